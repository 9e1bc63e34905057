use super::*;
use crate::chip::testing::shared;

/// Runs what is due until nothing is, or `until`.
fn pass(rcc: &mut Rcc, shared: &mut Shared, micros: u64) {
    let end = shared.after(Time::from_micros(micros));
    while shared.arrive(Unit::Rcc, end) {
        rcc.event(shared);
    }
}

fn start(rcc: &mut Rcc, shared: &mut Shared) {
    rcc.write(0x00, 0x0001_0081, !0, shared);
    assert_eq!(rcc.read(0x00, shared) & 1 << 17, 0, "not at once");
    pass(rcc, shared, 2_100);
    assert_ne!(rcc.read(0x00, shared) & 1 << 17, 0);
    // 8 MHz / 4 · 168 / 2.
    rcc.write(0x04, 0x2040_2a04 | 7 << 24, !0, shared);
    rcc.write(0x00, 0x0101_0081, !0, shared);
    rcc.write(0x08, 0x0000_9402, !0, shared);
    pass(rcc, shared, 200);
}

#[test]
fn clocks_beyond_their_limits_are_found() {
    let (mut rcc, mut shared) = (Rcc::default(), shared());
    start(&mut rcc, &mut shared);
    // APB1 at 84 MHz.
    rcc.write(0x08, 0x0000_9002, !0, &mut shared);
    assert_eq!(shared.kinds(), [Kind::ClockLimit]);
    let found = &shared.findings.list()[0];
    assert!(found.text.contains("PCLK1 84000000"), "{found:?}");
}

#[test]
fn without_clock_security_the_core_stands_still_until_the_crystal_swings_again() {
    let (mut rcc, mut shared) = (Rcc::default(), shared());
    start(&mut rcc, &mut shared);
    shared.effects.clear();
    rcc.crystal(false, &mut shared);
    assert!(rcc.is_held());
    assert!(shared.effects.iter().eq(&[Effect::Frequency(STALLED_HZ)]));
    pass(&mut rcc, &mut shared, 50_000);
    rcc.crystal(true, &mut shared);
    pass(&mut rcc, &mut shared, 1_900);
    assert!(rcc.is_held(), "2 ms to start");
    // Then 0.1 ms for the PLL.
    pass(&mut rcc, &mut shared, 300);
    assert!(!rcc.is_held());
    assert_eq!(shared.effects.back(), Some(&Effect::Frequency(168_000_000)));
}

#[test]
fn a_dead_crystal_is_never_ready() {
    for dead in [false, true] {
        let (mut rcc, mut shared) = (Rcc::default(), shared());
        rcc.crystal(!dead, &mut shared);
        rcc.write(0x00, 0x81 | HSEON, !0, &mut shared);
        pass(&mut rcc, &mut shared, 10_000);
        assert_eq!(rcc.read(0x00, &mut shared) >> 17 & 1 == 0, dead);
    }
}

#[test]
fn what_the_core_runs_on_cannot_be_switched_off() {
    let (mut rcc, mut shared) = (Rcc::default(), shared());
    start(&mut rcc, &mut shared);
    for off in [HSEON, PLLON] {
        let cr = rcc.read(0x00, &mut shared);
        rcc.write(0x00, cr & !off, !0, &mut shared);
        assert_eq!(rcc.read(0x00, &mut shared), cr);
    }
    let cr = rcc.read(0x00, &mut shared);
    rcc.write(0x00, cr & !HSION, !0, &mut shared);
    assert_eq!(rcc.read(0x00, &mut shared) & 3, 0, "neither on nor ready");
    let found = shared.findings.list();
    assert!(found.len() == 1 && found[0].count == 2, "{found:?}");
}

