//! Keys of the dashboard: end of the run, pause, single steps and speed of a simulation, and the drive by hand.

use core_algos::node::lead::Task;
use core_algos::time::{EPOCH, TICK};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Time without a key after which a robot driven by hand stops.
const IDLE_TIMEOUT: Duration = Duration::from_secs(5);
/// Lower and upper limit of a simulation's speed, times real time.
const RATES: (f64, f64) = (0.125, 16.0);
/// Key presses from rest to the largest speed, and from straight to the largest curvature.
const STEPS: f64 = 8.0;

/// Action of a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Key {
    /// Ends the run.
    End,
    /// Interrupts the run: Ctrl-C, or the terminal was closed.
    Interrupt,
    /// Pauses or resumes the simulation.
    Pause,
    /// Advances a paused simulation by one epoch.
    Step,
    /// Doubles the speed of the simulation.
    Faster,
    /// Halves the speed of the simulation.
    Slower,
    /// Raises the speed of the robot.
    Forward,
    /// Lowers the speed of the robot.
    Backward,
    /// Bends the path to the left.
    Left,
    /// Bends the path to the right.
    Right,
    /// Stops the robot.
    Halt,
    /// Clears the faults of the robot.
    Clear,
}

/// Command of a drive by hand.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Hand {
    /// Commanded speed, m/s.
    pub speed_m_s: f64,
    /// Commanded curvature, 1/m.
    pub curvature: f64,
    /// Task to send before the speed: stop, or clear the faults.
    pub task: Option<Task>,
}

impl Hand {
    /// Command with zero speed and a task.
    fn at_rest(task: Task) -> Self {
        Self {
            task: Some(task),
            ..Self::default()
        }
    }
}

/// State of the keys.
#[derive(Clone, Copy, Debug)]
struct Keys {
    ended: bool,
    interrupted: bool,
    paused: bool,
    /// Ticks that a paused simulation may still run.
    ticks: u64,
    rate: f64,
    hand: Hand,
    /// Limits of speed (m/s) and curvature (1/m) of a drive by hand; `None` if the keys do not drive.
    limits: Option<[f64; 2]>,
    pressed: Instant,
    /// True if the robot was stopped because no key was pressed.
    idled: bool,
}

/// Keys read by the dashboard and obeyed by the run; clones share their state.
#[derive(Clone, Debug)]
pub struct Keyboard(Arc<Mutex<Keys>>);

impl PartialEq for Keyboard {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

impl Default for Keyboard {
    fn default() -> Self {
        Self(Arc::new(Mutex::new(Keys {
            ended: false,
            interrupted: false,
            paused: false,
            ticks: 0,
            rate: 1.0,
            hand: Hand::default(),
            limits: None,
            pressed: Instant::now(),
            idled: false,
        })))
    }
}

impl Keyboard {
    /// Keys that drive a robot, with the largest speed (m/s) and curvature (1/m).
    pub fn of_driver(limits: [f64; 2]) -> Self {
        let keyboard = Self::default();
        keyboard.keys().limits = Some(limits);
        keyboard
    }

    fn keys(&self) -> MutexGuard<'_, Keys> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Applies a pressed key.
    pub fn press(&self, key: Key) {
        let mut keys = self.keys();
        (keys.pressed, keys.idled) = (Instant::now(), false);
        let limits = keys.limits.unwrap_or_default();
        let add = |value: f64, limit: f64, steps: f64| {
            let raised = ((value / limit * STEPS).round() + steps) / STEPS;
            limit * raised.clamp(-1.0, 1.0)
        };
        let hand = keys.hand;
        match key {
            Key::End => keys.ended = true,
            Key::Interrupt => (keys.ended, keys.interrupted) = (true, true),
            Key::Pause => keys.paused = !keys.paused,
            Key::Step => keys.ticks = EPOCH / TICK,
            Key::Faster => keys.rate = (2.0 * keys.rate).min(RATES.1),
            Key::Slower => keys.rate = (0.5 * keys.rate).max(RATES.0),
            _ if keys.limits.is_none() => {}
            Key::Forward => keys.hand.speed_m_s = add(hand.speed_m_s, limits[0], 1.0),
            Key::Backward => keys.hand.speed_m_s = add(hand.speed_m_s, limits[0], -1.0),
            Key::Left => keys.hand.curvature = add(hand.curvature, limits[1], 1.0),
            Key::Right => keys.hand.curvature = add(hand.curvature, limits[1], -1.0),
            Key::Halt => keys.hand = Hand::at_rest(Task::Stop),
            Key::Clear => keys.hand = Hand::at_rest(Task::Clear),
        }
    }

