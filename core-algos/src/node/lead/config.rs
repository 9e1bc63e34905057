//! Configuration of the lead node.

use crate::bus::layout;
use crate::config::{Allowed, ConfigError, declare, require};
use crate::control::cascade::{self, Cascade};
use crate::control::governor::{self, Governor};
use crate::control::regulator::{self, Regulator};
use crate::control::train::{self, Train};
use crate::fusion::Estimate;
use crate::fusion::robot::{self, Mode, RobotFusion};
use crate::math::Wrench;
use crate::node::path_task::{self, PathTask};
use crate::safety::ramp;
use crate::safety::supervisor::{self, Supervisor};
use crate::time::{EPOCH, EPOCH_S, LEAD_PHASE, Micros, TICK};
use crate::topology::Topology;

/// True if a fusion suits a robot. Covariance intersection and IPEC know one pair of axles. By odometry alone the axles
/// of a longer robot do not know their distances, and within a few metres they strain the frames until they stop.
pub const fn fusion_fits(mode: Mode, robot: Topology) -> bool {
    robot.frame_count() == 1 || matches!(mode, Mode::Joint)
}

/// Fusion of a robot with more than two axles, in words.
pub const FUSION_OF_CHAIN: &str = "joint with more than two axles";

declare! {
    /// Parameters of the lead node.
    pub struct Config {
        /// Age of an axle's report after which the motors are switched off.
        pub report_timeout_s: f32 = layout::timeout_s(layout::id::AXLE_POSTURE), "s": Range(0.02, 1.0);
        /// Longest time for which the motors hold the robot in place, before or after a drive; then they are switched
        /// off until the next command.
        pub hold_s: f32 = 60.0, "s": Range(0.1, 3600.0);
        /// Fusion of both axles and the beam.
        pub fusion: robot::Config = robot::Config::default();
        /// Posture regulation.
        pub regulator: regulator::Config = regulator::Config::default();
        /// Path following and trajectory tracking.
        pub course: path_task::Config = path_task::Config::default();
        /// Governor of the midpoint's motion.
        pub governor: governor::Config = governor::Config::default();
        /// Cascade to the axles.
        pub cascade: cascade::Config = cascade::Config::default();
        /// Limits beyond which the robot stops.
        pub limits: Limits = Limits::default();
        /// Ramp of a stop.
        pub stop: ramp::Config = ramp::Config::default();
        /// Supervisor.
        pub supervisor: supervisor::Config = supervisor::Config::default();
        /// Control of three and more axles.
        pub train: train::Config = train::Config::default();
    }
}

declare! {
    /// Limits that a sound robot keeps; each counts only after the time of its condition.
    pub struct Limits {
        /// Steering angle of the frame |ψ|.
        pub bend_rad: f32 = 0.7, "rad": Range(0.05, 1.5);
        /// Force of the frame on an axle.
        pub force_n: f32 = 25.0, "N": Positive;
        /// Moment of the frame on an axle.
        pub moment_n_m: f32 = 6.0, "N m": Positive;
        /// Standard deviation of the position of O beyond which the estimate counts as vague.
        // A floor drift of 1.5 % over 300 m is 4.5 m.
        pub position_sigma_m: f32 = 5.0, "m": Positive;
        /// Standard deviation of the heading of O beyond which the estimate counts as vague.
        pub heading_sigma_rad: f32 = 0.5, "rad": Positive;
    }
}

impl Limits {
    /// True if the frame pushes, pulls or turns an axle too hard, or for NaN.
    pub(super) fn exceeded_by(&self, wrench: &Wrench) -> bool {
        let force = wrench.force_x * wrench.force_x + wrench.force_y * wrench.force_y;
        !(force <= self.force_n * self.force_n
            && wrench.moment_root.abs() <= self.moment_n_m
            && wrench.moment_end.abs() <= self.moment_n_m)
    }

    /// True if a standard deviation of an estimate exceeds its limit, or for NaN.
    pub(super) fn is_vague(&self, robot: &Estimate) -> bool {
        let p = &robot.covariance;
        let position = self.position_sigma_m * self.position_sigma_m;
        let heading = self.heading_sigma_rad * self.heading_sigma_rad;
        !(p[0][0] <= position && p[1][1] <= position && p[2][2] <= heading)
    }
}

impl Config {
    /// Refuses a fusion that does not suit more than two axles.
    fn check_fusion(&self, topology: Topology) -> Result<(), ConfigError> {
        let mode = self.fusion.mode;
        let allowed = Allowed::Condition(FUSION_OF_CHAIN);
        require(
            fusion_fits(mode, topology),
            "mode",
            mode as u8 as f32,
            allowed,
        )
        .map(drop)
    }

