//! `eval ekf`: the seven-state axle filter.
//!
//! First line: `{"dt","track","Q":[[7×7]],"R":[4],"R_pose":[[3×3]],"x0":[7],"P0":[[7×7]]}`: period
//! (s), distance between the wheels (m), process noise, variances of left wheel, right wheel, gyro
//! and accelerometer, covariance of the posture fix (may be left out if no fix comes), initial state
//! x, y, phi, v, phidot, vdot, phiddot and its covariance. An accepted first line gives no output; a refused first line
//! gives an error, and every later line is refused too.
//!
//! Each further line is one step: `{"left","right","gyro","accel","pose":[3]}` (m/s, m/s, rad/s,
//! m/s², (m, m, rad)); each may be null or absent. Output: `{"x":[7],"P":[[7×7]]}` after the prediction and the update
//! by the given measurements; the heading is wrapped to [−π, π]. Innovation gates are off. A bad line is refused and
//! leaves the filter unchanged.

use super::check::{self, Definite};
use super::{Kernel, KernelState};
use core_algos::fusion::ekf::{AxleFilter, Config, Fix, Measurements, ProcessNoise, State};
use serde::Deserialize;
use serde_json::{Value, json};

/// Runs [`core_algos::fusion::ekf`]: a configuration line, then one line per step.
#[derive(Clone, Debug, Default)]
pub struct Ekf {
    stage: KernelState<Box<EkfRun>>,
}

