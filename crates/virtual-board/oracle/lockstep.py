#!/usr/bin/env python3
"""Compares the core with Unicorn, instruction by instruction.

    crates/virtual-board/oracle/lockstep.py [--instructions N] [--seed N] [ELF ...]

Random blocks contain every encoding that may stand in straight-line code with random operands, branches
within the block, and IT blocks. Each block runs from random registers, flags, floating-point modes and
memory in the core (`crates/virtual-board/examples/lockstep.rs`) and in Unicorn's Cortex-M4. Afterwards
registers, flags, FPSCR and memory must be equal. A block with a difference is shortened to find the
first instruction that differs. Then every encoding in the images runs alone from several states. Exits 1
on any difference.

Not compared, because Unicorn differs from the manual (ARMv7-M Architecture Reference Manual) or lacks
the feature:

- conversions from fixed point to floating point with RMode other than 0: they round to nearest whatever
  FPSCR selects (A7.7.229); Unicorn rounds according to FPSCR;
- an ISB in an IT block: the block continues (A7.3); Unicorn executes the rest unconditionally;
- YIELD: a hint (A7.7.268); Unicorn stops there;
- LDM, STM, LDRD, STRD, VLDR and VSTR of images at unaligned addresses: they fault (A3.2.1), in Unicorn
  they do not; tests of the crate cover the faults;
- exceptions and private peripherals.

Unicorn sometimes executes an outdated translation of code that was at an address before. A block with
a difference is therefore translated and run again, up to three times. If a repetition is equal and the
core's result is that of the first run, the block counts as equal. The number of such blocks is printed.

stretches.py compares sequences of the images' instructions; check_lockstep.sh installs Unicorn and runs
both programs.

Unicorn is GPL and runs in a process of its own; it is not linked to anything here.
"""

import argparse
import collections
import ctypes
import pathlib
import random
import struct
import sys

import core_side
import encodings_of_elf
import generate

try:
    import unicorn
    from unicorn import arm_const as arm
except ImportError:
    sys.exit("lockstep.py: the package unicorn is missing: check_lockstep.sh installs and runs all")

FLASH, FLASH_SIZE = 0x0800_0000, 1 << 20
SRAM, SRAM_SIZE = 0x2000_0000, 0x2_0000
DATA = 0x2000_4000
WORDS = 49
# Unicorn's names of the words of a state: r0 to r14, flags, FPSCR, s0 to s31.
IDS = [arm.UC_ARM_REG_R0 + k for k in range(13)]
IDS += [arm.UC_ARM_REG_SP, arm.UC_ARM_REG_LR, arm.UC_ARM_REG_XPSR, arm.UC_ARM_REG_FPSCR]
IDS += [arm.UC_ARM_REG_S0 + k for k in range(32)]
FLAGS, FPSCR = 15, 16
FLAG_BITS = 0xF80F_0000
NAMES = [f"r{k}" for k in range(13)] + ["sp", "lr", "apsr", "fpscr"] + [f"s{k}" for k in range(32)]


class Ours:
    """The core of virtual-board, in a process of its own."""

    def __init__(self):
        self.process = core_side.start("lockstep")
        # The start of the flash holds the vectors and code that the process itself needs.
        self.flash = self.process.stdout.read(0x1000)

    def run(self, address, code, data, end, cases):
        """Result of each case: failed, executed, pc, words, data."""
        request = struct.pack("<II", address, len(code)) + code
        request += struct.pack("<I", len(data)) + data + struct.pack("<II", end, len(cases))
        request += b"".join(struct.pack(f"<{WORDS}I", *case) for case in cases)
        self.process.stdin.write(request)
        self.process.stdin.flush()
        results = []
        for _ in cases:
            answer = self.process.stdout.read(4 * (3 + WORDS))
            failed, count, pc, *words = struct.unpack(f"<{3 + WORDS}I", answer)
            results.append((failed, count, pc, words, self.process.stdout.read(len(data))))
        return results


