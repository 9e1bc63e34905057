//! Timers TIM1 to TIM5: counting, compare, pulses with dead time and break, encoders, triggers.
//!
//! Source: reference manual RM0090, chapters 17 and 18. The counter is not stepped: it is on a leg, up
//! or down, and its value follows from the time. What is on the schedule is the end of the leg (update)
//! and the compare values that somebody waits for.
//!
//! Not modelled: input capture, slave modes other than encoders, DMA requests, one-pulse mode, OCxCE;
//! switching one on is a finding.

mod input;
mod output;

use super::Peripheral;
use super::interrupt::Interrupt;
use super::pin::{Drive, Signal};
use super::register::{Register, merge, narrow};
use super::shared::{Effect, Shared, Source, Trigger};
use crate::finding;
use crate::time::{Cycles, NEVER};
use input::Input;
use output::{Mode, OUTPUTS, Stage};

#[rustfmt::skip]
const REGISTERS: &[Register] = &[
    narrow(0x00, "CR1", 0x3ff), narrow(0x04, "CR2", 0x7ffd), narrow(0x08, "SMCR", 0xfff7), narrow(0x0c, "DIER", 0x7fff),
    narrow(0x10, "SR", 0x1eff), narrow(0x14, "EGR", 0xff), narrow(0x18, "CCMR1", 0xffff), narrow(0x1c, "CCMR2", 0xffff),
    narrow(0x20, "CCER", 0xffff), narrow(0x24, "CNT", !0), narrow(0x28, "PSC", 0xffff), narrow(0x2c, "ARR", !0),
    narrow(0x30, "RCR", 0xff), narrow(0x34, "CCR1", !0), narrow(0x38, "CCR2", !0), narrow(0x3c, "CCR3", !0),
    narrow(0x40, "CCR4", !0), narrow(0x44, "BDTR", 0xffff), narrow(0x48, "DCR", 0x1f1f), narrow(0x4c, "DMAR", !0),
    narrow(0x50, "OR", 0xcc0),
];

// Bits of SR and DIER.
const UPDATE: u32 = 1;
const BREAK: u32 = 1 << 7;
// Bits of BDTR.
const MOE: u32 = 1 << 15;
const BKP: u32 = 1 << 13;
const BKE: u32 = 1 << 12;
const OSSI: u32 = 1 << 10;

/// Which timer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Tim1,
    Tim2,
    Tim3,
    Tim4,
    Tim5,
}

impl Kind {
    fn source(self) -> Source {
        [
            Source::Tim1,
            Source::Tim2,
            Source::Tim3,
            Source::Tim4,
            Source::Tim5,
        ][self as usize]
    }

    fn is_wide(self) -> bool {
        matches!(self, Self::Tim2 | Self::Tim5)
    }

    fn trgo(self) -> Trigger {
        [
            Trigger::Tim1Trgo,
            Trigger::Tim2Trgo,
            Trigger::Tim3Trgo,
            Trigger::Tim4Trgo,
            Trigger::Tim5Trgo,
        ][self as usize]
    }

    fn compare(self, channel: usize) -> Option<Trigger> {
        use Trigger::*;
        let of = match self {
            Self::Tim1 => [Some(Tim1Cc1), Some(Tim1Cc2), Some(Tim1Cc3), Some(Tim1Cc4)],
            Self::Tim2 => [Some(Tim2Cc1), Some(Tim2Cc2), Some(Tim2Cc3), Some(Tim2Cc4)],
            Self::Tim3 => [Some(Tim3Cc1), Some(Tim3Cc2), None, Some(Tim3Cc4)],
            Self::Tim4 => [Some(Tim4Cc1), Some(Tim4Cc2), Some(Tim4Cc3), Some(Tim4Cc4)],
            Self::Tim5 => [Some(Tim5Cc1), Some(Tim5Cc2), Some(Tim5Cc3), Some(Tim5Cc4)],
        };
        of[channel]
    }
}

