//! Interaction of the parts of the chip.

mod analog;
mod can;

use super::*;
use crate::core::{BusError, System, Transfer};
use crate::time::Cycles;
use std::collections::VecDeque;

/// A circuit with scheduled changes and a voltage for each channel; records the chip's drives and SPI words.
#[derive(Clone, Default)]
struct ScriptedCircuit {
    due: VecDeque<(Time, Change)>,
    volts: Option<f64>,
    drives: Vec<(Time, Pin, Drive)>,
    words: Vec<u16>,
}

impl ScriptedCircuit {
    /// 12-bit count of the voltage at a pin of port A.
    fn count(pin: Pin) -> u32 {
        300 + 500 * pin.number()
    }
}

#[derive(Clone, Copy)]
enum Change {
    Supply(f64),
    Crystal(bool),
    Pin(Pin, Drive),
}

impl Circuit for ScriptedCircuit {
    fn pin(&mut self, pin: Pin, drive: Drive, at: Time) {
        self.drives.push((at, pin, drive));
    }

    fn voltage(&mut self, pin: Pin, _at: Time) -> f64 {
        3.3 * f64::from(Self::count(pin)) / 4096.0
    }

    fn spi(&mut self, word: u16, _bits: u32, _at: Time) -> u16 {
        self.words.push(word);
        word ^ 0xff
    }

    fn next(&self) -> Time {
        self.due.front().map_or(Time::NEVER, |(at, _)| *at)
    }

    fn advance(&mut self, _at: Time, inputs: &mut Inputs) {
        match self.due.pop_front() {
            Some((_, Change::Supply(volts))) => {
                self.volts = Some(volts);
                inputs.supply = true;
            }
            Some((_, Change::Crystal(works))) => inputs.crystal = Some(works),
            Some((_, Change::Pin(pin, drive))) => inputs.pins.push((pin, drive)),
            None => {}
        }
    }

    fn supply(&mut self, _at: Time) -> f64 {
        self.volts.unwrap_or(3.3)
    }
}

/// A chip without a core, accessed over its bus.
struct ChipBench {
    chip: Chip,
    cycle: Cycles,
}

const RCC: u32 = 0x4002_3800;
const PWR: u32 = 0x4000_7000;
const FLASH_ACR: u32 = 0x4002_3c00;
const FLASH_KEYR: u32 = 0x4002_3c04;
const GPIOB: u32 = 0x4002_0400;
const PB13: Pin = Pin::new('B', 13);

impl ChipBench {
    /// A bench with scheduled changes, times in µs.
    fn new(changes: &[(u64, Change)]) -> Self {
        let due = changes.iter();
        let due = due.map(|(at, change)| (Time::from_micros(*at), *change));
        let circuit = ScriptedCircuit {
            due: due.collect(),
            ..ScriptedCircuit::default()
        };
        Self {
            chip: Chip::new(Box::new(circuit), 0),
            cycle: 0,
        }
    }

    fn circuit(&mut self) -> &mut ScriptedCircuit {
        self.chip.circuit().expect("the scripted circuit")
    }

    fn read(&mut self, address: u32) -> u32 {
        let read = self.chip.read(Transfer::word(address, 0), &mut self.cycle);
        read.expect("no bus error")
    }

    /// Writes a word, followed by a barrier.
    fn write(&mut self, address: u32, value: u32) {
        self.write_alone(address, value);
        self.chip.synchronise();
    }

    fn write_alone(&mut self, address: u32, value: u32) {
        let at = Transfer::word(address, 0);
        let done = self.chip.write(at, value, &mut self.cycle);
        done.expect("no bus error");
    }

    fn set(&mut self, address: u32, bits: u32) {
        let value = self.read(address) | bits;
        self.write(address, value);
    }

    fn run_to(&mut self, until: Cycles) {
        self.chip.advance(until, until);
        self.cycle = until;
    }

