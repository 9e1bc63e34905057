use super::*;
use crate::chip::testing::shared;

const PB13: Pin = Pin::new('B', 13);
const PORT_B: u32 = 0x400;

#[test]
fn output_drives_its_pin_and_the_circuit_is_called() {
    let (mut gpio, mut shared) = (Gpio::default(), shared());
    gpio.begin(&Gpio::default(), &mut shared);
    shared.effects.clear();
    gpio.write(PORT_B + 0x18, 1 << 13, !0, &mut shared);
    assert!(shared.effects.is_empty(), "still an input");
    gpio.write(PORT_B, 0x280 | 1 << 26, !0, &mut shared);
    let effects: Vec<_> = shared.effects.drain(..).collect();
    let driven = Effect::Driven(PB13, Drive::High);
    assert_eq!(
        effects,
        [
            driven,
            Effect::Level {
                pin: PB13,
                high: true
            }
        ]
    );
    // The upper halfword of BSRR resets the output.
    gpio.write(PORT_B + 0x18, 1 << 29, 0xffff_0000, &mut shared);
    assert_eq!(gpio.read(PORT_B + 0x10, &mut shared) >> 13 & 1, 0);
    assert_eq!(gpio.read(PORT_B + 0x14, &mut shared), 0);
}

#[test]
fn circuit_overrides_pulls_and_a_drive_conflict_is_a_finding() {
    let (mut gpio, mut shared) = (Gpio::default(), shared());
    gpio.write(PORT_B + 0x0c, 0x100 | 1 << 26, !0, &mut shared);
    assert!(gpio.level(PB13));
    gpio.external(PB13, Drive::PullDown, &mut shared);
    assert!(!gpio.level(PB13));
    gpio.external(PB13, Drive::High, &mut shared);
    assert!(gpio.level(PB13) && shared.findings.list().is_empty());
    gpio.write(PORT_B, 0x280 | 1 << 26, !0, &mut shared);
    assert_eq!(shared.findings.list().len(), 1);
}

#[test]
fn signal_drives_the_pin_with_its_alternate_function() {
    let (mut gpio, mut shared) = (Gpio::default(), shared());
    gpio.output(Signal::Tim1Ch1, Drive::High, &mut shared);
    gpio.write(0x24, 1, 0xf, &mut shared);
    gpio.write(0x00, 0xa800_0000 | 2 << 16, !0, &mut shared);
    assert_eq!(gpio.pin_of(Signal::Tim1Ch1), Some(Pin::new('A', 8)));
    assert!(gpio.level(Pin::new('A', 8)));
    gpio.output(Signal::Tim1Ch1, Drive::Low, &mut shared);
    assert!(!gpio.level(Pin::new('A', 8)));
}

#[test]
fn reset_releases_the_chips_pins_and_keeps_the_circuits_drives() {
    let (mut gpio, mut shared) = (Gpio::default(), shared());
    gpio.external(Pin::new('C', 13), Drive::Low, &mut shared);
    gpio.write(PORT_B, 0x280 | 1 << 26, !0, &mut shared);
    gpio.write(PORT_B + 0x18, 1 << 13, !0, &mut shared);
    shared.effects.clear();
    let mut after = Gpio::default();
    after.begin(&gpio, &mut shared);
    assert!(shared.effects.contains(&Effect::Driven(PB13, Drive::Open)));
    assert_eq!(after.circuit[Pin::new('C', 13).index()], Drive::Low);
}

#[test]
fn open_drain_output_drives_low_only() {
    let (mut gpio, mut shared) = (Gpio::default(), shared());
    gpio.write(PORT_B + 0x04, 1 << 13, !0, &mut shared);
    gpio.write(PORT_B, 0x280 | 1 << 26, !0, &mut shared);
    assert_eq!(gpio.driven(PB13), Drive::Low);
    gpio.write(PORT_B + 0x18, 1 << 13, !0, &mut shared);
    assert_eq!(gpio.driven(PB13), Drive::Open);
    gpio.external(PB13, Drive::PullUp, &mut shared);
    assert!(gpio.level(PB13) && shared.findings.list().is_empty());
}

