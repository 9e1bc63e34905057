//! Invariants of a node at every tick. The times are copied from docs/codes.md and docs/bus.md.

use core_algos::bus::{self, LeadMode, Message};
use core_algos::node::axle;
use core_algos::node::lead;
use core_algos::safety::OperatingState::{self, Active, Armed, Boot, Fault, Idle, SafeStop};
use core_algos::safety::{Condition, supervisor};
use core_algos::topology::{AxleId, Node, Wheels};
use std::collections::BTreeMap;

/// Conditions of class cut with their hold time, ms. The motors are off at the tick at which the hold time has passed.
const CUTS: [(Condition, u32); 8] = [
    (Condition::NotANumber, 0),
    (Condition::EncoderFault, 5),
    (Condition::OverCurrent, 2),
    (Condition::MotorStall, 300),
    (Condition::DriverFault, 0),
    (Condition::MotorUnresponsive, 50),
    (Condition::Restarted, 0),
    (Condition::RoleTaken, 0),
];
/// Conditions of class stop that drivers report, with their hold time, ms. The axle stops after the hold time.
const STOPS: [(Condition, u32); 6] = [
    (Condition::EmergencyStop, 0),
    (Condition::BusOff, 20),
    (Condition::OverTemperature, 200),
    (Condition::SupplyLow, 20),
    (Condition::TickOverrun, 5),
    (Condition::SupplyHigh, 20),
];
/// Maximum duration of a stop, ms: `stop_timeout_s` of 2 s plus one tick.
const STOP_MS: u32 = 2001;
/// Timeout of the lead's mode and of references, after which an axle stops, ms.
const COMMAND_MS: u32 = 60;
/// Timeout of heartbeats, after which a node is lost, ms.
const HEARTBEAT_MS: u32 = 50;

/// Period of the messages, ms.
const EPOCH_MS: u32 = 10;

/// Violated invariant, with values.
pub type Violation = String;

fn is_off(state: OperatingState) -> bool {
    matches!(state, Boot | Idle | Fault)
}

fn drives(state: OperatingState) -> bool {
    matches!(state, Armed | Active)
}

/// True if the debug text of a value contains a number that is not finite.
fn has_non_finite(value: &dyn std::fmt::Debug) -> bool {
    // An innovation without a usable covariance has an infinite NIS and is not used.
    let text = format!("{value:?}").replace("nis: inf", "");
    text.contains("NaN") || text.contains(" inf") || text.contains("-inf") || text.contains("[inf")
}

/// State of a node at the previous tick, with history.
#[derive(Debug)]
struct StateHistory {
    state: OperatingState,
    /// True if a reason to stop is latched.
    latched: bool,
    stopping_since: Option<u32>,
    /// Latest epoch of the messages with each frame identifier.
    epochs: BTreeMap<u16, u32>,
}

impl StateHistory {
    fn new() -> Self {
        Self {
            state: Boot,
            latched: false,
            stopping_since: None,
            epochs: BTreeMap::new(),
        }
    }

    /// Checks the change of state at this tick; `cleared` is true if the lead commands Clear.
    fn step(
        &mut self,
        tick: u32,
        supervisor: &supervisor::State,
        cleared: bool,
    ) -> Result<(), Violation> {
        let (before, state) = (self.state, supervisor.operating());
        let latched = self.latched;
        (self.state, self.latched) = (state, supervisor.first().is_some());
        if before == Fault && state != Fault && !cleared {
            return Err(format!("a fault is left by Clear alone: {state:?}"));
        }
        if before == SafeStop && latched && !cleared && !matches!(state, SafeStop | Fault) {
            return Err(format!("a stop with a reason ends in a fault: {state:?}"));
        }
        if state == Fault && supervisor.first().is_none() {
            return Err("a fault has a reason".to_owned());
        }
        if state != SafeStop {
            self.stopping_since = None;
            return Ok(());
        }
        let since = *self.stopping_since.get_or_insert(tick);
        match tick - since > STOP_MS {
            true => Err(format!("a stop lasts 2 s at most: {} ms", tick - since)),
            false => Ok(()),
        }
    }

