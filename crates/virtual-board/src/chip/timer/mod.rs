//! Timers TIM1 to TIM5: counting, compare, PWM with break, encoders, triggers.
//!
//! Source: reference manual RM0090, chapters 17 and 18. The counter is not stepped: its value is computed from the
//! time. Compare matches and update events are applied at the next access. Only events that something depends on are
//! scheduled: interrupts, triggers, outputs.
//!
//! Choices where the manual is unclear:
//!
//! - The counter starts at the second edge of its clock after CEN is set (manual: CNT_EN is set one clock after CEN).
//! - A counter above its reload value counts to its full width and continues at 0, without an event.
//! - TRGO from OCxREF needs neither CCxE nor MOE.
//! - MOE and the break input act at once; the one or two clocks of resynchronization are omitted.
//!
//! Not modelled: output modes except frozen and PWM; complementary outputs with dead time; one-pulse mode; AOE; LOCK;
//! input capture; slave modes except encoder mode 3 (all edges count); DMA requests; OCxCE; CCPC; TI1S; the remapping
//! in OR; a prescaler with an encoder. Enabling one of these is a finding.

mod counter;
mod encoder;
mod input;
mod output;
mod registers;
#[cfg(test)]
mod tests;
mod write;

use super::Peripheral;
use super::effect::Effect;
use super::pin::{Drive, Signal};
use super::register::{Register, merge};
use super::shared::Shared;
use crate::finding;
use crate::time::{Cycles, NEVER};
use counter::{Counter, Turn};
use input::Input;
use output::Mode;
pub(crate) use registers::TimerId;
use registers::*;

#[derive(Clone, Copy, Debug, Default)]
struct Channel {
    preload: u32,
    /// Active compare value.
    compare: u32,
    mode: Mode,
    /// Level of OCxREF.
    reference: bool,
    /// Latest result of the PWM comparison, see [`output::is_inside`].
    inside: bool,
    /// Drive of the pin by the output.
    drive: Drive,
}

/// Events that must be scheduled because something depends on them.
#[derive(Clone, Copy, Debug, Default)]
struct Needs {
    update: bool,
    /// Channels whose compare match is needed, one bit each.
    channels: u32,
}

#[derive(Clone)]
pub(crate) struct Timer {
    id: TimerId,
    /// Registers as written, by offset / 4.
    plain: [u32; COUNT],
    counter: Counter,
    channels: [Channel; 4],
    /// Overflows and underflows left until the next update.
    repetitions: u32,
    /// Compare matches up to this cycle have been applied.
    matched_until: Cycles,
    needs: Needs,
    inputs: [Input; 4],
    break_level: bool,
    /// True if an input filter may be running.
    timed: bool,
    /// True while a debugger halts the core and DBGMCU stops the timer.
    frozen: bool,
    /// True while the timer's clock is off.
    gated: bool,
}

impl Timer {
    /// A timer after a reset.
    pub fn new(id: TimerId) -> Self {
        let mut plain = [0; COUNT];
        plain[ARR as usize / 4] = id.max_count();
        Self {
            id,
            plain,
            counter: Counter::new(id.max_count()),
            channels: [Channel::default(); 4],
            repetitions: 0,
            matched_until: 0,
            needs: Needs::default(),
            inputs: [Input::default(); 4],
            break_level: false,
            timed: false,
            frozen: false,
            gated: false,
        }
    }

    /// Stops the timer while a debugger halts the core, or resumes it. Meanwhile the outputs of TIM1 are off, as with
    /// MOE clear.
    pub fn freeze(&mut self, frozen: bool, shared: &mut Shared) {
        self.sync(shared);
        let was = std::mem::replace(&mut self.frozen, frozen);
        if was != frozen && self.id == TimerId::Tim1 {
            self.main_changed(shared);
        }
        self.adjust(shared);
    }

    /// Stops the timer while its clock is off, or resumes it.
    pub fn gate(&mut self, off: bool, shared: &mut Shared) {
        if self.gated != off {
            self.sync(shared);
            self.gated = off;
            self.adjust(shared);
        }
    }

    /// Switches the outputs off after a failure of the crystal, if the break input is enabled.
    pub fn clock_failure(&mut self, shared: &mut Shared) {
        if self.reg(BDTR) & BKE != 0 {
            self.sync(shared);
            self.do_break(shared);
            self.adjust(shared);
        }
    }

