//! Faults of samples, frames and plant of a robot with boards in this process, and their runs.

use super::Campaign;
use super::bench::MOVING_M_S;
use super::entry::{Entry, entries};
use super::outcome::{End, FaultCase, Outcome, stop_violation};
use super::sensors::WHEELS;
use core_algos::bus::LeadMode;
use core_algos::control::regulator::Phase;
use core_algos::math::Posture;
use core_algos::node::lead::Task;
use core_algos::safety::Condition::{self, *};
use core_algos::time::{Micros, TICK};
use core_algos::topology::{Role, Side, Topology};
use host_sim::base::error::Error;
use host_sim::bus::virtual_bus::BusConfig;
use host_sim::run::drive::{DriveTask, Progress, drive};
use host_sim::run::robot::{Record, Robot as _};
use host_sim::run::simulation::Simulation;
use host_sim::scenario::Scenario;
use host_sim::world::faults::Fault::{
    AccelerometerMissing, Bus, EncoderJumps, EncoderMissing, EncoderStuck, EncodersSwapped,
    FrameSnapped, Freeze, GaugeDrift, GaugeRail, GaugeStuck, GyroBias, GyroNotANumber, Loss,
    MotorStuckOn, MotorWeak, Reported, Reset, SlowClock, WheelLifted,
};
use host_sim::world::faults::{Fault, Rail, Wheel};

/// Permitted reasons of a stop after lost or late messages, or after the loss of a board.
const SILENCE: &[Condition] = &[CommandTimeout, NeighbourLost, NeighbourFault];
/// Permitted reasons of a stop after messages with wrong contents or times.
const CORRUPTION: &[Condition] = &[
    CommandTimeout,
    NeighbourLost,
    NeighbourFault,
    EstimateInconsistent,
    TrackingLost,
    WrenchHigh,
    FrameBent,
    WheelSlip,
    // A stop starts from the last reference; if that reference is wrong, the motors are cut.
    StopNotFollowed,
];
/// Permitted reasons of a stop after a fault of a gauge.
const GAUGES: &[Condition] = &[EstimateInconsistent, WrenchHigh, FrameBent, DegradedTooLong];
/// Permitted reasons of a stop after the frame has snapped.
const SNAPPED: &[Condition] = &[EstimateInconsistent, FrameBent, WrenchHigh, TrackingLost];
/// Time for which a frame of a chain may stay straight before it shows that it has snapped, s.
const STRAIGHT_S: f64 = 4.0;
/// Limit of the time from the loss of the beam to the stop, s.
const BEAM_S: f64 = 22.0;
/// Limit of the time to the stop if only the estimate reveals the fault, s.
const SLOW_S: f64 = 20.0;

/// Limits that a controlled robot exceeds for at most 0.3 s: speed of an axle's midpoint (m/s; the governor allows
/// half of it), steering angle |ψ| (rad), force of the frame (N).
pub const BOUNDS: [f64; 3] = [0.5, 0.8, 40.0];
/// Limit of the time beyond [`BOUNDS`], ticks.
const MAX_BEYOND_TICKS: u32 = 300;
/// Limits of the goal error of a finished task: position (m) and heading (rad).
pub const TOLERANCE: [f64; 2] = [0.03, 0.052_36];
/// Speed below which the robot counts as at rest, m/s.
const REST_M_S: f64 = 0.02;
/// Speed above which a stopped robot counts as driven again, m/s.
const SWING_M_S: f64 = 0.1;
/// Time at rest with motors off that counts as stopped, ticks.
const REST_TICKS: u32 = 100;
/// Time for which a stopped robot is observed, µs.
const STOP_OBSERVATION_US: Micros = 1_000_000;

pub(super) fn entries() -> Vec<Entry> {
    [frames(), samples(), plant()].concat()
}