    /// Checks a message that the node sends. A message beyond the range of its signals is not sent on the bus.
    fn sends(&mut self, tick: u32, message: &Message) -> Result<(), Violation> {
        if has_non_finite(message) {
            return Err(format!("messages are finite: {message:?}"));
        }
        let Ok(frame) = bus::encode(message) else {
            return Ok(());
        };
        let now = tick / EPOCH_MS;
        let epoch = now - u32::from((now as u8).wrapping_sub(frame.data[0]));
        let before = self.epochs.insert(frame.id, epoch);
        match epoch + 1 < now || before.is_some_and(|before| epoch < before) {
            true => Err(format!("times of messages never run back: {message:?}")),
            false => Ok(()),
        }
    }
}

/// Latest heartbeat of a node: state, reason code and tick.
type Heartbeat = (OperatingState, u8, u32);

fn failed(beat: Option<Heartbeat>, tick: u32) -> bool {
    beat.is_some_and(|(state, reason, at)| {
        matches!(state, SafeStop | Fault) && reason != 0 && tick - at <= HEARTBEAT_MS
    })
}

fn older(at: Option<u32>, tick: u32, ms: u32) -> bool {
    at.is_none_or(|at| tick - at > ms)
}

/// Checks of an axle node.
pub struct AxleChecks {
    axle: AxleId,
    limit_nm: f32,
    history: StateHistory,
    mode: Option<(LeadMode, u32)>,
    posture: Option<u32>,
    motion: Option<u32>,
    other: Option<Heartbeat>,
    lead: Option<Heartbeat>,
    since: BTreeMap<Condition, u32>,
    encoder_missing_since: Option<u32>,
}

impl AxleChecks {
    pub fn new(axle: AxleId, limit_nm: f32) -> Self {
        Self {
            axle,
            limit_nm,
            history: StateHistory::new(),
            mode: None,
            posture: None,
            motion: None,
            other: None,
            lead: None,
            since: BTreeMap::new(),
            encoder_missing_since: None,
        }
    }

    pub fn receive(&mut self, tick: u32, message: &Message) {
        let other = match self.axle {
            AxleId(0) => Node::axle(1),
            _ => Node::axle(0),
        };
        match *message {
            Message::LeadStatus { mode, .. } => self.mode = Some((mode, tick)),
            Message::ReferencePosture { axle, .. } if axle == self.axle => {
                self.posture = Some(tick);
            }
            Message::ReferenceMotion { axle, .. } if axle == self.axle => self.motion = Some(tick),
            Message::NodeStatus {
                node,
                state,
                reason,
                ..
            } => {
                let beat = Some((state, reason, tick));
                if node == other {
                    self.other = beat;
                } else if node == Node::Lead {
                    self.lead = beat;
                }
            }
            _ => {}
        }
    }

    pub fn sends(&mut self, tick: u32, message: &Message) -> Result<(), Violation> {
        self.history.sends(tick, message)
    }

    /// Checks the axle at a tick; true if the motors are switched on at this tick.
    pub fn step(
        &mut self,
        tick: u32,
        samples: &axle::Samples,
        supervisor: &supervisor::State,
        torque_nm: Wheels<f32>,
    ) -> Result<bool, Violation> {
        let before = self.history.state;
        let mode = self.mode.filter(|(_, at)| tick - at <= COMMAND_MS);
        let mode = mode.map(|(mode, _)| mode);
        self.history
            .step(tick, supervisor, mode == Some(LeadMode::Clear))?;
        let state = self.history.state;
        // Not `!(abs > limit)`, so that NaN is a violation.
        let allowed = |torque: &f32| torque.abs() <= self.limit_nm;
        if !torque_nm.list().iter().all(allowed) {
            return Err(format!("torques are within the limit: {torque_nm:?}"));
        }
        if is_off(state) && torque_nm != Wheels::both(0.0) {
            return Err(format!("motors off is no torque: {torque_nm:?}"));
        }
        self.conditions(tick, samples, state)?;
        if drives(state) {
            self.may_drive(tick, mode, before)?;
        }
        Ok(!drives(before) && drives(state))
    }

