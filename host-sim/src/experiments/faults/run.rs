//! One run with a fault, and how it ended.

use crate::base::error::Error;
use crate::run::recovery::Status;
use crate::run::robot::Robot as _;
use crate::run::simulation::Simulation;
use crate::scenario::Scenario;
use crate::targets::HostCommand;
use crate::world::faults::{Entry, Fault};
use core_algos::bus::LeadMode;
use core_algos::control::regulator::Phase;
use core_algos::math::Posture;
use core_algos::node::lead::Task;
use core_algos::safety::Condition;
use core_algos::time::{EPOCH, Micros, TICK};
use serde::Serialize;

/// Motion that a robot under control never shows for longer than a moment.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Bounds {
    /// Speed of an axle's midpoint, m/s. The governor allows half of it.
    pub speed_m_s: f64,
    /// Bend of the frame, half the angle between the axles, rad.
    pub steering_rad: f64,
    /// Force of the frame, N.
    pub force_n: f64,
    /// The moment, s.
    pub moment_s: f64,
}

impl Default for Bounds {
    fn default() -> Self {
        Self {
            speed_m_s: 0.5,
            steering_rad: 0.8,
            force_n: 40.0,
            moment_s: 0.3,
        }
    }
}

/// Largest distance (m) and heading error (rad) of a finished task.
pub const TOLERANCE: [f64; 2] = [0.03, 0.052_36];
/// Speed of a robot at rest, m/s.
const REST_M_S: f64 = 0.02;
/// Speed of a robot that a motor drives again, m/s.
const SWING_M_S: f64 = 0.1;
/// Time at rest with motors off that counts as stopped, ticks.
const REST: u32 = 100;
/// Time a stopped robot is watched, ticks.
const WATCH: u32 = 1000;

/// End of a run.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum End {
    /// Task done within [`TOLERANCE`], or within what the robot then said it knows of its posture (95 %).
    Finished,
    /// At rest with motors off, for a reason that fits the fault, in time.
    Stopped,
    /// The robot took the task for done, but was farther off.
    Missed,
    /// Stopped, but late, or for a reason that does not fit, or for none.
    WrongStop,
    /// A bound was exceeded for more than a moment.
    Uncontrolled,
    /// Neither done nor stopped within the time limit.
    Unfinished,
}

impl End {
    /// True if this end is allowed.
    pub fn is_right(self) -> bool {
        matches!(self, Self::Finished | Self::Stopped)
    }
}

/// Outcome of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outcome {
    /// Time of the fault, s.
    pub at_s: f64,
    /// Seed.
    pub seed: u64,
    /// Result.
    pub end: End,
    /// The heartbeat that first told of a stop or a cut.
    pub first: Option<Status>,
    /// From the fault to rest with motors off, s.
    pub stop_s: Option<f64>,
    /// True distance from the goal at the end, m.
    pub error_m: f64,
    /// True heading error at the end, rad.
    pub heading_rad: f64,
    /// Half axis of the ellipse in which a robot that took the task for done said it is, m, and half the
    /// interval of its heading, rad, both with 95 %.
    pub claimed: Option<[f64; 2]>,
    /// Largest speed from the fault on, m/s.
    pub speed_m_s: f64,
    /// Largest true steering angle |ψ| from the fault on, rad.
    pub steering_rad: f64,
    /// Largest force of the frame from the fault on, N.
    pub force_n: f64,
    /// Torques at the end, N m.
    pub torque_nm: [[f64; 2]; 2],
    /// Speed at the end, m/s.
    pub end_speed_m_s: f64,
    /// Heartbeats of the nodes.
    pub nodes: Vec<Status>,
}

impl Outcome {
    /// Code of the first reason.
    pub fn code(&self) -> Option<Condition> {
        self.first.and_then(|status| status.reason)
    }
}

/// A fault, when it comes, and the seed of all draws.
#[derive(Clone, Copy, Debug)]
pub struct Case<'a> {
    /// The fault and how the run may end.
    pub entry: &'a Entry,
    /// Time, µs after the start of the task.
    pub after: Micros,
    /// Seed.
    pub seed: u64,
}

impl Case<'_> {
    /// Time, µs from the start of the simulation.
    fn at(&self, scenario: &Scenario) -> Micros {
        (scenario.mission.settle_s * 1e6) as Micros + self.after
    }

    /// First tick of the fault.
    pub fn tick(&self, scenario: &Scenario) -> u32 {
        (self.at(scenario) / TICK) as u32
    }
}

/// Regulates to the scenario's goal, with the boards in this process.
pub fn run(scenario: &Scenario, case: &Case, bounds: &Bounds) -> Result<Outcome, Error> {
    let mut simulation = Simulation::new(scenario, case.seed, 0)?;
    simulation.inject(case.entry.fault, case.tick(scenario));
    run_on(&mut simulation, scenario, case, bounds)
}

/// End of a robot that stopped so long ago, µs; none while it is watched.
fn stop(since: Micros, off: bool, speed: f64) -> Option<End> {
    // The frame may swing a little when the motors let go.
    if !off || !(speed < SWING_M_S) {
        return Some(End::WrongStop);
    }
    (since >= Micros::from(WATCH) * TICK).then_some(End::Stopped)
}

