//! Counts of an image on a board with nothing around it, as JSON: `counts IMAGE SECONDS`, for so long from
//! the first tick of SysTick on. Beside it stands the same of another emulator, `tools/rigless`.

use std::path::Path;
use virtual_board::Time;
use virtual_board::board::Board;
use virtual_board::chip::Bare;
use virtual_board::image::Image;

const SYSTICK: u16 = 15;
/// No image needs longer to its first tick.
const PATIENCE: Time = Time::from_micros(10_000_000);

/// Exceptions taken, by number.
fn taken(board: &Board) -> Vec<u64> {
    (0..98).map(|number| board.core().taken(number)).collect()
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [image, seconds] = arguments.as_slice() else {
        return Err("usage: counts IMAGE SECONDS".into());
    };
    let image = Image::open(Path::new(image))?;
    let mut board = Board::new(Box::new(Bare), 0);
    board.flash(&image);
    board.power(true);
    while board.core().taken(SYSTICK) == 0 {
        if board.now() > PATIENCE {
            return Err("no tick of SysTick within 10 s".into());
        }
        board.run_until(board.now() + Time::from_micros(1));
    }
    let (before, converted) = (taken(&board), board.chip().conversions());
    let length = Time::from_micros((seconds.parse::<f64>()? * 1e6) as u64);
    let end = board.now() + length;
    while board.now() < end {
        board.run_until(end.min(board.now() + Time::from_micros(1_000)));
    }
    let counts = taken(&board).into_iter().zip(before).enumerate();
    let counts = counts.filter(|(_, (after, before))| after > before);
    let exceptions: Vec<String> = counts
        .map(|(number, (after, before))| format!("\"{number}\": {}", after - before))
        .collect();
    println!(
        "{{\"resets\": {}, \"conversions\": {}, \"exceptions\": {{{}}}}}",
        board.resets().len(),
        board.chip().conversions().regular - converted.regular,
        exceptions.join(", ")
    );
    Ok(())
}
