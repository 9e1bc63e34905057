use super::*;
use crate::chip::testing::shared;

/// Handles the events due within `micros` µs.
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
    // The PLL's output is 8 MHz / 4 · 168 / 2 = 168 MHz.
    rcc.write(0x04, 0x2040_2a04 | 7 << 24, !0, shared);
    rcc.write(0x00, 0x0101_0081, !0, shared);
    rcc.write(0x08, 0x0000_9402, !0, shared);
    pass(rcc, shared, 200);
}

#[test]
fn bus_clock_beyond_its_limit_is_a_finding() {
    let (mut rcc, mut shared) = (Rcc::default(), shared());
    start(&mut rcc, &mut shared);
    // This divider sets APB1 to 84 MHz; the limit is 42 MHz.
    rcc.write(0x08, 0x0000_9002, !0, &mut shared);
    assert_eq!(shared.kinds(), [FindingKind::ClockLimit]);
    let found = &shared.findings.list()[0];
    assert!(found.text.contains("PCLK1 84000000"), "{found:?}");
}

#[test]
fn core_stalls_without_clock_security_until_the_crystal_recovers() {
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
    // The PLL takes another 0.1 ms.
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
fn clock_source_of_the_core_cannot_be_switched_off() {
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
fn ready_flag_is_set_only_with_its_interrupt_enabled() {
    let (mut rcc, mut shared) = (Rcc::default(), shared());
    rcc.write(0x0c, 1 << 12, !0, &mut shared);
    start(&mut rcc, &mut shared);
    assert_eq!(rcc.read(0x0c, &mut shared), 1 << 12 | 1 << 4);
    assert_eq!(shared.lines, 1 << Interrupt::Rcc as u32);
    rcc.write(0x0c, 1 << 12 | 1 << 20, !0, &mut shared);
    assert_eq!(shared.lines, 0);
}

#[test]
fn change_of_a_bus_prescaler_alone_is_reported() {
    let (mut rcc, mut shared) = (Rcc::default(), shared());
    rcc.write(0x08, 4 << 10, !0, &mut shared);
    assert_eq!((shared.clocks.apb1, shared.clocks.timer1), (2, 1));
    assert!(shared.effects.iter().eq(&[Effect::Frequency(16_000_000)]));
}

#[test]
fn reset_bit_resets_its_peripheral_when_it_rises() {
    let (mut rcc, mut shared) = (Rcc::default(), shared());
    rcc.write(0x20, 1 << 25, !0, &mut shared);
    rcc.write(0x20, 1 << 25 | 1, !0, &mut shared);
    let expected = [
        Effect::ResetUnit {
            register: 0x40,
            bit: 25,
        },
        Effect::ResetUnit {
            register: 0x40,
            bit: 0,
        },
    ];
    assert!(shared.effects.iter().eq(&expected));
    assert!(rcc.is_in_reset(0x40, 25) && !rcc.is_in_reset(0x40, 1));
}

#[test]
fn reset_flags_accumulate_until_cleared_or_power_reset() {
    let mut shared = shared();
    let mut rcc = Rcc::default();
    rcc.begin(Kept::default(), Cause::PowerOn, &mut shared);
    let mut after = |rcc: &mut Rcc, cause: Cause| {
        let kept = rcc.kept(cause);
        *rcc = Rcc::default();
        rcc.begin(kept, cause, &mut shared);
        rcc.read(CSR, &mut shared) >> 24
    };
    // Expected values are the reset flags of CSR (RM0090, 7.3.21), shifted down by 24 bits.
    assert_eq!(after(&mut rcc, Cause::Watchdog), 0x2e);
    assert_eq!(after(&mut rcc, Cause::Software), 0x3e);
    assert_eq!(after(&mut rcc, Cause::BrownOut), 0x06);
    assert_eq!(after(&mut rcc, Cause::Pin), 0x06);
    rcc.write_csr(1 << 24, &mut super::super::testing::shared());
    assert_eq!(after(&mut rcc, Cause::Pin), 0x04);
    assert_eq!(after(&mut rcc, Cause::PowerOn), 0x0e);
}

#[test]
fn core_is_released_after_the_reset_delay() {
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
fn backup_domain_outlives_resets_and_its_clock_is_selected_once() {
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