fn frames() -> Vec<Entry> {
    entries! {
        "none, boards in process", "", model(Fault::None).goes_on();
        "bus loses 1 %", "frames", model(Bus(BusConfig { loss: 0.01, ..BusConfig::default() })).goes_on();
        "bus loses 10 %", "frames", model(Bus(BusConfig { loss: 0.1, ..BusConfig::default() })).goes_on().stops(SILENCE).within(60.0);
        "bus loses 50 %", "frames", model(Bus(BusConfig { loss: 0.5, ..BusConfig::default() })).goes_on().stops(SILENCE).within(SLOW_S);
        "bus late by 20 ms", "frames", model(Bus(BusConfig { late_ms: vec![20], ..BusConfig::default() })).goes_on().stops(SILENCE);
        "bus reorders within 8 ms", "frames", model(Bus(BusConfig { jitter_ms: 8, ..BusConfig::default() })).goes_on().stops(SILENCE);
        "bus doubles 30 %", "frames", model(Bus(BusConfig { doubling: 0.3, ..BusConfig::default() })).goes_on();
        "bus corrupts 5 %", "frames", model(Bus(BusConfig { corruption: 0.05, ..BusConfig::default() })).goes_on().stops(CORRUPTION)
            .within(SLOW_S);
        "front board resets", "boards", model(Reset { board: Role::LEAD, off_ms: 200 }).stops(SILENCE).within(1.5);
        "front board lost", "boards", model(Loss(Role::LEAD)).stops(SILENCE).within(1.5);
        "{axle} board lost", "boards", model(Loss(Role::axle(1))).stops(SILENCE).within(1.5);
        "{frame} board lost", "boards", model(Loss(Role::beam(0))).goes_on().stops(&[DegradedTooLong]).within(BEAM_S);
        "front board freezes 0.3 s", "boards", model(Freeze { board: Role::LEAD, ms: 300 }).stops(SILENCE).within(1.8);
        "{axle} clock slow by 0.02 %, no common time", "boards", model(SlowClock { board: Role::axle(1), period: 5000 }).goes_on()
            .stops(CORRUPTION).within(SLOW_S);
        "{axle} clock slow by 0.2 %, no common time", "boards", model(SlowClock { board: Role::axle(1), period: 500 }).goes_on()
            .stops(CORRUPTION).within(SLOW_S);
    }
}

const fn wheel(axle: usize, side: Side) -> Wheel {
    Wheel { axle, side }
}

fn samples() -> Vec<Entry> {
    entries! {
        "gauge dead", "samples", model(GaugeRail { count: 1, rail: Rail::Zero }).goes_on();
        "all gauges dead", "samples", model(GaugeRail { count: 5, rail: Rail::Zero }).goes_on().stops(&[DegradedTooLong]).within(BEAM_S);
        "gauge stuck", "samples", model(GaugeStuck(2)).goes_on().stops(GAUGES).within(BEAM_S);
        "gauge drifts", "samples", model(GaugeDrift { gauge: 2, counts_per_s: 40.0 }).goes_on().stops(GAUGES).within(BEAM_S);
        "encoder stuck", "samples", model(EncoderStuck(wheel(1, Side::Left))).stops(WHEELS);
        "encoder jumps", "samples", model(EncoderJumps { wheel: wheel(0, Side::Left), counts: 500 }).goes_on().stops(WHEELS);
        "encoders swapped", "samples", model(EncodersSwapped(1)).goes_on().stops(WHEELS).within(SLOW_S);
        "encoder missing", "samples", model(EncoderMissing(wheel(0, Side::Right))).stops(WHEELS).within(1.5);
        "gyro not a number", "samples", model(GyroNotANumber(0)).goes_on().stops(&[NotANumber]).within(1.5);
        "gyro off by 0.3 rad/s", "samples", model(GyroBias { axle: 1, bias_rad_s: 0.3 }).goes_on().stops(WHEELS).within(10.0);
        "accelerometer missing", "samples", model(AccelerometerMissing(0)).goes_on();
        "driver too hot", "samples", model(Reported { axle: 0, condition: OverTemperature, ms: 0 }).stops(&[OverTemperature, NeighbourFault]);
    }
}

