//! The plant and its time step.
//!
//! **Scheme.** Linearly implicit Euler with one Richardson extrapolation: one full step and two
//! half steps share the Jacobian of the start, and twice the second result minus the first is of
//! second order, whatever that Jacobian leaves out. It holds what is stiff: tangent stiffness and
//! damping of the frame, slope of the tyres, spin of the wheels. Wheel speeds are eliminated, and
//! since the frame acts through three numbers, so is the coupling of the axles: each step solves
//! two 3 × 3 systems for the axles and one for the frame in place of a 6 × 6 or 10 × 10 one.
//!
//! Velocities are held in the axles' frames; within a step, in their frames at its start.
//!
//! No allocation and no failure in [`Plant::step`].

use super::config::{PlantConfig, TICK_S};
use super::drivetrain::Drivetrain;
use super::frame::{Column, Equilibrium, Strip};
use super::geometry::{
    Clamps, Geometry, Mat3, Vec3, add, direction, inverse, minus, rotate, scaled, small_turn, sum,
    times, unrotate, unturned,
};
#[cfg(target_arch = "x86_64")]
use super::lanes::Wide;
use super::lanes::{Lanes, Narrow};
use super::loads::{Body, Loads, gravity};
use super::sincos::directions;
use super::state::{Health, PlantState};
use super::wheel::{Conditions, Contact, Eliminated, Wheels};

mod floor;
mod interface;

pub use interface::Outline;

/// Coefficient of the implicit part, 1 − 1/√2: the method damps what is infinitely stiff.
const GAMMA: f64 = 1.0 - std::f64::consts::FRAC_1_SQRT_2;
/// Finest division of a step: `1 << FINEST` parts.
const FINEST: u32 = 4;
/// Ratios of internal viscosity τ to the whole time step tried when the strip snaps through.
const CREEP: [f64; 5] = [5.0, 20.0, 100.0, 500.0, 5000.0];

/// The robot.
#[derive(Clone, Debug)]
pub struct Plant {
    wheels: Wheels,
    strip: Strip,
    /// True if the processor works on four numbers at once. The results are the same.
    #[cfg(target_arch = "x86_64")]
    wide: bool,
    bodies: [Body; 2],
    clamps: Clamps,
    substeps: u32,
    /// Length of a substep, s.
    step: f64,
    damping: f64,
    half_track: [f64; 2],
    tolerance: f64,
    current_share: f64,
    /// Way of the floor over the way rolled.
    carpet: [f64; 2],
    /// Gravity along the floor, global, m/s²; `None` on a level floor.
    gravity: Option<[f64; 2]>,

    state: PlantState,
    /// Conditions of the wheels; the command is that after the current loop.
    conditions: Conditions,
    loads: Loads,
    drivetrain: Drivetrain,
    equilibrium: Equilibrium,
    bend: Column,
    creeping: bool,
    snapped: bool,
    geometry: Geometry,
    stiffness: Mat3,
    viscosity: Mat3,
    /// Elastic wrench on the strip's end.
    elastic: Vec3,
    /// With damping.
    total: Vec3,
    health: Health,
}

/// The linear equations of one (full or half) step of length `h`.
struct Implicit<V> {
    h: f64,
    wheels: Eliminated<V>,
    axle: [Mat3; 2],
    /// Change of the frame's wrench for a unit change of the end's rate.
    frame: Mat3,
    reduced: Mat3,
}

impl<V: Lanes> Implicit<V> {
    #[inline(always)]
    fn new(plant: &Plant, at: &Contact<V>, h: f64) -> Self {
        let wheels = plant.wheels.eliminate(at, h);
        let d = plant.wheels.damping(&wheels);
        let mut axle = [[[0.0; 3]; 3]; 2];
        for i in 0..2 {
            let [xx, xy, xt, yy, yt, tt] = d[i];
            let damping = [h * xx, h * xy, h * xt, h * yy, h * yt, h * tt];
            axle[i] = inverse(&plant.bodies[i].with_damping(&damping));
        }
        let mut frame = [[0.0; 3]; 3];
        for m in 0..3 {
            for n in 0..3 {
                frame[m][n] =
                    h * (plant.damping * plant.viscosity[m][n] + h * plant.stiffness[m][n]);
            }
        }
        // I + (compliance of the axles) · frame, column by column.
        let mut system = [[0.0; 3]; 3];
        for n in 0..3 {
            let column = [frame[0][n], frame[1][n], frame[2][n]];
            let [f, r] = plant.geometry.transpose(&column);
            let rate = plant
                .geometry
                .rate(&[times(&axle[0], &f), times(&axle[1], &r)]);
            for m in 0..3 {
                system[m][n] = rate[m];
            }
            system[n][n] += 1.0;
        }
        Self {
            h,
            wheels,
            axle,
            frame,
            reduced: inverse(&system),
        }
    }

