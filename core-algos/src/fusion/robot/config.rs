//! Configuration of the fusion.

use super::{RobotFusion, WALK_TIME_S, ground};
use crate::config::{ConfigError, declare, positive};
use crate::fusion::{constants, intersection, ipec, joint};
use crate::math::trig::sqrt;

declare! {
    /// Fusion method.
    pub enum Mode, default Joint {
        /// Each axle's odometry alone; for a robot without a beam board.
        Odometry = "odometry",
        /// Covariance intersection through the beam.
        Intersection = "intersection" or "ci",
        /// Covariance intersection and internal posture error correction.
        IntersectionIpec = "intersection-ipec" or "ci+ipec",
        /// One filter of both axles.
        Joint = "joint",
    }
}

declare! {
    /// Slip of an axle that its wheels do not measure, as random walks.
    pub struct Slip {
        /// Slip along the heading that grows with distance.
        pub along_m_per_sqrt_m: f32 = 5e-4, "m/√m": NonNegative;
        /// Slip across the heading that grows with distance.
        pub across_m_per_sqrt_m: f32 = 2e-4, "m/√m": NonNegative;
        /// Slip across the heading, per radian of relative heading: tyres slip under the side force as long as a turn
        /// lasts.
        pub side_m_per_sqrt_m: f32 = 1e-3, "m/√m/rad": NonNegative;
        /// Slip in heading that grows with distance.
        pub heading_rad_per_sqrt_m: f32 = 2e-3, "rad/√m": NonNegative;
        /// Slip in heading that grows with time, at any speed.
        pub heading_rad_per_sqrt_s: f32 = 2e-4, "rad/√s": NonNegative;
        /// Slip in heading that grows with time, per radian of relative heading.
        pub creep_per_sqrt_s: f32 = 2e-3, "rad/√s/rad": NonNegative;
        /// Slip in heading that grows with distance, per radian of relative heading.
        pub creep_per_sqrt_m: f32 = 5e-3, "rad/√m/rad": NonNegative;
        /// Slip in position that grows with time, at any speed.
        pub position_m_per_sqrt_s: f32 = 1e-5, "m/√s": NonNegative;
        /// Speed at which an axle slips under the load of the frame in a mode without the beam; in heading this speed
        /// over half the track. Constant throughout a drive.
        // Uniform up to 10 mm/s, where a tyre reaches half of its friction.
        pub load_speed_m_s: f32 = 5.8e-3, "m/s": NonNegative;
    }
}

declare! {
    /// Parameters of the fusion of both axles and the beam.
    pub struct Config {
        /// Fusion method.
        pub mode: Mode = Mode::Joint;
        /// Standard deviations of the front axle's posture in the rear axle's frame at the start, the
        /// frame being taken as straight.
        pub frame_sigmas: [f32; 3] = [1e-3, 1e-3, 4e-3], "m, m, rad": Positive;
        /// Slip added to each axle's increments.
        pub slip: Slip = Slip::default();
        /// Noise of the joint filter's increments on uneven ground.
        pub ground: ground::Config = ground::Config::default();
        /// Largest accepted normalised innovation squared (NIS) of the beam's posture, three degrees of freedom.
        /// Without a value, every measurement is accepted.
        pub beam_gate: Option<f32> = Some(40.0), "": Positive;
        /// Rejections of the beam in a row after which its next measurement is accepted.
        pub gate_patience: u16 = 50, "": Range(0.0, 65_535.0);
        /// Covariance intersection.
        // Trace, because the determinant depends on relative sizes only and does not favour the axle whose large
        // error shrinks. Length 1 m: a heading error counts as the position error it makes over the next metre.
        pub intersection: intersection::Config = intersection::Config {
            criterion: intersection::Criterion::Trace,
            heading_length_m: 1.0,
        };
        /// Internal posture error correction.
        pub ipec: ipec::Config = ipec::Config::default();
        /// Joint filter. The other modes use its constant errors too, except the steady turn of the whole robot.
        pub joint: joint::Config = joint::Config::default();
        derived {
            /// Time between two ticks.
            pub period_s: f32 = 0.01, "s": Positive;
        }
    }
}

impl Config {
    /// Builds the fusion; an error names the parameter out of range.
    pub fn build(&self) -> Result<RobotFusion, ConfigError> {
        self.check_ranges()?;
        self.slip.check_ranges()?;
        let square = |x: f32| x * x;
        let t = self.period_s;
        let slip = &self.slip;
        let joint = self.joint.build(t)?;
        Ok(RobotFusion {
            mode: self.mode,
            period: t,
            per_m: [
                square(slip.along_m_per_sqrt_m),
                square(slip.across_m_per_sqrt_m),
                square(slip.heading_rad_per_sqrt_m),
            ],
            side_per_m: square(slip.side_m_per_sqrt_m),
            position_per_tick: t * square(slip.position_m_per_sqrt_s),
            heading_per_tick: t * square(slip.heading_rad_per_sqrt_s),
            creep_per_tick: t * square(slip.creep_per_sqrt_s),
            creep_per_m: square(slip.creep_per_sqrt_m),
            constants: sigmas(&joint, &self.joint),
            load: match self.mode {
                Mode::Odometry => {
                    let speed = slip.load_speed_m_s;
                    let half_track = 0.5 * positive("track_m", self.ipec.track_m)?;
                    [speed, speed, speed / half_track]
                }
                _ => [0.0; 3],
            },
            ground: self.ground.build()?,
            beam_gate: self.beam_gate,
            patience: self.gate_patience,
            intersection: self.intersection.build()?,
            ipec: self.ipec.build()?,
            joint,
        })
    }
}

/// Standard deviations of the constants for the modes without the joint filter: the priors of the joint filter, with
/// the random walk of the gyros' biases and the modelled slip of the tyres added. Only the joint filter subtracts the
/// modelled slip.
fn sigmas(joint: &joint::Joint, config: &joint::Config) -> [f32; constants::COUNT] {
    let mut own = joint.prior_sigmas();
    // A bias walk adds walk²·T³/3 to the heading variance in a time T. A constant bias of variance walk²·T/3 adds the
    // same.
    let walk = config.gyro_bias_walk_rad_s_per_sqrt_s;
    for bias in &mut own[constants::GYRO_BIAS..constants::GYRO_BIAS + 2] {
        *bias = sqrt(*bias * *bias + walk * walk * WALK_TIME_S / 3.0);
    }
    let slip = &mut own[constants::COMPLIANCE];
    let all = joint.tyres().compliance;
    *slip = sqrt(*slip * *slip + all * all);
    own
}
