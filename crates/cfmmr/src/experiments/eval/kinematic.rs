//! `eval kinematic`: equation 4, before limits.
//!
//! Input: `{"posture":[x,y,phi],"reference":[x,y,phi],"v_r","kappa_r","r","epsilon","k1","k2",
//! "form":"derived"|"printed"}`; `form` may be left out (derived). Output: `{"v","kappa","phi_dot"}`.
//!
//! The denominator has no floor. Three limits act near singular points only and keep the result finite:
//! e is at least 1e-6 m in `1/e`, the denominator has magnitude at least 1e-9 m, and the divisor of κ
//! has magnitude at least 1e-6 m/s; signs are kept (+ at 0). So at v = 0, κ is 1e6 s/m times the yaw
//! rate, and 0 if the yaw rate is 0. At e = 0 the line of sight is along the reference heading. A result
//! beyond `f32` is replaced by rest (all 0).

use super::{Kernel, check, parse};
use core_algos::control::kinematic::{Config, Form, PolarError};
use serde::Deserialize;
use serde_json::{Value, json};

/// Kernel of `eval kinematic`: runs [`core_algos::control::kinematic::Law::command`] on each line.
#[derive(Clone, Copy, Debug, Default)]
pub struct Kinematic;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct KinematicCase {
    posture: [f64; 3],
    reference: [f64; 3],
    v_r: f32,
    kappa_r: f32,
    r: f32,
    epsilon: f32,
    k1: f32,
    k2: f32,
    #[serde(default)]
    form: Form,
}

impl Kernel for Kinematic {
    fn line(&mut self, text: &str) -> Result<Value, String> {
        let case: KinematicCase = parse(text)?;
        let posture = check::narrow_posture("posture", &case.posture)?;
        let reference = check::narrow_posture("reference", &case.reference)?;
        let finite = [
            ("v_r", case.v_r.is_finite()),
            ("kappa_r", case.kappa_r.is_finite()),
        ];
        if let Some((name, _)) = finite.into_iter().find(|(_, finite)| !finite) {
            return Err(format!("{name}: must be finite"));
        }
        let law = Config {
            circle_radius_m: case.r,
            epsilon: case.epsilon,
            approach_gain_m_s: case.k1,
            heading_gain_rad_s: case.k2,
            form: case.form,
            denominator_floor: 0.0,
            ..Config::default()
        }
        .build()
        .map_err(|error| {
            let field = match error.field {
                "circle_radius_m" => "r",
                "approach_gain_m_s" => "k1",
                "heading_gain_rad_s" => "k2",
                field => field,
            };
            format!("{field} = {}: must be {}", error.value, error.allowed)
        })?;
        let error = PolarError::between(posture, reference);
        let command = law.command(error, case.v_r, case.kappa_r);
        Ok(json!({ "v": command.v, "kappa": command.kappa, "phi_dot": command.phi_dot }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Equation 4 in f64 and Cartesian terms: sines and cosines of θ and α from dot and cross
    /// products, `ζ − cos 2θ` as printed.
    fn reference_command(case: &Value) -> Option<[f64; 3]> {
        let number = |name: &str| f64::from(case[name].as_f64().unwrap() as f32);
        let vector = |name: &str, k: usize| f64::from(case[name][k].as_f64().unwrap() as f32);
        let (dx, dy) = (
            vector("reference", 0) - vector("posture", 0),
            vector("reference", 1) - vector("posture", 1),
        );
        let e = dx.hypot(dy);
        let angles = |name: &str| {
            let phi = vector(name, 2);
            let sin = (dy * phi.cos() - dx * phi.sin()) / e;
            let cos = (dx * phi.cos() + dy * phi.sin()) / e;
            (sin, cos, sin.atan2(cos))
        };
        let (sin_t, cos_t, theta) = angles("reference");
        let (sin_a, cos_a, alpha) = angles("posture");
        let (r, k1, k2) = (number("r"), number("k1"), number("k2"));
        let (v_r, kappa_r) = (number("v_r"), number("kappa_r"));
        let root = (1.0 + number("epsilon") - (2.0 * theta).cos()).sqrt();
        let sin2 = (2.0 * theta).sin();
        let r2 = r * 2f64.sqrt();
        let numerator = k1 * e * root * (e - r2 * root).tanh()
            + v_r * e * cos_t * root
            + v_r * r2 * sin2 * (sin_t + kappa_r * e);
        let tangential = if case["form"] == "printed" {
            1.0
        } else {
            cos_a
        };
        let denominator = e * root * tangential + r2 * sin2 * sin_a;
        let v = numerator / denominator;
        let phi_dot =
            k2 * (theta + alpha).tanh() + 2.0 / e * (v * sin_a - v_r * sin_t) - v_r * kappa_r;
        let ordinary = e > 0.05
            && denominator.abs() > 0.05 * e
            && v.abs() > 0.02
            && theta.abs() < 3.1
            && alpha.abs() < 3.1;
        ordinary.then_some([v, phi_dot / v, phi_dot])
    }

    properties! {
        #[test]
        fn agrees_with_the_equation_in_f64(
            posture in prop::array::uniform3(-2.0..2.0f64),
            reference in prop::array::uniform3(-2.0..2.0f64),
            v_r in -0.5..0.5f64, kappa_r in -3.0..3.0f64, r in 0.05..0.5f64, printed: bool,
        ) {
            let form = if printed { "printed" } else { "derived" };
            let case = json!({
                "posture": posture, "reference": reference, "v_r": v_r, "kappa_r": kappa_r,
                "r": r, "epsilon": 1e-3, "k1": 1.5, "k2": 2.0, "form": form,
            });
            let expected = reference_command(&case);
            prop_assume!(expected.is_some());
            let [v, kappa, phi_dot] = expected.unwrap();
            let out = Kinematic.line(&case.to_string()).unwrap();
            for (name, expected) in [("v", v), ("kappa", kappa), ("phi_dot", phi_dot)] {
                let got = out[name].as_f64().unwrap();
                // Terms of order v/e may cancel: the tolerance scales with the terms.
                let scale = expected.abs() + 1.0 + v.abs();
                // κ is a quotient: a small v amplifies the errors.
                let scale = if name == "kappa" { scale / v.abs().min(1.0) } else { scale };
                prop_assert!((got - expected).abs() < 2e-5 * scale, "{name}: {got} {expected}");
            }
        }
    }

    #[test]
    fn error_has_the_field_name_of_the_input() {
        let case = |r: f64, form: &str| {
            json!({
                "posture": [0, 0, 0], "reference": [1, 0, 0], "v_r": 0, "kappa_r": 0, "r": r,
                "epsilon": 1e-3, "k1": 1.5, "k2": 2.0, "form": form,
            })
            .to_string()
        };
        assert!(
            Kinematic
                .line(&case(-1.0, "derived"))
                .unwrap_err()
                .starts_with("r = -1")
        );
        assert!(
            Kinematic
                .line(&case(0.2, "other"))
                .unwrap_err()
                .starts_with("form")
        );
        assert!(Kinematic.line("{}").unwrap_err().contains("posture"));
    }
}
