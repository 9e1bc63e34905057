//! Registers of the timers and their bits (RM0090, chapters 17 and 18).

use super::super::effect::Clocks;
pub(crate) use super::super::effect::TimerId;
use super::super::interrupt::Interrupt;
use super::super::map::Unit;
use super::super::register::{Register, narrow};

impl TimerId {
    pub const ALL: [Self; 5] = [Self::Tim1, Self::Tim2, Self::Tim3, Self::Tim4, Self::Tim5];

    pub fn name(self) -> &'static str {
        ["TIM1", "TIM2", "TIM3", "TIM4", "TIM5"][self as usize]
    }

    pub fn unit(self) -> Unit {
        Unit::SCHEDULED[Unit::Tim1 as usize + self as usize]
    }

    /// Largest value of the counter.
    pub fn max_count(self) -> u32 {
        match self {
            Self::Tim2 | Self::Tim5 => !0,
            _ => 0xffff,
        }
    }

    /// Core cycles in one cycle of the timer's clock.
    pub fn clock(self, clocks: &Clocks) -> u64 {
        match self {
            Self::Tim1 => clocks.timer2,
            _ => clocks.timer1,
        }
    }

    /// Interrupt lines, each with its flags of SR.
    pub fn lines(self) -> &'static [(Interrupt, u32)] {
        match self {
            Self::Tim1 => &[
                (Interrupt::Tim1Break, BREAK),
                (Interrupt::Tim1Update, UPDATE),
                (Interrupt::Tim1Trigger, TRIGGER | COMMUTATION),
                (Interrupt::Tim1Compare, 0x1e),
            ],
            Self::Tim2 => &[(Interrupt::Tim2, 0x5f)],
            Self::Tim3 => &[(Interrupt::Tim3, 0x5f)],
            Self::Tim4 => &[(Interrupt::Tim4, 0x5f)],
            Self::Tim5 => &[(Interrupt::Tim5, 0x5f)],
        }
    }

    pub fn registers(self) -> &'static [Register] {
        match self {
            Self::Tim1 => ADVANCED,
            Self::Tim2 => TIM2,
            Self::Tim5 => TIM5,
            Self::Tim3 | Self::Tim4 => HALF,
        }
    }
}

// Offsets of the timer's registers.
pub(super) const CR1: u32 = 0x00;
pub(super) const CR2: u32 = 0x04;
pub(super) const SMCR: u32 = 0x08;
pub(super) const DIER: u32 = 0x0c;
pub(super) const SR: u32 = 0x10;
pub(super) const EGR: u32 = 0x14;
pub(super) const CCMR1: u32 = 0x18;
pub(super) const CCMR2: u32 = 0x1c;
pub(super) const CCER: u32 = 0x20;
pub(super) const CNT: u32 = 0x24;
pub(super) const PSC: u32 = 0x28;
pub(super) const ARR: u32 = 0x2c;
pub(super) const RCR: u32 = 0x30;
pub(super) const CCR1: u32 = 0x34;
pub(super) const CCR4: u32 = 0x40;
pub(super) const BDTR: u32 = 0x44;
pub(super) const DCR: u32 = 0x48;
pub(super) const DMAR: u32 = 0x4c;
pub(super) const OR: u32 = 0x50;
/// Number of registers of a timer.
pub(super) const COUNT: usize = 21;

// Bits of CR1.
bits! { pub(super):
    CEN 0, UDIS 1, URS 2, OPM 3, DIR 4
}
/// SMS: encoder mode that counts the edges of both inputs.
pub(super) const ENCODER: u32 = 3;
pub(super) const CMS: u32 = 3 << 5;
pub(super) const ARPE: u32 = 1 << 7;
// Bits of CR2.
pub(super) const CCPC: u32 = 1;
pub(super) const TI1S: u32 = 1 << 7;
// Bits of SR, DIER and EGR.
bits! { pub(super):
    UPDATE 0, COMMUTATION 5, TRIGGER 6, BREAK 7
}
// Bits of BDTR.
bits! { pub(super):
    MOE 15, AOE 14, BKP 13, BKE 12, OSSI 10
}
pub(super) const LOCK: u32 = 3 << 8;

#[rustfmt::skip]
const ADVANCED: &[Register] = &[
    narrow(CR1, "CR1", 0x3ff), narrow(CR2, "CR2", 0x7ffd), narrow(SMCR, "SMCR", 0xfff7), narrow(DIER, "DIER", 0x7fff),
    narrow(SR, "SR", 0x1eff), narrow(EGR, "EGR", 0xff), narrow(CCMR1, "CCMR1", 0xffff), narrow(CCMR2, "CCMR2", 0xffff),
    narrow(CCER, "CCER", 0x3fff), narrow(CNT, "CNT", 0xffff), narrow(PSC, "PSC", 0xffff), narrow(ARR, "ARR", 0xffff),
    narrow(RCR, "RCR", 0xff), narrow(CCR1, "CCR1", 0xffff), narrow(0x38, "CCR2", 0xffff), narrow(0x3c, "CCR3", 0xffff),
    narrow(CCR4, "CCR4", 0xffff), narrow(BDTR, "BDTR", 0xffff), narrow(DCR, "DCR", 0x1f1f), narrow(DMAR, "DMAR", 0xffff),
];

macro_rules! general {
    ($max:literal $(, $remap:literal)?) => {
        &[
            narrow(CR1, "CR1", 0x3ff), narrow(CR2, "CR2", 0xf8), narrow(SMCR, "SMCR", 0xfff7),
            narrow(DIER, "DIER", 0x5f5f), narrow(SR, "SR", 0x1e5f), narrow(EGR, "EGR", 0x5f),
            narrow(CCMR1, "CCMR1", 0xffff), narrow(CCMR2, "CCMR2", 0xffff), narrow(CCER, "CCER", 0xbbbb),
            narrow(CNT, "CNT", $max), narrow(PSC, "PSC", 0xffff), narrow(ARR, "ARR", $max),
            narrow(CCR1, "CCR1", $max), narrow(0x38, "CCR2", $max), narrow(0x3c, "CCR3", $max),
            narrow(CCR4, "CCR4", $max), narrow(DCR, "DCR", 0x1f1f), narrow(DMAR, "DMAR", 0xffff),
            $(narrow(OR, "OR", $remap),)?
        ]
    };
}

const TIM2: &[Register] = general!(0xffff_ffff, 0xc00);
const TIM5: &[Register] = general!(0xffff_ffff, 0xc0);
const HALF: &[Register] = general!(0xffff);
