//! `eval ci`: covariance intersection of two postures.
//!
//! Input: `{"a":[x,y,phi],"A":[[3×3]],"b":[x,y,phi],"B":[[3×3]],"criterion":"det"|"trace"}`;
//! `criterion` may be left out (det). Output: `{"omega","x":[3],"P":[[3×3]]}` with
//! P⁻¹ = ω A⁻¹ + (1 − ω) B⁻¹; the third component is an angle, wrapped to [−π, π]. The criterion `trace` minimises the
//! trace of diag(1, 1, 0.2²) P.

use super::check::{self, Definite};
use super::{Kernel, parse};
use core_algos::fusion::intersection::{Config, Criterion, ExtendedEstimate};
use serde::Deserialize;
use serde_json::{Value, json};

/// Kernel of `eval ci`: runs [`core_algos::fusion::intersection`] on each line.
#[derive(Clone, Copy, Debug, Default)]
pub struct Ci;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CiCase {
    a: [f64; 3],
    #[serde(rename = "A")]
    a_covariance: [[f64; 3]; 3],
    b: [f64; 3],
    #[serde(rename = "B")]
    b_covariance: [[f64; 3]; 3],
    #[serde(default)]
    criterion: Measure,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Measure {
    #[default]
    Det,
    Trace,
}

fn estimate(
    names: [&str; 2],
    posture: &[f64; 3],
    covariance: &[[f64; 3]; 3],
) -> Result<ExtendedEstimate, String> {
    let posture = check::posture(names[0], posture)?;
    let covariance = check::covariance(names[1], covariance, Definite::Positive)?;
    for i in 0..3 {
        let sigma = covariance[i][i].sqrt();
        if !(sigma > 1e-15 && sigma < 1e15) {
            return Err(format!(
                "{}[{i}][{i}] = {:e}: must be from 1e-30 to 1e30",
                names[1], covariance[i][i]
            ));
        }
    }
    Ok(ExtendedEstimate {
        posture,
        covariance,
    })
}

impl Kernel for Ci {
    fn line(&mut self, text: &str) -> Result<Value, String> {
        let case: CiCase = parse(text)?;
        let a = estimate(["a", "A"], &case.a, &case.a_covariance)?;
        let b = estimate(["b", "B"], &case.b, &case.b_covariance)?;
        let criterion = match case.criterion {
            Measure::Det => Criterion::Determinant,
            Measure::Trace => Criterion::Trace,
        };
        let intersection = Config {
            criterion,
            ..Config::default()
        }
        .build()
        .map_err(|error| error.to_string())?;
        let fused = intersection
            .fuse_extended(&a, &b)
            .ok_or("A, B: nearly singular, or too different in size, for single precision")?;
        let x: [f32; 3] = fused.estimate.posture.into();
        Ok(json!({ "omega": fused.omega, "x": x, "P": fused.estimate.covariance }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn mirrored_ellipses_give_equal_weights() {
        let line = r#"{"a":[0,0,3.0],"A":[[0.04,0,0],[0,0.01,0],[0,0,0.01]],
            "b":[0.1,0.2,-3.0],"B":[[0.01,0,0],[0,0.04,0],[0,0,0.01]],"criterion":"det"}"#;
        let result = Ci.line(line).unwrap();
        assert!((result["omega"].as_f64().unwrap() - 0.5).abs() < 1e-6);
        // The variance is 1/(0.5·25 + 0.5·100) along x and y. Posture a has weight 0.2 along x and 0.8 along y.
        assert!((result["P"][0][0].as_f64().unwrap() - 0.016).abs() < 1e-7);
        assert!((result["P"][1][1].as_f64().unwrap() - 0.016).abs() < 1e-7);
        assert!((result["x"][0].as_f64().unwrap() - 0.08).abs() < 1e-7);
        assert!((result["x"][1].as_f64().unwrap() - 0.04).abs() < 1e-7);
        let heading = result["x"][2].as_f64().unwrap();
        assert!((heading.abs() - std::f64::consts::PI).abs() < 1e-6);
    }

    #[test]
    fn error_names_the_field() {
        let good = r#"{"a":[0,0,0],"A":[[1,0,0],[0,1,0],[0,0,1]],"b":[0,0,0],"B":[[1,0,0],[0,1,0],[0,0,1]]}"#;
        assert!(Ci.line(good).is_ok());
        for (from, to, name) in [
            (r#""A":[[1,"#, r#""A":[[-1,"#, "A[0][0] = -1"),
            (r#""B":[[1,0"#, r#""B":[[1,2"#, "B[1][0]"),
            (
                r#""B":[[1,0,0],[0"#,
                r#""B":[[1,2,0],[2"#,
                "B: must be positive definite",
            ),
            (r#""a":[0"#, r#""a":[1e39"#, "a[0]"),
            (r#""a":[0"#, r#""a":["x""#, "a[0]"),
            (r#"{"#, r#"{"criterion":"max","#, "criterion"),
            (r#"{"#, r#"{"weight":1,"#, "weight"),
        ] {
            let error = Ci.line(&good.replacen(from, to, 1)).unwrap_err();
            assert!(error.contains(name), "{error}");
        }
    }
}
