//! Each key of a scenario and each parameter of a board changes a run, or is refused with the reason.
//!
//! Every key is changed alone in one situation after another, until a run changes. In a situation in which the key is
//! refused, the run must stay bit-identical.

use core_algos::params::TABLE;
use core_algos::topology::{Role, Topology};
use host_sim::base::error::Error;
use host_sim::paths::Path;
use host_sim::plant::Wrench;
use host_sim::run::path_run;
use host_sim::run::path_run::{PathMode, Route};
use host_sim::run::regulate::regulate_on;
use host_sim::run::robot::{Observer, Record, Robot};
use host_sim::run::simulation::Simulation;
use host_sim::scenario::Scenario;
use host_sim::scenario::effect;
use host_sim::scenario::effect::Use;
use host_sim::world::faults::Fault;
use rayon::prelude::*;
use remote::virtual_robot::faults::{RunKind, catalogue};
use std::hash::{DefaultHasher, Hash, Hasher};
use std::sync::{Arc, Mutex};
use toml::{Table, Value};

/// Tick at which a fault begins if the line of its situation names no tick.
const FAULT_TICK: &str = "4000";

/// Task, injected fault with its tick, and changes of the default scenario.
struct Situation {
    task: Task,
    fault: Option<(Fault, u32)>,
    changes: Vec<String>,
}

#[derive(Clone, Copy, PartialEq)]
enum Task {
    Regulate,
    Path(PathMode),
}

/// Situations, one per line: task, fault and changes. The first line is the default experiment.
const SITUATIONS: &str = "
posture ||
posture || sensors.gyro.fitted=true sensors.accelerometer.fitted=true
follow ||
track ||
posture || mission.rps=false
posture || robot.lead.fusion.mode=intersection-ipec
posture || robot.lead.regulator.strategy=paper-law
posture || plant.tyre.creep={}
posture || plant.cogging_torque_n_m=0.05 plant.payload_kg=[1,1] plant.center_of_mass_height_m=0.05
posture || sensors.bridge.warming_k=5 sensors.bridge.creep_share=0.01
posture || robot.axle.speed_source=filter robot.axle.controller.frame_force=beam
posture || robot.beam.method=piecewise
posture || mission.start=[-0.2,0.2,1.0]
posture || sensors.gyro.fitted=true sensors.gyro.rest_average_s=0
posture || sensors.accelerometer.fitted=true sensors.accelerometer.rest_average_s=0
posture || robot.lead.regulator.approach.approach_gain_m_s=0.1
posture | gauge dead |
posture | gauge drifts |
posture | gauge stuck |
posture | beam board lost |
posture | bus loses 50 % |
posture | motor without torque |
posture | motor stuck on |
posture | encoder stuck |
posture | gyro off by 0.3 rad/s | sensors.gyro.fitted=true sensors.accelerometer.fitted=true
posture | frame snapped |
posture | rear board lost |
";

