//! Analogue converter ADC1.
//!
//! Source: reference manual RM0090, chapter 13, and the data sheet. A conversion samples for the time of SMPRx, then
//! takes one clock for each bit of the result. The voltage is sampled at the end of the sampling time; the supply is
//! the reference. A conversion starts two clocks (regular group) or three (injected group) after its trigger, the
//! longest times of the data sheet.
//!
//! Choices where the manual is unclear:
//!
//! - After an overrun in DMA mode, DMA requests stop until the DMA bit is cleared and set again.
//! - In an overrun the new result is lost, not the unread one.
//! - A program that clears EOC itself counts as having read the result.
//!
//! Not modelled: ADC2 and ADC3; dual and triple modes; continuous and discontinuous modes; automatic injection; offsets
//! (JOFRx); resolutions below 12 bits; left alignment; analogue watchdog; triggers other than TRGO of TIM1 to TIM5;
//! internal channels. Enabling one of these is a finding. The sampling capacitor draws no charge from the pin.

mod registers;
#[cfg(test)]
mod tests;
mod write;

use super::Peripheral;
use super::chip_variation::ChipVariation;
use super::effect::{Effect, Request};
use super::interrupt::Interrupt;
use super::map::Unit;
use super::nonlinearity::Nonlinearity;
use super::register::{Register, merge};
use super::shared::Shared;
use super::{timer, transfer};
use crate::finding::FindingKind;
use crate::noise::Noise;
use crate::time::{Cycles, NEVER, Time};
use registers::*;

/// Time from switching on to the first conversion.
const STABILISATION: Time = Time::from_micros(3);
/// Supply limit, V; highest clock frequency above and below this supply, and lowest clock frequency, Hz (data sheet).
const FULL_SPEED_V: f64 = 2.4;
const MAX_HZ: [u64; 2] = [36_000_000, 18_000_000];
const MIN_HZ: u64 = 600_000;
/// Clocks from a trigger to the start of a conversion: regular, injected.
const LATENCY: [u64; 2] = [2, 3];
/// Clocks of a conversion after sampling: one for each bit.
const CONVERTING: u64 = 12;

/// Counts of conversions and overruns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Conversions of the regular group.
    pub regular: u64,
    /// Conversions of the injected group.
    pub injected: u64,
    /// Overruns.
    pub overruns: u64,
}

/// Conversion in progress.
#[derive(Clone, Copy, Debug)]
struct Conversion {
    injected: bool,
    channel: u32,
    /// Cycle at which sampling ends.
    sampled: Cycles,
}

#[derive(Clone)]
pub(crate) struct Adc {
    /// Registers that only store the written value, by offset / 4.
    plain: [u32; COUNT],
    common: u32,
    sr: u32,
    data: u32,
    injected_data: [u32; 4],
    /// Present positions in the sequences of the regular and the injected group; `None` if the group does not run.
    positions: [Option<u32>; 2],
    conversion: Option<Conversion>,
    /// Core cycles in one clock of the converter when the conversion began.
    clock: u64,
    /// True until the latest result of the regular group is read.
    unread: bool,
    /// True if DMA requests have stopped: the block ended without DDS, or an overrun occurred.
    requests_stopped: bool,
    stable: Time,
    /// Channels whose pin was checked since the converter was switched on, one bit each.
    checked: u32,
    /// Cycles left of the conversion and of its sampling while the clock is off; `None` while the clock is on.
    gated: Option<[Cycles; 2]>,
    noise: Noise,
    /// Nonlinearity of this chip's converter; `None` until the first conversion.
    nonlinearity: Option<Nonlinearity>,
    /// Cycle of the latest start of the injected group.
    started: Cycles,
    counts: Counts,
}

impl Default for Adc {
    fn default() -> Self {
        let mut plain = [0; COUNT];
        plain[HTR as usize / 4] = 0xfff;
        Self {
            plain,
            common: 0,
            sr: 0,
            data: 0,
            injected_data: [0; 4],
            positions: [None; 2],
            conversion: None,
            clock: 1,
            unread: false,
            requests_stopped: false,
            stable: Time::NEVER,
            checked: 0,
            gated: None,
            noise: Noise::new(0),
            nonlinearity: None,
            started: 0,
            counts: Counts::default(),
        }
    }
}