    /// Advances by `micros` µs, through resets. Returns the cause of the latest reset; `None` without a reset.
    fn pass(&mut self, micros: u64) -> Option<Cause> {
        let end = self.chip.time_of(self.cycle) + Time::from_micros(micros);
        let mut latest = None;
        loop {
            let until = self.chip.cycle_of(end);
            if self.cycle >= until {
                return latest;
            }
            let next = self.chip.advance(self.cycle, until);
            if let Some(cause) = self.chip.take_reset() {
                latest = Some(cause);
                self.chip.restart(cause, self.cycle);
            } else {
                self.cycle = next.clamp(self.cycle + 1, until);
            }
        }
    }

    /// Switches to 168 MHz from the crystal, with the wait states required.
    fn run_at_168_mhz(&mut self) {
        self.write(FLASH_ACR, 5);
        self.set(RCC, 1 << 16);
        self.pass(2_100);
        self.write(RCC + 0x04, 0x2740_2a04);
        self.set(RCC, 1 << 24);
        self.pass(150);
        self.write(RCC + 0x08, 0x0000_9402);
    }

    /// Configures PB13 as an output at high level.
    fn drive(&mut self) {
        self.set(RCC + 0x30, 2);
        self.set(GPIOB + 0x14, 1 << 13);
        self.set(GPIOB, 1 << 26);
    }

    /// Latest change of a pin's drive by the chip.
    fn last_drive(&mut self) -> Option<(Pin, Drive)> {
        let change = self.circuit().drives.last()?;
        Some((change.1, change.2))
    }

    fn unlock(&mut self) {
        self.write(FLASH_KEYR, 0x4567_0123);
        self.write(FLASH_KEYR, 0xcdef_89ab);
    }

    fn causes(&mut self) -> u32 {
        self.read(RCC + 0x74) >> 24
    }

    fn findings(&self) -> Vec<(FindingKind, &str)> {
        let list = self.chip.findings().list();
        list.iter().map(|f| (f.kind, f.text.as_str())).collect()
    }
}

#[test]
fn core_is_released_after_power_on_and_clock_reaches_168_mhz() {
    let mut bench = ChipBench::new(&[]);
    assert!(bench.chip.is_held());
    bench.pass(1_501);
    assert!(!bench.chip.is_held());
    bench.run_at_168_mhz();
    assert!(bench.chip.must_stop(), "who runs it must look at the clock");
    bench.chip.advance(bench.cycle, bench.cycle);
    bench.chip.advance(bench.cycle, bench.cycle);
    assert!(!bench.chip.must_stop());
    assert_eq!(bench.chip.clocks().hclk_hz, 168_000_000);
    let clocks = bench.chip.shared.clocks;
    assert_eq!([clocks.apb1, clocks.apb2], [4, 2]);
    assert_eq!([clocks.timer1, clocks.timer2], [2, 1]);
    let [before, after] = [0, 168].map(|later| bench.chip.time_of(bench.cycle + later));
    assert_eq!(after - before, Time(1_000_000));
    assert!(bench.findings().is_empty(), "{:?}", bench.findings());
}

#[test]
fn wrong_wait_states_for_clock_and_supply_are_a_finding() {
    let cases = [
        (5, 3.3, 0),
        (4, 3.3, 1),
        (7, 3.3, 1),
        (5, 2.6, 1),
        (6, 2.6, 0),
    ];
    for (acr, volts, findings) in cases {
        let mut bench = ChipBench::new(&[]);
        bench.circuit().volts = Some(volts);
        bench.pass(1_600);
        bench.chip.restart(Cause::Pin, bench.cycle);
        bench.run_at_168_mhz();
        bench.write(FLASH_ACR, acr);
        // Too many wait states are a finding only when the frequency rises, so the core leaves the PLL and returns.
        bench.write(RCC + 0x08, 0x0000_9400);
        bench.write(RCC + 0x08, 0x0000_9402);
        let (found, start) = (bench.findings(), format!("{acr} wait"));
        let about = found.iter().filter(|(_, text)| text.starts_with(&start));
        assert_eq!(about.count(), findings, "{acr} {volts} {found:?}");
    }
}