/// A stretch of counting in one direction.
#[derive(Clone, Copy, Debug)]
struct Leg {
    start: Cycles,
    from: u32,
    /// Ticks of the counter until the leg ends.
    length: u64,
    up: bool,
}

/// A channel.
#[derive(Clone, Copy, Debug, Default)]
struct Channel {
    preload: u32,
    compare: u32,
    reference: bool,
    /// Levels at which output and complement arrive when the dead time is over, and when.
    delayed: [Option<Cycles>; 2],
}

/// A timer.
pub(crate) struct Timer {
    kind: Kind,
    /// Registers as they were written, by offset over 4.
    plain: [u32; 21],
    channels: [Channel; 4],
    reload: u32,
    prescaler: u32,
    repetitions: u32,
    /// The counter while it stands.
    count: u32,
    leg: Option<Leg>,
    /// Compare values met so far on this leg lie before this cycle.
    seen: Cycles,
    inputs: [Input; 2],
    break_level: bool,
    outputs: [Drive; OUTPUTS.len()],
}

impl Timer {
    /// A timer after a reset.
    pub fn new(kind: Kind) -> Self {
        let most = if kind.is_wide() { !0 } else { 0xffff };
        let mut plain = [0; 21];
        plain[0x2c / 4] = most;
        Self {
            kind,
            plain,
            channels: [Channel::default(); 4],
            reload: most,
            prescaler: 0,
            repetitions: 0,
            count: 0,
            leg: None,
            seen: 0,
            inputs: [Input::default(); 2],
            break_level: false,
            outputs: [Drive::Open; OUTPUTS.len()],
        }
    }

    fn reg(&self, offset: usize) -> u32 {
        self.plain[offset / 4]
    }

    fn most(&self) -> u32 {
        if self.kind.is_wide() { !0 } else { 0xffff }
    }

    /// Cycles of the core in one of the timer's clock.
    fn clock(&self, shared: &Shared) -> u64 {
        match self.kind {
            Kind::Tim1 => shared.clocks.timer2,
            _ => shared.clocks.timer1,
        }
    }

    /// Cycles of the core in one step of the counter.
    fn step(&self, shared: &Shared) -> u64 {
        self.clock(shared) * (u64::from(self.prescaler) + 1)
    }

    fn is_centred(&self) -> bool {
        self.reg(0) >> 5 & 3 != 0
    }

    fn encoder(&self) -> Option<u32> {
        let mode = self.reg(0x08) & 7;
        (1..=3).contains(&mode).then_some(mode)
    }

    /// The counter.
    fn counter(&self, shared: &Shared) -> u32 {
        let Some(leg) = &self.leg else {
            return self.count;
        };
        let steps =
            (shared.now.saturating_sub(leg.start) / self.step(shared)).min(leg.length) as u32;
        let count = if leg.up {
            leg.from + steps
        } else {
            leg.from - steps
        };
        // The last step of an edge-aligned leg wraps.
        if self.is_centred() || steps < leg.length as u32 {
            count
        } else if leg.up {
            0
        } else {
            self.reload
        }
    }

    /// Begins to count from where the counter stands.
    fn begin_leg(&mut self, from: u32, up: bool, shared: &mut Shared) {
        let length = match (self.is_centred(), up) {
            (true, true) => u64::from(self.reload.saturating_sub(from)),
            (true, false) => u64::from(from),
            (false, true) => u64::from(self.reload).saturating_sub(from.into()) + 1,
            (false, false) => u64::from(from) + 1,
        };
        self.leg = Some(Leg {
            start: shared.now,
            from,
            length: length.max(1),
            up,
        });
        self.seen = shared.now;
    }

