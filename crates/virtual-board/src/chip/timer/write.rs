//! Writes to a timer's registers.

use super::super::register::merge;
use super::super::shared::Shared;
use super::output::Mode;
use super::registers::*;
use super::{Timer, finding};

impl Timer {
    fn note(&self, kind: finding::FindingKind, text: &str, shared: &mut Shared) {
        shared.note(kind, format!("{}: {text}", self.id.name()));
    }

    fn not_modelled(&self, what: &str, shared: &mut Shared) {
        self.note(finding::FindingKind::NotModelled, what, shared);
    }

    pub(super) fn write_register(
        &mut self,
        offset: u32,
        value: u32,
        mask: u32,
        shared: &mut Shared,
    ) {
        let old = match offset {
            CNT => self.counter.value(shared.now),
            CCR1..=CCR4 => self.channels[(offset - CCR1) as usize / 4].preload,
            _ => self.reg(offset),
        };
        let full = merge(old, value, mask);
        match offset {
            CR1 => self.write_cr1(full & 0x3ff, shared),
            CR2 => self.write_cr2(full & 0x7ffd, shared),
            SMCR => self.write_slave(full & 0xfff7, shared),
            DIER => {
                *self.reg_mut(DIER) = full & 0x7fff;
                if full & 0x7f00 != 0 {
                    self.not_modelled("DMA requests", shared);
                }
            }
            SR => self.write_status(full | !mask),
            EGR => self.generate(value, shared),
            CCMR1 | CCMR2 => self.write_modes(offset, full & 0xffff, shared),
            CCER => self.write_enables(full & 0xffff, shared),
            CNT => self.write_count(full & self.id.max_count(), shared),
            ARR => self.write_reload(full & self.id.max_count(), shared),
            CCR1..=CCR4 => {
                let k = (offset - CCR1) as usize / 4;
                self.channels[k].preload = full & self.id.max_count();
                self.load_immediate(k);
            }
            BDTR => self.write_break(full & 0xffff, shared),
            DCR | DMAR | OR => {
                *self.reg_mut(offset) = full;
                if full != 0 {
                    self.not_modelled("bursts of DMA, remapped inputs", shared);
                }
            }
            _ => *self.reg_mut(offset) = full & 0xffff,
        }
    }

    /// Activates a compare value that has no preload.
    fn load_immediate(&mut self, k: usize) {
        if self.mode_bits(k) & 1 << 3 == 0 {
            self.channels[k].compare = self.channels[k].preload;
        }
    }

    fn write_cr1(&mut self, value: u32, shared: &mut Shared) {
        let (old, now) = (self.reg(CR1), shared.now);
        *self.reg_mut(CR1) = value;
        if value & OPM != 0 {
            self.not_modelled("one-pulse mode", shared);
        }
        let centred = value & CMS != 0;
        if old & CEN != 0 && centred != self.counter.centred {
            let text = "CMS: alignment changed while the counter is enabled";
            self.note(finding::FindingKind::Forbidden, text, shared);
        }
        // In centre-aligned and encoder modes the counter, not the program, sets the direction.
        let own = self.is_encoder() || self.counter.centred && centred;
        let up = if own {
            self.counter.up
        } else {
            value & DIR == 0
        };
        let reload = match value & ARPE {
            0 => self.reg(ARR),
            _ => self.counter.reload,
        };
        if (centred, up, reload) != (self.counter.centred, self.counter.up, self.counter.reload) {
            self.counter.adapt(now, |counter| {
                (counter.centred, counter.up, counter.reload) = (centred, up, reload);
            });
        }
        self.check_capture(shared);
        if (value ^ old) & CEN == 0 {
            return;
        }
        if value & CEN != 0 && !self.is_encoder() {
            // CNT_EN follows CEN by one clock.
            let start = self.counter.edge(now) + self.counter.clock();
            self.counter.stop(now);
            if !self.frozen && !self.gated {
                self.counter.start(start);
            }
            self.matched_until = start;
        }
        if self.master() == 1 {
            self.trgo(value & CEN != 0, shared);
        }
    }

    fn write_cr2(&mut self, value: u32, shared: &mut Shared) {
        let old = std::mem::replace(self.reg_mut(CR2), value);
        if value & (CCPC | TI1S) != 0 {
            self.not_modelled("CCPC, TI1S", shared);
        }
        // When TRGO switches to an OCxREF that is already high, TRGO has an edge.
        let level = |master: u32| master >= 4 && self.channels[master as usize - 4].reference;
        let (was, is) = (level(old >> 4 & 7), level(self.master()));
        if was != is {
            self.trgo(is, shared);
        }
    }

