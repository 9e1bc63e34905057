//! Decoding of all encodings. Execution is tested by oracle/check_lockstep.sh.

use crate::core::decode16;
use crate::core::decode32;
use crate::core::instruction::Op;

#[test]
fn undefined_halfwords_are_those_of_the_manual() {
    let mut undefined = 0;
    for h in 0..0xe800u32 {
        let insn = decode16::decode(0x0800_0000, h);
        undefined += u32::from(insn.op == Op::Undefined);
        assert!(insn.op != Op::Empty && insn.size == 2);
    }
    // 0xde00 to 0xdeff (UDF), 0xb600 to 0xb65f, 0xb680 to 0xb6ff, 0xb700 to 0xb8ff and 0xba80 to 0xbabf are undefined.
    assert_eq!(undefined, 256 + 0x60 + 0x80 + 0x200 + 0x40);
}

#[test]
fn every_32_bit_pattern_decodes() {
    let mut state = 1u64;
    for _ in 0..2_000_000 {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        let word = (state >> 32) as u32;
        let (h, g) = (0xe800 | word >> 16 & 0x1fff, word & 0xffff);
        if h >> 11 < 0b11101 {
            continue;
        }
        let insn = decode32::decode(0x0800_0000, h, g);
        assert!(insn.op != Op::Empty && insn.size == 4);
    }
}
