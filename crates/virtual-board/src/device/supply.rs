//! Supplies: a voltage that is told over time, a battery with its resistance and the regulator behind
//! it, a divider with a capacitor.

use super::span_s;
use crate::time::Time;

/// A quantity over time: straight lines between points, constant before the first and after the last.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Profile {
    points: Vec<(Time, f64)>,
}

impl Profile {
    /// Constant.
    pub fn constant(value: f64) -> Self {
        Self {
            points: vec![(Time(0), value)],
        }
    }

    /// Through points in the order of time; two at one time are a step.
    pub fn through(points: impl IntoIterator<Item = (Time, f64)>) -> Self {
        let mut points: Vec<_> = points.into_iter().collect();
        points.sort_by_key(|p| p.0);
        Self { points }
    }

    /// The value at a time; at a step the later one. Without any point 0.
    pub fn at(&self, at: Time) -> f64 {
        let after = self.points.partition_point(|p| p.0 <= at);
        let before = after.checked_sub(1).and_then(|i| self.points.get(i));
        match (before, self.points.get(after)) {
            (None, None) => 0.0,
            (Some(p), None) | (None, Some(p)) => p.1,
            (Some(p), Some(q)) => {
                let share = span_s(p.0, at) / span_s(p.0, q.0);
                p.1 + share * (q.1 - p.1)
            }
        }
    }

    /// The next point after a time: where the slope or the value changes.
    pub fn next(&self, after: Time) -> Time {
        let index = self.points.partition_point(|p| p.0 <= after);
        self.points.get(index).map_or(Time::NEVER, |p| p.0)
    }
}

/// A battery and the 3.3 V regulator behind it.
#[derive(Clone, Debug, PartialEq)]
pub struct Supply {
    /// Voltage without load, V.
    pub open_v: Profile,
    /// Resistance of cells and leads, Ω.
    pub resistance_ohm: f64,
    /// What the regulator gives as long as it can, V.
    pub regulated_v: f64,
    /// What it needs above that, V.
    pub dropout_v: f64,
}

impl Supply {
    /// A battery of constant voltage with 50 mΩ; 3.3 V with 1.1 V of drop-out, as an LM1117 has.
    pub fn battery(volts: f64) -> Self {
        Self {
            open_v: Profile::constant(volts),
            resistance_ohm: 0.05,
            regulated_v: 3.3,
            dropout_v: 1.1,
        }
    }

    /// Voltage at the drivers under a current, V.
    pub fn battery_v(&self, at: Time, amperes: f64) -> f64 {
        (self.open_v.at(at) - self.resistance_ohm * amperes).max(0.0)
    }

    /// Voltage behind the regulator, V.
    pub fn logic_v(&self, at: Time, amperes: f64) -> f64 {
        (self.battery_v(at, amperes) - self.dropout_v).clamp(0.0, self.regulated_v)
    }
}

/// Two resistors, and a capacitor across the lower one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Divider {
    share: f64,
    tau_s: f64,
    now: Time,
    input_v: f64,
    output_v: f64,
}

impl Divider {
    /// Settled at an input of `volts`.
    pub fn new(upper_ohm: f64, lower_ohm: f64, farad: f64, volts: f64) -> Self {
        let share = lower_ohm / (upper_ohm + lower_ohm);
        Self {
            share,
            tau_s: upper_ohm * share * farad,
            now: Time(0),
            input_v: volts,
            output_v: share * volts,
        }
    }

    /// The input has this voltage from now on.
    pub fn input(&mut self, at: Time, volts: f64) {
        self.output(at);
        self.input_v = volts;
    }

    /// The output at a time, V.
    pub fn output(&mut self, at: Time) -> f64 {
        let target = self.share * self.input_v;
        if self.tau_s > 0.0 {
            let left = libm::exp(-span_s(self.now, at) / self.tau_s);
            self.output_v = target + (self.output_v - target) * left;
        } else {
            self.output_v = target;
        }
        self.now = self.now.max(at);
        self.output_v
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000_000;

    #[test]
    fn a_profile_goes_through_its_points_and_steps() {
        let times = [(10, 12.0), (20, 8.0), (20, 0.0), (30, 0.0), (30, 12.0)];
        let profile = Profile::through(times.map(|(ms, v)| (Time(ms * MS), v)));
        for (ms, volts) in [
            (0, 12.0),
            (15, 10.0),
            (20, 0.0),
            (25, 0.0),
            (30, 12.0),
            (99, 12.0),
        ] {
            assert_eq!(profile.at(Time(ms * MS)), volts, "{ms}");
        }
        assert_eq!(profile.next(Time(20 * MS)), Time(30 * MS));
        assert_eq!(profile.next(Time(30 * MS)), Time::NEVER);
    }

    #[test]
    fn a_battery_sags_and_the_regulator_drops_out() {
        let mut supply = Supply::battery(12.0);
        assert!((supply.battery_v(Time(0), 8.0) - 11.6).abs() < 1e-12);
        assert_eq!(supply.logic_v(Time(0), 8.0), 3.3);
        supply.open_v = Profile::constant(4.0);
        assert!((supply.logic_v(Time(0), 0.0) - 2.9).abs() < 1e-12);
    }

    #[test]
    fn the_divider_of_the_supply_has_eight_tenths_of_a_millisecond() {
        let mut divider = Divider::new(47e3, 10e3, 100e-9, 12.0);
        assert!((divider.output(Time(MS)) - 12.0 / 5.7).abs() < 1e-12);
        divider.input(Time(MS), 0.0);
        // 47 kΩ and 10 kΩ in parallel times 100 nF: 0.8246 ms to 1/e.
        let at = Time(MS + 824_561_404);
        assert!((divider.output(at) - 12.0 / 5.7 / std::f64::consts::E).abs() < 1e-6);
    }
}
