//! Procedures of a calibration: runs, and the constants computed from them.

use crate::experiments::calibrate::wheels;
use crate::experiments::calibrate::wheels::{OdometryErrors, systematic};
use crate::experiments::calibrate::{
    CalibrationBench, CalibrationRun, configured_axle, gauges, square, turns,
};
use core_algos::params::{Parameter, Settings, find};
use core_algos::topology::Role;
use host_sim::base::error::Error;
use host_sim::paths::Path;
use host_sim::scenario::Scenario;
use host_sim::scenario::board_parameters::{Overlays, Values};
use host_sim::world::sensors::SAMPLE_PERIOD_S;
use output::table::Table;
use serde::Serialize;

/// Speeds of the squares, m/s. Two speeds separate creep, which grows with time, from a wrong track.
pub(super) const SPEEDS_M_S: [f32; 2] = [0.2, 0.1];
/// Directions of the squares: 1 left, −1 right.
pub(super) const DIRECTIONS: [f64; 2] = [1.0, -1.0];
/// Length of the straight line, m.
pub(super) const STRAIGHT_M: f64 = 4.0;
/// Curvatures of the formers, 1/m.
pub(super) const FORMERS: [f64; 4] = [1.0, -1.0, 2.0, -2.0];

#[derive(Clone, Debug, Serialize)]
pub(super) struct CalibratedParameter {
    pub(super) board: &'static str,
    pub(super) name: &'static str,
    pub(super) unit: &'static str,
    pub(super) before: f64,
    pub(super) after: f64,
    /// True value in the simulated robot.
    pub(super) truth: f64,
}

/// Error of the robot before and after the calibration.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Effect {
    pub(super) what: String,
    pub(super) unit: &'static str,
    pub(super) before: f64,
    pub(super) after: f64,
}

/// Result of a calibration.
#[derive(Clone, Debug, Default, Serialize)]
pub struct CalibrationReport {
    /// World of the robot.
    pub world: String,
    /// Seed of all draws.
    pub seed: u64,
    pub(super) parameters: Vec<CalibratedParameter>,
    pub(super) effects: Vec<Effect>,
    pub(super) notes: Vec<String>,
    /// True if the boards have saved the parameters.
    pub saved: bool,
    /// Calibrated parameters of each board.
    #[serde(skip)]
    pub found: Overlays,
}

pub(super) fn parameter(name: &str) -> Result<&'static Parameter, Error> {
    find(name).ok_or_else(|| Error::Failure(format!("{name}: no such parameter")))
}

impl CalibrationReport {
    /// Report without parameters.
    fn of(scenario: &Scenario) -> Self {
        Self {
            found: Overlays::new(scenario.robot.topology()),
            ..Self::default()
        }
    }

    /// Adds a calibrated parameter to the report; fails if its new value `after` is out of range.
    pub(super) fn find(
        &mut self,
        role: Role,
        name: &str,
        before: f64,
        after: f64,
        truth: f64,
    ) -> Result<(), Error> {
        let parameter = parameter(name)?;
        let value = parameter.validate(after as f32)?;
        self.found.put(role, &Values::from([(parameter, value)]));
        self.parameters.push(CalibratedParameter {
            board: self.found.topology.name(role),
            name: parameter.name,
            unit: parameter.unit,
            before,
            after,
            truth,
        });
        Ok(())
    }

    pub(super) fn effect(
        &mut self,
        what: impl Into<String>,
        unit: &'static str,
        [before, after]: [f64; 2],
    ) {
        let what = what.into();
        self.effects.push(Effect {
            what,
            unit,
            before,
            after,
        });
    }

