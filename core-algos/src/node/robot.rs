//! Configuration of the whole robot: every constant once, handed to the algorithms that need it.
//!
//! The configurations of the algorithms have fields for dimensions and limits, so that each can be used by itself. In
//! a robot, [`RobotConfig::completed`] fills these fields from [`Geometry`] and [`Limits`], so that each dimension is
//! configured once.

use super::lead::Placement;
use super::{axle, beam, lead};
use crate::beam::sensor;
use crate::config::{Allowed, ConfigError, declare};
use crate::fusion::Estimate;
use crate::math::Posture;
use crate::math::trig::sin_cos;
use crate::safety::supervisor;
use crate::topology::{AxleId, FrameId, MAX_AXLES, Topology};

declare! {
    /// Dimensions and stiffness of the robot as configured.
    pub struct Geometry {
        /// Number of axles. A frame joins each two neighbouring axles.
        pub axles: u32 = 2, "": Range(2.0, MAX_AXLES as f32);
        /// Flexible length of the frame (the paper's L).
        pub frame_length_m: f32 = 0.37, "m": Range(0.05, 5.0);
        /// Rigid length between each end of the flexible part and the nearer axle.
        pub rigid_end_m: f32 = 0.0, "m": Range(0.0, 1.0);
        /// Distance of the strain gauges from the neutral axis: half the strip's thickness.
        pub half_thickness_m: f32 = 0.5e-3, "m": Range(5e-5, 0.02);
        /// Bending stiffness EI of the frame.
        pub bending_stiffness_n_m2: f32 = 0.833, "N m²": Range(1e-3, 1e3);
        /// Half of the distance between the wheels of an axle (the paper's d).
        pub half_track_m: f32 = 0.162, "m": Range(0.02, 2.0);
        /// Radius of the wheels (the paper's r_w).
        pub wheel_radius_m: f32 = 0.073, "m": Range(0.01, 0.5);
        /// Ratio of the right to the left wheel's radius; `wheel_radius_m` is their mean.
        pub wheel_ratio: f32 = 1.0, "": Range(0.8, 1.25);
        /// Encoder counts per revolution of a wheel, gear and edges included.
        pub encoder_counts_per_revolution: u32 = 8192, "": Range(16.0, 1e6);
    }
}

declare! {
    /// Limits of the midpoint's motion.
    pub struct Limits {
        /// Largest speed of the midpoint.
        pub max_speed_m_s: f32 = 0.25, "m/s": Range(0.01, 2.0);
        /// Largest steering angle |ψ| the frame may be bent to; bounds the curvature by
        /// 2ψ/(L cos ψ).
        pub max_steering_rad: f32 = 0.5, "rad": Range(0.05, 1.2);
        /// Margin between the largest steering angle and the largest command, because the true angle may exceed its
        /// command.
        ///
        /// On creeping tyres the frame's moment holds the true angle about 2 % below its command. On stiff tyres lag
        /// and the error of the beam let the true angle exceed its command, by 3 mrad at most in simulation.
        pub steering_margin_rad: f32 = 0.005, "rad": Range(0.0, 0.25);
    }
}

impl Limits {
    /// Largest steering angle that is commanded, rad.
    pub fn commanded_steering_rad(&self) -> f32 {
        self.max_steering_rad - self.steering_margin_rad
    }
}

declare! {
    /// Configuration of all boards of a robot.
    pub struct RobotConfig {
        /// Dimensions and stiffness.
        pub geometry: Geometry = Geometry::default();
        /// Limits of motion.
        pub limits: Limits = Limits::default();
        /// Both axle nodes.
        pub axle: axle::Config = axle::Config::default();
        /// Beam node.
        pub beam: sensor::Config = sensor::Config::default();
        /// Lead node.
        pub lead: lead::Config = lead::Config::default();
    }
}

/// Start posture of the midpoint for operation by the button (m, m, rad), as in the paper's experiment; the goal is
/// the origin.
pub const START: Posture = Posture::new(-1.342, -1.342, 0.0);

/// Accuracy of placement and floor, given by the operator; no sensor on board measures them.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(deny_unknown_fields, default))]
pub struct ConfiguredPlacement {
    /// Standard deviation of the start along each axis, m.
    pub placement_m: f32,
    /// Standard deviation of the start's heading, rad.
    pub placement_rad: f32,
    /// Displacement of the robot by the floor per metre rolled, standard deviation along each of the floor's axes.
    pub floor_drift: f32,
}

