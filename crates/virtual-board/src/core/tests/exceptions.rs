//! Exceptions: frames, priorities, chaining, masks, floating-point context.

use super::*;

/// A handler that appends `word` to the log at r7 and returns.
fn logging(word: u16) -> Vec<u16> {
    vec![
        0x2600 | word, // movs r6, #word
        0xc740,        // stm r7!, {r6}
        0x4770,        // bx lr
    ]
}

/// Enables lines 0 to 31 and sets the priorities of lines 0 to 3.
fn enable(machine: &mut Machine, priorities: [u8; 4]) {
    machine.set_private(ISER0, u32::MAX);
    machine.set_private(IPR0, u32::from_le_bytes(priorities));
}

/// A handler that counts in r6 and stops at `last`.
fn counting(last: u16) -> [u16; 5] {
    [
        0x3601,        // adds r6, #1
        0x2e00 | last, // cmp r6, #last
        0xd100,        // bne 1f
        0xbe00,        // bkpt
        0x4770,        // 1: bx lr
    ]
}

#[test]
fn supervisor_call_stacks_the_frame_of_the_manual() {
    // svc #5; bkpt
    let mut machine = Machine::new(&[0xdf05, 0xbe00]);
    for number in 0..13 {
        machine.core.set_register(number, 0x1000 + number as u32);
    }
    machine.core.set_register(14, 0x1234_5679);
    // The stack pointer is misaligned by 4. The frame is aligned to 8, and bit 9 of the stacked xPSR records the shift.
    machine.core.set_register(13, STACK - 4);
    machine.core.set_xpsr(0xa000_0000 | 1 << 24);
    assert_eq!(machine.run_to_breakpoint(), 11);
    let frame = STACK - 0x28;
    assert_eq!(machine.r(13), frame);
    assert_eq!(machine.r(14), 0xffff_fff9);
    let words: Vec<u32> = (0..8).map(|k| machine.chip.word(frame + 4 * k)).collect();
    assert_eq!(words[..5], [0x1000, 0x1001, 0x1002, 0x1003, 0x100c]);
    assert_eq!(words[5..], [0x1234_5679, CODE + 2, 0xa100_0200]);
    assert_eq!(machine.core.xpsr() & 0x1ff, 11);
    // The return to thread mode restores stack pointer, link register, flags and program counter.
    machine.chip.program(HANDLERS + 64 * 11, &[0xbe00, 0x4770]);
    assert_eq!(machine.go_on(), 0);
    assert_eq!(machine.r(13), STACK - 4);
    assert_eq!(machine.r(14), 0x1234_5679);
    assert_eq!(machine.core.xpsr() & 0xf800_0000, 0xa000_0000);
    assert_eq!(machine.core.pc(), CODE + 2);
}

#[test]
fn process_stack_is_used_only_in_thread_mode() {
    let mut machine = Machine::new(&[
        0xf380, 0x8809, // msr psp, r0
        0xf381, 0x8814, // msr control, r1
        0xf3bf, 0x8f6f, // isb
        0xdf00, // svc #0
        0xbe00, // bkpt
    ])
    .registers(&[(0, 0x2000_1000), (1, 2)]);
    assert_eq!(machine.run_to_breakpoint(), 11);
    assert_eq!(machine.r(14), 0xffff_fffd);
    assert_eq!(machine.core.psp(), 0x2000_1000 - 0x20);
    assert_eq!(machine.r(13), STACK);
    machine.chip.program(HANDLERS + 64 * 11, &[0xbe00, 0x4770]);
    assert_eq!(machine.go_on(), 0);
    assert_eq!(machine.r(13), 0x2000_1000);
    assert_eq!(machine.core.msp(), STACK);
}

#[test]
fn interrupt_inside_an_it_block_returns_into_the_block() {
    let first = [
        0x9807, // ldr r0, [sp, #28]
        0x6038, // str r0, [r7]
        0x45bd, // cmp sp, r7
        0x4770, // bx lr
    ];
    // The store sets line 0 pending. After the handler, the IT block continues and skips its else instruction.
    let mut machine = Machine::new(&[
        0x4280, // cmp r0, r0
        0xbf03, // ittte eq
        0x6011, // streq r1, [r2]
        0x3301, // addeq r3, #1
        0x3302, // addeq r3, #2
        0x3308, // addne r3, #8
        0xbe00, // bkpt
    ])
    .handler(16, &first)
    .registers(&[(1, 1), (2, ISPR0), (3, 0), (7, LOG)]);
    enable(&mut machine, [0; 4]);
    assert_eq!(machine.run_to_breakpoint(), 0);
    assert_eq!(machine.r(3), 3);
    let psr = machine.chip.word(LOG);
    // ITSTATE: condition EQ, mask 0b0011 for T, T, E, shifted once by the first of the four instructions.
    let it = psr >> 25 & 3 | psr >> 8 & 0xfc;
    assert_eq!(it, 0b0000_0110, "{psr:#010x}");
    assert_eq!(machine.core.taken(16), 1);
    assert_eq!(machine.core.xpsr() & 0x0600_fc00, 0);
}

