#!/usr/bin/env python3
"""Compares the core with Unicorn on stretches of images: instructions in sequence from a random state.

    crates/virtual-board/oracle/stretches.py [--most N] [--seed N] ELF ...

A stretch begins at each instruction of an image that no stretch has executed yet, with random
registers, flags and memory (numbers, floats and pointers into the memories). The core executes up to N
instructions, through branches, calls and loops; `crates/virtual-board/examples/stretches.rs` lists what
ends a stretch earlier. Then Unicorn executes the same number of instructions: registers, flags, FPSCR
and both memories must be equal. Exits 1 on any difference, or if the share of the images' instructions
that were executed is below LEAST.

A stretch also ends before an access to private peripherals or bit-band aliases, which Unicorn lacks, and
where Unicorn's stack pointer is no multiple of 4, although the manual keeps it aligned (B1.4.1).
"""

import argparse
import pathlib
import random
import struct
import sys

import core_side
import encodings_of_elf
import generate
import lockstep
import unicorn
from unicorn import arm_const as arm

# Mask registers of Unicorn, to be cleared before each stretch.
MASKS = (arm.UC_ARM_REG_PRIMASK, arm.UC_ARM_REG_BASEPRI, arm.UC_ARM_REG_FAULTMASK)
# Unicorn's errors for accesses to unmapped memory.
UNMAPPED = (unicorn.UC_ERR_READ_UNMAPPED, unicorn.UC_ERR_WRITE_UNMAPPED)
# Length of each memory by its first address.
SIZES = {lockstep.SRAM: lockstep.SRAM_SIZE, 0x1000_0000: 0x1_0000}
MEMORIES = sum(SIZES.values())
BATCH = 64
# Smallest share of the images' instructions that must be executed. The rest fault from every tried state, or
# need a feature that Unicorn lacks.
LEAST = 0.99
# Maximum number of stretches that begin at the same instruction.
TRIES = 3


