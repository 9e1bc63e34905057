//! The supervisor of a node: conditions and requests in, operating state out, once a tick.
//!
//! A condition counts once it has held for its hold time ([`Entry::hold`](super::condition::Entry)). Stops and cuts are
//! then latched until cleared, and the first of them is kept as the reason. Degradations start an allowance of time and
//! distance; when the allowance is used up, [`Condition::DegradedTooLong`] stops the robot.
//!
//! # Requirements
//!
//! | condition | reaction | within | until | reason |
//! |---|---|---|---|---|
//! | any | counts as present | its hold time without a break, to the tick | the tick at which it is gone | noise is no fault |
//! | notice | reported in the next heartbeat; no change of state | – | the report | information for the user |
//! | degraded, while *active* | `DegradedTooLong` | the tick beyond the allowed time or distance | the degradation ends, which restores both | the estimate gets worse with time and distance |
//! | stop, while the motors are on | *safe stop*, latched, the first one kept as reason | the same tick | *fault*, then `Clear` without a cause | axles that stop together do not bend the frame |
//! | stop, while the motors are off | no arming | the same tick | the tick at which it is gone | nothing moves |
//! | emergency stop, cut | *fault*, latched (an emergency stop while the motors are on: *safe stop*) | the same tick | `Clear` without a cause | control cannot be trusted |
//! | *safe stop* and rest | *fault* with a reason, *idle* without | the same tick | – | the motors are not needed |
//! | *safe stop* without rest | the same as with rest | the tick beyond `stop_timeout_s` of this stop | – | a stop must end |
//! | `Clear` outside of *fault* | none | – | – | a stop under way keeps its reason |
//! | a clock that stands still or runs back | no time passes until it is ahead of its latest time | – | – | a condition keeps its hold time |
//! | a gap between ticks | counts as 100 ms at most | – | – | a missed tick is no proof that a condition held |
//!
//! The states and their transitions: [`super::state`].
//!
//! # Example
//!
//! ```
//! use core_algos::safety::supervisor::{Config, Input, State};
//! use core_algos::safety::{Condition, Conditions, OperatingState, Permit, StateRequest};
//!
//! let supervisor = Config::default().build()?;
//! let (mut state, mut now) = (State::default(), 0);
//! let mut tick = |input: Input| {
//!     now += 1_000;
//!     supervisor.step(&mut state, now, &input)
//! };
//! for request in [StateRequest::Ready, StateRequest::Arm, StateRequest::Start] {
//!     tick(Input { request: Some(request), ..Input::default() });
//! }
//! // A bent frame counts after 30 ms.
//! let bent = Input { conditions: Conditions::only(Condition::FrameBent), ..Input::default() };
//! assert_eq!(tick(bent).permit, Permit::Drive);
//! let output = (0..40).map(|_| tick(bent)).last().expect("forty of them");
//! assert_eq!(output.state, OperatingState::SafeStop);
//! assert_eq!(output.reason, Some(Condition::FrameBent));
//! // It stays when the cause is gone; once the robot rests, the motors are off until it is cleared.
//! assert_eq!(tick(Input { halted: true, ..Input::default() }).state, OperatingState::Fault);
//! let clear = Input { request: Some(StateRequest::Clear), ..Input::default() };
//! assert_eq!(tick(clear).state, OperatingState::Idle);
//! # Ok::<(), core_algos::config::ConfigError>(())
//! ```

use super::condition::{BITS, Class, Condition, Conditions};
use super::state::{Cause, OperatingState, Permit, StateRequest, transition};
use crate::config::{ConfigError, declare};
use crate::time::Micros;

/// Longest time that counts between two steps, µs.
const LONGEST_GAP: Micros = 100_000;

declare! {
    /// Parameters of a supervisor.
    pub struct Config {
        /// Longest time the robot may drive on while degraded.
        pub degraded_time_s: f32 = 20.0, "s": Range(0.0, 3600.0);
        /// Longest distance the robot may drive on while degraded.
        pub degraded_distance_m: f32 = 2.0, "m": Positive;
        /// Time after which a stop that has not come to rest ends with motors off.
        pub stop_timeout_s: f32 = 2.0, "s": Range(0.1, 10.0);
    }
}

impl Config {
    /// Builds the supervisor; an error names the parameter out of range.
    pub fn build(&self) -> Result<Supervisor, ConfigError> {
        self.check_ranges()?;
        let to_micros = |s: f32| (s * 1e6) as Micros;
        Ok(Supervisor {
            degraded_time: to_micros(self.degraded_time_s),
            degraded_distance: self.degraded_distance_m,
            stop_timeout: to_micros(self.stop_timeout_s),
        })
    }
}

/// The supervisor, ready to run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Supervisor {
    degraded_time: Micros,
    degraded_distance: f32,
    stop_timeout: Micros,
}

/// State of a supervisor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    operating: OperatingState,
    last: Option<Micros>,
    /// Time that each condition has held without a break, µs.
    held: [u32; BITS],
    /// Conditions that held at the last step.
    holding: Conditions,
    /// Conditions that have held for their hold time.
    present: Conditions,
    /// Conditions that were present since the last call of [`Self::take_occurred`].
    occurred: Conditions,
    latched: Conditions,
    first: Option<Condition>,
    degraded_for: Micros,
    degraded_moved_m: f32,
    stopping_for: Micros,
    /// Number of times a condition of each class has come up, saturating.
    counts: [u16; 4],
}

