//! Runs an image that counts instructions by SysTick, such as firmware-bench, and prints its output: `count IMAGE
//! instructions|cycles`.
//!
//! A read of SysTick returns a count that advances by [`MILLITICKS`] thousandths of a tick for each instruction, or for
//! each cycle. The memory has no wait states.

mod flat;

use flat::Flat;
use flat::semihosting::serve;
use virtual_board::core::{Stop, System, Width};
use virtual_board::image::Image;

/// Address of the current value of SysTick.
const SYST_CVR: u32 = 0xe000_e018;
/// Start value of SysTick, which counts down.
const RELOAD: u64 = 0x00ff_ffff;
/// Thousandths of a tick for each instruction or cycle, which then counts as 128 ns of a SysTick at 168 MHz.
const MILLITICKS: u64 = 21_504;

/// Destination register of the load instruction at `pc`; `None` if another instruction is there.
fn loaded(flat: &mut Flat, pc: u32) -> Option<usize> {
    let [first, second] = [pc, pc + 2].map(|at| flat.fetch(at).unwrap_or(0));
    match first {
        0x6800..=0x6fff => Some(usize::from(first & 7)),
        0xf8d0..=0xf8df => Some(usize::from(second >> 12)),
        _ => None,
    }
}

fn run(image: &Image, by_cycles: bool) -> Result<bool, String> {
    let (mut core, mut flat) = Flat::start(image);
    core.add_watchpoint(SYST_CVR, Width::Word.bytes());
    loop {
        match core.run(&mut flat, u64::MAX) {
            Stop::Breakpoint(_) => {
                if let Some(ended) = serve(&mut core, &mut flat, true) {
                    return Ok(ended);
                }
            }
            Stop::Watchpoint { write: true, .. } => {}
            Stop::Watchpoint { pc, .. } => {
                let count = if by_cycles {
                    core.cycles()
                } else {
                    core.instructions()
                };
                let ticks = count * MILLITICKS / 1000;
                let register = loaded(&mut flat, pc)
                    .ok_or(format!("{pc:#010x}: SysTick is read by no plain load"))?;
                core.set_register(register, (RELOAD - ticks % (RELOAD + 1)) as u32);
            }
            stop => return Err(format!("{stop:?} at {:#010x}: {:?}", core.pc(), flat.notes)),
        }
    }
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (path, by_cycles) = match arguments.as_slice() {
        [path, what] if what == "instructions" => (path, false),
        [path, what] if what == "cycles" => (path, true),
        _ => return Err("usage: count IMAGE instructions|cycles".into()),
    };
    match run(&Image::open(path.as_ref())?, by_cycles)? {
        true => Ok(()),
        false => Err("the image ended with an error".into()),
    }
}
