//! Expected times are calculated from RM0090 and the data sheet. A regular conversion starts two clocks after its
//! trigger, an injected one three. One clock of the converter is two core cycles.

use super::*;
use crate::chip::circuit::Circuit;
use crate::chip::pin::Pin;

/// A circuit with a voltage of 100 counts times the channel number at each pin.
#[derive(Clone)]
struct Levels;

impl Circuit for Levels {
    fn voltage(&mut self, pin: Pin, _at: Time) -> f64 {
        let channel = match pin.port() {
            0 => pin.number(),
            1 => 8 + pin.number(),
            _ => 10 + pin.number(),
        };
        3.3 * f64::from(100 * channel) / 4096.0
    }
}

/// Response of the DMA stream to a request: reads the result or not.
#[derive(Clone, Copy, PartialEq)]
enum Stream {
    Fetches,
    Sleeps,
}

struct AdcBench {
    adc: Adc,
    shared: Shared,
    /// Cycles of the DMA requests.
    asked: Vec<Cycles>,
    data: Vec<u32>,
    stream: Stream,
}

/// CR1 of the bench: scan mode, interrupts of injected group and overrun.
const SCANNED: u32 = SCAN | JEOCIE | OVRIE;
/// CR2 of the bench: trigger by TIM2, DMA.
const STREAMED: u32 = ADON | DMA | DDS | 6 << 24 | 1 << 28;

impl AdcBench {
    /// A noiseless converter. Regular channels 1 and 2 sample for 15 clocks, injected channel 3 for 28.
    fn new(cr1: u32, cr2: u32) -> Self {
        let mut bench = Self {
            adc: Adc::default(),
            shared: Shared::new(Box::new(Levels), 0),
            asked: Vec::new(),
            data: Vec::new(),
            stream: Stream::Fetches,
        };
        bench.shared.variation.converter_noise = 0.0;
        bench.write(&[
            (SMPR2, 1 << 3 | 1 << 6 | 2 << 9),
            (SQR1, 1 << 20),
            (SQR3, 1 | 2 << 5),
            (JSQR, 3 << 15),
            (CR1, cr1),
            (CR2, cr2),
        ]);
        bench.pass(1000);
        bench
    }

    fn write(&mut self, values: &[(u32, u32)]) -> &mut Self {
        for &(offset, value) in values {
            self.adc.write(offset, value, !0, &mut self.shared);
        }
        self.serve();
        self
    }

    /// Sets bits of CR2.
    fn command(&mut self, bits: u32) -> &mut Self {
        let cr2 = self.adc.cr2();
        self.write(&[(CR2, cr2 | bits)])
    }

    fn read(&mut self, offset: u32) -> u32 {
        self.adc.read(offset, &mut self.shared)
    }

    fn trigger(&mut self) -> &mut Self {
        self.adc
            .trigger(timer::TimerId::Tim2, true, &mut self.shared);
        self
    }

    fn serve(&mut self) {
        while let Some(effect) = self.shared.effects.pop_front() {
            if effect == Effect::Dma(Request::Adc1) {
                self.asked.push(self.shared.now);
                if self.stream == Stream::Fetches {
                    let datum = self.read(DR);
                    self.data.push(datum);
                }
            }
        }
    }

    /// Advances to `end`, inclusive.
    fn pass(&mut self, end: Cycles) -> &mut Self {
        while self.shared.arrive(Unit::Adc, end) {
            self.adc.event(&mut self.shared);
            self.serve();
        }
        self
    }

    fn interrupted(&self) -> bool {
        self.shared.lines == 1 << Interrupt::Adc as u32
    }
}

#[test]
fn voltage_is_taken_at_the_end_of_sampling() {
    /// A voltage that rises by one count in each cycle at 16 MHz.
    #[derive(Clone)]
    struct Ramp;
    impl Circuit for Ramp {
        fn voltage(&mut self, _pin: Pin, at: Time) -> f64 {
            3.3 * at.seconds() * 16e6 / 4096.0
        }
    }
    let mut bench = AdcBench::new(SCANNED, STREAMED);
    bench.shared.replace_circuit(Box::new(Ramp));
    bench.trigger().pass(2000);
    assert_eq!(bench.data, [1000 + 4 + 30, 1000 + 4 + 84]);
}