    fn run(&mut self, on: bool, shared: &mut Shared) {
        if on && self.leg.is_none() && self.encoder().is_none() {
            let down = !self.is_centred() && self.reg(0) & 1 << 4 != 0;
            let (from, up) = (self.count, !down);
            self.begin_leg(from, up, shared);
            if self.reg(0x04) >> 4 & 7 == 1 {
                shared.effect(Effect::Trigger(self.kind.trgo()));
            }
        } else if !on {
            self.count = self.counter(shared);
            self.leg = None;
        }
    }

    /// Whether somebody waits for the compare value of a channel.
    fn matters(&self, k: usize) -> bool {
        let (ccer, trgo) = (self.reg(0x20), self.reg(0x04) >> 4 & 7);
        let enabled = ccer >> (4 * k) & 5 != 0;
        enabled || trgo == 4 + k as u32 || trgo == 3 && k == 0 || self.reg(0x0c) >> (k + 1) & 1 != 0
    }

    /// When the counter meets a compare value on this leg after what was seen.
    fn meets(&self, k: usize, shared: &Shared) -> Option<Cycles> {
        let leg = self.leg.as_ref()?;
        let compare = self.channels[k].compare;
        let steps = match leg.up {
            true => u64::from(compare.checked_sub(leg.from)?),
            false => u64::from(leg.from.checked_sub(compare)?),
        };
        let at = leg.start + steps * self.step(shared);
        (steps < leg.length && at > self.seen).then_some(at)
    }

    fn leg_ends(&self, shared: &Shared) -> Cycles {
        self.leg
            .map_or(NEVER, |leg| leg.start + leg.length * self.step(shared))
    }

    fn plan(&self, shared: &mut Shared) {
        let mut next = NEVER;
        // Encoders have nothing but their filters.
        if self.leg.is_some() {
            next = self.leg_ends(shared);
            for k in 0..4 {
                if self.matters(k) {
                    next = next.min(self.meets(k, shared).unwrap_or(NEVER));
                }
            }
        }
        let inputs = self.inputs.iter().filter_map(|input| input.due);
        let delayed = self
            .channels
            .iter()
            .flat_map(|channel| channel.delayed)
            .flatten();
        let next = inputs.chain(delayed).fold(next, Cycles::min);
        shared.schedule(self.kind.source(), next);
    }

    /// An update event: preloaded values count from here on.
    fn update(&mut self, by_software: bool, shared: &mut Shared) {
        self.reload = self.reg(0x2c);
        self.prescaler = self.reg(0x28);
        self.repetitions = self.reg(0x30);
        for channel in &mut self.channels {
            channel.compare = channel.preload;
        }
        if !(by_software && self.reg(0) & 1 << 2 != 0) {
            self.plain[0x10 / 4] |= UPDATE;
        }
        let mode = self.reg(0x04) >> 4 & 7;
        if mode == 2 || by_software && mode == 0 {
            shared.effect(Effect::Trigger(self.kind.trgo()));
        }
        self.line(shared);
    }

    /// The end of a leg.
    fn turn(&mut self, shared: &mut Shared) {
        let Some(leg) = self.leg else {
            return;
        };
        let centred = self.is_centred();
        let reached = if leg.up {
            leg.from + leg.length as u32
        } else {
            0
        };
        if self.reg(0) & 2 == 0 {
            if self.repetitions == 0 {
                self.update(false, shared);
            } else {
                self.repetitions -= 1;
            }
        }
        match (centred, leg.up) {
            (true, true) => self.begin_leg(reached, false, shared),
            (true, false) | (false, true) => self.begin_leg(0, true, shared),
            (false, false) => self.begin_leg(self.reload, false, shared),
        }
    }