/// Keys with an effect in a special situation only, or with an effect that a search over all situations finds late.
const PROBES: &str = "
world=ideal | posture ||
bus.transmission=on | posture || bus.latency_ms=0 robot.axle.speed_source=filter robot.axle.controller.frame_force=beam
robot.axle.limits.stall_share=0.4 | posture || plant.rolling_resistance=0.5
robot.axle.rest_settle_s=6 | posture || mission.rest_s=60 robot.lead.hold_s=6 sensors.gyro.fitted=true
robot.lead.hold_s=6 | posture || mission.rest_s=60
robot.axle.supervisor.stop_timeout_s=0.5 | posture | motor stuck on | robot.axle.stop.release_s=0.2
robot.lead.supervisor.stop_timeout_s=0.5 | posture | motor stuck on | robot.lead.stop.release_s=0.2
robot.axle.wheel.max_speed_rad_s=600 | posture | encoder jumps |
robot.axle.reference_timeout_s=0.012 | posture | bus loses 50 % |
robot.axle.wrench_timeout_s=0.5 | posture | beam board lost | robot.axle.controller.frame_force=beam
robot.beam.health.active_counts=100000 | posture | gauge stuck @600 | robot.beam.health.max_chi_square=1e6
robot.beam.health.flat_window_periods=200 | posture | gauge stuck @600 | robot.beam.health.max_chi_square=1e6
robot.beam.health.dead_strain=0.01 | posture | gauge stuck @600 | robot.beam.health.max_chi_square=1e6
robot.axle.limits.slip_rad_s=0.08 | posture | gyro off by 0.3 rad/s | sensors.gyro.fitted=true sensors.accelerometer.fitted=true
robot.axle.filter.gate_patience=2 | posture | gyro off by 0.3 rad/s | sensors.gyro.fitted=true sensors.accelerometer.fitted=true
robot.axle.limits.tracking_m=0.008 | posture | motor stuck on |
robot.axle.disturbance.max_force_n=0.1 | posture ||
robot.lead.supervisor.degraded_time_s=2 | posture | beam board lost |
robot.lead.supervisor.degraded_distance_m=1 | posture | beam board lost |
robot.axle.stop.shortest_s=0.2 | posture | gauge stuck |
robot.lead.stop.shortest_s=0.2 | posture | gauge stuck |
robot.lead.limits.force_n=2.5 | posture | gauge drifts |
robot.beam.calibration.rail_margin_counts=0 | posture | gauge dead |
robot.lead.regulator.accept_distance_m=0.003 | posture || robot.lead.regulator.approach.approach_gain_m_s=0.1
boards.front.robot.lead.regulator.accept_distance_m=0.003 | posture || robot.lead.regulator.approach.approach_gain_m_s=0.1
robot.lead.regulator.planner.margin_rad=0.1 | posture || mission.start=[-0.2,0.2,1.0]
robot.lead.regulator.planner.min_approach_m=1.5 | posture || mission.start=[-0.2,0.2,1.0]
robot.lead.regulator.planner.cusp_price_m=1.5 | posture || mission.start=[-0.2,0.2,1.0]
mission.tolerance_m=0.01 | posture ||
mission.tolerance_rad=0.01 | posture ||
robot.lead.limits.position_sigma_m=0.01 | posture ||
robot.lead.regulator.max_attempts=0 | posture || mission.rps=false robot.lead.regulator.accept_heading_rad=0.002
robot.lead.regulator.planner.max_straight_m=0.3 | posture || mission.start=[-0.3,0.3,2.0]
robot.lead.regulator.approach.denominator_floor=1 | posture || robot.lead.regulator.approach.approach_gain_m_s=0.1
robot.lead.regulator.release_factor=1.1 | posture || mission.rest_s=20 sensors.bridge.drift_walk_strain=1e-5 robot.lead.regulator.accept_distance_m=0.003 robot.lead.regulator.accept_heading_rad=0.003
robot.lead.regulator.leave_factor=1 | posture || mission.start=[-1.0,0.6,2.0] robot.lead.regulator.leave_slack_rad=0
robot.lead.regulator.leave_slack_rad=0 | posture || mission.start=[-1.0,0.6,2.0] robot.lead.regulator.leave_factor=1
robot.lead.course.law.denominator_floor=1 | follow ||
robot.lead.course.max_deviation_m=0.001 | follow ||
robot.lead.course.path.search_window_m=0.001 | follow ||
robot.lead.course.path.max_steering_acceleration_rad_s2=0.05 | follow ||
robot.lead.course.path.min_speed_m_s=0.15 | follow || robot.lead.course.path.max_steering_rate_rad_s=0.05
boards.beam.robot.geometry.bending_stiffness_n_m2=0.9163 | posture || robot.axle.speed_source=filter robot.axle.controller.frame_force=beam
boards.front.robot.axle.controller.max_torque_nm=2.2 | posture | motor stuck on |
boards.front.robot.lead.governor.max_wheel_speed_m_s=0.54 | posture ||
boards.front.robot.lead.governor.stop_deceleration_m_s2=0.88 | posture | gauge stuck |
boards.front.robot.lead.regulator.accept_heading_rad=0.001 | posture ||
boards.rear.robot.axle.controller.max_torque_nm=2.2 | posture | motor stuck on |
boards.rear.robot.limits.max_speed_m_s=0.01 | posture ||
mission.time_limit_s=9.0 | posture ||
plant.no_load_speed_rad_s=22.0 | posture | motor stuck on |
plant.stall_torque_n_m=2.75 | posture | motor stuck on |
plant.torque_limit_n_m=0.25 | posture ||
robot.axle.controller.max_torque_nm=2.2 | posture | motor stuck on |
robot.axle.filter.innovation_gate=39.6 | posture | gyro off by 0.3 rad/s | sensors.gyro.fitted=true sensors.accelerometer.fitted=true
robot.axle.limits.stall_rad_s=0.22 | posture | encoder stuck |
robot.axle.limits.tracking_rad=0.385 | posture | motor stuck on |
robot.axle.speed_source=wheels | posture || robot.axle.speed_source=filter robot.axle.controller.frame_force=beam
robot.axle.stop.deceleration_m_s2=1.1 | posture | gauge stuck |
robot.axle.stop.release_s=0.825 | posture | gauge stuck |
robot.axle.stop.rest_s=0.11 | posture | gauge stuck |
robot.beam.calibration.max_strain=0.0005 | posture ||
robot.beam.health.max_chi_square=33.0 | posture | gauge drifts |
robot.beam.health.trip_periods=6 | posture | gauge drifts |
robot.beam.health.verdicts=3 | posture | gauge drifts |
robot.beam.health.watch_consistency=false | posture | gauge drifts |
robot.beam.method=elastica | posture || robot.beam.method=piecewise
robot.beam.strip.uncertainty.interpolation=0.33 | posture || robot.beam.method=piecewise
robot.lead.course.path.max_steering_rate_rad_s=0.08 | follow ||
robot.lead.fusion.beam_gate=5.0 | posture | encoder stuck |
robot.lead.fusion.gate_patience=51 | posture | gauge stuck |
robot.lead.governor.max_wheel_speed_m_s=0.54 | posture ||
robot.lead.governor.stop_deceleration_m_s2=0.88 | posture | gauge stuck |
robot.lead.limits.bend_rad=0.35 | posture ||
robot.lead.limits.heading_sigma_rad=0.05 | follow ||
robot.lead.limits.moment_n_m=0.6 | posture ||
robot.lead.regulator.accept_heading_rad=0.001 | posture ||
robot.lead.regulator.approach.circle_radius_m=0.0055 | posture || robot.lead.regulator.approach.approach_gain_m_s=0.1
robot.lead.regulator.approach.epsilon=0.0011 | posture || robot.lead.regulator.approach.approach_gain_m_s=0.1
robot.lead.regulator.approach.form=printed | posture || robot.lead.regulator.approach.approach_gain_m_s=0.1
robot.lead.regulator.planner_budget=200 | posture ||
robot.lead.regulator.steering_timeout_s=0.3 | posture ||
robot.lead.regulator.steering_wait_rad=0.22 | posture | motor without torque |
robot.lead.report_timeout_s=0.055 | posture | bus loses 50 % |
robot.lead.stop.deceleration_m_s2=1.1 | posture | gauge stuck |
robot.lead.stop.release_s=0.825 | posture | gauge stuck |
robot.lead.stop.rest_s=0.11 | posture | gauge stuck |
";