    /// Builds the algorithms of the node; the error names the parameter that is wrong.
    pub fn build(&self, topology: Topology) -> Result<Algorithms, ConfigError> {
        self.check_ranges()?;
        self.limits.check_ranges()?;
        self.check_fusion(topology)?;
        let cascade = self.cascade.build()?;
        Ok(Algorithms {
            topology,
            begin_phase: begin_phase(topology),
            step_phase: step_phase(topology),
            planning_ticks: planning_ticks(topology),
            limits: self.limits,
            ramp: self.stop.build(self.supervisor.stop_timeout_s)?,
            frame_length: self.cascade.frame_length_m,
            supervisor: self.supervisor.build()?,
            report_timeout: (self.report_timeout_s * 1e6) as Micros,
            longest_hold: (self.hold_s * 1e6) as Micros,
            fusion: self.fusion.build()?,
            regulator: self.regulator.build()?,
            path_task: self.course.build(&cascade)?,
            governor: self.governor.build(&cascade, EPOCH_S)?,
            train: match topology.axle_count() {
                2 => None,
                _ => Some(self.train_of(topology, &cascade).build()?),
            },
            cascade,
        })
    }
}

impl Config {
    /// Parameters of the train with the values that follow from the robot.
    fn train_of(&self, topology: Topology, cascade: &Cascade) -> train::Config {
        let (governor, regulator) = (&self.governor, &self.regulator);
        train::Config {
            axles: topology.axle_count() as u8,
            frame_length_m: self.cascade.frame_length_m,
            rigid_end_m: self.cascade.rigid_end_m,
            max_curvature_per_m: cascade.max_curvature(),
            path_speed_m_s: self.course.path.max_speed_m_s,
            max_speed_m_s: governor.max_speed_m_s,
            half_track_m: governor.half_track_m,
            acceleration_m_s2: governor.max_acceleration_m_s2,
            stop_deceleration_m_s2: governor.stop_deceleration_m_s2,
            speed_lag_s: 1.0 / governor.speed_rate_per_s,
            reversal_hold_s: governor.reversal_hold_s,
            max_wheel_speed_m_s: governor.max_wheel_speed_m_s,
            settle_time_s: regulator.settle_time_s,
            accept_distance_m: regulator.accept_distance_m,
            accept_heading_rad: regulator.accept_heading_rad,
            release_factor: regulator.release_factor,
            max_attempts: regulator.max_attempts,
            ..self.train
        }
    }
}

/// The algorithms of a lead node, without its state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Algorithms {
    pub(super) topology: Topology,
    // Derived from `topology` once, as each tick asks for them.
    pub(super) begin_phase: Micros,
    pub(super) step_phase: Micros,
    /// Ticks of an epoch that plan ahead.
    pub(super) planning_ticks: u32,
    pub(super) report_timeout: Micros,
    pub(super) longest_hold: Micros,
    pub(super) fusion: RobotFusion,
    pub(super) regulator: Regulator,
    pub(super) path_task: PathTask,
    pub(super) governor: Governor,
    /// Control of three and more axles; `None` for two.
    pub(super) train: Option<Train>,
    pub(super) cascade: Cascade,
    pub(super) limits: Limits,
    pub(super) ramp: ramp::Ramp,
    pub(super) frame_length: f32,
    pub(super) supervisor: Supervisor,
}

impl Algorithms {
    /// Topology of the robot.
    pub const fn topology(&self) -> Topology {
        self.topology
    }
}

/// Delay of the lead node's work after the beginning of an epoch, µs: the reports of all boards have arrived.
pub const fn begin_phase(robot: Topology) -> Micros {
    LEAD_PHASE + TICK * robot.axle_count().saturating_sub(4) as Micros
}

/// Delay of the lead node's step after the beginning of an epoch, µs. Of several pairs of axles, one is fused at each
/// tick from [`begin_phase`] on, then the step follows. A single pair is fused in the step.
pub const fn step_phase(robot: Topology) -> Micros {
    let ticks = match robot.frame_count() {
        1 => 0,
        pairs => pairs,
    };
    begin_phase(robot) + TICK * ticks as Micros
}

/// Number of ticks of an epoch in which the planner works. The other ticks are for the reports, for fusion and step, and
/// one is for the conditioning of a covariance.
const fn planning_ticks(robot: Topology) -> u32 {
    let work = (step_phase(robot) - begin_phase(robot)) / TICK;
    (EPOCH / TICK).saturating_sub(3 + work) as u32
}

/// Delay of the tick before the lead node's work after the beginning of an epoch, µs: the tick at which a board
/// executes orders of a host.
pub const fn order_phase(robot: Topology) -> Micros {
    begin_phase(robot) - TICK
}
