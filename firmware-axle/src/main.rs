//! Image of the axle board.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
#[embassy_executor::main]
async fn main(spawner: embassy_executor::Spawner) {
    firmware_axle::robot::run(spawner, firmware_axle::robot::Own::default());
}

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("this program is for the board: cargo build-axle, or cargo flash-axle");
    std::process::exit(2);
}
