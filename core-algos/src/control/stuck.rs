//! Time for which a robot was commanded to move and did not.

use crate::math::Posture;

/// Time of commanded motion after which a robot that has not moved is stuck, s.
pub const STUCK_S: f32 = 2.0;
/// Distance above which a robot has moved, m.
const MOVED_M: f32 = 1e-3;

/// Time for which the robot was commanded to move and did not, and the posture from which its motion is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Stuck {
    at: Posture,
    time_s: f32,
}

impl Stuck {
    /// Counter before the first observation.
    pub const NEW: Self = Self {
        at: Posture::ORIGIN,
        time_s: 0.0,
    };

    /// Observes O at `posture` after `dt` seconds; `commanded` is true if the robot is commanded to move. Returns the
    /// time for which the robot has been commanded to move and has not, s.
    pub fn step(&mut self, commanded: bool, posture: Posture, dt: f32) -> f32 {
        if commanded && posture.distance(self.at) <= MOVED_M {
            self.time_s += dt;
        } else {
            *self = Self {
                at: posture,
                time_s: 0.0,
            };
        }
        self.time_s
    }

    /// Sets the time to zero; the posture stays.
    pub fn reset(&mut self) {
        self.time_s = 0.0;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_without_motion_counts_while_commanded_within_one_millimetre() {
        let mut stuck = Stuck::NEW;
        for (commanded, x, y, time_s) in [
            (true, MOVED_M, 0.0, 0.5),
            (true, 0.0, -MOVED_M, 1.0),
            (true, MOVED_M.next_up(), 0.0, 0.0),
            // The distance is measured from the posture of the last motion.
            (true, 0.0, 0.0, 0.0),
            (true, 0.0, 0.0, 0.5),
            (false, 0.0, 0.0, 0.0),
            (true, 0.0, 0.0, 0.5),
            (true, f32::NAN, 0.0, 0.0),
        ] {
            let found = stuck.step(commanded, Posture::new(x, y, 1.0), 0.5);
            assert_eq!(found, time_s, "{commanded} {x} {y}");
        }
        let mut waited = Stuck::NEW;
        waited.step(true, Posture::ORIGIN, 0.5);
        waited.reset();
        assert_eq!(waited.step(true, Posture::ORIGIN, 0.25), 0.25);
    }
}
