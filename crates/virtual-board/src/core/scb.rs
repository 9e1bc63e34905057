//! System control block: configuration of the core, fault status.

/// Bits of the configurable fault status register: memory management, bus, usage.
pub(super) mod cfsr {
    bits! { pub(crate):
        IACCVIOL 0, DACCVIOL 1, MUNSTKERR 3, MSTKERR 4, MLSPERR 5, MMARVALID 7
    }
    bits! { pub(crate):
        IBUSERR 8, PRECISERR 9, UNSTKERR 11, STKERR 12, LSPERR 13, BFARVALID 15
    }
    bits! { pub(crate):
        UNDEFINSTR 16, INVSTATE 17, INVPC 18, NOCP 19, UNALIGNED 24, DIVBYZERO 25
    }
}

/// Bits of the hard fault status register.
pub(super) mod hfsr {
    bits! { pub(crate):
        VECTTBL 1, FORCED 30, DEBUGEVT 31
    }
}

/// Bits of the configuration and control register.
pub(super) mod ccr {
    bits! { pub(crate):
        NONBASETHRDENA 0, USERSETMPEND 1, UNALIGN_TRP 3, DIV_0_TRP 4, BFHFNMIGN 8, STKALIGN 9
    }
    pub(crate) const WRITABLE: u32 =
        NONBASETHRDENA | USERSETMPEND | UNALIGN_TRP | DIV_0_TRP | BFHFNMIGN | STKALIGN;
}

/// Bits of the system control register.
pub(super) mod scr {
    bits! { pub(crate):
        SLEEPONEXIT 1, SLEEPDEEP 2, SEVONPEND 4
    }
}

/// Bits of the floating-point context control register.
pub(super) mod fpccr {
    bits! { pub(crate):
        LSPACT 0, USER 1, THREAD 3, HFRDY 4, MMRDY 5, BFRDY 6, MONRDY 8, LSPEN 30, ASPEN 31
    }
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
    /// DEMCR without TRCENA.
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

/// Key in the upper halfword of a write to AIRCR, and the value read there.
pub(super) const VECTKEY: u32 = 0x05fa;
pub(super) const VECTKEYSTAT: u32 = 0xfa05_0000;
