//! Faults and variants of a [`Plant`], and its readings: postures, wrenches, gauges, outlines of the
//! frames, energy. Axles and frames are numbered from 0 at the front.

use super::frame::Frame;
use super::{Plant, linearise, of_group};
use crate::config::PlantConfig;
use crate::frame::Station;
use crate::geometry::{Vec3, rotate, unrotate};
use crate::loads::check_payload;
use crate::state::{AxleState, Health, Wrench};
use declare::ConfigError;

/// Prepared points along a frame, from [`Plant::outline`].
#[derive(Clone, Debug)]
pub struct Outline {
    frame: usize,
    /// Nearest place on the strip, and signed distance (m) from there along a rigid end; negative at the root.
    places: Vec<(Station, f64)>,
}

impl PlantConfig {
    /// The plant of a robot with `axles` axles, 2 to [`MAX_AXLES`](crate::MAX_AXLES), at rest at the origin. Checks
    /// every constant; the plant cannot fail afterwards.
    pub fn build(&self, axles: usize) -> Result<Plant, ConfigError> {
        self.check()?;
        let config = self.for_axles(axles)?;
        check_payload(&config)?;
        Ok(Plant::new(&config))
    }
}

impl Plant {
    /// Lifts a wheel (side 0 left, 1 right) of an axle off the ground permanently.
    pub fn lift_wheel(&mut self, axle: usize, side: usize) {
        self.groups[axle / 2].wheels.lift(2 * (axle % 2) + side);
    }

    /// Sets the friction coefficient of the ground, above 0, under all wheels that are not lifted.
    pub fn set_friction(&mut self, friction: f64) {
        for group in &mut self.groups {
            group.wheels.set_friction(friction);
        }
    }

    /// Breaks a frame in two permanently: its wrench and its curvature are zero.
    pub fn snap_frame(&mut self, frame: usize) {
        self.frames[frame].snapped = true;
        linearise(&self.axles, &mut self.frames);
    }

    /// Copy computed without vector instructions; its results must be identical.
    pub fn portable(&self) -> Self {
        Self {
            #[cfg(target_arch = "x86_64")]
            wide: false,
            ..self.clone()
        }
    }

    /// Copy on frictionless ground, where the frames alone act.
    pub fn without_friction(&self) -> Self {
        let mut free = self.clone();
        for group in &mut free.groups {
            group.wheels.remove_friction();
        }
        free
    }

    /// Time since [`Self::place`], s.
    pub fn time(&self) -> f64 {
        self.health.steps as f64 * self.step
    }

    /// States of the axles, front first.
    pub fn axles(&self) -> &[AxleState] {
        &self.axles
    }

    /// Number of frames.
    pub fn frame_count(&self) -> usize {
        self.frames.len()
    }

    /// Posture of O: mean of the middles between neighbouring axles (m), heading from the last axle to the first (rad,
    /// within ±π).
    pub fn midpoint(&self) -> Vec3 {
        let middles = self.axles.windows(2).map(|pair| {
            let [f, r] = [pair[0].posture, pair[1].posture];
            [0.5 * (f[0] + r[0]), 0.5 * (f[1] + r[1])]
        });
        let sum = middles
            .reduce(|a, b| [a[0] + b[0], a[1] + b[1]])
            .unwrap_or_default();
        let count = self.frames.len() as f64;
        let (first, last) = (self.axles[0].posture, self.axles[self.frames.len()].posture);
        let heading = libm::atan2(first[1] - last[1], first[0] - last[0]);
        [sum[0] / count, sum[1] / count, heading]
    }

    /// Posture of the axle ahead of a frame in the coordinates of the axle behind (m, m, rad not wrapped).
    pub fn relative_posture(&self, frame: usize) -> Vec3 {
        let [x, y] = self.frames[frame].geometry.position;
        let [f, r] = [&self.axles[frame], &self.axles[frame + 1]];
        [x, y, f.posture[2] - r.posture[2]]
    }

    /// Wrench of a frame on its axles, elastic and damping.
    pub fn wrench(&self, frame: usize) -> Wrench {
        let frame = &self.frames[frame];
        frame.on_axles(&frame.total)
    }

    /// Elastic part of [`Self::wrench`], which the gauges measure.
    pub fn elastic_wrench(&self, frame: usize) -> Wrench {
        let frame = &self.frames[frame];
        frame.on_axles(&frame.elastic)
    }

