//! Faults: status registers, escalation, lock-up.

use super::*;

const BUS: u16 = 5;
const USAGE: u16 = 6;
const HARD: u16 = 3;
const MEMORY: u16 = 4;

/// A machine with all three configurable faults enabled.
fn enabled(program: &[u16]) -> Machine {
    let mut machine = Machine::new(program);
    machine.set_private(SHCSR, 7 << 16);
    machine
}

/// Program counter in the frame of a handler.
fn stacked_pc(machine: &mut Machine) -> u32 {
    let sp = machine.r(13);
    machine.chip.word(sp + 24)
}

/// Sets up a region of 32 bytes without access in the MPU.
fn guard(machine: &mut Machine, base: u32) {
    machine.set_private(0xe000_ed9c, base | 0x10);
    machine.set_private(0xe000_eda0, 1 << 28 | 4 << 1 | 1);
    machine.set_private(0xe000_ed94, 5);
}

#[test]
fn usage_fault_status_shows_the_reason() {
    let programs: [(&[u16], u32); 6] = [
        // udf
        (&[0xde00], 1 << 16),
        // vadd.f32 s0, s0, s0 with the floating-point unit off
        (&[0xee30, 0x0a00], 1 << 19),
        // mrc p15, 0, r0, c0, c0, 0
        (&[0xee10, 0x0f10], 1 << 19),
        // ldm r0, {r1, r2}; in this program and the next two, r0 is not a multiple of 4
        (&[0xe890, 0x0006], 1 << 24),
        // ldrd r1, r2, [r0]
        (&[0xe9d0, 0x1200], 1 << 24),
        // ldrex r1, [r0]
        (&[0xe850, 0x1f00], 1 << 24),
    ];
    for (program, bit) in programs {
        let mut machine = enabled(program).register(0, LOG + 2);
        machine.ends_in(USAGE, &[(CFSR, bit)]);
        assert_eq!(stacked_pc(&mut machine), CODE);
        // Bits are cleared by writing ones.
        machine.set_private(CFSR, bit);
        assert_eq!(machine.private(CFSR), 0);
    }
}

#[test]
fn unaligned_access_and_division_by_zero_trap_only_if_enabled() {
    // ldr r1, [r0] unaligned; udiv r1, r0, r2 by zero.
    let programs: [(&[u16], u32, u32); 2] = [
        (&[0x6801, 0xbe00], 1 << 3, 1 << 24),
        (&[0xfbb0, 0xf1f2, 0xbe00], 1 << 4, 1 << 25),
    ];
    for (program, control, bit) in programs {
        let mut machine = enabled(program).registers(&[(0, LOG + 1), (2, 0)]);
        assert_eq!(machine.run_to_breakpoint(), 0);
        let mut machine = enabled(program).registers(&[(0, LOG + 1), (2, 0)]);
        machine.set_private(CCR, 1 << 9 | control);
        machine.ends_in(USAGE, &[(CFSR, bit)]);
    }
}

#[test]
fn jump_to_an_even_address_is_an_invalid_state_fault() {
    let mut machine = enabled(&[0x4700]).register(0, CODE + 0x40);
    machine.ends_in(USAGE, &[(CFSR, 1 << 17)]);
    assert_eq!(stacked_pc(&mut machine), CODE + 0x40);
}

#[test]
fn bus_fault_reports_the_address_and_changes_no_register() {
    // ldr r1, [r0], #4; str r1, [r0, #4]!; ldm r0!, {r1, r2}; pop {r1, r2}
    let programs: [&[u16]; 4] = [&[0xf850, 0x1b04], &[0xf840, 0x1f04], &[0xc806], &[0xbc06]];
    for program in programs {
        let mut machine = enabled(program).registers(&[(0, 0x6000_0000), (1, 11), (2, 12)]);
        if program[0] == 0xbc06 {
            // The first word is readable, the second is beyond the end of RAM.
            machine.core.set_register(13, 0x2000_fffc);
        }
        machine.ends_in(BUS, &[(CFSR, 1 << 9 | 1 << 15)]);
        let address = match program[0] {
            0xbc06 => 0x2001_0000,
            0xf840 => 0x6000_0004,
            _ => 0x6000_0000,
        };
        assert_eq!(machine.private(BFAR), address);
        assert_eq!(machine.r(0), 0x6000_0000);
        assert_eq!((machine.r(1), machine.r(2)), (11, 12));
        assert_eq!(stacked_pc(&mut machine), CODE);
    }
}

