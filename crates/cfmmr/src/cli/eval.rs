//! `cfmmr eval`: runs one on-board algorithm on test cases from standard input.

use crate::experiments::eval;
use crate::experiments::eval::Kernel;
use clap::{Args, ValueEnum};
use host_sim::base::error::Error;
use std::io;

/// Algorithms that `eval` runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Algorithm {
    /// Relative position sensor: strains to end posture and covariance
    Rps,
    /// Covariance intersection of two postures
    Ci,
    /// Seven-state axle filter
    Ekf,
    /// Internal posture error correction
    Ipec,
    /// Curvature-based law before limits
    Kinematic,
    /// Midpoint motion to axle velocities
    Cascade,
    /// Messages of the bus to bytes and back
    Bus,
    /// Frame of the plant (f64)
    Frame,
}

/// Arguments of `eval`.
#[derive(Clone, Debug, Args)]
pub struct EvalArgs {
    /// Algorithm
    #[arg(value_enum)]
    pub name: Algorithm,
}

/// Runs the algorithm on each line of standard input; fails if a line was rejected.
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
    // Line-buffered: the answer to a line is printed before the next line is read.
    let output = io::stdout().lock();
    match eval::run(kernel.as_mut(), io::stdin().lock(), output) {
        Ok(true) => Ok(()),
        Ok(false) => Err(Error::input(
            "at least one line was rejected; see \"error\" in the output",
        )),
        // A reader that closes the pipe early (head) is no failure.
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        Err(error) if error.kind() == io::ErrorKind::InvalidInput => {
            Err(Error::input(format!("standard input: {error}")))
        }
        Err(error) => Err(Error::Failure(format!(
            "cannot write to standard output: {error}"
        ))),
    }
}
