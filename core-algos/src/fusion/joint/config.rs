//! Configuration of the joint filter.

use super::{GRAVITY, Joint, inconsistency};
use crate::beam::strip::{self, PostureSigmas};
use crate::config::{ConfigError, declare, in_range, positive};
use crate::fusion::constants::{
    self, COMPLIANCE, DRIFT, GAIN, GYRO_BIAS, GYRO_SCALE, SCALE, SIDE, TURN, Tyres, UNEVEN, ZERO,
};
use crate::math::trig::sqrt;

declare! {
    /// Parameters of the joint filter.
    pub struct Config {
        /// Slip stiffness of the tyres per load (C): rubber on a firm floor 10 to 40.
        pub slip_stiffness: f32 = 20.0, "": Range(1.0, 1e4);
        /// Friction coefficient of the tyres.
        pub friction: f32 = 0.7, "": Positive;
        /// Relative standard deviation of the slip common to all tyres, due to floor and rubber.
        pub slip_sigma: f32 = 0.5, "": NonNegative;
        /// Relative standard deviation of the slip of each tyre beyond the common slip.
        pub tyre_slip_sigma: f32 = 0.3, "": NonNegative;
        /// Standard deviation of an axle's heading drift: relative difference of its wheel radii
        /// divided by the track.
        // Radii of each wheel known to 0.4 %, 0.324 m apart.
        pub heading_drift_sigma_rad_per_m: f32 = 1.75e-2, "rad/m": NonNegative;
        /// Standard deviation of an axle's scale error (relative error of the mean wheel radius).
        pub scale_sigma: f32 = 2.8e-3, "": NonNegative;
        /// Standard deviation of the scale error of the headings that the wheels report: relative error
        /// of an axle's track.
        pub turn_scale_sigma: f32 = 1.25e-2, "": NonNegative;
        /// Standard deviation of an axle's lateral motion per forward motion.
        pub side_slip_sigma: f32 = 3e-3, "": NonNegative;
        /// Standard deviation of a gyro's bias at the start of a drive.
        // Zeroed over 0.4 s at rest: 4.9e-5 rad/s/√Hz of noise leave 5.5e-5 rad/s.
        pub gyro_bias_sigma_rad_s: f32 = 6e-5, "rad/s": NonNegative;
        /// Random walk of a gyro's bias.
        pub gyro_bias_walk_rad_s_per_sqrt_s: f32 = 5e-5, "rad/s/√s": NonNegative;
        /// Standard deviation of a gyro's scale error.
        pub gyro_scale_sigma: f32 = 5e-3, "": NonNegative;
        /// Standard deviation of a constant turn of the whole robot: lasting errors that the states do not describe.
        /// It shows in hours of driving.
        pub steady_turn_sigma_rad_per_m: f32 = 3e-4, "rad/m": NonNegative;
        /// Time constant with which estimates of tyres, wheels and gains fade to their priors.
        pub constancy_s: f32 = 3600.0, "s": Positive;
        /// Standard deviation of the difference between the travel of a wheel and that of its encoder due to
        /// backlash. Beam and odometry disagree by as much.
        // Uniform over 5 mrad of a wheel with a radius of 73 mm.
        pub play_sigma_m: f32 = 1.1e-4, "m": NonNegative;
        derived {
            /// Standard deviations of the beam posture's errors due to zeros and gains of the gauges.
            // Default: the default strip.
            pub beam: PostureSigmas = strip::Config::default().sigmas();
            /// Half the track (the paper's d).
            pub half_track_m: f32 = 0.162, "m": Positive;
            /// Moment of the frame on an axle per radian of relative heading, EI/L.
            pub frame_moment_n_m: f32 = 0.833 / 0.37, "N m": Positive;
            /// Mass that the wheels of an axle carry.
            pub axle_mass_kg: f32 = 4.76, "kg": Positive;
        }
    }
}

impl Config {
    /// Builds the filter for ticks of `period_s`; an error names the parameter out of range.
    pub fn build(&self, period_s: f32) -> Result<Joint, ConfigError> {
        self.check_ranges()?;
        let t = positive("period_s", period_s)?;
        macro_rules! variance {
            ($($field:ident).+) => {{
                let sigma = self.$($field).+;
                sigma * sigma
            }};
        }
        let half_track = self.half_track_m;
        let moment = self.frame_moment_n_m;
        let wheel_load = 0.5 * GRAVITY * self.axle_mass_kg;
        let stiffness = self.slip_stiffness;
        let tyres = Tyres {
            half_track,
            compliance: moment / (2.0 * half_track * half_track * wheel_load * stiffness),
            sliding: 2.0 * half_track * self.friction * wheel_load / moment,
        };
        let compliance = tyres.compliance * tyres.compliance;
        // A compliance state is the mean, or half the difference, of two axles with two tyres each: a quarter of the
        // variance of one tyre.
        let of_tyres = 0.25 * variance!(tyre_slip_sigma);
        let mut prior = [0.0; constants::COUNT];
        let mut walk = [0.0; constants::COUNT];
        prior[ZERO] = variance!(beam.zero_rad);
        prior[ZERO + 1] = variance!(beam.zero_tilt_m);
        prior[GAIN] = variance!(beam.gain);
        prior[GAIN + 1] = variance!(beam.gain_tilt_m);
        prior[COMPLIANCE] = compliance * (variance!(slip_sigma) + of_tyres);
        prior[COMPLIANCE + 1] = compliance * of_tyres;
        for (first, variance) in [
            (DRIFT, variance!(heading_drift_sigma_rad_per_m)),
            (SCALE, variance!(scale_sigma)),
            (TURN, variance!(turn_scale_sigma)),
            (SIDE, variance!(side_slip_sigma)),
            (UNEVEN, 2.0 * compliance * of_tyres),
            (GYRO_BIAS, variance!(gyro_bias_sigma_rad_s)),
            (GYRO_SCALE, variance!(gyro_scale_sigma)),
        ] {
            prior[first] = variance;
            prior[first + 1] = variance;
        }
        walk[ZERO] = t * variance!(beam.walk_rad_per_sqrt_s);
        walk[ZERO + 1] = t * variance!(beam.walk_tilt_m_per_sqrt_s);
        walk[GYRO_BIAS] = t * variance!(gyro_bias_walk_rad_s_per_sqrt_s);
        walk[GYRO_BIAS + 1] = walk[GYRO_BIAS];
        let backlash = variance!(play_sigma_m);
        let constancy_s = in_range("constancy_s", self.constancy_s, 10.0 * t, 1e7)?;
        // The limit of a constant with a random walk includes its walk over the time `constancy_s`.
        let mut per_limit = [0.0; constants::COUNT];
        for (k, per_limit) in per_limit.iter_mut().enumerate() {
            let sigma = sqrt(prior[k] + walk[k] * (constancy_s / t));
            *per_limit = match sigma > 0.0 {
                true => 1.0 / (inconsistency::SIGMAS * sigma),
                false => 0.0,
            };
        }
        Ok(Joint {
            t,
            steady_turn: variance!(steady_turn_sigma_rad_per_m),
            backlash_heading: 0.5 * backlash / (half_track * half_track),
            backlash_position: 0.5 * backlash,
            tyres,
            prior,
            per_limit,
            kept: 1.0 - t / constancy_s,
            walk,
        })
    }
}