    /// Reference signals anew, with what their edges do.
    fn references(&mut self, shared: &mut Shared) {
        let count = self.counter(shared);
        let up = self.leg.is_none_or(|leg| leg.up);
        for k in 0..4 {
            if !self.matters(k) || self.selection(k) != 0 {
                continue;
            }
            let mode = Mode::of(self.mode_bits(k) >> 4);
            let Channel {
                compare,
                reference: before,
                ..
            } = self.channels[k];
            let reference = mode.reference(count, compare, up, before);
            if reference == before {
                continue;
            }
            self.channels[k].reference = reference;
            self.delay(k, shared);
            if reference {
                if self.reg(0x04) >> 4 & 7 == 4 + k as u32 {
                    shared.effect(Effect::Trigger(self.kind.trgo()));
                }
                if self.reg(0x20) >> (4 * k) & 1 != 0
                    && let Some(trigger) = self.kind.compare(k)
                {
                    shared.effect(Effect::Trigger(trigger));
                }
            }
        }
    }

    /// A compare value was met.
    fn compare_flag(&mut self, k: usize, shared: &mut Shared) {
        let up = self.leg.is_none_or(|leg| leg.up);
        let wanted = match self.reg(0) >> 5 & 3 {
            1 => !up,
            2 => up,
            _ => true,
        };
        if wanted {
            self.plain[0x10 / 4] |= 2 << k;
            if k == 0 && self.reg(0x04) >> 4 & 7 == 3 {
                shared.effect(Effect::Trigger(self.kind.trgo()));
            }
        }
    }

    /// Eight bits of CCMR of a channel.
    fn mode_bits(&self, k: usize) -> u32 {
        self.reg(if k < 2 { 0x18 } else { 0x1c }) >> (8 * (k % 2)) & 0xff
    }

    /// What CCxS selects: 0 is an output.
    fn selection(&self, k: usize) -> u32 {
        self.mode_bits(k) & 3
    }

    /// After an edge of a reference signal, the side that becomes active waits for the dead time.
    fn delay(&mut self, k: usize, shared: &Shared) {
        let both = k < 3 && self.reg(0x20) >> (4 * k) & 5 == 5;
        let wait = output::dead_time(self.reg(0x44)) * self.sampling(shared);
        let channel = &mut self.channels[k];
        channel.delayed = [None; 2];
        if both && wait > 0 {
            let side = usize::from(!channel.reference);
            channel.delayed[side] = Some(shared.now + wait);
        }
    }

    /// Cycles of the core in one of f_DTS.
    fn sampling(&self, shared: &Shared) -> u64 {
        self.clock(shared) << (self.reg(0) >> 8 & 3).min(2)
    }

    /// Drives the outputs anew.
    fn drive(&mut self, shared: &mut Shared) {
        if self.kind != Kind::Tim1 {
            return;
        }
        let (ccer, bdtr, cr2) = (self.reg(0x20), self.reg(0x44), self.reg(0x04));
        for (n, signal) in OUTPUTS.into_iter().enumerate() {
            let (k, complement) = (n % 4, n >= 4);
            let bits = ccer >> (4 * k + if complement { 2 } else { 0 });
            let stage = Stage {
                enabled: bits & 1 != 0,
                inverted: bits & 2 != 0,
                main: bdtr & MOE != 0,
                off_state: bdtr & OSSI != 0,
                idle: cr2 >> (8 + 2 * k + usize::from(complement)) & 1 != 0,
            };
            let channel = &self.channels[k];
            let waits = channel.delayed[usize::from(complement)].is_some();
            let drive = stage.drive(channel.reference != complement && !waits);
            if self.outputs[n] != drive {
                self.outputs[n] = drive;
                shared.effect(Effect::Output(signal, drive));
            }
        }
    }

    fn line(&self, shared: &mut Shared) {
        let active = self.reg(0x10) & self.reg(0x0c);
        match self.kind {
            Kind::Tim1 => {
                shared.line(Interrupt::Tim1Break, active & BREAK != 0);
                shared.line(Interrupt::Tim1Update, active & UPDATE != 0);
                shared.line(Interrupt::Tim1Compare, active & 0x1e != 0);
            }
            Kind::Tim2 => shared.line(Interrupt::Tim2, active & 0x5f != 0),
            Kind::Tim3 => shared.line(Interrupt::Tim3, active & 0x5f != 0),
            Kind::Tim4 => shared.line(Interrupt::Tim4, active & 0x5f != 0),
            Kind::Tim5 => shared.line(Interrupt::Tim5, active & 0x5f != 0),
        }
    }

