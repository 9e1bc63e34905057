//! Configuration of the axle node.

use super::{AxleNode, Neighbours, State};
use crate::bus::layout;
use crate::config::{ConfigError, declare, non_negative, positive};
use crate::control::{disturbance, dynamic, wheel_observer};
use crate::fusion::ekf;
use crate::fusion::standstill::{self, RestTimes};
use crate::math::{Posture, Twist};
use crate::safety::{ramp, supervisor};
use crate::time::Micros;
use crate::topology::{AxleId, Topology};

declare! {
    /// Source of the speed that the controller uses.
    pub enum SpeedSource, default Wheels {
        /// The tracking observers of the wheels: least lag.
        Wheels = "wheels",
        /// The axle filter.
        Filter = "filter",
    }
}

declare! {
    /// Parameters of an axle node.
    pub struct Config {
        /// Age of a mode or a reference after which the motors are switched off.
        pub reference_timeout_s: f32 = layout::timeout_s(layout::id::REFERENCE_POSTURE), "s": Range(0.01, 1.0);
        /// Age of a wrench from the beam after which it is no longer used.
        pub wrench_timeout_s: f32 = layout::timeout_s(layout::id::BEAM_WRENCH), "s": Range(0.01, 1.0);
        /// Source of the speed that the controller uses.
        pub speed_source: SpeedSource = SpeedSource::Wheels;
        /// Wheel observers.
        pub wheel: wheel_observer::Config = wheel_observer::Config::default();
        /// Time of rest after which the inertial sensors are zeroed: wheels still for the
        /// accelerometer, motors off too for the gyro.
        pub rest_hold_s: f32 = 0.1, "s": Range(0.01, 10.0);
        /// Time for which the motors must have been off before the gyro is zeroed, unless they never
        /// were on: a bent frame unwinds over creeping tyres.
        pub rest_settle_s: f32 = 60.0, "s": Range(0.0, 3600.0);
        /// Zeroing of the gyro at standstill.
        pub gyro_zero: standstill::Config = standstill::Config::GYRO;
        /// Zeroing of the accelerometer at standstill.
        pub accelerometer_zero: standstill::Config = standstill::Config::ACCELEROMETER;
        /// Axle filter.
        pub filter: ekf::Config = ekf::Config::default();
        /// Dynamic controller.
        pub controller: dynamic::Config = dynamic::Config::default();
        /// Disturbance observer.
        pub disturbance: disturbance::Config = disturbance::Config::default();
        /// Limits beyond which the axle stops.
        pub limits: Limits = Limits::default();
        /// Ramp of a stop.
        pub stop: ramp::Config = ramp::Config::default();
        /// Supervisor.
        pub supervisor: supervisor::Config = supervisor::Config::default();
        derived {
            /// Ratio of the right to the left wheel's radius.
            pub wheel_ratio: f32 = 1.0, "": Range(0.8, 1.25);
        }
    }
}

declare! {
    /// Limits that a sound axle keeps; each counts only after the time of its condition.
    pub struct Limits {
        /// Distance from the reference.
        pub tracking_m: f32 = 0.08, "m": Positive;
        /// Difference in heading from the reference.
        pub tracking_rad: f32 = 0.35, "rad": Positive;
        /// Share of the largest torque from which a wheel at standstill counts as blocked.
        pub stall_share: f32 = 0.6, "": Range(0.1, 1.0);
        /// Speed up to which a wheel counts as still.
        pub stall_rad_s: f32 = 0.2, "rad/s": Positive;
        /// Difference of the yaw rates by the wheels and by the gyro.
        pub slip_rad_s: f32 = 0.8, "rad/s": Positive;
        derived {
            /// Largest wheel speed over ground of an accepted reference.
            pub wheel_speed_m_s: f32 = 0.5, "m/s": Positive;
        }
    }
}

impl Limits {
    /// True if a posture error is within `times` the tracking limits.
    pub(super) fn near(&self, error: Posture, times: f32) -> bool {
        let (distance, turn) = (times * self.tracking_m, times * self.tracking_rad);
        error.x.abs() <= distance && error.y.abs() <= distance && error.phi.abs() <= turn
    }

    /// True if a motion keeps both wheels within the speed limit.
    pub(super) fn allow(&self, twist: Twist, half_track: f32) -> bool {
        twist.v.abs() + half_track * twist.omega.abs() <= self.wheel_speed_m_s
    }
}

/// Properties of the frame that an axle is fixed to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameProperties {
    /// Bending stiffness EI, N m².
    pub bending_stiffness_n_m2: f32,
    /// Flexible length L, m.
    pub length_m: f32,
    /// Rigid length between each end of the flexible part and its axle, m.
    pub rigid_end_m: f32,
}

impl Config {
    /// Builds the node of one axle; the error names the parameter that is wrong.
    pub fn build(
        &self,
        axle: AxleId,
        topology: Topology,
        frame: FrameProperties,
    ) -> Result<AxleNode, ConfigError> {
        self.check_ranges()?;
        positive("bending_stiffness_n_m2", frame.bending_stiffness_n_m2)?;
        positive("frame_length_m", frame.length_m)?;
        non_negative("rigid_end_m", frame.rigid_end_m)?;
        self.limits.check_ranges()?;
        let to_micros = |s: f32| (s * 1e6) as Micros;
        let period = positive("period_s", self.filter.period_s)?;
        let rest_hold = self.rest_hold_s;
        let rest_settle = self.rest_settle_s;
        let gyro_zero = self.gyro_zero.build(period)?;
        let wheel_radius = positive("wheel_radius_m", self.controller.wheel_radius_m)?;
        let ratio = self.wheel_ratio;
        let left = 2.0 * wheel_radius / (1.0 + ratio);
        Ok(AxleNode {
            axle,
            topology,
            frames: Neighbours {
                behind: topology.behind(axle),
                ahead: topology.ahead(axle),
            },
            frame,
            reference_timeout: to_micros(self.reference_timeout_s),
            wrench_timeout: to_micros(self.wrench_timeout_s),
            speed_source: self.speed_source,
            wheel_radius,
            wheel_radii: [left, ratio * left],
            half_track: positive("half_track_m", self.controller.half_track_m)?,
            period,
            rest: RestTimes {
                hold: (rest_hold / period).clamp(1.0, f32::from(u16::MAX)) as u16,
                settle: (rest_settle / period) as u32,
                spread: gyro_zero.spread(),
            },
            gyro_zero,
            accelerometer_zero: self.accelerometer_zero.build(period)?,
            observer: self.wheel.build()?,
            filter: self.filter.build()?,
            controller: self.controller.build()?,
            disturbance: self.disturbance.build(&self.controller)?,
            stall_torque: self.limits.stall_share * self.controller.max_torque_nm,
            limits: self.limits,
            ramp: self.stop.build(self.supervisor.stop_timeout_s)?,
            supervisor: self.supervisor.build()?,
            state: State::default(),
        })
    }
}
