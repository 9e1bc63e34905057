"""Random instructions, blocks and states for lockstep.py."""

import struct

import patterns as table

# Length in bytes of the memory from 0x2000_4000 on that blocks access, and the address in the base registers.
WINDOW = 0x1800
BASE = 0x2000_4C00
NOP = b"\x00\xbf" * 4
# Registers that instructions may change. Registers 7, 10 and 13 hold the base, 6 and 11 a small index.
FREE = [0, 1, 2, 3, 4, 5, 8, 9, 12, 14]
FREE_LOW = [0, 1, 2, 3, 4, 5]
READABLE = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 14]
# Those of FREE from r8 on, as 3-bit numbers: the register's number less 8.
FREE_HIGH = [0, 1, 4, 6]
DEFAULT_FPSCR = 0


class Unit:
    """Instructions that a cut of a block does not separate, and the name under which they are counted."""

    def __init__(self, name, code):
        self.name, self.code = name, code

    def bound(self, _address):
        return self


def halves(*values):
    return struct.pack(f"<{len(values)}H", *values)


def fields(pattern):
    """Dictionary from each field's letter to its bit numbers, highest first."""
    places = {}
    for k, letter in enumerate(pattern):
        if letter not in "01":
            places.setdefault(letter, []).append(len(pattern) - 1 - k)
    return places


def choose(rng, letter, width, name):
    if letter == "B":
        return 7 if width == 3 else rng.choice([10, 13])
    if letter == "X":
        return 6 if width == 3 else 11
    if letter in "nma" and not (letter == "n" and "high" in name):
        return rng.choice(READABLE if width == 4 else range(8))
    if letter in "dlhn":
        if width == 4:
            return rng.choice(FREE)
        return rng.choice(FREE_HIGH if "high" in name and width == 3 else FREE_LOW)
    return rng.getrandbits(width)


def is_register(letter, width, name):
    """True for the field of a core register. Narrower fields m and n belong to floating point."""
    return letter in table.REGISTERS and width >= 3


def prepare(rows):
    prepared = []
    for name, pattern, accept in rows:
        places = fields(pattern)
        fixed = int("".join(c if c in "01" else "0" for c in pattern), 2)
        prepared.append((name, len(pattern), fixed, places, accept))
    return prepared


def encode(rng, row):
    """A random instruction of a pattern."""
    name, length, fixed, places, accept = row
    while True:
        values = {}
        for letter, bits in places.items():
            width = len(bits)
            if is_register(letter, width, name):
                values[letter] = choose(rng, letter, width, name)
            else:
                values[letter] = rng.getrandbits(width)
        if accept is None or accept(values):
            break
    word = fixed
    for letter, bits in places.items():
        width = len(bits)
        for k, bit in enumerate(bits):
            word |= (values[letter] >> (width - 1 - k) & 1) << bit
    if length == 16:
        return halves(word)
    return halves(word >> 16, word & 0xFFFF)


STRAIGHT = prepare(table.NARROW + table.WIDE + table.FLOAT)
TO_NEAREST = prepare(table.TO_NEAREST)
MOVING = prepare(table.NARROW_MOVING + table.WIDE_MOVING + table.FLOAT_MOVING)


def move_wide(register, value):
    """MOVW and MOVT that load a value into a register."""

    def one(top, imm):
        first = 0xF240 | top << 7 | imm >> 11 & 1 << 0
        first = 0xF240 | top << 7 | (imm >> 11 & 1) << 10 | imm >> 12
        return halves(first, (imm >> 8 & 7) << 12 | register << 8 | imm & 0xFF)

    return one(0, value & 0xFFFF) + one(1, value >> 16)


# Restores the base registers: loads r10, then copies it to r7 and sp.
RESTORE = move_wide(10, BASE) + halves(0x4657, 0x46D5)


def conditional_code(rng):
    """A random instruction that may stand in an IT block."""
    while True:
        row = rng.choice(STRAIGHT)
        # Unicorn executes the rest of an IT block unconditionally after an ISB, unlike the manual (A7.3).
        if "pc" not in row[0] and row[0] not in ("ADR", "LDR literal", "ISB"):
            return encode(rng, row)


def it_block(rng):
    condition = rng.randrange(14)
    count = rng.randrange(1, 5)
    mask = 0
    for _ in range(count - 1):
        mask = mask << 1 | rng.getrandbits(1)
    mask = (mask << 1 | 1) << (4 - count)
    code = halves(0xBF00 | condition << 4 | mask)
    for _ in range(count):
        code += conditional_code(rng)
    return Unit("IT", code)


def some_code(rng):
    return encode(rng, rng.choice(STRAIGHT))


