//! Links every step of every node and the bus codec against a panic handler without a body: the image links
//! only if the compiler has proved that none of these functions can panic. The image is never run. With the
//! feature `panic` one step can panic, and the image must not link.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod image;

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("this image is only linked, never run: tools/scripts/check_no_panic.sh");
    std::process::exit(2);
}