impl Situation {
    fn parse(line: &'static str) -> Self {
        let [task, fault, changes] = line.split('|').map(str::trim).collect::<Vec<_>>()[..] else {
            panic!("{line}");
        };
        let (name, tick) = fault.split_once(" @").unwrap_or((fault, FAULT_TICK));
        let entry = catalogue(Topology::PAIR)
            .into_iter()
            .find(|entry| entry.name == name);
        assert!(fault.is_empty() || entry.is_some(), "{line}");
        let modelled = entry.and_then(|entry| match entry.kind {
            RunKind::Model(fault) => Some(fault),
            _ => None,
        });
        Self {
            task: match task {
                "follow" => Task::Path(PathMode::Follow),
                "track" => Task::Path(PathMode::Track),
                _ => Task::Regulate,
            },
            fault: modelled.map(|fault| (fault, tick.parse().unwrap())),
            changes: changes.split_whitespace().map(str::to_owned).collect(),
        }
    }

    fn with(&self, more: &[String]) -> Result<Scenario, Error> {
        Scenario::parse(None, "", "test", &[&self.changes, more].concat())
    }

    fn refusal(&self, key: &str, scenario: &Scenario) -> Option<String> {
        let (taken, used) = match self.task {
            Task::Regulate => (&[] as effect::Taken, Use::Regulate),
            Task::Path(_) => (cfmmr::experiments::follow::PATH, Use::Path),
        };
        effect::text(key, taken, &[(scenario, used)])
    }

