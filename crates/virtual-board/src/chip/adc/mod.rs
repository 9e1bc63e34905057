//! Analogue converter ADC1.
//!
//! Source: reference manual RM0090, chapter 13, and the data sheet. A conversion samples for the time of
//! SMPRx, then takes as many clocks as its result has bits; the voltage is taken at the instant at which
//! sampling ends, over the supply, which is the reference too. A trigger takes two (regular group) or three (injected group) clocks to start a
//! conversion, the longest times of the data sheet.
//!
//! Where the manual leaves something open:
//!
//! - After an overrun in DMA mode nothing is asked of the stream until the DMA bit is cleared and set.
//! - A datum that comes when the one before was not fetched is the one that is lost.
//! - A program that clears EOC itself has fetched the datum.
//!
//! Not modelled: ADC2 and ADC3, dual and triple modes, continuous and discontinuous modes, an injected
//! group that follows by itself, offsets (JOFRx), resolutions below 12 bits, results aligned to the left,
//! the analogue watchdog, triggers but TRGO of TIM1 to TIM5, channels inside the chip; switching one on is a
//! finding. The capacitor that samples takes no charge from the pin.

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
use crate::finding::Kind;
use crate::noise::Noise;
use crate::time::{Cycles, NEVER, Time};
use registers::*;

/// From switching on to the first conversion.
const STABILISATION: Time = Time::from_micros(3);
/// Limits of the clock above and below this supply, and the lowest (data sheet), Hz.
const FULL_SPEED_V: f64 = 2.4;
const MOST_HZ: [u64; 2] = [36_000_000, 18_000_000];
const LEAST_HZ: u64 = 600_000;
/// Clocks from a trigger to the start, regular and injected.
const LATENCY: [u64; 2] = [2, 3];
/// Clocks of a conversion after sampling: one for each bit.
const CONVERTING: u64 = 12;

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

/// What the converter is at.
#[derive(Clone, Copy, Debug)]
struct Conversion {
    injected: bool,
    channel: u32,
    /// When sampling ends.
    sampled: Cycles,
}

/// The converter.
#[derive(Clone)]
pub(crate) struct Adc {
    /// Registers that only hold what is written, by offset over 4.
    plain: [u32; COUNT],
    common: u32,
    sr: u32,
    data: u32,
    injected_data: [u32; 4],
    /// Places in the sequences of the regular and of the injected group, while they run.
    places: [Option<u32>; 2],
    conversion: Option<Conversion>,
    /// Cycles of the core in one of the converter's clock, as the conversion began.
    clock: u64,
    /// The datum was not fetched yet.
    unread: bool,
    /// The stream is asked for nothing more: it ended its block without DDS, or an overrun.
    silent: bool,
    stable: Time,
    /// Channels whose pin was looked at since the converter was switched on.
    checked: u32,
    /// What is left of a conversion and of its sampling, while the clock is off.
    gated: Option<[Cycles; 2]>,
    noise: Noise,
    /// Made at the first conversion.
    nonlinearity: Option<Nonlinearity>,
    /// When the injected group was started last.
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
            places: [None; 2],
            conversion: None,
            clock: 1,
            unread: false,
            silent: false,
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
    /// After a reset of the converter: what is soldered and what its silicon has stays.
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

    /// After a reset of the chip, with the noise that it has from here on.
    pub fn begin(&mut self, noise: Noise) {
        self.noise = noise;
    }

    /// Its noise, which outlives a reset.
    pub fn into_noise(self) -> Noise {
        self.noise
    }

    /// Conversions so far.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// When the injected group was started last.
    pub fn started(&self) -> Cycles {
        self.started
    }

    /// The converter's clock is switched off or on.
    pub fn gate(&mut self, off: bool, shared: &mut Shared) {
        match (off, self.gated) {
            (true, None) => self.gated = Some(self.left(shared)),
            (false, Some(left)) => {
                self.gated = None;
                self.go_on(left, shared);
            }
            _ => {}
        }
    }

    /// Stops the conversion; gives what is left of it and of its sampling.
    fn left(&self, shared: &mut Shared) -> [Cycles; 2] {
        let (now, due) = (shared.now, shared.due(Unit::Adc));
        let sampled = self.conversion.map_or(0, |c| c.sampled);
        shared.schedule(Unit::Adc, NEVER);
        if sampled > now {
            shared.cancel_sample();
        }
        [due, sampled].map(|at| at.saturating_sub(now))
    }

