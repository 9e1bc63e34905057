//! Errors of odometry and beam that stay the same, or nearly so, throughout a drive.
//!
//! They add linearly and white noise cannot stand for them. [`joint`](super::joint) estimates them;
//! [`track`](super::track) keeps what a posture owes to each. Both take from here what they do to
//! an axle's odometric increment.
//!
//! | index | constant |
//! |---|---|
//! | [`OFFSET`] | offset of the beam's r_y (m) and r_φ (rad) |
//! | [`DRIFT`] | heading drift per metre of front and rear odometry: unequal wheels (rad/m) |
//! | [`SCALE`] | scale error of front and rear odometry: wheel size |
//! | [`CREEP`] | yaw rate of each axle against the bend per radian of bend (1/s) |
//! | [`TURN`] | scale error of the headings that the wheels of front and rear report: track |
//! | [`GYRO_BIAS`] | what the gyros of front and rear read too little (rad/s) |
//! | [`GYRO_SCALE`] | scale error of the gyros of front and rear |
//!
//! An axle with a gyro turns by it: the wheels' share of the heading is then some thousandths, and
//! with it what creep, unequal wheels and track do to it.

use crate::math::Posture;
use crate::math::matrix::Mat;

/// Number of constants.
pub const COUNT: usize = 13;
/// Offset of the beam (2).
pub const OFFSET: usize = 0;
/// Heading drift of front and rear.
pub const DRIFT: usize = 2;
/// Scale error of front and rear.
pub const SCALE: usize = 4;
/// Creep of the axles against each other.
pub const CREEP: usize = 6;
/// Scale error of the heading by the wheels of front and rear.
pub const TURN: usize = 7;
/// Bias of the gyros of front and rear.
pub const GYRO_BIAS: usize = 9;
/// Scale error of the gyros of front and rear.
pub const GYRO_SCALE: usize = 11;

/// One axle's odometric increment and what its errors depend on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// 0 for the front axle, 1 for the rear.
    pub axle: usize,
    /// Posture reached, in the frame of departure (m, m, rad).
    pub moved: Posture,
    /// Heading of the front axle less that of the rear, rad.
    pub bend: f32,
    /// Time the increment spans, s.
    pub dt: f32,
    /// Share of the time in which a gyro took part, 0 to 1.
    pub gyro_share: f32,
}

impl Step {
    /// Rate at which the heading that odometry does not see grows with the creep constant, per
    /// radian of bend: the frame turns the front axle back and the rear axle into the bend.
    pub fn creep_time(&self) -> f32 {
        let sign = if self.axle == 0 { -1.0 } else { 1.0 };
        sign * self.by_wheels() * self.dt
    }

    /// Share of the heading that comes from the wheels.
    pub fn by_wheels(&self) -> f32 {
        1.0 - self.gyro_share
    }

    /// Derivative of the true increment (m, m, rad) by the constants.
    pub fn by_constants(&self) -> Mat<3, COUNT> {
        let p = self.moved;
        let axle = self.axle.min(1);
        let mut by = [[0.0; COUNT]; 3];
        by[0][SCALE + axle] = p.x;
        by[1][SCALE + axle] = p.y;
        by[2][DRIFT + axle] = self.by_wheels() * p.x;
        by[2][TURN + axle] = self.by_wheels() * p.phi;
        by[2][CREEP] = self.creep_time() * self.bend;
        by[2][GYRO_BIAS + axle] = self.gyro_share * self.dt;
        by[2][GYRO_SCALE + axle] = self.gyro_share * p.phi;
        by
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn step(axle: usize, gyro_share: f32) -> Step {
        Step {
            axle,
            moved: Posture::new(0.4, 0.02, 0.3),
            bend: 0.5,
            dt: 2.0,
            gyro_share,
        }
    }

    /// Heading error of a step of 2 s by a constant of size one.
    fn heading(axle: usize, gyro_share: f32, constant: usize) -> f32 {
        step(axle, gyro_share).by_constants()[2][constant]
    }

    #[test]
    fn heading_owes_its_errors_to_the_sensor_it_comes_from() {
        for axle in 0..2 {
            assert_eq!(heading(axle, 0.0, DRIFT + axle), 0.4);
            assert_eq!(heading(axle, 0.0, TURN + axle), 0.3);
            assert_eq!(heading(axle, 0.0, GYRO_BIAS + axle), 0.0);
            assert_eq!(heading(axle, 1.0, DRIFT + axle), 0.0);
            assert_eq!(heading(axle, 1.0, CREEP), 0.0);
            assert_eq!(heading(axle, 1.0, GYRO_BIAS + axle), 2.0);
            assert_eq!(heading(axle, 1.0, GYRO_SCALE + axle), 0.3);
            // A gyro that was there half of the time leaves half of each.
            assert_eq!(heading(axle, 0.5, DRIFT + axle), 0.2);
            assert_eq!(heading(axle, 0.5, GYRO_BIAS + axle), 1.0);
        }
    }

    #[test]
    fn each_axle_has_constants_of_its_own_but_for_the_creep() {
        for constant in 0..COUNT {
            let both = [0, 1].map(|axle| heading(axle, 0.5, constant));
            if constant == CREEP {
                assert_eq!(both[0], -both[1]);
                assert!(both[1] > 0.0);
            } else {
                assert!(both[0] == 0.0 || both[1] == 0.0, "{constant}");
            }
        }
    }
}
