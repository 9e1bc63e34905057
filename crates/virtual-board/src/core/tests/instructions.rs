//! Decoding of everything, and instructions whose results are known otherwise.

use super::*;
use crate::core::decode16;
use crate::core::decode32;
use crate::core::instruction::Op;

#[test]
fn of_all_halfwords_those_are_undefined_that_the_manual_leaves_out() {
    let mut undefined = 0;
    for h in 0..0xe800u32 {
        let insn = decode16::decode(0x0800_0000, h);
        undefined += u32::from(insn.op == Op::Undefined);
        assert!(insn.op != Op::Empty && insn.size == 2);
    }
    // UDF 0xdexx, 0xb2xx to 0xbfxx: 0xb600 to 0xb65f, 0xb680 to 0xb6ff, 0xb700 to 0xb8ff, 0xba80 to
    // 0xbabf.
    assert_eq!(undefined, 256 + 0x60 + 0x80 + 0x200 + 0x40);
}

#[test]
fn every_wide_pattern_decodes_to_something() {
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

#[test]
fn division_multiplication_and_bit_fields_agree_with_wider_arithmetic() {
    // sdiv r2, r0, r1; udiv r3, r0, r1; smull r4, r5, r0, r1; umull r6, r7, r0, r1;
    // smmulr r8, r0, r1; ubfx r9, r0, #5, #9; sbfx r10, r0, #5, #9; ssat r11, #12, r0, asr #3; bkpt
    let program = [
        0xfb90, 0xf2f1, 0xfbb0, 0xf3f1, 0xfb80, 0x4501, 0xfba0, 0x6701, 0xfb50, 0xf811, 0xf3c0,
        0x1948, 0xf340, 0x1a48, 0xf320, 0x0bcb, 0xbe00,
    ];
    let numbers = [
        0,
        1,
        2,
        7,
        0x1234,
        0x7fff_ffff,
        0x8000_0000,
        0xffff_ffff,
        0xdead_beef,
    ];
    for a in numbers {
        for b in numbers {
            let mut machine = Machine::new(&program).registers(&[(0, a), (1, b)]);
            machine.run_to_breakpoint();
            let (x, y) = (i128::from(a as i32), i128::from(b as i32));
            assert_eq!(machine.r(2), if y == 0 { 0 } else { (x / y) as u32 });
            assert_eq!(machine.r(3), a.checked_div(b).unwrap_or(0));
            let long = |low, high| u64::from(machine.r(high)) << 32 | u64::from(machine.r(low));
            assert_eq!(long(4, 5) as i64 as i128, x * y);
            assert_eq!(u128::from(long(6, 7)), u128::from(a) * u128::from(b));
            assert_eq!(machine.r(8), ((x * y + (1 << 31)) >> 32) as u32);
            assert_eq!(machine.r(9), a / 32 % 512);
            let field = (a / 32 % 512) as i32;
            let signed = if field >= 256 { field - 512 } else { field };
            assert_eq!(machine.r(10) as i32, signed);
            assert_eq!(machine.r(11) as i32, ((a as i32) >> 3).clamp(-2048, 2047));
        }
    }
}

#[test]
fn conditions_hold_as_the_table_says() {
    // The condition of each: b<c> +2; movs r0, #1; bkpt
    for flags in 0..16u32 {
        let (n, z) = (flags & 8 != 0, flags & 4 != 0);
        let (c, v) = (flags & 2 != 0, flags & 1 != 0);
        // Each, then its inverse.
        let holds = [z, c, n, v, c && !z, n == v, !z && n == v];
        let table = holds.into_iter().flat_map(|holds| [holds, !holds]);
        for (condition, expected) in table.enumerate() {
            let branch = 0xd000 | (condition as u16) << 8;
            // In an IT block the other way round: executed if it holds.
            let it = 0xbf08 | (condition as u16) << 4;
            let mut machine =
                Machine::new(&[branch, 0x2001, it, 0x2101, 0xbe00]).registers(&[(0, 0), (1, 0)]);
            machine.core.set_xpsr(flags << 28 | 1 << 24);
            // movs changes N and Z, so the branch and the block are looked at apart.
            machine.core.add_breakpoint(CODE + 4);
            machine.run_to_breakpoint();
            assert_eq!(machine.r(0) == 0, expected, "{flags:04b} {condition}");
            machine.core.set_xpsr(flags << 28 | 1 << 24);
            machine.run_to_breakpoint();
            assert_eq!(machine.r(1) == 1, expected, "{flags:04b} {condition}");
            assert_eq!(machine.core.xpsr() >> 28, flags, "no flags in the block");
        }
    }
}

#[test]
fn tables_of_branches_and_calls_go_where_they_should() {
    let mut machine = Machine::new(&[
        0xe8df, 0xf000, // tbb [pc, r0]
        0x0302, // two offsets: 2 and 3 halfwords
        0xbe00, // bkpt
        0xbe01, // bkpt #1
        0xbe02, // bkpt #2
    ])
    .register(0, 1);
    machine.run_to_breakpoint();
    assert_eq!(machine.core.pc(), CODE + 4 + 6);
    let mut machine = Machine::new(&[
        0xf000, 0xf801, // bl 1f
        0xbe00, // bkpt
        0x4670, // 1: mov r0, lr
        0x4770, // bx lr
    ]);
    machine.run_to_breakpoint();
    assert_eq!((machine.core.pc(), machine.r(0)), (CODE + 4, CODE + 5));
}