    /// Checks the reactions to conditions whose hold time has passed.
    fn conditions(
        &mut self,
        tick: u32,
        samples: &axle::Samples,
        state: OperatingState,
    ) -> Result<(), Violation> {
        self.since
            .retain(|condition, _| samples.conditions.contains(*condition));
        for condition in samples.conditions.iter() {
            self.since.entry(condition).or_insert(tick);
        }
        let has_lasted = |condition, ms| {
            let since = self.since.get(&condition);
            since.is_some_and(|since| tick - since >= ms)
        };
        for (condition, ms) in CUTS {
            if has_lasted(condition, ms) && state != Fault {
                return Err(format!("{condition:?} cuts the motors at once: {state:?}"));
            }
        }
        for (condition, ms) in STOPS {
            if has_lasted(condition, ms) && drives(state) {
                return Err(format!("{condition:?} stops the axle: {state:?}"));
            }
        }
        match samples.encoder.list().iter().any(Option::is_none) {
            true => _ = self.encoder_missing_since.get_or_insert(tick),
            false => self.encoder_missing_since = None,
        }
        match self.encoder_missing_since {
            Some(since) if tick - since >= 5 && state != Fault => {
                Err(format!("a missing encoder cuts the motors: {state:?}"))
            }
            _ => Ok(()),
        }
    }

    /// Checks the preconditions of an axle that holds or drives. An axle detects its neighbour's state one tick after
    /// arming.
    fn may_drive(
        &self,
        tick: u32,
        mode: Option<LeadMode>,
        before: OperatingState,
    ) -> Result<(), Violation> {
        let state = self.history.state;
        match mode {
            None => return Err(format!("an axle without a mode stops: {state:?}")),
            Some(LeadMode::Idle | LeadMode::Clear) => {
                return Err(format!("an axle that is let go stops: {state:?}"));
            }
            Some(_) => {}
        }
        let stale = [self.posture, self.motion].map(|at| older(at, tick, COMMAND_MS));
        if state == Active && stale != [false; 2] {
            return Err("an axle without references stops".to_owned());
        }
        if older(self.other.map(|(.., at)| at), tick, HEARTBEAT_MS) {
            return Err("an axle without its neighbour stops".to_owned());
        }
        if !is_off(before) && (failed(self.other, tick) || failed(self.lead, tick)) {
            return Err("an axle stops with its neighbour".to_owned());
        }
        Ok(())
    }
}

/// Checks of the lead node.
pub struct LeadChecks {
    history: StateHistory,
    /// True if the latest task is to clear faults.
    pub clears: bool,
    axles: [Option<Heartbeat>; 2],
}

impl LeadChecks {
    pub fn new() -> Self {
        Self {
            history: StateHistory::new(),
            clears: false,
            axles: [None; 2],
        }
    }

    pub fn receive(&mut self, tick: u32, message: &Message) {
        if let Message::NodeStatus {
            node: Node::Axle(axle),
            state,
            reason,
            ..
        } = *message
        {
            self.axles[axle.index()] = Some((state, reason, tick));
        }
    }

    /// Checks a step; true if the robot begins to drive.
    pub fn step(
        &mut self,
        tick: u32,
        supervisor: &supervisor::State,
        output: &lead::Output,
    ) -> Result<bool, Violation> {
        let before = self.history.state;
        self.history.step(tick, supervisor, self.clears)?;
        let state = self.history.state;
        if has_non_finite(output) {
            return Err(format!("outputs are finite: {output:?}"));
        }
        let commands = matches!(output.mode, LeadMode::Active | LeadMode::Hold);
        if commands && !drives(state) {
            return Err(format!("axles are driven by permit: {state:?}"));
        }
        let lost = |beat: &Option<Heartbeat>| older(beat.map(|(.., at)| at), tick, HEARTBEAT_MS);
        if drives(state) && self.axles.iter().any(lost) {
            return Err("the robot stops without an axle".to_owned());
        }
        let stopped = |beat: &Option<Heartbeat>| failed(*beat, tick);
        if drives(state) && !is_off(before) && self.axles.iter().any(stopped) {
            return Err("the robot stops with an axle".to_owned());
        }
        Ok(state == Active && before != Active)
    }
}

/// Checks of the beam node.
pub struct BeamChecks(StateHistory, Option<LeadMode>);

impl BeamChecks {
    pub fn new() -> Self {
        Self(StateHistory::new(), None)
    }

    pub fn receive(&mut self, message: &Message) {
        if let Message::LeadStatus { mode, .. } = *message {
            self.1 = Some(mode);
        }
    }

    pub fn sends(&mut self, tick: u32, message: &Message) -> Result<(), Violation> {
        self.0.sends(tick, message)
    }

    pub fn step(&mut self, tick: u32, supervisor: &supervisor::State) -> Result<(), Violation> {
        self.0
            .step(tick, supervisor, self.1 == Some(LeadMode::Clear))
    }
}
