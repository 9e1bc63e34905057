//! Timers, converter and streams together, driven as a program does: through the addresses of their
//! registers. The core's clock is the internal oscillator, 16 MHz, and so are all others.

use std::collections::VecDeque;
use virtual_board::chip::{Chip, ChipVariation, Circuit, Drive, Inputs, Interrupt, Pin};
use virtual_board::core::{System, Transfer};
use virtual_board::{Cycles, Time};

const SRAM: u32 = 0x2000_0000;
const TIM1: u32 = 0x4001_0000;
const TIM2: u32 = 0x4000_0000;
const TIM3: u32 = 0x4000_0400;
const ADC1: u32 = 0x4001_2000;
const DMA2: u32 = 0x4002_6400;
const SPI1: u32 = 0x4001_3000;
const PORT_A: u32 = 0x4002_0000;
const PORT_B: u32 = 0x4002_0400;
const PORT_C: u32 = 0x4002_0800;
const RCC: u32 = 0x4002_3800;
const AHB1ENR: u32 = RCC + 0x30;
const APB1ENR: u32 = RCC + 0x40;
const APB2ENR: u32 = RCC + 0x44;
const APB2RSTR: u32 = RCC + 0x24;

/// Picoseconds of a cycle.
const CYCLE_PS: u64 = 62_500;

/// Pins that change at given cycles, voltages by channel, and what the chip drives.
#[derive(Default)]
struct World {
    script: VecDeque<(Cycles, Pin, Drive)>,
    driven: Vec<(Cycles, Pin, Drive)>,
    words: Vec<u16>,
}

impl World {
    /// Counts of twelve bits that stand at a pin of port A.
    fn count(pin: Pin) -> u32 {
        300 + 500 * pin.number()
    }
}

impl Circuit for World {
    fn pin(&mut self, pin: Pin, drive: Drive, at: Time) {
        self.driven.push((at.0 / CYCLE_PS, pin, drive));
    }

    fn voltage(&mut self, pin: Pin, _at: Time) -> f64 {
        3.3 * f64::from(Self::count(pin)) / 4096.0
    }

    fn spi(&mut self, word: u16, _bits: u32, _at: Time) -> u16 {
        self.words.push(word);
        word ^ 0xff
    }

    fn next(&self) -> Time {
        let first = self.script.front();
        first.map_or(Time::NEVER, |(at, ..)| Time(at * CYCLE_PS))
    }

    fn advance(&mut self, at: Time, inputs: &mut Inputs) {
        while let Some(&(due, pin, drive)) = self.script.front()
            && due * CYCLE_PS <= at.0
        {
            self.script.pop_front();
            inputs.pins.push((pin, drive));
        }
    }
}

struct Bench {
    chip: Chip,
    cycle: Cycles,
}

impl Bench {
    /// A chip whose converter has no noise, long after power came on.
    fn new() -> Self {
        let mut part = ChipVariation::default();
        part.converter.noise = 0.0;
        let mut chip = Chip::new(Box::new(World::default()), 0);
        chip.set_variation(part);
        let mut bench = Self { chip, cycle: 0 };
        bench.pass(100_000);
        bench
    }

    fn world(&mut self) -> &mut World {
        self.chip.circuit().expect("the world")
    }

    /// Has pins change; the chip looks at its circuit.
    fn script(&mut self, script: &[(Cycles, Pin, Drive)]) {
        self.world().script.extend(script);
        self.chip.refresh();
    }

    fn pass(&mut self, until: Cycles) {
        self.chip.advance(until, until);
        self.cycle = until;
    }

    /// Each access at the cycle after the one before, whatever it takes.
    fn write(&mut self, values: &[(u32, u32)]) {
        for &(address, value) in values {
            let mut took = self.cycle;
            let done = self
                .chip
                .write(Transfer::word(address, 0), value, &mut took);
            assert!(done.is_ok());
            self.cycle += 1;
        }
    }

    fn read(&mut self, address: u32) -> u32 {
        let mut took = self.cycle;
        self.chip
            .read(Transfer::word(address, 0), &mut took)
            .expect("a register")
    }

    fn halves(&mut self, address: u32, n: usize) -> Vec<u16> {
        let at = (address - SRAM) as usize;
        let bytes = &self.chip.sram()[at..at + 2 * n];
        let pairs = bytes.chunks(2);
        pairs
            .map(|pair| u16::from_le_bytes([pair[0], pair[1]]))
            .collect()
    }

