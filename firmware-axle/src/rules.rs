//! Rules of the tick without access to hardware: conditions, limits, button.

use core_algos::control::wheel_observer;
use core_algos::drive::winding::{self, Winding};
use core_algos::math::Posture;
use core_algos::node::board::Output;
use core_algos::node::lead::{Activity, Task};
use core_algos::params::{Button, Drive, Press};
use core_algos::safety::{Condition, Conditions};
use core_algos::time::EPOCH;

/// Epochs for which the button must keep its level before a press or a release counts: 50 ms.
const HOLD: u8 = 5;
const _: () = assert!(EPOCH == 10_000);

/// Command of the tick to the motors.
#[derive(Clone, Copy, Debug, Default)]
pub struct Command {
    /// True if the motors may be on.
    pub on: bool,
    /// True to clear a latched fault.
    pub clear: bool,
    /// Wheel torques (left, right), N m, forward positive.
    pub torque_nm: [f32; 2],
    /// Wheel speeds (left, right), rad/s, for the back-EMF.
    pub speed_rad_s: [f32; 2],
    /// Current limits of the motors (left, right), A.
    pub limit_a: [f32; 2],
}

/// Report of the motors for the last tick.
#[derive(Clone, Copy, Debug)]
pub struct Feedback {
    /// Motor currents (left, right), root mean square over the tick, A.
    pub current_a: [f32; 2],
    /// Supply voltage of the drivers, V.
    pub supply_v: f32,
    /// Temperature between the drivers, °C; `None` if the thermistor is open or short.
    pub temperature_c: Option<f32>,
    /// True if the drivers are awake and their wake-up time is over.
    pub on: bool,
    /// True if the zeros of the current sensors are known.
    pub ready: bool,
    /// True if the emergency stop is pressed.
    pub stopped: bool,
    /// True if a motor's current does not follow its voltage.
    pub unresponsive: bool,
    /// Longest run of the current loop since the start, core cycles.
    pub longest_cycles: u32,
    /// Condition that switched the motors off, latched until cleared.
    pub fault: Option<Condition>,
}

impl Feedback {
    /// Feedback before the first tick.
    pub const NOTHING: Self = Self {
        current_a: [0.0; 2],
        supply_v: 0.0,
        temperature_c: None,
        on: false,
        ready: false,
        stopped: false,
        unresponsive: false,
        longest_cycles: 0,
        fault: None,
    };

    /// Conditions of drivers, motors and supply.
    pub fn conditions(&self, drive: &Drive) -> Conditions {
        let hotter = |bound: f32| self.temperature_c.is_some_and(|t| !(t <= bound));
        let below = |bound: f32| self.ready && !(self.supply_v >= bound);
        let too_high = self.supply_v > drive.supply_maximum_v;
        let warm = hotter(drive.driver_fold_back_c());
        let conditions = Conditions::NONE
            .with(Condition::EmergencyStop, self.stopped)
            .with(Condition::TemperatureHigh, warm)
            .with(Condition::OverTemperature, hotter(drive.driver_max_c))
            .with(Condition::SupplyWarning, below(drive.supply_warning_v))
            .with(Condition::SupplyLow, below(drive.supply_minimum_v))
            .with(Condition::SupplyHigh, too_high)
            .with(Condition::MotorUnresponsive, self.unresponsive);
        match self.fault {
            Some(fault) => conditions.with(fault, true),
            None => conditions,
        }
    }
}

impl Command {
    /// Command with the node's torques and with the current limits of motors and drivers.
    pub fn limited(
        output: &Output,
        feedback: &Feedback,
        wheels: &[wheel_observer::State; 2],
        (drive, winding): (&Drive, &Winding),
        windings: &mut [winding::State; 2],
    ) -> Self {
        let driver = drive.driver_share(feedback.temperature_c);
        let mut command = Self {
            on: output.active,
            clear: output.clear,
            torque_nm: output.torque_nm.list(),
            ..Self::default()
        };
        for i in 0..2 {
            command.speed_rad_s[i] = wheels[i].speed_rad_s;
            command.limit_a[i] = winding.step(&mut windings[i], feedback.current_a[i], driver);
        }
        command
    }
}

/// The button's state between epochs.
///
/// A press counts only after a release: a button that is held, stuck or wired the other way round at the start has no
/// effect.
#[derive(Clone, Copy, Debug, Default)]
pub struct Presses {
    down: bool,
    /// Epochs since the level changed, saturating.
    held: u8,
    /// True after a release, until the next press.
    released: bool,
}

impl Presses {
    /// Takes the button's level in one epoch; true once for each press.
    pub fn step(&mut self, down: bool) -> bool {
        if down != self.down {
            (self.down, self.held) = (down, 0);
        }
        self.held = self.held.saturating_add(1);
        if self.held != HOLD {
            return false;
        }
        let pressed = down && self.released;
        self.released = !down;
        pressed
    }
}

