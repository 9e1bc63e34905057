//! Duty to the two pins of a bridge in phase/enable mode (DRV8874 and similar): sign on one pin, magnitude on the
//! other.
//!
//! With the enable pin low the bridge brakes (slow decay through both low sides), so the mean voltage is duty times
//! supply. The driver inserts the dead time. Its sleep pin lets the motor coast.

use crate::math::compare::lesser;

/// Settings of the timer and the direction pin.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pins {
    /// Compare value of the enable pin's channel, 0 to the timer's top.
    pub compare: u16,
    /// True if the direction pin is high: forward.
    pub forward: bool,
}

/// Pins for a signed duty, −1 to 1, with a timer that counts to `top`. Larger magnitudes count as ±1, NaN as 0. The
/// compare value is rounded to the nearest count; `f32` adds an error below 0.01 counts.
pub fn pins(duty: f32, top: u16) -> Pins {
    let magnitude = lesser(1.0, duty.abs());
    // The sum is at most 65 535.5, and the cast truncates and saturates, so the result is the nearest count. NaN
    // becomes 0.
    Pins {
        compare: (magnitude * f32::from(top) + 0.5) as u16,
        forward: duty > 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    properties! {
        #[test]
        fn mean_of_pins_is_the_duty_to_half_a_count(duty in -1.0f32..=1.0, top in 100u16..=u16::MAX) {
            let pins = pins(duty, top);
            prop_assert!(pins.compare <= top);
            let magnitude = f64::from(pins.compare) / f64::from(top);
            let mean = if pins.forward { magnitude } else { -magnitude };
            // Product and sum round by half a unit in the last place each.
            let tolerance = 0.5 / f64::from(top) + f64::from(f32::EPSILON);
            prop_assert!((mean - f64::from(duty)).abs() <= tolerance);
        }

        #[test]
        fn compare_value_never_exceeds_the_top(bits: u32, top: u16) {
            let duty = f32::from_bits(bits);
            let pins = pins(duty, top);
            prop_assert!(pins.compare <= top);
            if duty.is_nan() {
                prop_assert_eq!(pins.compare, 0);
            }
        }
    }

    #[test]
    fn full_and_zero_duty_are_reached() {
        let full = |forward| Pins {
            compare: 4200,
            forward,
        };
        assert_eq!(pins(1.0, 4200), full(true));
        assert_eq!(pins(-7.0, 4200), full(false));
        for none in [0.0, -0.0, f32::NAN] {
            assert_eq!(pins(none, 4200), Pins::default());
        }
        assert_eq!(pins(f32::INFINITY, u16::MAX).compare, u16::MAX);
    }
}
