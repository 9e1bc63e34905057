//! Registers of the converter and their bits (RM0090, chapter 13).

use super::super::pin::Pin;
use super::super::register::{Register, narrow, word};
use super::super::timer::TimerId;

// Offsets of registers.
pub(super) const SR: u32 = 0x00;
pub(super) const CR1: u32 = 0x04;
pub(super) const CR2: u32 = 0x08;
pub(super) const SMPR1: u32 = 0x0c;
pub(super) const SMPR2: u32 = 0x10;
pub(super) const JOFR1: u32 = 0x14;
pub(super) const JOFR4: u32 = 0x20;
pub(super) const HTR: u32 = 0x24;
pub(super) const LTR: u32 = 0x28;
pub(super) const SQR1: u32 = 0x2c;
pub(super) const SQR2: u32 = 0x30;
pub(super) const SQR3: u32 = 0x34;
pub(super) const JSQR: u32 = 0x38;
pub(super) const JDR1: u32 = 0x3c;
pub(super) const JDR4: u32 = 0x48;
pub(super) const DR: u32 = 0x4c;
pub(super) const CSR: u32 = 0x300;
pub(super) const CCR: u32 = 0x304;
pub(super) const CDR: u32 = 0x308;
/// Number of registers that only store the written value.
pub(super) const COUNT: usize = JSQR as usize / 4 + 1;

#[rustfmt::skip]
pub(super) const REGISTERS: &[Register] = &[
    word(SR, "SR", 0x3f), word(CR1, "CR1", 0x07c0_ffff), word(CR2, "CR2", 0x7f7f_0f03), word(SMPR1, "SMPR1", 0x07ff_ffff),
    word(SMPR2, "SMPR2", 0x3fff_ffff), word(JOFR1, "JOFR1", 0xfff), word(0x18, "JOFR2", 0xfff), word(0x1c, "JOFR3", 0xfff),
    word(JOFR4, "JOFR4", 0xfff), word(HTR, "HTR", 0xfff), word(LTR, "LTR", 0xfff), word(SQR1, "SQR1", 0x00ff_ffff),
    word(SQR2, "SQR2", 0x3fff_ffff), word(SQR3, "SQR3", 0x3fff_ffff), word(JSQR, "JSQR", 0x003f_ffff),
    narrow(JDR1, "JDR1", 0xffff), narrow(0x40, "JDR2", 0xffff), narrow(0x44, "JDR3", 0xffff), narrow(JDR4, "JDR4", 0xffff),
    narrow(DR, "DR", 0xffff), word(CSR, "CSR", 0x003f_3f3f), word(CCR, "CCR", 0x00c3_ef1f), word(CDR, "CDR", !0),
];

// Bits of SR.
bits! { pub(super):
    EOC 1, JEOC 2, JSTRT 3, STRT 4, OVR 5
}
// Bits of CR1.
bits! { pub(super):
    EOCIE 5, JEOCIE 7, SCAN 8, OVRIE 26
}
/// Bits of CR1 that are not modelled: JAUTO, DISCEN, JDISCEN, JAWDEN, AWDEN, RES.
pub(super) const UNKNOWN_CR1: u32 = 0x03c0_1c00;
// Bits of CR2.
bits! { pub(super):
    ADON 0, CONT 1, DMA 8, DDS 9, EOCS 10, ALIGN 11
}
pub(super) const JEXTEN: u32 = 3 << 20;
pub(super) const JSWSTART: u32 = 1 << 22;
pub(super) const EXTEN: u32 = 3 << 28;
pub(super) const SWSTART: u32 = 1 << 30;
/// Bits of CCR that are not modelled: MULTI, DMA mode of several converters, VBATE, TSVREFE.
pub(super) const UNKNOWN_COMMON: u32 = 0x00c0_c01f;

/// Sampling times by SMPx, clocks.
pub(super) const SAMPLING: [u64; 8] = [3, 15, 28, 56, 84, 112, 144, 480];

/// Timer whose TRGO starts the regular group, by EXTSEL; `None` for other triggers, which are not modelled.
pub(super) fn regular_trigger(select: u32) -> Option<TimerId> {
    match select & 15 {
        6 => Some(TimerId::Tim2),
        8 => Some(TimerId::Tim3),
        _ => None,
    }
}

/// Timer whose TRGO starts the injected group, by JEXTSEL; `None` for other triggers, which are not modelled.
pub(super) fn injected_trigger(select: u32) -> Option<TimerId> {
    match select & 15 {
        1 => Some(TimerId::Tim1),
        3 => Some(TimerId::Tim2),
        9 => Some(TimerId::Tim4),
        11 => Some(TimerId::Tim5),
        _ => None,
    }
}

/// Pin of a channel; `None` for the internal channels, from 16 on.
pub(super) fn pin(channel: u32) -> Option<Pin> {
    match channel {
        0..=7 => Some(Pin::of(0, channel)),
        8 | 9 => Some(Pin::of(1, channel - 8)),
        10..=15 => Some(Pin::of(2, channel - 10)),
        _ => None,
    }
}
