//! Configuration of the regulator.

use super::Regulator;
use crate::config::{Allowed, ConfigError, in_range, non_negative, positive, require};
use crate::control::kinematic::{self, LimitsConfig};
use crate::control::{funnel, planner};

/// Strategy to reach the goal.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "kebab-case"))]
pub enum Strategy {
    /// Planner, funnel and approach law: any start.
    #[default]
    Funnel,
    /// Equation 4 alone.
    PaperLaw,
}

/// Parameters of the regulator.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields, default))]
pub struct Config {
    /// Strategy to reach the goal.
    pub strategy: Strategy,
    /// Bounds of speed and steering.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub limits: LimitsConfig,
    /// Gains of equation 4 where it drives alone ([`Strategy::PaperLaw`]).
    pub law: kinematic::Config,
    /// Gains of the approach in the funnel: `arrival_gain` 3, `circle_radius_m` below `1/(2 κ_max)`.
    pub approach: kinematic::Config,
    /// The planner.
    pub planner: planner::Config,
    /// Interval of [`Regulator::tick`], s.
    pub tick_s: f32,
    /// Candidate postures the planner looks at in a tick.
    pub planner_budget: u32,
    /// Steering error below which a segment is begun, rad.
    pub steering_tolerance_rad: f32,
    /// A segment is begun after this time whatever the steering, s.
    pub steering_timeout_s: f32,
    /// Steering error at which the speed is held at zero, rad; from half of it down the speed is
    /// free.
    pub steering_wait_rad: f32,
    /// Deceleration of the governor, m/s².
    pub braking_m_s2: f32,
    /// Lag of the governor's speed where its deceleration is not at its limit, s.
    pub speed_lag_s: f32,
    /// Length over which deviations from a segment's path decay, m.
    pub path_length_constant_m: f32,
    /// Commanded speed below which the robot counts as at rest, m/s.
    pub rest_speed_m_s: f32,
    /// Commanded speed below which steering for the next segment begins, m/s.
    pub steer_speed_m_s: f32,
    /// Time at rest before the posture is judged, s.
    pub settle_time_s: f32,
    /// Way left along the path at which the approach ends, m.
    pub latch_distance_m: f32,
    /// At rest, the goal counts as reached within this distance, m. Each renewed attempt allows
    /// 60 % more, up to the tolerance of the goal.
    pub accept_distance_m: f32,
    /// At rest, the goal counts as reached within this heading error, rad; widened likewise.
    pub accept_heading_rad: f32,
    /// A reached goal is left when the error exceeds the accepted one by this factor.
    pub release_factor: f32,
    /// The funnel counts as left when the needed curvature exceeds κ_max by this factor.
    pub leave_factor: f32,
    /// And by this more than the bearings' own error near the goal, rad.
    pub leave_slack_rad: f32,
    /// Within this distance of the goal, m, the approach follows the arc it is on to its end:
    /// bearings lose meaning.
    pub final_arc_m: f32,
    /// Length over which deviations from the final arc decay, m.
    pub final_length_constant_m: f32,
    /// Renewed attempts before giving up.
    pub max_attempts: u8,
    /// Equation 4 alone: stop within this of the rest distance, m.
    pub stop_margin_m: f32,
    /// Equation 4 alone: stop below this demanded speed, m/s.
    pub stop_speed_m_s: f32,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            strategy: Strategy::Funnel,
            limits: LimitsConfig::default(),
            law: kinematic::Config::default(),
            approach: kinematic::Config {
                circle_radius_m: 0.005,
                approach_gain_m_s: 2.0,
                ..kinematic::Config::default()
            },
            planner: planner::Config::default(),
            tick_s: 0.01,
            planner_budget: 400,
            steering_tolerance_rad: 0.05,
            steering_timeout_s: 3.0,
            steering_wait_rad: 0.2,
            braking_m_s2: 0.4,
            speed_lag_s: 1.0 / 6.0,
            path_length_constant_m: 0.2,
            rest_speed_m_s: 0.004,
            steer_speed_m_s: 0.02,
            settle_time_s: 0.2,
            latch_distance_m: 0.003,
            accept_distance_m: 0.01,
            accept_heading_rad: 0.026,
            release_factor: 2.5,
            leave_factor: 1.15,
            leave_slack_rad: 0.1,
            final_arc_m: 0.15,
            final_length_constant_m: 0.06,
            max_attempts: 20,
            stop_margin_m: 0.03,
            stop_speed_m_s: 0.004,
        }
    }
}

impl Config {
    /// Checks the parameters.
    pub fn build(self) -> Result<Regulator, ConfigError> {
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
        positive("tick_s", self.tick_s)?;
        require(
            self.planner_budget > 0,
            "planner_budget",
            self.planner_budget as f32,
            Allowed::Positive,
        )?;
        positive("steering_tolerance_rad", self.steering_tolerance_rad)?;
        positive("steering_timeout_s", self.steering_timeout_s)?;
        require(
            self.steering_wait_rad > self.steering_tolerance_rad,
            "steering_wait_rad",
            self.steering_wait_rad,
            Allowed::Condition("greater than steering_tolerance_rad"),
        )?;
        positive("braking_m_s2", self.braking_m_s2)?;
        in_range(
            "path_length_constant_m",
            self.path_length_constant_m,
            0.02,
            10.0,
        )?;
        positive("speed_lag_s", self.speed_lag_s)?;
        positive("rest_speed_m_s", self.rest_speed_m_s)?;
        positive("steer_speed_m_s", self.steer_speed_m_s)?;
        positive("settle_time_s", self.settle_time_s)?;
        positive("latch_distance_m", self.latch_distance_m)?;
        require(
            self.accept_distance_m >= self.latch_distance_m && self.accept_distance_m.is_finite(),
            "accept_distance_m",
            self.accept_distance_m,
            Allowed::Condition("at least latch_distance_m"),
        )?;
        positive("accept_heading_rad", self.accept_heading_rad)?;
        in_range("release_factor", self.release_factor, 1.1, 100.0)?;
        in_range("leave_factor", self.leave_factor, 1.0, 10.0)?;
        non_negative("leave_slack_rad", self.leave_slack_rad)?;
        positive("final_arc_m", self.final_arc_m)?;
        in_range(
            "final_length_constant_m",
            self.final_length_constant_m,
            0.01,
            10.0,
        )?;
        positive("stop_margin_m", self.stop_margin_m)?;
        positive("stop_speed_m_s", self.stop_speed_m_s)?;
        Ok(Regulator {
            law: self.law.build()?,
            approach: self.approach.build()?,
            planner: self.planner.build(limits.max_curvature())?,
            limits,
            config: self,
        })
    }
}
