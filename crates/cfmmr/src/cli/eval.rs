//! `cfmmr eval`: runs one on-board algorithm on test cases from standard input.

use crate::experiments::eval;
use crate::experiments::eval::Kernel;
use clap::{Args, ValueEnum};
use host_sim::base::error::Error;
use output::terminal::note;
use std::io;

/// Algorithms that `eval` runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Algorithm {
    /// Relative position sensor: strains to end posture and covariance (Python: StrainFit)
    Rps,
    /// Covariance intersection of two postures (Python: covariance_intersection)
    Ci,
    /// Seven-state axle filter (Python: AxleFilter)
    Ekf,
    /// Internal posture error correction (Python: Ipec)
    Ipec,
    /// Curvature-based law before limits (Python: KinematicLaw)
    Kinematic,
    /// Midpoint motion to axle velocities (Python: Cascade)
    Cascade,
    /// Messages of the bus to bytes and back (Python: cantools with the file of `cfmmr dbc`)
    Bus,
    /// Frame of the plant in f64 (Python: strip_equilibrium)
    Frame,
}

/// Arguments of `eval`.
#[derive(Clone, Debug, Args)]
pub struct EvalArgs {
    /// Algorithm
    #[arg(value_enum)]
    pub name: Algorithm,
}

impl Algorithm {
    /// What replaces the algorithm here.
    const fn replacement(self) -> &'static str {
        match self {
            Self::Rps => "cfmmr.algorithms.StrainFit",
            Self::Ci => "cfmmr.algorithms.covariance_intersection",
            Self::Ekf => "cfmmr.algorithms.AxleFilter",
            Self::Ipec => "cfmmr.algorithms.Ipec",
            Self::Kinematic => "cfmmr.algorithms.KinematicLaw",
            Self::Cascade => "cfmmr.algorithms.Cascade",
            Self::Bus => "the package cantools with the file that `cfmmr dbc` writes",
            Self::Frame => "cfmmr.algorithms.strip_equilibrium",
        }
    }
}

/// Runs the algorithm on each line of standard input; fails if a line was rejected.
pub fn run(args: &EvalArgs) -> Result<(), Error> {
    note(format!(
        "cfmmr: the next version has no `eval`; in Python use {} (docs/python.md)",
        args.name.replacement()
    ));
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
