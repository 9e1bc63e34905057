//! Measurement model: acceleration along the heading, z = v̇, gravity removed (level floor).

use super::{AxleFilter, State, V_DOT, Verdict};

impl AxleFilter {
    /// Update by a forward acceleration (m/s²).
    pub fn update_accelerometer(&self, state: &mut State, acceleration: Option<f32>) -> Verdict {
        let Some(acceleration) = acceleration else {
            return Verdict::Absent;
        };
        if !acceleration.is_finite() {
            return state.counters.accelerometer.refuse();
        }
        let innovation = (acceleration - state.motion[2].high) - state.motion[2].low;
        let (p, noise) = (&state.covariance, self.accelerometer_variance);
        let nis = || innovation * innovation / (p.entry(V_DOT, V_DOT) + noise);
        let refusals = &mut state.counters.accelerometer;
        let verdict = refusals.judge(nis, self.gate, self.patience);
        if verdict == Verdict::Used {
            let h = [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0];
            let gain = state.covariance.observe::<V_DOT>(&h, noise);
            state.correct(&gain, innovation);
        }
        verdict
    }
}
