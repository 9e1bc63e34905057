//! `eval ipec`: internal posture error correction; each line runs the whole interval algorithm.
//!
//! First line: `{"track","axle1":[x,y,phi],"axle2":[x,y,phi],"sigma":{"wheel","r_y","r_phi"}}`:
//! distance between the wheels (m), start postures of front and rear axle, standard deviations of a
//! wheel's advance in an interval (m) and of the relative posture (m, rad). An accepted first line gives
//! no output; a refused first line gives an error, and every later line is refused too.
//!
//! Each further line is one interval: `{"d":[left1,right1,left2,right2],"r":[x,y,phi]}`: advance of
//! the wheels (m), and axle 2 in axle 1's frame (m, m, rad), at least 1 mm away. Output:
//! `{"axle1":[3],"axle2":[3],"var_beta"}`: postures, headings wrapped to [−π, π], and the variance
//! σ_β² (rad²) accumulated since the start.

use super::{Kernel, KernelState, check};
use core_algos::fusion::ipec::{Config, Ipec as Algorithm, MIN_BASELINE_M, State};
use core_algos::math::Posture;
use serde::Deserialize;
use serde_json::{Value, json};

/// Runs [`core_algos::fusion::ipec`]: a configuration line, then one line per interval.
#[derive(Clone, Debug, Default)]
pub struct Ipec {
    stage: KernelState<(Algorithm, State)>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Setup {
    track: f64,
    axle1: [f64; 3],
    axle2: [f64; 3],
    sigma: Sigma,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Sigma {
    wheel: f64,
    r_y: f64,
    r_phi: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Interval {
    d: [f64; 4],
    r: [f64; 3],
}

fn start(setup: &Setup) -> Result<(Algorithm, State), String> {
    let algorithm = Config {
        track_m: check::positive("track", setup.track)?,
        wheel_sigma_m: check::non_negative("sigma.wheel", setup.sigma.wheel)?,
        lateral_sigma_m: check::non_negative("sigma.r_y", setup.sigma.r_y)?,
        heading_sigma_rad: check::non_negative("sigma.r_phi", setup.sigma.r_phi)?,
        ..Config::default()
    }
    .build()
    .map_err(|error| error.to_string())?;
    let axle1 = check::narrow_posture("axle1", &setup.axle1)?;
    let axle2 = check::narrow_posture("axle2", &setup.axle2)?;
    if !(axle1.distance(axle2) >= MIN_BASELINE_M) {
        return Err(format!(
            "axle2: must be at least {MIN_BASELINE_M} m away from axle1"
        ));
    }
    Ok((algorithm, State::new(axle1, axle2)))
}

fn step((algorithm, state): &mut (Algorithm, State), interval: &Interval) -> Result<Value, String> {
    let advance = check::vector("d", &interval.d)?;
    let r = Posture::from(check::vector("r", &interval.r)?);
    if !(r.distance(Posture::ORIGIN) >= MIN_BASELINE_M) {
        return Err(format!(
            "r = [{}, {}, …]: must be at least {MIN_BASELINE_M} m long",
            interval.r[0], interval.r[1]
        ));
    }
    let mut next = *state;
    if algorithm.step(&mut next, &advance, &r).is_none() {
        return Err("d: moves both axles to one point, so the heading is undefined".into());
    }
    let [axle1, axle2] = next.precise_postures();
    if !axle1.iter().chain(&axle2).all(|x| x.is_finite()) || !next.variance.is_finite() {
        return Err("d: moves the axles out of the range of single precision".into());
    }
    *state = next;
    Ok(json!({ "axle1": axle1, "axle2": axle2, "var_beta": next.variance }))
}

impl Kernel for Ipec {
    fn line(&mut self, text: &str) -> Result<Value, String> {
        self.stage.line(text, start, step)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SETUP: &str = r#"{"track":0.3,"axle1":[0.4,0,0],"axle2":[0,0,0],
        "sigma":{"wheel":1e-4,"r_y":1e-4,"r_phi":1e-3}}"#;

    fn configured() -> Ipec {
        let mut ipec = Ipec::default();
        assert_eq!(ipec.line(SETUP), Ok(Value::Null));
        ipec
    }

    fn vector(value: &Value) -> Vec<f64> {
        let array = value.as_array().unwrap();
        array.iter().map(|x| x.as_f64().unwrap()).collect()
    }

    #[test]
    fn bump_turns_both_axles_with_the_baseline() {
        let mut ipec = configured();
        // Axle 1's left wheel runs over a bump; the measured relative posture stays straight.
        let result = ipec
            .line(r#"{"d":[0.012,0.01,0.01,0.01],"r":[-0.4,0,0]}"#)
            .unwrap();
        let (front, rear) = (vector(&result["axle1"]), vector(&result["axle2"]));
        // The front axle advances 0.011 m in direction dθ/2, with dθ = −0.002/0.3.
        let turn = 0.5 * 0.002 / 0.3;
        let beta = (-0.011 * f64::sin(turn)) / (0.4 + 0.011 * f64::cos(turn) - 0.01);
        assert!((front[2] - beta).abs() < 1e-6 && (rear[2] - beta).abs() < 1e-6);
        let distance = (front[0] - rear[0]).hypot(front[1] - rear[1]);
        assert!((distance - 0.4).abs() < 1e-7);
        assert!((front[0] + rear[0] - 0.4 - 0.021).abs() < 1e-6);
        // On a straight line only the terms ds2² σ_rφ² and (ds1 − ds2)² σ_α² of the variance are not zero.
        let alpha = 1e-4 / 0.4;
        let variance = ((0.01f64 * 1e-3).powi(2) + (0.001f64 * alpha).powi(2)) / 0.16;
        let reported = result["var_beta"].as_f64().unwrap();
        assert!(
            (reported / variance - 1.0).abs() < 1e-3,
            "{reported:e} {variance:e}"
        );
    }

    #[test]
    fn error_names_the_field() {
        let mut ipec = configured();
        let good = r#"{"d":[0.01,0.01,0.01,0.01],"r":[-0.4,0,0]}"#;
        for (bad, field) in [
            (r#"{"d":[0.01,0.01,0.01],"r":[-0.4,0,0]}"#, "d"),
            (r#"{"d":[0.01,1e99,0.01,0],"r":[-0.4,0,0]}"#, "d[1]"),
            (r#"{"d":[0.01,0.01,0.01,0],"r":[0,0,0]}"#, "r = "),
            (r#"{"r":[-0.4,0,0]}"#, "d"),
        ] {
            let error = ipec.line(bad).unwrap_err();
            assert!(error.contains(field), "{error}");
        }
        assert_eq!(ipec.line(good), configured().line(good));
        for (from, to, field) in [
            ("0.3", "0", "track"),
            ("\"wheel\":1e-4", "\"wheel\":-1", "sigma.wheel"),
            ("[0,0,0]", "[0.4,0,0]", "axle2"),
            ("1e-3", "null", "sigma.r_phi"),
        ] {
            let mut ipec = Ipec::default();
            let error = ipec.line(&SETUP.replacen(from, to, 1)).unwrap_err();
            assert!(error.contains(field), "{error}");
            assert!(ipec.line(good).is_err());
        }
    }
}
