//! Reference signals of a timer's outputs.

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pulse_stands_around_zero_and_has_twice_its_compare_value() {
        let inside = |up: bool| (0..=10).filter(|&c| is_inside(c, 3, up)).count();
        // Up: 0, 1, 2; down: 3, 2, 1 (and 0, which is the same as that of up).
        assert_eq!((inside(true), inside(false)), (3, 4));
        assert_eq!(Mode::Pulse1.pulse(false), Some(false));
        assert_eq!(Mode::Pulse2.pulse(false), Some(true));
    }
}
