//! Analogue converter ADC1.
//!
//! Source: reference manual RM0090, chapter 13, and the data sheet. A conversion samples for the time of
//! SMPRx, then takes twelve clocks; the voltage is taken at the instant at which sampling ends. The
//! converter has 10.8 effective bits: normal noise of 0.6 counts besides its own steps.
//!
//! Not modelled: ADC2 and ADC3, dual modes, discontinuous and automatic injected mode, analogue watchdog,
//! left alignment, offsets of injected channels, falling edges of triggers; switching one on is a finding.
//! The time from a trigger to the start, two to three clocks, is left out.

use super::Peripheral;
use super::interrupt::Interrupt;
use super::pin::Pin;
use super::register::{Register, merge, narrow, word};
use super::shared::{Effect, Request, Shared, Source, Trigger};
use crate::finding::Kind;
use crate::time::{Cycles, NEVER, Time};

#[rustfmt::skip]
const REGISTERS: &[Register] = &[
    word(0x00, "SR", 0x3f), word(0x04, "CR1", 0x07c0_ffff), word(0x08, "CR2", 0x7f7f_0f03), word(0x0c, "SMPR1", 0x07ff_ffff),
    word(0x10, "SMPR2", 0x3fff_ffff), word(0x14, "JOFR1", 0xfff), word(0x18, "JOFR2", 0xfff), word(0x1c, "JOFR3", 0xfff),
    word(0x20, "JOFR4", 0xfff), word(0x24, "HTR", 0xfff), word(0x28, "LTR", 0xfff), word(0x2c, "SQR1", 0x00ff_ffff),
    word(0x30, "SQR2", 0x3fff_ffff), word(0x34, "SQR3", 0x3fff_ffff), word(0x38, "JSQR", 0x003f_ffff),
    word(0x3c, "JDR1", 0xffff), word(0x40, "JDR2", 0xffff), word(0x44, "JDR3", 0xffff), word(0x48, "JDR4", 0xffff),
    narrow(0x4c, "DR", 0xffff), word(0x300, "CSR", 0x003f_3f3f), word(0x304, "CCR", 0x00c3_ef1f), word(0x308, "CDR", !0),
];

// Bits of SR.
const EOC: u32 = 1 << 1;
const JEOC: u32 = 1 << 2;
const JSTRT: u32 = 1 << 3;
const STRT: u32 = 1 << 4;
const OVR: u32 = 1 << 5;
// Bits of CR1.
const EOCIE: u32 = 1 << 5;
const JEOCIE: u32 = 1 << 7;
const SCAN: u32 = 1 << 8;
const OVRIE: u32 = 1 << 26;
// Bits of CR2.
const ADON: u32 = 1;
const CONT: u32 = 1 << 1;
const DMA: u32 = 1 << 8;
const DDS: u32 = 1 << 9;
const EOCS: u32 = 1 << 10;
const JSWSTART: u32 = 1 << 22;
const SWSTART: u32 = 1 << 30;

/// Clocks of sampling, by SMPx.
const SAMPLING: [u64; 8] = [3, 15, 28, 56, 84, 112, 144, 480];
/// Clocks of a conversion of 12 bits.
const CONVERSION: u64 = 12;
/// From switching on to the first conversion.
const STABILISATION: Time = Time::from_micros(3);
/// Largest clock, Hz.
const MOST_HZ: u64 = 36_000_000;
/// Normal noise, counts rms.
const NOISE: f64 = 0.6;
/// Voltages of the channels inside the chip, V: temperature at 25 °C, reference, half the battery.
const INSIDE: [f64; 3] = [0.76, 1.21, 1.65];

#[rustfmt::skip]
const REGULAR: [Option<Trigger>; 16] = [
    Some(Trigger::Tim1Cc1), Some(Trigger::Tim1Cc2), Some(Trigger::Tim1Cc3), Some(Trigger::Tim2Cc2),
    Some(Trigger::Tim2Cc3), Some(Trigger::Tim2Cc4), Some(Trigger::Tim2Trgo), Some(Trigger::Tim3Cc1),
    Some(Trigger::Tim3Trgo), Some(Trigger::Tim4Cc4), Some(Trigger::Tim5Cc1), Some(Trigger::Tim5Cc2),
    Some(Trigger::Tim5Cc3), None, None, Some(Trigger::Exti11),
];

