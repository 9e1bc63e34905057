//! How fast simulated time goes.

use serde::Serialize;
use std::time::Instant;

/// Simulated time over time taken, of several runs.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Speed {
    /// Median of the runs.
    pub real_time_factor: f64,
    /// Slowest run.
    pub slowest: f64,
    /// Fastest run.
    pub fastest: f64,
    /// Median by the wall clock.
    pub wall_real_time_factor: f64,
    /// Runs.
    pub repeats: usize,
}

impl Speed {
    /// Runs `work`, which simulates `simulated` seconds on this thread, `repeats` times (at least
    /// once).
    pub fn measure(repeats: usize, simulated: f64, mut work: impl FnMut()) -> Self {
        let repeats = repeats.max(1);
        let (mut cpu, mut wall) = (Vec::new(), Vec::new());
        for _ in 0..repeats {
            let (started, at) = (Instant::now(), thread_time());
            work();
            let taken = started.elapsed().as_secs_f64();
            let ran = at.zip(thread_time()).map_or(taken, |(a, b)| b - a);
            wall.push(simulated / taken);
            cpu.push(simulated / ran);
        }
        Self {
            real_time_factor: median(&mut cpu),
            slowest: cpu[0],
            fastest: cpu[cpu.len() - 1],
            wall_real_time_factor: median(&mut wall),
            repeats,
        }
    }
}

/// Clock of the factors: `"cpu"`, the time of the thread, or `"wall"` if the system has no such
/// clock.
pub fn clock() -> &'static str {
    if thread_time().is_some() {
        "cpu"
    } else {
        "wall"
    }
}

/// Time that this thread has run, s, where the system tells it.
fn thread_time() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    let nanoseconds: f64 = text.split_whitespace().next()?.parse().ok()?;
    Some(nanoseconds * 1e-9)
}

/// Sorts the values and returns the middle one.
fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    0.5 * (values[(n - 1) / 2] + values[n / 2])
}
