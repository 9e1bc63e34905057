//! Image of the beam board.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod robot;
#[cfg(any(test, target_os = "none"))]
mod rules;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("this program is for the board: cargo build-beam, or cargo flash-beam");
    std::process::exit(2);
}
