//! Reference signals of a timer's outputs.

/// A channel's output mode, as OCxM says.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Mode {
    #[default]
    Frozen,
    Pulse1,
    Pulse2,
}

impl Mode {
    /// None for those that are not modelled: set, clear or toggle on match, forced levels.
    pub fn of(bits: u32) -> Option<Self> {
        match bits & 7 {
            0 => Some(Self::Frozen),
            6 => Some(Self::Pulse1),
            7 => Some(Self::Pulse2),
            _ => None,
        }
    }

    /// The reference signal for the result of the comparison, see [`is_inside`].
    pub fn reference(self, inside: bool) -> Option<bool> {
        match self {
            Self::Frozen => None,
            Self::Pulse1 => Some(inside),
            Self::Pulse2 => Some(!inside),
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
        assert_eq!(Mode::Pulse1.reference(false), Some(false));
        assert_eq!(Mode::Pulse2.reference(false), Some(true));
    }
}
