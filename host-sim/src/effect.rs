//! Keys of a scenario without effect in a configuration.
//!
//! Such a key is refused where it is given for one run (`--set`, `[[vary]]`, `--with`) and in a world file, with the
//! reason. A scenario file may serve several commands: there it is reported once on standard error.
//!
//! A rule names keys, a condition and the reason. A key without a rule has an effect, if only beyond a limit.

use crate::error::Error;
use crate::plant::Tyre;
use crate::scenario::Scenario;
use crate::scenario_file;
use crate::world::World;
use core_algos::beam::sensor::Method;
use core_algos::control::regulator::Strategy;
use core_algos::fusion::tandem::Mode;
use toml::{Table, Value};

/// Use of a scenario: the task of the run, or the model that replaces the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Use {
    /// Regulation to a posture.
    Regulate,
    /// Path following or trajectory tracking.
    Path,
    /// Regulation on virtual boards, which have circuits.
    Virtual,
    /// Regulation of the kinematic model.
    Kinematic,
    /// Calibration of wheels, gauges or gyros.
    Calibrate,
    /// Estimates recomputed from a log.
    Replay,
}

/// Keys or tables separated by spaces, the condition under which they have no effect, and the reason.
type Rules<Condition> = &'static [(&'static str, Condition, &'static str)];

/// Rules within a world.
const WORLD: Rules<fn(&World) -> bool> = &[
    (
        "plant.creep_velocity_m_s",
        |world| world.plant.tyre == Tyre::Brush,
        "with plant.tyre = \"brush\"; vary plant.slip_stiffness",
    ),
    (
        "plant.slip_stiffness plant.rest_creep_velocity_m_s spread.slip_stiffness",
        |world| world.plant.tyre == Tyre::Creep,
        "with plant.tyre = \"creep\"; vary plant.creep_velocity_m_s",
    ),
    (
        "plant.static_decay_m_s",
        |world| world.plant.static_excess == 0.0,
        "with plant.static_excess = 0",
    ),
    (
        "plant.load_transfer_time_s",
        |world| world.plant.center_of_mass_height_m == 0.0,
        "with plant.center_of_mass_height_m = 0",
    ),
    (
        "plant.rotor_inertia_share",
        |world| world.plant.backlash_rad == [[0.0; 2]; 2] && world.spread.backlash_rad == 0.0,
        "without backlash: plant.backlash_rad and spread.backlash_rad are 0",
    ),
    (
        "plant.cogging_periods plant.cogging_phase_rad",
        |world| world.plant.cogging_torque_n_m == 0.0,
        "with plant.cogging_torque_n_m = 0",
    ),
    (
        "plant.payload_position_m",
        |world| world.plant.payload_kg == [0.0; 2],
        "with plant.payload_kg = 0",
    ),
    (
        "sensors.bridge.warming_time_s sensors.bridge.zero_per_k_sigma_strain \
         sensors.bridge.gain_per_k",
        |world| world.sensors.bridge.warming_k == 0.0,
        "with sensors.bridge.warming_k = 0",
    ),
    (
        "sensors.bridge.creep_time_s",
        |world| world.sensors.bridge.creep_share == 0.0 && world.sensors.bridge.creep_sigma == 0.0,
        "with sensors.bridge.creep_share = 0 and creep_sigma = 0",
    ),
];

