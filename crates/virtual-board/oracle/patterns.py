"""Encodings of ARMv7E-M with FPv4-SP that may stand in straight-line code, for lockstep.py.

Patterns have the form of the ARMv7-M Architecture Reference Manual: 0 and 1 are fixed bits, a letter is a
bit of a field. B and X are registers that form an address.

    d n m a l h   core registers that may be read and written
    B             base of an address, X an index (a small number)
    S             sets the flags; i t w j  any number
    f g k j q     bits of floating-point registers
"""

# Names of the fields that hold core registers.
REGISTERS = "dnmalhBX"


def thumb_expand_allowed(f):
    """Constants of the forms 00XY00XY and so on may not be of a zero byte."""
    code = f["i"] >> 8
    return not (1 <= code <= 3 and f["i"] & 0xFF == 0)


def different(one, other):
    return lambda f: f[one] != f[other]


def field_fits(f):
    """Lowest bit and width - 1 of a bit field to be extracted."""
    return low(f) + f["w"] < 32


def low(f):
    return f["i"]


NARROW = [
    ("LSL imm", "00000iiiiimmmddd", None),
    ("LSR imm", "00001iiiiimmmddd", None),
    ("ASR imm", "00010iiiiimmmddd", None),
    ("ADD reg", "0001100mmmnnnddd", None),
    ("SUB reg", "0001101mmmnnnddd", None),
    ("ADD imm3", "0001110iiinnnddd", None),
    ("SUB imm3", "0001111iiinnnddd", None),
    ("MOV imm8", "00100dddiiiiiiii", None),
    ("CMP imm8", "00101nnniiiiiiii", None),
    ("ADD imm8", "00110dddiiiiiiii", None),
    ("SUB imm8", "00111dddiiiiiiii", None),
    ("AND", "0100000000mmmddd", None),
    ("EOR", "0100000001mmmddd", None),
    ("LSL reg", "0100000010mmmddd", None),
    ("LSR reg", "0100000011mmmddd", None),
    ("ASR reg", "0100000100mmmddd", None),
    ("ADC", "0100000101mmmddd", None),
    ("SBC", "0100000110mmmddd", None),
    ("ROR reg", "0100000111mmmddd", None),
    ("TST", "0100001000mmmnnn", None),
    ("RSB", "0100001001nnnddd", None),
    ("CMP", "0100001010mmmnnn", None),
    ("CMN", "0100001011mmmnnn", None),
    ("ORR", "0100001100mmmddd", None),
    ("MUL", "0100001101nnnddd", None),
    ("BIC", "0100001110mmmddd", None),
    ("MVN", "0100001111mmmddd", None),
    ("ADD high", "010001001mmmmddd", None),
    ("CMP high", "010001011mmmmnnn", None),
    ("CMP high 2", "010001010mmmmnnn", lambda f: f["m"] >= 8),
    ("MOV high", "010001100mmmmddd", None),
    ("ADD pc", "0100010001111ddd", None),
    ("MOV pc", "0100011001111ddd", None),
    ("LDR literal", "01001dddiiiiiiii", None),
    ("STR reg", "0101000XXXBBBddd", None),
    ("STRH reg", "0101001XXXBBBddd", None),
    ("STRB reg", "0101010XXXBBBddd", None),
    ("LDRSB reg", "0101011XXXBBBddd", None),
    ("LDR reg", "0101100XXXBBBddd", None),
    ("LDRH reg", "0101101XXXBBBddd", None),
    ("LDRB reg", "0101110XXXBBBddd", None),
    ("LDRSH reg", "0101111XXXBBBddd", None),
    ("STR imm", "01100iiiiiBBBddd", None),
    ("LDR imm", "01101iiiiiBBBddd", None),
    ("STRB imm", "01110iiiiiBBBddd", None),
    ("LDRB imm", "01111iiiiiBBBddd", None),
    ("STRH imm", "10000iiiiiBBBddd", None),
    ("LDRH imm", "10001iiiiiBBBddd", None),
    ("STR sp", "10010dddiiiiiiii", None),
    ("LDR sp", "10011dddiiiiiiii", None),
    ("ADR", "10100dddiiiiiiii", None),
    ("ADD sp", "10101dddiiiiiiii", None),
    ("SXTH", "1011001000mmmddd", None),
    ("SXTB", "1011001001mmmddd", None),
    ("UXTH", "1011001010mmmddd", None),
    ("UXTB", "1011001011mmmddd", None),
    ("REV", "1011101000mmmddd", None),
    ("REV16", "1011101001mmmddd", None),
    ("REVSH", "1011101011mmmddd", None),
    ("NOP", "1011111100000000", None),
    ("SEV", "1011111101000000", None),
]