#[rustfmt::skip]
const INJECTED: [Option<Trigger>; 16] = [
    Some(Trigger::Tim1Cc4), Some(Trigger::Tim1Trgo), Some(Trigger::Tim2Cc1), Some(Trigger::Tim2Trgo),
    Some(Trigger::Tim3Cc2), Some(Trigger::Tim3Cc4), Some(Trigger::Tim4Cc1), Some(Trigger::Tim4Cc2),
    Some(Trigger::Tim4Cc3), Some(Trigger::Tim4Trgo), Some(Trigger::Tim5Cc4), Some(Trigger::Tim5Trgo),
    None, None, None, Some(Trigger::Exti15),
];

/// The pin of a channel; the last three are inside the chip.
fn pin(channel: u32) -> Option<Pin> {
    match channel {
        0..=7 => Some(Pin::of(0, channel)),
        8 | 9 => Some(Pin::of(1, channel - 8)),
        10..=15 => Some(Pin::of(2, channel - 10)),
        _ => None,
    }
}

/// A group of channels that is being converted.
#[derive(Clone, Copy, Debug, Default)]
struct Group {
    /// Place in the sequence, while it runs.
    place: Option<u32>,
    /// The voltage that was sampled, as a count, once sampling has ended.
    sampled: Option<u16>,
}

/// The converter.
pub(crate) struct Adc {
    /// Registers that only hold what is written, by offset over 4.
    plain: [u32; 20],
    common: u32,
    sr: u32,
    dr: u32,
    injected_data: [u32; 4],
    regular: Group,
    injected: Group,
    stable: Time,
    /// The stream ended its block, and DDS asks for no more.
    ended: bool,
    reference_v: f64,
    random: u64,
    checked: u32,
    /// When the injected group was started last.
    started: Cycles,
    /// Conversions of both groups so far, and those that were lost.
    counts: Counts,
}

/// Conversions so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Of the regular group.
    pub regular: u64,
    /// Of the injected group.
    pub injected: u64,
    /// Overruns.
    pub overruns: u64,
}

impl Default for Adc {
    fn default() -> Self {
        Self {
            plain: [0; 20],
            common: 0,
            sr: 0,
            dr: 0,
            injected_data: [0; 4],
            regular: Group::default(),
            injected: Group::default(),
            stable: Time::NEVER,
            ended: false,
            reference_v: 3.3,
            random: 0x2545_f491_4f6c_dd1d,
            checked: 0,
            started: 0,
            counts: Counts::default(),
        }
    }
}

impl Adc {
    fn cr1(&self) -> u32 {
        self.plain[1]
    }

    fn cr2(&self) -> u32 {
        self.plain[2]
    }

    /// Conversions so far.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// When the injected group was started last.
    pub fn started(&self) -> Cycles {
        self.started
    }

    /// Analogue supply, V, which is the reference too.
    pub fn set_reference(&mut self, volts: f64) {
        self.reference_v = volts.max(0.1);
    }

    /// Cycles of the core in one of the converter's clock.
    fn clock(&self, shared: &Shared) -> u64 {
        shared.clocks.apb2 * 2 * (u64::from(self.common >> 16 & 3) + 1)
    }

    fn sampling(&self, channel: u32) -> u64 {
        let bits = match channel {
            0..=9 => self.plain[4] >> (3 * channel),
            _ => self.plain[3] >> (3 * (channel.min(18) - 10)),
        };
        SAMPLING[bits as usize & 7]
    }

    /// Clocks of a conversion after sampling, by RES.
    fn conversion(&self) -> u64 {
        CONVERSION - 2 * u64::from(self.cr1() >> 24 & 3)
    }

    /// Channel at a place of the regular sequence.
    fn regular_channel(&self, place: u32) -> u32 {
        let register = match place {
            0..=5 => self.plain[13] >> (5 * place),
            6..=11 => self.plain[12] >> (5 * (place - 6)),
            _ => self.plain[11] >> (5 * (place - 12)),
        };
        register & 31
    }

    fn regular_length(&self) -> u32 {
        match self.cr1() & SCAN {
            0 => 1,
            _ => (self.plain[11] >> 20 & 15) + 1,
        }
    }

    fn injected_length(&self) -> u32 {
        match self.cr1() & SCAN {
            0 => 1,
            _ => (self.plain[14] >> 20 & 3) + 1,
        }
    }

    /// Channel at a place of the injected sequence: a short one ends with JSQ4.
    fn injected_channel(&self, place: u32) -> u32 {
        let length = (self.plain[14] >> 20 & 3) + 1;
        self.plain[14] >> (5 * (4 - length + place)) & 31
    }

