//! Offsets and bits of the registers (RM0090, "CAN registers").

use super::super::register::{Register, word};
use super::filter::ALL;

// Bits of MCR.
bits! { pub(super):
    INRQ 0, SLEEP 1, TXFP 2, RFLM 3, NART 4, AWUM 5, ABOM 6, TTCM 7, RESET 15
}
pub(super) const MCR_BITS: u32 = 0x0001_80ff;
pub(super) const MCR_RESET: u32 = 1 << 16 | SLEEP;

// Bits of MSR.
bits! { pub(super):
    INAK 0, SLAK 1, ERRI 2, SLAKI 4, TXM 8
}
/// Bits of MSR for the last sample and the level of the receive pin, both recessive.
pub(super) const RECESSIVE: u32 = 3 << 10;

/// Bits of IER.
pub(super) const TMEIE: u32 = 1;
pub(super) const FMPIE: [u32; 2] = [1 << 1, 1 << 4];
pub(super) const FFIE: [u32; 2] = [1 << 2, 1 << 5];
pub(super) const FOVIE: [u32; 2] = [1 << 3, 1 << 6];
bits! { pub(super):
    EWGIE 8, EPVIE 9, BOFIE 10, LECIE 11, ERRIE 15, WKUIE 16, SLKIE 17
}
pub(super) const IER_BITS: u32 = 0x0003_8f7f;

// Bits of ESR.
bits! { pub(super):
    EWGF 0, EPVF 1, BOFF 2
}
pub(super) const LEC: u32 = 7 << 4;

/// Bits of BTR.
pub(super) const SILM: u32 = 1 << 31;
pub(super) const LBKM: u32 = 1 << 30;
pub(super) const BTR_BITS: u32 = 0xc37f_03ff;

const TDTR_BITS: u32 = 0xffff_010f;
pub(super) const FMR_BITS: u32 = 0x3f01;
/// Reserved bits of FMR whose reset value is one.
pub(super) const FMR_ONES: u32 = 0x2a1c_0000;

pub(super) const MAILBOXES: u32 = 0x180;
pub(super) const OUTPUTS: u32 = 0x1b0;
pub(super) const BANKS: u32 = 0x240;

macro_rules! registers {
    (outgoing: $($out:literal)*; incoming: $($in:literal)*; filters: $($bank:literal)*) => {
        [
            word(0x00, "MCR", MCR_BITS), word(0x04, "MSR", 0xf1f), word(0x08, "TSR", 0xff8f_8f8f),
            word(0x0c, "RF0R", 0x3b), word(0x10, "RF1R", 0x3b), word(0x14, "IER", IER_BITS),
            word(0x18, "ESR", 0xffff_0077), word(0x1c, "BTR", BTR_BITS),
            $(
                word(MAILBOXES + 16 * $out, concat!("TI", $out, "R"), !0),
                word(MAILBOXES + 16 * $out + 4, concat!("TDT", $out, "R"), TDTR_BITS),
                word(MAILBOXES + 16 * $out + 8, concat!("TDL", $out, "R"), !0),
                word(MAILBOXES + 16 * $out + 12, concat!("TDH", $out, "R"), !0),
            )*
            $(
                word(OUTPUTS + 16 * $in, concat!("RI", $in, "R"), !1),
                word(OUTPUTS + 16 * $in + 4, concat!("RDT", $in, "R"), 0xffff_ff0f),
                word(OUTPUTS + 16 * $in + 8, concat!("RDL", $in, "R"), !0),
                word(OUTPUTS + 16 * $in + 12, concat!("RDH", $in, "R"), !0),
            )*
            word(0x200, "FMR", FMR_BITS).keeping(FMR_ONES), word(0x204, "FM1R", ALL),
            word(0x20c, "FS1R", ALL), word(0x214, "FFA1R", ALL), word(0x21c, "FA1R", ALL),
            $(
                word(BANKS + 8 * $bank, concat!("F", $bank, "R1"), !0),
                word(BANKS + 8 * $bank + 4, concat!("F", $bank, "R2"), !0),
            )*
        ]
    };
}

pub(super) const REGISTERS: [Register; 89] = registers!(
    outgoing: 0 1 2;
    incoming: 0 1;
    filters: 0 1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27
);
