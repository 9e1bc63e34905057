//! Memory map and linker script of the images.

use std::env;
use std::path::PathBuf;

fn main() {
    println!("cargo::rerun-if-changed=../../memory.x");
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    let package = PathBuf::from(env::var("CARGO_MANIFEST_DIR").expect("set by cargo"));
    println!(
        "cargo::rustc-link-search={}",
        package.join("../..").display()
    );
    for argument in ["--nmagic", "-Tlink.x"] {
        println!("cargo::rustc-link-arg-bins={argument}");
    }
}
