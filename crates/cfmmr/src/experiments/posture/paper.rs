//! The paper's robot: its measured figures, and its algorithms in the world `paper`.

use super::report::Row;
use super::variant::Variant;
use core_algos::control::regulator::Strategy;
use host_sim::base::error::Error;
use host_sim::scenario::Scenario;
use output::table::{Table, plus_minus};

/// The paper's configurations: encoders alone, and the sensor with its fusion.
pub const ROWS: [Variant; 2] = [Variant::ALL[0], Variant::ALL[2]];

/// Mean and standard deviation of e (cm), θ and α (°): Table 1 of the paper, in the order of [`ROWS`].
pub const TABLE_1: [[[f64; 2]; 3]; 2] = [
    [[10.6, 3.4], [-31.7, 9.4], [-45.4, 12.2]],
    [[9.5, 2.1], [-13.3, 14.2], [-21.6, 14.9]],
];

/// Note below the table of the paper's robot.
pub const FIXED: &str = "This table is the paper's experiment with the trials and the seed of the command: from \
                         -1.342,-1.342,0 in world paper. --from, --world, --scenario and --set do not change it.";

/// The paper's algorithms in the world `paper`, in the order of [`ROWS`].
pub fn scenarios() -> Result<[Scenario; 2], Error> {
    let mut scenario = Scenario::in_world(Some("paper"))?;
    scenario.robot.lead.regulator.strategy = Strategy::PaperLaw;
    Ok(ROWS.map(|variant| variant.apply(&scenario)))
}

/// e (cm), θ and α (°) of a row as mean and standard deviation.
pub fn figures(row: &Row) -> [[f64; 2]; 3] {
    let degrees = |angle: f64| angle.to_degrees();
    [
        [100.0 * row.e_m.mean, 100.0 * row.e_m.sd],
        [row.theta_rad.mean, row.theta_rad.sd].map(degrees),
        [row.alpha_rad.mean, row.alpha_rad.sd].map(degrees),
    ]
}

/// Figures of the paper beside those of its algorithms in the world `paper`.
pub fn table(rows: &[Row]) -> String {
    let mut table = Table::new([
        "the paper's robot",
        "goal error e (cm)",
        "θ (°)",
        "α (°)",
        "x, y (cm)",
        "φ (°)",
        "ends",
    ]);
    for ((variant, measured), row) in ROWS.iter().zip(TABLE_1).zip(rows) {
        let name = variant.sensors();
        let simulated = ("simulated", figures(row), row.ends.text());
        for (whose, figures, ends) in [("measured", measured, String::new()), simulated] {
            let [[e, _], [theta, _], [alpha, _]] = figures;
            let (sin, cos) = libm::sincos(theta.to_radians());
            let mut cells = vec![format!("{name}, {whose}")];
            cells.extend(figures.map(|[mean, sd]| plus_minus(mean, sd, 1)));
            // The mean posture, from the means of its polar errors.
            cells.push(format!("{:.1}, {:.1}", -e * cos, -e * sin));
            cells.push(format!("{:.1}", theta - alpha));
            cells.push(ends);
            table.row(cells);
        }
    }
    table.to_string()
}
