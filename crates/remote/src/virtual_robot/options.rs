//! Options of the boards, and random properties of each chip.

use core_algos::topology::Role;
use host_sim::world::random::{Stream, generator};
use rand::RngExt;
use virtual_board::Time;
use virtual_board::chip::ChipVariation;

/// Options of a robot's virtual boards.
#[derive(Clone, Debug)]
pub struct Options {
    /// Number of threads for the boards.
    pub threads: usize,
    /// Power-on delays of the listed boards, ms; the other boards have no delay.
    pub late_ms: Vec<(Role, u64)>,
    /// True if execution time is counted per instruction, for [`profile`](super::tools::profile).
    pub profile: bool,
    /// Frequency errors of the listed boards' crystals, parts in 10⁹; the other boards get random errors.
    pub fast_ppb: Vec<(Role, i64)>,
    /// Changes a chip after the random draw.
    pub vary: fn(Role, &mut ChipVariation),
    /// Number of bus nodes that are no boards.
    pub extra_nodes: usize,
    /// True if this program is the host at the front board's serial port.
    pub host: bool,
    /// True if all boards are recorded, each at its serial port.
    pub record: bool,
}

/// Random chip within the limits of its data sheet.
pub fn chip(seed: u64) -> ChipVariation {
    let mut random = generator(seed, 0, Stream::Other(0x201));
    ChipVariation {
        crystal_start: Time::from_micros(random.random_range(1_000..=5_000)),
        internal_hz: random.random_range(15_840_000..=16_160_000),
        slow_hz: random.random_range(17_000..=47_000),
        converter_nonlinearity: random.random_range(0.5..=3.0),
        converter_seed: seed,
        seed,
        ..ChipVariation::default()
    }
}

impl Options {
    /// Number of threads for a single robot.
    pub fn threads() -> usize {
        rayon::current_num_threads().min(2)
    }
}

impl Default for Options {
    fn default() -> Self {
        Self {
            threads: 1,
            late_ms: Vec::new(),
            profile: false,
            fast_ppb: Vec::new(),
            vary: |_, _| {},
            extra_nodes: 0,
            host: true,
            record: false,
        }
    }
}
