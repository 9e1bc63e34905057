//! Timers, converter and DMA streams together, accessed through their register addresses as a program does. All clocks
//! are those of the internal oscillator, 16 MHz.

use super::*;

const TIM1: u32 = 0x4001_0000;
const TIM2: u32 = 0x4000_0000;
const TIM3: u32 = 0x4000_0400;
const ADC1: u32 = 0x4001_2000;
const DMA2: u32 = 0x4002_6400;
const PORT_A: u32 = 0x4002_0000;
const PORT_C: u32 = 0x4002_0800;
const AHB1ENR: u32 = RCC + 0x30;
const APB1ENR: u32 = RCC + 0x40;
const APB2ENR: u32 = RCC + 0x44;
const APB2RSTR: u32 = RCC + 0x24;

/// Control of a stream: halfwords, circular, interrupts at half and full transfer.
const RING: u32 = 1 << 13 | 1 << 11 | 1 << 10 | 1 << 8 | 1 << 4 | 1 << 3;

/// Duration of a cycle, ps.
const CYCLE_PS: u64 = 62_500;

impl ChipBench {
    /// A chip without converter noise, 100 000 cycles after power-on.
    fn precise() -> Self {
        let part = ChipVariation {
            converter_noise: 0.0,
            ..ChipVariation::default()
        };
        let mut bench = Self::new(&[]);
        bench.chip.set_variation(part);
        bench.run_to(100_000);
        bench
    }

    /// Schedules changes of pins at these cycles.
    fn script(&mut self, script: &[(Cycles, Pin, Drive)]) {
        let change = |&(at, pin, drive)| (Time(at * CYCLE_PS), Change::Pin(pin, drive));
        self.circuit().due.extend(script.iter().map(change));
        self.chip.refresh();
    }