#[test]
fn disabled_fault_escalates_to_a_hard_fault_and_is_a_finding() {
    let mut machine = Machine::new(&[0x6801]).register(0, 0x6000_0000);
    machine.ends_in(HARD, &[(HFSR, 1 << 30), (CFSR, 1 << 9 | 1 << 15)]);
    assert!(machine.chip.found(FindingKind::Fault));
}

#[test]
fn fault_in_a_handler_of_equal_priority_escalates() {
    let mut machine = enabled(&[0xde00]);
    machine.chip.program(HANDLERS + 64 * 6, &[0xde00]);
    machine.ends_in(HARD, &[(HFSR, 1 << 30)]);
    assert_eq!(stacked_pc(&mut machine), HANDLERS + 64 * 6);
}

#[test]
fn masked_supervisor_call_escalates_to_a_hard_fault() {
    // cpsid i; svc
    let mut machine = Machine::new(&[0xb672, 0xdf00]);
    machine.ends_in(HARD, &[(HFSR, 1 << 30)]);
}

#[test]
fn fault_in_the_hard_fault_handler_locks_up_until_reset() {
    let mut machine = Machine::new(&[0xde00]);
    machine.chip.program(HANDLERS + 64 * 3, &[0xde00]);
    assert_eq!(machine.run(), Stop::LockUp);
    let mut notes = machine.chip.notes.iter();
    assert!(notes.any(|(_, text)| text.contains("lock-up")));
    let before = machine.core.instructions();
    assert_eq!(machine.run(), Stop::Until, "time passes");
    assert_eq!(machine.core.instructions(), before);
    machine.chip.program(CODE, &[0xbe00]);
    machine.core.reset(&mut machine.chip);
    assert_eq!(machine.run_to_breakpoint(), 0);
}

#[test]
fn invalid_stack_causes_a_stacking_fault() {
    let mut machine = enabled(&[0xdf00]);
    // The priority of the supervisor call is lower than that of the bus fault.
    machine.set_private(0xe000_ed1c, 0x8000_0000);
    machine.core.set_register(13, 0x2000_0010);
    let stop = machine.run();
    // The bus fault's handler is entered although its frame cannot be stored either.
    assert!(matches!(stop, Stop::Breakpoint(_)), "{stop:?}");
    assert_eq!(machine.core.exception(), BUS);
    assert_eq!(machine.private(CFSR), 1 << 12);
}

/// "Secondary bus faults do not escalate because a pre-empting fault of the same type cannot pre-empt
/// itself [...] the fault handler still executes even though the stack pushes for the handler failed"
/// (DDI 0337E, 5.12.1).
#[test]
fn fault_handler_is_entered_although_its_frame_cannot_be_stacked() {
    // str r1, [r0] to an unmapped address, with the stack at an unmapped address.
    let mut machine = enabled(&[0x6001]).register(0, 0x6000_0000);
    machine.core.set_register(13, 0x2000_0010);
    assert_eq!(machine.run_to_breakpoint(), BUS);
    // PRECISERR with BFARVALID, and STKERR.
    assert_eq!(machine.private(CFSR), 1 << 9 | 1 << 15 | 1 << 12);
    assert_eq!(machine.private(BFAR), 0x6000_0000);
    assert_eq!(machine.private(HFSR), 0);
    // The stack pointer is at the start of the frame that could not be stored.
    assert_eq!(machine.r(13), 0x2000_0010u32.wrapping_sub(32));
    // With the MPU, both the store and the frame violate the guard region.
    let mut machine = enabled(&[0x6001]).register(0, LOG + 0x104);
    machine.core.set_register(13, LOG + 0x120);
    guard(&mut machine, LOG + 0x100);
    assert_eq!(machine.run_to_breakpoint(), MEMORY);
    // DACCVIOL with MMARVALID, and MSTKERR.
    assert_eq!(machine.private(CFSR), 1 << 1 | 1 << 7 | 1 << 4);
    assert_eq!(machine.private(MMFAR), LOG + 0x104);
    assert_eq!(machine.private(HFSR), 0);
    // Neither bus nor memory fault is enabled: a single hard fault reports both.
    let mut machine = Machine::new(&[0x6001]).register(0, 0x6000_0000);
    machine.core.set_register(13, 0x2000_0010);
    machine.ends_in(HARD, &[(CFSR, 1 << 9 | 1 << 15 | 1 << 12), (HFSR, 1 << 30)]);
    // A fault of another kind whose priority equals that of the stacking fault becomes a hard fault.
    let mut machine = enabled(&[0xde00]);
    machine.core.set_register(13, 0x2000_0010);
    machine.ends_in(HARD, &[(CFSR, 1 << 16 | 1 << 12), (HFSR, 1 << 30)]);
}