#[test]
fn ready_flags_come_where_their_interrupt_is_enabled() {
    let (mut rcc, mut shared) = (Rcc::default(), shared());
    rcc.write(0x0c, 1 << 12, !0, &mut shared);
    start(&mut rcc, &mut shared);
    assert_eq!(rcc.read(0x0c, &mut shared), 1 << 12 | 1 << 4);
    assert_eq!(shared.lines, 1 << Interrupt::Rcc as u32);
    rcc.write(0x0c, 1 << 12 | 1 << 20, !0, &mut shared);
    assert_eq!(shared.lines, 0);
}

#[test]
fn a_prescaler_of_a_bus_alone_is_told_too() {
    let (mut rcc, mut shared) = (Rcc::default(), shared());
    rcc.write(0x08, 4 << 10, !0, &mut shared);
    assert_eq!((shared.clocks.apb1, shared.clocks.timer1), (2, 1));
    assert!(shared.effects.iter().eq(&[Effect::Frequency(16_000_000)]));
}

#[test]
fn a_reset_bit_resets_at_its_edge() {
    let (mut rcc, mut shared) = (Rcc::default(), shared());
    rcc.write(0x20, 1 << 25, !0, &mut shared);
    rcc.write(0x20, 1 << 25 | 1, !0, &mut shared);
    let told = [
        Effect::ResetUnit {
            register: 0x40,
            bit: 25,
        },
        Effect::ResetUnit {
            register: 0x40,
            bit: 0,
        },
    ];
    assert!(shared.effects.iter().eq(&told));
    assert!(rcc.is_in_reset(0x40, 25) && !rcc.is_in_reset(0x40, 1));
}

#[test]
fn causes_add_up_until_they_are_cleared_or_the_power_fails() {
    let mut shared = shared();
    let mut rcc = Rcc::default();
    rcc.begin(Kept::default(), Cause::PowerOn, &mut shared);
    let mut after = |rcc: &mut Rcc, cause: Cause| {
        let kept = rcc.kept(cause);
        *rcc = Rcc::default();
        rcc.begin(kept, cause, &mut shared);
        rcc.read(CSR, &mut shared) >> 24
    };
    // Flags of RM0090, 7.3.21, over bit 24.
    assert_eq!(after(&mut rcc, Cause::Watchdog), 0x2e);
    assert_eq!(after(&mut rcc, Cause::Software), 0x3e);
    assert_eq!(after(&mut rcc, Cause::BrownOut), 0x06);
    assert_eq!(after(&mut rcc, Cause::Pin), 0x06);
    rcc.write_csr(1 << 24, &mut super::super::testing::shared());
    assert_eq!(after(&mut rcc, Cause::Pin), 0x04);
    assert_eq!(after(&mut rcc, Cause::PowerOn), 0x0e);
}

#[test]
fn the_core_is_let_go_some_time_after_a_reset() {
    for (cause, micros) in [(Cause::PowerOn, 1_500), (Cause::Software, 20)] {
        let (mut rcc, mut shared) = (Rcc::default(), shared());
        rcc.begin(Kept::default(), cause, &mut shared);
        pass(&mut rcc, &mut shared, micros - 1);
        assert!(rcc.is_held());
        pass(&mut rcc, &mut shared, 1);
        assert!(!rcc.is_held());
    }
}

#[test]
fn the_backup_domain_outlives_resets_and_its_clock_is_chosen_once() {
    let (mut rcc, mut shared) = (Rcc::default(), shared());
    rcc.write(BDCR, 0x8200, !0, &mut shared);
    let kept = rcc.kept(Cause::Watchdog);
    let mut rcc = Rcc::default();
    rcc.begin(kept, Cause::Watchdog, &mut shared);
    rcc.write(BDCR, 0x8100, !0, &mut shared);
    assert_eq!(rcc.read(BDCR, &mut shared), 0x8200);
    rcc.write(BDCR, BDRST, !0, &mut shared);
    rcc.write(BDCR, 0, !0, &mut shared);
    assert_eq!(rcc.read(BDCR, &mut shared), 0);
    assert_eq!(rcc.kept(Cause::PowerOn).backup, 0);
}