    /// Writes each value one cycle after the previous one, whatever time the access takes.
    fn write_all(&mut self, values: &[(u32, u32)]) {
        for (&(address, value), cycle) in values.iter().zip(self.cycle..) {
            self.cycle = cycle;
            self.write(address, value);
            self.cycle = cycle + 1;
        }
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

    /// Changes of a pin's drive from cycle `since` on; their cycles are relative to `since`.
    fn drives(&mut self, of: Pin, since: Cycles) -> Vec<(Cycles, Drive)> {
        let changes = self.circuit().drives.iter();
        let of_pin = changes.filter(|(_, pin, _)| *pin == of);
        let drives = of_pin.map(|(at, _, drive)| (at.0 / CYCLE_PS, *drive));
        let late = drives.filter(|(at, _)| *at >= since);
        late.map(|(at, drive)| (at - since, drive)).collect()
    }

    /// Sets up scans of the six channels PA0 to PA5, every 1000 cycles, into a circular buffer of 24 halfwords.
    fn scans(&mut self) {
        self.write_all(&[
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
            (DMA2 + 0x10, RING),
            (DMA2 + 0x10, RING | 1),
            (TIM2 + 0x2c, 999),
            (TIM2 + 0x14, 1),
            (TIM2 + 0x04, 2 << 4),
            (ADC1 + 0x08, 1 | 1 << 8 | 1 << 9 | 6 << 24 | 1 << 28),
        ]);
        self.run_to(self.cycle + 100);
    }
}

const PA8: Pin = Pin::new('A', 8);
const PB12: Pin = Pin::new('B', 12);

#[test]
fn timer_triggered_scans_fill_a_circular_buffer() {
    let mut bench = ChipBench::precise();
    bench.scans();
    let start = bench.cycle;
    bench.write_all(&[(TIM2, 1)]);
    // The timer counts from the next cycle on. A scan takes two converter clocks to start and six conversions of 27
    // clocks; one converter clock is four core cycles.
    let first = start + 1 + 1000;
    let scan = 4 * (2 + 6 * 27);
    for (at, halves) in [(first + scan - 1, 5), (first + scan, 6)] {
        bench.run_to(at);
        assert_eq!(bench.chip.conversions().regular, halves);
    }
    // The second scan fills half of the buffer.
    bench.run_to(first + 1000 + scan - 1);
    assert!(!bench.line(Interrupt::Dma2Stream0));
    bench.run_to(first + 1000 + scan);
    assert!(bench.line(Interrupt::Dma2Stream0));
    assert_eq!(bench.read(DMA2), 1 << 4);
    bench.write_all(&[(DMA2 + 8, 1 << 4)]);
    assert!(!bench.line(Interrupt::Dma2Stream0));
    bench.run_to(first + 3000 + scan);
    assert_eq!(bench.read(DMA2), 1 << 5);
    let scan =
        [0, 1, 2, 3, 4, 5].map(|channel| ScriptedCircuit::count(Pin::new('A', channel)) as u16);
    assert_eq!(bench.halves(SRAM, 24), scan.repeat(4));
    assert_eq!(bench.findings(), []);
}

#[test]
fn converter_and_stream_stop_without_their_clocks() {
    let mut bench = ChipBench::precise();
    bench.scans();
    bench.write_all(&[(TIM2, 1)]);
    bench.run_to(bench.cycle + 10_500);
    let before = bench.chip.conversions().regular;
    bench.write_all(&[(APB2ENR, 0)]);
    bench.run_to(bench.cycle + 10_000);
    assert_eq!(bench.chip.conversions().regular, before);
    bench.write_all(&[(APB2ENR, 1 << 8)]);
    bench.run_to(bench.cycle + 10_000);
    assert_eq!(bench.chip.conversions().regular, before + 60);
    // Without the clock of the DMA, the second result is an overrun.
    bench.write_all(&[(AHB1ENR, 1)]);
    bench.run_to(bench.cycle + 10_000);
    assert_eq!(bench.chip.conversions().overruns, 1);
    assert_eq!(bench.chip.conversions().regular, before + 62);
}

#[test]
fn converting_a_digital_pin_is_a_finding_once() {
    let mut bench = ChipBench::precise();
    bench.scans();
    bench.write_all(&[(PORT_A, 0xa800_0fcf), (TIM2, 1)]);
    bench.run_to(bench.cycle + 5_000);
    let found = [(
        FindingKind::Pin,
        "PA2 is converted but not in analogue mode",
    )];
    assert_eq!(bench.findings(), found);
}

/// Sets up PWM at PA8, conversions of PC0 triggered by OC4REF, and the break input PB12, as on a motor board. Returns
/// the cycle at which TIM1's counter starts.
fn pulses(bench: &mut ChipBench) -> Cycles {
    bench.write_all(&[
        (AHB1ENR, 7),
        (APB2ENR, 1 | 1 << 8),
        (PORT_A + 0x24, 1),
        (PORT_A, 0xa802_0000),
        (GPIOB + 0x24, 1 << 16),
        (GPIOB + 0x0c, 1 << 24 | 0x100),
        (GPIOB, 2 << 24 | 0x280),
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
    bench.run_to(bench.cycle + 200);
    bench.write_all(&[(TIM1, 1 << 5 | 1 << 7 | 1)]);
    bench.cycle
}

/// Bits of BDTR: MOE, BKP, BKE, OSSI.
const BDTR: u32 = 0xb400;

#[test]
fn break_stops_the_pwm_and_not_the_conversions() {
    let mut bench = ChipBench::precise();
    bench.script(&[(100_000, PB12, Drive::Low)]);
    let start = pulses(&mut bench);
    bench.script(&[
        (start + 1650, PB12, Drive::High),
        (start + 1651, PB12, Drive::Low),
    ]);
    bench.write_all(&[(TIM1 + 0x44, BDTR)]);
    bench.run_to(start + 8000);
    let edges = bench.drives(PA8, start + 2);
    let levels = [Drive::Low, Drive::High].into_iter().cycle();
    let expected = [98, 698, 898, 1498, 1648].into_iter().zip(levels);
    assert!(edges.iter().copied().eq(expected), "{edges:?}");
    assert_eq!(bench.read(TIM1 + 0x44), BDTR & 0x7fff);
    assert_eq!(bench.read(TIM1 + 0x10) & 1 << 7, 1 << 7);
    // OC4REF triggers one conversion in each PWM period of 800 cycles.
    assert_eq!(bench.chip.conversions().injected, 10);
    bench.write_all(&[(TIM1 + 0x10, 0), (TIM1 + 0x44, BDTR)]);
    let now = bench.cycle;
    bench.run_to(now + 2000);
    assert!(bench.drives(PA8, now).len() >= 4);
    assert_eq!(bench.findings(), []);
}

#[test]
fn reset_timer_releases_its_pin_and_keeps_the_break_level() {
    let mut bench = ChipBench::precise();
    bench.script(&[(100_000, PB12, Drive::Low)]);
    let start = pulses(&mut bench);
    bench.write_all(&[(TIM1 + 0x44, BDTR)]);
    bench.script(&[(start + 500, PB12, Drive::High)]);
    bench.run_to(start + 1000);
    bench.write_all(&[(APB2RSTR, 1), (APB2RSTR, 0)]);
    let drives = bench.drives(PA8, start + 1000);
    assert_eq!(drives, [(0, Drive::Open)]);
    bench.write_all(&[(TIM1 + 0x44, BDTR)]);
    assert_eq!(bench.read(TIM1 + 0x44), BDTR & 0x7fff);
}

#[test]
fn encoder_at_two_pins_is_counted() {
    let mut bench = ChipBench::precise();
    bench.write_all(&[
        (AHB1ENR, 4),
        (APB1ENR, 1 << 1),
        (PORT_C + 0x20, 2 << 24 | 2 << 28),
        (PORT_C, 2 << 12 | 2 << 14),
        (PORT_C + 0x0c, 1 << 12 | 1 << 14),
        (TIM3 + 0x18, 0xf1f1),
        (TIM3 + 0x20, 0x11),
        (TIM3 + 0x08, 3),
    ]);
    bench.run_to(bench.cycle + 1000);
    bench.write_all(&[(TIM3 + 0x24, 0), (TIM3, 1)]);
    let (a, b) = (Pin::new('C', 6), Pin::new('C', 7));
    let start = bench.cycle + 1000;
    let lines = [a, b].into_iter().cycle();
    let levels = [Drive::Low, Drive::Low, Drive::High, Drive::High];
    let edges = (0..400).zip(lines.zip(levels.into_iter().cycle()));
    let script = edges.map(|(k, (pin, drive))| (start + 400 * k, pin, drive));
    bench.script(&script.collect::<Vec<_>>());
    bench.run_to(start + 400 * 400);
    assert_eq!(bench.read(TIM3 + 0x24), 400);
    assert_eq!(bench.findings(), []);
}

#[test]
fn halted_core_stops_the_timers_selected_in_dbgmcu() {
    let mut bench = ChipBench::precise();
    bench.write_all(&[(APB1ENR, 3), (TIM2, 1), (TIM3, 1), (0xe004_2008, 1)]);
    let halt = bench.cycle;
    bench.chip.halt(true, halt);
    bench.run_to(halt + 1000);
    bench.chip.halt(false, halt + 1000);
    bench.run_to(halt + 1100);
    let counts = [TIM2, TIM3].map(|timer| {
        bench.cycle = halt + 1100;
        bench.read(timer + 0x24)
    });
    // The timers were started two cycles and one cycle before the halt.
    assert_eq!(counts, [102, 1101]);
}