impl Adc {
    /// Resets the converter; noise, nonlinearity and conversion counts are kept.
    pub fn reset(&mut self) {
        let gated = self.gated.map(|_| [0; 2]);
        *self = Self {
            noise: self.noise.clone(),
            nonlinearity: self.nonlinearity.clone(),
            counts: self.counts,
            gated,
            ..Self::default()
        };
    }

    /// Sets the noise generator after a reset of the chip.
    pub fn begin(&mut self, noise: Noise) {
        self.noise = noise;
    }

    /// Noise generator, to be kept over a reset.
    pub fn into_noise(self) -> Noise {
        self.noise
    }

    /// Conversions so far.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Cycle of the latest start of the injected group.
    pub fn started(&self) -> Cycles {
        self.started
    }

    /// Stops the converter while its clock is off, or resumes it.
    pub fn gate(&mut self, off: bool, shared: &mut Shared) {
        match (off, self.gated) {
            (true, None) => self.gated = Some(self.left(shared)),
            (false, Some(left)) => {
                self.gated = None;
                self.resume(left, shared);
            }
            _ => {}
        }
    }

    /// Stops the conversion. Returns the remaining cycles until its end and until its sampling point.
    fn left(&self, shared: &mut Shared) -> [Cycles; 2] {
        let (now, due) = (shared.now, shared.due(Unit::Adc));
        let sampled = self.conversion.map_or(0, |c| c.sampled);
        shared.schedule(Unit::Adc, NEVER);
        if sampled > now {
            shared.cancel_sample();
        }
        [due, sampled].map(|at| at.saturating_sub(now))
    }

    /// Resumes a conversion with these remaining cycles.
    fn resume(&mut self, [end, sampled]: [Cycles; 2], shared: &mut Shared) {
        let now = shared.now;
        let Some(conversion) = &mut self.conversion else {
            return;
        };
        if sampled > 0 {
            conversion.sampled = now + sampled;
            if let Some(pin) = pin(conversion.channel) {
                shared.sample(pin, now + sampled);
            }
        }
        shared.schedule(Unit::Adc, now + end);
    }

    fn reg(&self, offset: u32) -> u32 {
        self.plain[offset as usize / 4]
    }

    fn cr1(&self) -> u32 {
        self.reg(CR1)
    }

    fn cr2(&self) -> u32 {
        self.reg(CR2)
    }

    /// Core cycles in one clock of the converter.
    fn clock(&self, shared: &Shared) -> u64 {
        shared.clocks.apb2 * 2 * (u64::from(self.common >> 16 & 3) + 1)
    }

    /// Sampling time of a channel, clocks.
    fn sampling(&self, channel: u32) -> u64 {
        let bits = match channel {
            0..=9 => self.reg(SMPR2) >> (3 * channel),
            _ => self.reg(SMPR1) >> (3 * (channel.min(18) - 10)),
        };
        SAMPLING[bits as usize & 7]
    }

    /// Channel at a position of a sequence. An injected sequence shorter than four ends with JSQ4.
    fn channel(&self, injected: bool, position: u32) -> u32 {
        let register = match (injected, position) {
            (true, _) => {
                let length = (self.reg(JSQR) >> 20 & 3) + 1;
                self.reg(JSQR) >> (5 * (4 - length + position))
            }
            (_, 0..=5) => self.reg(SQR3) >> (5 * position),
            (_, 6..=11) => self.reg(SQR2) >> (5 * (position - 6)),
            _ => self.reg(SQR1) >> (5 * (position - 12)),
        };
        register & 31
    }

    fn length(&self, injected: bool) -> u32 {
        match (self.cr1() & SCAN, injected) {
            (0, _) => 1,
            (_, true) => (self.reg(JSQR) >> 20 & 3) + 1,
            (_, false) => (self.reg(SQR1) >> 20 & 15) + 1,
        }
    }

    fn position(&mut self, injected: bool) -> &mut Option<u32> {
        &mut self.positions[usize::from(injected)]
    }

    /// Handles an edge of a timer's TRGO.
    pub fn trigger(&mut self, timer: timer::TimerId, rises: bool, shared: &mut Shared) {
        let cr2 = self.cr2();
        if cr2 & ADON == 0 || self.gated.is_some() {
            return;
        }
        let edge = if rises { 1 } else { 2 };
        if cr2 >> 20 & edge != 0 && injected_trigger(cr2 >> 16) == Some(timer) {
            self.start(true, shared);
        }
        if cr2 >> 28 & edge != 0 && regular_trigger(cr2 >> 24) == Some(timer) {
            self.start(false, shared);
        }
    }