    /// True if the user ended the run.
    pub fn is_ended(&self) -> bool {
        self.keys().ended
    }

    /// True if the user interrupted the run.
    pub fn is_interrupted(&self) -> bool {
        self.keys().interrupted
    }

    /// True if the keys drive the robot.
    pub fn drives(&self) -> bool {
        self.keys().limits.is_some()
    }

    /// True if the simulation is paused, and its speed in multiples of real time.
    pub fn pace(&self) -> (bool, f64) {
        let keys = self.keys();
        (keys.paused, keys.rate)
    }

    /// True if the simulation is paused without ticks left, and must wait. A paused simulation with ticks left uses up
    /// one tick. False after the end of the run.
    pub fn holds(&self) -> bool {
        let mut keys = self.keys();
        if !keys.paused || keys.ended {
            return false;
        }
        let holds = keys.ticks == 0;
        keys.ticks = keys.ticks.saturating_sub(1);
        holds
    }

    /// Command of the drive by hand. The commanded speed becomes 0 after five seconds without a key.
    pub fn hand(&self) -> Hand {
        let mut keys = self.keys();
        if keys.pressed.elapsed() > IDLE_TIMEOUT && keys.hand.speed_m_s != 0.0 {
            keys.hand.speed_m_s = 0.0;
            keys.idled = true;
        }
        keys.hand
    }

    /// Notice that the robot stopped because no key was pressed; `None` if it did not stop for this reason.
    pub fn idle_stop(&self) -> Option<String> {
        let seconds = IDLE_TIMEOUT.as_secs();
        let text =
            || format!("no key for {seconds} s, so the robot stopped: press a key to drive on");
        self.keys().idled.then(text)
    }

    /// Removes and gives the task that must be sent before the commanded speed; `None` if there is none.
    pub fn take_task(&self) -> Option<Task> {
        self.keys().hand.task.take()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_change_speed_and_curvature_within_their_limits() {
        let keyboard = Keyboard::of_driver([0.4, 2.0]);
        for _ in 0..3 {
            keyboard.press(Key::Forward);
        }
        keyboard.press(Key::Right);
        let hand = keyboard.hand();
        assert!((hand.speed_m_s - 0.15).abs() < 1e-12 && (hand.curvature + 0.25).abs() < 1e-12);
        for _ in 0..30 {
            keyboard.press(Key::Backward);
            keyboard.press(Key::Left);
        }
        let hand = keyboard.hand();
        assert_eq!((hand.speed_m_s, hand.curvature), (-0.4, 2.0));
        keyboard.press(Key::Clear);
        assert_eq!(keyboard.hand(), Hand::at_rest(Task::Clear));
        keyboard.press(Key::Halt);
        assert_eq!(keyboard.take_task(), Some(Task::Stop));
        assert_eq!(keyboard.hand(), Hand::default());
        // A default keyboard does not drive the robot.
        let watcher = Keyboard::default();
        watcher.press(Key::Forward);
        assert_eq!(watcher.hand(), Hand::default());
    }

    #[test]
    fn idle_driver_stops_a_moving_robot_until_the_next_key() {
        let keyboard = Keyboard::of_driver([0.4, 2.0]);
        let idle = || {
            keyboard.keys().pressed -= IDLE_TIMEOUT + Duration::from_millis(1);
            (keyboard.hand().speed_m_s, keyboard.idle_stop().is_some())
        };
        assert_eq!(idle(), (0.0, false), "at rest anyway");
        keyboard.press(Key::Forward);
        assert_eq!(idle(), (0.0, true));
        keyboard.press(Key::Forward);
        assert!(keyboard.idle_stop().is_none());
    }

    #[test]
    fn paused_simulation_advances_one_epoch_per_step() {
        let keyboard = Keyboard::default();
        assert!(!keyboard.holds());
        keyboard.press(Key::Pause);
        assert!(keyboard.holds());
        keyboard.press(Key::Step);
        assert_eq!((0..100).filter(|_| !keyboard.holds()).count(), 10);
        keyboard.press(Key::Pause);
        assert!(!keyboard.holds());
        for _ in 0..10 {
            keyboard.press(Key::Faster);
        }
        assert_eq!(keyboard.pace(), (false, 16.0));
    }
}
