//! Declaration of parameters, and the errors of range checks.

pub use declare::{
    Allowed, Checked, ConfigError, finite, in_range, non_negative, positive, require,
};

/// Declares a table of parameters (crate `declare`). With the feature `serde`, a table can be read from a file;
/// missing keys take their defaults.
macro_rules! declare {
    ($(#[$doc:meta])* pub struct $($rest:tt)*) => {
        ::declare::declare! {
            $(#[$doc])*
            #[derive(Clone, Copy, Debug, PartialEq)]
            #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
            #[cfg_attr(feature = "serde", serde(deny_unknown_fields, default))]
            pub struct $($rest)*
        }
    };
    ($(#[$doc:meta])* pub enum $($rest:tt)*) => {
        ::declare::declare! {
            $(#[$doc])*
            #[derive(Clone, Copy, Debug, PartialEq)]
            #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
            pub enum $($rest)*
        }
    };
}
pub(crate) use declare;

/// Name of a field, and a change that makes the field invalid.
#[cfg(test)]
pub(crate) type Spoilt<C> = (&'static str, fn(&mut C));

/// A valid configuration and its `build`, for tests that make one field invalid.
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
    /// Asserts that `build` rejects each invalid field by its name.
    pub(crate) fn names(&self, spoilt: &[Spoilt<C>]) {
        for (field, spoil) in spoilt {
            let mut config = self.0;
            spoil(&mut config);
            let refused = (self.1)(config).err().map(|error| error.field);
            assert_eq!(refused, Some(*field));
        }
    }
}