# These instructions change a base register or the stack pointer; generate.py restores the register afterwards.
NARROW_MOVING = [
    ("ADD sp sp", "101100000iiiiiii", None),
    ("SUB sp sp", "101100001iiiiiii", None),
    ("PUSH", "1011010tiiiiiiii", lambda f: f["t"] or f["i"]),
    ("POP", "10111100iiiiiiii", lambda f: f["i"] & 0x3F and not f["i"] & 0xC0),
    ("STM", "11000111iiiiiiii", lambda f: f["i"] and not f["i"] & 0x80),
    ("LDM", "11001111iiiiiiii", lambda f: f["i"] and not f["i"] & 0xC0),
]

LOGIC = {"AND": 0, "BIC": 1, "ORR": 2, "ORN": 3, "EOR": 4}
SUMS = {"ADD": 8, "ADC": 10, "SBC": 11, "SUB": 13, "RSB": 14}
TESTS = {"TST": 0, "TEQ": 4, "CMN": 8, "CMP": 13}

WIDE = []
for _name, _op in {**LOGIC, **SUMS}.items():
    _bits = f"{_op:04b}"
    WIDE += [
        (f"{_name}.W imm", f"11110i0{_bits}Snnnn0iiiddddiiiiiiii", thumb_expand_allowed),
        (f"{_name}.W reg", f"1110101{_bits}Snnnn0iiiddddiittmmmm", None),
    ]
for _name, _op in {"MOV": 2, "MVN": 3}.items():
    _bits = f"{_op:04b}"
    WIDE += [
        (f"{_name}.W imm", f"11110i0{_bits}S11110iiiddddiiiiiiii", thumb_expand_allowed),
        (f"{_name}.W reg", f"1110101{_bits}S11110iiiddddiittmmmm", None),
    ]
for _name, _op in TESTS.items():
    _bits = f"{_op:04b}"
    WIDE += [
        (f"{_name}.W imm", f"11110i0{_bits}1nnnn0iii1111iiiiiiii", thumb_expand_allowed),
        (f"{_name}.W reg", f"1110101{_bits}1nnnn0iii1111iittmmmm", None),
    ]
WIDE += [
    ("ADDW", "11110i100000nnnn0iiiddddiiiiiiii", None),
    ("SUBW", "11110i101010nnnn0iiiddddiiiiiiii", None),
    ("ADR.W +", "11110i10000011110iiiddddiiiiiiii", None),
    ("ADR.W -", "11110i10101011110iiiddddiiiiiiii", None),
    ("MOVW", "11110i100100iiii0iiiddddiiiiiiii", None),
    ("MOVT", "11110i101100iiii0iiiddddiiiiiiii", None),
    ("SSAT", "1111001100t0nnnn0iiiddddii0wwwww", lambda f: f["t"] == 0 or f["i"]),
    ("USAT", "1111001110t0nnnn0iiiddddii0wwwww", lambda f: f["t"] == 0 or f["i"]),
    ("SSAT16", "111100110010nnnn0000dddd0000wwww", None),
    ("USAT16", "111100111010nnnn0000dddd0000wwww", None),
    ("SBFX", "111100110100nnnn0iiiddddii0wwwww", field_fits),
    ("UBFX", "111100111100nnnn0iiiddddii0wwwww", field_fits),
    ("BFI", "111100110110nnnn0iiiddddii0wwwww", lambda f: f["w"] >= low(f)),
    ("BFC", "11110011011011110iiiddddii0wwwww", lambda f: f["w"] >= low(f)),
    ("PKHBT", "111010101100nnnn0iiiddddii00mmmm", None),
    ("PKHTB", "111010101100nnnn0iiiddddii10mmmm", None),
    ("LSL.W reg", "11111010000Snnnn1111dddd0000mmmm", None),
    ("LSR.W reg", "11111010001Snnnn1111dddd0000mmmm", None),
    ("ASR.W reg", "11111010010Snnnn1111dddd0000mmmm", None),
    ("ROR.W reg", "11111010011Snnnn1111dddd0000mmmm", None),
]
for _k, _name in enumerate(["SXTAH", "UXTAH", "SXTAB16", "UXTAB16", "SXTAB", "UXTAB"]):
    WIDE.append((_name, f"111110100{_k:03b}nnnn1111dddd10iimmmm", None))
    WIDE.append((f"{_name} alone", f"111110100{_k:03b}11111111dddd10iimmmm", None))
