//! `cfmmr sensitivity`: how the final error depends on what is not known of a robot: its tyres, the
//! bias of its strain bridges, its wheels, and where it was put down.

use super::Context;
use super::posture::{FinalError, ROWS, Variant, summarize};
use crate::cli::SensitivityArgs;
use crate::effect::{Run, Use};
use crate::error::Error;
use crate::output::{Cell, Csv};
use crate::scenario::Scenario;
use crate::simulation::{self, Outcome};
use crate::statistics::Summary;
use crate::table::{Table, plus_minus};
use serde::Serialize;

/// One value of one influence.
struct Point {
    influence: &'static str,
    value: String,
    scenario: Scenario,
}

/// Result of one point with one configuration of sensors.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Entry {
    /// What was varied.
    pub influence: &'static str,
    /// Its value, with the unit.
    pub value: String,
    /// Whether the relative position sensor was fitted.
    pub rps: bool,
    /// Distance of O from the goal.
    pub e_m: Summary,
    /// Heading error of O.
    pub heading_rad: Summary,
    /// Share of trials within 3 cm and 3°.
    pub within_3cm_3deg: f64,
    /// Root mean square of the frame's force.
    pub force_rms_n: Summary,
}

/// Result of the command.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// Seed.
    pub seed: u64,
    /// Trials at each point and configuration.
    pub trials: u32,
    /// The results, two for each point.
    pub entries: Vec<Entry>,
}

/// Slip stiffness of all tyres over their load: from soft rubber on carpet to hard rubber on a hard floor.
const SLIP_STIFFNESS: [f64; 5] = [8.0, 14.0, 20.0, 28.0, 40.0];
/// Common error of all bridges as heading of the front axle against the rear, rad.
const BIAS: [f64; 4] = [0.0, 0.75e-3, 2e-3, 5e-3];
/// Relative error of each wheel's radius.
const RADIUS: [f64; 4] = [0.0, 1e-3, 3e-3, 1e-2];
/// Position (m) and heading (rad) error of the start.
const PLACEMENT: [[f64; 2]; 4] = [[0.0, 0.0], [2e-3, 2e-3], [5e-3, 5e-3], [1e-2, 1e-2]];

fn points(base: &Scenario) -> Vec<Point> {
    let mut points = vec![Point {
        influence: "none",
        value: "as in the scenario".to_owned(),
        scenario: base.clone(),
    }];
    let mut add = |influence, value: String, change: &dyn Fn(&mut Scenario)| {
        let mut scenario = base.clone();
        change(&mut scenario);
        points.push(Point {
            influence,
            value,
            scenario,
        });
    };
    for stiffness in SLIP_STIFFNESS {
        add(
            "slip stiffness of the tyres",
            format!("{stiffness}"),
            &|s| {
                s.world.plant.slip_stiffness = [[stiffness; 2]; 2];
            },
        );
    }
    for bias in BIAS {
        add(
            "bias of the sensor, σ",
            format!("{} mrad", 1e3 * bias),
            &|s| {
                // An angle over the whole strip is a strain of half the thickness over its length.
                let length = s.world.plant.strip_length_m;
                let bridge = &mut s.world.sensors.bridge;
                bridge.common_sigma_strain = bias * bridge.half_thickness_m / length;
                bridge.drift_sigma_strain = 0.0;
            },
        );
    }
    for radius in RADIUS {
        add("wheel radius, σ", format!("{} %", 100.0 * radius), &|s| {
            s.world.sensors.geometry.wheel_radius_sigma = radius;
        });
    }
    for [position, heading] in PLACEMENT {
        let value = format!("{} mm, {} mrad", 1e3 * position, 1e3 * heading);
        add("placement, σ", value, &|s| {
            s.world.sensors.placement.position_sigma_m = position;
            s.world.sensors.placement.heading_sigma_rad = heading;
        });
    }
    points
}