    fn reg(&self, offset: u32) -> u32 {
        self.plain[offset as usize / 4]
    }

    fn reg_mut(&mut self, offset: u32) -> &mut u32 {
        &mut self.plain[offset as usize / 4]
    }

    /// MMS of CR2: source of TRGO.
    fn master(&self) -> u32 {
        self.reg(CR2) >> 4 & 7
    }

    /// Eight bits of CCMRx for a channel.
    fn mode_bits(&self, k: usize) -> u32 {
        self.reg(if k < 2 { CCMR1 } else { CCMR2 }) >> (8 * (k % 2)) & 0xff
    }

    /// True if a channel is an output (CCxS).
    fn is_output(&self, k: usize) -> bool {
        self.mode_bits(k) & 3 == 0
    }

    /// CCxE and CCxP of a channel.
    fn enables(&self, k: usize) -> u32 {
        self.reg(CCER) >> (4 * k) & 3
    }

    /// True if the outputs are enabled as a whole.
    fn main_enabled(&self) -> bool {
        self.id != TimerId::Tim1 || self.reg(BDTR) & MOE != 0 && !self.frozen
    }

    /// Core cycles in one period of f_DTS.
    fn sampling(&self) -> u64 {
        self.counter.clock() << (self.reg(CR1) >> 8 & 3).min(2)
    }

    /// Applies everything that has happened up to now.
    fn sync(&mut self, shared: &mut Shared) {
        self.catch_up(shared);
        let clock = self.id.clock(&shared.clocks);
        if clock != self.counter.clock() {
            self.counter.set_clock(clock, shared.now);
            self.matched_until = shared.now;
        }
    }

    fn catch_up(&mut self, shared: &mut Shared) {
        let now = shared.now;
        // After this number of turns or restarts, count, direction and repetition counter have their old values.
        let stretch = 4 * (self.reg(RCR) + 1);
        let mut legs = 0;
        while let Some(end) = self.counter.end() {
            self.apply_matches(now.min(end - 1), shared);
            if end > now {
                break;
            }
            self.turn(end, shared);
            self.matched_until = end - 1;
            legs += 1;
            if legs > 2 * stretch {
                self.counter.skip(stretch.into(), now);
                legs = 0;
            }
        }
        self.matched_until = self.matched_until.max(now);
    }

    /// Channels whose compare match has no effect, one bit each: the flag is set already, and the output is frozen.
    fn idle(&self) -> u32 {
        let up = self.reg(SR) >> 1 & !self.needs.channels;
        let still = |k: &usize| self.channels[*k].mode == Mode::Frozen;
        (0..4).filter(still).fold(0, |idle, k| idle | up & 1 << k)
    }

    /// Applies the compare matches up to cycle `last`, which is before the counter's next turn or restart.
    fn apply_matches(&mut self, last: Cycles, shared: &mut Shared) {
        let idle = self.idle();
        for k in (0..4).filter(|k| idle >> k & 1 == 0) {
            let met = self.counter.meets(self.channels[k].compare);
            if met.is_some_and(|at| at > self.matched_until && at <= last) {
                self.matched(k, shared);
            }
        }
    }

    /// Handles a compare match of a channel.
    fn matched(&mut self, k: usize, shared: &mut Shared) {
        if !self.is_output(k) {
            return;
        }
        let compare = self.channels[k].compare;
        // A match at 0 or at the reload value of a centre-aligned count belongs to both directions.
        let end = compare == 0 || compare == self.counter.reload;
        let wanted = match self.reg(CR1) & CMS {
            0x20 => end || !self.counter.up,
            0x40 => end || self.counter.up,
            _ => true,
        };
        if wanted || self.is_encoder() {
            self.compare_flag(k, shared);
        }
        self.compare(k, compare, shared);
    }

    /// Sets CCxIF, with its trigger and interrupt.
    fn compare_flag(&mut self, k: usize, shared: &mut Shared) {
        *self.reg_mut(SR) |= 2 << k;
        if k == 0 && self.master() == 3 {
            self.pulse(shared);
        }
        if self.reg(DIER) & 2 << k != 0 {
            self.line(shared);
        }
    }

