//! `eval rps`: posture from the strains of one instant, by the code of the beam board.
//!
//! In: `{"length", "half_thickness", "rigid_root", "rigid_tip", "gauges": […], "strain": […],
//! "method": "piecewise" | "quadrature" | "elastica", "segments": 100}`. Metres; `length` is the
//! flexible length without the rigid ends, `gauges` are positions from its root, ascending;
//! `rigid_root` and `rigid_tip` (default 0), `method` (default elastica) and `segments` (default
//! 100, used by piecewise only) may be left out.
//!
//! Out: `{"x", "y", "phi", "cov": [[3×3]]}`, the end posture with the rigid ends in the root frame
//! (heading not wrapped) and its covariance under the default gauge uncertainties; for the elastica
//! also `"chi_square"` and `"wrench"` `[fx, fy, root moment, tip moment]` for EI = 0.833 N m².

use super::{Kernel, parse};
use core_algos::beam::sensor::PostureSolver;
use core_algos::beam::strip::{Config, MAX_TURN, MIN_GAUGES};
use core_algos::beam::{GaugeMask, MAX_GAUGES, Method, PerGauge};
use core_algos::config::ConfigError;
use serde::Deserialize;
use serde_json::{Value, json};

/// Kernel of `eval rps`: runs [`core_algos::beam::sensor::PostureSolver`] on each line.
#[derive(Clone, Copy, Debug, Default)]
pub struct Rps;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RpsCase {
    length: f64,
    half_thickness: f64,
    #[serde(default)]
    rigid_root: f64,
    #[serde(default)]
    rigid_tip: f64,
    gauges: Vec<f64>,
    strain: Vec<f64>,
    #[serde(default)]
    method: Method,
    #[serde(default = "default_segments")]
    segments: u64,
}

fn default_segments() -> u64 {
    100
}

/// Text of a configuration error, with the name of the field in the input.
fn input_name(error: &ConfigError) -> String {
    let name = match error.field {
        "length_m" => "length",
        "half_thickness_m" => "half_thickness",
        "rigid_root_m" => "rigid_root",
        "rigid_tip_m" => "rigid_tip",
        "gauges_m" => "gauges",
        other => other,
    };
    format!("{name} = {}: must be {}", error.value, error.allowed)
}

impl RpsCase {
    fn solver(&self) -> Result<PostureSolver, String> {
        let count = self.gauges.len();
        let narrow: Vec<f32> = self.gauges.iter().map(|g| *g as f32).collect();
        let gauges = PerGauge::new(&narrow)
            .filter(|gauges| gauges.count() >= MIN_GAUGES as usize)
            .ok_or(format!(
                "gauges = {count} positions: must be {MIN_GAUGES} to {MAX_GAUGES}"
            ))?;
        let config = Config {
            length_m: self.length as f32,
            half_thickness_m: self.half_thickness as f32,
            rigid_root_m: self.rigid_root as f32,
            rigid_tip_m: self.rigid_tip as f32,
            gauges_m: gauges,
            ..Config::default()
        };
        let strip = config.build().map_err(|error| input_name(&error))?;
        let segments = u16::try_from(self.segments)
            .ok()
            .filter(|segments| (1..=10_000).contains(segments))
            .ok_or(format!(
                "segments = {}: must be a whole number from 1 to 10000",
                self.segments
            ))?;
        PostureSolver::new(strip, self.method, segments).map_err(|error| input_name(&error))
    }

    fn strains(&self) -> Result<[f32; MAX_GAUGES], String> {
        if self.strain.len() != self.gauges.len() {
            return Err(format!(
                "strain = {} values: must be one for each of the {} gauges",
                self.strain.len(),
                self.gauges.len()
            ));
        }
        let limit = f64::from(MAX_TURN) * self.half_thickness / self.length;
        let mut strains = [0.0; MAX_GAUGES];
        for (i, (slot, strain)) in strains.iter_mut().zip(&self.strain).enumerate() {
            if !(strain.abs() <= limit) {
                return Err(format!(
                    "strain[{i}] = {strain:e}: must be a number from {:e} to {limit:e} \
                     (length × curvature at most {MAX_TURN} rad)",
                    -limit
                ));
            }
            *slot = *strain as f32;
        }
        Ok(strains)
    }
}