class Theirs:
    """Unicorn."""

    def __init__(self):
        self.uc = uc = unicorn.Uc(
            unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS
        )
        uc.ctl_set_cpu_model(arm.UC_CPU_ARM_CORTEX_M4)
        # The flash is mapped at two addresses and is read-only for the program.
        self.flash = ctypes.create_string_buffer(FLASH_SIZE + 0x1000)
        start = (ctypes.addressof(self.flash) + 0xFFF) & ~0xFFF
        read_only = unicorn.UC_PROT_READ | unicorn.UC_PROT_EXEC
        for address in (FLASH, 0):
            uc.mem_map_ptr(address, FLASH_SIZE, read_only, ctypes.c_void_p(start))
        uc.mem_write(FLASH, b"\x00\xbf" * (FLASH_SIZE // 2))
        uc.mem_map(SRAM, SRAM_SIZE)
        uc.mem_map(0x1000_0000, 0x1_0000)
        uc.reg_write(arm.UC_ARM_REG_C1_C0_2, 0x00F0_0000)
        uc.reg_write(arm.UC_ARM_REG_FPEXC, 0x4000_0000)
        # Unicorn's Python calls for many registers are slow, so its C functions are called, with fixed buffers.
        self.library = unicorn.unicorn_py3.unicorn.uclib
        self.values = (ctypes.c_uint32 * (WORDS + 1))()
        count = WORDS + 1
        self.ids = (ctypes.c_int * count)(*IDS, arm.UC_ARM_REG_PC)
        # A write of Unicorn's XPSR does not set the GE bits; a write of APSR_NZCVQG does.
        write = [arm.UC_ARM_REG_APSR_NZCVQG if k == FLAGS else id for k, id in enumerate(IDS)]
        self.write_ids = (ctypes.c_int * WORDS)(*write)
        step = ctypes.sizeof(ctypes.c_uint32)
        places = [ctypes.addressof(self.values) + k * step for k in range(count)]
        self.places = (ctypes.c_void_p * count)(*places)

    def run(self, address, code, data, end, cases):
        self.uc.mem_write(address, code)
        # Unicorn must discard its translation of the code that was at this address before.
        self.uc.ctl_remove_cache(address, address + len(code))
        results = []
        for case in cases:
            self.uc.mem_write(DATA, data)
            error, pc, words = self.execute(address, end or 0xFFFF_FFFE, 0 if end else 1, case)
            failed = error or (end != 0 and pc != end)
            results.append((failed, 0, pc, words, bytes(self.uc.mem_read(DATA, len(data)))))
        return results

    def execute(self, begin, end, count, case):
        """Runs from a state to address `end`, or `count` instructions if not 0: error, program counter, words."""
        handle = self.uc._uch
        self.values[:WORDS] = case
        self.values[FLAGS] |= 1 << 24
        self.library.uc_reg_write_batch(handle, self.write_ids, self.places, WORDS)
        error = self.library.uc_emu_start(
            handle,
            ctypes.c_uint64(begin | 1),
            ctypes.c_uint64(end),
            ctypes.c_uint64(0),
            ctypes.c_size_t(count),
        )
        self.library.uc_reg_read_batch(handle, self.ids, self.places, WORDS + 1)
        words = list(self.values[:WORDS])
        words[FLAGS] &= FLAG_BITS
        return error, self.values[WORDS], words


def differences(ours, theirs):
    """Texts that describe the differences of two results; none if the case cannot be compared."""
    if ours[0] or theirs[0]:
        # Unicorn has no bit-band aliases and no private peripherals.
        if theirs[0] in (unicorn.UC_ERR_READ_UNMAPPED, unicorn.UC_ERR_WRITE_UNMAPPED):
            return []
        if bool(ours[0]) == bool(theirs[0]):
            return []
        places = f"at {ours[2]:#010x}, {theirs[2]:#010x}"
        return [f"failed: ours {ours[0]}, unicorn {theirs[0]}, {places}"]
    texts = []
    if ours[2] != theirs[2]:
        texts.append(f"pc: ours {ours[2]:#010x}, unicorn {theirs[2]:#010x}")
    for name, a, b in zip(NAMES, ours[3], theirs[3]):
        if a != b:
            texts.append(f"{name}: ours {a:#010x}, unicorn {b:#010x}")
    if ours[4] != theirs[4]:
        k = next(k for k, (a, b) in enumerate(zip(ours[4], theirs[4])) if a != b)
        texts.append(f"memory {DATA + k:#010x}: ours {ours[4][k]:#04x}, unicorn {theirs[4][k]:#04x}")
    return texts


class Lockstep:
    """Runs cases in the core and in Unicorn, and counts comparisons and differences."""

    def __init__(self, most_shown, verbose):
        self.begin(FLASH_SIZE)
        self.instructions = 0
        self.compared = collections.Counter()
        self.different = collections.Counter()
        self.shown = self.repeated = 0
        self.most_shown, self.verbose = most_shown, verbose

    def begin(self, size):
        """Starts the core and Unicorn anew; code is placed in the first `size` bytes of the flash."""
        self.ours, self.theirs = Ours(), Theirs()
        self.theirs.uc.mem_write(FLASH, self.ours.flash)
        self.address, self.end = FLASH + 0x1000, FLASH + size - 0x1000

    def place(self, length):
        """Address for new code; addresses are used again only when the flash is full."""
        if self.address + length > self.end:
            self.address = FLASH + 0x1000
        address = self.address
        self.address += (length + 64 + 3) & ~3
        return address

    def both(self, address, code, data, end, cases):
        ours = self.ours.run(address, code, data, end, cases)
        theirs = self.theirs.run(address, code, data, end, cases)
        return ours, theirs

    def block(self, units, data, cases):
        """Compares a block of units, each a name and its code."""
        code = b"".join(unit.code for unit in units)
        address = self.place(len(code))
        units = [unit.bound(address) for unit in units]
        # The run ends at the first of the NOPs that follow the block.
        ours, theirs = self.both(address, code + generate.NOP, data, address + len(code), cases)
        for one, other, case in zip(ours, theirs, cases):
            self.instructions += one[1]
            texts = differences(one, other)
            if texts and self.differs_always(address, units, data, case, one):
                self.cut(address, units, data, case, texts)
            elif texts:
                self.repeated += 1
        for unit in units:
            self.compared[unit.name] += len(cases)

    def again(self, address, code, data, case):
        ours, theirs = self.both(address, code, data, 0, [case])
        return ours[0], theirs[0]

    def differs_always(self, address, units, data, case, before):
        """False if Unicorn had run an outdated translation: a repetition is equal, and the core's result is
        that of the first run."""
        for _ in range(3):
            texts, words = self.prefix(address, units, data, case)
            if words != before[3]:
                return True
            if not texts:
                return False
        return True

    def cut(self, address, units, data, case, whole):
        """Finds and shows the first unit after which the states differ."""
        low, high = 0, len(units)
        while high - low > 1:
            middle = (low + high) // 2
            if self.prefix(address, units[:middle], data, case)[0]:
                high = middle
            else:
                low = middle
        texts, before = self.prefix(address, units[:high], data, case)
        if not texts:
            texts, before = ["not repeatable: " + "; ".join(whole)], case
        self.show(units[high - 1], texts, self.prefix(address, units[: high - 1], data, case)[1])

    def prefix(self, address, units, data, case):
        code = b"".join(unit.code for unit in units)
        ours, theirs = self.both(address, code + generate.NOP, data, address + len(code), [case])
        return differences(ours[0], theirs[0]), ours[0][3]

    def show(self, unit, texts, before):
        self.different[unit.name] += 1
        self.shown += 1
        if self.shown <= self.most_shown:
            print(f"{unit.name} [{unit.code.hex(' ', -2)}]: {'; '.join(texts)}")
            if self.verbose:
                words = zip(NAMES, before)
                print("  before: " + ", ".join(f"{name} {value:#x}" for name, value in words))

    def single(self, code, data, cases):
        """Compares one instruction of an image from several states."""
        padded = code + generate.NOP
        if generate.branches(code):
            # Its target must be executable, so the branch is in the middle of the flash, among NOPs.
            address = FLASH + FLASH_SIZE // 2
        else:
            address = self.place(len(padded))
        ours, theirs = self.both(address, padded, data, 0, cases)
        ran = 0
        for one, other, case in zip(ours, theirs, cases):
            ran += not one[0]
            self.instructions += one[1]
            texts = differences(one, other)
            unit = generate.Unit("image", code)
            if texts and all(differences(*self.again(address, padded, data, case)) for _ in range(3)):
                self.show(generate.Unit("image", code), texts, case)
            elif texts:
                self.repeated += 1
        self.compared["image"] += len(cases)
        return ran


def random_blocks(lockstep, wanted, rng):
    """Compares random blocks until `wanted` instructions have run."""
    states = generate.States(rng)
    while lockstep.instructions < wanted:
        units = generate.block(rng)
        data = rng.randbytes(generate.WINDOW)
        cases = [states.draw() for _ in range(24)]
        lockstep.block(units, data, cases)


def images(lockstep, paths, rng, part, parts):
    """Compares the encodings of the images, or a part of them. Returns the number of all encodings, the number of
    compared encodings, and those that faulted from every state."""
    codes = set()
    for path in paths:
        codes |= encodings_of_elf.encodings(path)
    lockstep.begin(FLASH_SIZE // 4)
    chosen = [code for code in sorted(codes) if not generate.leaves_the_block(code)][part::parts]
    never, states = [], generate.States(rng)
    for code in chosen:
        data = rng.randbytes(0x4000)
        cases = [states.pointers(code, kind) for kind in range(4)]
        if lockstep.single(code, data, cases) == 0:
            never.append(code)
    return len(codes), len(chosen), never


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("elf", nargs="*", type=pathlib.Path, help="images whose encodings to compare")
    parser.add_argument("--instructions", type=int, default=10_000_000, help="how many at random")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--part", type=int, nargs=2, default=(0, 1), help="of the encodings the part K of N, from 0")
    parser.add_argument("--show", type=int, default=20, help="differences to print")
    parser.add_argument("--verbose", action="store_true", help="state before each difference")
    parser.add_argument("--table", action="store_true", help="counts of every encoding")
    arguments = parser.parse_args()
    rng = random.Random(arguments.seed)
    lockstep = Lockstep(arguments.show, arguments.verbose)
    random_blocks(lockstep, arguments.instructions, rng)
    print(f"{len(lockstep.compared)} kinds of instruction, {lockstep.instructions} instructions")
    if arguments.table:
        for name, count in sorted(lockstep.compared.items()):
            print(f"  {name:24} {count:9} {lockstep.different[name]:6}")
    missing = generate.names() - lockstep.compared.keys()
    if missing:
        print(f"never generated: {', '.join(sorted(missing))}")
    before = lockstep.instructions
    if arguments.elf:
        every, chosen, never = images(lockstep, arguments.elf, rng, *arguments.part)
        print(
            f"images: {every} encodings, {chosen} compared, "
            f"{lockstep.instructions - before} instructions, {len(never)} never without a fault"
        )
        for code in never[: arguments.show]:
            print(f"  {code.hex(' ', 2)}")
    if lockstep.repeated:
        print(f"{lockstep.repeated} cases were equal only after Unicorn had translated them anew")
    wrong = sum(lockstep.different.values())
    print(f"{lockstep.instructions} instructions compared, {wrong} differences")
    for name, count in lockstep.different.most_common():
        print(f"  {name}: {count}")
    sys.exit(1 if wrong or missing else 0)


if __name__ == "__main__":
    main()
