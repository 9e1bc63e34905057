//! `eval cascade`: the cascade connection (paper eq. 5, 6) for one frame length.

use super::{Kernel, parse};
use core_algos::config::{finite, in_range};
use core_algos::control::cascade::{Config, Form, MAX_STEERING, Motion};
use serde::Deserialize;
use serde_json::{Value, json};

/// One case: velocity of O (m/s), path curvature (1/m) and its rate (1/(m s)), frame length (m).
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Case {
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
        let case: Case = parse(text)?;
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

    /// Eq. 5 and 6 in `f64`, ψ by bisection.
    fn expected(v: f64, kappa: f64, kappa_dot: f64, length: f64, exact: bool) -> [f64; 6] {
        let (mut low, mut high) = (-1.57f64, 1.57f64);
        for _ in 0..80 {
            let mid = 0.5 * (low + high);
            if 2.0 * mid / (length * mid.cos()) < kappa {
                low = mid;
            } else {
                high = mid;
            }
        }
        let psi = low;
        let h = 1e-5;
        let relation = |p: f64| 2.0 * p / (length * p.cos());
        let psi_dot = kappa_dot * 2.0 * h / (relation(psi + h) - relation(psi - h));
        let term = if exact {
            let chord = |p: f64| {
                if p == 0.0 {
                    length
                } else {
                    length * p.sin() / p
                }
            };
            let rate = (chord(psi + h) - chord(psi - h)) / (2.0 * h) * psi_dot;
            0.5 * rate / psi.cos()
        } else {
            -length * psi * psi_dot / 6.0
        };
        let common = v / psi.cos();
        [
            psi,
            psi_dot,
            common + term,
            common - term,
            v * kappa + psi_dot,
            v * kappa - psi_dot,
        ]
    }

    #[test]
    fn both_forms_agree_with_double_precision() {
        for (v, kappa, kappa_dot, length) in [
            (0.25, 3.0, 0.5, 0.37),
            (-0.2, -1.5, 2.0, 0.37),
            (0.0, 0.0, -4.0, 0.5),
            (0.25, 1e-4, 0.1, 0.37),
            (0.1, 10.0, -1.0, 0.3),
        ] {
            for form in ["exact", "printed"] {
                let text = json!({
                    "v": v, "kappa": kappa, "kappa_dot": kappa_dot, "length": length, "form": form,
                });
                let result = Cascade.line(&text.to_string()).unwrap();
                let got = [
                    &result["psi"],
                    &result["psi_dot"],
                    &result["v"][0],
                    &result["v"][1],
                    &result["omega"][0],
                    &result["omega"][1],
                ];
                let want = expected(v, kappa, kappa_dot, length, form == "exact");
                for (got, want) in got.iter().zip(want) {
                    let gap = (got.as_f64().unwrap() - want).abs();
                    assert!(gap < 2e-6 * want.abs().max(1.0), "{got} {want}");
                }
            }
        }
    }

    #[test]
    fn bad_input_names_field_and_range() {
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
