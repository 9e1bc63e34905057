//! One declaration of a table of parameters: name, type, default, unit, allowed values and meaning.
//!
//! [`declare!`] generates the struct or enumeration, its default, the check of each number and the
//! description ([`Field`], [`Choice`]) from which files, stores and pages are made.
//!
//! # Example
//!
//! ```
//! use declare::{Kind, declare};
//!
//! declare! {
//!     /// Wheels of an axle.
//!     #[derive(Clone, Copy, Debug, PartialEq)]
//!     pub struct Wheels {
//!         /// Radius (the paper's r_w).
//!         pub radius_m: f32 = 0.073, "m": Range(0.01, 0.5);
//!         /// Encoder counts per revolution.
//!         pub counts: u32 = 8192, "": Positive;
//!     }
//! }
//!
//! let mut wheels = Wheels::default();
//! assert_eq!(Wheels::FIELDS[0].meaning(), "Radius (the paper's r_w).");
//! assert!(matches!(Wheels::FIELDS[0].kind, Kind::Number { unit: "m", whole: false, .. }));
//! wheels.radius_m = f32::NAN;
//! let error = wheels.check_ranges().unwrap_err();
//! assert_eq!(error.to_string(), "radius_m = NaN: must be a number from 0.01 to 0.5");
//! ```
#![no_std]
#![forbid(unsafe_code)]

#[cfg(feature = "alloc")]
extern crate alloc;

mod allowed;
mod description;
mod macros;

pub use allowed::{
    Allowed, Checked, ConfigError, finite, in_range, non_negative, positive, require,
};
pub use description::{Choice, Declared, Field, Kind, field_at, find};