/// Rules within a scenario and its use.
const SCENARIO: Rules<fn(&Scenario, Use) -> bool> = &[
    (
        "robot.beam.calibration.strain_per_count robot.beam.calibration.zero_counts \
         robot.beam.calibration.full_scale_counts",
        |_, used| used != Use::Replay,
        "in a simulation: sensors.bridge decides; on a board it is a parameter",
    ),
    (
        "plant spread sensors bus boards robot.axle robot.beam robot.lead.fusion robot.lead.cascade \
         robot.lead.limits robot.lead.stop robot.lead.supervisor robot.lead.hold_s \
         robot.lead.report_timeout_s robot.lead.governor.stop_deceleration_m_s2 \
         robot.lead.governor.steering_tolerance_rad robot.lead.governor.reversal_hold_s \
         robot.lead.governor.max_wheel_speed_m_s robot.lead.governor.max_interval_s \
         robot.geometry.half_thickness_m robot.geometry.bending_stiffness_n_m2 \
         robot.geometry.half_track_m robot.geometry.wheel_radius_m robot.geometry.wheel_ratio \
         robot.geometry.encoder_counts_per_revolution mission.rps mission.settle_s \
         mission.time_limit_s mission.rest_s",
        |_, used| used == Use::Kinematic,
        "on the kinematic model",
    ),
    (
        "mission.start mission.goal mission.time_limit_s mission.rest_s",
        |_, used| used == Use::Calibrate,
        "in a calibration",
    ),
    (
        "robot.lead.regulator robot.lead.course robot.lead.governor robot.lead.cascade \
         robot.lead.stop robot.lead.supervisor robot.lead.hold_s robot.axle.stop \
         robot.axle.supervisor robot.axle.limits",
        |_, used| used == Use::Replay,
        "in a replay, which recomputes estimates",
    ),
    (
        "robot.axle.filter.fix_gate",
        |_, _| true,
        "without position fixes, which no node sends",
    ),
    (
        "robot.lead.regulator.approach.heading_gain_rad_s",
        |_, _| true,
        "in the approach, which has arrival_gain in its place",
    ),
    (
        "robot.axle.supervisor.degraded_time_s robot.axle.supervisor.degraded_distance_m",
        |_, _| true,
        "in an axle node, which nothing degrades; vary robot.lead.supervisor",
    ),
    (
        "robot.lead.regulator.law.arrival_gain robot.lead.regulator.law.softening_m \
         robot.lead.course.law.arrival_gain robot.lead.course.law.softening_m",
        |_, _| true,
        "in the paper's form of the law; vary robot.lead.regulator.approach",
    ),
    (
        "sensors.gyro.bias_sigma",
        |scenario, _| scenario.world.sensors.gyro.rest_average_s > 0.0,
        "with sensors.gyro.rest_average_s above 0: the mean at rest takes the bias away",
    ),
    (
        "sensors.accelerometer.bias_sigma",
        |scenario, _| scenario.world.sensors.accelerometer.rest_average_s > 0.0,
        "with sensors.accelerometer.rest_average_s above 0: the mean at rest takes the bias away",
    ),
    (
        "robot.lead.fusion.mode robot.lead.fusion.beam_gate robot.lead.fusion.gate_patience \
         robot.beam sensors.bridge plant.sensing_mass_kg",
        |scenario, _| !scenario.mission.rps,
        "with mission.rps = false",
    ),
    (
        "robot.lead.fusion.intersection",
        |scenario, _| !matches!(mode(scenario), Mode::Intersection | Mode::IntersectionIpec),
        "unless robot.lead.fusion.mode is \"intersection\" or \"intersection-ipec\"",
    ),
    (
        "robot.lead.fusion.ipec",
        |scenario, _| mode(scenario) != Mode::IntersectionIpec,
        "unless robot.lead.fusion.mode = \"intersection-ipec\"",
    ),
    (
        "robot.lead.fusion.slip.load_speed_m_s",
        |scenario, _| mode(scenario) != Mode::Odometry,
        "unless robot.lead.fusion.mode = \"odometry\" or mission.rps = false",
    ),
    (
        "sensors.gyro.bias_sigma sensors.gyro.rest_average_s sensors.gyro.rest_age_s \
         sensors.gyro.bias_walk sensors.gyro.noise_density sensors.gyro.scale_sigma \
         sensors.gyro.range sensors.gyro.bits sensors.gyro.delay_ms robot.axle.gyro_zero \
         robot.axle.filter.gyro_sigma_rad_s robot.lead.fusion.joint.gyro_bias_sigma_rad_s \
         robot.lead.fusion.joint.gyro_bias_walk_rad_s_per_sqrt_s \
         robot.lead.fusion.joint.gyro_scale_sigma inertial.gyro_gain",
        |scenario, _| !scenario.world.sensors.gyro.fitted,
        "with sensors.gyro.fitted = false",
    ),
    (
        "sensors.accelerometer.bias_sigma sensors.accelerometer.rest_average_s \
         sensors.accelerometer.rest_age_s sensors.accelerometer.bias_walk \
         sensors.accelerometer.noise_density sensors.accelerometer.scale_sigma \
         sensors.accelerometer.range sensors.accelerometer.bits sensors.accelerometer.delay_ms \
         robot.axle.accelerometer_zero robot.axle.filter.accelerometer_sigma_m_s2 \
         inertial.accelerometer_gain",
        |scenario, _| !scenario.world.sensors.accelerometer.fitted,
        "with sensors.accelerometer.fitted = false",
    ),
    (
        "robot.lead.regulator.law robot.lead.regulator.stop_margin_m \
         robot.lead.regulator.stop_speed_m_s",
        |scenario, _| scenario.robot.lead.regulator.strategy == Strategy::Funnel,
        "with robot.lead.regulator.strategy = \"funnel\"; vary robot.lead.regulator.approach",
    ),
    (
        "robot.lead.regulator.approach robot.lead.regulator.planner \
         robot.lead.regulator.planner_budget",
        |scenario, _| scenario.robot.lead.regulator.strategy == Strategy::PaperLaw,
        "with robot.lead.regulator.strategy = \"paper-law\"; vary robot.lead.regulator.law",
    ),
    (
        "robot.lead.regulator",
        |_, used| used == Use::Path,
        "along a path; vary robot.lead.course",
    ),
    (
        "robot.lead.course",
        |_, used| matches!(used, Use::Regulate | Use::Virtual | Use::Kinematic),
        "without a path; vary robot.lead.regulator",
    ),
    (
        "robot.beam.segments",
        |scenario, _| scenario.robot.beam.method != Method::Piecewise,
        "unless robot.beam.method = \"piecewise\"",
    ),
];

fn mode(scenario: &Scenario) -> Mode {
    match scenario.mission.rps {
        true => scenario.robot.lead.fusion.mode,
        false => Mode::Odometry,
    }
}

