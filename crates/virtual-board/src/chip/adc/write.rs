//! Effects of writing the registers (RM0090, 13.13).

use super::registers::*;
use super::{Adc, Conversion, STABILISATION};
use crate::chip::map::Unit;
use crate::chip::shared::Shared;
use crate::finding::Kind;
use crate::time::NEVER;

impl Adc {
    pub(super) fn write_cr1(&mut self, value: u32, shared: &mut Shared) {
        self.plain[CR1 as usize / 4] = value;
        if value & UNKNOWN_CR1 != 0 {
            let text = "ADC1: DISCEN, JDISCEN, JAUTO, analogue watchdog, resolution";
            shared.note(Kind::NotModelled, text);
        }
    }

    pub(super) fn write_cr2(&mut self, value: u32, shared: &mut Shared) {
        let old = self.cr2();
        self.plain[CR2 as usize / 4] = value & !(SWSTART | JSWSTART);
        let features = [
            (ALIGN, "ADC1: results aligned to the left"),
            (CONT, "ADC1: continuous conversions"),
        ];
        shared.note_not_modelled(value, &features);
        let regular = value & EXTEN != 0 && regular_trigger(value >> 24).is_none();
        let injected = value & JEXTEN != 0 && injected_trigger(value >> 16).is_none();
        if regular || injected {
            let text = "ADC1: triggers except TRGO of TIM1 to TIM5";
            shared.note(Kind::NotModelled, text);
        }
        if value & ADON == 0 {
            if value & (SWSTART | JSWSTART) != 0 {
                shared.note(Kind::Forbidden, "ADC1: started while it is off");
            }
            self.places = [None; 2];
            self.conversion = None;
            shared.cancel_sample();
            shared.schedule(Unit::Adc, NEVER);
        } else if old & ADON == 0 {
            self.stable = shared.time() + STABILISATION;
            self.checked = 0;
        }
        if value & !old & DMA != 0 {
            self.silent = false;
            self.ask(shared);
        }
        if value & ADON != 0 {
            if value & JSWSTART != 0 {
                self.start(true, shared);
            }
            if value & SWSTART != 0 {
                self.start(false, shared);
            }
        }
    }

    /// Restarts a sequence that is written while it is converted.
    pub(super) fn write_sequence(&mut self, injected: bool, shared: &mut Shared) {
        if self.place(injected).is_none() {
            return;
        }
        shared.note(
            Kind::Forbidden,
            "ADC1: a sequence is written while it is converted",
        );
        *self.place(injected) = Some(0);
        if self.conversion.is_some_and(|c| c.injected == injected) {
            self.sample_next(0, shared);
        }
    }

    pub(super) fn write_sampling(&mut self, offset: u32, value: u32, shared: &mut Shared) {
        let now = shared.now;
        let sampling = self.conversion.filter(|c| now < c.sampled);
        if let Some(Conversion { channel, .. }) = sampling {
            let before = self.sampling(channel);
            self.plain[offset as usize / 4] = value;
            if self.sampling(channel) != before {
                let text = "ADC1: SMPRx changed while the channel is sampled";
                shared.note(Kind::Forbidden, text);
            }
        }
        self.plain[offset as usize / 4] = value;
    }
}
