//! Links every step of every node, and the codec of the bus, against a panic handler that has no
//! body: the image links only if the compiler has proved that none of them can panic. It is never
//! run. With the feature `panic` one step can, and the image must not link.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod image;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("this image is only linked, never run: tools/scripts/check_no_panic.sh");
    std::process::exit(2);
}