/// Order in which lines 0 to 2 log with these priorities; the handler of line 1 pends lines 0 and 2.
fn order_of_three(group: u32, priorities: [u8; 4]) -> Vec<u32> {
    let second = [
        0x2005, // movs r0, #5
        0x6010, // str r0, [r2]
        0x2602, // movs r6, #2
        0xc740, // stm r7!, {r6}
        0x4770, // bx lr
    ];
    // str r1, [r2]; bkpt
    let mut machine = Machine::new(&[0x6011, 0xbe00])
        .handler(16, &logging(1))
        .handler(18, &logging(3))
        .handler(17, &second)
        .registers(&[(1, 2), (2, ISPR0), (7, LOG)]);
    machine.set_private(AIRCR, 0x05fa_0000 | group << 8);
    enable(&mut machine, priorities);
    assert_eq!(machine.run_to_breakpoint(), 0);
    assert_eq!(machine.r(13), STACK);
    machine.chip.log().to_vec()
}

#[test]
fn higher_priority_preempts_and_the_others_tail_chain() {
    assert_eq!(order_of_three(0, [0x10, 0x20, 0x30, 0]), [1, 2, 3]);
}

#[test]
fn group_priority_decides_preemption_and_subpriority_the_order() {
    assert_eq!(order_of_three(3, [0x40, 0x50, 0x60, 0]), [1, 2, 3]);
    assert_eq!(order_of_three(6, [0x40, 0x50, 0x60, 0]), [2, 1, 3]);
}

#[test]
fn late_arrival_is_taken_first_on_the_same_frame() {
    // b .
    let program = [0xe7fe];
    let first = [
        0x2601, // movs r6, #1
        0xc740, // stm r7!, {r6}
        0x466d, // mov r5, sp
        0x4770, // bx lr
    ];
    let second = [
        0x2602, // movs r6, #2
        0xc740, // stm r7!, {r6}
        0x456d, // cmp r5, sp
        0xbe00, // bkpt
    ];
    let mut machine = Machine::new(&program)
        .handler(16, &first)
        .handler(17, &second)
        .register(7, LOG);
    enable(&mut machine, [0x10, 0x20, 0, 0]);
    let begin = machine.core.cycles();
    let lines = [(50, 2), (55, 3), (64, 2), (75, 0)];
    machine.chip.schedule = lines.map(|(at, lines)| (begin + at, lines)).into();
    assert_eq!(machine.run_to_breakpoint(), 17);
    assert_eq!(machine.chip.log(), [1, 2]);
    // The second exception is tail-chained: it uses the same stack frame.
    assert_eq!(machine.r(5), machine.r(13));
}

#[test]
fn line_that_stays_high_interrupts_again() {
    for (falls, times) in [(true, 1), (false, 3)] {
        // nop; b .
        let mut machine = Machine::new(&[0xbf00, 0xe7fe])
            .handler(16, &counting(0x03))
            .register(6, 0);
        enable(&mut machine, [0; 4]);
        let begin = machine.core.cycles();
        machine.chip.schedule = vec![(begin + 20, 1)];
        if falls {
            machine.chip.schedule.push((begin + 33, 0));
        }
        let stop = machine.run();
        assert_eq!(stop == Stop::Until, falls);
        assert_eq!(machine.core.taken(16), times);
    }
}

#[test]
fn masks_hold_back_interrupts_by_priority() {
    let pend = |machine: &mut Machine| machine.set_private(ISPR0, 1);
    // First instructions: cpsid i; cpsid f; msr basepri, r0 in three programs; msr basepri_max, r0. The line's priority
    // is 0x20. Each row is the program, r0, and true if the interrupt is taken.
    let programs: [(&[u16], u32, bool); 6] = [
        (&[0xb672, 0xbf00, 0xbf00, 0xbe00], 0, false),
        (&[0xb671, 0xbf00, 0xbf00, 0xbe00], 0, false),
        (&[0xf380, 0x8811, 0xbf00, 0xbe00], 0x20, false),
        (&[0xf380, 0x8811, 0xbf00, 0xbe00], 0x30, true),
        (&[0xf380, 0x8811, 0xbf00, 0xbe00], 0x0f, true),
        (&[0xf380, 0x8812, 0xbf00, 0xbe00], 0x10, false),
    ];
    for (k, (program, r0, taken)) in programs.into_iter().enumerate() {
        let mut machine = Machine::new(program).register(0, r0);
        enable(&mut machine, [0x20, 0, 0, 0]);
        machine.core.add_breakpoint(CODE + 4);
        assert_eq!(machine.run_to_breakpoint(), 0);
        pend(&mut machine);
        let exception = machine.run_to_breakpoint();
        assert_eq!(exception == 16, taken, "{k}");
    }
}