    /// Tables and notes of the report, as text.
    pub fn text(&self) -> String {
        let digits = |row: &CalibratedParameter| if row.unit == "counts" { 2 } else { 6 };
        let mut table = Table::new([
            "parameter",
            "board",
            "unit",
            "before",
            "after",
            "true",
            "error",
        ]);
        for row in &self.parameters {
            let n = digits(row);
            table.row([
                row.name.to_owned(),
                row.board.to_owned(),
                row.unit.to_owned(),
                format!("{:.n$}", row.before),
                format!("{:.n$}", row.after),
                format!("{:.n$}", row.truth),
                format!("{:+.n$}", row.after - row.truth),
            ]);
        }
        let mut effects = Table::new(["error", "unit", "before", "after"]);
        for effect in &self.effects {
            effects.row([
                effect.what.clone(),
                effect.unit.to_owned(),
                format!("{:.2}", effect.before),
                format!("{:.2}", effect.after),
            ]);
        }
        let notes: String = self.notes.iter().map(|note| format!("{note}\n")).collect();
        format!("{table}\n{effects}\nworld {}\n{notes}", self.world)
    }
}

/// Squares in both directions at both speeds, nominal speed first: speed, direction, run.
pub(super) struct Squares(Vec<(f32, f64, CalibrationRun)>);

impl Squares {
    pub(super) fn drive(
        scenario: &Scenario,
        bench: &mut CalibrationBench,
        laps: u32,
    ) -> Result<Self, Error> {
        let (mut runs, mut number) = (Vec::new(), 10);
        for speed in SPEEDS_M_S {
            let mut scenario = scenario.clone();
            scenario.robot.lead.course.path.nominal_speed_m_s = speed;
            for direction in DIRECTIONS {
                for _ in 0..laps {
                    number += 1;
                    let run = bench.drive(&scenario, &square(direction)?, number)?;
                    runs.push((speed, direction, run));
                }
            }
        }
        Ok(Self(runs))
    }

    /// UMBmark's systematic error at the nominal speed, from the return error of each run.
    pub(super) fn systematic(&self, error: impl Fn(&CalibrationRun) -> [f64; 2]) -> f64 {
        let of = |wanted: f64| -> Vec<[f64; 2]> {
            let runs = self.0.iter();
            runs.filter(|(speed, direction, _)| *speed == SPEEDS_M_S[0] && *direction == wanted)
                .map(|(_, _, run)| error(run))
                .collect()
        };
        systematic([&of(DIRECTIONS[0]), &of(DIRECTIONS[1])])
    }
}