    /// Runs the scenario and returns a hash of the recorded state of each epoch. Stops at the first hash that differs
    /// from `before`, unless `before` is empty.
    fn run(&self, scenario: &Scenario, before: &[u64]) -> Result<Vec<u64>, Error> {
        let mut scenario = scenario.clone();
        let route = match self.task {
            Task::Regulate => None,
            Task::Path(_) => {
                let path = Path::figure_eight(1.0).unwrap();
                let route = Route::new(&path, 1, &scenario);
                let route = route.map_err(|error| Error::input(error.to_string()))?;
                scenario.mission.start = route.start();
                Some(route)
            }
        };
        let mut simulation = Simulation::new(&scenario, 3, 0)?;
        let hashes = Arc::new(Mutex::new(Vec::new()));
        simulation.observe(Box::new(Epochs {
            hashes: hashes.clone(),
            before: before.to_vec(),
        }));
        if let Some((fault, tick)) = self.fault.clone() {
            simulation.inject(fault, tick);
        }
        // The only error is the observer's, at the first difference.
        let _ = match (self.task, &route) {
            (Task::Path(path_mode), Some(route)) => {
                path_run::drive_on(&mut simulation, &scenario, route, path_mode, |_| {}).map(|_| ())
            }
            _ => regulate_on(&mut simulation, &scenario, |_| {}).map(|_| ()),
        };
        Ok(std::mem::take(&mut *hashes.lock().unwrap()))
    }

    fn changes_with(&self, scenario: &Scenario, before: &[u64]) -> bool {
        self.run(scenario, before)
            .is_ok_and(|after| after != before)
    }
}

/// Observer that hashes the state of each epoch and fails at the first difference from `before`.
struct Epochs {
    hashes: Arc<Mutex<Vec<u64>>>,
    before: Vec<u64>,
}

impl Observer for Epochs {
    fn epoch(&mut self, robot: &dyn Robot, record: &Record) -> Result<(), Error> {
        let mut hash = DefaultHasher::new();
        let bits = |values: &[f64]| {
            values
                .iter()
                .map(|value| value.to_bits())
                .collect::<Vec<_>>()
        };
        bits(&record.midpoint).hash(&mut hash);
        for axle in &record.axles {
            bits(&axle.torque).hash(&mut hash);
        }
        for frame in &record.frames {
            let Wrench {
                force,
                root_moment,
                end_moment,
            } = frame.wrench;
            bits(&[force[0], force[1], root_moment, end_moment]).hash(&mut hash);
            frame.strain.map(f32::to_bits).hash(&mut hash);
        }
        format!("{:?} {:?}", record.lead, robot.monitor().changes().last()).hash(&mut hash);
        let (mut hashes, hash) = (self.hashes.lock().unwrap(), hash.finish());
        let same = self.before.is_empty() || self.before.get(hashes.len()) == Some(&hash);
        hashes.push(hash);
        match same {
            true => Ok(()),
            false => Err(Error::Failure("changed".to_owned())),
        }
    }
}

/// Appends the key paths of all values in a TOML value to `found`.
fn value_paths(value: &Value, at: &[String], found: &mut Vec<Vec<String>>) {
    let mut inner = |key: String, value: &Value| value_paths(value, &[at, &[key]].concat(), found);
    match value {
        Value::Table(table) => table
            .iter()
            .for_each(|(key, value)| inner(key.clone(), value)),
        Value::Array(list) => (0..)
            .zip(list)
            .for_each(|(i, value): (u32, _)| inner(i.to_string(), value)),
        _ => found.push(at.to_vec()),
    }
}

fn entry<'a>(value: &'a mut Value, path: &[String]) -> &'a mut Value {
    path.iter().fold(value, |value, key| match value {
        Value::Array(list) => &mut list[key.parse::<usize>().unwrap()],
        table => &mut table[key.as_str()],
    })
}

