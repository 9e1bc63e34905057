//! One frame of the robot: the strip in its clamps, and its present forces.

use super::CREEP;
use crate::config::PlantConfig;
use crate::frame::{Column, Equilibrium, Shape, Strip};
use crate::geometry::{Clamps, Geometry, Mat3, Vec3, add, times, unrotate};
use crate::lanes::Lanes;
use crate::state::{AxleState, Health, Wrench};

/// A frame, with its tip at the axle ahead and its root at the axle behind.
#[derive(Clone, Debug)]
pub struct Frame {
    pub strip: Strip,
    pub clamps: Clamps,
    damping: f64,
    /// Length of a substep, s.
    step: f64,
    pub equilibrium: Equilibrium,
    bend: Column,
    /// True if the strip is between two branches, held back by internal viscosity.
    pub creeping: bool,
    /// True if the frame is broken in two.
    pub snapped: bool,
    pub geometry: Geometry,
    pub stiffness: Mat3,
    viscosity: Mat3,
    /// Elastic wrench on the strip's end.
    pub elastic: Vec3,
    /// Elastic wrench plus damping, on the strip's end.
    pub total: Vec3,
}

impl Frame {
    /// Unloaded frame from checked constants; `step` is the length of a substep, s.
    pub fn new(config: &PlantConfig, step: f64) -> Self {
        let strip = Strip::new(
            config.strip_length_m,
            config.bending_stiffness_n_m2,
            config.axial_stiffness_n,
            config.natural_slope_rad,
        );
        Self {
            clamps: Clamps::new(
                [config.rigid_root_m, config.rigid_tip_m],
                [config.clamp_angle_root_rad, config.clamp_angle_tip_rad],
            ),
            damping: config.internal_damping_s,
            step,
            equilibrium: strip.unloaded(),
            bend: Column::ZERO,
            creeping: false,
            snapped: false,
            geometry: Geometry::default(),
            stiffness: [[0.0; 3]; 3],
            viscosity: [[0.0; 3]; 3],
            elastic: [0.0; 3],
            total: [0.0; 3],
            strip,
        }
    }

    /// Unloads the frame, whatever the postures of the axles.
    pub fn unload(&mut self) {
        self.equilibrium = self.strip.unloaded();
        self.bend = Column::ZERO;
        self.creeping = false;
    }

    /// Updates the geometry from the postures and directions of the axles, front and rear.
    #[inline(always)]
    pub fn locate(&mut self, postures: [&Vec3; 2], [front, rear]: [[f64; 2]; 2]) {
        let [f, r] = postures;
        let turn = [
            front[0] * rear[0] + front[1] * rear[1],
            front[1] * rear[0] - front[0] * rear[1],
        ];
        let position = unrotate(&[f[0] - r[0], f[1] - r[1]], rear);
        self.geometry = Geometry::new(&self.clamps, [front, rear], position, turn);
    }

    /// The strip's end in the strip's root frame, for a geometry and a turn of the front axle from the rear axle.
    #[inline(always)]
    pub fn end(&self, geometry: &Geometry, turn: f64) -> Vec3 {
        let [x, y] = geometry.end;
        [x - self.clamps.root_length, y, turn]
    }

    /// Updates the frame's wrench and stiffness at these body velocities of the axles.
    #[inline(always)]
    pub fn linearise(&mut self, velocities: &[Vec3; 2]) {
        if self.snapped {
            (self.stiffness, self.viscosity) = ([[0.0; 3]; 3], [[0.0; 3]; 3]);
            (self.elastic, self.total) = ([0.0; 3], [0.0; 3]);
            return;
        }
        self.stiffness = self.strip.stiffness(&self.equilibrium);
        self.viscosity = self.strip.viscosity(&self.equilibrium);
        self.elastic = self.strip.wrench(&self.equilibrium);
        self.total = self.damped(&self.elastic, &self.geometry.rate(velocities));
    }

    /// Elastic wrench plus the damping at a rate of the end.
    #[inline(always)]
    pub fn damped(&self, elastic: &Vec3, rate: &Vec3) -> Vec3 {
        add(elastic, self.damping, &times(&self.viscosity, rate))
    }

    /// Change of the wrench over a step `h` for a unit change of the rate of the strip's end.
    #[inline(always)]
    pub fn response(&self, h: f64) -> Mat3 {
        let mut response = [[0.0; 3]; 3];
        for m in 0..3 {
            for n in 0..3 {
                response[m][n] =
                    h * (self.damping * self.viscosity[m][n] + h * self.stiffness[m][n]);
            }
        }
        response
    }

    /// Elastic wrench at an end near the present end; zero for a broken frame. A creeping frame gives the linear
    /// prediction. Any other frame whose wrench is not found gives the linear prediction with `force`, else `None`.
    #[inline(always)]
    pub fn wrench_near<V: Lanes>(
        &mut self,
        end: Vec3,
        force: bool,
        health: &mut Health,
    ) -> Option<Vec3> {
        if self.snapped {
            return Some([0.0; 3]);
        }
        if !self.creeping {
            if let Some((wrench, bend)) = self.strip.near::<V>(&self.equilibrium, end) {
                self.bend = Column(bend.0.map(|g| g.map(|b| 4.0 * b)));
                return Some(wrench);
            }
            if !force {
                return None;
            }
        }
        self.bend = Column::ZERO;
        health.linear_wrenches += 1;
        Some(self.strip.linear_wrench(&self.equilibrium, end))
    }

    /// Finds the equilibrium at an end after a part `h` (s) of a step. If no equilibrium is near, gives false, so that
    /// the part can be shortened; with `force` the strip snaps through under internal viscosity instead.
    #[inline(always)]
    pub fn settle<V: Lanes>(
        &mut self,
        end: Vec3,
        h: f64,
        force: bool,
        health: &mut Health,
    ) -> bool {
        match self
            .strip
            .follow::<V>(&mut self.equilibrium, end, &self.bend)
        {
            Some(solved) => {
                self.creeping = false;
                health.factorisations += u64::from(solved.iterations);
                health.most_factorisations = health.most_factorisations.max(solved.iterations);
            }
            None if force || self.creeping => self.creep(h, health),
            None => return false,
        }
        true
    }

    #[cold]
    fn creep(&mut self, h: f64, health: &mut Health) {
        health.snap_throughs += u64::from(!self.creeping);
        health.creep_steps += 1;
        self.creeping = true;
        for ratio in CREEP {
            let ratio = ratio * self.step / h;
            if self.strip.creep(&mut self.equilibrium, ratio).is_some() {
                return;
            }
        }
        health.failures += 1;
    }

    /// Restores an earlier equilibrium from its shape.
    #[cold]
    pub fn restore(&mut self, shape: Shape) {
        self.strip.restore(&mut self.equilibrium, shape);
    }

    /// Converts a wrench on the strip's end to the frame's wrench on its axles.
    pub fn on_axles(&self, wrench: &Vec3) -> Wrench {
        let [front, rear] = self.geometry.transpose(wrench);
        Wrench {
            force: [-rear[0], -rear[1]],
            root_moment: -rear[2],
            end_moment: front[2],
        }
    }

    /// Turn of the front axle from the rear axle, plus the twist of the clamps, rad.
    #[inline(always)]
    pub fn turn(&self, front: &AxleState, rear: &AxleState) -> f64 {
        front.posture[2] - rear.posture[2] + self.clamps.twist
    }
}
