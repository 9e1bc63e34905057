//! Regulation to a posture, and its outcome.

use crate::base::error::Error;
use crate::base::statistics::nees;
use crate::base::statistics::square;
use crate::run::drive::{DriveTask, Progress, drive};
use crate::run::end::{Ended, RunEnd};
use crate::run::robot::{Record, Robot};
use crate::run::simulation::Simulation;
use crate::scenario::Scenario;
use core_algos::bus::LeadMode;
use core_algos::control::regulator::Phase;
use core_algos::fusion::ekf::Verdict;
use core_algos::node::lead::Task;
use core_algos::node::robot::Geometry;
use core_algos::time::{EPOCH, Micros};
use std::f64::consts::{PI, TAU};

/// Final errors and statistics of a trial of regulation.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    /// True posture of the midpoint at the end: m, m, rad.
    pub midpoint: [f64; 3],
    /// End of the task.
    pub end: RunEnd,
    /// Normalised estimation error squared (NEES) at the end; 3 on average if the covariance is consistent.
    pub nees: f64,
    /// Share of the epochs in which the estimate used a beam posture.
    pub beam_share: f64,
    /// True if the true posture is within the tolerance of the goal.
    pub within: bool,
    /// Root mean square of the magnitude of the force over the task and over the frames, N.
    pub force_rms_n: f64,
    /// Largest true curvature from the bend of the frame over the task, at rest too, 1/m: paper eq. 5 of half
    /// the angle between the axles.
    pub max_curvature: f64,
    /// Largest true curvature of the midpoint's path, turn per distance, at speeds above
    /// [`PATH_CURVATURE_SPEED_M_S`], 1/m.
    pub max_path_curvature: f64,
    /// Largest curvature the governor commanded over the task, 1/m.
    pub max_commanded_curvature: f64,
    /// Length of the midpoint's path, m.
    pub path_m: f64,
    /// Number of changes of direction while driving.
    pub cusps: u32,
    /// Number of planning phases of the regulator.
    pub plans: u32,
    /// Error of the estimated relative posture of the axles at the end, of the frame with the largest error in position:
    /// m, m, rad.
    pub relative_error: [f64; 3],
}

impl Ended for Outcome {
    fn end(&self) -> RunEnd {
        self.end.clone()
    }
}

/// Speed below which the curvature of the driven path is not evaluated, m/s.
pub const PATH_CURVATURE_SPEED_M_S: f64 = 0.05;

/// Sums, counts and maxima over the epochs of a regulation.
#[derive(Clone, Copy, Debug)]
struct Drive {
    last: [f64; 3],
    phase: Phase,
    direction: f64,
    steering: f64,
    commanded_steering: f64,
    path_curvature: f64,
    path_m: f64,
    cusps: u32,
    plans: u32,
    epochs: u32,
    beam_used: u32,
}

impl Drive {
    fn new(robot: &impl Robot) -> Self {
        Self {
            last: robot.record().midpoint,
            phase: Phase::Stop,
            direction: 0.0,
            steering: 0.0,
            commanded_steering: 0.0,
            path_curvature: 0.0,
            path_m: 0.0,
            cusps: 0,
            plans: 0,
            epochs: 0,
            beam_used: 0,
        }
    }

    /// Adds the record of an epoch to the statistics.
    fn observe(&mut self, record: &Record) {
        const EPOCH_S: f64 = EPOCH as f64 * 1e-6;
        let [x, y, phi] = self.last;
        let (dx, dy) = (record.midpoint[0] - x, record.midpoint[1] - y);
        let ahead = dx * libm::cos(phi) + dy * libm::sin(phi);
        let turned = (record.midpoint[2] - phi + PI).rem_euclid(TAU) - PI;
        self.path_m += libm::hypot(dx, dy);
        if ahead.abs() > PATH_CURVATURE_SPEED_M_S * EPOCH_S {
            self.path_curvature = self.path_curvature.max((turned / ahead).abs());
        }
        // Slower motion may be vibration at rest.
        if ahead.abs() > 0.01 * EPOCH_S {
            self.cusps += u32::from(ahead * self.direction < 0.0);
            self.direction = ahead.signum();
        }
        self.last = record.midpoint;
        let lead = &record.lead;
        self.epochs += 1;
        self.beam_used += u32::from(lead.fused.beam.verdict == Verdict::Used);
        self.commanded_steering = self
            .commanded_steering
            .max(f64::from(lead.motion.psi.0).abs());
        let plans = lead.phase == Phase::Plan && self.phase != Phase::Plan;
        self.plans += u32::from(plans);
        self.phase = lead.phase;
    }
}