impl Default for ConfiguredPlacement {
    /// Robot placed by eye on a thick carpet.
    fn default() -> Self {
        Self {
            placement_m: 5e-3,
            placement_rad: 1e-2,
            floor_drift: 1.5e-2,
        }
    }
}

/// Smallest standard deviation of a start, m and rad, so that the covariance is positive definite.
const EXACT: f32 = 1e-6;

/// The nodes of a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    /// Axle nodes, front first.
    pub axles: [axle::AxleNode; 2],
    /// Beam node.
    pub beam: beam::BeamNode,
    /// Lead node.
    pub lead: lead::LeadNode,
}

/// Largest plausible wheel speed of a reference, over the largest speed of the midpoint. In the tightest bend the outer
/// wheel rolls at 1.6 times the speed of the midpoint, and corrections add to it.
const WHEEL_SPEED: f32 = 2.0;

impl RobotConfig {
    /// The configuration with geometry and limits copied into every part that needs them.
    pub fn completed(mut self) -> Self {
        let Geometry {
            frame_length_m,
            rigid_end_m,
            half_track_m,
            wheel_radius_m,
            wheel_ratio,
            encoder_counts_per_revolution,
            ..
        } = self.geometry;
        self.axle.wheel_ratio = wheel_ratio;
        self.axle.wheel.counts_per_revolution = encoder_counts_per_revolution;
        self.axle.filter.track_m = 2.0 * half_track_m;
        self.axle.controller.half_track_m = half_track_m;
        self.axle.controller.wheel_radius_m = wheel_radius_m;

        self.beam.strip.length_m = frame_length_m;
        self.beam.strip.half_thickness_m = self.geometry.half_thickness_m;
        self.beam.strip.rigid_root_m = rigid_end_m;
        self.beam.strip.rigid_tip_m = rigid_end_m;
        self.beam.strip.bending_stiffness_n_m2 = self.geometry.bending_stiffness_n_m2;

        let max_speed_m_s = self.limits.max_speed_m_s;
        self.axle.limits.wheel_speed_m_s = WHEEL_SPEED * max_speed_m_s;
        let max_steering_rad = self.limits.commanded_steering_rad();
        self.lead.cascade.frame_length_m = frame_length_m;
        self.lead.cascade.rigid_end_m = rigid_end_m;
        self.lead.cascade.max_steering_rad = max_steering_rad;
        self.lead.fusion.ipec.track_m = 2.0 * half_track_m;
        let joint = &mut self.lead.fusion.joint;
        joint.beam = self.beam.strip.sigmas();
        joint.half_track_m = half_track_m;
        joint.frame_moment_n_m = self.geometry.bending_stiffness_n_m2 / frame_length_m;
        joint.axle_mass_kg = self.axle.controller.mass_kg;
        self.lead.governor.half_track_m = half_track_m;
        self.lead.governor.max_speed_m_s = max_speed_m_s;
        self.lead.governor.max_steering_rad = max_steering_rad;
        // Rigid ends make the path straighter. Eq. 5 with this length gives its curvature, 2 tan ψ/(L sin ψ/ψ + 2a cos
        // ψ).
        let (s, c) = sin_cos(max_steering_rad);
        self.lead.regulator.limits.frame_length_m =
            frame_length_m + 2.0 * rigid_end_m * max_steering_rad * c / s.max(1e-6);
        self.lead.regulator.braking_m_s2 = self.lead.governor.max_acceleration_m_s2;
        self.lead.regulator.speed_lag_s = 1.0 / self.lead.governor.speed_rate_per_s;
        self.lead.regulator.limits.max_speed_m_s = max_speed_m_s;
        self.lead.regulator.limits.max_steering_rad = max_steering_rad;
        let path = &mut self.lead.course.path;
        path.max_speed_m_s = path.max_speed_m_s.min(max_speed_m_s);
        self
    }

    /// Placement of the robot with its midpoint at `start` and its frame straight.
    pub fn placement(&self, start: Posture, configured: &ConfiguredPlacement) -> Placement {
        let geometry = &self.geometry;
        let straight_m = geometry.frame_length_m + 2.0 * geometry.rigid_end_m;
        let [position, heading] =
            [configured.placement_m, configured.placement_rad].map(|sigma| sigma.max(EXACT));
        Placement {
            center: Estimate::with_sigmas(start, [position, position, heading]),
            relative: Estimate::with_sigmas(
                Posture::new(straight_m, 0.0, 0.0),
                self.lead.fusion.frame_sigmas,
            ),
            floor_drift: configured.floor_drift,
        }
    }