#[derive(Clone, Debug)]
struct EkfRun {
    filter: AxleFilter,
    fix: Option<Fix>,
    state: State,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Setup {
    dt: f64,
    track: f64,
    #[serde(rename = "Q")]
    q: [[f64; 7]; 7],
    #[serde(rename = "R")]
    r: [f64; 4],
    #[serde(rename = "R_pose", default)]
    r_pose: Option<[[f64; 3]; 3]>,
    x0: [f64; 7],
    #[serde(rename = "P0")]
    p0: [[f64; 7]; 7],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct EkfStep {
    #[serde(default)]
    left: Option<f64>,
    #[serde(default)]
    right: Option<f64>,
    #[serde(default)]
    gyro: Option<f64>,
    #[serde(default)]
    accel: Option<f64>,
    #[serde(default)]
    pose: Option<[f64; 3]>,
}

impl EkfRun {
    fn new(setup: &Setup) -> Result<Self, String> {
        let mut sigmas = [0.0; 4];
        for k in 0..4 {
            let field = format!("R[{k}]");
            check::positive(&field, setup.r[k])?;
            sigmas[k] = check::positive(&field, setup.r[k].sqrt())?;
        }
        let q = check::covariance("Q", &setup.q, Definite::Semi)?;
        let p0 = check::covariance("P0", &setup.p0, Definite::Positive)?;
        let config = Config {
            period_s: check::positive("dt", setup.dt)?,
            track_m: check::positive("track", setup.track)?,
            left_sigma_m_s: sigmas[0],
            right_sigma_m_s: sigmas[1],
            gyro_sigma_rad_s: sigmas[2],
            accelerometer_sigma_m_s2: sigmas[3],
            innovation_gate: None,
            fix_gate: None,
            ..Config::default()
        };
        let filter = config
            .build_with(ProcessNoise::Fixed(check::narrow(&q)))
            .map_err(|error| error.to_string())?;
        let fix = match &setup.r_pose {
            None => None,
            Some(r) => {
                let r = check::covariance("R_pose", r, Definite::Positive)?;
                Some(
                    Fix::new(&check::narrow(&r))
                        .ok_or("R_pose: must be positive definite in single precision")?,
                )
            }
        };
        let mut x0 = check::vector("x0", &setup.x0)?;
        let [x, y, phi, ..] = setup.x0;
        x0[2] = check::posture("x0", &[x, y, phi])?[2] as f32;
        Ok(Self {
            filter,
            fix,
            state: State::from_parts(x0, &check::narrow(&p0)),
        })
    }

    fn step(&mut self, step: &EkfStep) -> Result<Value, String> {
        let sample = |field: &str, value: Option<f64>| {
            value.map(|value| check::number(field, value)).transpose()
        };
        let measurements = Measurements {
            left_m_s: sample("left", step.left)?,
            right_m_s: sample("right", step.right)?,
            gyro_rad_s: sample("gyro", step.gyro)?,
            acceleration_m_s2: sample("accel", step.accel)?,
        };
        let pose = match &step.pose {
            None => None,
            Some(pose) => {
                let fix = self.fix.ok_or("pose: needs R_pose in the first line")?;
                Some((check::narrow_posture("pose", pose)?, fix))
            }
        };
        let mut state = self.state;
        self.filter.step(&mut state, &measurements);
        if let Some((posture, fix)) = pose {
            self.filter.update_fix(&mut state, &posture, &fix);
        }
        // The covariance is stored as factors; their product can overflow though the factors are finite.
        let covariance = state.covariance().wide_matrix();
        if !state.is_finite() || !covariance.iter().flatten().all(|entry| entry.is_finite()) {
            return Err("the state exceeds the range of single precision".to_owned());
        }
        self.state = state;
        let [x, y, phi] = state.precise_posture();
        let twist = state.twist();
        let [v_dot, omega_dot] = state.accelerations();
        Ok(json!({
            "x": [
                x, y, phi,
                f64::from(twist.v), f64::from(twist.omega), f64::from(v_dot), f64::from(omega_dot),
            ],
            "P": covariance,
        }))
    }
}

impl Kernel for Ekf {
    fn line(&mut self, text: &str) -> Result<Value, String> {
        let start = |setup: &Setup| EkfRun::new(setup).map(Box::new);
        self.stage.line(text, start, |run, step| run.step(step))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn diagonal<const N: usize>(values: [f64; N]) -> Vec<Vec<f64>> {
        let row = |i: usize| {
            (0..N)
                .map(|j| if i == j { values[i] } else { 0.0 })
                .collect()
        };
        (0..N).map(row).collect()
    }

    fn setup() -> Value {
        json!({
            "dt": 0.01, "track": 0.3,
            "Q": diagonal([1e-8, 1e-8, 1e-8, 1e-6, 1e-6, 1e-3, 1e-3]),
            "R": [1e-4, 1e-4, 1e-5, 1e-2],
            "R_pose": diagonal([1e-4, 1e-4, 1e-4]),
            "x0": [1.0, 2.0, 0.5, 0.2, 0.0, 0.0, 0.0],
            "P0": diagonal([1e-4; 7]),
        })
    }

    fn configured() -> Ekf {
        let mut ekf = Ekf::default();
        assert_eq!(ekf.line(&setup().to_string()), Ok(Value::Null));
        ekf
    }

    fn number(value: &Value) -> f64 {
        value.as_f64().unwrap()
    }

    #[test]
    fn estimates_move_in_the_direction_of_the_measurements() {
        let base = configured().line("{}").unwrap();
        let mut right = configured();
        let result = right.line(r#"{"right":0.3,"left":null}"#).unwrap();
        assert!(number(&result["x"][3]) > number(&base["x"][3]));
        assert!(number(&result["x"][4]) > 0.0);
        let result = configured().line(r#"{"left":0.3}"#).unwrap();
        assert!(number(&result["x"][4]) < 0.0);
        let result = configured().line(r#"{"gyro":-1,"accel":1}"#).unwrap();
        assert!(number(&result["x"][4]) < 0.0 && number(&result["x"][5]) > 0.0);
        let result = configured().line(r#"{"pose":[1.1,2.0,0.5]}"#).unwrap();
        assert!(number(&result["x"][0]) > number(&base["x"][0]) + 0.04);
    }

    #[test]
    fn bad_step_leaves_the_filter_unchanged() {
        let (mut clean, mut dirty) = (configured(), configured());
        for bad in [
            r#"{"left":1e300}"#,
            r#"{"speed":1}"#,
            "nonsense",
            r#"{"pose":[1,2]}"#,
        ] {
            assert!(dirty.line(bad).is_err());
        }
        let step = r#"{"left":0.2,"right":0.2,"gyro":0,"accel":0}"#;
        assert_eq!(clean.line(step), dirty.line(step));
    }

    #[test]
    fn bad_first_line_names_the_field_and_later_lines_fail() {
        for (entry, value, field) in [
            ("/Q/0/1", json!(1e-8), "Q[1][0]"),
            ("/P0/3/3", json!(0.0), "P0[3][3]"),
            ("/dt", json!(0.0), "dt = 0"),
            ("/track", json!(-0.3), "track = -0.3"),
            ("/R/2", json!(-1.0), "R[2] = -1"),
            ("/R_pose/0/0", json!(-1.0), "R_pose[0][0]"),
            ("/x0/6", json!("a"), "x0[6]"),
        ] {
            let mut bad = setup();
            *bad.pointer_mut(entry).unwrap() = value;
            let mut ekf = Ekf::default();
            let error = ekf.line(&bad.to_string()).unwrap_err();
            assert!(error.contains(field), "{error}");
            assert!(ekf.line("{}").is_err());
            assert!(ekf.line(&setup().to_string()).is_err());
        }
        let mut bare = setup();
        bare.as_object_mut().unwrap().remove("R_pose");
        let mut ekf = Ekf::default();
        ekf.line(&bare.to_string()).unwrap();
        assert!(ekf.line("{}").is_ok());
        assert!(
            ekf.line(r#"{"pose":[1,2,0]}"#)
                .unwrap_err()
                .contains("R_pose")
        );
    }
}
