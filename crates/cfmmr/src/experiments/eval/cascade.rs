//! `eval cascade`: the cascade connection (paper eq. 5, 6) for one frame length.

use super::{Kernel, parse};
use core_algos::config::{finite, in_range};
use core_algos::control::cascade::{Config, Form, MAX_STEERING, Motion};
use serde::Deserialize;
use serde_json::{Value, json};

/// One case: velocity of O (m/s), path curvature (1/m) and its rate (1/(m s)), frame length (m).
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CascadeCase {
    v: f32,
    kappa: f32,
    kappa_dot: f32,
    length: f32,
    form: Form,
}

/// `{"v","kappa","kappa_dot","length","form"}` → `{"psi","psi_dot","v":[front,rear],"omega":[…]}`.
#[derive(Default)]
pub struct Cascade;

impl Kernel for Cascade {
    fn line(&mut self, text: &str) -> Result<Value, String> {
        let case: CascadeCase = parse(text)?;
        let named = |error: core_algos::config::ConfigError| error.to_string();
        finite("v", case.v).map_err(named)?;
        finite("kappa", case.kappa).map_err(named)?;
        finite("kappa_dot", case.kappa_dot).map_err(named)?;
        in_range("length", case.length, 1e-3, 1e3).map_err(named)?;
        let cascade = Config {
            frame_length_m: case.length,
            rigid_end_m: 0.0,
            max_steering_rad: MAX_STEERING,
            form: case.form,
        }
        .build()
        .map_err(named)?;
        let bound = cascade.max_curvature();
        in_range("kappa", case.kappa, -bound, bound).map_err(|error| {
            format!("{error} (steering up to {MAX_STEERING} rad at this length)")
        })?;

        let steering = cascade.steering_motion(case.kappa, case.kappa_dot, 0.0);
        let [(front, _), (rear, _)] = cascade.axle_twists(&Motion {
            v: case.v,
            psi: steering.psi,
            psi_rate: steering.rate,
            ..Motion::default()
        });
        let result = [steering.rate, front.v, rear.v, front.omega, rear.omega];
        if !result.iter().all(|value| value.is_finite()) {
            return Err(format!(
                "v = {}, kappa_dot = {}: the result exceeds single precision",
                case.v, case.kappa_dot
            ));
        }
        Ok(json!({
            "psi": steering.psi,
            "psi_dot": steering.rate,
            "v": [front.v, rear.v],
            "omega": [front.omega, rear.omega],
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A straight frame bends at the rate ψ̇ = κ̇ L/2; the axles turn in opposite directions.
    #[test]
    fn output_fields_have_the_axle_motions() {
        for form in ["exact", "printed"] {
            let text = json!({
                "v": 0.2, "kappa": 0.0, "kappa_dot": -4.0, "length": 0.5, "form": form,
            });
            let result = Cascade.line(&text.to_string()).unwrap();
            let want =
                json!({ "psi": 0.0, "psi_dot": -1.0, "v": [0.2, 0.2], "omega": [-1.0, 1.0] });
            for (name, want) in want.as_object().unwrap() {
                let numbers = |value: &Value| match value {
                    Value::Array(both) => both.iter().map(|v| v.as_f64().unwrap()).collect(),
                    one => vec![one.as_f64().unwrap()],
                };
                for (got, want) in numbers(&result[name]).into_iter().zip(numbers(want)) {
                    assert!((got - want).abs() < 1e-6, "{name}: {got}");
                }
            }
        }
    }

    #[test]
    fn error_names_field_and_range() {
        let error = |text: &str| Cascade.line(text).unwrap_err();
        let case = |kappa: &str, length: &str, form: &str| {
            format!(
                r#"{{"v":0.2,"kappa":{kappa},"kappa_dot":0,"length":{length},"form":"{form}"}}"#
            )
        };
        assert!(error(&case("1", "0", "exact")).starts_with("length = 0: must be"));
        assert!(error(&case("1e39", "0.37", "exact")).starts_with("kappa"));
        assert!(error(&case("1000", "0.37", "exact")).starts_with("kappa = 1000: must be"));
        assert!(error(&case("1", "0.37", "best")).starts_with("form: "));
        assert!(error(r#"{"v":0.2}"#).contains("kappa"));
    }
}