    /// Change of the axles' velocities for the loads `b`, which hold the frame's wrench.
    #[inline(always)]
    fn solve(&self, geometry: &Geometry, b: &[Vec3; 2]) -> [Vec3; 2] {
        let free = [
            times(&self.axle[0], &scaled(self.h, &b[0])),
            times(&self.axle[1], &scaled(self.h, &b[1])),
        ];
        let rate = times(&self.reduced, &geometry.rate(&free));
        let [f, r] = geometry.transpose(&times(&self.frame, &rate));
        [
            add(&free[0], -1.0, &times(&self.axle[0], &f)),
            add(&free[1], -1.0, &times(&self.axle[1], &r)),
        ]
    }
}

impl Plant {
    /// From checked constants.
    fn new(config: &PlantConfig) -> Self {
        let strip = Strip::new(
            config.strip_length_m,
            config.bending_stiffness_n_m2,
            config.axial_stiffness_n,
            config.natural_slope_rad,
        );
        let equilibrium = strip.unloaded();
        let bodies = Body::both(config);
        let bare = PlantConfig {
            payload_kg: [0.0; 2],
            ..config.clone()
        };
        let step = TICK_S / f64::from(config.substeps);
        let measured_at = Loads::new(&bare, &Body::both(&bare)).now;
        let mut plant = Self {
            wheels: Wheels::new(config, measured_at),
            #[cfg(target_arch = "x86_64")]
            wide: std::arch::is_x86_feature_detected!("avx2"),
            loads: Loads::new(config, &bodies),
            bodies,
            clamps: Clamps::new(
                [config.rigid_root_m, config.rigid_tip_m],
                [config.clamp_angle_root_rad, config.clamp_angle_tip_rad],
            ),
            substeps: config.substeps,
            step,
            damping: config.internal_damping_s,
            half_track: config.half_track_m,
            tolerance: config.tolerance_m_s,
            current_share: 1.0 - libm::exp(-step / config.current_loop_time_s),
            carpet: config.carpet_drift,
            gravity: (config.slope_rad != 0.0).then(|| gravity(config).1),
            state: PlantState::default(),
            conditions: Conditions::default(),
            drivetrain: Drivetrain::new(config),
            equilibrium,
            bend: Column::ZERO,
            creeping: false,
            snapped: false,
            geometry: Geometry::default(),
            stiffness: [[0.0; 3]; 3],
            viscosity: [[0.0; 3]; 3],
            elastic: [0.0; 3],
            total: [0.0; 3],
            health: Health::default(),
            strip,
        };
        plant.place([0.0; 3]);
        plant
    }

    /// Puts the robot at rest with its frame straight and unloaded, its middle O at `midpoint`
    /// (m, m, rad), time, wheel angles and counters at zero.
    pub fn place(&mut self, midpoint: Vec3) {
        self.equilibrium = self.strip.unloaded();
        let end = self.equilibrium.end(&self.strip);
        // The front axle seen from the rear one, in the root frame: straight ahead but for the
        // clamps. The unloaded strip may leave its ends a hair apart sideways.
        let clamps = &self.clamps;
        let offset = [end[0] + clamps.root_length + clamps.tip_length, end[1]];
        let offset = rotate(&offset, clamps.root);
        // O's heading is C2 → C1.
        let heading = midpoint[2] - libm::atan2(offset[1], offset[0]);
        let [dx, dy] = rotate(&offset, direction(heading));
        self.state = PlantState::default();
        let ends = [(0.5, heading - clamps.twist), (-0.5, heading)];
        for (axle, (side, heading)) in self.state.axle.iter_mut().zip(ends) {
            axle.posture = [midpoint[0] + side * dx, midpoint[1] + side * dy, heading];
        }
        self.loads.settle();
        self.conditions = Conditions {
            load: self.loads.now,
            ..Conditions::default()
        };
        self.wheels.bear(&self.loads.now);
        self.drivetrain.place(&mut self.wheels);
        self.bend = Column::ZERO;
        self.creeping = false;
        self.health = Health::default();
        self.locate::<Narrow>();
        // Rounding of the global position must not load the stiff strip.
        let end = self.strip_end();
        let _ = self
            .strip
            .follow::<Narrow>(&mut self.equilibrium, end, &Column::ZERO);
        self.linearise();
        self.publish_loads();
    }