#[test]
fn invalid_exception_return_value_is_a_usage_fault() {
    // The handler returns to handler mode, but no other exception is active.
    for value in [0xffff_fff1u32, 0xffff_fff5, 0xffff_fff0] {
        let mut machine = enabled(&[0xdf00]).register(0, value);
        // bx r0
        machine.chip.program(HANDLERS + 64 * 11, &[0x4700]);
        machine.ends_in(USAGE, &[(CFSR, 1 << 18)]);
        assert_eq!(machine.r(14), value);
    }
}

#[test]
fn frame_with_a_wrong_exception_number_is_a_usage_fault() {
    // The handler writes 11 into the stacked IPSR: str r0, [sp, #28]; bx lr
    let mut machine = enabled(&[0xdf00]).register(0, 0x0100_000b);
    machine.chip.program(HANDLERS + 64 * 11, &[0x9007, 0x4770]);
    machine.ends_in(USAGE, &[(CFSR, 1 << 18)]);
}

#[test]
fn fetch_from_peripherals_or_unmapped_addresses_faults() {
    // bx r0 to a peripheral: forbidden by the default map. bx r0 to an unmapped address: bus fault.
    for (target, exception, bit) in [(0x4000_0001u32, MEMORY, 1), (0x1fff_0001, BUS, 1 << 8)] {
        let mut machine = enabled(&[0x4700]).register(0, target);
        machine.ends_in(exception, &[(CFSR, bit)]);
        assert_eq!(stacked_pc(&mut machine), target & !1);
    }
}

#[test]
fn breakpoint_without_debugger_is_a_hard_fault() {
    let mut machine = Machine::new(&[0xbe00]);
    machine.core.attach_debugger(false);
    machine.chip.program(HANDLERS + 64 * 3, &[0xe7fe]);
    assert_eq!(machine.run(), Stop::Until);
    assert_eq!(machine.core.exception(), HARD);
    assert_eq!(machine.private(HFSR), 1 << 31);
}

#[test]
fn unpredictable_instruction_is_a_finding() {
    // ldrd r0, r0, [r1]
    let mut machine = Machine::new(&[0xe9d1, 0x0000]).register(1, LOG);
    assert_eq!(machine.run_to_breakpoint(), HARD);
    assert!(machine.chip.found(FindingKind::NotModelled));
}

#[test]
fn mpu_guard_region_stops_a_store_and_a_frame() {
    // str r0, [r1]
    let mut machine = enabled(&[0x6008]).register(1, LOG + 0x104);
    guard(&mut machine, LOG + 0x100);
    machine.ends_in(MEMORY, &[(CFSR, 1 << 1 | 1 << 7), (MMFAR, LOG + 0x104)]);
    // The frame extends into the guard region. The supervisor call has lower priority than the fault.
    let mut machine = enabled(&[0xdf00]);
    machine.set_private(0xe000_ed1c, 0x8000_0000);
    machine.core.set_register(13, LOG + 0x128);
    guard(&mut machine, LOG + 0x100);
    machine.ends_in(MEMORY, &[(CFSR, 1 << 4)]);
    // The words next to the guard region are accessible.
    let mut machine =
        enabled(&[0x6008, 0x6010, 0xbe00]).registers(&[(1, LOG + 0xfc), (2, LOG + 0x120)]);
    guard(&mut machine, LOG + 0x100);
    assert_eq!(machine.run_to_breakpoint(), 0);
}

#[test]
fn unprivileged_code_cannot_access_private_peripherals_or_masks() {
    // msr control, r0; isb; cpsid i; mrs r2, primask; ldr r3, [r1]
    let mut machine = enabled(&[
        0xf380, 0x8814, 0xf3bf, 0x8f6f, 0xb672, 0xf3ef, 0x8210, 0x680b,
    ])
    .registers(&[(0, 1), (1, CFSR), (2, 9)]);
    assert_eq!(machine.run_to_breakpoint(), BUS);
    assert_eq!(machine.r(2), 0);
    assert!(!machine.core.primask);
    assert_eq!(machine.private(BFAR), CFSR);
}

#[test]
fn bus_errors_can_be_ignored_in_fault_handlers() {
    let mut machine = Machine::new(&[0xde00]).register(0, 0x6000_0000);
    machine.set_private(CCR, 1 << 9 | 1 << 8);
    // ldr r1, [r0]; bkpt
    machine.chip.program(HANDLERS + 64 * 3, &[0x6801, 0xbe00]);
    assert_eq!(machine.run_to_breakpoint(), HARD);
    assert_eq!(machine.core.pc(), HANDLERS + 64 * 3 + 2);
}
