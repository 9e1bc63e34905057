//! Measurement model: yaw rate from a gyro, z = φ̇.

use super::{AxleFilter, OMEGA, State, Verdict};

impl AxleFilter {
    /// Innovation of a yaw rate (rad/s, counter-clockwise positive), and whether it may be used.
    pub(super) fn judge_gyro(&self, state: &mut State, rate: Option<f32>) -> (Verdict, f32) {
        let Some(rate) = rate else {
            return (Verdict::Absent, 0.0);
        };
        if !rate.is_finite() {
            return (state.counters.gyro.refuse(), 0.0);
        }
        let innovation = (rate - state.motion[1].high) - state.motion[1].low;
        let p = &state.covariance;
        let nis = || innovation * innovation / (p.entry(OMEGA, OMEGA) + self.gyro_variance);
        let verdict = state.counters.gyro.judge(nis, self.gate, self.patience);
        (verdict, innovation)
    }
}