    /// Lets the conversion go on of which this is left.
    fn go_on(&mut self, [end, sampled]: [Cycles; 2], shared: &mut Shared) {
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

    /// Cycles of the core in one of the converter's clock.
    fn clock(&self, shared: &Shared) -> u64 {
        shared.clocks.apb2 * 2 * (u64::from(self.common >> 16 & 3) + 1)
    }

    /// Clocks of sampling of a channel.
    fn sampling(&self, channel: u32) -> u64 {
        let bits = match channel {
            0..=9 => self.reg(SMPR2) >> (3 * channel),
            _ => self.reg(SMPR1) >> (3 * (channel.min(18) - 10)),
        };
        SAMPLING[bits as usize & 7]
    }

    /// Channel at a place of a sequence. A short injected one ends with JSQ4.
    fn channel(&self, injected: bool, place: u32) -> u32 {
        let register = match (injected, place) {
            (true, _) => {
                let length = (self.reg(JSQR) >> 20 & 3) + 1;
                self.reg(JSQR) >> (5 * (4 - length + place))
            }
            (_, 0..=5) => self.reg(SQR3) >> (5 * place),
            (_, 6..=11) => self.reg(SQR2) >> (5 * (place - 6)),
            _ => self.reg(SQR1) >> (5 * (place - 12)),
        };
        register & 31
    }

    /// Places of a sequence.
    fn length(&self, injected: bool) -> u32 {
        match (self.cr1() & SCAN, injected) {
            (0, _) => 1,
            (_, true) => (self.reg(JSQR) >> 20 & 3) + 1,
            (_, false) => (self.reg(SQR1) >> 20 & 15) + 1,
        }
    }

    fn place(&mut self, injected: bool) -> &mut Option<u32> {
        &mut self.places[usize::from(injected)]
    }

    /// TRGO of a timer rises or falls.
    pub fn trigger(&mut self, timer: timer::Kind, rises: bool, shared: &mut Shared) {
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

    fn judge_start(&mut self, shared: &mut Shared) {
        if shared.time() < self.stable {
            shared.note(
                Kind::Forbidden,
                "ADC1: a conversion starts within 3 µs of ADON",
            );
        }
        let hz = shared.clocks.hclk_hz / self.clock(shared);
        let most = MOST_HZ[usize::from(shared.volts < FULL_SPEED_V)];
        if !(LEAST_HZ..=most).contains(&hz) {
            shared.note(
                Kind::ClockLimit,
                format!("ADC1 clock {hz} Hz: must be {LEAST_HZ} to {most} Hz"),
            );
        }
    }

    /// Starts a group, by a trigger or by the program.
    fn start(&mut self, injected: bool, shared: &mut Shared) {
        if !injected && self.sr & OVR != 0 && self.notices_overruns() {
            // The manual: ignored until the overrun's flag is cleared.
            return;
        }
        if self.place(injected).is_some() {
            let text = match injected {
                true => "ADC1: injected trigger while the group is converted",
                false => "ADC1: regular trigger while the group is converted",
            };
            return shared.note(Kind::Lost, text);
        }
        self.judge_start(shared);
        self.sr |= if injected { JSTRT } else { STRT };
        *self.place(injected) = Some(0);
        if injected {
            self.started = shared.now;
            // What the regular group is at begins anew afterwards.
            self.conversion = None;
        }
        if self.conversion.is_none() {
            let wait = LATENCY[usize::from(injected)] * self.clock(shared);
            self.sample_next(wait, shared);
        }
    }

    /// The group whose turn it is begins to sample its next channel after `wait` cycles.
    fn sample_next(&mut self, wait: Cycles, shared: &mut Shared) {
        let (injected, place) = match self.places {
            [_, Some(place)] => (true, place),
            [Some(place), None] => (false, place),
            [None, None] => {
                self.conversion = None;
                return shared.schedule(Unit::Adc, NEVER);
            }
        };
        let channel = self.channel(injected, place);
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

    /// The result of twelve bits for a channel's voltage where its sampling ended.
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
                shared.note(Kind::NotModelled, "ADC1: channels inside the chip");
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

    /// Whether an overrun of the regular group is noticed.
    fn notices_overruns(&self) -> bool {
        self.cr2() & (DMA | EOCS) != 0
    }

    fn regular_done(&mut self, count: u32, shared: &mut Shared) {
        self.counts.regular += 1;
        let ends = self.advance(false);
        let cr2 = self.cr2();
        // Beyond the stream's block nothing is asked for, and nothing is an overrun.
        let ended = cr2 & DMA != 0 && self.silent;
        if self.unread && self.notices_overruns() && !ended {
            self.sr |= OVR;
            self.silent = true;
            self.counts.overruns += 1;
            *self.place(false) = None;
            return shared.note(Kind::Lost, "ADC1: overrun, a conversion was not fetched");
        }
        self.data = count;
        self.unread = true;
        if ends || cr2 & EOCS != 0 {
            self.sr |= EOC;
        }
        self.ask(shared);
    }

    /// A place was converted; whether the sequence ends with it.
    fn advance(&mut self, injected: bool) -> bool {
        let length = self.length(injected);
        let place = self.place(injected);
        let next = place.unwrap_or(0) + 1;
        *place = (next < length).then_some(next);
        next >= length
    }

    /// Asks the stream for the datum that waits, if the program wants that.
    pub fn ask(&mut self, shared: &mut Shared) {
        if self.cr2() & DMA != 0 && self.unread && !self.silent {
            shared.effect(Effect::Dma(Request::Adc1));
        }
    }

    /// The stream has moved the last datum of its block.
    pub fn block_ended(&mut self) {
        self.silent |= self.cr2() & DDS == 0;
    }

    fn injected_done(&mut self, count: u32) {
        self.counts.injected += 1;
        let place = self.place(true).unwrap_or(0);
        self.injected_data[place as usize & 3] = count;
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
        let place = offset as usize / 4;
        let value = match self.plain.get(place) {
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
                shared.note(Kind::NotModelled, "ADC1: offsets of injected results");
            }
            SMPR1 | SMPR2 => self.write_sampling(offset, value, shared),
            SQR1..=SQR3 => {
                self.plain[place] = value;
                self.write_sequence(false, shared);
            }
            JSQR => {
                self.plain[place] = value;
                self.write_sequence(true, shared);
            }
            JDR1..=DR | CSR | CDR => {
                shared.note(Kind::Forbidden, "ADC1: data are read only");
            }
            CCR => {
                if (value ^ self.common) & 3 << 16 != 0 && self.conversion.is_some() {
                    shared.note(Kind::Forbidden, "ADC_CCR: ADCPRE changed while converting");
                }
                self.common = value;
                if value & UNKNOWN_COMMON != 0 {
                    let text = "ADC_CCR: dual and triple modes, channels inside the chip";
                    shared.note(Kind::NotModelled, text);
                }
            }
            _ => self.plain[place] = value,
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
            self.go_on(left, shared);
        }
    }
}
