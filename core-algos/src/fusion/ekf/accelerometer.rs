//! Measurement model: acceleration along the heading, z = v̇, gravity removed (level floor).

use super::factors::ACCELERATION;
use super::{AxleFilter, State, Verdict};

impl AxleFilter {
    /// Measurement update by the accelerometer's forward acceleration (m/s²).
    pub fn update_accelerometer(&self, state: &mut State, acceleration: Option<f32>) -> Verdict {
        let Some(acceleration) = acceleration else {
            return Verdict::Absent;
        };
        if !acceleration.is_finite() {
            return state.counters.accelerometer.refuse();
        }
        let innovation = acceleration - state.motion[ACCELERATION];
        let (p, noise) = (&state.covariance, self.accelerometer_variance);
        let variance = || p.motion_variance(&[0.0, 0.0, 1.0, 0.0]);
        let refusals = &mut state.counters.accelerometer;
        let verdict =
            refusals.scalar_verdict(innovation, noise, variance, self.gate, self.patience);
        if verdict == Verdict::Used {
            let gain = state.covariance.observe::<ACCELERATION>(noise);
            state.correct(&gain.map(|gain| gain * innovation));
        }
        verdict
    }
}