#[test]
fn regulator_scale_2_at_168_mhz_is_a_finding() {
    let mut bench = ChipBench::new(&[]);
    bench.run_at_168_mhz();
    bench.set(RCC + 0x40, 1 << 28);
    bench.write(PWR, 0);
    assert_eq!(bench.findings()[0].0, FindingKind::ClockLimit);
}

#[test]
fn crystal_failure_raises_the_nmi_and_switches_to_the_internal_oscillator() {
    let mut bench = ChipBench::new(&[(10_000, Change::Crystal(false))]);
    bench.run_at_168_mhz();
    bench.set(RCC, 1 << 19);
    bench.pass(10_000);
    assert_eq!(bench.chip.clocks().hclk_hz, 16_000_000);
    assert!(bench.chip.take_nmi() && !bench.chip.take_nmi());
    assert_eq!(bench.read(RCC + 0x0c), 1 << 7);
    bench.write(RCC + 0x0c, 1 << 23);
    assert_eq!(bench.read(RCC + 0x0c), 0);
    assert!(bench.findings().is_empty(), "{:?}", bench.findings());
}

#[test]
fn crystal_failure_without_clock_security_stalls_until_the_watchdog_resets() {
    let mut bench = ChipBench::new(&[(10_000, Change::Crystal(false))]);
    bench.run_at_168_mhz();
    bench.write(0x4000_3000, 0xcccc);
    assert_eq!(bench.pass(500_000), None);
    assert!(bench.chip.is_held());
    // The timeout is 512 ms from the start.
    assert_eq!(bench.pass(20_000), Some(Cause::Watchdog));
    assert!(!bench.chip.is_held());
    assert_eq!(bench.chip.clocks().hclk_hz, 16_000_000);
    assert_eq!(bench.causes(), 0x2e);
}

#[test]
fn brown_out_releases_the_pins_until_the_supply_recovers() {
    let mut bench = ChipBench::new(&[
        (10_000, Change::Supply(1.9)),
        (11_000, Change::Supply(1.65)),
        (12_000, Change::Supply(1.71)),
        (13_000, Change::Supply(3.3)),
    ]);
    bench.pass(2_000);
    bench.write(SRAM, 0x1234_5678);
    bench.drive();
    bench.pass(8_500);
    assert!(!bench.chip.is_held(), "brown-out is off in a new chip");
    bench.pass(1_000);
    assert!(bench.chip.is_held() && bench.chip.must_stop());
    assert_eq!(bench.last_drive(), Some((PB13, Drive::Open)));
    bench.pass(1_000);
    assert!(bench.chip.is_held(), "hysteresis");
    assert_eq!(bench.pass(1_000), Some(Cause::PowerOn));
    bench.pass(2_000);
    assert!(!bench.chip.is_held());
    assert_eq!((bench.causes(), bench.read(SRAM)), (0x0e, 0x1234_5678));
}

/// The supply fails after the start of an instruction and before the instruction's access.
#[test]
fn access_after_a_brown_out_is_no_finding() {
    let mut bench = ChipBench::new(&[(10_000, Change::Supply(1.6))]);
    bench.pass(2_000);
    bench.drive();
    bench.pass(7_999);
    bench.cycle = bench.chip.cycle_of(Time::from_micros(10_001));
    bench.read(GPIOB + 0x10);
    assert!(bench.chip.is_held());
    assert_eq!(bench.findings(), []);
}

#[test]
fn memory_loses_its_content_below_the_retention_voltage() {
    let changes = [(10_000, Change::Supply(1.0)), (20_000, Change::Supply(3.3))];
    let mut bench = ChipBench::new(&changes);
    for k in 0..16 {
        bench.write(SRAM + 4 * k, 0);
    }
    assert_eq!(bench.pass(30_000), Some(Cause::PowerOn));
    let kept = (0..16).filter(|k| bench.read(SRAM + 4 * k) == 0);
    assert_eq!(kept.count(), 0);
}