#[test]
fn basepri_max_only_raises() {
    // The program writes r0 to r3 to BASEPRI_MAX in turn and reads BASEPRI after each write.
    let mut machine = Machine::new(&[
        0xf380, 0x8812, // msr basepri_max, r0
        0xf3ef, 0x8411, // mrs r4, basepri
        0xf381, 0x8812, // msr basepri_max, r1
        0xf3ef, 0x8511, // mrs r5, basepri
        0xf382, 0x8812, // msr basepri_max, r2
        0xf3ef, 0x8611, // mrs r6, basepri
        0xf383, 0x8812, // msr basepri_max, r3
        0xf3ef, 0x8711, // mrs r7, basepri
        0xbe00, // bkpt
    ])
    .registers(&[(0, 0x40), (1, 0x80), (2, 0), (3, 0x20)]);
    machine.run_to_breakpoint();
    assert_eq!([4, 5, 6, 7].map(|k| machine.r(k)), [0x40, 0x40, 0x40, 0x20]);
}

#[test]
fn fp_registers_are_saved_at_the_handlers_first_fp_instruction() {
    let program = [
        0xeeb7, 0x0a00, // vmov.f32 s0, #1.0
        0xeef0, 0x7a00, // vmov.f32 s15, #2.0
        0x6011, // str r1, [r2]
        0xee30, 0x0a27, // vadd.f32 s0, s0, s15
        0xbe00, // bkpt
    ];
    let handler = [
        0xbe00, // bkpt
        0xeeb2, 0x0a00, // vmov.f32 s0, #8.0
        0xeeb1, 0x8a00, // vmov.f32 s16, #4.0
        0xbe00, // bkpt
        0x4770, // bx lr
    ];
    let mut machine = Machine::new(&program)
        .handler(16, &handler)
        .registers(&[(1, 1), (2, ISPR0)]);
    machine.set_private(CPACR, 0x00f0_0000);
    enable(&mut machine, [0; 4]);
    assert_eq!(machine.run_to_breakpoint(), 16);
    let frame = STACK - 0x68;
    assert_eq!(machine.r(13), frame);
    assert_eq!(machine.r(14), 0xffff_ffe9);
    assert_eq!(machine.private(FPCCR) & 1, 1);
    assert_eq!(machine.private(FPCAR), frame + 0x20);
    assert_eq!(machine.chip.word(frame + 0x20), 0, "nothing is written yet");
    assert_eq!(machine.go_on(), 16);
    assert_eq!(machine.private(FPCCR) & 1, 0);
    assert_eq!(machine.chip.word(frame + 0x20), 1.0f32.to_bits());
    assert_eq!(machine.chip.word(frame + 0x5c), 2.0f32.to_bits());
    assert_eq!(machine.go_on(), 0);
    assert_eq!(f32::from_bits(machine.core.single(0)), 3.0);
    assert_eq!(f32::from_bits(machine.core.single(16)), 4.0, "callee-saved");
    assert_eq!(machine.r(13), STACK);
}

#[test]
fn fp_registers_unused_by_the_handler_are_never_saved() {
    let mut machine = Machine::new(&[
        0xeeb7, 0x0a00, // vmov.f32 s0, #1.0
        0x6011, // str r1, [r2]
        0xeef0, 0x0a40, // vmov.f32 s1, s0
        0xbe00, // bkpt
    ])
    .handler(16, &[0x4770])
    .registers(&[(1, 1), (2, ISPR0)]);
    machine.set_private(CPACR, 0x00f0_0000);
    enable(&mut machine, [0; 4]);
    assert_eq!(machine.run_to_breakpoint(), 0);
    assert_eq!(machine.core.single(1), 1.0f32.to_bits());
    assert_eq!(machine.chip.word(STACK - 0x48), 0);
    assert_eq!(machine.private(FPCCR) & 1, 0);
}

#[test]
fn fp_registers_are_saved_at_once_without_lazy_saving() {
    // vmov.f32 s3, #1.0; str r1, [r2]; bkpt
    let mut machine =
        Machine::new(&[0xeef7, 0x1a00, 0x6011, 0xbe00]).registers(&[(1, 1), (2, ISPR0)]);
    machine.set_private(CPACR, 0x00f0_0000);
    machine.set_private(FPCCR, 1 << 31);
    enable(&mut machine, [0; 4]);
    assert_eq!(machine.run_to_breakpoint(), 16);
    assert_eq!(machine.chip.word(STACK - 0x48 + 12), 1.0f32.to_bits());
    assert_eq!(machine.private(FPCCR) & 1, 0);
}

