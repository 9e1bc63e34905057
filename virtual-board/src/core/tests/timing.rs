//! Cycles against the tables of the Cortex-M4 Technical Reference Manual.

use super::*;

/// Cycles of a program up to its breakpoint, with memory that does not wait.
fn cycles(program: &[u16]) -> u64 {
    let mut code = program.to_vec();
    code.push(0xbe00);
    let mut machine = Machine::new(&code)
        .register(0, LOG)
        .register(1, LOG + 0x40)
        .register(2, 4)
        .register(3, 0xffff_ffff)
        .register(4, 3);
    machine.set_private(CPACR, 0x00f0_0000);
    machine.core.add_breakpoint(CODE + 2 * program.len() as u32);
    let begin = machine.core.cycles();
    machine.run_to_breakpoint();
    machine.core.cycles() - begin
}

#[test]
fn instructions_take_what_the_table_says() {
    let table: [(&str, &[u16], u64); 24] = [
        ("adds", &[0x3001], 1),
        ("mul", &[0xfb00, 0xf001], 1),
        ("mla", &[0xfb00, 0x1002], 1),
        ("umull", &[0xfba0, 0x5601], 1),
        ("udiv by more", &[0xfbb2, 0xf5f3], 2),
        ("udiv of 32 bits by 2", &[0xfbb3, 0xf5f4], 10),
        ("ldr", &[0x6805], 2),
        ("ldr ldr", &[0x6805, 0x684e], 3),
        ("ldr ldr ldr", &[0x6805, 0x684e, 0x6887], 4),
        ("ldr str", &[0x6805, 0x604d], 2),
        ("ldr, then by what it loaded", &[0x6809, 0x680d], 4),
        ("str", &[0x6005], 1),
        ("str str", &[0x6005, 0x6045], 2),
        ("str by register", &[0x5085], 2),
        ("add, then an address from it", &[0x1880, 0x6805], 4),
        ("ldm of 3", &[0xc8e0], 4),
        ("stm of 3", &[0xc0e0], 4),
        ("push of 4", &[0xb4f0], 5),
        ("ldrd", &[0xe9d0, 0x5600], 3),
        ("vadd", &[0xee30, 0x0a01], 1),
        ("vfma", &[0xeea0, 0x0a81], 3),
        ("vldr", &[0xed90, 0x0a00], 2),
        (
            "vadd, vadd of its result",
            &[0xee30, 0x0a20, 0xee70, 0x0a00],
            3,
        ),
        ("b over nothing", &[0xe7ff], 2),
    ];
    for (name, program, expected) in table {
        assert_eq!(cycles(program), expected, "{name}");
    }
}

#[test]
fn a_division_of_floats_runs_beside_integer_instructions() {
    // vdiv.f32 s0, s1, s2; 20 nops: nothing waits. Followed by vmov s3, s0: that waits.
    let mut alone = vec![0xee80, 0x0a81];
    alone.extend([0xbf00; 20]);
    assert_eq!(cycles(&alone), 21);
    assert_eq!(cycles(&[0xee80, 0x0a81, 0xeef0, 0x1a40]), 15);
}

#[test]
fn a_loop_takes_three_cycles_a_round() {
    // movs r5, #100; 1: subs r5, #1; bne 1b
    assert_eq!(cycles(&[0x2564, 0x3d01, 0xd1fd]), 1 + 100 + 99 * 2 + 1);
}

#[test]
fn exceptions_take_twelve_ten_and_six_cycles() {
    let mut machine = Machine::new(&[0xbf00, 0xbf00, 0xbf00, 0xbe00])
        .handler(16, &[0x4770])
        .handler(17, &[0x4770]);
    machine.set_private(ISER0, 3);
    for (pended, expected) in [(1, 3 + 12 + 1 + 10), (3, 3 + 12 + 1 + 6 + 1 + 10)] {
        machine.core.set_register(15, CODE);
        machine.set_private(ISPR0, pended);
        let begin = machine.core.cycles();
        assert_eq!(machine.run_to_breakpoint(), 0);
        // BKPT itself takes one.
        assert_eq!(machine.core.cycles() - begin, expected + 1);
    }
}

#[test]
fn the_cycle_counter_counts_and_stands_in_sleep() {
    // ldr r1, [r0]; nop x10; ldr r2, [r0]; wfi; ldr r3, [r0]; bkpt
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