#[test]
fn analogue_pin_reads_low_at_any_external_level() {
    let (mut gpio, mut shared) = (Gpio::default(), shared());
    gpio.begin(&Gpio::default(), &mut shared);
    gpio.external(PB13, Drive::High, &mut shared);
    assert!(gpio.level(PB13));
    shared.effects.clear();
    gpio.write(PORT_B, 0x280 | 3 << 26, !0, &mut shared);
    assert_eq!(gpio.read(PORT_B + 0x10, &mut shared) >> 13 & 1, 0);
    assert!(shared.effects.iter().eq(&[Effect::Level {
        pin: PB13,
        high: false
    }]));
    assert!(gpio.is_analogue(PB13) && !gpio.floats(PB13));
}

#[test]
fn reading_a_released_pin_is_a_finding() {
    let (mut gpio, mut shared) = (Gpio::default(), shared());
    gpio.read(PORT_B + 0x10, &mut shared);
    gpio.external(PB13, Drive::High, &mut shared);
    gpio.read(PORT_B + 0x10, &mut shared);
    assert!(shared.findings.list().is_empty());
    gpio.external(PB13, Drive::Open, &mut shared);
    gpio.read(PORT_B + 0x10, &mut shared);
    let [found] = shared.findings.list() else {
        panic!("{:?}", shared.findings.list());
    };
    assert!(found.text.starts_with("PB13"), "{found:?}");
}

#[test]
fn peripheral_receives_the_level_of_its_newly_routed_pin() {
    let (mut gpio, mut shared) = (Gpio::default(), shared());
    gpio.begin(&Gpio::default(), &mut shared);
    let pin = Pin::new('B', 12);
    gpio.external(pin, Drive::High, &mut shared);
    gpio.write(PORT_B + 0x24, 1 << 16, !0, &mut shared);
    shared.effects.clear();
    gpio.write(PORT_B, 0x280 | 2 << 24, !0, &mut shared);
    assert_eq!(gpio.signal_at(pin), Some(Signal::Tim1Bkin));
    assert!(
        shared
            .effects
            .iter()
            .eq(&[Effect::Level { pin, high: true }])
    );
}

#[test]
fn port_reset_releases_its_pins() {
    let (mut gpio, mut shared) = (Gpio::default(), shared());
    gpio.write(PORT_B, 0x280 | 1 << 26, !0, &mut shared);
    gpio.reset(1, &mut shared);
    assert_eq!(gpio.driven(PB13), Drive::Open);
    // JTRST and JTDO are pins of the debug port.
    assert_eq!(gpio.read(PORT_B, &mut shared), 0x280);
    assert_eq!(gpio.driven(Pin::new('B', 4)), Drive::PullUp);
}

#[test]
fn every_signal_has_one_row_of_at_most_four_pins() {
    for (signal, _, pins) in ALTERNATE {
        assert!(pins.len() <= CHOICES, "{signal:?}");
        let rows = ALTERNATE.iter().filter(|(of, ..)| of == signal);
        assert_eq!(rows.count(), 1, "{signal:?}");
    }
}

#[test]
fn driving_a_board_net_is_a_finding_except_led_and_button() {
    /// A circuit that has only the nets of an H405 board.
    #[derive(Clone)]
    struct Bare405;
    impl crate::chip::Circuit for Bare405 {
        fn nets(&self) -> &'static [Net] {
            crate::device::olimex_h405::NETS
        }
    }
    const PORT_C: u32 = 0x800;
    let (mut gpio, mut shared) = (Gpio::default(), shared());
    shared.replace_circuit(Box::new(Bare405));
    gpio.begin(&Gpio::default(), &mut shared);
    gpio.external(Pin::new('A', 0), Drive::High, &mut shared);
    gpio.write(PORT_C, 1 << 24 | 1 << 10, !0, &mut shared);
    assert!(shared.findings.list().is_empty(), "LED and PC5");
    gpio.external(Pin::new('C', 14), Drive::High, &mut shared);
    gpio.write(PORT_C, 1 << 24 | 1 << 10 | 1 << 8, !0, &mut shared);
    let texts: Vec<_> = shared.findings.list().iter().map(|f| &f.text).collect();
    assert!(
        texts[0].starts_with("PC14 is the board's net OSC32_IN"),
        "{texts:?}"
    );
    assert!(
        texts[1].starts_with("PC4 is the board's net USB_P"),
        "{texts:?}"
    );
    assert_eq!(texts.len(), 2);
}