    /// Whether the break input says stop.
    fn is_broken(&self) -> bool {
        let bdtr = self.reg(0x44);
        bdtr & BKE != 0 && self.break_level == (bdtr & BKP != 0)
    }

    /// The clock security system reports that the crystal failed, to the break input too.
    pub fn clock_failure(&mut self, shared: &mut Shared) {
        if self.reg(0x44) & BKE != 0 {
            self.stop(shared);
        }
    }

    fn check_break(&mut self, shared: &mut Shared) {
        if self.is_broken() {
            self.stop(shared);
        }
    }

    fn stop(&mut self, shared: &mut Shared) {
        self.plain[0x44 / 4] &= !MOE;
        self.plain[0x10 / 4] |= BREAK;
        self.line(shared);
        self.drive(shared);
    }

    /// An input has another level.
    pub fn input(&mut self, signal: Signal, level: bool, shared: &mut Shared) {
        let which = match signal {
            Signal::Tim1Bkin => {
                self.break_level = level;
                return self.check_break(shared);
            }
            Signal::Tim3Ch1 | Signal::Tim4Ch1 => 0,
            _ => 1,
        };
        let filter = self.mode_bits(which) >> 4;
        let clocks = (self.clock(shared), self.sampling(shared));
        let now = shared.now;
        if self.inputs[which].change(level, filter, clocks, now) {
            self.edge(which, shared);
        }
        self.plan(shared);
    }

    /// An input has another level behind its filter.
    fn edge(&mut self, which: usize, shared: &mut Shared) {
        let (Some(mode), true) = (self.encoder(), self.reg(0) & 1 != 0) else {
            return;
        };
        let inverted = |k: usize| self.reg(0x20) >> (4 * k + 1) & 1 != 0;
        let levels = [0, 1].map(|k: usize| self.inputs[k].level != inverted(k));
        let by = input::counts(mode, which, levels[which], levels[1 - which]);
        if by == 0 {
            return;
        }
        self.plain[0] = merge(self.plain[0], if by < 0 { 1 << 4 } else { 0 }, 1 << 4);
        let wrapped = match by {
            1 if self.count >= self.reload => 0,
            -1 if self.count == 0 => self.reload,
            _ => {
                self.count = self.count.wrapping_add_signed(by);
                return;
            }
        };
        self.count = wrapped;
        self.update(false, shared);
    }

    fn write_cr1(&mut self, value: u32, shared: &mut Shared) {
        if value & 1 << 3 != 0 {
            shared.note(finding::Kind::NotModelled, "timer: one-pulse mode");
        }
        self.plain[0] = value;
        self.run(value & 1 != 0, shared);
    }

    fn write_compare_mode(&mut self, offset: u32, value: u32, shared: &mut Shared) {
        self.plain[offset as usize / 4] = value;
        for k in 0..2 {
            let bits = value >> (8 * k) & 0xff;
            if bits & 3 == 0 && bits & 0x80 != 0 {
                shared.note(finding::Kind::NotModelled, "timer: OCxCE");
            }
        }
    }

    fn write_enables(&mut self, value: u32, shared: &mut Shared) {
        self.plain[0x20 / 4] = value;
        for k in 0..4 {
            let on = value >> (4 * k) & 1 != 0;
            if on && self.selection(k) != 0 && self.reg(0) & 1 != 0 && self.encoder().is_none() {
                shared.note(finding::Kind::NotModelled, "timer: input capture");
            }
        }
    }

