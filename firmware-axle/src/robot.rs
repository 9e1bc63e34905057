//! The image that drives the robot.

use embassy_executor::Spawner;
use embassy_time::{Duration, Ticker};
use firmware_common::watchdog::Watchdog;
use firmware_common::{board, fault, stack};

#[embassy_executor::main]
async fn main(_spawner: Spawner) {
    let p = board::start();
    let mut watchdog = Watchdog::start(p.IWDG);
    let mut ticker = Ticker::every(Duration::from_millis(100));
    loop {
        for _ in 0..100 {
            ticker.next().await;
            watchdog.feed();
        }
        let (used, size) = stack::high_water();
        defmt::info!("stack {} of {} bytes, {}", used, size, fault::counts());
    }
}
