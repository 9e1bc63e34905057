//! Counts instructions of the boards' algorithms on an emulated Cortex-M4F:
//! `tools/scripts/count_instructions.py`.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod image;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("this image runs in an emulator: tools/scripts/count_instructions.py");
    std::process::exit(2);
}
