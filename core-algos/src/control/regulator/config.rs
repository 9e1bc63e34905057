//! Configuration of the regulator.

use super::Regulator;
use crate::config::{Allowed, ConfigError, declare, require};
use crate::control::kinematic::{self, LimitsConfig};
use crate::control::{funnel, planner};

declare! {
    /// Strategy to reach the goal.
    pub enum Strategy, default Funnel {
        /// Planner, funnel and approach law: any start.
        Funnel = "funnel",
        /// Equation 4 alone.
        PaperLaw = "paper-law",
    }
}

declare! {
    /// Parameters of the regulator.
    pub struct Config {
        /// Strategy to reach the goal.
        pub strategy: Strategy = Strategy::Funnel;
        /// Gains of equation 4 where it is used alone.
        pub law: kinematic::Config = kinematic::Config::default();
        /// Gains of the approach in the funnel: `arrival_gain` 3, `circle_radius_m` below `1/(2 κ_max)`.
        pub approach: kinematic::Config = kinematic::Config {
            circle_radius_m: 0.005,
            approach_gain_m_s: 2.0,
            ..kinematic::Config::default()
        };
        /// Parameters of the planner.
        pub planner: planner::Config = planner::Config::default();
        /// Candidate postures that the planner evaluates in a tick.
        pub planner_budget: u32 = 400, "": Positive;
        /// Steering error up to which a segment or the approach begins.
        pub steering_tolerance_rad: f32 = 0.05, "rad": Positive;
        /// Time after which a segment or the approach begins at any steering error.
        pub steering_timeout_s: f32 = 3.0, "s": Positive;
        /// Steering error above which the speed is zero. Below half this error the speed is not reduced.
        pub steering_wait_rad: f32 = 0.2, "rad": Positive;
        /// Length over which deviations from a segment's path decay.
        pub path_length_constant_m: f32 = 0.2, "m": Range(0.02, 10.0);
        /// Commanded speed below which the robot counts as at rest.
        pub rest_speed_m_s: f32 = 0.004, "m/s": Positive;
        /// Commanded speed below which steering for the next segment begins.
        pub steer_speed_m_s: f32 = 0.02, "m/s": Positive;
        /// Time at rest before the posture is compared with the goal.
        pub settle_time_s: f32 = 0.2, "s": Positive;
        /// Remaining distance along the path at which the approach ends.
        pub latch_distance_m: f32 = 0.003, "m": Positive;
        /// At rest, the goal counts as reached within this distance. Each renewed attempt allows
        /// 60 % more, up to the tolerance of the goal.
        pub accept_distance_m: f32 = 0.01, "m": Range(0.003, 0.5);
        /// At rest, the goal counts as reached within this heading error; each renewed attempt allows 60 % more.
        pub accept_heading_rad: f32 = 0.026, "rad": Range(1e-3, 1.0);
        /// A reached goal is left when the error exceeds the accepted error by this factor.
        pub release_factor: f32 = 2.5, "": Range(1.1, 100.0);
        /// The funnel counts as left when the needed curvature exceeds κ_max by this factor.
        pub leave_factor: f32 = 1.15, "": Range(1.0, 10.0);
        /// Additional bearing error that is allowed before the funnel counts as left.
        pub leave_slack_rad: f32 = 0.1, "rad": NonNegative;
        /// Distance from the goal below which the approach follows its present arc to the end, because bearings lose
        /// meaning.
        pub final_arc_m: f32 = 0.15, "m": Positive;
        /// Length over which deviations from the final arc decay.
        pub final_length_constant_m: f32 = 0.06, "m": Range(0.01, 10.0);
        /// Renewed attempts before giving up.
        pub max_attempts: u8 = 20, "": Range(0.0, 255.0);
        /// Equation 4 alone: distance beyond the rest distance within which the robot stops.
        pub stop_margin_m: f32 = 0.03, "m": Positive;
        /// Equation 4 alone: commanded speed below which the robot stops.
        pub stop_speed_m_s: f32 = 0.004, "m/s": Positive;
        derived {
            /// Bounds of speed and steering.
            pub limits: LimitsConfig = LimitsConfig::default();
            /// Deceleration of the governor.
            pub braking_m_s2: f32 = 0.4, "m/s²": Positive;
            /// Time constant of the governor's speed below its limit of deceleration.
            pub speed_lag_s: f32 = 1.0 / 6.0, "s": Positive;
        }
    }
}

impl Config {
    /// Builds the validated regulator; the error names the invalid field.
    pub fn build(self) -> Result<Regulator, ConfigError> {
        self.check_ranges()?;
        let limits = self.limits.build()?;
        require(
            self.approach.arrival_gain == funnel::ARRIVAL_WEIGHT,
            "approach.arrival_gain",
            self.approach.arrival_gain,
            Allowed::Condition("3, the gain whose funnel is invariant"),
        )?;
        let radius = self.approach.circle_radius_m;
        require(
            2.0 * radius * limits.max_curvature() < 1.0,
            "approach.circle_radius_m",
            radius,
            Allowed::Condition("less than half the smallest turning radius"),
        )?;
        require(
            self.steering_wait_rad > self.steering_tolerance_rad,
            "steering_wait_rad",
            self.steering_wait_rad,
            Allowed::Condition("greater than steering_tolerance_rad"),
        )?;
        require(
            self.accept_distance_m >= self.latch_distance_m,
            "accept_distance_m",
            self.accept_distance_m,
            Allowed::Condition("at least latch_distance_m"),
        )?;
        Ok(Regulator {
            law: self.law.build()?,
            approach: self.approach.build()?,
            planner: self.planner.build(limits.max_curvature())?,
            limits,
            config: self,
        })
    }
}