    /// Elastic curvature of a frame's strip (1/m) at arc length `s` (m) from its root: the strain of a gauge
    /// bonded to the unloaded strip, divided by the half thickness. Positive if bent left.
    pub fn curvature(&self, frame: usize, s: f64) -> f64 {
        let frame = &self.frames[frame];
        match frame.creeping {
            _ if frame.snapped => 0.0,
            true => frame.strip.series_curvature(&frame.equilibrium, s),
            false => frame.strip.elastic_curvature(&frame.equilibrium, s),
        }
    }

    /// Prepared place of a gauge at arc length `s` (m, clamped to the strip) of a frame, for [`Self::gauges`].
    pub fn gauge(&self, frame: usize, s: f64) -> Station {
        self.frames[frame].strip.station(s)
    }

    /// Elastic curvature (1/m) at each gauge of a frame: [`Self::curvature`] with the tangents of the strip computed
    /// once for all gauges.
    pub fn gauges(&self, frame: usize, stations: &[Station], mut visit: impl FnMut(usize, f64)) {
        let Frame {
            strip,
            equilibrium,
            creeping,
            snapped,
            ..
        } = &self.frames[frame];
        if *snapped {
            (0..stations.len()).for_each(|i| visit(i, 0.0));
            return;
        }
        if *creeping {
            for (i, station) in stations.iter().enumerate() {
                visit(i, strip.series_curvature_at(equilibrium, station));
            }
            return;
        }
        let tangents = strip.tangents(equilibrium);
        for (i, station) in stations.iter().enumerate() {
            visit(i, strip.curvature_at(equilibrium, &tangents, station));
        }
    }

    /// Prepares `points` points along a frame, at equal distances from the axle behind to the axle ahead, for
    /// [`Self::draw`].
    pub fn outline(&self, frame: usize, points: usize) -> Outline {
        let Frame { strip, clamps, .. } = &self.frames[frame];
        let (length, root) = (strip.length(), clamps.root_length);
        let whole = root + length + clamps.tip_length;
        let place = |k: usize| {
            let distance = whole * k as f64 / points.saturating_sub(1).max(1) as f64;
            let s = (distance - root).clamp(0.0, length);
            (strip.station(s), distance - root - s)
        };
        let places = (0..points).map(place).collect();
        Outline { frame, places }
    }

    /// Points of the outline's frame, global, m; as many as `out` and the outline both have.
    pub fn draw(&self, outline: &Outline, out: &mut [[f64; 2]]) {
        let rear = self.axles[outline.frame + 1].posture;
        let Frame {
            strip,
            clamps,
            geometry,
            equilibrium,
            ..
        } = &self.frames[outline.frame];
        let tangents = strip.tangents(equilibrium);
        let ahead = unrotate(&rotate(&clamps.tip, geometry.turn), clamps.root);
        for ((station, rest), out) in outline.places.iter().zip(out) {
            let [x, y] = strip.position(&tangents, station);
            // A rigid end extends in the direction of its clamp.
            let [c, s] = if *rest > 0.0 { ahead } else { [1.0, 0.0] };
            let point = [x + clamps.root_length + rest * c, y + rest * s];
            let [x, y] = rotate(&rotate(&point, clamps.root), geometry.rear);
            *out = [rear[0] + x, rear[1] + y];
        }
    }

    /// Kinetic energy of axles and wheels and elastic energy of the frames, J.
    pub fn energy(&self) -> f64 {
        let strips = self
            .frames
            .iter()
            .filter(|frame| !frame.snapped)
            .map(|frame| frame.strip.energy(&frame.equilibrium));
        let bodies = self.bodies.iter().zip(&self.axles);
        let bodies = bodies.map(|(body, axle)| body.energy(&axle.velocity));
        let groups = self.groups.iter().enumerate().map(|(g, group)| {
            let axles = of_group(&self.axles, g);
            group.wheels.energy(axles) + group.drivetrain.energy(&group.wheels)
        });
        strips.sum::<f64>() + bodies.sum::<f64>() + groups.sum::<f64>()
    }

    /// Counters of steps, factorisations and snap-throughs since [`Self::place`].
    pub fn health(&self) -> Health {
        self.health
    }
}
