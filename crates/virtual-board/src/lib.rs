#![doc = include_str!("../README.md")]
#![cfg_attr(
    test,
    allow(
        clippy::disallowed_methods,
        reason = "a test compares with another implementation"
    )
)]

/// Declares bits of registers: a constant for each name and bit number.
macro_rules! bits {
    (pub($scope:tt): $($name:ident $bit:literal),* $(,)?) => {
        $(pub($scope) const $name: u32 = 1 << $bit;)*
    };
    ($($name:ident $bit:literal),* $(,)?) => { $(const $name: u32 = 1 << $bit;)* };
}

/// Declares the characteristics of a part: name, type and default of each.
macro_rules! characteristics {
    (
        $(#[$doc:meta])*
        pub struct $name:ident {
            $($(#[$field_doc:meta])* pub $field:ident: $type:ty = $default:expr;)*
        }
    ) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct $name {
            $($(#[$field_doc])* pub $field: $type,)*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $default,)* }
            }
        }
    };
}

pub mod board;
pub mod chip;
pub mod core;
pub mod device;
pub mod finding;
pub mod image;
pub mod network;
mod noise;
pub mod probe;
pub mod time;
pub mod wire;
mod workers;

pub use finding::{Finding, FindingKind, Findings};
pub use time::{Cycles, Time};