impl Kernel for Rps {
    fn line(&mut self, text: &str) -> Result<Value, String> {
        let case: RpsCase = parse(text)?;
        let solver = case.solver()?;
        let strains = case.strains()?;
        let all = GaugeMask::first(case.gauges.len());
        let solution = solver
            .solve(&strains, all)
            .ok_or("strain: no finite posture fits these readings")?;
        if solution.method != case.method {
            return Err("strain: no elastica fits these readings".into());
        }
        let posture = solution.relative.posture;
        let mut result = json!({
            "x": posture.x,
            "y": posture.y,
            "phi": posture.phi,
            "cov": solution.relative.covariance,
        });
        if let Some(wrench) = solution.wrench {
            result["wrench"] = json!([wrench.fx, wrench.fy, wrench.root_moment, wrench.tip_moment]);
            result["chi_square"] = json!(solution.chi_square);
        }
        Ok(result)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ask(text: &str) -> Result<Value, String> {
        Rps.line(text)
    }

    fn case(change: impl Fn(&mut Value)) -> Result<Value, String> {
        let mut case = json!({
            "length": 0.36, "half_thickness": 0.0005, "rigid_root": 0.01, "rigid_tip": 0.02,
            "gauges": [0.02, 0.1, 0.18, 0.26, 0.34],
            "strain": [0.001, 0.001, 0.001, 0.001, 0.001],
            "method": "piecewise", "segments": 100,
        });
        change(&mut case);
        ask(&case.to_string())
    }

    #[test]
    fn every_method_solves_a_circle_with_rigid_ends() {
        let phi = 2.0f64 * 0.36;
        let x = 0.01 + phi.sin() / 2.0 + 0.02 * phi.cos();
        let y = (1.0 - phi.cos()) / 2.0 + 0.02 * phi.sin();
        for method in ["piecewise", "quadrature", "elastica"] {
            let out = case(|c| c["method"] = json!(method)).unwrap();
            for (name, expected) in [("x", x), ("y", y), ("phi", phi)] {
                let found = out[name].as_f64().unwrap();
                assert!((found - expected).abs() < 1e-6, "{method} {name} {found}");
            }
            for i in 0..3 {
                assert!(out["cov"][i][i].as_f64().unwrap() > 0.0);
                for j in 0..3 {
                    assert_eq!(out["cov"][i][j], out["cov"][j][i]);
                }
            }
        }
    }

    #[test]
    fn omitted_fields_have_their_defaults() {
        let short =
            ask(r#"{"length":0.3,"half_thickness":1e-3,"gauges":[0.1,0.2],"strain":[1e-3,1e-3]}"#)
                .unwrap();
        assert!((short["phi"].as_f64().unwrap() - 0.3).abs() < 1e-6);
        assert!(short["wrench"].is_array());
    }

    #[test]
    fn error_names_field_value_and_range() {
        for (entry, value, expected) in [
            ("/length", json!(0), "length = 0: must be a number from"),
            ("/length", json!(1e300), "length = inf"),
            ("/half_thickness", json!(0), "half_thickness = 0"),
            ("/half_thickness", json!(-1), "half_thickness = -1"),
            ("/rigid_tip", json!(-1.0), "rigid_tip = -1"),
            (
                "/gauges",
                json!([0.02, 0.18, 0.1, 0.26, 0.34]),
                "gauges = 0.1: must be greater",
            ),
            (
                "/gauges/4",
                json!(0.4),
                "gauges = 0.4: must be a number from 0 to 0.36",
            ),
            ("/gauges", json!([0.1]), "gauges = 1 positions"),
            ("/gauges", json!(vec![0.1; 9]), "gauges = 9 positions"),
            ("/strain", json!([0.0, 0.0]), "strain = 2 values"),
            ("/strain/1", json!(1e30), "strain[1] = 1e30"),
            ("/strain/1", Value::Null, "strain"),
            ("/segments", json!(0), "segments = 0"),
            ("/segments", json!(1.5), "segments"),
            ("/method", json!("spline"), "method"),
        ] {
            let error = case(|c| *c.pointer_mut(entry).unwrap() = value.clone()).unwrap_err();
            assert!(error.contains(expected), "{expected}: {error}");
        }
        let error = case(|c| c["lenght"] = json!(1)).unwrap_err();
        assert!(error.contains("unknown field `lenght`"), "{error}");
        assert!(ask(r#"{"length": NaN}"#).is_err());
        assert!(ask(r#"{"length": 1e999}"#).is_err());
    }
}