    fn line(&self, interrupt: Interrupt) -> bool {
        self.chip.lines() >> interrupt as u32 & 1 != 0
    }

    /// How the chip drove a pin since a cycle, with times from there.
    fn drives(&mut self, of: Pin, since: Cycles) -> Vec<(Cycles, Drive)> {
        let driven = self.world().driven.iter();
        let of_pin = driven.filter(|(at, pin, _)| *pin == of && *at >= since);
        of_pin.map(|(at, _, drive)| (at - since, *drive)).collect()
    }

    fn findings(&self) -> Vec<String> {
        let list = self.chip.findings().list();
        list.iter().map(|finding| finding.text.clone()).collect()
    }

    /// Scans of the six channels of PA0 to PA5 every 1000 cycles into a ring of 24 halves.
    fn scans(&mut self) {
        self.write(&[
            (AHB1ENR, 1 | 1 << 22),
            (APB1ENR, 1),
            (APB2ENR, 1 << 8),
            (PORT_A, 0xa800_0fff),
            (ADC1 + 0x304, 1 << 16),
            (ADC1 + 0x04, 1 << 8),
            (ADC1 + 0x10, 0o111111),
            (ADC1 + 0x2c, 5 << 20),
            (ADC1 + 0x34, 1 << 5 | 2 << 10 | 3 << 15 | 4 << 20 | 5 << 25),
            (DMA2 + 0x18, ADC1 + 0x4c),
            (DMA2 + 0x1c, SRAM),
            (DMA2 + 0x14, 24),
            // Halves, ring, half and end of it tell.
            (
                DMA2 + 0x10,
                1 << 13 | 1 << 11 | 1 << 10 | 1 << 8 | 1 << 4 | 1 << 3,
            ),
            (
                DMA2 + 0x10,
                1 << 13 | 1 << 11 | 1 << 10 | 1 << 8 | 1 << 4 | 1 << 3 | 1,
            ),
            (TIM2 + 0x2c, 999),
            (TIM2 + 0x14, 1),
            (TIM2 + 0x04, 2 << 4),
            (ADC1 + 0x08, 1 | 1 << 8 | 1 << 9 | 6 << 24 | 1 << 28),
        ]);
        self.pass(self.cycle + 100);
    }
}

const PA8: Pin = Pin::new('A', 8);
const PB12: Pin = Pin::new('B', 12);

#[test]
fn scans_at_a_timers_pace_fill_a_ring() {
    let mut bench = Bench::new();
    bench.scans();
    let start = bench.cycle;
    bench.write(&[(TIM2, 1)]);
    // Counting from the next cycle on; a clock is four cycles: two to start, six conversions of 27.
    let first = start + 1 + 1000;
    let scan = 4 * (2 + 6 * 27);
    for (at, halves) in [(first + scan - 1, 5), (first + scan, 6)] {
        bench.pass(at);
        assert_eq!(bench.chip.conversions().regular, halves);
    }
    // The second scan fills half of the ring.
    bench.pass(first + 1000 + scan - 1);
    assert!(!bench.line(Interrupt::Dma2Stream0));
    bench.pass(first + 1000 + scan);
    assert!(bench.line(Interrupt::Dma2Stream0));
    assert_eq!(bench.read(DMA2), 1 << 4);
    bench.write(&[(DMA2 + 8, 1 << 4)]);
    assert!(!bench.line(Interrupt::Dma2Stream0));
    bench.pass(first + 3000 + scan);
    assert_eq!(bench.read(DMA2), 1 << 5);
    let scan: Vec<u16> = (0..6)
        .map(|channel| World::count(Pin::new('A', channel)) as u16)
        .collect();
    assert_eq!(bench.halves(SRAM, 24), scan.repeat(4));
    assert_eq!(bench.findings(), [""; 0]);
}

