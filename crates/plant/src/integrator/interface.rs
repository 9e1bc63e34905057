//! Faults and variants of a [`Plant`], and its readings: postures, wrenches, gauges, outline of the
//! frame, energy.

use super::Plant;
use crate::config::PlantConfig;
use crate::frame::Station;
use crate::geometry::{Vec3, rotate, unrotate};
use crate::loads::check_payload;
use crate::state::{Health, PlantState, Wrench};
use declare::ConfigError;

/// Places along the frame, prepared by [`Plant::outline`]: on the strip, and how far beyond it.
#[derive(Clone, Debug)]
pub struct Outline(Vec<(Station, f64)>);

impl PlantConfig {
    /// The plant, at rest at the origin. Every constant is checked here; after that nothing fails.
    pub fn build(&self) -> Result<Plant, ConfigError> {
        self.check()?;
        check_payload(self)?;
        Ok(Plant::new(self))
    }
}

impl Plant {
    /// Lifts a wheel (axle 0 front, 1 rear; side 0 left, 1 right) off the ground for good.
    pub fn lift_wheel(&mut self, axle: usize, side: usize) {
        self.wheels.lift(2 * axle + side);
    }

    /// Breaks the frame in two for good: it exerts nothing and is not bent.
    pub fn snap_frame(&mut self) {
        self.snapped = true;
        self.linearise();
    }

    /// Copy computed without vector instructions; its results must be the same.
    pub fn portable(&self) -> Self {
        Self {
            #[cfg(target_arch = "x86_64")]
            wide: false,
            ..self.clone()
        }
    }

    /// Copy on frictionless ground, where the frame alone acts.
    pub fn without_friction(&self) -> Self {
        let mut free = self.clone();
        free.wheels.remove_friction();
        free
    }

    /// Time since [`Self::place`], s.
    pub fn time(&self) -> f64 {
        self.health.steps as f64 * self.step
    }

    /// The axles.
    pub fn state(&self) -> &PlantState {
        &self.state
    }

    /// Posture of O: middle between the axles (m), heading from rear to front (rad, within ±π).
    pub fn midpoint(&self) -> Vec3 {
        let [f, r] = self.state.axle.map(|a| a.posture);
        [
            0.5 * (f[0] + r[0]),
            0.5 * (f[1] + r[1]),
            libm::atan2(f[1] - r[1], f[0] - r[0]),
        ]
    }

    /// Front axle's posture in the rear axle's frame (m, m, rad not wrapped).
    pub fn relative_posture(&self) -> Vec3 {
        let [x, y] = self.geometry.position;
        let [f, r] = &self.state.axle;
        [x, y, f.posture[2] - r.posture[2]]
    }

    /// Wrench of the frame on the axles, elastic and damping.
    pub fn wrench(&self) -> Wrench {
        self.on_axles(&self.total)
    }

    /// Elastic part of [`Self::wrench`], which the strains show.
    pub fn elastic_wrench(&self) -> Wrench {
        self.on_axles(&self.elastic)
    }

    fn on_axles(&self, w: &Vec3) -> Wrench {
        let [front, rear] = self.geometry.transpose(w);
        Wrench {
            force: [-rear[0], -rear[1]],
            root_moment: -rear[2],
            end_moment: front[2],
        }
    }

    /// Elastic curvature of the strip (1/m) at arc length `s` (m) from its root: what a gauge
    /// bonded to the unloaded strip sees, divided by the half thickness. Positive: bent left.
    pub fn curvature(&self, s: f64) -> f64 {
        if self.creeping {
            self.strip.series_curvature(&self.equilibrium, s)
        } else {
            self.strip.elastic_curvature(&self.equilibrium, s)
        }
    }

    /// The place of a gauge at arc length `s` (m, clamped to the strip), for [`Self::gauges`].
    pub fn gauge(&self, s: f64) -> Station {
        self.strip.station(s)
    }

    /// Elastic curvature (1/m) at each gauge: [`Self::curvature`] by the same nodes for all.
    pub fn gauges(&self, stations: &[Station], mut visit: impl FnMut(usize, f64)) {
        if self.snapped {
            (0..stations.len()).for_each(|i| visit(i, 0.0));
            return;
        }
        if self.creeping {
            for (i, station) in stations.iter().enumerate() {
                visit(
                    i,
                    self.strip.series_curvature_at(&self.equilibrium, station),
                );
            }
            return;
        }
        let tangents = self.strip.tangents(&self.equilibrium);
        for (i, station) in stations.iter().enumerate() {
            let curvature = self
                .strip
                .curvature_at(&self.equilibrium, &tangents, station);
            visit(i, curvature);
        }
    }

    /// `points` places along the frame, evenly from the rear axle to the front axle, for
    /// [`Self::draw`].
    pub fn outline(&self, points: usize) -> Outline {
        let length = self.strip.length();
        let root = self.clamps.root_length;
        let whole = root + length + self.clamps.tip_length;
        let place = |k: usize| {
            let along = whole * k as f64 / points.saturating_sub(1).max(1) as f64;
            let s = (along - root).clamp(0.0, length);
            (self.strip.station(s), along - root - s)
        };
        Outline((0..points).map(place).collect())
    }

    /// Points of the frame, global, m; as many as `out` and the outline both have.
    pub fn draw(&self, outline: &Outline, out: &mut [[f64; 2]]) {
        let rear = self.state.axle[1].posture;
        let tangents = self.strip.tangents(&self.equilibrium);
        let clamps = &self.clamps;
        let ahead = unrotate(&rotate(&clamps.tip, self.geometry.turn), clamps.root);
        for ((station, rest), out) in outline.0.iter().zip(out) {
            let [x, y] = self.strip.position(&tangents, station);
            // The rigid ends point as the clamps do.
            let [c, s] = if *rest > 0.0 { ahead } else { [1.0, 0.0] };
            let point = [x + clamps.root_length + rest * c, y + rest * s];
            let [x, y] = rotate(&rotate(&point, clamps.root), self.geometry.rear);
            *out = [rear[0] + x, rear[1] + y];
        }
    }

    /// Kinetic energy of axles and wheels and elastic energy of the frame, J.
    pub fn energy(&self) -> f64 {
        let mut energy = self.strip.energy(&self.equilibrium);
        for (i, a) in self.state.axle.iter().enumerate() {
            energy += self.bodies[i].energy(&a.velocity);
        }
        energy + self.wheels.energy(&self.speeds()) + self.drivetrain.energy(&self.wheels)
    }

    /// Shows the wheel loads in the state.
    pub(super) fn publish_loads(&mut self) {
        for w in 0..4 {
            self.state.axle[w / 2].load[w % 2] = self.loads.now[w];
        }
    }

    /// Counters since [`Self::place`].
    pub fn health(&self) -> Health {
        self.health
    }
}
