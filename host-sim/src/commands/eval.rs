//! `cfmmr eval`: one on-board algorithm on cases from standard input.

use crate::cli::{Algorithm, EvalArgs};
use crate::error::Error;
use crate::eval::{self, Kernel};
use std::io;

/// Feeds standard input to the algorithm; an error if any line was bad.
pub fn run(args: &EvalArgs) -> Result<(), Error> {
    let mut kernel: Box<dyn Kernel> = match args.name {
        Algorithm::Rps => Box::new(eval::rps::Rps),
        Algorithm::Ci => Box::new(eval::ci::Ci),
        Algorithm::Ekf => Box::new(eval::ekf::Ekf::default()),
        Algorithm::Ipec => Box::new(eval::ipec::Ipec::default()),
        Algorithm::Kinematic => Box::new(eval::kinematic::Kinematic),
        Algorithm::Cascade => Box::new(eval::cascade::Cascade),
        Algorithm::Bus => Box::new(eval::bus::Bus),
        Algorithm::Frame => Box::new(eval::frame::Frame),
    };
    // Line-buffered: whoever feeds line by line gets each answer at once.
    let output = io::stdout().lock();
    match eval::run(kernel.as_mut(), io::stdin().lock(), output) {
        Ok(true) => Ok(()),
        Ok(false) => Err(Error::input(
            "at least one line was refused; see its \"error\"",
        )),
        // A reader that has seen enough is no failure.
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        Err(error) => Err(error.into()),
    }
}
