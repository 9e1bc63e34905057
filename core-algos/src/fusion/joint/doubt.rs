//! Sensors that contradict what is known of them: constants learnt far beyond their priors.

use super::{Joint, State};
use crate::fusion::constants::{
    COMPLIANCE, DRIFT, GAIN, GYRO_BIAS, GYRO_SCALE, SCALE, SIDE, TURN, UNEVEN, ZERO,
};

/// Prior standard deviations of a constant from which on its sensor is inconsistent. Of 400 sound robots in two
/// worlds none came beyond 3.5 of them in a drive of 3 m, of 50 none in one of 20 m; in hours one came to 4.6.
pub(super) const SIGMAS: f32 = 4.0;

/// Part of the robot that the other sensors contradict.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Doubt {
    /// Wheels, tyres, axles askew or with another track.
    Wheels,
    /// Zeros and gains of the strain gauges.
    Gauges,
    /// Bias or scale of a gyro.
    Gyros,
}

impl Joint {
    /// The part whose constants lie furthest beyond four prior standard deviations; `None` if none does.
    ///
    /// A pair is judged by its sum and its difference: nothing may see what the axles have in common, and the error of
    /// one axle is then shared among both.
    pub fn doubt(&self, state: &State) -> Option<Doubt> {
        let of = |k: usize| state.constants[k].abs() * self.per_limit[k];
        let pair = |k: usize| core::f32::consts::FRAC_1_SQRT_2 * (of(k) + of(k + 1));
        let largest = |scores: &[f32]| scores.iter().fold(0.0, |most: f32, &score| most.max(score));
        let wheels = [DRIFT, SCALE, TURN, SIDE, UNEVEN].map(pair);
        let wheels = largest(&wheels).max(of(COMPLIANCE)).max(of(COMPLIANCE + 1));
        let gauges = largest(&[of(ZERO), of(ZERO + 1), of(GAIN), of(GAIN + 1)]);
        let gyros = pair(GYRO_BIAS).max(pair(GYRO_SCALE));
        let most = wheels.max(gauges).max(gyros);
        if !(most > 1.0) {
            None
        } else if most == wheels {
            Some(Doubt::Wheels)
        } else if most == gauges {
            Some(Doubt::Gauges)
        } else {
            Some(Doubt::Gyros)
        }
    }
}
