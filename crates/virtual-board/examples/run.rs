//! Runs an image on a board without external circuit: `cargo run --release --example run -- IMAGE SECONDS`. Prints the
//! findings and statistics of the board. Analogue inputs are at half the supply.

use std::path::Path;
use std::time::Instant;
use virtual_board::Time;
use virtual_board::board::Board;
use virtual_board::chip::Bare;
use virtual_board::image::Image;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [image, seconds] = arguments.as_slice() else {
        return Err("usage: run IMAGE SECONDS".into());
    };
    let image = Image::open(Path::new(image))?;
    let mut board = Board::new(Box::new(Bare), 0);
    board.flash(&image);
    board.power(true);
    let end = Time::from_micros((seconds.parse::<f64>()? * 1e6) as u64);
    let start = Instant::now();
    while board.now() < end {
        board.run_until(end.min(board.now() + Time::from_micros(1_000)));
    }
    let took = start.elapsed().as_secs_f64();
    for reset in board.resets() {
        println!("{}: reset by {}", reset.at, reset.cause.name());
    }
    for finding in board.chip().findings().list() {
        println!("{finding}, in {}", image.describe(finding.pc));
    }
    let core = board.core();
    let cycles = core.cycles();
    println!(
        "{:.3} s: {} instructions, {:.1} % asleep, lowest stack {:#010x}, pc in {}",
        end.seconds(),
        core.instructions(),
        100.0 * core.asleep() as f64 / cycles as f64,
        core.lowest_msp(),
        image.describe(core.pc()),
    );
    println!(
        "{took:.2} s on this machine, {:.0} MIPS",
        core.instructions() as f64 * 1e-6 / took
    );
    Ok(())
}
