#!/usr/bin/env python3
"""Compares the core with Unicorn on stretches of images.

    crates/virtual-board/oracle/stretches.py [--most N] [--seed N] ELF ...

Begins at every instruction of an image that no stretch has executed yet, with arbitrary registers,
flags and memory (numbers, floats and pointers into the memories), and lets the program go where it
goes, through branches, calls and loops, up to N instructions; it ends earlier where the core's side
(`crates/virtual-board/examples/stretches.rs`) says. Then the same number of instructions in Unicorn:
registers, flags, FPSCR and both memories must be equal. Exit 1 on any difference, or if less than
LEAST of the images' instructions were executed.

Where Unicorn has no memory, the private peripherals and the bit-band aliases, a stretch ends too, and
where its stack pointer is no multiple of 4, which the manual's always is (B1.4.1).
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

# Masks, which outlive a stretch.
MASKS = (arm.UC_ARM_REG_PRIMASK, arm.UC_ARM_REG_BASEPRI, arm.UC_ARM_REG_FAULTMASK)
# Errors of accesses where Unicorn has no memory.
UNMAPPED = (unicorn.UC_ERR_READ_UNMAPPED, unicorn.UC_ERR_WRITE_UNMAPPED)
# Memories, and where the addresses of their pointers lie.
SIZES = {lockstep.SRAM: lockstep.SRAM_SIZE, 0x1000_0000: 0x1_0000}
MEMORIES = sum(SIZES.values())
BATCH = 64
# Of the instructions of all images. The others fault from every state that was tried, or need what
# Unicorn has not.
LEAST = 0.99
# How often an instruction may be where a stretch begins.
TRIES = 3


class Ours:
    """The core, with an image."""

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
        """Instructions, those not skipped, program counter and words of each; memories; bits of what
        was executed."""
        request = memories + struct.pack("<I", len(starts))
        for begin, max_instructions, words in starts:
            request += struct.pack(f"<{2 + lockstep.WORDS}I", begin, max_instructions, *words)
        self.process.stdin.write(request)
        self.process.stdin.flush()
        results = []
        for _ in starts:
            answer = self.process.stdout.read(4 * (3 + lockstep.WORDS))
            count, skipped, pc, *words = struct.unpack(f"<{3 + lockstep.WORDS}I", answer)
            # Unicorn does not count what an IT block skips.
            results.append((count, count - skipped, pc, words))
        read = self.process.stdout.read
        return results, read(MEMORIES), read(lockstep.FLASH_SIZE // 16)


def state(rng, pool):
    """Numbers, floats and pointers in the registers; the stack pointer inside a memory."""
    words = rng.choices(pool, k=lockstep.WORDS)
    words[13] = lockstep.SRAM + 0x1_0000 + 8 * rng.randrange(0x1000)
    words[lockstep.FLAGS] = generate.flags(rng)
    # See TO_NEAREST of generate.py.
    words[lockstep.FPSCR] = generate.status(rng) & ~0x00C0_0000
    return words


def some_words(rng):
    """What registers and memory may hold."""
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
    """Runs a batch in both. Shortens a stretch of which Unicorn has not the memory. Gives the
    instructions, what differs, what was executed, and what the core gave."""
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
            # What comes next is translated, though not executed, and may be no instruction.
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
    """Whether Unicorn agrees when it runs the batch again, and the core gives what it gave before: what
    Unicorn keeps of its translations is not always right, see lockstep.py."""
    _, texts, _, again = compare(ours, theirs, memories, starts)
    return not texts and again == given


def cut(ours, theirs, memories, starts):
    """The first instruction that differs: in the first stretch that does, after those before it."""

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
    """Stretches of one image until there is nothing new to begin with; the instructions compared, the
    image's, those that were executed, and the differences."""
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
