//! System control block: registers that configure the processor or tell what went wrong.

/// Bits of the configurable fault status register.
pub mod cfsr {
    /// Memory management: fetch.
    pub const IACCVIOL: u32 = 1;
    /// Memory management: data.
    pub const DACCVIOL: u32 = 1 << 1;
    /// Memory management: unstacking.
    pub const MUNSTKERR: u32 = 1 << 3;
    /// Memory management: stacking.
    pub const MSTKERR: u32 = 1 << 4;
    /// Memory management: lazy saving of floating point.
    pub const MLSPERR: u32 = 1 << 5;
    /// MMFAR holds an address.
    pub const MMARVALID: u32 = 1 << 7;
    /// Bus: fetch.
    pub const IBUSERR: u32 = 1 << 8;
    /// Bus: data, precise.
    pub const PRECISERR: u32 = 1 << 9;
    /// Bus: unstacking.
    pub const UNSTKERR: u32 = 1 << 11;
    /// Bus: stacking.
    pub const STKERR: u32 = 1 << 12;
    /// Bus: lazy saving of floating point.
    pub const LSPERR: u32 = 1 << 13;
    /// BFAR holds an address.
    pub const BFARVALID: u32 = 1 << 15;
    /// Usage: undefined instruction.
    pub const UNDEFINSTR: u32 = 1 << 16;
    /// Usage: not in Thumb state.
    pub const INVSTATE: u32 = 1 << 17;
    /// Usage: exception return that does not fit.
    pub const INVPC: u32 = 1 << 18;
    /// Usage: coprocessor that is off or does not exist.
    pub const NOCP: u32 = 1 << 19;
    /// Usage: unaligned.
    pub const UNALIGNED: u32 = 1 << 24;
    /// Usage: division by zero.
    pub const DIVBYZERO: u32 = 1 << 25;
}

/// Bits of the hard fault status register.
pub mod hfsr {
    /// The vector could not be read.
    pub const VECTTBL: u32 = 1 << 1;
    /// Another fault that was disabled or could not be taken.
    pub const FORCED: u32 = 1 << 30;
    /// A breakpoint without debugger.
    pub const DEBUGEVT: u32 = 1 << 31;
}

/// Bits of the configuration and control register.
pub(super) mod ccr {
    pub(crate) const NONBASETHRDENA: u32 = 1;
    pub(crate) const USERSETMPEND: u32 = 1 << 1;
    pub(crate) const UNALIGN_TRP: u32 = 1 << 3;
    pub(crate) const DIV_0_TRP: u32 = 1 << 4;
    pub(crate) const BFHFNMIGN: u32 = 1 << 8;
    pub(crate) const STKALIGN: u32 = 1 << 9;
    pub(crate) const WRITABLE: u32 =
        NONBASETHRDENA | USERSETMPEND | UNALIGN_TRP | DIV_0_TRP | BFHFNMIGN | STKALIGN;
}

/// Bits of the system control register.
pub(super) mod scr {
    pub(crate) const SLEEPONEXIT: u32 = 1 << 1;
    pub(crate) const SLEEPDEEP: u32 = 1 << 2;
    pub(crate) const SEVONPEND: u32 = 1 << 4;
}

/// Bits of the floating-point context control register.
pub(super) mod fpccr {
    pub(crate) const LSPACT: u32 = 1;
    pub(crate) const USER: u32 = 1 << 1;
    pub(crate) const THREAD: u32 = 1 << 3;
    pub(crate) const HFRDY: u32 = 1 << 4;
    pub(crate) const MMRDY: u32 = 1 << 5;
    pub(crate) const BFRDY: u32 = 1 << 6;
    pub(crate) const MONRDY: u32 = 1 << 8;
    pub(crate) const LSPEN: u32 = 1 << 30;
    pub(crate) const ASPEN: u32 = 1 << 31;
    pub(crate) const STATE: u32 = LSPACT | USER | THREAD | HFRDY | MMRDY | BFRDY | MONRDY;
}

#[derive(Clone, Debug, Default)]
pub(super) struct Scb {
    pub(super) actlr: u32,
    pub(super) vtor: u32,
    pub(super) scr: u32,
    pub(super) ccr: u32,
    pub(super) cfsr: u32,
    pub(super) hfsr: u32,
    pub(super) dfsr: u32,
    pub(super) mmfar: u32,
    pub(super) bfar: u32,
    pub(super) cpacr: u32,
    pub(super) fpccr: u32,
    pub(super) fpcar: u32,
    pub(super) fpdscr: u32,
    /// Bits of DEMCR but TRCENA.
    pub(super) demcr: u32,
}

impl Scb {
    pub(super) fn after_reset() -> Self {
        Self {
            ccr: ccr::STKALIGN,
            fpccr: fpccr::ASPEN | fpccr::LSPEN,
            ..Self::default()
        }
    }
}

/// Identification registers of a Cortex-M4 r0p1 with floating point, from 0xE000_ED40 on.
pub(super) const IDENTIFICATION: [u32; 13] = [
    0x0000_0030,
    0x0000_0200,
    0x0010_0000,
    0x0000_0000,
    0x0010_0030,
    0x0000_0000,
    0x0100_0000,
    0x0000_0000,
    0x0110_1110,
    0x0211_2000,
    0x2123_2231,
    0x0111_1131,
    0x0131_0102,
];

/// CPUID: Cortex-M4 r0p1.
pub(super) const CPUID: u32 = 0x410f_c241;

/// MVFR0 and MVFR1.
pub(super) const MEDIA: [u32; 2] = [0x1011_0021, 0x1100_0011];

/// VECTKEY, high half of a write to AIRCR, and what reads there.
pub(super) const VECTKEY: u32 = 0x05fa;
pub(super) const VECTKEYSTAT: u32 = 0xfa05_0000;
