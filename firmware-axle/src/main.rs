//! Image of the axle board.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod robot;
#[cfg(any(test, target_os = "none"))]
#[cfg_attr(test, allow(dead_code, reason = "read by the image only"))]
mod rules;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("this program is for the board: cargo build-axle, or cargo flash-axle");
    std::process::exit(2);
}