fn plant() -> Vec<Entry> {
    entries! {
        "motor without torque", "plant", model(MotorWeak { wheel: wheel(0, Side::Left), share: 0.0 }).goes_on().stops(WHEELS).within(SLOW_S);
        "motor weak", "plant", model(MotorWeak { wheel: wheel(1, Side::Right), share: 0.3 }).goes_on().stops(WHEELS).within(SLOW_S);
        "motor stuck on", "plant", model(MotorStuckOn { wheel: wheel(0, Side::Right), torque_n_m: 1.5 }).stops(WHEELS).within(3.5);
        "wheel lifted", "plant", model(WheelLifted(wheel(1, Side::Left))).goes_on().stops(WHEELS).within(SLOW_S);
        "frame snapped", "plant", model(FrameSnapped).stops(SNAPPED).within(3.0)
            .longer_in_chain(STRAIGHT_S);
    }
}

/// First tick of the fault of a robot of two axles.
pub fn tick(scenario: &Scenario, case: &FaultCase) -> u32 {
    (scenario.mission.settle_s * 1e3) as u32 + case.after_ms as u32
}

/// Runs the robot to the scenario's goal with a fault.
pub(super) fn run(campaign: &Campaign, case: &FaultCase, fault: Fault) -> Result<Outcome, Error> {
    let mut simulation = Simulation::new(&campaign.scenario, case.seed, 0)?;
    run_on(&mut simulation, &campaign.scenario, case, fault)
}

/// Observer that checks each tick of a run with a fault.
struct FaultObserver {
    goal: Posture,
    /// Fault that begins this number of ticks after the first motion; `None` once its time is known.
    waiting: Option<(Fault, u32)>,
    /// Time of the fault, µs; the largest number until it is known.
    from: Micros,
    /// Consecutive ticks beyond each bound.
    beyond: [u32; 3],
    /// Consecutive ticks at rest with motors off.
    rest: u32,
    /// Time of the stop, µs; `None` while the robot moves.
    stopped: Option<Micros>,
    /// Description of the failure; `None` without one.
    violation: Option<String>,
}

impl FaultObserver {
    /// Injects the fault at a tick.
    fn begin(&mut self, simulation: &mut Simulation, fault: Fault, tick: u32) {
        simulation.inject(fault, tick);
        self.from = Micros::from(tick) * TICK;
    }

    /// Description of a bound exceeded for longer than [`MAX_BEYOND_TICKS`]; `None` if no bound was.
    fn exceeded(&mut self, simulation: &Simulation) -> Option<String> {
        let plant = simulation.plant();
        let mut forces = (0..plant.frame_count()).map(|frame| {
            let [x, y] = plant.wrench(frame).force;
            libm::hypot(x, y)
        });
        // Also a force that is not a number.
        let high = forces.find(|force| !(*force <= BOUNDS[2]));
        let values = [
            simulation.speed(),
            simulation.steering().abs(),
            high.unwrap_or(0.0),
        ];
        let mut exceeded = None;
        for (i, beyond) in self.beyond.iter_mut().enumerate() {
            // The comparison is false for NaN, so NaN is beyond every bound.
            let within = values[i] <= BOUNDS[i];
            *beyond = if within { 0 } else { *beyond + 1 };
            if *beyond > MAX_BEYOND_TICKS {
                let what = ["speed", "steering", "force"][i];
                exceeded = Some(format!(
                    "{what} {:.2}: must be at most {}",
                    values[i], BOUNDS[i]
                ));
            }
        }
        exceeded
    }
}

impl DriveTask<Simulation> for FaultObserver {
    fn task(&self) -> Option<Task> {
        Some(Task::regulate(self.goal))
    }

    fn feed(&mut self, simulation: &mut Simulation) -> Result<(), Error> {
        if simulation.speed() > MOVING_M_S
            && let Some((fault, after)) = self.waiting.take()
        {
            self.begin(simulation, fault, (simulation.now() / TICK) as u32 + after);
        }
        Ok(())
    }

    fn must_end(&self, _robot: &Simulation) -> bool {
        false
    }

