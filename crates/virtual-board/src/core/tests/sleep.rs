//! WFI, WFE and wake-up conditions.

use super::*;
use crate::core::Sleep;

/// A machine with line 0 enabled; the line rises after 500 cycles and falls 10 cycles later.
fn rising(program: &[u16]) -> Machine {
    let mut machine = Machine::new(program).handler(16, &[0x2601, 0x4770]);
    machine.set_private(ISER0, 1);
    let begin = machine.core.cycles();
    machine.chip.schedule = vec![(begin + 500, 1), (begin + 510, 0)];
    machine
}

#[test]
fn wfi_sleeps_until_an_interrupt_is_taken() {
    let mut machine = rising(&[0xbf30, 0xbe00]).register(6, 0);
    machine.run_to_breakpoint();
    assert_eq!(machine.r(6), 1);
    let asleep = machine.core.asleep();
    assert!((490..=500).contains(&asleep), "{asleep}");
    assert_eq!(machine.core.taken(16), 1);
}

#[test]
fn wfi_wakes_on_an_interrupt_masked_by_primask_and_not_by_basepri() {
    // cpsid i; wfi; bkpt
    let mut machine = rising(&[0xb672, 0xbf30, 0xbe00]);
    machine.run_to_breakpoint();
    assert_eq!(machine.core.taken(16), 0);
    assert!(machine.core.asleep() > 400);
    // msr basepri, r0; wfi
    let mut machine = rising(&[0xf380, 0x8811, 0xbf30, 0xbe00]).register(0, 0x10);
    machine.set_private(IPR0, 0x20);
    assert_eq!(machine.run(), Stop::Until);
    assert_ne!(machine.core.sleep, Sleep::Awake);
}

#[test]
fn wfi_does_not_sleep_while_an_interrupt_is_pending() {
    let mut machine = Machine::new(&[0xb672, 0xbf30, 0xbe00]);
    machine.set_private(ISER0, 1);
    machine.set_private(ISPR0, 1);
    machine.run_to_breakpoint();
    assert!(machine.core.asleep() < 2);
}

#[test]
fn wfe_consumes_the_event_of_sev_and_of_exceptions() {
    // sev; wfe; wfe: the second WFE sleeps.
    let mut machine = Machine::new(&[0xbf40, 0xbf20, 0xbf20, 0xbe00]);
    assert_eq!(machine.run(), Stop::Until);
    assert_eq!(machine.core.pc(), CODE + 6);
    assert_ne!(machine.core.sleep, Sleep::Awake);
    // svc; wfe: exception entry and return set the event.
    let mut machine = Machine::new(&[0xdf00, 0xbf20, 0xbe00]).handler(11, &[0x4770]);
    machine.run_to_breakpoint();
}

#[test]
fn sevonpend_wakes_wfe_on_a_disabled_interrupt() {
    for (control, wakes) in [(0, false), (1 << 4, true)] {
        let mut machine = Machine::new(&[0xbf20, 0xbe00]);
        machine.set_private(SCR, control);
        let begin = machine.core.cycles();
        machine.chip.schedule = vec![(begin + 300, 8)];
        assert_eq!(machine.run() != Stop::Until, wakes);
    }
}

#[test]
fn sleep_on_exit_sleeps_again_after_the_handler() {
    let mut machine = rising(&[0xbf30, 0xbe00]).register(6, 0);
    machine.set_private(SCR, 2);
    assert_eq!(machine.run(), Stop::Until);
    assert_eq!(machine.r(6), 1);
    assert_ne!(machine.core.sleep, Sleep::Awake);
}

#[test]
fn deep_sleep_is_a_finding() {
    let mut machine = rising(&[0xbf30, 0xbe00]);
    machine.set_private(SCR, 4);
    machine.run_to_breakpoint();
    assert!(machine.chip.found(FindingKind::NotModelled));
}
