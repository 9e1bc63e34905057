//! Case and outcome of a run.

use super::entry::Entry;
use core_algos::safety::Condition;
use serde::{Serialize, Serializer};

/// One case of the campaign: a fault, its time and a seed.
#[derive(Clone, Copy, Debug)]
pub struct FaultCase<'a> {
    /// Fault of the case, with its permitted outcomes.
    pub entry: &'a Entry,
    /// Time of the fault after the start, ms.
    pub after_ms: u64,
    /// Seed of all random numbers.
    pub seed: u64,
}

/// How a run with a fault ended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum End {
    /// The robot continued or finished its task.
    WentOn,
    /// All motors were off in time.
    Stopped,
    /// Any other end, with its description.
    Wrong(String),
}

/// Outcome of a run with a fault.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outcome {
    /// Seed of all random numbers of the run.
    pub seed: u64,
    /// Time of the fault after the start, ms.
    pub after_ms: u64,
    /// How the run ended.
    pub end: End,
    /// First reason of a stop seen on the bus; `None` without a stop.
    #[serde(serialize_with = "name")]
    pub reason: Option<Condition>,
    /// Time from the fault to all motors off, s; `None` without a stop.
    pub off_s: Option<f64>,
    /// Time from the fault to the last PWM pulse of the affected axle, s; `None` if not observed.
    pub own_off_s: Option<f64>,
    /// Number of cases in a trial of a single board.
    pub cases: usize,
}

fn name<S: Serializer>(reason: &Option<Condition>, to: S) -> Result<S::Ok, S::Error> {
    reason.map(|reason| reason.entry().name).serialize(to)
}

/// Description of a stop that the entry does not permit; `None` if the entry permits the stop. `off_s` is the time
/// until all motors were off, `own_off_s` until the last PWM pulse of the affected axle.
pub(super) fn stop_violation(
    entry: &Entry,
    reason: Option<Condition>,
    off_s: f64,
    own_off_s: Option<f64>,
) -> Option<String> {
    if entry.goes_on && entry.codes.is_empty() {
        return Some(format!("stopped: {reason:?}"));
    }
    let fits = match reason {
        Some(reason) => entry.codes.contains(&reason),
        None => entry.codes.is_empty(),
    };
    if !fits {
        return Some(format!("stopped for another reason: {reason:?}"));
    }
    if off_s > entry.off_within_s {
        return Some(format!("motors off after {off_s:.3} s"));
    }
    match (own_off_s, entry.own_within_s) {
        (Some(own), Some(within)) if own > within => {
            Some(format!("last pulse of the struck axle after {own:.6} s"))
        }
        _ => None,
    }
}