#[test]
fn a_converter_or_stream_without_clock_stands_still() {
    let mut bench = Bench::new();
    bench.scans();
    bench.write(&[(TIM2, 1)]);
    bench.pass(bench.cycle + 10_500);
    let before = bench.chip.conversions().regular;
    bench.write(&[(APB2ENR, 0)]);
    bench.pass(bench.cycle + 10_000);
    assert_eq!(bench.chip.conversions().regular, before);
    bench.write(&[(APB2ENR, 1 << 8)]);
    bench.pass(bench.cycle + 10_000);
    assert_eq!(bench.chip.conversions().regular, before + 60);
    // Without the stream's clock the second datum is an overrun.
    bench.write(&[(AHB1ENR, 1)]);
    bench.pass(bench.cycle + 10_000);
    assert_eq!(bench.chip.conversions().overruns, 1);
    assert_eq!(bench.chip.conversions().regular, before + 62);
}

#[test]
fn a_pin_that_is_not_analogue_is_found_once() {
    let mut bench = Bench::new();
    bench.scans();
    bench.write(&[(PORT_A, 0xa800_0fcf), (TIM2, 1)]);
    bench.pass(bench.cycle + 5_000);
    assert_eq!(bench.findings(), ["PA2 is converted and not analogue"]);
}

/// Pulses of PA8 and conversions of PC0 by OC4REF, as a motor's board has them; TIM1's counter starts
/// at the cycle that is given back. The break input is PB12.
fn pulses(bench: &mut Bench) -> Cycles {
    bench.write(&[
        (AHB1ENR, 7),
        (APB2ENR, 1 | 1 << 8),
        (PORT_A + 0x24, 1),
        (PORT_A, 0xa802_0000),
        (PORT_B + 0x24, 1 << 16),
        (PORT_B + 0x0c, 1 << 24 | 0x100),
        (PORT_B, 2 << 24 | 0x280),
        (PORT_C, 3),
        (ADC1 + 0x38, 10 << 15),
        (ADC1 + 0x08, 1 | 1 << 16),
        (TIM1 + 0x2c, 400),
        (TIM1 + 0x34, 100),
        (TIM1 + 0x40, 380),
        (TIM1 + 0x18, 0x68),
        (TIM1 + 0x1c, 0x7800),
        (TIM1 + 0x20, 1),
        (TIM1 + 0x14, 1),
        (TIM1 + 0x04, 7 << 4),
        (TIM1 + 0x10, 0),
        (TIM1, 1 << 5 | 1 << 7),
        (ADC1 + 0x08, 1 | 1 << 16 | 1 << 20),
    ]);
    bench.pass(bench.cycle + 200);
    bench.write(&[(TIM1, 1 << 5 | 1 << 7 | 1)]);
    bench.cycle
}

/// MOE, BKP, BKE, OSSI.
const BDTR: u32 = 0xb400;

#[test]
fn pulses_come_at_their_pin_and_a_break_stops_them_but_not_the_conversions() {
    let mut bench = Bench::new();
    bench.script(&[(100_000, PB12, Drive::Low)]);
    let start = pulses(&mut bench);
    bench.script(&[
        (start + 1650, PB12, Drive::High),
        (start + 1651, PB12, Drive::Low),
    ]);
    bench.write(&[(TIM1 + 0x44, BDTR)]);
    bench.pass(start + 8000);
    let edges = bench.drives(PA8, start + 2);
    let expected = [
        (98, Drive::Low),
        (698, Drive::High),
        (898, Drive::Low),
        (1498, Drive::High),
        (1648, Drive::Low),
    ];
    assert_eq!(edges, expected);
    assert_eq!(bench.read(TIM1 + 0x44), BDTR & 0x7fff);
    assert_eq!(bench.read(TIM1 + 0x10) & 1 << 7, 1 << 7);
    // Once a period of 800.
    assert_eq!(bench.chip.conversions().injected, 10);
    bench.write(&[(TIM1 + 0x10, 0), (TIM1 + 0x44, BDTR)]);
    let now = bench.cycle;
    bench.pass(now + 2000);
    assert!(bench.drives(PA8, now).len() >= 4);
    assert_eq!(bench.findings(), [""; 0]);
}

#[test]
fn a_timer_that_is_reset_lets_its_pin_go_and_still_hears_the_break_input() {
    let mut bench = Bench::new();
    bench.script(&[(100_000, PB12, Drive::Low)]);
    let start = pulses(&mut bench);
    bench.write(&[(TIM1 + 0x44, BDTR)]);
    bench.script(&[(start + 500, PB12, Drive::High)]);
    bench.pass(start + 1000);
    bench.write(&[(APB2RSTR, 1), (APB2RSTR, 0)]);
    let drives = bench.drives(PA8, start + 1000);
    assert_eq!(drives, [(0, Drive::Open)]);
    bench.write(&[(TIM1 + 0x44, BDTR)]);
    assert_eq!(bench.read(TIM1 + 0x44), BDTR & 0x7fff);
}

