//! Time for which a robot was asked to move and did not.

use crate::math::Posture;

/// Time without motion after which a robot is stuck, s.
pub const STUCK_S: f32 = 2.0;
/// Distance that counts as motion, m.
const MOVED_M: f32 = 1e-3;

/// Time without motion, and the posture at the last motion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stuck {
    at: Posture,
    time_s: f32,
}

impl Stuck {
    /// Nothing observed yet.
    pub const NEW: Self = Self {
        at: Posture::ORIGIN,
        time_s: 0.0,
    };

    /// Observes O at `posture` after `dt` seconds; `asked` is true if the robot is to move. Gives the time without
    /// motion, s.
    pub fn step(&mut self, asked: bool, posture: Posture, dt: f32) -> f32 {
        if asked && posture.distance(self.at) <= MOVED_M {
            self.time_s += dt;
        } else {
            *self = Self {
                at: posture,
                time_s: 0.0,
            };
        }
        self.time_s
    }

    /// Begins to count anew.
    pub fn reset(&mut self) {
        self.time_s = 0.0;
    }
}