#[test]
fn configured_brown_out_level_holds_the_chip_in_reset() {
    let mut bench = ChipBench::new(&[
        (10_000, Change::Supply(2.7)),
        (20_000, Change::Supply(3.0)),
        (40_000, Change::Supply(1.0)),
        (50_000, Change::Supply(2.5)),
        (60_000, Change::Supply(3.0)),
    ]);
    let variation = ChipVariation {
        brown_out: 0,
        ..ChipVariation::default()
    };
    bench.chip.set_variation(variation);
    assert_eq!(bench.read(FLASH_ACR + 0x14), 0x0fff_aae1);
    bench.pass(15_000);
    assert!(bench.chip.is_held());
    assert_eq!(bench.pass(10_000), Some(Cause::BrownOut));
    bench.pass(30_000);
    assert!(bench.chip.is_held());
    assert_eq!(bench.pass(10_000), Some(Cause::PowerOn));
}

#[test]
fn peripheral_held_in_reset_has_reset_values_and_access_is_a_finding() {
    let mut bench = ChipBench::new(&[]);
    bench.drive();
    bench.write(RCC + 0x10, 2);
    assert_eq!(bench.last_drive(), Some((PB13, Drive::Open)));
    bench.read(GPIOB);
    let held = (
        FindingKind::Forbidden,
        "GPIOB: the program holds it in reset",
    );
    assert_eq!(bench.findings(), [held]);
    bench.write(RCC + 0x10, 0);
    assert_eq!(bench.read(GPIOB), 0x280);
    assert_eq!(bench.findings().len(), 1);
}

#[test]
fn an_access_right_after_the_clock_was_switched_on_is_found() {
    const WWDG_CR: u32 = 0x4000_2c00;
    let early = |cycles: u64, barrier: bool| {
        let mut bench = ChipBench::new(&[]);
        bench.write_alone(RCC + 0x40, 1 << 11);
        if barrier {
            bench.chip.synchronise();
        }
        bench.cycle += cycles;
        bench.write_alone(WWDG_CR, 0xff);
        bench.write_alone(WWDG_CR, 0xff);
        let found = bench.findings().into_iter();
        found
            .map(|(kind, text)| (kind, text.to_owned()))
            .collect::<Vec<_>>()
    };
    // Nine cycles between enabling the clock and the access are within the margin.
    let found = early(9, false);
    assert_eq!(found.len(), 1, "{found:?}");
    assert_eq!(found[0].0, FindingKind::Forbidden);
    assert!(found[0].1.starts_with("WWDG: accessed"), "{found:?}");
    assert_eq!(early(100, false), []);
    assert_eq!(early(0, true), []);
}

#[test]
fn wrong_flash_key_is_a_bus_error_and_locks_until_reset() {
    let mut bench = ChipBench::new(&[]);
    let key = Transfer::word(FLASH_KEYR, 0);
    let wrong = bench.chip.write(key, 1, &mut bench.cycle);
    assert_eq!(wrong, Err(BusError));
    bench.chip.restart(Cause::Software, bench.cycle);
    bench.unlock();
    assert_eq!(bench.read(FLASH_ACR + 0x10), 0);
}

#[test]
fn flash_write_stalls_the_core_and_reports_changed_code() {
    let mut bench = ChipBench::new(&[]);
    bench.chip.take_changed_code();
    bench.unlock();
    bench.write(FLASH_ACR + 0x10, 2 << 8 | 1);
    bench.write(FLASH + 0x8000, 0xbf00_bf00);
    let before = bench.cycle;
    bench.chip.enter_line(FLASH + 0x100, &mut bench.cycle);
    // Programming takes 16 µs, 256 cycles at 16 MHz.
    assert!((250..=256).contains(&(bench.cycle - before)));
    let changed = bench.chip.take_changed_code();
    assert_eq!(changed, Some((FLASH + 0x8000, FLASH + 0x8003)));
    assert_eq!(bench.chip.fetch(FLASH + 0x8002), Ok(0xbf00));
}