for _op, _name in {1: "ADD16", 2: "ASX", 6: "SAX", 5: "SUB16", 0: "ADD8", 4: "SUB8"}.items():
    for _k, _prefix in {0: "S", 1: "Q", 2: "SH", 4: "U", 5: "UQ", 6: "UH"}.items():
        _pattern = f"111110101{_op:03b}nnnn1111dddd0{_k:03b}mmmm"
        WIDE.append((_prefix + _name, _pattern, None))
for _k, _name in enumerate(["QADD", "QDADD", "QSUB", "QDSUB"]):
    WIDE.append((_name, f"111110101000nnnn1111dddd10{_k:02b}mmmm", None))
for _op, _k, _name in [
    (1, 0, "REV.W"),
    (1, 1, "REV16.W"),
    (1, 2, "RBIT"),
    (1, 3, "REVSH.W"),
    (3, 0, "CLZ"),
]:
    _pattern = f"111110101{_op:03b}nnnn1111dddd10{_k:02b}mmmm"
    WIDE.append((_name, _pattern, lambda f: f["n"] == f["m"]))
WIDE += [
    ("SEL", "111110101010nnnn1111dddd1000mmmm", None),
    ("MUL.W", "111110110000nnnn1111dddd0000mmmm", None),
    ("MLA", "111110110000nnnnaaaadddd0000mmmm", None),
    ("MLS", "111110110000nnnnaaaadddd0001mmmm", None),
    ("SMULxy", "111110110001nnnn1111dddd00iimmmm", None),
    ("SMLAxy", "111110110001nnnnaaaadddd00iimmmm", None),
    ("SMUAD", "111110110010nnnn1111dddd000immmm", None),
    ("SMLAD", "111110110010nnnnaaaadddd000immmm", None),
    ("SMULWy", "111110110011nnnn1111dddd000immmm", None),
    ("SMLAWy", "111110110011nnnnaaaadddd000immmm", None),
    ("SMUSD", "111110110100nnnn1111dddd000immmm", None),
    ("SMLSD", "111110110100nnnnaaaadddd000immmm", None),
    ("SMMUL", "111110110101nnnn1111dddd000immmm", None),
    ("SMMLA", "111110110101nnnnaaaadddd000immmm", None),
    ("SMMLS", "111110110110nnnnaaaadddd000immmm", None),
    ("USAD8", "111110110111nnnn1111dddd0000mmmm", None),
    ("USADA8", "111110110111nnnnaaaadddd0000mmmm", None),
    ("SMULL", "111110111000nnnnllllhhhh0000mmmm", different("l", "h")),
    ("SDIV", "111110111001nnnn1111dddd1111mmmm", None),
    ("UMULL", "111110111010nnnnllllhhhh0000mmmm", different("l", "h")),
    ("UDIV", "111110111011nnnn1111dddd1111mmmm", None),
    ("SMLAL", "111110111100nnnnllllhhhh0000mmmm", different("l", "h")),
    ("SMLALxy", "111110111100nnnnllllhhhh10iimmmm", different("l", "h")),
    ("SMLALD", "111110111100nnnnllllhhhh110immmm", different("l", "h")),
    ("SMLSLD", "111110111101nnnnllllhhhh110immmm", different("l", "h")),
    ("UMLAL", "111110111110nnnnllllhhhh0000mmmm", different("l", "h")),
    ("UMAAL", "111110111110nnnnllllhhhh0110mmmm", different("l", "h")),
    ("LDRD", "11101001t101BBBBllllhhhhiiiiiiii", different("l", "h")),
    ("STRD", "11101001t100BBBBllllhhhhiiiiiiii", None),
    ("LDRD literal", "11101001110111 11llllhhhh0000iiii".replace(" ", ""), different("l", "h")),
    ("STRT", "111110000100BBBBdddd1110iiiiiiii", None),
    ("LDRT", "111110000101BBBBdddd1110iiiiiiii", None),
    ("PLD imm", "111110001001BBBB1111iiiiiiiiiiii", None),
    ("PLD literal", "11111000t00111111111iiiiiiiiiiii", None),
    ("MRS APSR", "11110011111011111000dddd00000000", None),
    ("MSR APSR", "111100111000nnnn1000tt0000000000", lambda f: f["t"]),
    ("NOP.W", "11110011101011111000000000000000", None),
    ("DMB", "1111001110111111100011110101iiii", None),
    ("DSB", "1111001110111111100011110100iiii", None),
    ("ISB", "1111001110111111100011110110iiii", None),
    ("CLREX", "11110011101111111000111100101111", None),
]
for _bits, _name in {"0000": "B", "0010": "H", "0100": "W"}.items():
    WIDE += [
        (f"STR{_name} imm12", f"11111000{int(_bits, 2) + 8:04b}BBBBdddd0iiiiiiiiiii", None),
        (f"STR{_name} neg", f"11111000{_bits}BBBBdddd1100iiiiiiii", None),
        (f"STR{_name} reg", f"11111000{_bits}BBBBdddd000000iiXXXX", None),
    ]
