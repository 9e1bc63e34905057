//! Configuration of the train.

use super::Train;
use super::leader::Leader;
use super::planner::Planner;
use super::spacing::Link;
use super::speed::Limits;
use super::turn::Turns;
use crate::config::{ConfigError, declare};
use crate::topology::MAX_AXLES;

/// Knots of the curve for each frame.
const FRAME_PITCHES: f32 = 40.0;

declare! {
    /// Parameters of a robot of three or more axles.
    pub struct Config {
        /// Largest curvature of plans times the distance of neighbouring axles. Not beyond the steering limit.
        pub curvature_share: f32 = 0.85, "": Range(0.05, 1.5);
        /// Largest rate of curvature along plans times the square of the distance of neighbouring axles.
        pub slope_share: f32 = 0.82, "": Range(0.05, 5.0);
        /// Factor by which paths of the user may exceed the largest rate of curvature of plans.
        pub slope_margin: f32 = 1.4, "": Range(1.0, 5.0);
        /// Length over which deviations of the curve from its path decay.
        pub length_constant_m: f32 = 0.25, "m": Range(0.02, 10.0);
        /// Distance over which the deviations of axles from a new curve fade.
        pub fade_length_m: f32 = 0.3, "m": Range(0.01, 10.0);
        /// Price of a cusp in a plan.
        pub cusp_price_m: f32 = 0.2, "m": NonNegative;
        /// Candidates that the planner evaluates in an epoch.
        // A candidate takes 4 µs on a board, and with five axles three ticks of an epoch are left for them.
        pub planner_budget: u32 = 250, "": Positive;
        /// Speed of regulation.
        pub speed_m_s: f32 = 0.2, "m/s": Positive;
        /// Mean distance of the axles behind their references at which the robot waits; it slows down from half of this
        /// distance.
        pub wait_m: f32 = 0.05, "m": Range(1e-3, 1.0);
        /// Distance of an axle from its reference, or of the curve from its path, beyond which a path is lost.
        pub max_deviation_m: f32 = 0.5, "m": Positive;
        /// Gain of the distance along a trajectory.
        pub trajectory_gain_per_s: f32 = 1.5, "1/s": Range(0.0, 10.0);
        derived {
            /// Number of axles.
            pub axles: u8 = 3, "": Range(2.0, MAX_AXLES as f32);
            /// Length of the flexible part of a frame (L).
            pub frame_length_m: f32 = 0.37, "m": Positive;
            /// Length of the rigid section between each end of the flexible part and its axle.
            pub rigid_end_m: f32 = 0.0, "m": NonNegative;
            /// Curvature at the largest commanded steering angle.
            pub max_curvature_per_m: f32 = 3.0, "1/m": Positive;
            /// Speed along paths.
            pub path_speed_m_s: f32 = 0.2, "m/s": Positive;
            /// Largest speed of the leading axle.
            pub max_speed_m_s: f32 = 0.25, "m/s": Positive;
            /// Half of the track of an axle (d).
            pub half_track_m: f32 = 0.162, "m": Positive;
            /// Largest acceleration, and deceleration ahead of stops.
            pub acceleration_m_s2: f32 = 0.4, "m/s²": Positive;
            /// Deceleration of a stop that was not foreseen.
            pub stop_deceleration_m_s2: f32 = 0.8, "m/s²": Positive;
            /// Time constant at the end of acceleration and braking.
            pub speed_lag_s: f32 = 1.0 / 6.0, "s": Positive;
            /// Time at rest at a cusp.
            pub reversal_hold_s: f32 = 0.1, "s": NonNegative;
            /// Largest circumferential speed of any wheel.
            pub max_wheel_speed_m_s: f32 = 0.6, "m/s": Positive;
            /// Time at rest before the posture is compared with the goal.
            pub settle_time_s: f32 = 0.2, "s": Positive;
            /// Distance within which the goal counts as reached at rest; each renewed attempt allows 60 % more.
            pub accept_distance_m: f32 = 0.01, "m": Positive;
            /// Heading error within which the goal counts as reached at rest; each renewed attempt allows 60 % more.
            pub accept_heading_rad: f32 = 0.026, "rad": Positive;
            /// A reached goal is left when the error exceeds the accepted error by this factor.
            pub release_factor: f32 = 2.5, "": Positive;
            /// Renewed attempts before giving up.
            pub max_attempts: u8 = 20, "": Range(0.0, 255.0);
        }
    }
}

impl Config {
    /// Builds the validated train; the error names the invalid field.
    pub fn build(self) -> Result<Train, ConfigError> {
        self.check_ranges()?;
        let link = Link {
            length_m: self.frame_length_m,
            rigid_end_m: self.rigid_end_m,
        };
        let distance = link.straight();
        let body = f32::from(self.axles.saturating_sub(1)) * distance;
        let kappa = (self.curvature_share / distance).min(self.max_curvature_per_m);
        let slope = self.slope_share / (distance * distance);
        let turns = Turns::new(kappa, slope);
        Ok(Train {
            axles: self.axles.into(),
            link,
            body,
            pitch: distance / FRAME_PITCHES,
            planner: Planner::new(turns, body, self.cusp_price_m),
            leader: Leader {
                kappa: self.max_curvature_per_m,
                slope,
                steepest: self.slope_margin * slope,
                length: self.length_constant_m,
            },
            limits: Limits {
                speed: self.max_speed_m_s,
                acceleration: self.acceleration_m_s2,
                deceleration: self.stop_deceleration_m_s2,
                lag: self.speed_lag_s,
                wheel: self.max_wheel_speed_m_s,
                half_track: self.half_track_m,
            },
            config: self,
        })
    }
}
