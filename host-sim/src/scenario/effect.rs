//! Keys of a scenario that have no effect in a run.
//!
//! Such a key is refused with the reason where it is given for one run (`--set`, `[[vary]]`, `--with`) and in a world
//! file. A scenario file may serve several commands, so its keys without effect are reported once on standard error.
//!
//! A rule names keys, a condition and the reason. A key without a rule has an effect, possibly only beyond a limit.

use crate::base::error::Error;
use crate::base::toml_file;
use crate::scenario::Scenario;
use crate::world::effect::{Rules, in_world, keys, listed, rules, within};
use core_algos::beam::sensor::Method;
use core_algos::control::regulator::Strategy;
use core_algos::fusion::robot::Mode;
use std::io::{self, Write};

/// Use of a scenario: the task of the run, or the model that replaces the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Use {
    /// Regulation to a posture.
    Regulate,
    /// Path following or trajectory tracking.
    Path,
    /// Regulation on virtual boards, which simulate the circuits.
    Virtual,
    /// Path following or trajectory tracking on virtual boards.
    VirtualPath,
    /// Calibration of wheels, gauges or gyros.
    Calibrate,
    /// Estimates recomputed from a log.
    Replay,
}

/// Rules whose condition depends on the scenario and its use.
const SCENARIO: Rules<fn(&Scenario, Use) -> bool> = rules! {
    "robot.beam.calibration.strain_per_count robot.beam.calibration.zero_counts \
     robot.beam.calibration.full_scale_counts":
        |_, used| used != Use::Replay =>
            "in a simulation: sensors.bridge decides; on a board it is a parameter";
    "mission.start mission.goal mission.time_limit_s mission.rest_s":
        |_, used| used == Use::Calibrate => "in a calibration";
    "robot.lead.regulator robot.lead.course robot.lead.governor robot.lead.cascade \
     robot.lead.stop robot.lead.supervisor robot.lead.hold_s robot.axle.stop \
     robot.axle.supervisor robot.axle.limits":
        |_, used| used == Use::Replay => "in a replay, which recomputes estimates";
    "board.place": |_, _| true => "in a simulation: each board has the place of its name";
    "robot.axle.filter.fix_gate": |_, _| true => "without position fixes, which no node sends";
    "robot.lead.regulator.approach.heading_gain_rad_s":
        |_, _| true => "in the approach, which uses arrival_gain instead";
    "robot.axle.supervisor.degraded_time_s robot.axle.supervisor.degraded_distance_m":
        |_, _| true => "in an axle node, which is never degraded; vary robot.lead.supervisor";
    "robot.lead.regulator.law.arrival_gain robot.lead.regulator.law.softening_m \
     robot.lead.course.law.arrival_gain robot.lead.course.law.softening_m":
        |_, _| true => "in the paper's form of the law; vary robot.lead.regulator.approach";
    "sensors.gyro.bias_sigma":
        |scenario, _| scenario.world.sensors.gyro.rest_average_s > 0.0 =>
            "with sensors.gyro.rest_average_s above 0: the mean at rest removes the bias";
    "sensors.accelerometer.bias_sigma":
        |scenario, _| scenario.world.sensors.accelerometer.rest_average_s > 0.0 =>
            "with sensors.accelerometer.rest_average_s above 0: the mean at rest removes the bias";
    "robot.lead.fusion.mode robot.lead.fusion.beam_gate robot.lead.fusion.gate_patience \
     robot.beam sensors.bridge plant.sensing_mass_kg":
        |scenario, _| !scenario.mission.rps => "with mission.rps = false";
    "robot.lead.fusion.intersection":
        |scenario, _| !matches!(scenario.fusion(), Mode::Intersection | Mode::IntersectionIpec) =>
            "unless robot.lead.fusion.mode is \"intersection\" or \"intersection-ipec\"";
    "robot.lead.fusion.ground":
        |scenario, _| scenario.fusion() != Mode::Joint =>
            "unless robot.lead.fusion.mode is \"joint\"";
    "robot.lead.fusion.ipec":
        |scenario, _| scenario.fusion() != Mode::IntersectionIpec =>
            "unless robot.lead.fusion.mode = \"intersection-ipec\"";
    "robot.lead.fusion.slip.load_speed_m_s":
        |scenario, _| scenario.fusion() != Mode::Odometry =>
            "unless robot.lead.fusion.mode = \"odometry\" or mission.rps = false";
    "sensors.gyro.bias_sigma sensors.gyro.rest_average_s sensors.gyro.rest_age_s \
     sensors.gyro.bias_walk sensors.gyro.noise_density sensors.gyro.scale_sigma \
     sensors.gyro.range sensors.gyro.bits sensors.gyro.delay_ms robot.axle.gyro_zero \
     robot.axle.filter.gyro_sigma_rad_s robot.lead.fusion.joint.gyro_bias_sigma_rad_s \
     robot.lead.fusion.joint.gyro_bias_walk_rad_s_per_sqrt_s \
     robot.lead.fusion.joint.gyro_scale_sigma inertial.gyro_gain":
        |scenario, _| !scenario.world.sensors.gyro.fitted => "with sensors.gyro.fitted = false";
    "sensors.accelerometer.bias_sigma sensors.accelerometer.rest_average_s \
     sensors.accelerometer.rest_age_s sensors.accelerometer.bias_walk \
     sensors.accelerometer.noise_density sensors.accelerometer.scale_sigma \
     sensors.accelerometer.range sensors.accelerometer.bits sensors.accelerometer.delay_ms \
     robot.axle.accelerometer_zero robot.axle.filter.accelerometer_sigma_m_s2 \
     inertial.accelerometer_gain":
        |scenario, _| !scenario.world.sensors.accelerometer.fitted =>
            "with sensors.accelerometer.fitted = false";
    "robot.lead.regulator.law robot.lead.regulator.stop_margin_m \
     robot.lead.regulator.stop_speed_m_s":
        |scenario, _| scenario.robot.lead.regulator.strategy == Strategy::Funnel =>
            "with robot.lead.regulator.strategy = \"funnel\"; vary robot.lead.regulator.approach";
    "robot.lead.regulator.approach robot.lead.regulator.planner \
     robot.lead.regulator.planner_budget":
        |scenario, _| scenario.robot.lead.regulator.strategy == Strategy::PaperLaw =>
            "with robot.lead.regulator.strategy = \"paper-law\"; vary robot.lead.regulator.law";
    "robot.lead.regulator":
        |_, used| matches!(used, Use::Path | Use::VirtualPath) => "along a path; vary robot.lead.course";
    "mission.tolerance_m mission.tolerance_rad":
        |_, used| matches!(used, Use::Calibrate | Use::Replay) => "without a goal";
    "bus":
        |_, used| matches!(used, Use::Virtual | Use::VirtualPath) =>
            "on virtual boards, whose bus has its own times and losses";
    "robot.lead.course":
        |_, used| matches!(used, Use::Regulate | Use::Virtual) =>
            "without a path; vary robot.lead.regulator";
    "robot.lead.train":
        |scenario, used| scenario.robot.topology().frame_count() == 1 || used == Use::Replay =>
            "with two axles, nor in a replay; vary robot.lead.regulator or robot.lead.governor";
    "robot.lead.regulator.strategy robot.lead.regulator.law robot.lead.regulator.approach \
     robot.lead.regulator.planner robot.lead.regulator.planner_budget \
     robot.lead.regulator.steering_tolerance_rad robot.lead.regulator.steering_timeout_s \
     robot.lead.regulator.steering_wait_rad robot.lead.regulator.path_length_constant_m \
     robot.lead.regulator.rest_speed_m_s robot.lead.regulator.steer_speed_m_s \
     robot.lead.regulator.latch_distance_m robot.lead.regulator.leave_factor \
     robot.lead.regulator.leave_slack_rad robot.lead.regulator.final_arc_m \
     robot.lead.regulator.final_length_constant_m robot.lead.regulator.stop_margin_m \
     robot.lead.regulator.stop_speed_m_s robot.lead.cascade robot.lead.course.law \
     robot.lead.course.rest_speed_m_s robot.lead.governor.max_steering_acceleration_rad_s2 \
     robot.lead.governor.steering_frequency_rad_s robot.lead.governor.steering_tolerance_rad":
        |scenario, _| scenario.robot.topology().frame_count() > 1 =>
            "with more than two axles; vary robot.lead.train";
    "robot.beam.segments":
        |scenario, _| scenario.robot.beam.method != Method::Piecewise =>
            "unless robot.beam.method = \"piecewise\"";
};

