//! Cycles compared with the tables of the Cortex-M4 Technical Reference Manual.

use super::*;

/// Cycles of a program up to its breakpoint, with memory without wait states.
fn cycles(program: &[u16]) -> u64 {
    let mut code = program.to_vec();
    code.push(0xbe00);
    let behind = CODE + 2 * program.len() as u32;
    let mut machine = Machine::new(&code)
        .registers(&[(0, LOG), (1, LOG + 0x40), (2, 4)])
        .registers(&[(3, 0xffff_ffff), (4, 3), (6, behind | 1)]);
    machine.chip.set_word(LOG, behind | 1);
    machine.chip.set_word(LOG + 4, behind | 1);
    machine.set_private(CPACR, 0x00f0_0000);
    machine.core.add_breakpoint(behind);
    let begin = machine.core.cycles();
    machine.run_to_breakpoint();
    machine.core.cycles() - begin
}

/// The manual gives ranges: refills 1 to 3 cycles, divisions 2 to 12, changes of a mask 1 or 2.
#[test]
fn instructions_are_within_the_published_cycles() {
    type TimingRow = (&'static str, &'static [u16], std::ops::RangeInclusive<u64>);
    let table: [TimingRow; 41] = [
        ("adds", &[0x3001], 1..=1),
        ("mla", &[0xfb00, 0x1002], 1..=1),
        ("umull", &[0xfba0, 0x5601], 1..=1),
        ("udiv by more", &[0xfbb2, 0xf5f3], 2..=2),
        ("udiv of 32 bits by 2", &[0xfbb3, 0xf5f4], 10..=10),
        ("ldr", &[0x6805], 2..=2),
        ("ldr ldr", &[0x6805, 0x684e], 3..=3),
        ("ldr ldr ldr", &[0x6805, 0x684e, 0x6887], 4..=4),
        ("ldr str", &[0x6805, 0x604d], 2..=2),
        ("ldr, then by what it loaded", &[0x6809, 0x680d], 4..=4),
        ("str", &[0x6005], 1..=1),
        ("str str", &[0x6005, 0x6045], 2..=2),
        ("str by register", &[0x5085], 2..=2),
        ("add, then an address from it", &[0x1880, 0x6805], 4..=4),
        ("ldm of 3", &[0xc8e0], 4..=4),
        ("ldrd", &[0xe9d0, 0x5600], 3..=3),
        ("vadd", &[0xee30, 0x0a01], 1..=1),
        ("vfma", &[0xeea0, 0x0a81], 3..=3),
        ("vldr", &[0xed90, 0x0a00], 2..=2),
        (
            "vadd, vadd of its result",
            &[0xee30, 0x0a20, 0xee70, 0x0a00],
            3..=3,
        ),
        ("b over nothing", &[0xe7ff], 2..=2),
        ("MOV to the program counter", &[0x46b7], 2..=4),
        ("B taken", &[0x4280, 0xd0ff], 3..=5),
        ("B not taken", &[0x4280, 0xd1ff], 2..=2),
        ("BL", &[0xf000, 0xf800], 2..=4),
        ("BX", &[0x4730], 2..=4),
        ("CBZ taken", &[0xb105, 0xbf00], 2..=4),
        ("CBZ not taken", &[0xb104], 1..=1),
        ("TBB", &[0xe8df, 0xf005, 0x0001], 3..=5),
        ("LDR to the program counter", &[0xf8d0, 0xf000], 3..=5),
        (
            "LDM of 2 with the program counter",
            &[0xe890, 0x8020],
            4..=6,
        ),
        ("SDIV", &[0xfb93, 0xf5f4], 2..=12),
        ("MRS", &[0xf3ef, 0x8511], 1..=2),
        ("CPS", &[0xb661], 1..=2),
        ("SMLAD", &[0xfb22, 0x4503], 1..=1),
        ("USAD8", &[0xfb72, 0xf503], 1..=1),
        ("VCVT to an integer", &[0xeebd, 0x0ae0], 1..=1),
        ("VLDM of 4", &[0xec90, 0x0a04], 5..=5),
        ("VLDR of a double", &[0xed90, 0x0b00], 3..=3),
        ("VFNMA", &[0xee90, 0x0ac1], 3..=3),
        ("VMOV of two to the core", &[0xec56, 0x5a10], 2..=2),
    ];
    for (name, program, expected) in table {
        let took = cycles(program);
        assert!(expected.contains(&took), "{name}: {took}, {expected:?}");
    }
}

#[test]
fn square_root_takes_14_cycles() {
    // vsqrt.f32 s0, s1; vmov s3, s0
    assert_eq!(cycles(&[0xeeb1, 0x0ae0, 0xeef0, 0x1a40]), 14 + 1);
}

#[test]
fn fp_division_runs_in_parallel_with_integer_instructions() {
    // `vdiv.f32 s0, s1, s2` and 20 nops: no wait. `vdiv.f32` and `vmov s3, s0`: the move waits for the result.
    let mut alone = vec![0xee80, 0x0a81];
    alone.extend([0xbf00; 20]);
    assert_eq!(cycles(&alone), 21);
    assert_eq!(cycles(&[0xee80, 0x0a81, 0xeef0, 0x1a40]), 15);
}

#[test]
fn loop_of_two_instructions_takes_three_cycles_per_iteration() {
    // movs r5, #100; 1: subs r5, #1; bne 1b
    assert_eq!(cycles(&[0x2564, 0x3d01, 0xd1fd]), 1 + 100 + 99 * 2 + 1);
}

#[test]
fn exception_entry_return_and_tail_chain_take_12_10_and_6_cycles() {
    let mut machine = Machine::new(&[0xbf00, 0xbf00, 0xbf00, 0xbe00])
        .handler(16, &[0x4770])
        .handler(17, &[0x4770]);
    machine.set_private(ISER0, 3);
    for (pended, expected) in [(1, 3 + 12 + 1 + 10), (3, 3 + 12 + 1 + 6 + 1 + 10)] {
        machine.core.set_register(15, CODE);
        machine.set_private(ISPR0, pended);
        let begin = machine.core.cycles();
        assert_eq!(machine.run_to_breakpoint(), 0);
        // BKPT itself takes one cycle.
        assert_eq!(machine.core.cycles() - begin, expected + 1);
    }
}

#[test]
fn cycle_counter_stops_during_sleep() {
    // ldr r1, [r0]; nop x10; ldr r2, [r0]; cpsid i; wfi; ldr r3, [r0]; bkpt
    let mut program = vec![0x6801];
    program.extend([0xbf00; 10]);
    program.extend([0x6802, 0xb672, 0xbf30, 0x6803, 0xbe00]);
    let mut machine = Machine::new(&program).register(0, 0xe000_1004);
    machine.set_private(0xe000_edfc, 1 << 24);
    machine.set_private(0xe000_1000, 1);
    machine.set_private(ISER0, 1);
    let begin = machine.core.cycles();
    machine.chip.schedule = vec![(begin + 1000, 1)];
    machine.run_to_breakpoint();
    assert_eq!(machine.r(2) - machine.r(1), 12);
    assert!(machine.r(3) - machine.r(2) < 10);
    assert!(machine.core.asleep() > 900);
}