/// Keys that a user gave.
#[derive(Clone, Debug, Default)]
pub struct Given {
    /// Those of `--set`.
    set: Vec<String>,
    /// Those of the scenario file.
    file: Vec<String>,
}

/// A run: what it is made of, and the use of it.
pub type Run<'a> = (&'a Scenario, Use);

impl Given {
    /// The keys of `--set` and of a scenario file that has been read without error.
    pub fn new(changes: &[String], file: &str) -> Result<Self, Error> {
        let keys = |table: Table| {
            let mut keys = Vec::new();
            leaves("", &table, &mut keys);
            keys
        };
        Ok(Self {
            set: keys(scenario_file::changes(changes)?),
            file: keys(toml::from_str(file).unwrap_or_default()),
        })
    }

    /// Refuses a key of `--set` without effect in any of the runs, and reports those of the file. `taken` holds keys
    /// whose place the command takes, each with the reason.
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
            eprintln!(
                "cfmmr: scenario file: {}",
                idle.join("\ncfmmr: scenario file: ")
            );
        }
        Ok(())
    }
}

/// Keys whose place a command takes, each with the reason.
pub type Taken<'a> = &'a [(&'a str, &'a str)];

/// Key and reason if it has no effect in any of the runs.
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

/// Refuses a key of a file for one run without effect in the run.
pub fn check_file(text: &str, file: &str, run: Run) -> Result<(), Error> {
    let mut keys = Vec::new();
    leaves("", &toml::from_str(text).unwrap_or_default(), &mut keys);
    match keys.iter().find_map(|key| self::text(key, &[], &[run])) {
        Some(text) => Err(Error::input(format!("{file}: {text}"))),
        None => Ok(()),
    }
}

/// Refuses a key of a world file without effect in that world.
pub fn check_world(text: &str, world: &World) -> Result<(), Error> {
    let mut keys = Vec::new();
    leaves("", &toml::from_str(text).unwrap_or_default(), &mut keys);
    let idle = |key: &String| Some(format!("{key}: no effect {}", in_world(key, world)?));
    match keys.iter().find_map(idle) {
        Some(text) => Err(Error::input(format!("world = {}: {text}", world.name))),
        None => Ok(()),
    }
}

/// Reason why a key has no effect in a run.
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
        // The zeros of the beam board are laid over those of the bridges.
        Some(("beam", parameter))
            if within(parameter, "robot.beam.calibration") && scenario.mission.rps =>
        {
            None
        }
        Some((board, parameter)) => {
            on_other_board(board, parameter, used).or_else(|| find(parameter))
        }
        None => find(key),
    }
}

fn in_world(key: &str, world: &World) -> Option<&'static str> {
    let mut rules = WORLD.iter().filter(|(keys, ..)| listed(key, keys));
    rules
        .find(|(_, idle, _)| idle(world))
        .map(|(.., reason)| *reason)
}

/// Parameters of an axle node.
const AXLE: &str = "drive inertial robot.axle robot.limits robot.geometry.wheel_radius_m \
    robot.geometry.wheel_ratio robot.geometry.half_track_m \
    robot.geometry.encoder_counts_per_revolution";
/// Parameters of the strip and of steering, of which a rear board has no use.
const STEERING: &str = "robot.geometry.half_thickness_m robot.geometry.rigid_end_m \
    robot.limits.max_steering_rad robot.limits.steering_margin_rad";

/// Reason why a parameter has no effect on a board.
fn on_other_board(board: &str, parameter: &str, used: Use) -> Option<&'static str> {
    let of = |keys: &str| listed(parameter, keys);
    match board {
        _ if used != Use::Virtual && of("drive") => {
            Some("in a simulation: it describes the circuit of a board")
        }
        "rear" | "beam" if of("robot.lead") => {
            Some("on this board: the lead node runs on the front board")
        }
        "beam" if of(AXLE) => Some("on this board: it has no axle node"),
        "front" | "rear" if of("robot.beam.calibration") || board == "rear" && of("robot.beam") => {
            Some("on this board: it has no beam node")
        }
        "rear" if of(STEERING) => Some("on this board: the front board steers"),
        _ => None,
    }
}

/// True if `key` is one of `keys`, or an entry of one of them.
fn listed(key: &str, keys: &str) -> bool {
    keys.split_whitespace().any(|other| within(key, other))
}

/// True if `key` is `prefix`, or an entry of that table or list.
fn within(key: &str, prefix: &str) -> bool {
    key.strip_prefix(prefix)
        .is_some_and(|rest| rest.is_empty() || rest.starts_with(['.', '[']))
}

/// Keys of all values that are not tables.
fn leaves(prefix: &str, table: &Table, keys: &mut Vec<String>) {
    for (name, value) in table {
        let key = if prefix.is_empty() {
            name.clone()
        } else {
            format!("{prefix}.{name}")
        };
        match value {
            Value::Table(inner) => leaves(&key, inner, keys),
            _ => keys.push(key),
        }
    }
}
