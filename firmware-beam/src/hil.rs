//! The image for hardware in the loop: the board's nodes behind a serial link. The strain bridges are not set up.

use embassy_executor::Spawner;
use firmware_common::board;
#[cfg(feature = "emulated")]
use firmware_common::emulated::run;
use firmware_common::hil::Kind;
#[cfg(not(feature = "emulated"))]
use firmware_common::hil::run;

#[embassy_executor::main]
async fn main(_spawner: Spawner) {
    run(board::start(env!("BUILD")), Kind::Beam, env!("BUILD")).await
}
