//! Measurement model: speeds of the left and right wheel over ground, z = v ∓ φ̇ · track/2 (left −,
//! right +), wheel rotation times radius.

use super::{AxleFilter, State, Verdict};

impl AxleFilter {
    /// Verdict and innovation of each wheel speed (m/s). Each speed is compared with the prediction, not with the
    /// other wheel.
    pub(super) fn wheel_verdicts(
        &self,
        state: &mut State,
        left: Option<f32>,
        right: Option<f32>,
    ) -> [(Verdict, f32); 2] {
        let half_track = self.half_track;
        let p = &state.covariance;
        let [v, omega, ..] = state.motion;
        let (gate, patience) = (self.gate, self.patience);
        let wheel_verdict =
            |speed: Option<f32>, lever: f32, noise: f32, refusals: &mut super::Refusals| {
                let Some(speed) = speed else {
                    return (Verdict::Absent, 0.0);
                };
                if !speed.is_finite() {
                    return (refusals.refuse(), 0.0);
                }
                let innovation = speed - (v + omega * lever);
                let variance = || p.motion_variance(&[1.0, lever, 0.0, 0.0]);
                let verdict = refusals.scalar_verdict(innovation, noise, variance, gate, patience);
                (verdict, innovation)
            };
        let counters = &mut state.counters;
        [
            wheel_verdict(left, -half_track, self.left_variance, &mut counters.left),
            wheel_verdict(right, half_track, self.right_variance, &mut counters.right),
        ]
    }
}
