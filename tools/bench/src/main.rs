//! Counts instructions of the boards' algorithms on the virtual board's core:
//! `tools/scripts/count_instructions.py`.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod image;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("this image runs on the virtual board's core: tools/scripts/count_instructions.py");
    std::process::exit(2);
}