    /// Geometry from the postures.
    #[inline(always)]
    fn locate<V: Lanes>(&mut self) {
        let (f, r) = (self.state.axle[0].posture, self.state.axle[1].posture);
        let (s, c) = directions(V::load(&[f[2], r[2], 0.0, 0.0]));
        let (s, c) = (s.store(), c.store());
        let (front, rear) = ([c[0], s[0]], [c[1], s[1]]);
        let turn = [
            front[0] * rear[0] + front[1] * rear[1],
            front[1] * rear[0] - front[0] * rear[1],
        ];
        let position = unrotate(&[f[0] - r[0], f[1] - r[1]], rear);
        self.geometry = Geometry::new(&self.clamps, [front, rear], position, turn);
    }

    /// Strip's end in the strip's root frame.
    #[inline(always)]
    fn strip_end(&self) -> Vec3 {
        let [x, y] = self.geometry.end;
        let [f, r] = &self.state.axle;
        let turn = f.posture[2] - r.posture[2] + self.clamps.twist;
        [x - self.clamps.root_length, y, turn]
    }

    /// Wrench and stiffness of the frame as it is now.
    #[inline(always)]
    fn linearise(&mut self) {
        if self.snapped {
            (self.stiffness, self.viscosity) = ([[0.0; 3]; 3], [[0.0; 3]; 3]);
            (self.elastic, self.total) = ([0.0; 3], [0.0; 3]);
            return;
        }
        self.stiffness = self.strip.stiffness(&self.equilibrium);
        self.viscosity = self.strip.viscosity(&self.equilibrium);
        self.elastic = self.strip.wrench(&self.equilibrium);
        let v = [self.state.axle[0].velocity, self.state.axle[1].velocity];
        let rate = self.geometry.rate(&v);
        self.total = add(&self.elastic, self.damping, &times(&self.viscosity, &rate));
    }

