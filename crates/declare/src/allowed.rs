//! Allowed values, their checks, and the error of a check.
//!
//! Each check refuses NaN and infinity: bounds are written so that an unordered comparison fails.

use core::fmt;

/// Allowed values of a number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Allowed {
    /// Greater than zero and finite.
    Positive,
    /// Zero or greater, and finite.
    NonNegative,
    /// Any finite number.
    Finite,
    /// Between the two bounds, both included.
    Range(f32, f32),
    /// One of the listed numbers.
    OneOf(&'static [f32]),
    /// Condition in words, for a value that the caller has already found wrong; a check against it refuses every value.
    Condition(&'static str),
}

impl fmt::Display for Allowed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Positive => f.write_str("a finite number greater than 0"),
            Self::NonNegative => f.write_str("a finite number not less than 0"),
            Self::Finite => f.write_str("a finite number"),
            Self::Range(low, high) => write!(f, "a number from {low} to {high}"),
            Self::OneOf(values) => {
                for (i, value) in values.iter().enumerate() {
                    let before = match i {
                        0 => "",
                        _ if i + 1 == values.len() => " or ",
                        _ => ", ",
                    };
                    write!(f, "{before}{value}")?;
                }
                Ok(())
            }
            Self::Condition(text) => f.write_str(text),
        }
    }
}

impl Allowed {
    /// True if `value` is allowed.
    fn holds(self, value: f32) -> bool {
        match self {
            Self::Positive => value > 0.0 && value.is_finite(),
            Self::NonNegative => value >= 0.0 && value.is_finite(),
            Self::Finite => value.is_finite(),
            Self::Range(low, high) => value >= low && value <= high,
            Self::OneOf(values) => values.contains(&value),
            Self::Condition(_) => false,
        }
    }

    /// `value` if it is allowed; otherwise an error that names `field`.
    pub fn check(self, field: &'static str, value: f32) -> Result<f32, ConfigError> {
        require(self.holds(value), field, value, self)
    }
}

/// A parameter whose value is not allowed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConfigError {
    /// Name of the parameter, as in the configuration file.
    pub field: &'static str,
    /// Indices of the refused number in its list or list of lists; `None` for a single number.
    pub index: [Option<u8>; 2],
    /// The value that was refused.
    pub value: f32,
    /// Allowed values of the parameter.
    pub allowed: Allowed,
}

impl ConfigError {
    /// Adds the index of the refused number in its list; for a list of lists, the inner index first.
    #[must_use]
    pub const fn at(mut self, index: usize) -> Self {
        self.index = [Some(index as u8), self.index[0]];
        self
    }
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.field)?;
        for index in self.index.into_iter().flatten() {
            write!(f, "[{index}]")?;
        }
        write!(f, " = {}: must be {}", self.value, self.allowed)
    }
}

impl core::error::Error for ConfigError {}

/// A number, an optional number or a list of numbers.
pub trait Checked {
    /// True if the values are whole numbers.
    const WHOLE: bool = false;

    /// Checks each number by itself; the error names `field`.
    fn check(&self, field: &'static str, allowed: Allowed) -> Result<(), ConfigError>;
}

macro_rules! numbers {
    ($($number:ty, $whole:literal;)*) => {
        $(impl Checked for $number {
            const WHOLE: bool = $whole;

            fn check(&self, field: &'static str, allowed: Allowed) -> Result<(), ConfigError> {
                allowed.check(field, *self as f32).map(|_| ())
            }
        })*
    };
}
numbers! {
    f32, false;
    f64, false;
    u8, true;
    u16, true;
    u32, true;
    i32, true;
}

impl<T: Checked> Checked for [T] {
    const WHOLE: bool = T::WHOLE;

    fn check(&self, field: &'static str, allowed: Allowed) -> Result<(), ConfigError> {
        self.iter().enumerate().try_for_each(|(i, entry)| {
            let checked = entry.check(field, allowed);
            checked.map_err(|error| error.at(i))
        })
    }
}

impl<T: Checked, const N: usize> Checked for [T; N] {
    const WHOLE: bool = T::WHOLE;

    fn check(&self, field: &'static str, allowed: Allowed) -> Result<(), ConfigError> {
        self.as_slice().check(field, allowed)
    }
}

#[cfg(feature = "alloc")]
impl<T: Checked> Checked for alloc::vec::Vec<T> {
    const WHOLE: bool = T::WHOLE;

    fn check(&self, field: &'static str, allowed: Allowed) -> Result<(), ConfigError> {
        self.as_slice().check(field, allowed)
    }
}

impl<T: Checked> Checked for Option<T> {
    const WHOLE: bool = T::WHOLE;

    fn check(&self, field: &'static str, allowed: Allowed) -> Result<(), ConfigError> {
        self.iter()
            .try_for_each(|value| value.check(field, allowed))
    }
}

/// `value` if it is finite and greater than zero.
pub fn positive(field: &'static str, value: f32) -> Result<f32, ConfigError> {
    Allowed::Positive.check(field, value)
}

/// `value` if it is finite and not less than zero.
pub fn non_negative(field: &'static str, value: f32) -> Result<f32, ConfigError> {
    Allowed::NonNegative.check(field, value)
}

/// `value` if it is finite.
pub fn finite(field: &'static str, value: f32) -> Result<f32, ConfigError> {
    Allowed::Finite.check(field, value)
}

/// `value` if it lies in `[low, high]`.
pub fn in_range(field: &'static str, value: f32, low: f32, high: f32) -> Result<f32, ConfigError> {
    Allowed::Range(low, high).check(field, value)
}

/// `value` if `ok`; otherwise an error with `field` and `allowed`.
pub fn require(
    ok: bool,
    field: &'static str,
    value: f32,
    allowed: Allowed,
) -> Result<f32, ConfigError> {
    if ok {
        Ok(value)
    } else {
        Err(ConfigError {
            field,
            index: [None; 2],
            value,
            allowed,
        })
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use std::string::ToString;

    #[test]
    fn nan_and_infinity_are_refused_by_every_check() {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert!(positive("p", bad).is_err());
            assert!(non_negative("p", bad).is_err());
            assert!(finite("p", bad).is_err());
            assert!(in_range("p", bad, -1.0, 1.0).is_err());
            assert!(Allowed::OneOf(&[1.0, 2.0]).check("p", bad).is_err());
            assert!(Some(bad).check("p", Allowed::Finite).is_err());
        }
    }

    #[test]
    fn error_names_field_index_value_and_allowed_values() {
        let text =
            |allowed: Allowed, value: f32| allowed.check("p", value).unwrap_err().to_string();
        assert_eq!(
            text(Allowed::Range(0.0, 1.2), 2.0),
            "p = 2: must be a number from 0 to 1.2"
        );
        assert_eq!(
            text(Allowed::OneOf(&[1.0, 2.0, 4.0]), 3.0),
            "p = 3: must be 1, 2 or 4"
        );
        let wheels = [[0.1, 0.1], [0.1, -0.2]];
        let error = wheels.check("radius_m", Allowed::Positive).unwrap_err();
        assert_eq!(
            error.to_string(),
            "radius_m[1][1] = -0.2: must be a finite number greater than 0"
        );
    }

    #[test]
    fn bounds_are_allowed() {
        assert!(in_range("p", 1.0, 0.0, 1.0).is_ok());
        assert!(non_negative("p", 0.0).is_ok());
        assert!(positive("p", 0.0).is_err());
        assert!(None::<f32>.check("p", Allowed::Positive).is_ok());
    }
}