#[test]
fn an_encoder_at_two_pins_is_counted() {
    let mut bench = Bench::new();
    bench.write(&[
        (AHB1ENR, 4),
        (APB1ENR, 1 << 1),
        (PORT_C + 0x20, 2 << 24 | 2 << 28),
        (PORT_C, 2 << 12 | 2 << 14),
        (PORT_C + 0x0c, 1 << 12 | 1 << 14),
        (TIM3 + 0x18, 0xf1f1),
        (TIM3 + 0x20, 0x11),
        (TIM3 + 0x08, 3),
    ]);
    bench.pass(bench.cycle + 1000);
    bench.write(&[(TIM3 + 0x24, 0), (TIM3, 1)]);
    let (a, b) = (Pin::new('C', 6), Pin::new('C', 7));
    let start = bench.cycle + 1000;
    let turn = [
        (a, Drive::Low),
        (b, Drive::Low),
        (a, Drive::High),
        (b, Drive::High),
    ];
    let script: Vec<_> = turn
        .iter()
        .cycle()
        .take(400)
        .zip(0..)
        .map(|(&(pin, drive), k)| (start + 400 * k, pin, drive))
        .collect();
    bench.script(&script);
    bench.pass(start + 400 * 400);
    assert_eq!(bench.read(TIM3 + 0x24), 400);
    assert_eq!(bench.findings(), [""; 0]);
}

#[test]
fn words_go_out_and_come_in_by_two_streams() {
    let mut bench = Bench::new();
    let at = 0x400;
    for k in 0..8 {
        bench.chip.sram()[at + k] = 0x10 + k as u8;
    }
    let memory = 1 << 10;
    bench.write(&[
        (AHB1ENR, 1 | 1 << 22),
        (APB2ENR, 1 << 12),
        (PORT_A + 0x20, 0x5550_0000),
        (PORT_A, 0xa800_a800),
        // Stream 2 from, stream 3 to the data register.
        (DMA2 + 0x40 + 0x08, SPI1 + 0x0c),
        (DMA2 + 0x40 + 0x0c, SRAM + 0x500),
        (DMA2 + 0x40 + 0x04, 8),
        (DMA2 + 0x40, 3 << 25 | memory | 1),
        (DMA2 + 0x58 + 0x08, SPI1 + 0x0c),
        (DMA2 + 0x58 + 0x0c, SRAM + at as u32),
        (DMA2 + 0x58 + 0x04, 8),
        (DMA2 + 0x58, 3 << 25 | memory | 1 << 6 | 1),
        (SPI1, 1 << 9 | 1 << 8 | 1 << 6 | 1 << 2),
        (SPI1 + 0x04, 3),
    ]);
    // Eight bits of two cycles each.
    bench.pass(bench.cycle + 8 * 16 + 20);
    let sent: Vec<_> = (0x10..0x18).collect();
    assert_eq!(bench.world().words, sent);
    let came: Vec<_> = (0x10..0x18).map(|word| word ^ 0xff).collect();
    assert_eq!(bench.chip.sram()[0x500..0x508], came);
    // Both are complete: streams 2 and 3 in the low register, halves too.
    assert_eq!(bench.read(DMA2), 0x30 << 16 | 0x30 << 22);
    assert_eq!(bench.findings(), [""; 0]);
}

#[test]
fn a_halted_core_stops_the_timers_that_are_chosen() {
    let mut bench = Bench::new();
    bench.write(&[(APB1ENR, 3), (TIM2, 1), (TIM3, 1), (0xe004_2008, 1)]);
    let halt = bench.cycle;
    bench.chip.halt(true, halt);
    bench.pass(halt + 1000);
    bench.chip.halt(false, halt + 1000);
    bench.pass(halt + 1100);
    let counts = [TIM2, TIM3].map(|timer| bench.read(timer + 0x24));
    // Started one after the other, two and one cycles before the halt.
    assert_eq!(counts, [102, 1101]);
}
