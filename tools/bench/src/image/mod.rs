//! Firmware image that prints one line per measurement.

mod counter;
mod ours;
mod problem;

use cortex_m_rt::entry;
use counter::Counter;
// Prints the message of a panic and exits with an error.
use panic_semihosting as _;
use semihosting::println;

#[entry]
fn main() -> ! {
    let mut counter = Counter::start();
    println!("calibration {} {}", counter.nops_100(), counter.nops_1000());
    ours::measure(&mut counter);
    semihosting::process::exit(0)
}