/// Runs the command.
pub fn run(args: &SensitivityArgs) -> Result<(), Error> {
    let context = Context::new(&args.common, "sensitivity")?;
    let points = points(&context.scenario);
    let variants = Variant::PAIR;
    let trials = args.trials as usize;
    let scenarios: Vec<Scenario> = points
        .iter()
        .flat_map(|point| variants.map(|variant| variant.apply(&point.scenario)))
        .collect();
    let runs: Vec<Run> = scenarios.iter().map(|row| (row, Use::Regulate)).collect();
    context.check_keys(ROWS, &runs)?;
    let goal = context.scenario.mission.goal;
    let outcomes = context.run("trials", scenarios.len() * trials, |index| {
        let scenario = &scenarios[index / trials];
        simulation::regulate(scenario, context.seed, (index % trials) as u64, |_| {})
    })?;

    let mut entries = Vec::new();
    let mut csv = Csv::new(["influence", "value", "rps", "trial", "e_m", "heading_rad"]);
    for (index, block) in outcomes.chunks(trials).enumerate() {
        let (point, variant) = (&points[index / 2], &variants[index % 2]);
        for (trial, outcome) in block.iter().enumerate() {
            let error = FinalError::of(outcome.midpoint, goal);
            csv.row::<Cell>([
                point.influence.into(),
                point.value.as_str().into(),
                variant.rps.into(),
                trial.into(),
                error.e_m.into(),
                error.heading_rad.into(),
            ]);
        }
        entries.push(entry(point, variant, block, goal));
    }
    let report = Report {
        seed: context.seed,
        trials: args.trials,
        entries,
    };
    let mut files = context.output()?;
    files.text("sensitivity.md", markdown(&report));
    files.csv("trials.csv", csv);
    context.finish(&table(&report), &report, files)
}

fn entry(point: &Point, variant: &Variant, block: &[Outcome], goal: [f64; 3]) -> Entry {
    let row = summarize(variant, block, goal);
    Entry {
        influence: point.influence,
        value: point.value.clone(),
        rps: variant.rps,
        e_m: row.e_m,
        heading_rad: row.heading_rad,
        within_3cm_3deg: row.within_3cm_3deg,
        force_rms_n: row.force_rms_n,
    }
}

/// The cells of one configuration at one point.
fn cells(entry: &Entry) -> [String; 4] {
    [
        plus_minus(100.0 * entry.e_m.mean, 100.0 * entry.e_m.sd, 2),
        format!("{:.2}", entry.heading_rad.mean_abs.to_degrees()),
        format!("{:.0} %", 100.0 * entry.within_3cm_3deg),
        format!("{:.2}", entry.force_rms_n.mean),
    ]
}

const HEADER: [&str; 10] = [
    "influence",
    "value",
    "without RPS: e (cm)",
    "heading error (°)",
    "3 cm, 3°",
    "force (N)",
    "with RPS: e (cm)",
    "heading error (°)",
    "3 cm, 3°",
    "force (N)",
];

fn rows(report: &Report) -> Vec<Vec<String>> {
    report
        .entries
        .chunks(2)
        .map(|pair| {
            let mut row = vec![pair[0].influence.to_owned(), pair[0].value.clone()];
            row.extend(pair.iter().flat_map(cells));
            row
        })
        .collect()
}

fn table(report: &Report) -> String {
    let mut table = Table::new(HEADER);
    for row in rows(report) {
        table.row(row);
    }
    format!(
        "True final posture error against what is not known of the robot; {} paired trials at each \
         point\n\n{table}",
        report.trials
    )
}

fn markdown(report: &Report) -> String {
    let mut text = format!(
        "| {} |\n|{}|\n",
        HEADER.join(" | "),
        ["---"; HEADER.len()].join("|")
    );
    for row in rows(report) {
        text += &format!("| {} |\n", row.join(" | "));
    }
    text += &format!(
        "\n`cfmmr sensitivity --trials {} --seed {}`\n",
        report.trials, report.seed
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_point_is_a_valid_scenario_and_changes_one_thing() {
        let base = Scenario::default();
        let points = points(&base);
        for point in &points {
            point.scenario.check().unwrap();
        }
        assert_eq!(points[0].scenario, base);
        // A bias of 5 mrad over 0.37 m at 0.5 mm is a strain of 6.76 µε.
        let biased = points.iter().find(|point| point.value == "5 mrad").unwrap();
        let strain = biased.scenario.world.sensors.bridge.common_sigma_strain;
        assert!((strain - 6.757e-6).abs() < 1e-9);
    }
}