#[test]
fn unmodelled_peripheral_is_a_finding_and_unmapped_address_a_bus_error() {
    let mut bench = ChipBench::new(&[]);
    assert_eq!(bench.read(0x4001_1000), 0);
    bench.write(0x4000_5400, 1);
    let nowhere = Transfer::word(0x3000_0000, 0);
    let nothing = bench.chip.read(nowhere, &mut bench.cycle);
    assert_eq!(nothing, Err(BusError));
    let kinds = bench.chip.shared.kinds();
    assert_eq!(kinds[..2], [FindingKind::NotModelled; 2]);
    assert_eq!(kinds[2..], [FindingKind::Unmapped]);
}

#[test]
fn backup_domain_write_needs_dbp() {
    let mut bench = ChipBench::new(&[]);
    for written in [0, 0x8200] {
        bench.write(RCC + 0x70, 0x8200);
        assert_eq!(bench.read(RCC + 0x70), written);
        assert_eq!(bench.findings().len(), 1);
        bench.set(RCC + 0x40, 1 << 28);
        bench.set(PWR, 1 << 8);
    }
}

#[test]
fn halted_core_stops_the_watchdog_if_dbgmcu_says_so() {
    for (stops, cause) in [(false, Some(Cause::Watchdog)), (true, None)] {
        let mut bench = ChipBench::new(&[]);
        bench.write(0xe004_2008, u32::from(stops) << 12);
        bench.write(0x4000_3000, 0xcccc);
        bench.chip.halt(true, bench.cycle);
        assert_eq!(bench.pass(1_000_000), cause);
    }
}

#[test]
fn same_seed_gives_the_same_memory_and_identifier() {
    let memory = |seed: u64| {
        let mut bench = ChipBench::new(&[]);
        bench.chip.set_variation(ChipVariation {
            seed,
            ..ChipVariation::default()
        });
        (bench.read(SRAM), bench.read(0x1fff_7a14))
    };
    assert_eq!(memory(5), memory(5));
    assert_ne!(memory(5), memory(6));
}

#[test]
fn crystal_failure_clears_moe_of_tim1_if_break_is_enabled() {
    const TIM1: u32 = 0x4001_0000;
    const BKE: u32 = 1 << 12;
    const MOE: u32 = 1 << 15;
    // The break input is not connected; with this polarity a low input is inactive.
    const BKP: u32 = 1 << 13;
    for (bdtr, goes_on) in [(MOE | BKP, true), (MOE | BKP | BKE, false)] {
        let mut bench = ChipBench::new(&[(10_000, Change::Crystal(false))]);
        bench.run_at_168_mhz();
        bench.set(RCC, 1 << 19);
        bench.set(RCC + 0x44, 1);
        bench.write(TIM1 + 0x44, bdtr);
        assert_ne!(bench.read(TIM1 + 0x44) & MOE, 0);
        bench.pass(10_000);
        assert_eq!(bench.read(TIM1 + 0x44) & MOE != 0, goes_on);
    }
}

#[test]
fn flash_control_write_stalls_until_the_operation_ends() {
    let mut bench = ChipBench::new(&[]);
    bench.unlock();
    bench.write(FLASH_ACR + 0x10, 2 << 8 | 1);
    bench.write(FLASH, 0);
    let before = bench.cycle;
    bench.write(FLASH_ACR + 0x10, 0);
    // Programming takes 16 µs, 256 cycles at 16 MHz.
    assert!((250..=257).contains(&(bench.cycle - before)));
    let before = bench.cycle;
    bench.write(FLASH_ACR + 0x10, 0);
    assert!(bench.cycle - before < 10);
}