/// Wheel radius, wheel ratio and track of each axle, from a straight line and squares.
pub fn calibrate_wheels(
    scenario: &Scenario,
    bench: &mut CalibrationBench,
    laps: u32,
) -> Result<CalibrationReport, Error> {
    let mut report = CalibrationReport::of(scenario);
    let line = Path::line(STRAIGHT_M).map_err(|error| Error::Failure(error.to_string()))?;
    let straight = [
        bench.drive(scenario, &line, 1)?,
        bench.drive(scenario, &line, 2)?,
    ];
    let before = Squares::drive(scenario, bench, laps)?;
    let topology = scenario.robot.topology();
    let names = topology.axles().map(|axle| topology.name(Role::Axle(axle)));
    let mut creep = Vec::new();
    for (axle, name) in topology.axles().zip(names.clone()) {
        let (i, role) = (axle.index(), Role::Axle(axle));
        let length = |[x, y, _]: [f64; 3]| libm::hypot(x, y);
        let scales = straight
            .iter()
            .map(|run| length(run.axles[i].end) / length(run.axles[i].lap.end()));
        let scale = scales.sum::<f64>() / straight.len() as f64;
        let returns: Vec<_> = before
            .0
            .iter()
            .map(|(_, _, run)| run.axles[i].clone())
            .collect();
        let old = configured_axle(scenario, role)?;
        let errors: OdometryErrors = wheels::fit(&returns, 2.0 * old.half_track_m)
            .ok_or_else(|| Error::Failure(format!("{name} axle: the fit of the squares failed")))?;
        creep.push(errors.creep);
        let new = old.corrected(scale, &errors);
        let robot = bench.robot();
        let nominal = &scenario.world.plant;
        let radii: [f64; 2] =
            std::array::from_fn(|k| nominal.wheel_radius_m[i][k] * robot.wheel_radius_factor[i][k]);
        let track = nominal.half_track_m[i] * robot.track_factor[i];
        for (name, old, new, truth) in [
            (
                "wheel_radius_m",
                old.radius_m,
                new.radius_m,
                0.5 * (radii[0] + radii[1]),
            ),
            ("wheel_ratio", old.ratio, new.ratio, radii[1] / radii[0]),
            ("half_track_m", old.half_track_m, new.half_track_m, track),
        ] {
            report.find(role, &format!("robot.geometry.{name}"), old, new, truth)?;
        }
    }
    let after = Squares::drive(&with_parameters(scenario, &report.found)?, bench, laps)?;
    let both = [&before, &after];
    for (i, name) in names.clone().enumerate() {
        let measured = both.map(|runs| 1e3 * runs.systematic(|run| run.axles[i].error()));
        report.effect(format!("E_max,syst, {name} axle alone"), "mm", measured);
        let left =
            both.map(|runs| 1e3 * runs.systematic(|run| run.axles[i].without_creep(creep[i])));
        report.effect(
            format!("E_max,syst, {name} axle alone, less creep"),
            "mm",
            left,
        );
    }
    let robot = both.map(|runs| 1e3 * runs.systematic(|run| run.robot));
    report.effect("E_max,syst, robot's estimate", "mm", robot);
    let creep = creep.iter().zip(names);
    let creep: Vec<_> = creep
        .map(|(creep, name)| format!("{creep:+.4} ({name})"))
        .collect();
    report.notes.push(format!(
        "creep under the frame's moment: {} rad/s per rad of relative heading; \
         the joint filter estimates the creep, no parameter corrects it",
        creep.join(" and ")
    ));
    Ok(report)
}

/// Zeros and gains of the strain gauges, from a straight strip and formers.
pub fn calibrate_gauges(
    scenario: &Scenario,
    bench: &mut CalibrationBench,
) -> Result<CalibrationReport, Error> {
    let mut report = CalibrationReport::of(scenario);
    let bridge = &scenario.world.sensors.bridge;
    let middle = f64::from(bridge.full_scale_counts());
    let points = bench.hold(scenario, &FORMERS)?;
    let count = scenario.robot.beam.strip.gauges_m.count();
    let (mut zeros, mut gains) = (Vec::new(), Vec::new());
    for i in 0..count {
        let found = gauges::fit(&points, i, bridge.strain_per_count());
        let (zero, gain) = found.ok_or_else(|| {
            Error::Failure(format!(
                "gauge {i}: the strains of the postures do not differ"
            ))
        })?;
        zeros.push(zero);
        gains.push(gain);
    }
    let robot = bench.robot().clone();
    let frame = &robot.frames[0];
    let truth = bridge.zero_counts(frame);
    for (i, zero) in zeros.iter().enumerate() {
        let name = format!("robot.beam.calibration.zero_counts[{i}]");
        report.find(Role::beam(0), &name, middle, *zero, middle + truth[i])?;
    }
    for (i, gain) in gains.iter().enumerate() {
        let name = format!("robot.beam.calibration.gain[{i}]");
        let truth = 1.0 / (1.0 + frame.bridge_gain_error[i]);
        report.find(Role::beam(0), &name, 1.0, *gain, truth)?;
    }
    // The lap before the calibration of gains already uses calibrated zeros, without which the robot cannot follow.
    let mut zeroed = Overlays::new(scenario.robot.topology());
    zeroed.put(Role::beam(0), &report.found.values(Role::beam(0))?);
    for i in 0..count {
        let gain = parameter(&format!("robot.beam.calibration.gain[{i}]"))?;
        zeroed.put(Role::beam(0), &[(gain, 1.0)]);
    }
    let lap = square(1.0)?;
    let ends = [&zeroed, &report.found];
    let mut errors = Vec::new();
    for overlays in ends {
        errors.push(
            bench
                .drive(&with_parameters(scenario, overlays)?, &lap, 3)?
                .beam,
        );
    }
    for (k, (what, unit)) in [
        ("frame's end on a lap, x", "mm"),
        ("frame's end on a lap, y", "mm"),
        ("frame's end on a lap, heading", "mrad"),
    ]
    .into_iter()
    .enumerate()
    {
        report.effect(
            format!("{what}, rms"),
            unit,
            [0, 1].map(|i| 1e3 * errors[i][k]),
        );
    }
    // The effect of the zeros is computed, not driven: a mean strain error turns the measured end of the frame.
    let geometry = &scenario.robot.geometry;
    let [length, half] = [geometry.frame_length_m, geometry.half_thickness_m].map(f64::from);
    let unzeroed = frame.bridge_offset[..count].iter().sum::<f64>() / count as f64;
    let strain = bridge.strain_per_count();
    let left = (0..count).map(|i| (truth[i] + middle - zeros[i]) * strain);
    let left = left.sum::<f64>() / count as f64;
    let turn = |strain: f64| 1e3 * (strain * length / half).abs();
    report.effect(
        "relative heading measured with a straight frame",
        "mrad",
        [turn(unzeroed), turn(left)],
    );
    report.notes.push(
        "frame's end on a lap: before with calibrated zeros, after with calibrated zeros and gains"
            .to_owned(),
    );
    Ok(report)
}