    fn check_start(&mut self, shared: &mut Shared) {
        if shared.time() < self.stable {
            shared.note(
                FindingKind::Forbidden,
                "ADC1: a conversion starts within 3 µs of ADON",
            );
        }
        let hz = shared.clocks.hclk_hz / self.clock(shared);
        let max_hz = MAX_HZ[usize::from(shared.volts < FULL_SPEED_V)];
        if !(MIN_HZ..=max_hz).contains(&hz) {
            shared.note(
                FindingKind::ClockLimit,
                format!("ADC1 clock {hz} Hz: must be {MIN_HZ} to {max_hz} Hz"),
            );
        }
    }

    /// Starts a group, by trigger or by the program.
    fn start(&mut self, injected: bool, shared: &mut Shared) {
        if !injected && self.sr & OVR != 0 && self.detects_overruns() {
            // Manual: regular triggers are ignored until the overrun flag is cleared.
            return;
        }
        if self.position(injected).is_some() {
            let text = match injected {
                true => "ADC1: injected trigger while the group is converted",
                false => "ADC1: regular trigger while the group is converted",
            };
            return shared.note(FindingKind::Lost, text);
        }
        self.check_start(shared);
        self.sr |= if injected { JSTRT } else { STRT };
        *self.position(injected) = Some(0);
        if injected {
            self.started = shared.now;
            // The interrupted conversion of the regular group restarts afterwards.
            self.conversion = None;
        }
        if self.conversion.is_none() {
            let wait = LATENCY[usize::from(injected)] * self.clock(shared);
            self.sample_next(wait, shared);
        }
    }

    /// Starts sampling the next channel after `wait` cycles; the injected group goes first.
    fn sample_next(&mut self, wait: Cycles, shared: &mut Shared) {
        let (injected, position) = match self.positions {
            [_, Some(position)] => (true, position),
            [Some(position), None] => (false, position),
            [None, None] => {
                self.conversion = None;
                return shared.schedule(Unit::Adc, NEVER);
            }
        };
        let channel = self.channel(injected, position);
        self.clock = self.clock(shared);
        let sampled = shared.now + wait + self.sampling(channel) * self.clock;
        self.conversion = Some(Conversion {
            injected,
            channel,
            sampled,
        });
        match pin(channel) {
            Some(pin) => shared.sample(pin, sampled),
            None => shared.cancel_sample(),
        }
        shared.schedule(Unit::Adc, sampled + CONVERTING * self.clock);
    }

    /// 12-bit result for the voltage of a channel at the end of its sampling.
    fn convert(&mut self, channel: u32, shared: &mut Shared) -> u32 {
        let volts = match pin(channel) {
            Some(pin) => {
                if self.checked >> channel & 1 == 0 {
                    self.checked |= 1 << channel;
                    shared.effect(Effect::Sampled(pin));
                }
                shared.take_sample().unwrap_or_default()
            }
            None => {
                shared.note(FindingKind::NotModelled, "ADC1: channels inside the chip");
                0.0
            }
        };
        let ratio = volts / shared.volts;
        let ChipVariation {
            converter_noise,
            converter_nonlinearity,
            converter_seed,
            ..
        } = shared.variation;
        let curve = self
            .nonlinearity
            .get_or_insert_with(|| Nonlinearity::new(converter_nonlinearity, converter_seed));
        transfer::count(ratio, curve.at(ratio), converter_noise, &mut self.noise)
    }

    /// True if overruns of the regular group are detected.
    fn detects_overruns(&self) -> bool {
        self.cr2() & (DMA | EOCS) != 0
    }

    fn regular_done(&mut self, count: u32, shared: &mut Shared) {
        self.counts.regular += 1;
        let ends = self.advance(false);
        let cr2 = self.cr2();
        // After the end of the DMA block there are no requests and no overruns.
        let ended = cr2 & DMA != 0 && self.requests_stopped;
        if self.unread && self.detects_overruns() && !ended {
            self.sr |= OVR;
            self.requests_stopped = true;
            self.counts.overruns += 1;
            *self.position(false) = None;
            return shared.note(
                FindingKind::Lost,
                "ADC1: overrun, a conversion was not fetched",
            );
        }
        self.data = count;
        self.unread = true;
        if ends || cr2 & EOCS != 0 {
            self.sr |= EOC;
        }
        self.request_dma(shared);
    }

