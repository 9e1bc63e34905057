use super::*;
use crate::chip::circuit::Circuit;
use crate::chip::testing::PeripheralBench;
use crate::time::Time;

const CR1: u32 = 0;
const CR2: u32 = 4;
const SR: u32 = 8;
const DR: u32 = 12;
/// Master with its select input held high by software; SPI clock PCLK2 / 8.
const MASTER: u32 = MSTR | SSM | SSI | 2 << 3;
/// Core cycles in one bit: APB2 at half the core clock, divided by eight.
const BIT: Cycles = 16;

/// A device that answers each word with its complement and records the words.
#[derive(Clone, Default)]
struct Mirror {
    words: Vec<(u16, u32, Time)>,
}

impl Circuit for Mirror {
    fn spi(&mut self, word: u16, bits: u32, at: Time) -> u16 {
        self.words.push((word, bits, at));
        !word
    }
}

fn disabled() -> PeripheralBench<Spi> {
    PeripheralBench::around(Mirror::default(), Unit::Spi1, Spi::after_reset())
}

fn enabled() -> PeripheralBench<Spi> {
    let mut bench = disabled();
    bench.write(&[(CR1, MASTER), (CR1, MASTER | SPE)]);
    bench.shared.effects.clear();
    bench
}

#[test]
fn word_is_received_half_a_bit_before_its_end() {
    let mut bench = enabled();
    assert_eq!(bench.read(SR), TXE);
    bench.write(&[(DR, 0x5a)]);
    assert_eq!(bench.read(SR), TXE | BSY);
    bench.run(8 * BIT - BIT / 2 - 1);
    assert_eq!(bench.read(SR), TXE | BSY);
    bench.run(8 * BIT - BIT / 2);
    assert_eq!(bench.read(SR), TXE | BSY | RXNE);
    assert_eq!(bench.read(DR), 0xa5);
    assert_eq!(bench.read(SR), TXE | BSY);
    bench.run(8 * BIT);
    assert_eq!(bench.read(SR), TXE);
    let end = bench.shared.base.time_of(8 * BIT);
    assert_eq!(bench.circuit::<Mirror>().words, [(0x5a, 8, end)]);
    assert!(bench.shared.kinds().is_empty());
}

#[test]
fn waiting_word_follows_without_a_gap() {
    let mut bench = enabled();
    bench.write(&[(CR2, RXNEIE), (DR, 1), (DR, 2)]);
    assert_eq!(bench.read(SR), BSY);
    let mut words = Vec::new();
    for _ in 0..2 {
        while bench.shared.lines == 0 {
            bench.run(bench.shared.now + 1);
        }
        words.push((bench.shared.now, bench.read(DR)));
        assert_eq!(bench.shared.lines, 0);
    }
    let half = BIT / 2;
    assert_eq!(words, [(8 * BIT - half, 0xfe), (16 * BIT - half, 0xfd)]);
}

#[test]
fn words_of_16_bits_transfer_and_pins_are_checked_once() {
    let mut bench = disabled();
    let cr1 = MASTER | DFF | CPOL | CPHA;
    bench.write(&[(CR1, cr1), (CR1, cr1 | SPE), (DR, 0x1234)]);
    bench.run(16 * BIT);
    assert_eq!(bench.read(DR), 0xedcb);
    assert_eq!(bench.circuit::<Mirror>().words[0].1, 16);
    // A second enabling does not check again that the signals are routed to pins.
    bench.write(&[(CR1, cr1), (CR1, cr1 | SPE)]);
    let signals = [Signal::Spi1Sck, Signal::Spi1Miso, Signal::Spi1Mosi];
    assert_eq!(bench.shared.effects, signals.map(Effect::Uses));
}

#[test]
fn unread_word_is_an_overrun() {
    let mut bench = enabled();
    bench.write(&[(CR2, ERRIE), (DR, 1), (DR, 2)]);
    bench.run(16 * BIT);
    assert_eq!(bench.read(SR), TXE | RXNE | OVR);
    assert_ne!(bench.shared.lines, 0);
    assert_eq!(bench.shared.kinds(), [FindingKind::Lost]);
    // The first word stays; reading DR and then SR clears the flag.
    assert_eq!(bench.read(DR), 0xfe);
    assert_eq!(bench.read(SR), TXE | OVR);
    assert_eq!(bench.read(SR), TXE);
}

#[test]
fn misuse_of_the_spi_is_a_finding() {
    let mut bench = enabled();
    bench.write(&[(DR, 1), (CR1, MASTER)]);
    assert_eq!(bench.shared.kinds(), [FindingKind::Forbidden]);
    bench.write(&[(DR, 1)]);
    assert_eq!(bench.shared.kinds(), [FindingKind::Forbidden; 2]);
    // A low select input disables the master.
    bench.write(&[(CR1, (MASTER & !SSI) | SPE)]);
    assert_eq!(bench.read(SR) & MODF, MODF);
    assert_eq!(bench.read(CR1) & (SPE | MSTR), 0);
    bench.write(&[(CR1, 0)]);
    assert_eq!(bench.read(SR) & MODF, 0);
    bench.write(&[(CR1, SSM | SSI | SPE)]);
    assert_eq!(bench.shared.kinds().last(), Some(&FindingKind::NotModelled));
    let mut bench = disabled();
    bench.write(&[(CR2, TXDMAEN), (CR1, LSBFIRST)]);
    assert_eq!(bench.shared.kinds(), [FindingKind::NotModelled; 2]);
    // PCLK2 of 168 MHz, divided by two, exceeds the limit of 42 MHz.
    let mut bench = disabled();
    bench.shared.clocks.apb2 = 1;
    bench.write(&[(CR1, MSTR | SSM | SSI | SPE)]);
    assert_eq!(bench.shared.kinds(), [FindingKind::ClockLimit]);
}
