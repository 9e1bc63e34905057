//! Reference signals of a timer's outputs.

/// Output mode of a channel, OCxM.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Mode {
    #[default]
    Frozen,
    Pulse1,
    Pulse2,
}

impl Mode {
    /// Mode from OCxM; `None` if not modelled: set, clear or toggle on match, forced levels.
    pub fn of(bits: u32) -> Option<Self> {
        match bits & 7 {
            0 => Some(Self::Frozen),
            6 => Some(Self::Pulse1),
            7 => Some(Self::Pulse2),
            _ => None,
        }
    }

    /// Level of OCxREF for the result of the comparison, see [`is_inside`]; `None` if frozen.
    pub fn reference(self, inside: bool) -> Option<bool> {
        match self {
            Self::Frozen => None,
            Self::Pulse1 => Some(inside),
            Self::Pulse2 => Some(!inside),
        }
    }
}

/// PWM comparison: true if the counter counts up and is below the compare value, or counts down and is not above the
/// compare value (RM0090, OCxM of TIMx_CCMR1).
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
    fn pulse_is_centred_on_zero_and_twice_the_compare_value_long() {
        let inside = |up: bool| (0..=10).filter(|&c| is_inside(c, 3, up)).count();
        // The counts inside the pulse are 0, 1, 2 upward and 3, 2, 1, 0 downward; the 0 is the same step in both.
        assert_eq!((inside(true), inside(false)), (3, 4));
        assert_eq!(Mode::Pulse1.reference(false), Some(false));
        assert_eq!(Mode::Pulse2.reference(false), Some(true));
    }
}