/// Keys that the user has set on the command line and in the scenario file.
#[derive(Clone, Debug, Default)]
pub struct GivenKeys {
    /// Keys set by `--set`.
    set: Vec<String>,
    /// Keys of the scenario file.
    file: Vec<String>,
}

/// Scenario of a run and its use.
pub type Run<'a> = (&'a Scenario, Use);

impl GivenKeys {
    /// Keys of `--set` and of a scenario file that has been read without error.
    pub fn new(changes: &[String], file: &str) -> Result<Self, Error> {
        Ok(Self {
            set: keys(&toml_file::changes(changes)?),
            file: keys(&toml::from_str(file).unwrap_or_default()),
        })
    }

    /// Refuses a key of `--set` that has no effect in any of the runs, and reports such keys of the scenario file on
    /// standard error.
    pub fn check(&self, taken: Taken, runs: &[Run]) -> Result<(), Error> {
        if let Some(text) = self.set.iter().find_map(|key| text(key, taken, runs)) {
            return Err(Error::input(format!("--set {text}")));
        }
        let idle: Vec<String> = self
            .file
            .iter()
            .filter_map(|key| text(key, taken, runs))
            .collect();
        if !idle.is_empty() {
            // Known keys have no control characters, so the text may be printed as given.
            let _ = writeln!(
                io::stderr(),
                "cfmmr: scenario file: {}",
                idle.join("\ncfmmr: scenario file: ")
            );
        }
        Ok(())
    }

