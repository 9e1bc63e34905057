//! Axle board: code shared by its images.
#![cfg_attr(target_os = "none", no_std)]

#[cfg(target_os = "none")]
pub mod robot;
#[cfg(any(test, target_os = "none"))]
#[cfg_attr(test, allow(dead_code, reason = "read by the image only"))]
mod rules;
