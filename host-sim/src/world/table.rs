//! Tables of a world file: each key is declared once, with its type, base value and range.

use core_algos::config::{Allowed, ConfigError, in_range, non_negative, positive, require};

/// Declares a table: its keys with type, base value and check.
macro_rules! table {
    (
        $(#[$doc:meta])*
        pub struct $name:ident($table:literal) {
            $($(#[$key_doc:meta])* $key:ident: $type:ty = $base:expr, $check:expr;)*
        }
    ) => {
        $(#[$doc])*
        #[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
        #[serde(deny_unknown_fields, default)]
        pub struct $name {
            $($(#[$key_doc])* pub $key: $type,)*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($key: $base,)* }
            }
        }

        impl $name {
            /// Checks every value.
            pub fn check(&self) -> Result<(), core_algos::config::ConfigError> {
                $($check(concat!($table, ".", stringify!($key)), &self.$key)?;)*
                Ok(())
            }
        }
    };
}

pub(super) use table;

type Checked = Result<(), ConfigError>;

/// A number of at least 0.
pub fn at_least_0(field: &'static str, value: &f64) -> Checked {
    non_negative(field, *value as f32).map(drop)
}

/// A number above 0.
pub fn above_0(field: &'static str, value: &f64) -> Checked {
    positive(field, *value as f32).map(drop)
}

/// A relative standard deviation: a draw of ten of them must leave a positive factor.
pub fn small(field: &'static str, value: &f64) -> Checked {
    up_to(0.09)(field, value)
}

/// A number from 0 to `largest`.
pub fn up_to(largest: f32) -> impl Fn(&'static str, &f64) -> Checked {
    move |field, value| in_range(field, *value as f32, 0.0, largest).map(drop)
}

/// A number of at most this magnitude.
pub fn within(largest: f32) -> impl Fn(&'static str, &f64) -> Checked {
    move |field, value| in_range(field, *value as f32, -largest, largest).map(drop)
}

/// A whole number from `low` to `high`.
pub fn whole(low: u32, high: u32) -> impl Fn(&'static str, &u32) -> Checked {
    move |field, value| in_range(field, *value as f32, low as f32, high as f32).map(drop)
}

/// 1, 2 or 4.
pub fn one_two_or_four(field: &'static str, value: &u32) -> Checked {
    let allowed = Allowed::Condition("1, 2 or 4");
    require(matches!(value, 1 | 2 | 4), field, *value as f32, allowed).map(drop)
}
