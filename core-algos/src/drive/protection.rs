//! Conditions that switch the motors off at once: driver fault, overcurrent, supply beyond its limits, emergency stop.
//! They are checked every PWM period. All except the emergency stop must last for several periods.
//!
//! Nothing here can fail; NaN is beyond every limit.

use crate::safety::Condition;

/// Limits, and the number of successive PWM periods after which each trips.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Current limit of a motor, A, and number of periods beyond the limit after which the protection trips.
    pub current: (f32, u16),
    /// Periods of a driver fault after which the protection trips.
    pub fault_periods: u16,
    /// Lowest and highest supply voltage, V.
    pub supply_v: (f32, f32),
    /// Periods of a supply voltage beyond its limits after which the protection trips.
    pub supply_periods: u16,
}

/// A motor and its driver in one period.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motor {
    /// Current, A; `None` if the reading is at a rail or its zero is not known.
    pub current_a: Option<f32>,
    /// True if the zero of the reading is known.
    pub zeroed: bool,
    /// True if the driver reports a fault.
    pub faulty: bool,
}

/// Readings of one PWM period.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// Left and right motor.
    pub motors: [Motor; 2],
    /// Supply voltage, V.
    pub supply_v: f32,
    /// True if the emergency stop is active.
    pub stopped: bool,
    /// True if the drivers are meant to be awake; supply and emergency stop are checked only then.
    pub awake: bool,
    /// True if the wake-up time of the drivers is over; before, they report a fault.
    pub ready: bool,
}

/// The protection of both motors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Protection {
    limits: Limits,
    over: [u16; 2],
    faulty: [u16; 2],
    supply: u16,
}

impl Protection {
    /// Protection before the first period.
    pub const fn new(limits: Limits) -> Self {
        Self {
            limits,
            over: [0; 2],
            faulty: [0; 2],
            supply: 0,
        }
    }

    /// Checks one period; returns a condition if the motors must be switched off.
    pub fn step(&mut self, sample: &Sample) -> Option<Condition> {
        let limits = &self.limits;
        let mut trip = None;
        let motors = sample.motors.iter();
        for ((motor, over), faulty) in motors.zip(&mut self.over).zip(&mut self.faulty) {
            // A reading at the rail is a current out of range, or a broken sensor.
            let beyond = match motor.current_a {
                Some(current) => !(current.abs() <= limits.current.0),
                None => motor.zeroed,
            };
            if lasts(over, beyond, limits.current.1) {
                trip = trip.or(Some(Condition::OverCurrent));
            }
            if lasts(faulty, sample.ready && motor.faulty, limits.fault_periods) {
                trip = trip.or(Some(Condition::DriverFault));
            }
        }
        let (lowest, highest) = limits.supply_v;
        let high = sample.supply_v > highest;
        let inside = sample.supply_v >= lowest && !high;
        if lasts(
            &mut self.supply,
            sample.awake && !inside,
            limits.supply_periods,
        ) {
            // NaN counts as low.
            trip = trip.or(Some(match high {
                true => Condition::SupplyHigh,
                false => Condition::SupplyLow,
            }));
        }
        if sample.awake && sample.stopped {
            trip = trip.or(Some(Condition::EmergencyStop));
        }
        trip
    }
}

/// Counts successive periods in which `so` is true; returns true once there are `periods` of them.
fn lasts(count: &mut u16, so: bool, periods: u16) -> bool {
    *count = if so { count.saturating_add(1) } else { 0 };
    *count >= periods
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits = Limits {
        current: (6.0, 40),
        fault_periods: 4,
        supply_v: (8.0, 18.0),
        supply_periods: 400,
    };

    fn good() -> Sample {
        let motor = Motor {
            current_a: Some(1.0),
            zeroed: true,
            faulty: false,
        };
        Sample {
            motors: [motor; 2],
            supply_v: 12.0,
            stopped: false,
            awake: true,
            ready: true,
        }
    }

    /// Periods with a spoiled sample until the protection trips, up to 1 s; 50 good periods come first.
    fn periods(spoil: impl Fn(&mut Sample)) -> Option<(usize, Condition)> {
        let mut protection = Protection::new(LIMITS);
        for _ in 0..50 {
            assert_eq!(protection.step(&good()), None);
        }
        let mut sample = good();
        spoil(&mut sample);
        (1..=20_000).find_map(|n| Some((n, protection.step(&sample)?)))
    }

    #[test]
    fn each_cause_trips_after_its_time() {
        let over = |current: Option<f32>| move |s: &mut Sample| s.motors[1].current_a = current;
        let over_current = Some((40, Condition::OverCurrent));
        for current in [Some(6.1), Some(-6.1), Some(f32::NAN), None] {
            assert_eq!(periods(over(current)), over_current, "{current:?}");
        }
        for current in [6.0, -6.0] {
            assert_eq!(periods(over(Some(current))), None);
        }
        for i in 0..2 {
            let faulty = periods(|s| s.motors[i].faulty = true);
            assert_eq!(faulty, Some((4, Condition::DriverFault)));
        }
        for (supply, condition) in [
            (7.9, Condition::SupplyLow),
            (f32::NAN, Condition::SupplyLow),
            (18.1, Condition::SupplyHigh),
        ] {
            assert_eq!(periods(|s| s.supply_v = supply), Some((400, condition)));
        }
        for supply in [8.0, 18.0] {
            assert_eq!(periods(|s| s.supply_v = supply), None);
        }
        let stopped = periods(|s| s.stopped = true);
        assert_eq!(stopped, Some((1, Condition::EmergencyStop)));
    }

    /// Interrupted conditions do not trip: a fault of either driver, overcurrent, low supply.
    #[test]
    fn interrupted_fault_does_not_trip() {
        let mut protection = Protection::new(LIMITS);
        for k in 0..10_000 {
            let mut sample = good();
            sample.motors[0].faulty = k % 4 != 0;
            sample.motors[1].faulty = k % 4 == 0;
            sample.motors[0].current_a = Some(if k % 40 == 0 { 1.0 } else { 9.0 });
            sample.supply_v = if k % 400 == 0 { 12.0 } else { 5.0 };
            assert_eq!(protection.step(&sample), None, "{k}");
        }
    }

    #[test]
    fn sleeping_drivers_trip_only_by_current() {
        let asleep = |s: &mut Sample| {
            (s.awake, s.ready) = (false, false);
            s.supply_v = 0.0;
            s.stopped = true;
            s.motors.iter_mut().for_each(|motor| motor.faulty = true);
        };
        assert_eq!(periods(asleep), None);
        // Without a zero the current is unknown.
        let unknown = |s: &mut Sample| {
            for motor in &mut s.motors {
                (motor.current_a, motor.zeroed) = (None, false);
            }
        };
        assert_eq!(periods(unknown), None);
        // Drivers report a fault while they wake up.
        let waking = |s: &mut Sample| {
            s.ready = false;
            s.motors[0].faulty = true;
        };
        assert_eq!(periods(waking), None);
    }
}