for _signed, _bits, _name in [
    (0, 0b0001, "B"),
    (0, 0b0011, "H"),
    (0, 0b0101, "W"),
    (1, 0b0001, "SB"),
    (1, 0b0011, "SH"),
]:
    _head = f"1111100{_signed}"
    WIDE += [
        (f"LDR{_name} imm12", f"{_head}{_bits + 8:04b}BBBBdddd0iiiiiiiiiii", None),
        (f"LDR{_name} neg", f"{_head}{_bits:04b}BBBBdddd1100iiiiiiii", None),
        (f"LDR{_name} reg", f"{_head}{_bits:04b}BBBBdddd000000iiXXXX", None),
        (f"LDR{_name} literal", f"{_head}t{_bits & 7:03b}1111dddd000000iiiiii", None),
    ]

_FREE = 0b0101_0011_0011_1111


def _list_is_free(f):
    return not f["i"] & ~_FREE and bin(f["i"]).count("1") >= 2


def _list_stores(f):
    return not f["i"] & 0xA400 and bin(f["i"]).count("1") >= 2


# The base is register 10, which generate.py restores afterwards.
WIDE_MOVING = [
    ("LDMIA", "1110100010t11010iiiiiiiiiiiiiiii", _list_is_free),
    ("LDMDB", "1110100100t11010iiiiiiiiiiiiiiii", _list_is_free),
    ("STMIA", "1110100010t01010iiiiiiiiiiiiiiii", _list_stores),
    ("STMDB", "1110100100t01010iiiiiiiiiiiiiiii", _list_stores),
    ("POP.W", "1110100010111101iiiiiiiiiiiiiiii", _list_is_free),
    ("PUSH.W", "1110100100101101iiiiiiiiiiiiiiii", _list_stores),
    ("LDRD pre", "11101001t1111010llllhhhhiiiiiiii", different("l", "h")),
    ("LDRD post", "11101000t1111010llllhhhhiiiiiiii", different("l", "h")),
    ("STRD pre", "11101001t1101010llllhhhhiiiiiiii", None),
    ("STRD post", "11101000t1101010llllhhhhiiiiiiii", None),
    ("STRB write", "1111100000001010dddd1tt1iiiiiiii", None),
    ("STRH write", "1111100000101010dddd1tt1iiiiiiii", None),
    ("STR write", "1111100001001010dddd1tt1iiiiiiii", None),
    ("LDRB write", "1111100000011010dddd1tt1iiiiiiii", None),
    ("LDRH write", "1111100000111010dddd1tt1iiiiiiii", None),
    ("LDR write", "1111100001011010dddd1tt1iiiiiiii", None),
    ("LDRSB write", "1111100100011010dddd1tt1iiiiiiii", None),
    ("LDRSH write", "1111100100111010dddd1tt1iiiiiiii", None),
]

