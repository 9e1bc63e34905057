//! Causes of resets, and the flags that show them.

// Reset flags in the RCC's register CSR.
bits! {
    BORRSTF 25, PINRSTF 26, PORRSTF 27, SFTRSTF 28, IWDGRSTF 29, WWDGRSTF 30
}

/// Cause of a reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Power-on.
    PowerOn,
    /// The supply sagged below the brown-out level.
    BrownOut,
    /// Reset pin.
    Pin,
    /// Reset request of the program.
    Software,
    /// Independent watchdog.
    Watchdog,
    /// Window watchdog.
    WindowWatchdog,
}

impl Cause {
    /// Name of the cause, for printed tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::PowerOn => "power on",
            Self::BrownOut => "brown-out",
            Self::Pin => "reset pin",
            Self::Software => "software",
            Self::Watchdog => "watchdog",
            Self::WindowWatchdog => "window watchdog",
        }
    }

    /// True for a power reset, which clears the flags of earlier resets (RM0090, 7.1.2 and 7.3.21).
    pub(crate) fn is_power(self) -> bool {
        matches!(self, Self::PowerOn | Self::BrownOut)
    }

    /// Flags of CSR that this cause sets. Every internal reset also pulls the reset pin low; power-on also sets the
    /// brown-out flag.
    pub(crate) fn flags(self) -> u32 {
        PINRSTF
            | match self {
                Self::PowerOn => PORRSTF | BORRSTF,
                Self::BrownOut => BORRSTF,
                Self::Pin => 0,
                Self::Software => SFTRSTF,
                Self::Watchdog => IWDGRSTF,
                Self::WindowWatchdog => WWDGRSTF,
            }
    }
}