#[test]
fn injected_group_interrupts_and_the_regular_conversion_restarts() {
    let mut bench = AdcBench::new(SCANNED, STREAMED);
    bench.trigger().pass(1070).command(JSWSTART).pass(1070 + 86);
    // 86 cycles: 3 clocks to start, 28 to sample, 12 to convert.
    assert!(bench.interrupted());
    assert_eq!(bench.read(JDR1), 300);
    bench.pass(2000);
    // The second regular conversion was aborted and restarts.
    assert_eq!(bench.asked, [1058, 1070 + 86 + 54]);
    assert_eq!(bench.data, [100, 200]);
    bench.write(&[(SR, !JEOC)]);
    assert!(!bench.interrupted());
}

#[test]
fn regular_trigger_waits_for_the_injected_group() {
    let mut bench = AdcBench::new(SCANNED, STREAMED);
    bench.command(JSWSTART).pass(1010).trigger().pass(2000);
    assert_eq!(bench.asked, [1086 + 54, 1086 + 108]);
}

#[test]
fn short_injected_sequence_ends_with_jsq4() {
    let mut bench = AdcBench::new(SCANNED, STREAMED);
    // A sequence of two channels uses JSQ3 and JSQ4.
    bench.write(&[(JSQR, 1 << 20 | 9 << 10 | 12 << 15)]);
    bench.command(JSWSTART).pass(2000);
    assert_eq!((bench.read(JDR1), bench.read(0x40)), (900, 1200));
}

#[test]
fn trigger_acts_on_the_selected_edges() {
    for (edges, rising, falling) in [(0, 0, 0), (1, 1, 0), (2, 0, 1), (3, 1, 1)] {
        let mut bench = AdcBench::new(0, ADON | 1 << 16 | edges << 20);
        for (level, end, injected) in [(true, 1500, rising), (false, 2000, rising + falling)] {
            let AdcBench { adc, shared, .. } = &mut bench;
            adc.trigger(timer::TimerId::Tim1, level, shared);
            bench.pass(end);
            assert_eq!(bench.adc.counts().injected, injected);
        }
    }
}

#[test]
fn unread_result_is_an_overrun_that_stops_the_regular_group() {
    let mut bench = AdcBench::new(SCANNED, STREAMED);
    bench.stream = Stream::Sleeps;
    bench.trigger().pass(2000);
    assert_eq!(bench.read(SR) & OVR, OVR);
    assert!(bench.interrupted());
    assert_eq!(bench.shared.kinds(), [FindingKind::Lost]);
    // Regular triggers are ignored; the injected group is not affected.
    bench.trigger().command(JSWSTART).pass(3000);
    let counts = bench.adc.counts();
    assert_eq!(
        [counts.regular, counts.injected, counts.overruns],
        [2, 1, 1]
    );
    // After the flag is cleared, conversions run without DMA requests.
    bench.stream = Stream::Fetches;
    bench.asked.clear();
    bench.write(&[(SR, 0)]).trigger().pass(4000);
    assert!(bench.asked.is_empty());
    let cr2 = bench.adc.cr2();
    bench.write(&[(CR2, cr2 & !DMA), (SR, 0), (CR2, cr2)]);
    bench.trigger().pass(5000);
    assert_eq!(bench.asked.len(), 2);
}

#[test]
fn overrun_is_detected_with_eocs_and_not_without() {
    let mut bench = AdcBench::new(SCANNED, ADON);
    bench.command(SWSTART).pass(2000);
    assert_eq!(bench.read(SR), STRT | EOC);
    assert_eq!(bench.read(DR), 200, "the last of the sequence");
    let mut bench = AdcBench::new(SCANNED, ADON | EOCS);
    bench.command(SWSTART).pass(1058);
    assert_eq!(bench.read(SR), STRT | EOC);
    bench.pass(2000);
    assert_eq!(bench.read(SR), STRT | EOC | OVR);
    assert_eq!(bench.read(DR), 100);
    assert_eq!(bench.read(SR), STRT | OVR);
}

