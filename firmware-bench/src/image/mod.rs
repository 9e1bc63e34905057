//! The image: measures, prints one line each, and ends the emulator.

mod counter;
mod ours;
mod peers;
mod problem;

use core::mem::MaybeUninit;
use cortex_m_rt::entry;
use counter::Counter;
use embedded_alloc::LlffHeap;
// Prints the message and ends the emulator with an error.
use panic_semihosting as _;
use semihosting::println;

/// One of the other libraries allocates when its filter is made, never in a step.
#[global_allocator]
static HEAP: LlffHeap = LlffHeap::empty();

#[entry]
fn main() -> ! {
    const ROOM: usize = 16 * 1024;
    static mut MEMORY: [MaybeUninit<u8>; ROOM] = [MaybeUninit::uninit(); ROOM];
    // SAFETY: done once, before any allocation; the memory is used for nothing else.
    unsafe { HEAP.init(&raw mut MEMORY as usize, ROOM) }
    let mut counter = Counter::start();
    println!("calibration {} {}", counter.nops_100(), counter.nops_1000());
    ours::measure(&mut counter);
    peers::measure(&mut counter);
    semihosting::process::exit(0)
}