    /// Refuses a key of `--set` that is none of `keys` (keys or tables, separated by spaces); the error states `reason`.
    pub fn check_only(&self, keys: &str, reason: &str) -> Result<(), Error> {
        match self.set.iter().find(|key| !listed(key, keys)) {
            Some(key) => Err(Error::input(format!("--set {key}: no effect {reason}"))),
            None => Ok(()),
        }
    }
}

/// Keys that the command itself sets, each with the reason.
pub type Taken<'a> = &'a [(&'a str, &'a str)];

/// Key and reason if the key has no effect in any of the runs; `None` if it has an effect in a run.
pub fn text(key: &str, taken: Taken, runs: &[Run]) -> Option<String> {
    let taken = taken.iter().find(|(other, _)| within(key, other));
    let reason = taken.map(|(_, reason)| *reason).or_else(|| {
        let mut reasons = runs
            .iter()
            .map(|(scenario, used)| reason(key, scenario, *used));
        let first = reasons.next()??;
        reasons.all(|reason| reason.is_some()).then_some(first)
    })?;
    Some(format!("{key}: no effect {reason}"))
}

/// Refuses a file for one run if one of its keys has no effect in the run.
pub fn check_file(text: &str, file: &str, run: Run) -> Result<(), Error> {
    let keys = keys(&toml::from_str(text).unwrap_or_default());
    match keys.iter().find_map(|key| self::text(key, &[], &[run])) {
        Some(text) => Err(Error::input(format!("{file}: {text}"))),
        None => Ok(()),
    }
}

/// Reason that a key has no effect in a run; `None` if the key has an effect.
fn reason(key: &str, scenario: &Scenario, used: Use) -> Option<&'static str> {
    let find = |key: &str| {
        let mut rules = SCENARIO.iter().filter(|(keys, ..)| listed(key, keys));
        let found = rules.find(|(_, idle, _)| idle(scenario, used));
        found
            .map(|(.., reason)| *reason)
            .or_else(|| in_world(key, &scenario.world))
    };
    match key
        .strip_prefix("boards.")
        .and_then(|rest| rest.split_once('.'))
    {
        // The calibration of a beam board in `boards` replaces the calibration from the bridges.
        Some((board, parameter))
            if is_beam(board)
                && within(parameter, "robot.beam.calibration")
                && scenario.mission.rps =>
        {
            None
        }
        // The mode in `boards.front` replaces the mode of a robot without the relative position sensor.
        Some(("front", "robot.lead.fusion.mode")) => None,
        Some((board, parameter)) => {
            on_other_board(board, parameter, used).or_else(|| find(parameter))
        }
        None => find(key),
    }
}

/// Parameters of an axle node, which the beam board does not use.
const AXLE: &str = "drive inertial robot.axle robot.limits robot.geometry.wheel_radius_m \
    robot.geometry.wheel_ratio robot.geometry.half_track_m \
    robot.geometry.encoder_counts_per_revolution";
/// Errors common to all gauges, which are no part of the noise that the beam board reports.
const SHARED_BY_GAUGES: &str = "robot.beam.strip.uncertainty.common_offset_strain \
    robot.beam.strip.uncertainty.common_gain";
/// Parameters of the strip and of steering, which the boards of the axles behind the first do not use.
const STEERING: &str = "robot.geometry.half_thickness_m robot.geometry.rigid_end_m \
    robot.limits.max_steering_rad robot.limits.steering_margin_rad";

/// True for the name of a frame's board.
fn is_beam(board: &str) -> bool {
    board.starts_with("beam")
}

/// Reason that a parameter has no effect on a board; `None` if there is no such reason.
fn on_other_board(board: &str, parameter: &str, used: Use) -> Option<&'static str> {
    let of = |keys: &str| listed(parameter, keys);
    let (beam, front) = (is_beam(board), board == "front");
    match () {
        () if of("button") => Some("in a simulation: mission.start and mission.goal set it"),
        () if !matches!(used, Use::Virtual | Use::VirtualPath) && of("drive") => {
            Some("in a simulation: it describes the circuit of a board")
        }
        () if !front && of("robot.lead") => {
            Some("on this board: the lead node runs on the front board")
        }
        () if beam && of(SHARED_BY_GAUGES) => {
            Some("on this board: the fusion on the front board uses it")
        }
        () if beam && of(AXLE) => Some("on this board: it has no axle node"),
        () if !beam && of("robot.beam.calibration") || !front && !beam && of("robot.beam") => {
            Some("on this board: it has no beam node")
        }
        () if !front && !beam && of(STEERING) => Some("on this board: the front board steers"),
        () => None,
    }
}
