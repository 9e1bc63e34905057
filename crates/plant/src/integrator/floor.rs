//! Effects of the floor and of turning on the axles: drift of a carpet, centrifugal forces, gravity along a slope.

use super::Plant;
use crate::geometry::{Geometry, Vec3, rotate, small_turn, unrotate};

impl Plant {
    /// Way of the floor over the way rolled, as the axles see it when half of `h` (s) has passed.
    #[inline(always)]
    pub(super) fn drift(&mut self, h: f64) {
        let [front, rear] = &self.state.axle;
        let ahead = rotate(
            &self.geometry.front,
            small_turn(0.5 * h * front.velocity[2]),
        );
        let behind = rotate(&self.geometry.rear, small_turn(0.5 * h * rear.velocity[2]));
        let front = unrotate(&self.carpet, ahead);
        let rear = unrotate(&self.carpet, behind);
        for n in 0..2 {
            self.conditions.drift[n] = [front[n], front[n], rear[n], rear[n]];
        }
    }

    /// Loads of the axles with the centrifugal forces at these yaw rates and with gravity, in the frames of axles that
    /// have turned in these directions since the start of the part.
    #[inline(always)]
    pub(super) fn swung(
        &self,
        load: &[Vec3; 2],
        rate: [f64; 2],
        turns: [[f64; 2]; 2],
    ) -> [Vec3; 2] {
        let [front, rear] = &self.bodies;
        let load = [
            front.swung(&load[0], rate[0]),
            rear.swung(&load[1], rate[1]),
        ];
        let Some(gravity) = self.downhill() else {
            return load;
        };
        [
            front.pulled(&load[0], unrotate(&gravity[0], turns[0])),
            rear.pulled(&load[1], unrotate(&gravity[1], turns[1])),
        ]
    }

    /// Gravity along the floor in the axles' frames, m/s²; `None` on a level floor.
    #[inline(always)]
    pub(super) fn downhill(&self) -> Option<[[f64; 2]; 2]> {
        let gravity = self.gravity?;
        let Geometry { front, rear, .. } = self.geometry;
        Some([unrotate(&gravity, front), unrotate(&gravity, rear)])
    }
}
