//! Supplies: a profile over time; a battery with resistance and regulator; a divider with capacitor.

use super::span_s;
use crate::time::Time;

/// A quantity over time: linear between points, constant before the first point and after the last.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Profile {
    points: Vec<(Time, f64)>,
}

impl Profile {
    /// A constant profile.
    pub fn constant(value: f64) -> Self {
        Self {
            points: vec![(Time(0), value)],
        }
    }

    /// A profile through points in the order of time; two points at the same time are a step.
    pub fn through(points: impl IntoIterator<Item = (Time, f64)>) -> Self {
        let mut points: Vec<_> = points.into_iter().collect();
        points.sort_by_key(|p| p.0);
        Self { points }
    }

    /// Value at a time; at a step, the value after it; 0 without points.
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

    /// Time of the first point after `after`, where slope or value changes; [`Time::NEVER`] after the last point.
    pub fn next(&self, after: Time) -> Time {
        let index = self.points.partition_point(|p| p.0 <= after);
        self.points.get(index).map_or(Time::NEVER, |p| p.0)
    }
}

/// A battery and its 3.3 V regulator.
#[derive(Clone, Debug, PartialEq)]
pub struct Supply {
    /// Open-circuit voltage of the battery over time, V.
    pub open_v: Profile,
    /// Resistance of cells and leads, Ω.
    pub resistance_ohm: f64,
    /// Nominal output of the regulator, V.
    pub regulated_v: f64,
    /// Drop-out voltage of the regulator, V.
    pub dropout_v: f64,
}

impl Supply {
    /// A battery of constant open-circuit voltage with 50 mΩ; the regulator has 3.3 V and 1.1 V drop-out, as an LM1117.
    pub fn battery(volts: f64) -> Self {
        Self {
            open_v: Profile::constant(volts),
            resistance_ohm: 0.05,
            regulated_v: 3.3,
            dropout_v: 1.1,
        }
    }

    /// Battery voltage at the drivers under a current, V.
    pub fn battery_v(&self, at: Time, amperes: f64) -> f64 {
        (self.open_v.at(at) - self.resistance_ohm * amperes).max(0.0)
    }

    /// Output voltage of the regulator, V.
    pub fn logic_v(&self, at: Time, amperes: f64) -> f64 {
        (self.battery_v(at, amperes) - self.dropout_v).clamp(0.0, self.regulated_v)
    }
}

/// A voltage divider with a capacitor across the lower resistor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Divider {
    share: f64,
    tau_s: f64,
    now: Time,
    input_v: f64,
    output_v: f64,
}

impl Divider {
    /// A divider settled at an input of `volts`.
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

    /// Sets the input voltage from `at` on.
    pub fn input(&mut self, at: Time, volts: f64) {
        self.output(at);
        self.input_v = volts;
    }

    /// Output at a time, V.
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
    fn profile_passes_through_its_points_and_steps() {
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
    fn battery_sags_under_load_and_the_regulator_drops_out() {
        let mut supply = Supply::battery(12.0);
        assert!((supply.battery_v(Time(0), 8.0) - 11.6).abs() < 1e-12);
        assert_eq!(supply.logic_v(Time(0), 8.0), 3.3);
        supply.open_v = Profile::constant(4.0);
        assert!((supply.logic_v(Time(0), 0.0) - 2.9).abs() < 1e-12);
    }

    #[test]
    fn supply_divider_has_a_time_constant_of_0_82_ms() {
        let mut divider = Divider::new(47e3, 10e3, 100e-9, 12.0);
        assert!((divider.output(Time(MS)) - 12.0 / 5.7).abs() < 1e-12);
        divider.input(Time(MS), 0.0);
        // The time constant is 0.8246 ms, from 100 nF and the parallel resistance of 47 kΩ and 10 kΩ.
        let at = Time(MS + 824_561_404);
        assert!((divider.output(at) - 12.0 / 5.7 / std::f64::consts::E).abs() < 1e-6);
    }
}