    /// A trigger fired.
    pub fn trigger(&mut self, trigger: Trigger, shared: &mut Shared) {
        let cr2 = self.cr2();
        if cr2 & ADON == 0 {
            return;
        }
        if cr2 >> 20 & 1 != 0 && INJECTED[(cr2 >> 16 & 15) as usize] == Some(trigger) {
            self.start_injected(shared);
        }
        if cr2 >> 28 & 1 != 0 && REGULAR[(cr2 >> 24 & 15) as usize] == Some(trigger) {
            self.start_regular(shared);
        }
    }

    fn judge_start(&mut self, shared: &mut Shared) {
        if shared.time() < self.stable {
            shared.note(
                Kind::Forbidden,
                "ADC1: a conversion starts within 3 µs of ADON",
            );
        }
        let hz = shared.clocks.hclk_hz / self.clock(shared);
        if hz > MOST_HZ {
            shared.note(
                Kind::ClockLimit,
                format!("ADC1 clock {hz} Hz: must be at most {MOST_HZ} Hz"),
            );
        }
    }

    fn start_injected(&mut self, shared: &mut Shared) {
        if self.injected.place.is_some() {
            shared.note(
                Kind::Lost,
                "ADC1: injected trigger while the group is converted",
            );
            return;
        }
        self.judge_start(shared);
        self.sr |= JSTRT;
        self.started = shared.now;
        self.injected = Group {
            place: Some(0),
            sampled: None,
        };
        // What the regular group is at begins anew afterwards.
        self.regular.sampled = None;
        shared.schedule(Source::Adc, NEVER);
        self.sample_next(shared);
    }

    fn start_regular(&mut self, shared: &mut Shared) {
        if self.sr & OVR != 0 && self.cr2() & DMA != 0 {
            return;
        }
        if self.regular.place.is_some() {
            shared.note(
                Kind::Lost,
                "ADC1: regular trigger while the group is converted",
            );
            return;
        }
        self.judge_start(shared);
        self.sr |= STRT;
        self.regular = Group {
            place: Some(0),
            sampled: None,
        };
        if self.injected.place.is_none() {
            self.sample_next(shared);
        }
    }

    /// The group whose turn it is begins to sample its next channel.
    fn sample_next(&mut self, shared: &mut Shared) {
        let (channel, source) = match (self.injected.place, self.regular.place) {
            (Some(place), _) => (self.injected_channel(place), Source::AdcInjected),
            (None, Some(place)) => (self.regular_channel(place), Source::Adc),
            (None, None) => return,
        };
        let at = shared.now + self.sampling(channel) * self.clock(shared);
        shared.schedule(source, at);
    }

    /// The count of a channel's voltage now.
    fn convert(&mut self, channel: u32, shared: &mut Shared) -> u16 {
        let at = shared.time();
        let volts = match pin(channel) {
            Some(pin) => {
                if self.checked >> channel & 1 == 0 {
                    self.checked |= 1 << channel;
                    shared.effect(Effect::Sampled(pin));
                }
                shared.surroundings.voltage(pin, at)
            }
            None => INSIDE[(channel as usize - 16).min(2)],
        };
        let count = 4096.0 * volts / self.reference_v + NOISE * self.noise() + 0.5;
        let full = count.clamp(0.0, 4095.0) as u16;
        full >> (2 * (self.cr1() >> 24 & 3))
    }