/// Gains of the gyros, from turns by known angles.
pub fn calibrate_gyros(
    scenario: &Scenario,
    bench: &mut CalibrationBench,
) -> Result<CalibrationReport, Error> {
    let mut report = CalibrationReport::of(scenario);
    let turned = bench.turn(scenario)?;
    let topology = scenario.robot.topology();
    for axle in topology.axles() {
        let (i, role) = (axle.index(), Role::Axle(axle));
        let name = topology.name(role);
        let mut settings = Settings::new(scenario.robot);
        scenario.boards.apply(role, &mut settings)?;
        let gain = turns::gain(&turned[i], SAMPLE_PERIOD_S)
            .ok_or_else(|| Error::Failure(format!("{name} gyro: no rotation measured")))?;
        let truth = 1.0 / (1.0 + bench.robot().gyro_scale_error[i]);
        let before = settings.inertial.gyro_gain.into();
        report.find(role, "inertial.gyro_gain", before, gain, truth)?;
        let bias = turned[i].iter().map(turns::Turn::bias).sum::<f64>() / turned[i].len() as f64;
        report.notes.push(format!(
            "{name} gyro: bias {:+.3} mrad/s at rest (true {:+.3}); not stored: each board estimates the bias at rest",
            1e3 * bias,
            1e3 * bench.robot().gyro_bias[i]
        ));
    }
    let mut fitted = scenario.clone();
    fitted.world.sensors.gyro.fitted = true;
    let lap = square(1.0)?;
    let before = bench.drive(&fitted, &lap, 4)?;
    let after = bench.drive(&with_parameters(&fitted, &report.found)?, &lap, 4)?;
    for axle in topology.axles() {
        let (i, name) = (axle.index(), topology.name(Role::Axle(axle)));
        let errors = [&before, &after].map(|run| 1e3 * run.heading[i].abs());
        report.effect(format!("{name} axle's heading after a lap"), "mrad", errors);
    }
    let errors = [&before, &after].map(|run| 1e3 * libm::hypot(run.robot[0], run.robot[1]));
    report.effect("robot's estimate after a lap", "mm", errors);
    Ok(report)
}

/// Scenario with the calibrated parameters.
fn with_parameters(scenario: &Scenario, found: &Overlays) -> Result<Scenario, Error> {
    let mut scenario = scenario.clone();
    for role in found.topology.boards() {
        scenario.boards.put(role, &found.values(role)?);
    }
    scenario.check()?;
    Ok(scenario)
}