    /// Checks dimensions and limits; the error names the parameter that is wrong.
    fn check(&self) -> Result<(), ConfigError> {
        let geometry = &self.geometry;
        geometry.check_ranges()?;
        self.limits.check_ranges()?;
        Allowed::Range(0.0, 0.5 * self.limits.max_steering_rad)
            .check("steering_margin_rad", self.limits.steering_margin_rad)?;
        Ok(())
    }

    /// Topology of the robot. A number of axles that is not allowed counts as two; [`Self::build`] refuses it.
    pub const fn topology(&self) -> Topology {
        match Topology::new(self.geometry.axles as usize) {
            Some(topology) => topology,
            None => Topology::PAIR,
        }
    }

    /// Builds the nodes; the error names the parameter that is wrong.
    pub fn build(&self) -> Result<Robot, ConfigError> {
        Ok(Robot {
            axles: [self.build_axle(AxleId(0))?, self.build_axle(AxleId(1))?],
            beam: self.build_beam(FrameId(0))?,
            lead: lead::LeadNode::new(self.build_lead()?),
        })
    }

    /// Builds the node of one axle alone.
    pub fn build_axle(&self, axle: AxleId) -> Result<axle::AxleNode, ConfigError> {
        self.check()?;
        let frame = axle::FrameProperties {
            bending_stiffness_n_m2: self.geometry.bending_stiffness_n_m2,
            length_m: self.geometry.frame_length_m,
            rigid_end_m: self.geometry.rigid_end_m,
        };
        self.completed().axle.build(axle, self.topology(), frame)
    }

    /// Builds the node of one frame alone.
    pub fn build_beam(&self, frame: FrameId) -> Result<beam::BeamNode, ConfigError> {
        self.check()?;
        // The beam board has no motors, so no parameter of its supervisor matters.
        let supervisor = supervisor::Config::default().build()?;
        Ok(beam::BeamNode::new(
            self.topology(),
            frame,
            self.completed().beam.build()?,
            supervisor,
        ))
    }