    fn write_slave(&mut self, value: u32, shared: &mut Shared) {
        let now = shared.now;
        *self.reg_mut(SMCR) = value;
        if !matches!(value & 7, 0 | ENCODER) || value & 1 << 14 != 0 {
            let what = "slave modes except encoders with edges of both inputs and external clock";
            self.not_modelled(what, shared);
        }
        if self.is_encoder() {
            self.counter.stop(now);
            if self.reg(PSC) != 0 {
                self.not_modelled("prescaler before an encoder", shared);
            }
        }
    }

    /// Clears the flags written as zero, except that of an active break input.
    fn write_status(&mut self, value: u32) {
        let keep = if self.is_broken() { BREAK } else { 0 };
        *self.reg_mut(SR) &= value | keep;
    }

    fn generate(&mut self, value: u32, shared: &mut Shared) {
        if value & UPDATE != 0 {
            if self.master() == 0 {
                self.pulse(shared);
            }
            if self.reg(CR1) & UDIS == 0 {
                self.update(true, shared);
            }
            self.counter.clear(shared.now);
            self.matched_until = shared.now.saturating_sub(1);
        }
        for k in 0..4 {
            if value >> (k + 1) & 1 != 0 {
                match self.is_output(k) {
                    true => self.compare_flag(k, shared),
                    false => self.not_modelled("input capture", shared),
                }
            }
        }
        if value & BREAK != 0 && self.id == super::TimerId::Tim1 {
            self.do_break(shared);
        }
        if value & (COMMUTATION | TRIGGER) != 0 {
            self.not_modelled("events of commutation and trigger", shared);
        }
    }

    fn write_modes(&mut self, offset: u32, value: u32, shared: &mut Shared) {
        let first = if offset == CCMR1 { 0 } else { 2 };
        *self.reg_mut(offset) = value;
        for k in first..first + 2 {
            let bits = self.mode_bits(k);
            if bits & 3 == 0 && bits & 0x80 != 0 {
                self.not_modelled("OCxCE", shared);
            }
            self.load_immediate(k);
            let is_output = bits & 3 == 0;
            let mode = Mode::of(bits >> 4).filter(|_| is_output);
            if is_output && mode.is_none() {
                self.not_modelled("output modes except frozen and PWM", shared);
            }
            self.change_mode(k, mode.unwrap_or_default(), shared);
        }
        self.check_capture(shared);
    }

    fn change_mode(&mut self, k: usize, mode: Mode, shared: &mut Shared) {
        let before = std::mem::replace(&mut self.channels[k].mode, mode);
        let count = self.counter.value(shared.now);
        self.compare(k, count, shared);
        // A change between the two PWM modes affects the output from the next match on.
        if before == Mode::Frozen
            && let Some(reference) = mode.reference(self.channels[k].inside)
        {
            self.set_reference(k, reference, shared);
        }
    }

    fn write_enables(&mut self, value: u32, shared: &mut Shared) {
        *self.reg_mut(CCER) = value;
        if value & 0x0444 != 0 && self.id == super::TimerId::Tim1 {
            self.not_modelled("complementary outputs", shared);
        }
        self.check_capture(shared);
    }

    /// Records a finding if an input capture, which is not modelled, is enabled.
    fn check_capture(&mut self, shared: &mut Shared) {
        if self.reg(CR1) & CEN == 0 {
            return;
        }
        for k in 0..4 {
            let encodes = self.is_encoder() && k < 2;
            if self.enables(k) & 1 != 0 && !self.is_output(k) && !encodes {
                self.not_modelled("input capture", shared);
            }
        }
    }

    fn write_count(&mut self, value: u32, shared: &mut Shared) {
        // At 0 and at the reload value, a centre-aligned counter sets its direction itself.
        self.counter.set(value, shared.now);
        self.matched_until = shared.now;
    }

    fn write_reload(&mut self, value: u32, shared: &mut Shared) {
        *self.reg_mut(ARR) = value;
        if self.reg(CR1) & ARPE == 0 {
            self.counter
                .adapt(shared.now, |counter| counter.reload = value);
            self.matched_until = shared.now;
        }
    }

    fn write_break(&mut self, value: u32, shared: &mut Shared) {
        let old = std::mem::replace(self.reg_mut(BDTR), value);
        let mut new = value;
        if value & (AOE | LOCK) != 0 {
            self.not_modelled("AOE, LOCK", shared);
        }
        if self.is_broken() {
            new &= !MOE;
            *self.reg_mut(BDTR) = new;
            *self.reg_mut(SR) |= BREAK;
        }
        if (new ^ old) & MOE != 0 {
            self.main_changed(shared);
        }
    }
}