    fn tick(&mut self, simulation: &Simulation) -> Progress {
        let now = simulation.now() - TICK;
        if now < self.from {
            return Progress::Driving;
        }
        self.violation = self.exceeded(simulation);
        let (speed, off) = (
            simulation.speed(),
            simulation.torque().iter().all(|torque| *torque == [0.0; 2]),
        );
        self.rest = (self.rest + 1) * u32::from(off && speed < REST_M_S);
        let faulted = simulation.monitor().first_fault().is_some();
        match self.stopped {
            // The frame may swing a little after the motors switch off.
            Some(_) if !off || !(speed < SWING_M_S) => {
                self.violation = Some("drives again after its stop".to_owned());
            }
            Some(since) if now - since >= STOP_OBSERVATION_US => return Progress::Over,
            None if faulted && self.rest >= REST_TICKS => {
                self.stopped = Some(now - Micros::from(self.rest) * TICK);
            }
            _ => {}
        }
        match self.violation {
            Some(_) => Progress::Over,
            None => Progress::Driving,
        }
    }

    fn epoch(&mut self, _robot: &Simulation, record: &Record, _since: Option<Micros>) -> Progress {
        let lead = &record.lead;
        match lead.done && lead.mode == LeadMode::Hold && lead.phase == Phase::Done {
            true => Progress::Done,
            false => Progress::Driving,
        }
    }
}

/// Runs a simulation with the fault of a case to its end. A robot of three or more axles plans before it drives: its
/// fault counts from the first motion.
pub fn run_on(
    simulation: &mut Simulation,
    scenario: &Scenario,
    case: &FaultCase,
    fault: Fault,
) -> Result<Outcome, Error> {
    let mission = &scenario.mission;
    let mut observer = FaultObserver {
        goal: Posture::from(mission.goal.map(|v| v as f32)),
        waiting: None,
        from: Micros::MAX,
        beyond: [0; 3],
        rest: 0,
        stopped: None,
        violation: None,
    };
    match scenario.robot.topology() {
        Topology::PAIR => observer.begin(simulation, fault, tick(scenario, case)),
        _ => observer.waiting = Some((fault, case.after_ms as u32)),
    }
    let done = drive(simulation, scenario, mission.time_limit_s, &mut observer)?.is_success();
    let first = simulation.monitor().first_fault().copied();
    let reason = first.and_then(|status| status.reason);
    let since = |at: Micros| at.saturating_sub(observer.from) as f64 * 1e-6;
    let off_s = observer.stopped.map(since);
    let violation = observer.violation.or_else(|| match off_s {
        Some(off_s) => stop_violation(case.entry, reason, off_s, None),
        None if done => goal_missed(simulation, scenario, case.entry),
        None => Some("the task is neither done nor stopped".to_owned()),
    });
    let end = if done { End::WentOn } else { End::Stopped };
    Ok(Outcome {
        seed: case.seed,
        after_ms: case.after_ms,
        end: violation.map_or(end, End::Wrong),
        reason,
        off_s,
        own_off_s: None,
        cases: 1,
    })
}

/// Description of the true goal error of a finished task; `None` if position and heading error are each within the
/// larger of [`TOLERANCE`] and the robot's 95 % error. Finishing is itself a failure if the entry does not permit the
/// robot to continue.
fn goal_missed(simulation: &Simulation, scenario: &Scenario, entry: &Entry) -> Option<String> {
    if !entry.goes_on {
        return Some("finished in spite of the fault".to_owned());
    }
    let [x, y, phi] = simulation.plant().midpoint();
    let goal = scenario.mission.goal;
    let turned = libm::remainder(phi - goal[2], std::f64::consts::TAU).abs();
    let away = libm::hypot(x - goal[0], y - goal[1]);
    let claimed = simulation.lead_output().fused.robot.half_axes_95();
    let [position, heading] = [0, 1].map(|i| TOLERANCE[i].max(f64::from(claimed[i])));
    let near = away <= position && turned <= heading;
    (!near).then(|| {
        format!(
            "goal error {:.1} cm and {:.1}° at the end",
            1e2 * away,
            turned.to_degrees()
        )
    })
}