    /// About normal, of variance 1: the sum of four even numbers.
    fn noise(&mut self) -> f64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        let sum: u64 = (0..4).map(|k| self.random >> (16 * k) & 0xffff).sum();
        (sum as f64 / 65_536.0 - 2.0) * 1.732_050_8
    }

    fn regular_done(&mut self, value: u16, place: u32, shared: &mut Shared) {
        self.counts.regular += 1;
        let last = place + 1 == self.regular_length();
        self.regular = Group {
            place: match (last, self.cr2() & CONT) {
                (false, _) => Some(place + 1),
                (true, 0) => None,
                (true, _) => Some(0),
            },
            sampled: None,
        };
        // Each datum is told of, or only the last of a sequence; only then a loss can be noticed.
        let each = self.cr2() & (DMA | EOCS) != 0;
        if each && self.sr & EOC != 0 && !self.ended {
            self.sr |= OVR;
            self.counts.overruns += 1;
            if self.cr2() & DMA != 0 {
                self.regular.place = None;
            }
            return;
        }
        self.dr = value.into();
        if each || last {
            self.sr |= EOC;
        }
        self.ask(shared);
    }

    /// Asks the stream for the datum that waits, if the program wants that.
    pub fn ask(&mut self, shared: &mut Shared) {
        if self.cr2() & DMA != 0 && self.sr & (EOC | OVR) == EOC && !self.ended {
            shared.effect(Effect::Dma(Request::Adc1));
        }
    }

    /// The stream has moved the last datum of its block.
    pub fn block_ended(&mut self) {
        self.ended = self.cr2() & DDS == 0;
    }

    fn injected_done(&mut self, value: u16, place: u32) {
        self.counts.injected += 1;
        self.injected_data[place as usize & 3] = value.into();
        self.injected.sampled = None;
        if place + 1 < self.injected_length() {
            self.injected.place = Some(place + 1);
        } else {
            self.injected.place = None;
            self.sr |= JEOC;
        }
    }

    fn line(&self, shared: &mut Shared) {
        let (sr, cr1) = (self.sr, self.cr1());
        let on = |flag: u32, enable: u32| sr & flag != 0 && cr1 & enable != 0;
        shared.line(
            Interrupt::Adc,
            on(EOC, EOCIE) || on(JEOC, JEOCIE) || on(OVR, OVRIE),
        );
    }

    fn write_cr2(&mut self, value: u32, shared: &mut Shared) {
        let old = self.cr2();
        self.plain[2] = value & !(SWSTART | JSWSTART);
        if value & ADON != 0 && old & ADON == 0 {
            self.stable = shared.time() + STABILISATION;
            self.checked = 0;
        }
        if value & ADON == 0 {
            (self.regular, self.injected) = (Group::default(), Group::default());
            shared.schedule(Source::Adc, NEVER);
            shared.schedule(Source::AdcInjected, NEVER);
        }
        if value & DMA == 0 || old & DMA == 0 {
            self.ended = false;
        }
        if value & (2 << 28 | 2 << 20 | 1 << 11) != 0 {
            shared.note(
                Kind::NotModelled,
                "ADC1: falling edges of triggers, left alignment",
            );
        }
        if value & ADON != 0 {
            if value & JSWSTART != 0 {
                self.start_injected(shared);
            }
            if value & SWSTART != 0 {
                self.start_regular(shared);
            }
        }
    }
}