/// Largest speed (m/s), steering angle (rad) and force (N), and ticks beyond the bound of each.
#[derive(Default)]
struct Extremes {
    most: [f64; 3],
    beyond: [u32; 3],
}

impl Extremes {
    fn see(&mut self, seen: [f64; 3], bounds: &Bounds) {
        let limits = [bounds.speed_m_s, bounds.steering_rad, bounds.force_n];
        for i in 0..3 {
            self.most[i] = self.most[i].max(seen[i]);
            // NaN is beyond every bound.
            let within = seen[i] <= limits[i];
            self.beyond[i] = if within { 0 } else { self.beyond[i] + 1 };
        }
    }

    /// True if one is beyond its bound for longer than a moment.
    fn are_beyond(&self, bounds: &Bounds) -> bool {
        let moment = (bounds.moment_s * 1e3) as u32;
        self.beyond.iter().any(|ticks| *ticks > moment)
    }
}

/// The same with a simulation into which the fault has been put.
pub fn run_on(
    simulation: &mut Simulation,
    scenario: &Scenario,
    case: &Case,
    bounds: &Bounds,
) -> Result<Outcome, Error> {
    let mission = &scenario.mission;
    let settle = (mission.settle_s * 1e6) as Micros;
    let limit = settle + (mission.time_limit_s * 1e6) as Micros;
    let at = case.at(scenario);
    let mut extremes = Extremes::default();
    let (mut rest, mut stopped_at) = (0u32, None);
    let mut done = 0u32;
    let mut claimed = None;
    let mut end = End::Unfinished;
    while simulation.now() < limit {
        let now = simulation.now();
        if now == settle {
            let goal = Posture::from(mission.goal.map(|v| v as f32));
            simulation.command(&HostCommand::Task(Task::Regulate { goal }))?;
        }
        simulation.step()?;
        let wrench = simulation.plant().wrench().force;
        let seen = [
            simulation.speed(),
            simulation.steering().abs(),
            wrench[0].hypot(wrench[1]),
        ];
        if now >= at {
            extremes.see(seen, bounds);
            if extremes.are_beyond(bounds) {
                end = End::Uncontrolled;
                break;
            }
        }
        let off = simulation.torque() == [[0.0; 2]; 2];
        rest = (rest + 1) * u32::from(off && seen[0] < REST_M_S);
        let faulted = simulation.monitor().first_fault().is_some();
        if now >= at && faulted && rest >= REST && stopped_at.is_none() {
            stopped_at = Some(now - Micros::from(rest) * TICK);
        }
        if let Some(ended) = stopped_at.and_then(|since| stop(now - since, off, seen[0])) {
            end = ended;
            break;
        }
        // What the lead node did comes from a board in parts, all of it by the end of the epoch.
        if !simulation.now().is_multiple_of(EPOCH) {
            continue;
        }
        let lead = simulation.lead_output();
        let finished = lead.done && lead.mode == LeadMode::Hold && lead.phase == Phase::Done;
        done = if finished { done + 1 } else { 0 };
        if f64::from(done) * EPOCH as f64 * 1e-6 >= mission.rest_s {
            end = End::Finished;
            claimed = Some(lead.fused.robot.half_axes_95().map(f64::from));
            break;
        }
    }
    let [x, y, phi] = simulation.plant().midpoint();
    let goal = mission.goal;
    let mut outcome = Outcome {
        at_s: at as f64 * 1e-6,
        seed: case.seed,
        end,
        first: simulation.monitor().first_fault().copied(),
        stop_s: stopped_at.map(|since| since.saturating_sub(at) as f64 * 1e-6),
        error_m: (x - goal[0]).hypot(y - goal[1]),
        heading_rad: libm::remainder(phi - goal[2], std::f64::consts::TAU).abs(),
        claimed,
        speed_m_s: extremes.most[0],
        steering_rad: extremes.most[1],
        force_n: extremes.most[2],
        torque_nm: simulation.torque(),
        end_speed_m_s: simulation.speed(),
        nodes: simulation.monitor().changes().to_vec(),
    };
    outcome.end = judged(case.entry, &outcome);
    Ok(outcome)
}

/// The end in the light of what the fault allows.
fn judged(entry: &Entry, outcome: &Outcome) -> End {
    match outcome.end {
        End::Finished => {
            let claimed = outcome.claimed.unwrap_or_default();
            let [position, heading] = [0, 1].map(|i| TOLERANCE[i].max(claimed[i]));
            let near = outcome.error_m <= position && outcome.heading_rad <= heading;
            match near && entry.finish {
                true => End::Finished,
                false => End::Missed,
            }
        }
        End::Stopped => {
            let fits = outcome
                .code()
                .is_some_and(|code| entry.codes.contains(&code));
            let in_time = outcome.stop_s.is_some_and(|s| s <= entry.stop_within_s);
            match fits && in_time && entry.fault != Fault::None {
                true => End::Stopped,
                false => End::WrongStop,
            }
        }
        other => other,
    }
}