/// Regulates to the scenario's goal; `observe` is called once an epoch.
pub fn regulate(
    scenario: &Scenario,
    seed: u64,
    trial: u64,
    observe: impl FnMut(&Record),
) -> Result<Outcome, Error> {
    regulate_on(
        &mut Simulation::new(scenario, seed, trial)?,
        scenario,
        observe,
    )
}

/// Regulation in progress.
struct Regulation<F> {
    task: Task,
    observe: F,
    drive: Drive,
    /// Sum of the squares of the frame's force, N², and number of ticks.
    force_square: f64,
    ticks: u64,
}

impl<R: Robot, F: FnMut(&Record)> DriveTask<R> for Regulation<F> {
    fn task(&self) -> Option<Task> {
        Some(self.task)
    }

    fn tick(&mut self, robot: &R) -> Progress {
        self.force_square += robot.plant().map_or(f64::NAN, |plant| {
            let of = |frame| {
                let [x, y] = plant.wrench(frame).force;
                square(x) + square(y)
            };
            let frames = plant.frame_count();
            (0..frames).map(of).sum::<f64>() / frames as f64
        });
        self.ticks += 1;
        self.drive.steering = self.drive.steering.max(robot.steering().abs());
        Progress::Driving
    }

    fn epoch(&mut self, _robot: &R, record: &Record, _since: Option<Micros>) -> Progress {
        self.drive.observe(record);
        (self.observe)(record);
        let lead = &record.lead;
        match lead.phase {
            Phase::Done if lead.done && lead.mode == LeadMode::Hold => Progress::Done,
            _ => Progress::Driving,
        }
    }
}

/// As [`regulate`], with the given robot of the scenario.
pub fn regulate_on(
    robot: &mut impl Robot,
    scenario: &Scenario,
    observe: impl FnMut(&Record),
) -> Result<Outcome, Error> {
    let mut regulation = Regulation {
        task: scenario.mission.regulate(scenario.mission.goal),
        observe,
        drive: Drive::new(robot),
        force_square: 0.0,
        ticks: 0,
    };
    let end = drive(
        robot,
        scenario,
        scenario.mission.time_limit_s,
        &mut regulation,
    )?;
    let record = robot.record();
    let fused = &record.lead.fused;
    let distance = |error: &[f64; 3]| libm::hypot(error[0], error[1]);
    let errors = record.relative_errors();
    let relative_error = errors.max_by(|a, b| distance(a).total_cmp(&distance(b)));
    let geometry = &scenario.robot.completed().geometry;
    let curvature = |steering| curvature(geometry, steering);
    let drive = regulation.drive;
    let mission = &scenario.mission;
    Ok(Outcome {
        midpoint: record.midpoint,
        end,
        nees: nees(&fused.robot, record.midpoint),
        beam_share: f64::from(drive.beam_used) / f64::from(drive.epochs.max(1)),
        within: mission.is_near(record.midpoint, mission.goal),
        force_rms_n: (regulation.force_square / regulation.ticks.max(1) as f64).sqrt(),
        max_curvature: curvature(drive.steering),
        max_path_curvature: drive.path_curvature,
        max_commanded_curvature: curvature(drive.commanded_steering),
        path_m: drive.path_m,
        cusps: drive.cusps,
        plans: drive.plans,
        relative_error: relative_error.unwrap_or([f64::NAN; 3]),
    })
}

/// Curvature (1/m) of the midpoint's path at a steering angle ψ (rad): 2 tan ψ divided by the distance of the
/// axles, which is paper eq. 5 without rigid ends.
pub fn curvature(geometry: &Geometry, steering: f64) -> f64 {
    let (length, rigid) = (geometry.frame_length_m, geometry.rigid_end_m);
    let ratio = match steering.abs() < 1e-9 {
        true => 1.0,
        false => libm::sin(steering) / steering,
    };
    let chord = f64::from(length) * ratio + 2.0 * f64::from(rigid) * libm::cos(steering);
    2.0 * libm::tan(steering) / chord
}

#[cfg(test)]
mod tests;
