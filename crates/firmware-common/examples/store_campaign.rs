//! Prints what power cuts and damaged bytes do to the store of parameters, on a simulated flash with
//! the sectors of the chip: `cargo run --release -p firmware-common --example store_campaign`.

#[cfg(not(target_os = "none"))]
fn main() {
    use firmware_common::store::campaign::{compactions, damage, power_cuts};

    println!("{:#?}", power_cuts::<16_384>(60, 1, 1));
    println!("{:#?}", compactions::<16_384>(25, 3));
    println!("{:#?}", damage::<16_384>(20_000, 64, 2));
}

#[cfg(target_os = "none")]
fn main() {}
