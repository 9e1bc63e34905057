//! Outputs of a timer: reference signals, polarity, dead time, break.

use super::super::pin::{Drive, Signal};

/// A channel's output mode, as OCxM says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mode {
    Frozen,
    SetOnMatch,
    ClearOnMatch,
    Toggle,
    ForceLow,
    ForceHigh,
    Pulse1,
    Pulse2,
}

impl Mode {
    pub fn of(bits: u32) -> Self {
        [
            Self::Frozen,
            Self::SetOnMatch,
            Self::ClearOnMatch,
            Self::Toggle,
            Self::ForceLow,
            Self::ForceHigh,
            Self::Pulse1,
            Self::Pulse2,
        ][bits as usize & 7]
    }

    /// The reference signal with the counter at `count`, going up or down (RM0090, 17.3.10).
    pub fn reference(self, count: u32, compare: u32, up: bool, before: bool) -> bool {
        let inside = if up {
            count < compare
        } else {
            count <= compare
        };
        match self {
            Self::Frozen => before,
            Self::ForceLow => false,
            Self::ForceHigh => true,
            Self::Pulse1 => inside,
            Self::Pulse2 => !inside,
            Self::SetOnMatch => before || count == compare,
            Self::ClearOnMatch => before && count != compare,
            Self::Toggle => before != (count == compare),
        }
    }
}

/// Dead time of DTG in cycles of f_DTS (RM0090, TIMx_BDTR).
pub(super) fn dead_time(dtg: u32) -> u64 {
    let dtg = u64::from(dtg & 0xff);
    match dtg >> 5 {
        0..=3 => dtg,
        4 | 5 => (64 + (dtg & 0x3f)) * 2,
        6 => (32 + (dtg & 0x1f)) * 8,
        _ => (32 + (dtg & 0x1f)) * 16,
    }
}

/// Settings that decide an output, of one channel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stage {
    /// CCxE or CCxNE.
    pub enabled: bool,
    /// CCxP or CCxNP.
    pub inverted: bool,
    /// MOE; always set on a timer without a break input.
    pub main: bool,
    /// OSSI and OISx (or OISxN).
    pub off_state: bool,
    pub idle: bool,
}

impl Stage {
    /// How the output drives its pin for a reference signal (already complemented for OCxN).
    pub fn drive(&self, active: bool) -> Drive {
        match (self.enabled, self.main) {
            (true, true) => Drive::to(active != self.inverted),
            (true, false) if self.off_state => Drive::to(self.idle),
            // Disabled outputs of TIM1 are not driven; those of the others neither.
            _ => Drive::Open,
        }
    }
}

/// Outputs of TIM1: channels, then complements.
pub(super) const OUTPUTS: [Signal; 7] = [
    Signal::Tim1Ch1,
    Signal::Tim1Ch2,
    Signal::Tim1Ch3,
    Signal::Tim1Ch4,
    Signal::Tim1Ch1N,
    Signal::Tim1Ch2N,
    Signal::Tim1Ch3N,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dead_times_of_the_manual() {
        // At f_DTS of 8 MHz the manual gives 0 to 15.875 µs in steps of 125 ns, and so on up to 126 µs.
        for (dtg, cycles) in [
            (0x7f, 127),
            (0x80, 128),
            (0xbf, 254),
            (0xc0, 256),
            (0xdf, 504),
            (0xe0, 512),
            (0xff, 1008),
        ] {
            assert_eq!(dead_time(dtg), cycles, "{dtg:#x}");
        }
    }

    #[test]
    fn a_pulse_stands_around_zero_and_has_twice_its_compare_value() {
        let high = |up: bool| {
            (0..=10)
                .filter(|&c| Mode::Pulse1.reference(c, 3, up, false))
                .count()
        };
        // Up: 0, 1, 2; down: 3, 2, 1 (and 0, which is the same as that of up).
        assert_eq!((high(true), high(false)), (3, 4));
        assert!(!Mode::Pulse1.reference(0, 0, true, false));
        assert!(Mode::Pulse2.reference(3, 3, true, false));
    }
}