#[test]
fn block_end_without_dds_stops_requests_and_overruns() {
    let mut bench = AdcBench::new(SCANNED, STREAMED & !DDS);
    bench.trigger().pass(2000);
    bench.adc.block_ended();
    bench.trigger().pass(3000);
    assert_eq!((bench.asked.len(), bench.adc.counts().regular), (2, 4));
    assert_eq!(bench.read(SR) & OVR, 0);
}

#[test]
fn enabling_an_unmodelled_feature_is_a_finding() {
    for (offset, value) in [
        (CR1, 1 << 10),
        (CR1, 1 << 11),
        (CR1, 1 << 23),
        (CR1, 1 << 24),
        (CR2, ALIGN),
        (CR2, CONT),
        (JOFR1, 301),
        (CR2, 15 << 24 | 1 << 28),
        (CR2, 15 << 16 | 1 << 20),
        (CCR, 1),
        (CCR, 1 << 23),
    ] {
        let mut bench = AdcBench::new(0, 0);
        bench.write(&[(offset, value)]);
        assert_eq!(
            bench.shared.kinds(),
            [FindingKind::NotModelled],
            "{value:#x}"
        );
    }
}

#[test]
fn trigger_during_its_own_group_is_lost() {
    let mut bench = AdcBench::new(SCANNED, STREAMED);
    bench.trigger().pass(1020).trigger().pass(2000);
    assert_eq!(bench.asked, [1058, 1112]);
    assert_eq!(bench.shared.kinds(), [FindingKind::Lost]);
    let mut bench = AdcBench::new(SCANNED, STREAMED);
    bench.command(JSWSTART).pass(1020);
    bench.command(JSWSTART).pass(2000);
    assert_eq!(bench.adc.counts().injected, 1);
    assert_eq!(bench.shared.kinds(), [FindingKind::Lost]);
}

#[test]
fn violated_limits_of_clock_and_start_up_are_findings() {
    let mut bench = AdcBench::new(SCANNED, STREAMED);
    bench.shared.clocks.hclk_hz = 168_000_000;
    bench.trigger();
    assert_eq!(bench.shared.kinds(), [FindingKind::ClockLimit]);
    // 21 MHz exceeds the limit below 2.4 V.
    for (volts, found) in [(3.3, vec![]), (2.0, vec![FindingKind::ClockLimit])] {
        let mut bench = AdcBench::new(SCANNED, STREAMED);
        bench.shared.clocks.hclk_hz = 42_000_000;
        bench.shared.volts = volts;
        bench.trigger();
        assert_eq!(bench.shared.kinds(), found);
    }
    let mut bench = AdcBench::new(SCANNED, 0);
    bench.write(&[(CR2, ADON)]).pass(1047).command(SWSTART);
    assert_eq!(bench.shared.kinds(), [FindingKind::Forbidden]);
}

#[test]
fn settings_changed_during_a_conversion_are_a_finding() {
    for write in [(SQR3, 5), (SMPR2, 0), (CCR, 1 << 16)] {
        let mut bench = AdcBench::new(SCANNED, STREAMED);
        bench.trigger().pass(1010).write(&[write]);
        assert_eq!(bench.shared.kinds(), [FindingKind::Forbidden], "{write:?}");
    }
    // A sequence written during a scan starts at its first channel.
    let mut bench = AdcBench::new(SCANNED, STREAMED);
    bench.trigger().pass(1070).write(&[(SQR3, 2 | 1 << 5)]);
    bench.pass(2000);
    assert_eq!(bench.data, [100, 200, 100]);
}

#[test]
fn conversion_pauses_while_the_clock_is_off() {
    let mut bench = AdcBench::new(SCANNED, STREAMED);
    bench.trigger().pass(1050);
    bench.adc.gate(true, &mut bench.shared);
    bench.pass(1500).trigger().pass(2000);
    bench.adc.gate(false, &mut bench.shared);
    bench.pass(2007);
    assert!(bench.asked.is_empty());
    bench.pass(2100);
    assert_eq!(bench.asked, [2008, 2062]);
}