def branch(rng):
    """A random kind of jump over one instruction."""
    kind = rng.randrange(10)
    skipped = some_code(rng)
    offset = len(skipped)
    if kind == 0:
        return Unit("B cond", halves(0xD000 | rng.randrange(14) << 8 | (offset - 2) // 2) + skipped)
    if kind == 1:
        return Unit("B", halves(0xE000 | (offset - 2) // 2) + skipped)
    if kind == 2:
        condition = rng.randrange(14)
        return Unit("B.W cond", halves(0xF000 | condition << 6, 0x8000 | offset // 2) + skipped)
    if kind == 3:
        return Unit("B.W", halves(0xF000, 0xB800 | offset // 2) + skipped)
    if kind == 4:
        return Unit("BL", halves(0xF000, 0xF800 | offset // 2) + skipped)
    if kind == 5:
        op = rng.choice([0xB100, 0xB900])
        register = rng.choice(range(6))
        return Unit("CBZ", halves(op | (offset - 2) // 2 << 3 | register) + skipped)
    if kind == 6:
        # The table of TBB or TBH has two entries; the index is set to 0 or 1 before.
        half = rng.getrandbits(1)
        register = rng.choice(FREE)
        code = move_wide(register, rng.getrandbits(1))
        code += halves(0xE8DF, 0xF000 | half << 4 | register)
        begin = 4 if half else 2
        entries = [begin // 2, (begin + offset) // 2]
        code += struct.pack("<2H" if half else "<2B", *entries)
        return Unit("TBH" if half else "TBB", code + skipped)
    if kind == 7:
        # ADR loads the address after the skipped instruction; BX, BLX or MOV jumps to it.
        register = rng.choice(FREE_LOW)
        op, name = rng.choice([(0x4700, "BX"), (0x4780, "BLX"), (0x4687, "MOV to pc")])
        # The base of ADR.W is its own address + 4, rounded down to a multiple of 4.
        adr = halves(0xF20F, register << 8 | (2 + offset + 1))
        code = adr + halves(op | register << 3) + skipped
        return Aligned(name, code)
    if kind == 8:
        register = rng.choice(FREE_LOW)
        adr = halves(0xF20F, register << 8 | (4 + offset + 1))
        code = adr + halves(0xB400 | 1 << register, 0xBD00) + skipped
        return Aligned("POP pc", code)
    register = rng.choice(FREE_LOW)
    adr = halves(0xF20F, register << 8 | (8 + offset + 1))
    store = halves(0xF8CA, register << 12)
    load = halves(0xF8DA, 0xF000)
    return Aligned("LDR pc", adr + store + load + skipped)


class Aligned(Unit):
    """Code that must begin at a multiple of 4."""


def exclusive(rng):
    size = rng.choice([0, 0x40, 0x50])
    loaded, status, stored = rng.sample(FREE, 3)
    if size == 0:
        load = halves(0xE85A, loaded << 12 | 0xF00 | 4)
        store = halves(0xE84A, stored << 12 | status << 8 | 4)
    else:
        load = halves(0xE8DA, loaded << 12 | 0xF0F | size)
        store = halves(0xE8CA, stored << 12 | 0xF00 | size | status)
    return Unit(f"LDREX STREX {size:#x}", load + store)


def status_code(rng, bits):
    """Code that writes a random value, restricted to `bits`, to FPSCR."""
    register = rng.choice(FREE)
    value = rng.getrandbits(32) & bits
    return move_wide(register, value) + halves(0xEEE1, register << 12 | 0xA10)


def write_status(rng):
    """A write of random values to all existing bits of FPSCR."""
    return Unit("VMSR", status_code(rng, 0xF7C0_009F))


def to_nearest(rng):
    row = rng.choice(TO_NEAREST)
    return Unit(row[0], status_code(rng, 0xF700_009F) + encode(rng, row))


def unit(rng):
    draw = rng.random()
    if draw < 0.02:
        return write_status(rng)
    if draw < 0.03:
        return to_nearest(rng)
    if draw < 0.12:
        row = rng.choice(MOVING)
        return Unit(row[0], encode(rng, row) + RESTORE)
    if draw < 0.18:
        return it_block(rng)
    if draw < 0.25:
        return branch(rng)
    if draw < 0.26:
        return exclusive(rng)
    row = rng.choice(STRAIGHT)
    return Unit(row[0], encode(rng, row))


def block(rng):
    """A random block: a list of 60 units, with NOPs where a unit must be aligned."""
    units, length = [], 0
    for _ in range(60):
        new = unit(rng)
        if isinstance(new, Aligned) and length & 2:
            units.append(Unit("NOP", halves(0xBF00)))
            length += 2
        units.append(new)
        length += len(new.code)
    return units


def names():
    """Names of all kinds of instruction that a long run must generate."""
    return {row[0] for row in STRAIGHT + MOVING + TO_NEAREST} | {
        "IT",
        "B cond",
        "B",
        "B.W cond",
        "B.W",
        "BL",
        "CBZ",
        "TBB",
        "TBH",
        "BX",
        "BLX",
        "MOV to pc",
        "POP pc",
        "LDR pc",
        "VMSR",
    }


SPECIAL = [0, 1, 0x7FFF_FFFF, 0x8000_0000, 0xFFFF_FFFF, 0xFFFF, 0x8000, 0x7FFF, 0x80, 0x7F]
SPECIAL_FLOAT = [
    0,
    0x8000_0000,
    0x7F80_0000,
    0xFF80_0000,
    0x7FC0_0000,
    0x7F80_0001,
    0xFFC1_2345,
    0xFFA0_0000,
    1,
    0x8000_0001,
    0x007F_FFFF,
    0x0080_0000,
    0x0080_0001,
    0x7F7F_FFFF,
    0x3F80_0000,
    0xBF80_0000,
    0x4F00_0000,
    0xCF00_0000,
    0x4F7F_FFFF,
]


def word(rng):
    draw = rng.random()
    if draw < 0.25:
        return rng.choice(SPECIAL)
    if draw < 0.4:
        return rng.getrandbits(rng.randrange(1, 33))
    return rng.getrandbits(32)


def single(rng):
    draw = rng.random()
    if draw < 0.15:
        return rng.choice(SPECIAL_FLOAT)
    if draw < 0.7:
        # The exponents are close together, so that sums round and cancel.
        return rng.getrandbits(1) << 31 | rng.randrange(110, 145) << 23 | rng.getrandbits(23)
    if draw < 0.8:
        return rng.getrandbits(1) << 31 | rng.randrange(0, 30) << 23 | rng.getrandbits(23)
    return rng.getrandbits(32)


def status(rng):
    """A random FPSCR; with probability one half a value that is usual in programs."""
    if rng.random() < 0.5:
        return rng.choice([0, 0x10])
    return rng.getrandbits(32) & 0xF7C0_009F


def flags(rng):
    return rng.getrandbits(32) & 0xF80F_0000


class States:
    """Random states. Values come from a pool, which is four times as fast as drawing each value."""

    def __init__(self, rng):
        self.rng = rng
        self.words = [word(rng) for _ in range(1 << 14)]
        self.singles = [single(rng) for _ in range(1 << 14)]

    def draw(self):
        rng = self.rng
        registers = rng.choices(self.words, k=15)
        for k in (7, 10, 13):
            registers[k] = BASE
        registers[6] = rng.randrange(64)
        registers[11] = rng.randrange(64)
        return [*registers, flags(rng), status(rng), *rng.choices(self.singles, k=32)]

    def pointers(self, code, kind):
        """A state for one instruction of an image. Core registers by `kind`: 0 random numbers, 1 pointers,
        2 pointers and small numbers mixed, 3 a pointer in the base register and small numbers elsewhere."""
        rng = self.rng
        # These instructions fault at unaligned addresses (A3.2.1), in Unicorn they do not.
        aligned = code[1] in (0xE8, 0xE9, 0xEC, 0xED) or code[1] >> 4 == 0xC
        middle = 0x2000_6000
        base = code[0] & 15 if len(code) == 4 else struct.unpack("<H", code)[0] >> 3 & 7
        registers = []
        for number in range(15):
            if kind == 0:
                registers.append(rng.choice(self.words) & (~3 if aligned else ~0))
            elif kind == 1 or (number == base if kind == 3 else rng.getrandbits(1)):
                registers.append(middle + 4 * rng.randrange(-64, 64))
            else:
                registers.append(rng.randrange(64) & (~3 if aligned else ~0))
        registers[13] = middle + 4 * rng.randrange(-64, 64)
        # RMode is 0 for all instructions, because some need it: see TO_NEAREST in patterns.py.
        fpscr = status(rng) & ~0x00C0_0000
        return [*registers, flags(rng), fpscr, *rng.choices(self.singles, k=32)]


def leaves_the_block(code):
    """True for an instruction that cannot be compared alone: jump to a register, IT, wait, mask, call."""
    h = struct.unpack_from("<H", code)[0]
    if len(code) == 2:
        return (
            h >> 8 == 0x47
            or h & 0xFF87 in (0x4687, 0x4487)
            or h >> 8 in (0xDF, 0xBE, 0xBD, 0xDE)
            or h & 0xFFE8 == 0xB660
            or (h >> 8 == 0xBF and h & 0xFF not in (0, 0x10, 0x40))
        )
    g = struct.unpack_from("<H", code, 2)[0]
    load = h & 0xFE50 == 0xE810 and g >> 15
    load_word = h & 0xFF70 == 0xF850 and g >> 12 == 15
    table_branch = h & 0xFFF0 == 0xE8D0 and g & 0xF0 < 0x20
    control = h & 0xF800 == 0xF000 and g & 0xD000 == 0x8000 and h & 0x0380 == 0x0380
    undefined = h & 0xFFF0 == 0xF7F0 and g >> 12 == 10
    exclusive_store = h & 0xFFF0 == 0xE840 or (h & 0xFFF0 == 0xE8C0 and g >> 12 != 15)
    return bool(load or load_word or table_branch or control or undefined or exclusive_store)


def branches(code):
    """True for B and BL of 32 bits."""
    if len(code) == 2:
        return False
    h, g = struct.unpack("<2H", code)
    return h & 0xF800 == 0xF000 and g & 0x8000 != 0
