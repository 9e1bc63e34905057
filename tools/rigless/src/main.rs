//! Runs an image on the STM32F427 of the emulator rigless and prints counts as JSON:
//! `rigless-counts IMAGE SECONDS`, for so long from the first tick of SysTick on.
//!
//! Exceptions by number, as arrivals at the first instruction of a handler that no other exception has;
//! scans of ADC1 that TIM2 started.
//!
//! That emulator leads no trigger from a timer to a converter. Here each update of its TIM2 writes SWSTART
//! for ADC1 if the image has chosen TIM2's trigger output; timer, converter, stream and interrupts are its
//! own.

mod counts;

use counts::{Counts, handlers};
use rigless::emulator::{self, Start};
use rigless::image::Image;
use rigless::machine::stm32f427_bench::Stm32f427Bench;
use rigless::session::Session;
use std::path::Path;
use std::process::ExitCode;

type Failure = Box<dyn std::error::Error>;

fn run(path: &str, seconds: &str) -> Result<(), Failure> {
    let seconds: f64 = seconds.parse()?;
    if !(seconds > 0.0 && seconds <= 3600.0) {
        return Err(format!("SECONDS {seconds}: must be above 0 and at most 3600").into());
    }
    let image = Image::read(Path::new(path), None)?;
    let counts = Counts::new(handlers(&image)?, (seconds * 1e9) as u64);
    let mut session = Session::new(Box::new(Stm32f427Bench::new()?), 0, counts::STEP)?;
    counts.watch(&mut session);
    let images = [image];
    let finished = emulator::run(session, &Start::new(&images), counts)?;
    println!("{}", finished.driver.json(finished.session.resets().len()));
    Ok(())
}

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [image, seconds] = arguments.as_slice() else {
        eprintln!("usage: rigless-counts IMAGE SECONDS");
        return ExitCode::from(2);
    };
    match run(image, seconds) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("rigless-counts: {error}");
            ExitCode::from(2)
        }
    }
}