/// Values to try instead of `value`; some may be out of range.
fn trial_values(value: &Value) -> Vec<Value> {
    let words = "creep brush paper-law funnel derived printed exact trace determinant elastica \
                 piecewise quadrature wheels filter on off reference beam joint odometry";
    match *value {
        Value::Float(0.0) => [1e-3, 0.05, 1e-6, 1.0, 5.0].map(Value::Float).to_vec(),
        Value::Float(x) => [1.1, 0.9, 1.01, 2.0, 0.5, 10.0, 0.1]
            .map(|factor| Value::Float(x * factor))
            .to_vec(),
        Value::Integer(n) => [n + 1, n - 1, n * 2, n / 2, n * 10, n / 10]
            .map(Value::Integer)
            .to_vec(),
        Value::Boolean(flag) => vec![Value::Boolean(!flag)],
        _ => words.split_whitespace().map(Value::from).collect(),
    }
}

/// At most `count` valid scenarios that differ in one key.
fn changed_scenarios(scenario: &Scenario, path: &[String], count: usize) -> Vec<Scenario> {
    let mut table = Value::Table(Table::try_from(scenario).unwrap());
    let value = entry(&mut table, path).clone();
    let mut found = Vec::new();
    for other in trial_values(&value) {
        *entry(&mut table, path) = other;
        let Ok(other) = table.clone().try_into::<Scenario>() else {
            continue;
        };
        if other != *scenario && other.check().is_ok() {
            found.push(other);
        }
    }
    found.truncate(count);
    found
}

/// Valid scenarios that differ in one parameter of one board.
fn with_parameter(scenario: &Scenario, role: Role, name: &str) -> Vec<Scenario> {
    let parameter = TABLE
        .iter()
        .find(|parameter| parameter.name == name)
        .unwrap();
    let (low, high) = parameter.range;
    let default = parameter.default();
    let tries = [
        default * 1.1,
        default * 0.9,
        default + 1.0,
        low + 0.3 * (high - low),
        default * 2.0,
        high,
        low,
    ];
    let mut found = Vec::new();
    for value in tries {
        let value = if parameter.whole {
            value.round()
        } else {
            value
        };
        if parameter.validate(value).is_err() || value == default {
            continue;
        }
        let mut other = scenario.clone();
        other.boards.put(role, &[(parameter, value)]);
        if other.check().is_ok() {
            found.push(other);
        }
    }
    found
}

#[derive(Clone, Copy, PartialEq)]
enum KeyEffect {
    Effective,
    Elsewhere,
    Refused,
    Nothing,
}

/// Function from a scenario to scenarios that differ in one key.
type Change = Box<dyn Fn(&Scenario) -> Vec<Scenario> + Send + Sync>;

/// Situation, its scenario, and the hashes of its unchanged run.
type Baseline = (Situation, Scenario, Vec<u64>);

/// Keys without an effect in any situation and under any known fault, with the test that covers each.
const TESTED_ELSEWHERE: &[(&str, &str)] = &[(
    "robot.beam.health.clear_periods",
    "a gauge that recovers: core-algos, beam/health.rs",
)];

/// Effect of a key in its situation of [`PROBES`]; `None` if the key has no such situation.
fn probe(key: &str) -> Option<Result<KeyEffect, Error>> {
    let probes = PROBES.lines().filter_map(|line| line.split_once(" | "));
    let mut of_key = probes.filter(|(change, _)| change.split_once('=').unwrap().0 == key);
    let (change, line) = of_key.next()?;
    let situation = Situation::parse(line);
    let changes = || -> Result<bool, Error> {
        let before = situation.run(&situation.with(&[])?, &[])?;
        let scenario = situation.with(&[change.to_owned()])?;
        Ok(situation.changes_with(&scenario, &before))
    };
    Some(changes().map(|changes| {
        if changes {
            KeyEffect::Elsewhere
        } else {
            KeyEffect::Nothing
        }
    }))
}

/// Searches a situation in which the key changes the run.
fn search_effect(key: &str, made: &[Baseline], change: &Change) -> Result<KeyEffect, Error> {
    if let Some(found) = probe(key) {
        return found;
    }
    if TESTED_ELSEWHERE.iter().any(|(other, _)| *other == key) {
        return Ok(KeyEffect::Elsewhere);
    }
    let (mut refused, mut tried) = (true, false);
    // Tries one value in all situations first: in the right situation one value usually shows the effect, and in any
    // other situation each value costs a whole run.
    for values in [0..1, 1..7] {
        for (i, (situation, scenario, before)) in made.iter().enumerate() {
            let others = change(scenario);
            tried |= !others.is_empty();
            if situation.refusal(key, scenario).is_some() {
                continue;
            }
            refused = false;
            let mut others = others.iter().take(values.end).skip(values.start);
            if others.any(|other| situation.changes_with(other, before)) {
                return Ok(if i == 0 {
                    KeyEffect::Effective
                } else {
                    KeyEffect::Elsewhere
                });
            }
        }
    }
    // A key without another valid value counts as refused.
    Ok(if refused || !tried {
        KeyEffect::Refused
    } else {
        KeyEffect::Nothing
    })
}

