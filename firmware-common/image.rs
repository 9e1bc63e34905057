//! Build script of both images: the shared memory map, and the linker scripts of runtime and log.

use std::env;
use std::path::Path;

fn main() {
    // Built for the host the crate is only a message, see its `main`.
    if env::var("CARGO_CFG_TARGET_OS").as_deref() != Ok("none") {
        return;
    }
    let package = env::var("CARGO_MANIFEST_DIR").expect("set by cargo");
    let workspace = Path::new(&package).parent().expect("a member's folder");
    println!(
        "cargo::rerun-if-changed={}",
        workspace.join("memory.x").display()
    );
    println!("cargo::rustc-link-search={}", workspace.display());
    for argument in ["--nmagic", "-Tlink.x", "-Tdefmt.x"] {
        println!("cargo::rustc-link-arg-bins={argument}");
    }
}