impl Peripheral for Adc {
    fn registers(&self) -> &'static [Register] {
        REGISTERS
    }

    fn read(&mut self, offset: u32, shared: &mut Shared) -> u32 {
        match offset {
            0x00 | 0x300 => self.sr,
            0x3c..=0x48 => self.injected_data[(offset as usize - 0x3c) / 4],
            0x4c => {
                self.sr &= !EOC;
                self.line(shared);
                self.dr
            }
            0x304 => self.common,
            0x308 => 0,
            _ => self.plain[offset as usize / 4],
        }
    }

    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared) {
        match offset {
            0x00 => self.sr &= value,
            0x04 => {
                self.plain[1] = merge(self.plain[1], value, mask);
                if value & 0x00c0_fe00 != 0 {
                    shared.note(
                        Kind::NotModelled,
                        "ADC1: discontinuous mode, analogue watchdog, JAUTO",
                    );
                }
            }
            0x08 => self.write_cr2(merge(self.plain[2], value, mask), shared),
            0x14..=0x20 if value != 0 => shared.note(Kind::NotModelled, "ADC1: offsets"),
            0x304 => {
                self.common = value;
                if value & 0xef1f != 0 {
                    shared.note(Kind::NotModelled, "ADC: dual and triple modes");
                }
            }
            0x3c..=0x4c | 0x300 | 0x308 => shared.note(Kind::Forbidden, "ADC1: data are read only"),
            _ => {
                self.plain[offset as usize / 4] =
                    merge(self.plain[offset as usize / 4], value, mask)
            }
        }
        self.line(shared);
    }

    fn event(&mut self, source: Source, shared: &mut Shared) {
        let injected = source == Source::AdcInjected;
        let group = if injected {
            self.injected
        } else {
            self.regular
        };
        let Some(place) = group.place else {
            return;
        };
        let Some(value) = group.sampled else {
            let channel = match injected {
                true => self.injected_channel(place),
                false => self.regular_channel(place),
            };
            let value = self.convert(channel, shared);
            let group = if injected {
                &mut self.injected
            } else {
                &mut self.regular
            };
            group.sampled = Some(value);
            let at: Cycles = shared.now + self.conversion() * self.clock(shared);
            shared.schedule(source, at);
            return;
        };
        match injected {
            true => self.injected_done(value, place),
            false => self.regular_done(value, place, shared),
        }
        self.line(shared);
        self.sample_next(shared);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::shared;

    /// Runs until `end`; gives the times at which transfers were asked for. Each is made if `serve`.
    fn pass(adc: &mut Adc, shared: &mut Shared, end: Cycles, serve: bool) -> Vec<Cycles> {
        let mut asked = Vec::new();
        loop {
            let next = [Source::Adc, Source::AdcInjected].map(|s| (shared.due(s), s));
            let (at, source) = if next[0].0 <= next[1].0 {
                next[0]
            } else {
                next[1]
            };
            if at > end {
                break;
            }
            shared.now = at;
            shared.schedule(source, NEVER);
            adc.event(source, shared);
            while let Some(effect) = shared.effects.pop_front() {
                if effect == Effect::Dma(Request::Adc1) {
                    asked.push(at);
                    if serve {
                        adc.read(0x4c, shared);
                    }
                }
            }
        }
        shared.now = end;
        asked
    }

    /// Two regular channels of 15 clocks by TIM2's trigger with DMA, one injected of 28 by software; a
    /// clock is two cycles.
    fn adc(shared: &mut Shared) -> Adc {
        let mut adc = Adc::default();
        for (offset, value) in [
            (0x04, SCAN | JEOCIE | OVRIE),
            (0x10, 1 << 3 | 1 << 6 | 2 << 9),
            (0x2c, 1 << 20),
            (0x34, 1 | 2 << 5),
            (0x38, 3 << 15),
            (0x08, ADON | DMA | DDS | 6 << 24 | 1 << 28),
        ] {
            adc.write(offset, value, !0, shared);
        }
        shared.now += 100;
        adc
    }

    #[test]
    fn a_scan_takes_the_data_sheets_time() {
        let mut shared = shared();
        let mut adc = adc(&mut shared);
        adc.trigger(Trigger::Tim2Trgo, &mut shared);
        let start = shared.now;
        let asked = pass(&mut adc, &mut shared, start + 1000, true);
        assert_eq!(asked, [start + 54, start + 108]);
        assert!(shared.findings.list().is_empty());
        assert_eq!(
            adc.counts(),
            Counts {
                regular: 2,
                injected: 0,
                overruns: 0
            }
        );
    }

    #[test]
    fn an_injected_conversion_goes_first_and_the_regular_one_begins_anew() {
        let mut shared = shared();
        let mut adc = adc(&mut shared);
        adc.trigger(Trigger::Tim2Trgo, &mut shared);
        let start = shared.now;
        pass(&mut adc, &mut shared, start + 60, true);
        let cr2 = adc.cr2();
        adc.write(0x08, cr2 | JSWSTART, !0, &mut shared);
        let asked = pass(&mut adc, &mut shared, start + 1000, true);
        // 80 cycles for the injected one from 60 on, then the second regular one anew.
        assert_eq!(asked, [start + 60 + 80 + 54]);
        assert_eq!(shared.lines, 1 << Interrupt::Adc as u32);
        adc.write(0x00, !JEOC, !0, &mut shared);
        assert_eq!(shared.lines, 0);
    }

    #[test]
    fn a_datum_that_nobody_fetches_is_an_overrun_that_ends_the_scans() {
        let mut shared = shared();
        let mut adc = adc(&mut shared);
        adc.trigger(Trigger::Tim2Trgo, &mut shared);
        let start = shared.now;
        pass(&mut adc, &mut shared, start + 1000, false);
        assert_eq!(adc.read(0x00, &mut shared) & OVR, OVR);
        adc.trigger(Trigger::Tim2Trgo, &mut shared);
        assert!(pass(&mut adc, &mut shared, start + 2000, true).is_empty());
        assert_eq!(adc.counts().overruns, 1);
    }

    #[test]
    fn noise_has_its_size_and_a_clock_beyond_the_limit_is_found() {
        let mut shared = shared();
        let mut adc = Adc::default();
        let n = 20_000;
        let values: Vec<f64> = (0..n).map(|_| adc.noise()).collect();
        let mean = values.iter().sum::<f64>() / f64::from(n);
        let variance = values.iter().map(|v| v * v).sum::<f64>() / f64::from(n);
        assert!(
            mean.abs() < 0.03 && (variance - 1.0).abs() < 0.03,
            "{mean} {variance}"
        );
        let mut adc = self::adc(&mut shared);
        shared.clocks.hclk_hz = 168_000_000;
        adc.trigger(Trigger::Tim2Trgo, &mut shared);
        assert_eq!(shared.findings.list().len(), 1);
    }
}
