//! `eval frame`: equilibrium of the plant's strip (`f64`) for a given posture of its end.
//!
//! Input: `{"length", "ei", "ea", "pose": [x, y, angle], "seed_curvature": [5]}`: m, N m², N; pose
//! of the end in the root frame (m, m, rad, the whole turn of the strip); curvature (1/m) at 0.1,
//! 0.3, 0.5, 0.7 and 0.9 of the length, which selects one of several branches.
//!
//! Output: `{"wrench_end": [Fx, Fy, M], "root_moment", "curvature": [5], "stable"}`: the wrench
//! (N, N, N m) that the environment exerts on the end, in the root frame; the bending moment at
//! the root, M + x·Fy − y·Fx, positive where the strip bends left, which the strip exerts
//! on its root support; the curvature (1/m) at the five places; true if the equilibrium is stable
//! with the end held.

use super::{Kernel, parse};
use plant::frame::Strip;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Positions of seed and output curvatures, as fractions of the length.
const POSITIONS: [f64; 5] = [0.1, 0.3, 0.5, 0.7, 0.9];

/// Kernel of `eval frame`: equilibrium of the plant's strip for a given posture of its end.
pub struct Frame;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct FrameCase {
    length: f64,
    ei: f64,
    ea: f64,
    pose: [f64; 3],
    seed_curvature: [f64; 5],
}

#[derive(Serialize)]
struct FrameSolution {
    wrench_end: [f64; 3],
    root_moment: f64,
    curvature: [f64; 5],
    stable: bool,
}

fn within(field: &str, value: f64, low: f64, high: f64) -> Result<(), String> {
    if value >= low && value <= high {
        Ok(())
    } else {
        Err(format!(
            "{field} = {value}: must be a number from {low} to {high}"
        ))
    }
}

impl Kernel for Frame {
    fn line(&mut self, text: &str) -> Result<Value, String> {
        let case: FrameCase = parse(text)?;
        let solution = solve(&case)?;
        serde_json::to_value(solution).map_err(|error| error.to_string())
    }
}

fn solve(case: &FrameCase) -> Result<FrameSolution, String> {
    within("length", case.length, 1e-3, 1e3)?;
    within("ei", case.ei, 1e-9, 1e9)?;
    let slender = case.ei / (case.length * case.length);
    within("ea", case.ea, 1e2 * slender, 1e9 * slender)?;
    let [x, y, angle] = case.pose;
    within("pose[0]", x, -1.1 * case.length, 1.1 * case.length)?;
    within("pose[1]", y, -1.1 * case.length, 1.1 * case.length)?;
    within("pose[2]", angle, -20.0, 20.0)?;
    let chord = libm::hypot(x, y);
    if chord > 1.05 * case.length {
        return Err(format!(
            "pose = {:?}: the distance {chord} m from the root exceeds the length of the strip, {} m",
            case.pose, case.length
        ));
    }
    for (i, k) in case.seed_curvature.into_iter().enumerate() {
        let most = 50.0 / case.length;
        within(&format!("seed_curvature[{i}]"), k, -most, most)?;
    }
    let strip = Strip::new(case.length, case.ei, case.ea, 0.0);
    let (equilibrium, stable) = strip
        .find(case.pose, &POSITIONS, &case.seed_curvature)
        .ok_or("pose: no equilibrium on the branch of seed_curvature")?;
    Ok(FrameSolution {
        wrench_end: strip.wrench(&equilibrium),
        root_moment: strip.root_moment(&equilibrium),
        curvature: POSITIONS.map(|f| strip.elastic_curvature(&equilibrium, f * case.length)),
        stable,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn ask(case: Value) -> Result<Value, String> {
        Frame.line(&case.to_string())
    }

    fn arc(turn: f64) -> Value {
        let (length, radius) = (0.4, 0.4 / turn);
        json!({
            "length": length, "ei": 0.5, "ea": 1e7,
            "pose": [radius * turn.sin(), radius * (1.0 - turn.cos()), turn],
            "seed_curvature": vec![1.0 / radius; 5],
        })
    }

    #[test]
    fn arc_needs_a_moment_and_no_force() {
        for turn in [-2.0, -0.3, 0.7, 3.0] {
            let solution = ask(arc(turn)).unwrap();
            let expected = 0.5 * turn / 0.4;
            let wrench: [f64; 3] = serde_json::from_value(solution["wrench_end"].clone()).unwrap();
            assert!(wrench[0].abs() < 1e-6 && wrench[1].abs() < 1e-6);
            assert!((wrench[2] - expected).abs() < 1e-9);
            assert!((solution["root_moment"].as_f64().unwrap() - expected).abs() < 1e-7);
            assert!((solution["curvature"][3].as_f64().unwrap() - turn / 0.4).abs() < 1e-6);
            assert_eq!(solution["stable"], true);
        }
    }

    #[test]
    fn error_names_the_field() {
        let cases = [
            ("length", json!(0.0)),
            ("length", json!(null)),
            ("ei", json!(-1.0)),
            ("ea", json!(0.0)),
            ("pose", json!([0.3, 0.0])),
            ("pose", json!([0.9, 0.0, 0.0])),
            ("pose", json!([0.39, 0.39, 0.0])),
            ("seed_curvature", json!([0.0, 0.0, 0.0, 0.0])),
            ("seed_curvature", json!([0.0, 0.0, 0.0, 0.0, 1e9])),
        ];
        for (field, value) in cases {
            let mut case = arc(0.5);
            case[field] = value;
            let error = ask(case).unwrap_err();
            assert!(error.starts_with(field), "{field}: {error}");
        }
        let mut case = arc(0.5);
        case["mass"] = json!(1.0);
        assert!(ask(case).unwrap_err().contains("mass"));
    }
}