    fn generate(&mut self, value: u32, shared: &mut Shared) {
        if value & 1 != 0 && self.reg(0) & 2 == 0 {
            self.count = 0;
            if self.leg.is_some() {
                self.begin_leg(0, true, shared);
            }
            self.update(true, shared);
            if let Some(leg) = self.leg {
                self.begin_leg(0, leg.up, shared);
            }
        }
        if value & BREAK != 0 && self.kind == Kind::Tim1 {
            self.plain[0x44 / 4] &= !MOE;
            self.plain[0x10 / 4] |= BREAK;
        }
        if value & 0x7e != 0 {
            shared.note(
                finding::Kind::NotModelled,
                "timer: software events but UG and BG",
            );
        }
    }

    fn write_slave(&mut self, value: u32, shared: &mut Shared) {
        self.plain[0x08 / 4] = value;
        if value & 7 > 3 || value & 0xff80 != 0 {
            shared.note(
                finding::Kind::NotModelled,
                "timer: slave modes but encoders",
            );
        }
    }

    fn write_break(&mut self, value: u32, shared: &mut Shared) {
        let locked = self.reg(0x44) >> 8 & 3 != 0;
        if locked {
            shared.note(finding::Kind::NotModelled, "timer: LOCK levels");
        }
        self.plain[0x44 / 4] = value;
        self.check_break(shared);
    }

    fn write_status(&mut self, value: u32) {
        // Written zeros clear; a break that lasts keeps its flag.
        let keep = if self.is_broken() { BREAK } else { 0 };
        self.plain[0x10 / 4] &= value | keep;
    }
}