    /// Advances by a tick ([`TICK_S`]) under the commanded wheel torques (N m, `[axle][left, right]`, held;
    /// a command that is not finite counts as none).
    pub fn step(&mut self, torque: [[f64; 2]; 2]) {
        #[cfg(target_arch = "x86_64")]
        if self.wide {
            // SAFETY: the processor has AVX2.
            #[allow(unsafe_code)]
            return unsafe { self.step_wide(torque) };
        }
        self.step_in::<Narrow>(torque);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn step_wide(&mut self, torque: [[f64; 2]; 2]) {
        self.step_in::<Wide>(torque);
    }

    #[inline(always)]
    fn step_in<V: Lanes>(&mut self, torque: [[f64; 2]; 2]) {
        for _ in 0..self.substeps {
            self.substep::<V>(torque);
        }
    }

    #[inline(always)]
    fn substep<V: Lanes>(&mut self, torque: [[f64; 2]; 2]) {
        for w in 0..4 {
            let wanted = torque[w / 2][w % 2];
            let wanted = if wanted.is_finite() { wanted } else { 0.0 };
            let command = &mut self.conditions.command[w];
            *command += self.current_share * (wanted - *command);
        }
        let before = [self.state.axle[0].velocity, self.state.axle[1].velocity];
        let turned = [self.state.axle[0].posture[2], self.state.axle[1].posture[2]];
        self.divide::<V>();
        for i in 0..2 {
            let axle = &mut self.state.axle[i];
            let was = unturned(&before[i], small_turn(axle.posture[2] - turned[i]));
            axle.acceleration = scaled(1.0 / self.step, &add(&axle.velocity, -1.0, &was));
        }
        if let Some(gravity) = self.downhill() {
            for (axle, gravity) in self.state.axle.iter_mut().zip(gravity) {
                axle.acceleration[0] -= gravity[0];
                axle.acceleration[1] -= gravity[1];
            }
        }
        self.health.steps += 1;
        self.drivetrain.publish(&mut self.state.axle);
        if self.loads.shift() {
            let base = libm::hypot(self.geometry.position[0], self.geometry.position[1]);
            self.loads.follow(&self.state.axle, base);
            self.conditions.load = self.loads.now;
            self.wheels.bear(&self.loads.now);
            self.publish_loads();
        }
    }

    /// Covers one step in as few parts as the error allows: 1, or powers of 2 around an impact or
    /// a tyre that breaks away.
    #[inline(always)]
    fn divide<V: Lanes>(&mut self) {
        const WHOLE: u32 = 1 << FINEST;
        let mut done = 0;
        let mut part = WHOLE;
        while done < WHOLE {
            let h = self.step * f64::from(part) / f64::from(WHOLE);
            if self.advance::<V>(h, part == 1) {
                done += part;
                self.health.parts += 1;
                // The largest power of two that `done` is a multiple of, at most twice the last.
                if part < WHOLE && done < WHOLE && done.is_multiple_of(2 * part) {
                    part *= 2;
                }
            } else {
                part /= 2;
            }
        }
    }

    /// Advances by `h`, unless the error is too large and `force` is not set.
    #[inline(always)]
    #[expect(clippy::too_many_lines, reason = "one formula")]
    fn advance<V: Lanes>(&mut self, h: f64, force: bool) -> bool {
        const G: f64 = GAMMA;
        let start = [self.state.axle[0].velocity, self.state.axle[1].velocity];
        let speed = self.speeds();
        let geometry = self.geometry;
        let g = G * h;

        if self.drivetrain.cogs() {
            self.conditions.cogging = self.drivetrain.cogging::<V>(&self.state.axle, h);
        }
        if self.wheels.moved() {
            self.drift(h);
        }

        // First stage: u = γh·k, (I − γhA) k = f(start).
        let hub = self.wheels.hub(&start);
        let now = self.wheels.contact(&hub, V::load(&speed), &self.conditions);
        let implicit = Implicit::<V>::new(self, &now, g);
        let pull = add(
            &self.total,
            g,
            &times(&self.stiffness, &geometry.rate(&start)),
        );
        let load = self.wheels.load(&implicit.wheels, &now, &now);
        let load = self.swung(&load, [start[0][2], start[1][2]], [[1.0, 0.0]; 2]);
        let gain1 = implicit.solve(&geometry, &minus(&load, &geometry.transpose(&pull)));
        let spin1 = self
            .wheels
            .spin(&implicit.wheels, &now, &now, &self.wheels.hub(&gain1));
        let k1 = [scaled(1.0 / g, &gain1[0]), scaled(1.0 / g, &gain1[1])];
        let move1 = sum(&start, &gain1);

        // Forces after half a step of it, in the axles' frames there.
        let a = 0.5 * h;
        let there_v = [add(&start[0], a, &k1[0]), add(&start[1], a, &k1[1])];
        let there_speed = V::load(&speed) + spin1 * V::splat(0.5 / G);
        let (there, turns) = self.moved(&geometry, &move1, a);
        let body = [
            unturned(&there_v[0], turns[0]),
            unturned(&there_v[1], turns[1]),
        ];
        let turn = self.state.axle[0].posture[2] - self.state.axle[1].posture[2];
        let end = [
            there.end[0] - self.clamps.root_length,
            there.end[1],
            turn + self.clamps.twist + a * (move1[0][2] - move1[1][2]),
        ];
        let Some(elastic) = self.wrench_near::<V>(end, force) else {
            return false;
        };
        let total = add(
            &elastic,
            self.damping,
            &times(&self.viscosity, &there.rate(&body)),
        );
        let hub = self.wheels.hub(&body);
        let mut then = self.wheels.contact(&hub, there_speed, &self.conditions);

        // Second stage: (I − γhA) k = f(there) − k₁.
        then.torque = then.torque - spin1 * (V::load(&self.wheels.inertia) / V::splat(g));
        let load = self.wheels.load(&implicit.wheels, &now, &then);
        let load = self.swung(&load, [body[0][2], body[1][2]], turns);
        let mut load = minus(&load, &there.transpose(&total));
        let mut move2 = [[0.0; 3]; 2];
        for i in 0..2 {
            let momentum = self.bodies[i].momentum(&k1[i]);
            load[i] = add(&self.bodies[i].turned(&load[i], turns[i]), -1.0, &momentum);
            move2[i] = add(&there_v[i], -1.0, &move1[i]);
        }
        let stiff = scaled(g, &times(&self.stiffness, &geometry.rate(&move2)));
        let gain2 = implicit.solve(&geometry, &minus(&load, &geometry.transpose(&stiff)));
        let spin2 = self
            .wheels
            .spin(&implicit.wheels, &now, &then, &self.wheels.hub(&gain2));
        let move2 = sum(&move2, &gain2);

        // The second stage is what the second order adds to the first.
        let mut error: f64 = 0.0;
        for i in 0..2 {
            for n in 0..3 {
                let e = gain2[i][n].abs();
                let e = if n == 2 { e * self.half_track[i] } else { e };
                error = error.max(e);
            }
        }
        if !(error / G <= self.tolerance) && !force {
            return false;
        }

        let (before, shape) = (self.state.axle, self.equilibrium.shape());
        let gained = ((spin1 + spin2) * V::splat(1.0 / G)).store();
        let motor = now.motor.store();
        for w in 0..4 {
            let axle = &mut self.state.axle[w / 2];
            axle.wheel_angle[w % 2] += h * (speed[w] + 0.5 * gained[w]);
            axle.wheel_speed[w % 2] += gained[w];
            axle.torque[w % 2] = motor[w];
        }
        let directions = [geometry.front, geometry.rear];
        for i in 0..2 {
            let axle = &mut self.state.axle[i];
            let (mut moved, mut velocity) = ([0.0; 3], [0.0; 3]);
            for n in 0..3 {
                moved[n] = h * (move1[i][n] + move2[i][n]);
                velocity[n] = start[i][n] + (gain1[i][n] + gain2[i][n]) / G;
            }
            let global = rotate(&[moved[0], moved[1]], directions[i]);
            axle.posture[0] += global[0];
            axle.posture[1] += global[1];
            axle.posture[2] += moved[2];
            axle.velocity = unturned(&velocity, small_turn(moved[2]));
        }
        self.locate::<V>();
        if !self.settle::<V>(h, force) {
            self.state.axle = before;
            self.geometry = geometry;
            self.strip.restore(&mut self.equilibrium, shape);
            self.linearise();
            return false;
        }
        self.linearise();
        if self.drivetrain.has_play() {
            let (wheels, axles) = (&mut self.wheels, &mut self.state.axle);
            self.drivetrain
                .mesh(wheels, axles, &self.conditions, (speed, h));
        }
        true
    }

    #[inline(always)]
    fn speeds(&self) -> [f64; 4] {
        let [f, r] = &self.state.axle;
        [
            f.wheel_speed[0],
            f.wheel_speed[1],
            r.wheel_speed[0],
            r.wheel_speed[1],
        ]
    }

    /// Geometry after moving at velocity `v` (frames of the start) for a time, and the turn of
    /// each axle.
    #[inline(always)]
    fn moved(&self, from: &Geometry, v: &[Vec3; 2], time: f64) -> (Geometry, [[f64; 2]; 2]) {
        let [f, r] = v;
        let turns = [small_turn(time * f[2]), small_turn(time * r[2])];
        let front = rotate(&[f[0], f[1]], from.turn);
        let position = [
            from.position[0] + time * (front[0] - r[0]),
            from.position[1] + time * (front[1] - r[1]),
        ];
        let position = unrotate(&position, turns[1]);
        let turn = unrotate(&rotate(&from.turn, turns[0]), turns[1]);
        let directions = [from.front, from.rear];
        let geometry = Geometry::new(&self.clamps, directions, position, turn);
        (geometry, turns)
    }

    /// Elastic wrench at an end near the present one; if it cannot be found there, its tangent
    /// under `force`, or nothing.
    #[inline(always)]
    fn wrench_near<V: Lanes>(&mut self, end: Vec3, force: bool) -> Option<Vec3> {
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
        self.health.linear_wrenches += 1;
        Some(self.strip.linear_wrench(&self.equilibrium, end))
    }

    /// Finds the frame's equilibrium. If there is none near, either the part of the step was too
    /// long (the result is false), or, under `force`, the strip snaps through, slowly.
    #[inline(always)]
    fn settle<V: Lanes>(&mut self, h: f64, force: bool) -> bool {
        let end = self.strip_end();
        match self
            .strip
            .follow::<V>(&mut self.equilibrium, end, &self.bend)
        {
            Some(solved) => {
                self.creeping = false;
                self.health.factorisations += u64::from(solved.iterations);
                self.health.most_factorisations =
                    self.health.most_factorisations.max(solved.iterations);
            }
            None if force || self.creeping => self.creep(h),
            None => return false,
        }
        true
    }

    #[cold]
    fn creep(&mut self, h: f64) {
        self.health.snap_throughs += u64::from(!self.creeping);
        self.health.creep_steps += 1;
        self.creeping = true;
        for ratio in CREEP {
            let ratio = ratio * self.step / h;
            if self.strip.creep(&mut self.equilibrium, ratio).is_some() {
                return;
            }
        }
        self.health.failures += 1;
    }
}