    /// Builds the algorithms of the lead node.
    pub fn build_lead(&self) -> Result<lead::Algorithms, ConfigError> {
        self.check()?;
        self.completed().lead.build(self.topology())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::beam::sensor::PostureSolver;
    use crate::control::kinematic::curvature_of_steering;
    use crate::fusion::constants;
    use crate::math::Steering;

    #[test]
    fn every_commanded_steering_limit_keeps_the_margin() {
        let config = RobotConfig::default().completed();
        for commanded in [
            config.lead.governor.max_steering_rad,
            config.lead.cascade.max_steering_rad,
            config.lead.regulator.limits.max_steering_rad,
        ] {
            assert!((commanded - 0.495).abs() < 1e-6);
        }
        let mut bad = RobotConfig::default();
        bad.limits.steering_margin_rad = 0.3;
        assert_eq!(bad.build().unwrap_err().field, "steering_margin_rad");
        bad.limits.steering_margin_rad = f32::NAN;
        assert!(bad.build().is_err());
        bad.limits.steering_margin_rad = 0.24;
        assert!(bad.build().is_ok());
        bad.geometry.encoder_counts_per_revolution = 0;
        let field = bad.build().unwrap_err().field;
        assert_eq!(field, "encoder_counts_per_revolution");
    }

    #[test]
    fn geometry_and_limits_reach_every_part() {
        let near = |found: f32, expected: f32| {
            assert!((found / expected - 1.0).abs() < 1e-5, "{found} {expected}");
        };
        let mut config = RobotConfig::default();
        config.geometry.rigid_end_m = 0.05;
        config.geometry.half_track_m = 0.2;
        config.geometry.bending_stiffness_n_m2 = 0.5;
        config.geometry.frame_length_m = 0.4;
        config.limits.max_speed_m_s = 0.15;
        let robot = config.build().unwrap();
        assert_eq!(robot.axles.map(|axle| axle.axle()), [AxleId(0), AxleId(1)]);
        let completed = config.completed();
        near(completed.beam.strip.rigid_root_m, 0.05);
        near(completed.beam.strip.rigid_tip_m, 0.05);
        near(completed.beam.strip.bending_stiffness_n_m2, 0.5);
        near(completed.axle.filter.track_m, 0.4);
        near(completed.axle.limits.wheel_speed_m_s, 0.3);
        near(completed.lead.fusion.ipec.track_m, 0.4);
        near(completed.lead.fusion.joint.frame_moment_n_m, 0.5 / 0.4);
        near(completed.lead.course.path.max_speed_m_s, 0.15);
        near(completed.lead.cascade.frame_length_m, 0.4);
        near(completed.lead.cascade.rigid_end_m, 0.05);
        near(completed.beam.strip.length_m, 0.4);
        near(completed.lead.governor.half_track_m, 0.2);
        let exact = ConfiguredPlacement {
            placement_m: 0.0,
            placement_rad: 0.0,
            ..ConfiguredPlacement::default()
        };
        let certain = config.placement(START, &exact).center.covariance;
        assert!((0..3).all(|i| certain[i][i] > 0.0), "{certain:?}");
        let placement = config.placement(START, &ConfiguredPlacement::default());
        near(placement.relative.posture.x, 0.5);
        near(placement.center.posture.x, -1.342);
        near(placement.center.posture.y, -1.342);
        let variances = [0, 1, 2].map(|i| placement.center.covariance[i][i]);
        for (found, expected) in variances.into_iter().zip([25e-6, 25e-6, 1e-4]) {
            near(found, expected);
        }
    }

    /// Regulator and cascade give the same curvature for the largest steering angle.
    #[test]
    fn regulator_and_cascade_agree_with_rigid_ends() {
        for rigid_end_m in [0.0, 0.02, 0.1] {
            let mut config = RobotConfig::default();
            config.geometry.rigid_end_m = rigid_end_m;
            let lead = config.completed().lead;
            let limits = lead.regulator.limits;
            let regulated =
                curvature_of_steering(Steering(limits.max_steering_rad), limits.frame_length_m);
            let bent = lead.cascade.build().unwrap().max_curvature();
            assert!((regulated - bent).abs() < 1e-5 * bent, "{regulated} {bent}");
        }
    }

    /// Covariance of (y, φ) due to the zero errors of the gauges, by differences.
    fn zero_covariance(config: &sensor::Config, curvature: f32) -> [[f32; 2]; 2] {
        let strip = config.strip.build().unwrap();
        let solver = PostureSolver::new(strip, config.method, config.segments).unwrap();
        let half_thickness = config.strip.half_thickness_m;
        let gauges = config.strip.gauges_m.count();
        let at = |change: &dyn Fn(usize) -> f32| {
            let mut strain = [0.0; crate::beam::MAX_GAUGES];
            for i in 0..gauges {
                strain[i] = curvature * half_thickness + change(i);
            }
            let solution = solver.solve(&strain, strip.gauges()).unwrap();
            let p = solution.relative.posture;
            [p.y, p.phi]
        };
        let step = 2e-5;
        let base = at(&|_| 0.0);
        let mut covariance = [[0.0; 2]; 2];
        let u = config.strip.uncertainty;
        let mut add = |sigma: f32, to: &dyn Fn(usize) -> bool| {
            let moved = at(&|i| if to(i) { step } else { 0.0 });
            let by = [0, 1].map(|k| (moved[k] - base[k]) / step * sigma);
            for i in 0..2 {
                for j in 0..2 {
                    covariance[i][j] += by[i] * by[j];
                }
            }
        };
        add(u.common_offset_strain, &|_| true);
        for gauge in 0..gauges {
            add(u.offset_strain, &|i| i == gauge);
        }
        covariance
    }

    #[test]
    fn filter_prior_of_the_beam_matches_the_zero_errors_of_its_gauges() {
        let config = RobotConfig::default().completed();
        let beam = config.lead.fusion.joint.beam;
        let length = config.geometry.frame_length_m;
        for curvature in [0.0, 1.0, -2.0] {
            let p = zero_covariance(&config.beam, curvature);
            let bend = curvature * length;
            let (x, y) = match bend == 0.0 {
                true => (length, 0.0),
                false => (bend.sin() / curvature, (1.0 - bend.cos()) / curvature),
            };
            let by = constants::beam_by_constants(Posture::new(x, y, bend));
            let sigmas = [beam.zero_rad, beam.zero_tilt_m];
            for (i, row) in [1, 2].into_iter().enumerate() {
                for (j, column) in [1, 2].into_iter().enumerate() {
                    let stated: f32 = (0..2)
                        .map(|k| sigmas[k] * sigmas[k] * by[row][k] * by[column][k])
                        .sum();
                    let scale = (p[i][i] * p[j][j]).sqrt();
                    let error = (stated - p[i][j]).abs() / scale;
                    assert!(error < 0.1, "{curvature} {i}{j} {stated:e} {p:?}");
                }
            }
        }
    }
}