/// Refused keys that change the run of a situation. All keys are changed together first, and one by one only if the
/// changed run differs.
fn wrongly_refused(
    (situation, scenario, before): &Baseline,
    keys: &[(String, Change)],
) -> Vec<String> {
    let refused = |key: &str, scenario: &Scenario| situation.refusal(key, scenario).is_some();
    // A change may give an effect to the changed key or to other keys; such a change is left out or made alone.
    let with = |scenario: &Scenario, (key, change): &(String, Change)| {
        let others = change(scenario);
        others.into_iter().find(|other| refused(key, other))
    };
    let mut together = scenario.clone();
    let (mut joined, mut alone) = (Vec::<&(String, Change)>::new(), Vec::new());
    for change in keys.iter().filter(|(key, _)| refused(key, scenario)) {
        match with(&together, change) {
            Some(next) if joined.iter().all(|(key, _)| refused(key, &next)) => {
                together = next;
                joined.push(change);
            }
            _ => alone.push(change),
        }
    }
    if situation.changes_with(&together, before) {
        alone.append(&mut joined);
    }
    let changes = |change: &&&(String, Change)| {
        with(scenario, change).is_some_and(|other| situation.changes_with(&other, before))
    };
    let wrong = alone.par_iter().filter(changes);
    wrong
        .map(|(key, _)| format!("{key}: changes a run in which it is refused"))
        .collect()
}

#[test]
fn each_key_changes_a_run_or_is_refused() {
    let lines: Vec<&str> = SITUATIONS.lines().filter(|line| !line.is_empty()).collect();
    let make = |line: &&'static str| {
        let situation = Situation::parse(line);
        let scenario = situation.with(&[]).unwrap();
        let run = situation.run(&scenario, &[]).unwrap();
        (situation, scenario, run)
    };
    let made: Vec<Baseline> = lines.par_iter().map(make).collect();
    let mut paths = Vec::new();
    let table = Value::Table(Table::try_from(&made[0].1).unwrap());
    value_paths(&table, &[], &mut paths);
    let of_scenario = paths.into_iter().map(|path| -> (String, Change) {
        let key = path.join(".");
        (
            key,
            Box::new(move |scenario| changed_scenarios(scenario, &path, 7)),
        )
    });
    let boards = Role::PAIR
        .into_iter()
        .flat_map(|role| TABLE.iter().map(move |p| (role, p.name)));
    let of_boards = boards.map(|(role, name)| -> (String, Change) {
        let key = format!("boards.{}.{name}", Topology::PAIR.name(role));
        let change = move |scenario: &_| with_parameter(scenario, role, name);
        (key, Box::new(change))
    });
    let keys: Vec<_> = of_scenario.chain(of_boards).collect();
    let results = keys
        .par_iter()
        .map(|(key, change)| (key, search_effect(key, &made, change)));
    let results: Vec<_> = results.collect();
    let count = |wanted| {
        results
            .iter()
            .filter(|(_, found)| matches!(found, Ok(f) if *f == wanted))
            .count()
    };
    println!(
        "{} keys: {} change the default run, {} another run, {} are refused",
        results.len(),
        count(KeyEffect::Effective),
        count(KeyEffect::Elsewhere),
        count(KeyEffect::Refused)
    );
    let wrong = results.iter().filter_map(|(key, found)| match found {
        Ok(KeyEffect::Nothing) => Some(format!("{key}: changes no run and is not refused")),
        Ok(_) => None,
        Err(error) => Some(format!("{key}: {error}")),
    });
    let wrongly_refused = made[..6]
        .par_iter()
        .flat_map(|made| wrongly_refused(made, &keys));
    let wrong: Vec<String> = wrong.chain(wrongly_refused.collect::<Vec<_>>()).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
