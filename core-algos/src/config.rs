//! Errors of configuration and the range checks that raise them.
//!
//! Each check refuses NaN and infinity: bounds are written so that an unordered comparison fails.

use core::fmt;

/// The range a parameter must lie in.
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
    /// A condition that a range cannot state.
    Condition(&'static str),
}

impl fmt::Display for Allowed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Positive => f.write_str("a finite number greater than 0"),
            Self::NonNegative => f.write_str("a finite number not less than 0"),
            Self::Finite => f.write_str("a finite number"),
            Self::Range(low, high) => write!(f, "a number from {low} to {high}"),
            Self::Condition(text) => f.write_str(text),
        }
    }
}

/// A parameter outside its allowed range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConfigError {
    /// Name of the parameter, as it stands in the configuration file.
    pub field: &'static str,
    /// The value that was refused.
    pub value: f32,
    /// Allowed values.
    pub allowed: Allowed,
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} = {}: must be {}",
            self.field, self.value, self.allowed
        )
    }
}

impl core::error::Error for ConfigError {}

/// Declares parameters: name, type, default, and what a number may be ([`Allowed`]).
///
/// The check of each number by itself, also in a list or an option, follows from it; conditions between several are those of `build`.
macro_rules! config {
    (
        $(#[$doc:meta])*
        pub struct $name:ident {
            $($(#[$field_doc:meta])* pub $field:ident: $type:ty = $default:expr $(, $allowed:expr)?;)*
        }
    ) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        #[cfg_attr(feature = "serde", serde(deny_unknown_fields, default))]
        pub struct $name {
            $($(#[$field_doc])* pub $field: $type,)*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $default,)* }
            }
        }

        impl $name {
            /// Checks each number by itself; the error names the field.
            fn check_ranges(&self) -> Result<(), $crate::config::ConfigError> {
                #[allow(unused_imports)]
                use $crate::config::Allowed::{Finite, NonNegative, Positive, Range};
                $($($crate::config::Checked::check(&self.$field, stringify!($field), $allowed)?;)?)*
                Ok(())
            }
        }
    };
}
pub(crate) use config;

/// A parameter of one number, several or none.
pub(crate) trait Checked {
    /// Checks each number by itself.
    fn check(&self, field: &'static str, allowed: Allowed) -> Result<(), ConfigError>;
}

macro_rules! checked_numbers {
    ($($number:ty),*) => {
        $(impl Checked for $number {
            fn check(&self, field: &'static str, allowed: Allowed) -> Result<(), ConfigError> {
                allowed.check(field, *self as f32).map(|_| ())
            }
        })*
    };
}
checked_numbers!(f32, u8, u16, u32, i32);

impl Checked for [f32; 3] {
    fn check(&self, field: &'static str, allowed: Allowed) -> Result<(), ConfigError> {
        self.iter()
            .try_for_each(|value| value.check(field, allowed))
    }
}

impl Checked for Option<f32> {
    fn check(&self, field: &'static str, allowed: Allowed) -> Result<(), ConfigError> {
        self.iter()
            .try_for_each(|value| value.check(field, allowed))
    }
}

impl Allowed {
    /// `value` if it is allowed; otherwise an error that names `field`. A condition that a range cannot state allows
    /// none.
    pub fn check(self, field: &'static str, value: f32) -> Result<f32, ConfigError> {
        let ok = match self {
            Self::Positive => value > 0.0 && value.is_finite(),
            Self::NonNegative => value >= 0.0 && value.is_finite(),
            Self::Finite => value.is_finite(),
            Self::Range(low, high) => value >= low && value <= high,
            Self::Condition(_) => false,
        };
        require(ok, field, value, self)
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

/// `value` if `ok`; otherwise an error that names `field` and what is `allowed`.
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
            value,
            allowed,
        })
    }
}

/// A field and what spoils it.
#[cfg(test)]
pub(crate) type Spoilt<C> = (&'static str, fn(&mut C));

/// Builder of a good configuration, which a test spoils.
#[cfg(test)]
pub(crate) struct Refusal<C, B>(C, B);

#[cfg(test)]
pub(crate) fn refusal_of<C, T, B>(good: C, build: B) -> Refusal<C, B>
where
    B: Fn(C) -> Result<T, ConfigError>,
{
    Refusal(good, build)
}

#[cfg(test)]
impl<C: Copy, T, B: Fn(C) -> Result<T, ConfigError>> Refusal<C, B> {
    /// Asserts that each field that is spoilt is refused by its name.
    pub(crate) fn names(&self, spoilt: &[Spoilt<C>]) {
        for (field, spoil) in spoilt {
            let mut config = self.0;
            spoil(&mut config);
            let refused = (self.1)(config).err().map(|error| error.field);
            assert_eq!(refused, Some(*field));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_check_lets_nan_or_infinity_pass() {
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert!(positive("p", bad).is_err());
            assert!(non_negative("p", bad).is_err());
            assert!(finite("p", bad).is_err());
            assert!(in_range("p", bad, -1.0, 1.0).is_err());
        }
    }

    #[test]
    fn message_names_field_value_and_range() {
        let text = in_range("max_steering_rad", 2.0, 0.0, 1.2)
            .unwrap_err()
            .to_string();
        assert_eq!(text, "max_steering_rad = 2: must be a number from 0 to 1.2");
    }

    #[test]
    fn bounds_are_included() {
        assert!(in_range("p", 1.0, 0.0, 1.0).is_ok());
        assert!(non_negative("p", 0.0).is_ok());
        assert!(positive("p", 0.0).is_err());
    }
}