FLOAT = [
    ("VMLA", "111011100g00kkkkffff1010k0q0jjjj", None),
    ("VMLS", "111011100g00kkkkffff1010k1q0jjjj", None),
    ("VNMLS", "111011100g01kkkkffff1010k0q0jjjj", None),
    ("VNMLA", "111011100g01kkkkffff1010k1q0jjjj", None),
    ("VMUL", "111011100g10kkkkffff1010k0q0jjjj", None),
    ("VNMUL", "111011100g10kkkkffff1010k1q0jjjj", None),
    ("VADD", "111011100g11kkkkffff1010k0q0jjjj", None),
    ("VSUB", "111011100g11kkkkffff1010k1q0jjjj", None),
    ("VDIV", "111011101g00kkkkffff1010k0q0jjjj", None),
    ("VFNMS", "111011101g01kkkkffff1010k0q0jjjj", None),
    ("VFNMA", "111011101g01kkkkffff1010k1q0jjjj", None),
    ("VFMA", "111011101g10kkkkffff1010k0q0jjjj", None),
    ("VFMS", "111011101g10kkkkffff1010k1q0jjjj", None),
    ("VMOV imm", "111011101g11kkkkffff10100000jjjj", None),
    ("VMOV", "111011101g110000ffff101001q0jjjj", None),
    ("VABS", "111011101g110000ffff101011q0jjjj", None),
    ("VNEG", "111011101g110001ffff101001q0jjjj", None),
    ("VSQRT", "111011101g110001ffff101011q0jjjj", None),
    ("VCVTB from half", "111011101g110010ffff101001q0jjjj", None),
    ("VCVTT from half", "111011101g110010ffff101011q0jjjj", None),
    ("VCVTB to half", "111011101g110011ffff101001q0jjjj", None),
    ("VCVTT to half", "111011101g110011ffff101011q0jjjj", None),
    ("VCMP", "111011101g110100ffff101001q0jjjj", None),
    ("VCMPE", "111011101g110100ffff101011q0jjjj", None),
    ("VCMP zero", "111011101g110101ffff101001000000", None),
    ("VCMPE zero", "111011101g110101ffff101011000000", None),
    ("VCVT from int", "111011101g111000ffff1010k1q0jjjj", None),
    ("VCVTR to unsigned", "111011101g111100ffff101001q0jjjj", None),
    ("VCVTR to signed", "111011101g111101ffff101001q0jjjj", None),
    ("VCVT to unsigned", "111011101g111100ffff101011q0jjjj", None),
    ("VCVT to signed", "111011101g111101ffff101011q0jjjj", None),
    ("VCVT to fixed 32", "111011101g11111kffff101011q0jjjj", None),
    ("VCVT to fixed 16", "111011101g11111kffff101001q00jjj", None),
    ("VMOV to core", "111011100001kkkkdddd1010k0010000", None),
    ("VMOV from core", "111011100000kkkkdddd1010k0010000", None),
    ("VMOV scalar to core", "1110111000t1kkkkdddd101100010000", None),
    ("VMOV scalar from core", "1110111000t0kkkkdddd101100010000", None),
    ("VMOV two to core", "111011000101hhhhllll101000g1jjjj", different("l", "h")),
    ("VMOV two from core", "111011000100hhhhllll101000g1jjjj", None),
    ("VMOV double to core", "111011000101hhhhllll10110001jjjj", different("l", "h")),
    ("VMOV double from core", "111011000100hhhhllll10110001jjjj", None),
    ("VMRS flags", "11101110111100011111101000010000", None),
    ("VMRS", "1110111011110001dddd101000010000", None),
    ("VLDR", "11101101tg01BBBBffff1010iiiiiiii", None),
    ("VSTR", "11101101tg00BBBBffff1010iiiiiiii", None),
    ("VLDR double", "11101101t001BBBBffff1011iiiiiiii", None),
    ("VSTR double", "11101101t000BBBBffff1011iiiiiiii", None),
    ("VLDR literal", "1110110110011111ffff1010000000ii", None),
]


# These conversions round to nearest (A7.7.229). Unicorn rounds according to FPSCR, so they run only with RMode 0.
TO_NEAREST = [
    ("VCVT from fixed 32", "111011101g11101kffff101011q0jjjj", None),
    ("VCVT from fixed 16", "111011101g11101kffff101001q00jjj", None),
]


def _float_pair(f):
    """Two singles, of which the second exists, to or from two different registers."""
    return not (f["j"] == 15 and f["g"]) and f["h"] != f["l"]


FLOAT = [
    (name, pattern, _float_pair if name.startswith("VMOV two") else accept)
    for name, pattern, accept in FLOAT
]


def _singles(f):
    return 1 <= f["i"] <= 16 and 2 * f["f"] + f["g"] + f["i"] <= 32


def _doubles(f):
    return f["i"] % 2 == 0 and 2 <= f["i"] <= 16 and f["f"] + f["i"] // 2 <= 16


FLOAT_MOVING = [
    ("VLDMIA", "111011001g111010ffff1010iiiiiiii", _singles),
    ("VLDMDB", "111011010g111010ffff1010iiiiiiii", _singles),
    ("VSTMIA", "111011001g101010ffff1010iiiiiiii", _singles),
    ("VSTMDB", "111011010g101010ffff1010iiiiiiii", _singles),
    ("VPUSH", "111011010g101101ffff1010iiiiiiii", _singles),
    ("VPOP", "111011001g111101ffff1010iiiiiiii", _singles),
    ("VLDMIA double", "1110110010111010ffff1011iiiiiiii", _doubles),
    ("VSTMDB double", "1110110100101010ffff1011iiiiiiii", _doubles),
]
