//! Outputs of a timer: reference signals, polarity, dead time, break.

use super::super::pin::{Drive, Signal};
use super::Kind;

/// A channel's output mode, as OCxM says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Mode {
    #[default]
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

    /// Whether the reference signal follows the counter.
    pub fn follows_counter(self) -> bool {
        !matches!(self, Self::Frozen | Self::ForceLow | Self::ForceHigh)
    }

    /// The reference signal after the counter has met the compare value.
    pub fn after_match(self, before: bool) -> bool {
        match self {
            Self::SetOnMatch => true,
            Self::ClearOnMatch => false,
            Self::Toggle => !before,
            _ => before,
        }
    }

    /// The reference signal of pulses for the result of the comparison, see [`is_inside`].
    pub fn pulse(self, inside: bool) -> Option<bool> {
        match self {
            Self::Pulse1 => Some(inside),
            Self::Pulse2 => Some(!inside),
            _ => None,
        }
    }
}

/// The comparison for pulses: a counter that goes up is below the compare value, one that goes down is
/// not above it (RM0090, OCxM of TIMx_CCMR1).
pub(super) fn is_inside(count: u32, compare: u32, up: bool) -> bool {
    if up {
        count < compare
    } else {
        count <= compare
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

/// What decides the outputs of a channel (RM0090, table of the output control bits).
#[derive(Clone, Copy, Debug)]
pub(super) struct Stage {
    /// CCxE, CCxP, CCxNE, CCxNP from bit 0 on.
    pub enables: u32,
    /// OISx and OISxN.
    pub idle: [bool; 2],
    /// MOE; always set on a timer without break input.
    pub main: bool,
    pub ossr: bool,
    pub ossi: bool,
}

impl Stage {
    /// Whether output and complement are both enabled, so that there is a dead time between them.
    pub fn is_complementary(&self) -> bool {
        self.enables & 5 == 5
    }

    /// How output and complement drive their pins. `waits` says which of them is held inactive by the
    /// dead time.
    pub fn drives(&self, reference: bool, waits: [bool; 2]) -> [Drive; 2] {
        let enabled = [self.enables & 1 != 0, self.enables & 4 != 0];
        let inverted = [self.enables & 2 != 0, self.enables & 8 != 0];
        let both = self.is_complementary();
        if !self.main {
            return self.off(enabled, inverted, waits);
        }
        let mut drives = [Drive::Open; 2];
        for side in 0..2 {
            let active = match (both, side) {
                (true, 0) => reference && !waits[0],
                (true, _) => !reference && !waits[1],
                // Alone, the complement is not complemented.
                _ => reference,
            };
            if enabled[side] {
                drives[side] = Drive::to(active != inverted[side]);
            } else if self.ossr && enabled[1 - side] {
                drives[side] = Drive::to(inverted[side]);
            }
        }
        drives
    }

    /// The outputs while MOE is clear: inactive, then at their idle levels.
    fn off(&self, enabled: [bool; 2], inverted: [bool; 2], waits: [bool; 2]) -> [Drive; 2] {
        if !self.ossi || enabled == [false; 2] {
            return [Drive::Open; 2];
        }
        // The idle levels must not have both sides active.
        let both_active = (0..2).all(|side| self.idle[side] != inverted[side]);
        if waits[0] || self.is_complementary() && both_active {
            return inverted.map(Drive::to);
        }
        self.idle.map(Drive::to)
    }
}

/// The signal of a channel's output or complement.
pub(super) fn signal(kind: Kind, channel: usize, complement: bool) -> Option<Signal> {
    use Signal::*;
    if complement {
        let all = [Tim1Ch1N, Tim1Ch2N, Tim1Ch3N];
        return (kind == Kind::Tim1).then_some(*all.get(channel)?);
    }
    Some(*Signal::CHANNELS[kind as usize].get(channel)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use Drive::{High, Low, Open};

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
        let inside = |up: bool| (0..=10).filter(|&c| is_inside(c, 3, up)).count();
        // Up: 0, 1, 2; down: 3, 2, 1 (and 0, which is the same as that of up).
        assert_eq!((inside(true), inside(false)), (3, 4));
        assert_eq!(Mode::Pulse1.pulse(false), Some(false));
        assert_eq!(Mode::Pulse2.pulse(false), Some(true));
    }

    /// Rows of the table of RM0090 with MOE set: OSSR, CCxE, CCxNE; outputs at a high and at a low
    /// reference signal, both polarities high.
    #[test]
    fn outputs_are_those_of_the_manuals_table() {
        type Row = (bool, u32, [Drive; 2], [Drive; 2]);
        let rows: [Row; 8] = [
            (false, 0b000, [Open, Open], [Open, Open]),
            (false, 0b100, [Open, High], [Open, Low]),
            (false, 0b001, [High, Open], [Low, Open]),
            (false, 0b101, [High, Low], [Low, High]),
            (true, 0b000, [Open, Open], [Open, Open]),
            (true, 0b100, [Low, High], [Low, Low]),
            (true, 0b001, [High, Low], [Low, Low]),
            (true, 0b101, [High, Low], [Low, High]),
        ];
        for (ossr, enables, high, low) in rows {
            let stage = Stage {
                enables,
                idle: [false; 2],
                main: true,
                ossr,
                ossi: false,
            };
            let found = [true, false].map(|reference| stage.drives(reference, [false; 2]));
            assert_eq!(found, [high, low], "{ossr} {enables:#b}");
        }
    }

    #[test]
    fn without_main_enable_outputs_float_or_idle() {
        let mut stage = Stage {
            enables: 0b0101,
            idle: [true, false],
            main: false,
            ossr: false,
            ossi: false,
        };
        assert_eq!(stage.drives(true, [false; 2]), [Open, Open]);
        stage.ossi = true;
        assert_eq!(stage.drives(true, [true; 2]), [Low, Low]);
        assert_eq!(stage.drives(true, [false; 2]), [High, Low]);
        // Both active at idle: never.
        stage.idle = [true; 2];
        assert_eq!(stage.drives(true, [false; 2]), [Low, Low]);
        // CCxE alone: both are driven.
        (stage.enables, stage.idle) = (0b0011, [true, false]);
        assert_eq!(stage.drives(true, [false; 2]), [High, Low]);
    }
}
