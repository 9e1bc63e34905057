//! Measurement model: yaw rate from a gyro, z = φ̇.

use super::{AxleFilter, State, Verdict};

impl AxleFilter {
    /// Verdict on a yaw rate (rad/s, counter-clockwise positive), and its innovation.
    pub(super) fn gyro_verdict(&self, state: &mut State, rate: Option<f32>) -> (Verdict, f32) {
        let Some(rate) = rate else {
            return (Verdict::Absent, 0.0);
        };
        if !rate.is_finite() {
            return (state.counters.gyro.refuse(), 0.0);
        }
        let innovation = rate - state.motion[1];
        let (p, noise) = (&state.covariance, self.gyro_variance);
        let variance = || p.motion_variance(&[0.0, 1.0, 0.0, 0.0]);
        let refusals = &mut state.counters.gyro;
        let verdict =
            refusals.scalar_verdict(innovation, noise, variance, self.gate, self.patience);
        (verdict, innovation)
    }
}