    /// Emits a short pulse of TRGO.
    fn pulse(&self, shared: &mut Shared) {
        self.trgo(true, shared);
        self.trgo(false, shared);
    }

    /// Emits an edge of TRGO.
    fn trgo(&self, rises: bool, shared: &mut Shared) {
        shared.effect(Effect::Trigger {
            timer: self.id,
            rises,
        });
    }

    /// Updates the PWM comparison for the counter at `count`.
    fn compare(&mut self, k: usize, count: u32, shared: &mut Shared) {
        let channel = &mut self.channels[k];
        let inside = output::is_inside(count, channel.compare, self.counter.up);
        if inside != channel.inside {
            channel.inside = inside;
            if let Some(reference) = channel.mode.reference(inside) {
                self.set_reference(k, reference, shared);
            }
        }
    }

    fn compare_all(&mut self, shared: &mut Shared) {
        let count = self.counter.value(shared.now);
        for k in 0..4 {
            self.compare(k, count, shared);
        }
    }

    /// Sets the level of OCxREF.
    fn set_reference(&mut self, k: usize, reference: bool, shared: &mut Shared) {
        if reference == self.channels[k].reference {
            return;
        }
        self.channels[k].reference = reference;
        if self.master() == 4 + k as u32 {
            self.trgo(reference, shared);
        }
        if self.enables(k) & 1 != 0 {
            self.drive(k, shared);
        }
    }

    /// Recomputes the drive of a channel's output (RM0090, table of the output control bits).
    fn drive(&mut self, k: usize, shared: &mut Shared) {
        let enables = self.enables(k);
        let level = if enables & 1 == 0 || !self.is_output(k) {
            None
        } else if self.main_enabled() {
            Some(self.channels[k].reference != (enables & 2 != 0))
        } else {
            // Idle level OISx.
            (self.reg(BDTR) & OSSI != 0).then_some(self.reg(CR2) >> (8 + 2 * k) & 1 != 0)
        };
        let drive = level.map_or(Drive::Open, Drive::to);
        let before = std::mem::replace(&mut self.channels[k].drive, drive);
        if before == drive {
            return;
        }
        let signal = Signal::CHANNELS[self.id as usize][k];
        shared.effect(Effect::Output(signal, drive));
    }

    fn drive_all(&mut self, shared: &mut Shared) {
        for k in 0..4 {
            self.drive(k, shared);
        }
    }

    /// Turns or restarts the counter at cycle `end`.
    fn turn(&mut self, end: Cycles, shared: &mut Shared) {
        let turn = self.counter.turn();
        self.ended(turn, shared);
        self.counter.next_leg(turn, end);
        let from = self.counter.value(end);
        for k in 0..4 {
            self.compare(k, from, shared);
        }
    }

    /// Handles an overflow or underflow.
    fn ended(&mut self, turn: Turn, shared: &mut Shared) {
        if turn == Turn::Wrap {
            return;
        }
        self.compare_beyond(turn, shared);
        let updates = self.repetitions == 0 && self.reg(CR1) & UDIS == 0;
        self.repetitions = self.repetitions.saturating_sub(1);
        if updates {
            self.update(false, shared);
        }
    }

    /// Sets the flags of channels whose compare value exceeds the reload value; with centre-aligned counting only at
    /// the overflow.
    fn compare_beyond(&mut self, turn: Turn, shared: &mut Shared) {
        if self.counter.centred && turn == Turn::Underflow {
            return;
        }
        for k in 0..4 {
            if self.is_output(k) && self.channels[k].compare > self.counter.reload {
                self.compare_flag(k, shared);
            }
        }
    }

    /// Handles an update event: preloaded values become active.
    fn update(&mut self, by_software: bool, shared: &mut Shared) {
        self.counter.reload = self.reg(ARR);
        self.counter.set_prescaler(self.reg(PSC));
        self.repetitions = self.reg(RCR);
        for channel in &mut self.channels {
            channel.compare = channel.preload;
        }
        if !(by_software && self.reg(CR1) & URS != 0) {
            *self.reg_mut(SR) |= UPDATE;
        }
        if self.master() == 2 {
            self.pulse(shared);
        }
        if self.reg(DIER) & UPDATE != 0 {
            self.line(shared);
        }
    }

