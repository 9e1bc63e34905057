//! Battery, 3.3 V rail and crystal of a board.

use std::collections::VecDeque;
use virtual_board::Time;
use virtual_board::chip::Inputs;
use virtual_board::device::{Profile, Supply};

/// Open-circuit voltage of the battery, V.
pub const BATTERY_V: f64 = 12.0;
/// Supply of the chip, the amplifiers and the sensors, V.
const LOGIC_V: f64 = 3.3;

/// Time in which the rail falls by one volt, s/V.
const FALL_S_PER_V: f64 = 100e-6;
/// Number of steps that approximate a fall of the rail.
const FALL_STEPS: u32 = 100;

/// Supplies and clock of a board.
#[derive(Clone)]
pub struct Power {
    /// Battery as seen at the drivers.
    pub battery: Supply,
    rail: Profile,
    /// Time up to which changes of the rail were passed to the chip.
    known: Time,
    crystal: VecDeque<(Time, bool)>,
}

impl Power {
    /// Sound supplies and crystal, with a battery of this voltage.
    pub fn new(battery_v: f64) -> Self {
        Self {
            battery: Supply::battery(battery_v),
            rail: Profile::constant(LOGIC_V),
            known: Time(0),
            crystal: VecDeque::new(),
        }
    }

    /// Voltage of the 3.3 V rail at `at`, V.
    pub fn logic_v(&self, at: Time) -> f64 {
        self.rail.at(at)
    }

    /// Lowers the rail to `volts` from `from` until `to`, at least until the fall is complete. The rail falls by 1 V in
    /// 100 µs, because a load of 0.1 A discharges 10 µF.
    pub fn dip(&mut self, from: Time, to: Time, volts: f64) {
        let fall = |share: f64| {
            let depth = share * (LOGIC_V - volts);
            let after = Time::from_nanos((depth * FALL_S_PER_V * 1e9) as u64);
            (from + after, LOGIC_V - depth)
        };
        let falls = (0..=FALL_STEPS).map(|k| fall(f64::from(k) / f64::from(FALL_STEPS)));
        let to = to.max(fall(1.0).0);
        self.rail = Profile::through(falls.chain([(to, volts), (to, LOGIC_V)]));
    }

    /// Stops or starts the crystal at `at`.
    pub fn crystal(&mut self, at: Time, works: bool) {
        self.crystal.push_back((at, works));
    }

    /// Time of the next change of the rail or the crystal.
    pub fn next(&self) -> Time {
        let crystal = self.crystal.front().map_or(Time::NEVER, |change| change.0);
        self.rail.next(self.known).min(crystal)
    }

    /// Passes due changes to the chip.
    pub fn advance(&mut self, at: Time, inputs: &mut Inputs) {
        inputs.supply |= self.rail.next(self.known) <= at;
        self.known = self.known.max(at);
        while let Some((_, works)) = self.crystal.pop_front_if(|change| change.0 <= at) {
            inputs.crystal = Some(works);
        }
    }
}