impl Peripheral for Timer {
    fn registers(&self) -> &'static [Register] {
        REGISTERS
    }

    fn read(&mut self, offset: u32, shared: &mut Shared) -> u32 {
        match offset {
            0x00 if self.is_centred() => {
                let down = self.leg.is_some_and(|leg| !leg.up);
                merge(self.reg(0), u32::from(down) << 4, 1 << 4)
            }
            0x24 => self.counter(shared),
            0x34..=0x40 => self.channels[(offset as usize - 0x34) / 4].preload,
            _ => self.reg(offset as usize),
        }
    }

    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared) {
        let place = offset as usize / 4;
        let full = merge(self.read(offset, shared), value, mask) & self.most();
        match offset {
            0x00 => self.write_cr1(full, shared),
            0x08 => self.write_slave(full, shared),
            0x0c => {
                self.plain[place] = full;
                if full & 0x7f00 != 0 {
                    shared.note(finding::Kind::NotModelled, "timer: DMA requests");
                }
            }
            0x10 => self.write_status(full),
            0x14 => self.generate(full, shared),
            0x18 | 0x1c => self.write_compare_mode(offset, full, shared),
            0x20 => self.write_enables(full, shared),
            0x24 => {
                self.count = full;
                if let Some(leg) = self.leg {
                    self.begin_leg(full, leg.up, shared);
                }
            }
            0x2c => {
                self.plain[place] = full;
                if self.reg(0) & 1 << 7 == 0 {
                    let (count, leg) = (self.counter(shared), self.leg);
                    self.reload = full;
                    if let Some(leg) = leg {
                        self.begin_leg(count, leg.up, shared);
                    }
                }
            }
            0x34..=0x40 => {
                let k = (offset as usize - 0x34) / 4;
                self.channels[k].preload = full;
                if self.mode_bits(k) & 1 << 3 == 0 {
                    self.channels[k].compare = full;
                }
            }
            0x44 if self.kind == Kind::Tim1 => self.write_break(full, shared),
            _ => self.plain[place] = full,
        }
        self.references(shared);
        self.drive(shared);
        self.line(shared);
        self.plan(shared);
    }

    fn event(&mut self, _source: Source, shared: &mut Shared) {
        let now = shared.now;
        for which in 0..2 {
            if self.inputs[which].due.is_some_and(|due| due <= now) {
                self.inputs[which].pass();
                self.edge(which, shared);
            }
        }
        for channel in &mut self.channels {
            for delayed in &mut channel.delayed {
                *delayed = delayed.filter(|&at| at > now);
            }
        }
        for k in 0..4 {
            if self.matters(k) && self.meets(k, shared).is_some_and(|at| at <= now) {
                self.compare_flag(k, shared);
            }
        }
        self.seen = now;
        if self.leg_ends(shared) <= now {
            self.turn(shared);
            for k in 0..4 {
                // A value that stands where the leg begins is met at once.
                let from = self.leg.map(|leg| leg.from);
                if self.matters(k) && from == Some(self.channels[k].compare) {
                    self.compare_flag(k, shared);
                }
            }
        }
        self.references(shared);
        self.drive(shared);
        self.line(shared);
        self.plan(shared);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::chip::testing::shared;

    /// Runs until `end`, and gives what happened with its times.
    fn pass(timer: &mut Timer, shared: &mut Shared, end: Cycles) -> Vec<(Cycles, Effect)> {
        let source = timer.kind.source();
        let mut seen: Vec<_> = shared.effects.drain(..).map(|e| (shared.now, e)).collect();
        while shared.due(source) <= end {
            shared.now = shared.due(source);
            shared.schedule(source, NEVER);
            timer.event(source, shared);
            seen.extend(shared.effects.drain(..).map(|e| (shared.now, e)));
        }
        shared.now = end;
        seen
    }

    fn write(timer: &mut Timer, shared: &mut Shared, values: &[(u32, u32)]) {
        for &(offset, value) in values {
            timer.write(offset, value, !0, shared);
        }
    }

    #[test]
    fn an_edge_aligned_timer_updates_every_reload_plus_one() {
        let (mut timer, mut shared) = (Timer::new(Kind::Tim2), shared());
        write(
            &mut timer,
            &mut shared,
            &[(0x2c, 874), (0x04, 2 << 4), (0x14, 1)],
        );
        shared.effects.clear();
        write(&mut timer, &mut shared, &[(0x00, 1)]);
        let updates: Vec<_> = pass(&mut timer, &mut shared, 2700)
            .into_iter()
            .map(|e| e.0)
            .collect();
        assert_eq!(updates, [875, 1750, 2625]);
        assert_eq!(timer.read(0x24, &mut shared), 75);
        assert_eq!(timer.read(0x10, &mut shared) & 1, 1);
    }

    /// TIM1 centre-aligned to 100, channel 1 with pulses of 30.
    fn pulses(shared: &mut Shared, repetition: u32) -> Timer {
        let mut timer = Timer::new(Kind::Tim1);
        let set = [
            (0x2c, 100),
            (0x30, repetition),
            (0x34, 30),
            (0x18, 0x68),
            (0x20, 1),
            (0x04, 2 << 4),
            (0x44, MOE | OSSI),
            (0x00, 1 << 5 | 1 << 7),
            (0x14, 1),
        ];
        write(&mut timer, shared, &set);
        shared.effects.clear();
        timer.write(0x00, 1 << 5 | 1 << 7 | 1, !0, shared);
        timer
    }

    #[test]
    fn centred_pulses_stand_around_underflow_and_repetition_halves_the_updates() {
        let mut shared = shared();
        let mut timer = pulses(&mut shared, 1);
        let seen = pass(&mut timer, &mut shared, 450);
        let edges: Vec<_> = seen
            .iter()
            .filter_map(|(at, effect)| match effect {
                Effect::Output(Signal::Tim1Ch1, drive) => Some((*at, *drive)),
                _ => None,
            })
            .collect();
        use Drive::{High, Low};
        assert_eq!(
            edges,
            [(30, Low), (170, High), (230, Low), (370, High), (430, Low)]
        );
        let updates: Vec<_> = seen
            .iter()
            .filter(|(_, effect)| *effect == Effect::Trigger(Trigger::Tim1Trgo))
            .map(|(at, _)| *at)
            .collect();
        // The first at an overflow or an underflow, by the repetitions left at the start.
        assert_eq!(updates, [200, 400]);
    }

    #[test]
    fn a_compare_value_counts_from_the_next_update() {
        let mut shared = shared();
        let mut timer = pulses(&mut shared, 0);
        pass(&mut timer, &mut shared, 50);
        timer.write(0x34, 60, !0, &mut shared);
        let seen = pass(&mut timer, &mut shared, 300);
        let falls: Vec<_> = seen
            .iter()
            .filter(|(_, effect)| *effect == Effect::Output(Signal::Tim1Ch1, Drive::Low))
            .map(|(at, _)| *at)
            .collect();
        assert_eq!(falls, [260]);
    }

    #[test]
    fn a_break_switches_the_outputs_off_until_it_is_gone_and_set_again() {
        let mut shared = shared();
        let mut timer = pulses(&mut shared, 0);
        timer.write(0x44, MOE | OSSI | BKE | BKP, !0, &mut shared);
        shared.effects.clear();
        timer.input(Signal::Tim1Bkin, true, &mut shared);
        assert!(
            shared
                .effects
                .contains(&Effect::Output(Signal::Tim1Ch1, Drive::Low))
        );
        write(
            &mut timer,
            &mut shared,
            &[(0x10, 0), (0x44, MOE | OSSI | BKE | BKP)],
        );
        assert_eq!(timer.read(0x44, &mut shared) & MOE, 0);
        assert_eq!(timer.read(0x10, &mut shared) & BREAK, BREAK);
        timer.input(Signal::Tim1Bkin, false, &mut shared);
        write(
            &mut timer,
            &mut shared,
            &[(0x10, 0), (0x44, MOE | OSSI | BKE | BKP)],
        );
        assert_eq!(timer.read(0x44, &mut shared) & MOE, MOE);
        assert_eq!(timer.read(0x10, &mut shared) & BREAK, 0);
    }

    #[test]
    fn the_reference_of_channel_4_is_a_trigger_once_a_period() {
        let mut shared = shared();
        let mut timer = pulses(&mut shared, 0);
        write(
            &mut timer,
            &mut shared,
            &[(0x1c, 0x7800), (0x40, 90), (0x04, 7 << 4)],
        );
        let seen = pass(&mut timer, &mut shared, 700);
        let triggers: Vec<_> = seen
            .iter()
            .filter(|(_, effect)| *effect == Effect::Trigger(Trigger::Tim1Trgo))
            .map(|(at, _)| *at)
            .collect();
        // At once, since nothing was loaded yet; then at 90 on the way up.
        assert_eq!(triggers, [0, 290, 490, 690]);
    }

    #[test]
    fn an_encoder_counts_filtered_edges_both_ways_and_wraps() {
        let (mut timer, mut shared) = (Timer::new(Kind::Tim3), shared());
        write(
            &mut timer,
            &mut shared,
            &[(0x18, 0xf1f1), (0x08, 3), (0x00, 1)],
        );
        let mut edge = |timer: &mut Timer, at: u64, signal, level| {
            pass(timer, &mut shared, at);
            timer.input(signal, level, &mut shared);
            timer.read(0x24, &mut shared)
        };
        use Signal::{Tim3Ch1 as A, Tim3Ch2 as B};
        edge(&mut timer, 1000, A, true);
        edge(&mut timer, 2000, B, true);
        // A glitch of 200 ns at 16 MHz.
        edge(&mut timer, 3000, A, false);
        edge(&mut timer, 3003, A, true);
        assert_eq!(edge(&mut timer, 4000, A, false), 2);
        edge(&mut timer, 5000, B, false);
        assert_eq!(edge(&mut timer, 6000, B, true), 4);
        for (k, (signal, level)) in [(A, true), (B, false), (A, false), (B, true), (A, true)]
            .into_iter()
            .enumerate()
        {
            edge(&mut timer, 7000 + 1000 * k as u64, signal, level);
        }
        assert_eq!(edge(&mut timer, 20_000, B, false), 0xfffe);
    }
}