impl Default for State {
    fn default() -> Self {
        Self {
            operating: OperatingState::Boot,
            last: None,
            held: [0; BITS],
            holding: Conditions::NONE,
            present: Conditions::NONE,
            occurred: Conditions::NONE,
            latched: Conditions::NONE,
            first: None,
            degraded_for: 0,
            degraded_moved_m: 0.0,
            stopping_for: 0,
            counts: [0; 4],
        }
    }
}

impl State {
    /// The operating state.
    pub fn operating(&self) -> OperatingState {
        self.operating
    }

    /// The first stop or cut since the last clearing.
    pub fn first(&self) -> Option<Condition> {
        self.first
    }

    /// Conditions that were present since the last call, or still are.
    pub fn take_occurred(&mut self) -> Conditions {
        core::mem::replace(&mut self.occurred, self.present)
    }

    /// Number of times a condition of `class` has come up, saturating.
    pub fn count(&self, class: Class) -> u16 {
        self.counts[class as usize]
    }

    fn hard(&self) -> bool {
        !self.latched.is_empty()
    }
}

/// Input of the supervisor at a tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Input {
    /// Conditions that hold at this tick.
    pub conditions: Conditions,
    /// Requested change of the operating state; `None` without a request.
    pub request: Option<StateRequest>,
    /// Distance driven since the last tick, m; a value that is not finite uses the allowance up.
    pub moved_m: f32,
    /// True if the coordinated stop is over and the node's motors are no longer needed.
    pub halted: bool,
}

/// Decision of the supervisor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Output {
    /// Operating state after this tick.
    pub state: OperatingState,
    /// Permit of the motors.
    pub permit: Permit,
    /// The reason of a stop or fault.
    pub reason: Option<Condition>,
    /// True if the state changed at this tick.
    pub changed: bool,
}

impl Supervisor {
    /// Runs one tick at `now`.
    pub fn step(&self, state: &mut State, now: Micros, input: &Input) -> Output {
        let before = state.operating;
        let dt = match state.last {
            Some(last) => now.saturating_sub(last).min(LONGEST_GAP),
            None => 0,
        };
        state.last = Some(state.last.map_or(now, |last| last.max(now)));

        let conditions = self.allowance(state, dt, input);
        self.hold(state, dt, conditions);
        state.occurred = state.occurred.union(state.present);
        // Clearing drops conditions that are over; present ones are latched again below.
        if input.request == Some(StateRequest::Clear) && state.operating == OperatingState::Fault {
            state.latched = Conditions::NONE;
            state.first = None;
        }
        state.latched = state.latched.union(state.present.hard());
        if state.first.is_none() {
            state.first = state.latched.worst();
        }
        for condition in state.present.iter() {
            let hard = state.hard();
            state.operating = transition(state.operating, Cause::Condition(condition), hard);
        }
        self.stop(state, dt, input.halted);
        if let Some(request) = input.request {
            let hard = state.hard();
            state.operating = transition(state.operating, Cause::Request(request), hard);
        }
        // While the motors are off, a condition of class stop that is over needs no clearing.
        if matches!(state.operating, OperatingState::Boot | OperatingState::Idle) {
            state.latched = state.present.hard();
            state.first = state.latched.worst();
        }
        Output {
            state: state.operating,
            permit: state.operating.permit(),
            reason: state.first,
            changed: state.operating != before,
        }
    }

    /// Conditions of the input, with `DegradedTooLong` if the allowance is used up.
    fn allowance(&self, state: &mut State, dt: Micros, input: &Input) -> Conditions {
        let degraded = !state.present.degraded().is_empty();
        let moving = matches!(state.operating, OperatingState::Active);
        if !degraded {
            state.degraded_for = 0;
            state.degraded_moved_m = 0.0;
        } else if moving {
            state.degraded_for = state.degraded_for.saturating_add(dt);
            state.degraded_moved_m += input.moved_m.abs();
        }
        let within = state.degraded_for <= self.degraded_time
            && state.degraded_moved_m <= self.degraded_distance;
        input
            .conditions
            .with(Condition::DegradedTooLong, degraded && moving && !within)
    }

    /// Counts how long each condition has held.
    fn hold(&self, state: &mut State, dt: Micros, conditions: Conditions) {
        for condition in state.holding.iter() {
            if !conditions.contains(condition)
                && let Some(held) = state.held.get_mut(condition as usize)
            {
                *held = 0;
            }
        }
        state.holding = conditions;
        state.present = state.present.both(conditions);
        for condition in conditions.iter() {
            let Some(held) = state.held.get_mut(condition as usize) else {
                continue;
            };
            // The tick at which a condition appears begins its hold time.
            if *held == 0 {
                *held = 1;
            } else {
                *held = held.saturating_add(dt as u32);
            }
            let counts = Micros::from(*held) > condition.entry().hold;
            if counts && !state.present.contains(condition) {
                state.present.set(condition, true);
                let count = &mut state.counts[condition.class() as usize];
                *count = count.saturating_add(1);
            }
        }
    }

    /// Ends a stop that is over or takes too long.
    fn stop(&self, state: &mut State, dt: Micros, halted: bool) {
        if state.operating != OperatingState::SafeStop {
            state.stopping_for = 0;
            return;
        }
        state.stopping_for = state.stopping_for.saturating_add(dt);
        if halted || state.stopping_for > self.stop_timeout {
            let hard = state.hard();
            state.operating =
                transition(state.operating, Cause::Request(StateRequest::Halted), hard);
        }
    }
}

#[cfg(test)]
mod tests;