    /// Advances to the next position; true at the end of the sequence.
    fn advance(&mut self, injected: bool) -> bool {
        let length = self.length(injected);
        let position = self.position(injected);
        let next = position.unwrap_or(0) + 1;
        *position = (next < length).then_some(next);
        next >= length
    }

    /// Requests a DMA transfer of the unread result, if enabled.
    pub fn request_dma(&mut self, shared: &mut Shared) {
        if self.cr2() & DMA != 0 && self.unread && !self.requests_stopped {
            shared.effect(Effect::Dma(Request::Adc1));
        }
    }

    /// Handles the end of the DMA stream's block: without DDS the converter stops its DMA requests.
    pub fn block_ended(&mut self) {
        self.requests_stopped |= self.cr2() & DDS == 0;
    }

    fn injected_done(&mut self, count: u32) {
        self.counts.injected += 1;
        let position = self.position(true).unwrap_or(0);
        self.injected_data[position as usize & 3] = count;
        if self.advance(true) {
            self.sr |= JEOC;
        }
    }

    fn line(&self, shared: &mut Shared) {
        let (sr, cr1) = (self.sr, self.cr1());
        let on = |flag: u32, enable: u32| sr & flag != 0 && cr1 & enable != 0;
        let any = on(EOC, EOCIE) || on(JEOC, JEOCIE) || on(OVR, OVRIE);
        shared.line(Interrupt::Adc, any);
    }
}

impl Peripheral for Adc {
    fn registers(&self) -> &'static [Register] {
        REGISTERS
    }

    fn read(&mut self, offset: u32, shared: &mut Shared) -> u32 {
        match offset {
            SR | CSR => self.sr,
            JDR1..=JDR4 => self.injected_data[(offset - JDR1) as usize / 4],
            DR => {
                self.unread = false;
                if self.sr & EOC != 0 {
                    self.sr &= !EOC;
                    self.line(shared);
                }
                self.data
            }
            CCR => self.common,
            CDR => 0,
            _ => self.reg(offset),
        }
    }

    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared) {
        let index = offset as usize / 4;
        let value = match self.plain.get(index) {
            Some(&old) => merge(old, value, mask),
            None => value,
        };
        match offset {
            SR => {
                if self.sr & !value & EOC != 0 {
                    self.unread = false;
                }
                self.sr &= value;
            }
            CR1 => self.write_cr1(value, shared),
            CR2 => self.write_cr2(value, shared),
            JOFR1..=JOFR4 if value != 0 => {
                shared.note(
                    FindingKind::NotModelled,
                    "ADC1: offsets of injected results",
                );
            }
            SMPR1 | SMPR2 => self.write_sampling(offset, value, shared),
            SQR1..=SQR3 => {
                self.plain[index] = value;
                self.write_sequence(false, shared);
            }
            JSQR => {
                self.plain[index] = value;
                self.write_sequence(true, shared);
            }
            JDR1..=DR | CSR | CDR => {
                shared.note(FindingKind::Forbidden, "ADC1: data are read only");
            }
            CCR => {
                if (value ^ self.common) & 3 << 16 != 0 && self.conversion.is_some() {
                    shared.note(
                        FindingKind::Forbidden,
                        "ADC_CCR: ADCPRE changed while converting",
                    );
                }
                self.common = value;
                if value & UNKNOWN_COMMON != 0 {
                    let text = "ADC_CCR: dual and triple modes, channels inside the chip";
                    shared.note(FindingKind::NotModelled, text);
                }
            }
            _ => self.plain[index] = value,
        }
        self.line(shared);
    }

    fn event(&mut self, shared: &mut Shared) {
        let Some(conversion) = self.conversion else {
            return;
        };
        let (injected, channel) = (conversion.injected, conversion.channel);
        let count = self.convert(channel, shared);
        match injected {
            true => self.injected_done(count),
            false => self.regular_done(count, shared),
        }
        self.line(shared);
        self.sample_next(0, shared);
    }

    fn clocks_changed(&mut self, shared: &mut Shared) {
        let clock = self.clock(shared);
        if self.conversion.is_some() && self.gated.is_none() && clock != self.clock {
            let left = self.left(shared).map(|left| left / self.clock * clock);
            self.clock = clock;
            self.resume(left, shared);
        }
    }
}