/// Task for a press of the button; `None` keeps the robot's task.
pub fn task_of_press(activity: Activity, button: &Button, latest: Option<Posture>) -> Option<Task> {
    match (activity, button.action) {
        (Activity::Faulted, _) => Some(Task::Clear),
        (Activity::Busy, _) => Some(Task::Stop),
        (Activity::Resting, Press::Again) => Some(Task::regulate(latest.unwrap_or(button.goal))),
        (Activity::Resting, Press::StartAndGoal) => Some(Task::regulate(button.goal)),
        (Activity::Resting, Press::Nothing) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn found(feedback: Feedback) -> Conditions {
        feedback.conditions(&Drive::default())
    }

    #[test]
    fn conditions_follow_the_limits_of_supply_and_drivers() {
        let drive = Drive::default();
        let good = Feedback {
            ready: true,
            supply_v: drive.supply_warning_v + 0.1,
            temperature_c: Some(25.0),
            ..Feedback::NOTHING
        };
        assert_eq!(found(good), Conditions::NONE);
        let supply = |supply_v| found(Feedback { supply_v, ..good });
        let warned = Conditions::only(Condition::SupplyWarning);
        assert_eq!(supply(drive.supply_minimum_v + 0.1), warned);
        let low = warned.with(Condition::SupplyLow, true);
        assert_eq!(supply(drive.supply_minimum_v - 0.1), low);
        assert_eq!(supply(f32::NAN), low);
        let high = Conditions::only(Condition::SupplyHigh);
        assert_eq!(supply(drive.supply_maximum_v + 0.1), high);
        // Until the zeros of the current sensors are known, the supply of 0 V is no measurement.
        assert_eq!(found(Feedback::NOTHING), Conditions::NONE);
        let heat = |c| {
            found(Feedback {
                temperature_c: Some(c),
                ..good
            })
        };
        let warm = Conditions::only(Condition::TemperatureHigh);
        assert_eq!(heat(drive.driver_max_c - 1.0), warm);
        let hot = warm.with(Condition::OverTemperature, true);
        assert_eq!([drive.driver_max_c + 1.0, f32::NAN].map(heat), [hot; 2]);
        let fault = Some(Condition::DriverFault);
        let stopped = Feedback {
            stopped: true,
            fault,
            ..good
        };
        let both = Conditions::only(Condition::EmergencyStop).with(Condition::DriverFault, true);
        assert_eq!(found(stopped), both);
    }

    #[test]
    fn current_limits_fall_with_driver_temperature_and_winding_load() {
        let drive = Drive::default();
        let winding = drive.winding().build().unwrap();
        let output = Output {
            active: true,
            torque_nm: [0.3, -0.2].into(),
            ..Output::default()
        };
        let limits = |temperature_c, seconds: usize| {
            let current_a = [0.0, 2.0 * drive.max_current_a];
            let feedback = Feedback {
                current_a,
                temperature_c,
                ..Feedback::NOTHING
            };
            let mut windings = [winding.at_start(); 2];
            let mut step = || {
                let parts = (&drive, &winding);
                Command::limited(
                    &output,
                    &feedback,
                    &Default::default(),
                    parts,
                    &mut windings,
                )
            };
            let last = (0..1000 * seconds).map(|_| step()).last().unwrap();
            assert_eq!((last.on, last.torque_nm), (true, [0.3, -0.2]));
            last.limit_a
        };
        let max_a = drive.max_current_a;
        assert_eq!(limits(Some(25.0), 1), [max_a; 2]);
        assert_eq!(limits(None, 1), [max_a / 2.0; 2]);
        assert_eq!(limits(Some(drive.driver_max_c), 1), [0.0; 2]);
        assert_eq!(limits(Some(25.0), 200), [max_a, 0.0]);
    }

    #[test]
    fn a_press_counts_once_after_50_ms_and_bounces_do_not() {
        let mut presses = Presses::default();
        let mut count = |down: &[bool]| down.iter().filter(|down| presses.step(**down)).count();
        assert_eq!(count(&[false; 5]), 0);
        assert_eq!(count(&[true, true, true, true, false]), 0);
        assert_eq!(count(&[true; 300]), 1);
        // A bouncing release does not count.
        assert_eq!(count(&[false, true, true]), 0);
        assert_eq!(count(&[true; 5]), 0);
        assert_eq!(count(&[false; 5]), 0);
        assert_eq!(count(&[true; 5]), 1);
    }

    #[test]
    fn a_button_that_is_down_from_the_start_counts_after_its_release() {
        let mut presses = Presses::default();
        let mut count = |down: &[bool]| down.iter().filter(|down| presses.step(**down)).count();
        assert_eq!(count(&[true; 300]), 0);
        assert_eq!(count(&[false; 4]), 0);
        assert_eq!(count(&[true; 300]), 0, "not released for 50 ms");
        assert_eq!(count(&[false; 5]), 0);
        assert_eq!(count(&[true; 5]), 1);
    }

    #[test]
    fn a_press_clears_a_fault_stops_a_robot_or_begins_a_drive() {
        let (own, latest) = (Posture::new(1.0, 2.0, 3.0), Posture::new(4.0, 5.0, 6.0));
        let regulate = |goal| Some(Task::regulate(goal));
        for (action, after_none, after_some) in [
            (Press::Again, regulate(own), regulate(latest)),
            (Press::StartAndGoal, regulate(own), regulate(own)),
            (Press::Nothing, None, None),
        ] {
            let button = Button {
                goal: own,
                action,
                ..Button::default()
            };
            let press = |activity, latest| task_of_press(activity, &button, latest);
            assert_eq!(press(Activity::Resting, None), after_none);
            assert_eq!(press(Activity::Resting, Some(latest)), after_some);
            assert_eq!(press(Activity::Busy, Some(latest)), Some(Task::Stop));
            assert_eq!(press(Activity::Faulted, None), Some(Task::Clear));
        }
    }
}