#[test]
fn exclusive_store_fails_after_an_exception() {
    let program = [
        0xe853, 0x0f00, // ldrex r0, [r3]
        0x6011, // str r1, [r2]
        0xe843, 0x0400, // strex r4, r0, [r3]
        0xe853, 0x0f00, // ldrex r0, [r3]
        0xe843, 0x0500, // strex r5, r0, [r3]
        0xe843, 0x0600, // strex r6, r0, [r3]
        0xbe00, // bkpt
    ];
    let mut machine =
        Machine::new(&program)
            .handler(16, &[0x4770])
            .registers(&[(1, 1), (2, ISPR0), (3, LOG)]);
    enable(&mut machine, [0; 4]);
    machine.run_to_breakpoint();
    assert_eq!([4, 5, 6].map(|k| machine.r(k)), [1, 0, 1]);
}

#[test]
fn pending_bits_are_set_by_stir_and_icsr_and_can_be_cleared() {
    let mut machine = Machine::new(&[0xbf00, 0xbf00, 0xbf00, 0xbe00]);
    machine.set_private(0xe000_ef00, 5);
    assert_eq!(machine.private(ISPR0), 1 << 5);
    assert_eq!(machine.private(ICSR) >> 12 & 0x1ff, 0, "not enabled");
    machine.set_private(0xe000_e280, 1 << 5);
    assert_eq!(machine.private(ISPR0), 0);
    machine.set_private(ICSR, 1 << 28);
    assert_eq!(machine.private(ICSR) >> 12 & 0x1ff, 14);
    machine.set_private(ICSR, 1 << 27);
    assert_eq!(machine.private(ICSR), 0x800);
    assert_eq!(machine.run_to_breakpoint(), 0);
}

#[test]
fn vector_table_can_be_moved() {
    // svc #0; bkpt
    let mut machine = Machine::new(&[0xdf00, 0xbe00]);
    machine.set_private(VTOR, 0x2000_4000);
    machine.chip.set_word(0x2000_402c, (HANDLERS + 64 * 20) | 1);
    assert_eq!(machine.run_to_breakpoint(), 11);
    assert_eq!(machine.core.pc(), HANDLERS + 64 * 20);
}

#[test]
fn reset_request_needs_the_key() {
    for (value, resets) in [(0x0000_0004, 0), (0x05fa_0004, 1)] {
        // str r0, [r1]; b .
        let mut machine = Machine::new(&[0x6008, 0xe7fe]).registers(&[(0, value), (1, AIRCR)]);
        let stop = machine.run();
        assert_eq!(stop == Stop::Reset, resets == 1);
        assert_eq!(machine.chip.resets, resets);
    }
}

#[test]
fn reset_clears_the_core_and_keeps_its_counters() {
    let mut machine = Machine::new(&[0xb672, 0xbe00]).register(5, 7);
    machine.set_private(ISER0, 1);
    machine.run_to_breakpoint();
    let (cycles, instructions) = (machine.core.cycles(), machine.core.instructions());
    machine.core.reset(&mut machine.chip);
    assert_eq!(machine.core.pc(), CODE);
    assert_eq!(machine.r(13), STACK);
    assert!(!machine.core.primask);
    assert_eq!(machine.private(ISER0), 0);
    assert!(machine.core.cycles() >= cycles && cycles > 0);
    assert_eq!(machine.core.instructions(), instructions);
}

#[test]
fn systick_interrupts_every_period() {
    // b .
    let mut machine = Machine::new(&[0xe7fe])
        .handler(15, &counting(0x0a))
        .register(6, 0);
    machine.set_private(0xe000_e014, 999);
    machine.set_private(0xe000_e018, 0);
    machine.set_private(0xe000_e010, 7);
    let begin = machine.core.cycles();
    assert_eq!(machine.run_to_breakpoint(), 15);
    let cycles = machine.core.cycles() - begin;
    assert!((10_000..10_040).contains(&cycles), "{cycles}");
}

#[test]
fn lowest_main_stack_pointer_is_recorded() {
    let mut machine = Machine::new(&[
        0xb507, // push {r0, r1, r2, lr}
        0xb090, // sub sp, #0x40
        0x4669, // mov r1, sp
        0xf1a1, 0x0180, // sub.w r1, r1, #0x80
        0x468d, // mov sp, r1
        0xb034, // add sp, #0xd0
        0xdf00, // svc #0
        0xbe00, // bkpt
    ])
    .handler(11, &[0x4770]);
    machine.run_to_breakpoint();
    assert_eq!(machine.core.lowest_msp(), STACK - 0x10 - 0x40 - 0x80);
    assert_eq!(machine.private(SHPR3), 0);
}
