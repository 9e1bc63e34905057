//! What events of timers, converter and streams cost: `cargo run --release --example events`, with a
//! number of cycles if not 400 million. Nothing else runs: no core, and surroundings that do nothing.

use std::sync::LazyLock;
use std::time::Instant;
use virtual_board::chip::{Chip, Drive, Inputs, Pin, Surroundings};
use virtual_board::core::{System, Width};
use virtual_board::{Cycles, Time};

const TIM1: u32 = 0x4001_0000;
const TIM2: u32 = 0x4000_0000;
const TIM3: u32 = 0x4000_0400;
const ADC1: u32 = 0x4001_2000;
const DMA2: u32 = 0x4002_6400;
const PORT_A: u32 = 0x4002_0000;
const PORT_C: u32 = 0x4002_0800;
const RCC: u32 = 0x4002_3800;

/// An encoder that turns, if `edge` is not zero.
struct Idle {
    edges: u64,
    /// Time between edges, ps.
    edge: u64,
}

impl Surroundings for Idle {
    fn pin(&mut self, _pin: Pin, _drive: Drive, _at: Time) {}

    fn voltage(&mut self, _pin: Pin, _at: Time) -> f64 {
        1.65
    }

    fn spi(&mut self, _word: u16, _bits: u32, _at: Time) -> u16 {
        !0
    }

    fn next(&self) -> Time {
        match self.edge {
            0 => Time::NEVER,
            edge => Time((self.edges + 1) * edge),
        }
    }

    fn advance(&mut self, _at: Time, inputs: &mut Inputs) {
        let (pin, high) = (6 + (self.edges & 1) as u8, self.edges & 2 != 0);
        self.edges += 1;
        inputs.pins.push((Pin::new('C', pin), Drive::to(high)));
    }
}

/// Time that this process had on a processor, ns; where the system does not tell, time that passed.
fn processor_ns() -> f64 {
    static START: LazyLock<Instant> = LazyLock::new(Instant::now);
    let told = std::fs::read_to_string("/proc/self/schedstat").ok();
    let first = told.and_then(|text| text.split(' ').next()?.parse().ok());
    first.unwrap_or_else(|| START.elapsed().as_secs_f64() * 1e9)
}

struct Bench {
    chip: Chip,
    cycle: Cycles,
}

impl Bench {
    fn new(edge: u64) -> Self {
        let chip = Chip::new(Box::new(Idle { edges: 0, edge }), 0);
        let mut bench = Self { chip, cycle: 0 };
        bench.pass(100_000);
        bench.write(&[
            (RCC + 0x30, 7 | 1 << 22),
            (RCC + 0x40, 3),
            (RCC + 0x44, 0x101),
        ]);
        bench
    }

    fn write(&mut self, values: &[(u32, u32)]) {
        for &(address, value) in values {
            let done = System::write(
                &mut self.chip,
                address,
                Width::Word,
                value,
                0,
                &mut self.cycle,
            );
            assert!(done.is_ok());
        }
        self.pass(self.cycle + 100);
    }

    /// Goes from event to event, as a sleeping core does; gives how many looks that took.
    fn pass(&mut self, until: Cycles) -> u64 {
        let mut looks = 0;
        while self.cycle < until {
            looks += 1;
            self.cycle = self.chip.advance(self.cycle, until).min(until);
        }
        looks
    }

    /// Measures what happens every `period` cycles.
    fn measure(&mut self, name: &str, cycles: Cycles, period: f64) {
        let start = processor_ns();
        let looks = self.pass(self.cycle + cycles);
        let took = processor_ns() - start;
        let (each, event) = (took * period / cycles as f64, took / looks as f64);
        println!("{name}: {each:.0} ns each, {event:.0} ns an event, {looks} events");
        for finding in self.chip.findings().list() {
            println!("  {finding}");
        }
    }
}

fn main() {
    let mut bench = Bench::new(0);
    bench.write(&[
        (PORT_A, 0xa800_0fff),
        (ADC1 + 0x304, 1 << 16),
        (ADC1 + 0x04, 1 << 8),
        (ADC1 + 0x10, 0o111111),
        (ADC1 + 0x2c, 5 << 20),
        (ADC1 + 0x34, 1 << 5 | 2 << 10 | 3 << 15 | 4 << 20 | 5 << 25),
        (DMA2 + 0x18, ADC1 + 0x4c),
        (DMA2 + 0x1c, 0x2000_0000),
        (DMA2 + 0x14, 1152),
        (DMA2 + 0x10, 1 << 13 | 1 << 11 | 1 << 10 | 1 << 8 | 1),
        (TIM2 + 0x2c, 874),
        (TIM2 + 0x14, 1),
        (TIM2 + 0x04, 2 << 4),
        (ADC1 + 0x08, 1 | 1 << 8 | 1 << 9 | 6 << 24 | 1 << 28),
        (TIM2, 1),
    ]);
    let argument = std::env::args().nth(1);
    let cycles = argument.and_then(|text| text.parse().ok());
    let cycles = cycles.unwrap_or(400_000_000);
    let period = 875.0 / 6.0;
    bench.measure("conversion of a scan with its transfer", cycles, period);

    let mut bench = Bench::new(0);
    bench.write(&[
        (PORT_A + 0x24, 0x11),
        (PORT_A, 0xa80a_0000),
        (TIM1 + 0x2c, 420),
        (TIM1 + 0x34, 100),
        (TIM1 + 0x38, 150),
        (TIM1 + 0x18, 0x6868),
        (TIM1 + 0x20, 0x11),
        (TIM1 + 0x44, 0x8400),
        (TIM1, 1 << 5 | 1 << 7),
        (TIM1 + 0x14, 1),
        (TIM1, 1 << 5 | 1 << 7 | 1),
    ]);
    // Four edges a period.
    bench.measure("edge of two outputs with pulses", cycles, 840.0 / 4.0);

    let mut bench = Bench::new(14_000_000);
    bench.write(&[
        (PORT_C + 0x20, 0x2200_0000),
        (PORT_C, 0xa000),
        (TIM3 + 0x18, 0xf1f1),
        (TIM3 + 0x08, 3),
        (TIM3, 1),
    ]);
    // 14 µs at 16 MHz.
    bench.measure("edge of an encoder", cycles, 224.0);
}