class Ours:
    """The core of virtual-board with an image, in a process of its own."""

    def __init__(self, path, places):
        self.process = core_side.start("stretches", path)
        self.flash = self.process.stdout.read(lockstep.FLASH_SIZE)
        ranges = []
        for address, code in places:
            if ranges and ranges[-1][1] == address:
                ranges[-1][1] += len(code)
            else:
                ranges.append([address, address + len(code)])
        request = struct.pack("<I", len(ranges))
        self.process.stdin.write(request + b"".join(struct.pack("<2I", *r) for r in ranges))

    def run(self, memories, starts):
        """Runs a batch. Returns for each stretch the numbers of instructions and of those not skipped, program
        counter and words; then both memories, and one bit for each halfword of flash, set if executed."""
        request = memories + struct.pack("<I", len(starts))
        for begin, max_instructions, words in starts:
            request += struct.pack(f"<{2 + lockstep.WORDS}I", begin, max_instructions, *words)
        self.process.stdin.write(request)
        self.process.stdin.flush()
        results = []
        for _ in starts:
            answer = self.process.stdout.read(4 * (3 + lockstep.WORDS))
            count, skipped, pc, *words = struct.unpack(f"<{3 + lockstep.WORDS}I", answer)
            # Unicorn does not count the instructions that an IT block skips.
            results.append((count, count - skipped, pc, words))
        read = self.process.stdout.read
        return results, read(MEMORIES), read(lockstep.FLASH_SIZE // 16)


def state(rng, pool):
    """A random state: numbers, floats and pointers in the registers, a stack pointer within SRAM."""
    words = rng.choices(pool, k=lockstep.WORDS)
    words[13] = lockstep.SRAM + 0x1_0000 + 8 * rng.randrange(0x1000)
    words[lockstep.FLAGS] = generate.flags(rng)
    # RMode is 0, see TO_NEAREST in patterns.py.
    words[lockstep.FPSCR] = generate.status(rng) & ~0x00C0_0000
    return words


def some_words(rng):
    """Pool of random values for registers and memory."""
    words = [generate.word(rng) for _ in range(2000)] + [generate.single(rng) for _ in range(4000)]
    words += [rng.randrange(256) for _ in range(4000)]
    for base, size in SIZES.items():
        words += [base + 4 * rng.randrange(0x400, size // 4 - 0x400) for _ in range(6000)]
    return words


def load(theirs, memories):
    at = 0
    for base, size in SIZES.items():
        theirs.uc.mem_write(base, memories[at : at + size])
        at += size


def compare(ours, theirs, memories, starts):
    """Runs a batch in the core and in Unicorn. Halves a stretch that accesses memory that Unicorn lacks, and repeats
    the batch. Returns the number of instructions, the differences, the executed halfwords and the core's results."""
    while True:
        results, after, executed = ours.run(memories, starts)
        load(theirs, memories)
        total, texts = 0, []
        for k, (start, (count, steps, pc, words)) in enumerate(zip(starts, results)):
            if count == 0:
                continue
            total += count
            for mask in MASKS:
                theirs.uc.reg_write(mask, 0)
            error, their_pc, their_words = theirs.execute(start[0], 0xFFFF_FFFE, steps, start[2])
            # An error does not count if the states are equal: Unicorn also translates the next halfwords, perhaps data.
            if (their_pc, their_words) == (pc, words):
                continue
            if error in UNMAPPED or their_words[13] & 3:
                starts[k] = (start[0], count // 2, start[2])
                break
            one, other = (0, count, pc, words, b""), (error, count, their_pc, their_words, b"")
            for text in lockstep.differences(one, other):
                texts.append((start, count, text))
        else:
            memory = b"".join(bytes(theirs.uc.mem_read(*place)) for place in SIZES.items())
            if memory != after and not texts:
                at = next(k for k, (a, b) in enumerate(zip(after, memory)) if a != b)
                text = f"memory {at:#x}: ours {after[at]:#x}, unicorn {memory[at]:#x}"
                texts.append((starts[0], 0, text))
            return total, texts, executed, (results, after)


def is_equal_again(ours, theirs, memories, starts, given):
    """True if a repetition of the batch is equal and the core's results are those of the first run: Unicorn
    sometimes executes an outdated translation, see lockstep.py."""
    _, texts, _, again = compare(ours, theirs, memories, starts)
    return not texts and again == given


def cut(ours, theirs, memories, starts):
    """Text that names the first instruction with a difference. Stretches before its own are run too, because they
    change the memory."""

    def differ(some):
        return bool(compare(ours, theirs, memories, list(some))[1])

    last = next((k for k in range(len(starts)) if differ(starts[: k + 1])), None)
    if last is None:
        return "not repeatable"
    before, (begin, high, words) = starts[:last], starts[last]
    low = 0
    while high - low > 1:
        middle = (low + high) // 2
        if differ([*before, (begin, middle, words)]):
            high = middle
        else:
            low = middle
    pc = ours.run(memories, [*before, (begin, low, words)])[0][-1][2] if low else begin
    return f"the instruction at {pc:#010x}, {low} after {begin:#010x}"


def image(path, max_instructions, rng, show):
    """Compares stretches of one image, TRIES times from each instruction not executed before. Returns the numbers of
    compared instructions, of instructions in the image, of those that were executed, and of differences."""
    places = list(encodings_of_elf.instructions(path))
    ours, theirs = Ours(path, places), lockstep.Theirs()
    theirs.uc.mem_write(lockstep.FLASH, ours.flash)
    pool = some_words(rng)
    executed = bytes(lockstep.FLASH_SIZE // 16)

    def is_new(address):
        half = (address - lockstep.FLASH) // 2
        return not executed[half // 8] >> half % 8 & 1

    total = wrong = repeated = 0
    for _ in range(TRIES):
        left = [address for address, _ in places]
        rng.shuffle(left)
        while left:
            starts = []
            while left and len(starts) < BATCH:
                address = left.pop()
                if is_new(address):
                    starts.append((address, max_instructions, state(rng, pool)))
            memories = struct.pack(f"<{MEMORIES // 4}I", *rng.choices(pool, k=MEMORIES // 4))
            count, texts, executed, given = compare(ours, theirs, memories, starts)
            total += count
            if texts and is_equal_again(ours, theirs, memories, starts, given):
                repeated += 1
            elif texts:
                wrong += 1
                if wrong <= show:
                    print(f"{path.name}: {texts[0][2]}: {cut(ours, theirs, memories, starts)}")
    if repeated:
        print(f"{path.name}: {repeated} batches were equal only when Unicorn ran them again")
    return total, len(places), sum(not is_new(address) for address, _ in places), wrong


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("elf", nargs="+", type=pathlib.Path)
    parser.add_argument("--most", type=int, default=2000, help="instructions of a stretch")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--show", type=int, default=20, help="differences to print")
    arguments = parser.parse_args()
    rng = random.Random(arguments.seed)
    instructions = reached = differences = 0
    for path in arguments.elf:
        total, every, executed, wrong = image(path, arguments.most, rng, arguments.show)
        print(
            f"{path.name}: stretches of {total} instructions over {executed} of "
            f"{every} places, {wrong} differences"
        )
        instructions, reached = instructions + every, reached + executed
        differences += wrong
    if reached < LEAST * instructions:
        print(f"stretches.py: {reached} of {instructions} executed: at least {LEAST:.0%}")
    sys.exit(1 if differences or reached < LEAST * instructions else 0)


if __name__ == "__main__":
    main()