    /// Updates the interrupt lines.
    fn line(&self, shared: &mut Shared) {
        let active = self.reg(SR) & self.reg(DIER);
        for &(interrupt, flags) in self.id.lines() {
            shared.line(interrupt, active & flags != 0);
        }
    }

    /// True if the break input is active.
    fn is_broken(&self) -> bool {
        let bdtr = self.reg(BDTR);
        bdtr & BKE != 0 && self.break_level == (bdtr & BKP != 0)
    }

    fn do_break(&mut self, shared: &mut Shared) {
        *self.reg_mut(SR) |= BREAK;
        if self.reg(BDTR) & MOE != 0 {
            *self.reg_mut(BDTR) &= !MOE;
            self.main_changed(shared);
        }
        self.line(shared);
    }

    /// Applies a change of MOE.
    fn main_changed(&mut self, shared: &mut Shared) {
        for k in 0..4 {
            self.drive(k, shared);
        }
        self.update_needs();
    }

    /// Derives from the registers which events must be scheduled.
    fn update_needs(&mut self) {
        let dier = self.reg(DIER);
        let master = self.master();
        let update = dier & UPDATE != 0 || master == 2;
        let mut channels = 0;
        for k in (0..4).filter(|&k| self.is_output(k)) {
            let flag = dier >> (k + 1) & 1 != 0 || k == 0 && master == 3;
            let reference =
                self.enables(k) & 1 != 0 && self.main_enabled() || master == 4 + k as u32;
            let follows = self.channels[k].mode != Mode::Frozen;
            channels |= u32::from(flag || reference && follows) << k;
        }
        self.needs = Needs {
            update: update || channels != 0,
            channels,
        };
    }

    /// Schedules the next event.
    fn plan(&mut self, shared: &mut Shared) {
        let mut next = NEVER;
        if self.needs.update
            && let Some(end) = self.counter.end()
        {
            next = end;
            for k in 0..4 {
                if self.needs.channels >> k & 1 != 0
                    && let Some(at) = self.counter.meets(self.channels[k].compare)
                    && at > self.matched_until
                {
                    next = next.min(at);
                }
            }
        }
        if self.timed {
            let first = self.inputs.iter().filter_map(|input| input.due).min();
            self.timed = first.is_some();
            next = next.min(first.unwrap_or(NEVER));
        }
        shared.schedule(self.id.unit(), next);
    }

    /// Ends the input filters due by `now`.
    fn end_times(&mut self, now: Cycles, shared: &mut Shared) {
        for which in 0..2 {
            let input = &mut self.inputs[which];
            if input.due.is_some_and(|due| due <= now) && input.pass() {
                self.encoder_edge(which, shared);
            }
        }
    }

    /// Updates everything that depends on the registers after a write.
    fn adjust(&mut self, shared: &mut Shared) {
        let now = shared.now;
        let runs = self.reg(CR1) & CEN != 0 && !self.is_encoder() && !self.frozen && !self.gated;
        if runs != self.counter.runs() {
            if runs {
                self.counter.start(self.counter.edge(now));
            } else {
                self.counter.stop(now);
            }
        }
        self.update_needs();
        self.compare_all(shared);
        self.drive_all(shared);
        self.line(shared);
        self.plan(shared);
    }
}

impl Peripheral for Timer {
    fn registers(&self) -> &'static [Register] {
        self.id.registers()
    }

    fn read(&mut self, offset: u32, shared: &mut Shared) -> u32 {
        self.sync(shared);
        match offset {
            CR1 => {
                let down = u32::from(!self.counter.up) * DIR;
                merge(self.reg(CR1), down, DIR)
            }
            EGR => 0,
            CNT => self.counter.value(shared.now),
            CCR1..=CCR4 => self.channels[(offset - CCR1) as usize / 4].preload,
            _ => self.reg(offset),
        }
    }

    fn write(&mut self, offset: u32, value: u32, mask: u32, shared: &mut Shared) {
        self.sync(shared);
        self.write_register(offset, value, mask, shared);
        self.adjust(shared);
    }

    fn event(&mut self, shared: &mut Shared) {
        let now = shared.now;
        self.sync(shared);
        if self.timed {
            self.end_times(now, shared);
        }
        self.plan(shared);
    }

    fn clocks_changed(&mut self, shared: &mut Shared) {
        self.sync(shared);
        self.plan(shared);
    }
}
