use super::*;
use crate::chip::testing::shared;

const PB13: Pin = Pin::new('B', 13);
const PORT_B: u32 = 0x400;

#[test]
fn an_output_drives_its_pin_and_the_world_hears_of_it() {
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
    // The half that resets.
    gpio.write(PORT_B + 0x18, 1 << 29, 0xffff_0000, &mut shared);
    assert_eq!(gpio.read(PORT_B + 0x10, &mut shared) >> 13 & 1, 0);
    assert_eq!(gpio.read(PORT_B + 0x14, &mut shared), 0);
}

#[test]
fn pulls_give_way_to_what_is_soldered_and_conflicts_are_found() {
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
fn a_signal_reaches_the_pin_that_has_its_function() {
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
fn a_reset_lets_the_chips_pins_go_and_the_worlds_stay() {
    let (mut gpio, mut shared) = (Gpio::default(), shared());
    gpio.external(Pin::new('C', 13), Drive::Low, &mut shared);
    gpio.write(PORT_B, 0x280 | 1 << 26, !0, &mut shared);
    gpio.write(PORT_B + 0x18, 1 << 13, !0, &mut shared);
    shared.effects.clear();
    let mut after = Gpio::default();
    after.begin(&gpio, &mut shared);
    assert!(shared.effects.contains(&Effect::Driven(PB13, Drive::Open)));
    assert_eq!(after.world[Pin::new('C', 13).index()], Drive::Low);
}

#[test]
fn an_open_drain_pulls_down_only() {
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
fn an_analogue_pin_reads_low_whatever_is_soldered_to_it() {
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
fn a_pin_that_is_let_go_is_found_when_it_is_read() {
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
fn a_peripheral_hears_the_level_of_the_pin_that_it_is_given() {
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
fn a_reset_of_a_port_lets_its_pins_go() {
    let (mut gpio, mut shared) = (Gpio::default(), shared());
    gpio.write(PORT_B, 0x280 | 1 << 26, !0, &mut shared);
    gpio.reset(1, &mut shared);
    assert_eq!(gpio.driven(PB13), Drive::Open);
    // JTRST and JTDO are pins of the debug port.
    assert_eq!(gpio.read(PORT_B, &mut shared), 0x280);
    assert_eq!(gpio.driven(Pin::new('B', 4)), Drive::PullUp);
}

#[test]
fn no_signal_has_more_pins_than_there_is_room_for() {
    for (signal, _, pins) in ALTERNATE {
        assert!(pins.len() <= CHOICES, "{signal:?}");
        let rows = ALTERNATE.iter().filter(|(of, ..)| of == signal);
        assert_eq!(rows.count(), 1, "{signal:?}");
    }
}

#[test]
fn a_net_of_the_board_that_is_driven_is_found_and_its_led_and_button_are_not() {
    /// Only the nets of an H405.
    #[derive(Clone)]
    struct Bare405;
    impl crate::chip::Circuit for Bare405 {
        fn nets(&self) -> &'static [Net] {
            crate::device::olimex_h405::NETS
        }
    }
    const PORT_C: u32 = 0x800;
    let (mut gpio, mut shared) = (Gpio::default(), shared());
    shared.replace_world(Box::new(Bare405));
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
