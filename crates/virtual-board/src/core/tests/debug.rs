//! Breakpoints, watchpoints, steps, profile.

use super::*;

#[test]
fn breakpoint_stops_before_its_instruction_and_is_passed_once() {
    // adds r0, #1; b back
    let mut machine = Machine::new(&[0x3001, 0xe7fd]).register(0, 0);
    machine.core.add_breakpoint(CODE);
    for round in 0..5 {
        assert_eq!(machine.run(), Stop::Breakpoint(CODE));
        assert_eq!(machine.r(0), round);
    }
    assert!(machine.core.remove_breakpoint(CODE));
    assert!(!machine.core.remove_breakpoint(CODE));
    assert_eq!(machine.run(), Stop::Until);
}

#[test]
fn each_step_executes_one_instruction() {
    // it eq; moveq r0, #1; movs r1, #2; svc
    let mut machine = Machine::new(&[0xbf08, 0x2001, 0x2102, 0xdf00]);
    let mut places = vec![];
    for _ in 0..4 {
        let until = machine.core.cycles() + MAX_CYCLES;
        assert_eq!(machine.core.step(&mut machine.chip, until), Stop::Step);
        places.push(machine.core.pc());
    }
    let handler = HANDLERS + 64 * 11;
    assert_eq!(places, [CODE + 2, CODE + 4, CODE + 6, handler]);
    assert_eq!(machine.core.instructions(), 4);
}

#[test]
fn watchpoint_stops_after_the_access() {
    // str r0, [r1]; ldr r2, [r1]; bkpt
    let program = [0x6008, 0x680a, 0xbe00];
    let mut machine = Machine::new(&program).register(1, LOG);
    let address = LOG + 1;
    machine.core.add_watchpoint(address, 1);
    for (write, pc) in [(true, CODE), (false, CODE + 2)] {
        let stop = machine.run();
        assert_eq!(stop, Stop::Watchpoint { address, pc, write });
        assert_eq!(machine.core.pc(), pc + 2);
    }
    machine.run_to_breakpoint();
}

#[test]
fn profile_adds_up_to_the_cycles_of_the_run() {
    let call = [
        0x6011, // str r1, [r2]
        0x2332, // movs r3, #50
        0x3b01, // 1: subs r3, #1
        0xd1fd, // bne 1b
        0x4770, // bx lr
    ];
    let first = [
        0x2314, // movs r3, #20
        0x3b01, // 1: subs r3, #1
        0xd1fd, // bne 1b
        0x4770, // bx lr
    ];
    let mut machine = Machine::new(&[
        0x2064, // movs r0, #100
        0x3801, // 1: subs r0, #1
        0xd1fd, // bne 1b
        0xdf00, // svc #0
        0xbe00, // bkpt
    ])
    .handler(11, &call)
    .handler(16, &first)
    .registers(&[(1, 1), (2, ISPR0)]);
    machine.set_private(ISER0, 1);
    // The priority of the supervisor call is lower than that of the interrupt line.
    machine.set_private(0xe000_ed1c, 0x8000_0000);
    machine.core.set_profiling(true);
    let begin = machine.core.cycles();
    machine.run_to_breakpoint();
    let all = machine.core.cycles() - begin;
    let profile = machine.core.profile().cloned().expect("it is on");
    let by_pc: u64 = profile.instructions().map(|(_, cycles)| cycles).sum();
    // Cycles of exception entry and return belong to no instruction.
    let between = all - by_pc;
    assert!((40..=50).contains(&between), "{between}");
    let loops: u64 = profile
        .instructions()
        .filter(|&(pc, _)| (CODE + 2..CODE + 6).contains(&pc))
        .map(|(_, cycles)| cycles)
        .sum();
    assert_eq!(loops, 100 + 99 * 2 + 1);
    let (call, line) = (profile.exception(11), profile.exception(16));
    assert_eq!((call.count, line.count), (1, 1));
    assert_eq!(call.longest, call.longest_own + line.longest);
    assert!((12..=14).contains(&line.longest_latency), "{line:?}");
}
