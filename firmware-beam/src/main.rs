//! Image of the beam board.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(all(target_os = "none", feature = "hil"))]
mod hil;
#[cfg(all(target_os = "none", not(feature = "hil")))]
mod robot;
#[cfg(any(test, all(target_os = "none", not(feature = "hil"))))]
mod rules;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("this program is for the board: cargo build-beam, or cargo flash-beam");
    std::process::exit(2);
}
