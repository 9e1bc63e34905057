//! The plant and its time step.
//!
//! **Scheme.** Linearly implicit (Rosenbrock–W) in two stages, with γ = 1 − 1/√2. Both stages share
//! the Jacobian of the start, and the result is of second order, whatever that Jacobian leaves out.
//! The Jacobian holds the stiff parts: tangent stiffness and damping of the frames, slope of the tyres, spin of
//! the wheels. Wheel speeds are eliminated. A frame acts on its axles through three numbers, so the coupling of the
//! axles is eliminated too: each stage solves a 3 × 3 system for each axle, and a block-tridiagonal system of
//! 3 × 3 blocks for the frames.
//!
//! Velocities are in the axles' frames; within a step, in the axles' frames at the start of the step.
//!
//! [`Plant::step`] neither allocates nor fails.

use super::config::{PlantConfig, TICK_S};
use super::drivetrain::Drivetrain;
use super::frame::Column;
use super::geometry::{
    Vec3, add, direction, minus, rotate, scaled, small_turn, sum, times, unrotate, unturned,
};
#[cfg(target_arch = "x86_64")]
use super::lanes::Wide;
use super::lanes::{Lanes, Narrow};
use super::loads::{Body, Loads, gravity};
use super::per_axle::MAX_AXLES;
use super::sincos::directions;
use super::state::{AxleState, Health};
use super::wheel::{Conditions, Wheels};
use floor::{directions_of, downhill, drift};
use frame::Frame;
use implicit::{Implicit, on_axles};

mod floor;
mod frame;
mod implicit;
mod interface;

pub use interface::Outline;

/// Coefficient of the implicit part, 1 − 1/√2: the method damps infinitely stiff modes.
const GAMMA: f64 = 1.0 - std::f64::consts::FRAC_1_SQRT_2;
/// Finest division of a step: `1 << FINEST` parts.
const FINEST: u32 = 4;
/// Ratios of internal viscosity τ to the whole time step, tried in turn when the strip snaps through.
const CREEP: [f64; 5] = [5.0, 20.0, 100.0, 500.0, 5000.0];

/// The simulated robot.
#[derive(Clone, Debug)]
pub struct Plant {
    /// True if the processor has AVX2, which changes the speed and not the results.
    #[cfg(target_arch = "x86_64")]
    wide: bool,
    bodies: Vec<Body>,
    substeps: u32,
    /// Length of a substep, s.
    step: f64,
    half_track: Vec<f64>,
    tolerance: f64,
    current_share: f64,
    /// Displacement by the floor per distance rolled, global.
    carpet: [f64; 2],
    /// Gravity along the floor, global, m/s²; `None` on a level floor.
    gravity: Option<[f64; 2]>,

    axles: Vec<AxleState>,
    groups: Vec<Group>,
    frames: Vec<Frame>,
    loads: Loads,
    health: Health,
}

/// Wheels of two neighbouring axles, four in a vector. If the number of axles is odd, the last group holds one axle.
#[derive(Clone, Debug)]
struct Group {
    wheels: Wheels,
    /// Inputs of the wheel model; `command` is the torque after the lag of the current loop.
    conditions: Conditions,
    drivetrain: Drivetrain,
}

/// Vectors of the axle `first` and of the axle behind it; the second is zero if `first` is the last axle.
#[inline(always)]
fn pair<const N: usize, const D: usize>(of: &[[f64; D]; N], first: usize) -> [[f64; D]; 2] {
    let last = if first + 1 < N {
        of[first + 1]
    } else {
        [0.0; D]
    };
    [of[first], last]
}

/// Values of the four wheels of a group. A missing wheel gets 1, so that a division by its value is safe.
fn of_wheels(all: &[[f64; 2]], first: usize) -> [f64; 4] {
    let [a, b] = all[first];
    let [c, d] = all.get(first + 1).copied().unwrap_or([1.0; 2]);
    [a, b, c, d]
}

/// The axles of a group.
#[inline(always)]
fn of_group(axles: &[AxleState], group: usize) -> &[AxleState] {
    &axles[2 * group..axles.len().min(2 * group + 2)]
}

/// Mutable axles of a group.
#[inline(always)]
fn of_group_mut(axles: &mut [AxleState], group: usize) -> &mut [AxleState] {
    let end = axles.len().min(2 * group + 2);
    &mut axles[2 * group..end]
}

/// The first `N` entries of `list`.
#[inline(always)]
fn sized<T, const N: usize>(list: &[T]) -> &[T; N] {
    list.first_chunk().expect("as many as the robot has axles")
}

/// The first `N` entries of `list`, mutable.
#[inline(always)]
fn sized_mut<T, const N: usize>(list: &mut [T]) -> &mut [T; N] {
    list.first_chunk_mut()
        .expect("as many as the robot has axles")
}

impl Plant {
    /// Plant from checked constants with an entry for each axle.
    fn new(config: &PlantConfig) -> Self {
        let bodies = Body::all(config);
        let bare = PlantConfig {
            payload_kg: [0.0].into(),
            ..config.clone()
        };
        let step = TICK_S / f64::from(config.substeps);
        let measured_at = Loads::new(&bare, &Body::all(&bare)).now;
        let groups = (0..bodies.len()).step_by(2).map(|first| Group {
            wheels: Wheels::new(config, first, of_wheels(&measured_at, first)),
            conditions: Conditions::default(),
            drivetrain: Drivetrain::new(config, first),
        });
        let mut plant = Self {
            #[cfg(target_arch = "x86_64")]
            wide: std::arch::is_x86_feature_detected!("avx2"),
            loads: Loads::new(config, &bodies),
            axles: vec![AxleState::default(); bodies.len()],
            groups: groups.collect(),
            frames: vec![Frame::new(config, step); bodies.len() - 1],
            bodies,
            substeps: config.substeps,
            step,
            half_track: config.half_track_m.entries().to_vec(),
            tolerance: config.tolerance_m_s,
            current_share: 1.0 - libm::exp(-step / config.current_loop_time_s),
            carpet: config.carpet_drift,
            gravity: (config.slope_rad != 0.0).then(|| gravity(config).1),
            health: Health::default(),
        };
        plant.place([0.0; 3]);
        plant
    }

    /// Places the robot at rest with its frames straight and unloaded and its midpoint O ([`Self::midpoint`]) at
    /// `midpoint` (m, m, rad). Time, wheel angles and counters become zero.
    pub fn place(&mut self, midpoint: Vec3) {
        self.frames.iter_mut().for_each(Frame::unload);
        let unrotated = self.straight(0.0);
        let [x, y, _] = unrotated[0];
        // O's heading is from the last axle to the first.
        let chain = self.straight(midpoint[2] - libm::atan2(y, x));
        let middles = chain
            .windows(2)
            .map(|pair| [0, 1].map(|n| 0.5 * (pair[0][n] + pair[1][n])));
        let sum = middles
            .reduce(|a, b| [a[0] + b[0], a[1] + b[1]])
            .unwrap_or_default();
        let middle = sum.map(|sum| sum / self.frames.len() as f64);
        for (axle, posture) in self.axles.iter_mut().zip(&chain) {
            *axle = AxleState::default();
            axle.posture = [
                midpoint[0] + (posture[0] - middle[0]),
                midpoint[1] + (posture[1] - middle[1]),
                posture[2],
            ];
        }
        self.loads.settle();
        for group in &mut self.groups {
            group.conditions = Conditions::default();
            group.drivetrain.place(&mut group.wheels);
        }
        self.apply_loads();
        self.health = Health::default();
        locate::<Narrow>(&self.axles, &mut self.frames);
        for (f, frame) in self.frames.iter_mut().enumerate() {
            // Rounding of the global position must not load the stiff strip.
            let end = frame.end(
                &frame.geometry,
                frame.turn(&self.axles[f], &self.axles[f + 1]),
            );
            let _ = frame
                .strip
                .follow::<Narrow>(&mut frame.equilibrium, end, &Column::ZERO);
        }
        linearise(&self.axles, &mut self.frames);
    }

    /// Postures of the axles with the frames unloaded, the last axle at the origin with this heading.
    fn straight(&self, heading: f64) -> Vec<Vec3> {
        let mut chain = vec![[0.0, 0.0, heading]];
        let mut last = chain[0];
        for frame in self.frames.iter().rev() {
            let (end, clamps) = (frame.equilibrium.end(&frame.strip), &frame.clamps);
            // Position of the axle ahead in the root frame of the axle behind: straight ahead except for the
            // clamps. The ends of the unloaded strip may be slightly offset sideways.
            let offset = [end[0] + clamps.root_length + clamps.tip_length, end[1]];
            let [dx, dy] = rotate(&rotate(&offset, clamps.root), direction(last[2]));
            last = [last[0] + dx, last[1] + dy, last[2] - clamps.twist];
            chain.push(last);
        }
        chain.reverse();
        chain
    }

    /// Sets load and rolling radius of every wheel from the present loads.
    fn apply_loads(&mut self) {
        for (g, group) in self.groups.iter_mut().enumerate() {
            group.conditions.load = of_wheels(&self.loads.now, 2 * g);
            group.wheels.update_radii(&group.conditions.load);
        }
        for (axle, load) in self.axles.iter_mut().zip(&self.loads.now) {
            axle.load = *load;
        }
    }

    /// Advances by a tick ([`TICK_S`]) under the commanded wheel torques (N m, `[axle][left, right]`), held over the
    /// tick. A missing or non-finite command counts as zero.
    pub fn step(&mut self, torque: &[[f64; 2]]) {
        match self.axles.len() {
            2 => self.step_of::<2, 1, 1>(torque),
            3 => self.step_of::<3, 2, 2>(torque),
            4 => self.step_of::<4, 3, 2>(torque),
            _ => self.step_of::<5, 4, 3>(torque),
        }
    }

    /// A step of `N` axles, `F` frames and `G` groups of wheels.
    fn step_of<const N: usize, const F: usize, const G: usize>(&mut self, torque: &[[f64; 2]]) {
        let mut wanted = [[0.0; 2]; N];
        for (wanted, torque) in wanted.iter_mut().zip(torque) {
            *wanted = torque.map(|torque| if torque.is_finite() { torque } else { 0.0 });
        }
        #[cfg(target_arch = "x86_64")]
        if self.wide {
            // SAFETY: the processor has AVX2.
            #[allow(unsafe_code)]
            return unsafe { self.step_wide::<N, F, G>(&wanted) };
        }
        self.step_in::<Narrow, N, F, G>(&wanted);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    fn step_wide<const N: usize, const F: usize, const G: usize>(
        &mut self,
        wanted: &[[f64; 2]; N],
    ) {
        self.step_in::<Wide, N, F, G>(wanted);
    }

    #[inline(always)]
    fn step_in<V: Lanes, const N: usize, const F: usize, const G: usize>(
        &mut self,
        wanted: &[[f64; 2]; N],
    ) {
        for _ in 0..self.substeps {
            self.substep::<V, N, F, G>(wanted);
        }
    }

    #[inline(always)]
    fn substep<V: Lanes, const N: usize, const F: usize, const G: usize>(
        &mut self,
        wanted: &[[f64; 2]; N],
    ) {
        let groups: &mut [Group; G] = sized_mut(&mut self.groups);
        for w in 0..2 * N {
            let command = &mut groups[w / 4].conditions.command[w % 4];
            *command += self.current_share * (wanted[w / 2][w % 2] - *command);
        }
        let axles: &[AxleState; N] = sized(&self.axles);
        let (mut before, mut turned) = ([[0.0; 3]; N], [0.0; N]);
        for i in 0..N {
            before[i] = axles[i].velocity;
            turned[i] = axles[i].posture[2];
        }
        self.divide::<V, N, F, G>();
        let axles: &mut [AxleState; N] = sized_mut(&mut self.axles);
        for i in 0..N {
            let axle = &mut axles[i];
            let was = unturned(&before[i], small_turn(axle.posture[2] - turned[i]));
            axle.acceleration = scaled(1.0 / self.step, &add(&axle.velocity, -1.0, &was));
        }
        if let Some(gravity) = self.gravity {
            let frames: &[Frame; F] = sized(&self.frames);
            let mut geometry = [frames[0].geometry; F];
            for f in 1..F {
                geometry[f] = frames[f].geometry;
            }
            let local_gravity: [[f64; 2]; N] = downhill(gravity, &geometry);
            for i in 0..N {
                axles[i].acceleration[0] -= local_gravity[i][0];
                axles[i].acceleration[1] -= local_gravity[i][1];
            }
        }
        self.health.steps += 1;
        for g in 0..G {
            let axles = of_group_mut(&mut self.axles, g);
            self.groups[g].drivetrain.publish(axles);
        }
        if self.loads.shift() {
            let mut base = 0.0;
            for frame in &self.frames {
                base += libm::hypot(frame.geometry.position[0], frame.geometry.position[1]);
            }
            self.loads.follow(&self.axles, base / F as f64);
            self.apply_loads();
        }
    }

    /// Covers one step in as few parts as the error allows: 1, or powers of 2 around an impact or
    /// a tyre that breaks away.
    #[inline(always)]
    fn divide<V: Lanes, const N: usize, const F: usize, const G: usize>(&mut self) {
        const WHOLE: u32 = 1 << FINEST;
        let mut done = 0;
        let mut part = WHOLE;
        while done < WHOLE {
            let h = self.step * f64::from(part) / f64::from(WHOLE);
            if self.advance::<V, N, F, G>(h, part == 1) {
                done += part;
                self.health.parts += 1;
                // Doubles the part where `done` is a multiple of the doubled part.
                if part < WHOLE && done < WHOLE && done.is_multiple_of(2 * part) {
                    part *= 2;
                }
            } else {
                part /= 2;
            }
        }
    }

    /// Advances by `h` (s). Gives false, with the state unchanged, if the error is too large and `force` is not set.
    #[inline(always)]
    #[expect(clippy::too_many_lines, reason = "one formula")]
    fn advance<V: Lanes, const N: usize, const F: usize, const G: usize>(
        &mut self,
        h: f64,
        force: bool,
    ) -> bool {
        let axles: &mut [AxleState; N] = sized_mut(&mut self.axles);
        let groups: &mut [Group; G] = sized_mut(&mut self.groups);
        let frames: &mut [Frame; F] = sized_mut(&mut self.frames);
        let bodies: &[Body; N] = sized(&self.bodies);
        let mut start = [[0.0; 3]; N];
        for i in 0..N {
            start[i] = axles[i].velocity;
        }
        let mut speed = [[0.0; 4]; G];
        for w in 0..2 * N {
            speed[w / 4][w % 4] = axles[w / 2].wheel_speed[w % 2];
        }
        let mut geometry = [frames[0].geometry; F];
        for f in 1..F {
            geometry[f] = frames[f].geometry;
        }
        let g = GAMMA * h;
        let gravity: Option<[_; N]> = self.gravity.map(|gravity| downhill(gravity, &geometry));

        for k in 0..G {
            let (group, axles) = (&mut groups[k], of_group(axles, k));
            if group.drivetrain.cogs() {
                group.conditions.cogging = group.drivetrain.cogging::<V>(axles, h);
            }
            if group.wheels.has_drift() {
                let directions = pair(&directions_of::<N, F>(&geometry), 2 * k);
                group.conditions.drift = drift(self.carpet, axles, directions, h);
            }
        }

        // First stage: u = γh·k, (I − γhA) k = f(start).
        let hub = groups[0].wheels.hub(&pair(&start, 0));
        let contact = groups[0]
            .wheels
            .contact(&hub, V::load(&speed[0]), &groups[0].conditions);
        let mut now = [contact; G];
        for k in 1..G {
            let group = &groups[k];
            let hub = group.wheels.hub(&pair(&start, 2 * k));
            now[k] = group
                .wheels
                .contact(&hub, V::load(&speed[k]), &group.conditions);
        }
        let implicit = Implicit::<V, N, F, G>::new((groups, bodies, frames), &now, g);
        let mut pull = [[0.0; 3]; F];
        for f in 0..F {
            let rate = geometry[f].rate(&pair(&start, f));
            pull[f] = add(&frames[f].total, g, &times(&frames[f].stiffness, &rate));
        }
        let mut load = [[0.0; 3]; N];
        for k in 0..G {
            let own = groups[k].wheels.load(&implicit.wheels[k], &now[k], &now[k]);
            for (i, own) in (2 * k..N).zip(own) {
                load[i] = bodies[i].with_centrifugal_force(&own, start[i][2]);
                if let Some(gravity) = &gravity {
                    load[i] = bodies[i].with_gravity(&load[i], unrotate(&gravity[i], [1.0, 0.0]));
                }
            }
        }
        let gain1 = implicit.solve(&geometry, &minus(&load, &on_axles(&geometry, &pull)));
        let mut spin1 = [V::splat(0.0); G];
        for k in 0..G {
            let wheels = &groups[k].wheels;
            let hub = wheels.hub(&pair(&gain1, 2 * k));
            spin1[k] = wheels.spin(&implicit.wheels[k], &now[k], &now[k], &hub);
        }
        let move1 = sum(&start, &gain1);

        // Forces after half a step of the first stage, in the axles' frames at that time.
        let a = 0.5 * h;
        let (mut k1, mut there_v, mut body) = (start, start, start);
        let mut turns = [[0.0; 2]; N];
        for i in 0..N {
            k1[i] = scaled(1.0 / g, &gain1[i]);
            there_v[i] = add(&start[i], a, &k1[i]);
            turns[i] = small_turn(a * move1[i][2]);
            body[i] = unturned(&there_v[i], turns[i]);
        }
        let (mut there, mut total) = (geometry, pull);
        for f in 0..F {
            let frame = &mut frames[f];
            let ends = [turns[f], turns[f + 1]];
            there[f] = geometry[f].moved(&frame.clamps, &pair(&move1, f), ends, a);
            let turn = frame.turn(&axles[f], &axles[f + 1]) + a * (move1[f][2] - move1[f + 1][2]);
            let end = frame.end(&there[f], turn);
            let Some(elastic) = frame.wrench_near::<V>(end, force, &mut self.health) else {
                return false;
            };
            total[f] = frame.damped(&elastic, &there[f].rate(&pair(&body, f)));
        }

        // Second stage: (I − γhA) k = f(there) − k₁; "there" is the state after half a step of the first stage.
        let mut then = now;
        for k in 0..G {
            let group = &groups[k];
            let hub = group.wheels.hub(&pair(&body, 2 * k));
            let there_speed = V::load(&speed[k]) + spin1[k] * V::splat(0.5 / GAMMA);
            then[k] = group.wheels.contact(&hub, there_speed, &group.conditions);
            let inertia = V::load(&group.wheels.inertia);
            then[k].torque = then[k].torque - spin1[k] * (inertia / V::splat(g));
            let own = group.wheels.load(&implicit.wheels[k], &now[k], &then[k]);
            for (i, own) in (2 * k..N).zip(own) {
                load[i] = bodies[i].with_centrifugal_force(&own, body[i][2]);
                if let Some(gravity) = &gravity {
                    load[i] = bodies[i].with_gravity(&load[i], unrotate(&gravity[i], turns[i]));
                }
            }
        }
        let mut load = minus(&load, &on_axles(&there, &total));
        let mut move2 = start;
        for i in 0..N {
            let momentum = bodies[i].momentum(&k1[i]);
            load[i] = add(&bodies[i].turned(&load[i], turns[i]), -1.0, &momentum);
            move2[i] = add(&there_v[i], -1.0, &move1[i]);
        }
        let mut stiff = total;
        for f in 0..F {
            let rate = geometry[f].rate(&pair(&move2, f));
            stiff[f] = scaled(g, &times(&frames[f].stiffness, &rate));
        }
        let gain2 = implicit.solve(&geometry, &minus(&load, &on_axles(&geometry, &stiff)));
        let move2 = sum(&move2, &gain2);

        // The second stage is the difference between the second-order and the first-order solution.
        let mut error: f64 = 0.0;
        for i in 0..N {
            for n in 0..3 {
                let e = gain2[i][n].abs();
                let e = if n == 2 { e * self.half_track[i] } else { e };
                error = error.max(e);
            }
        }
        if !(error / GAMMA <= self.tolerance) && !force {
            return false;
        }

        let before = *axles;
        let mut settled = [false; F];
        for k in 0..G {
            let wheels = &groups[k].wheels;
            let hub = wheels.hub(&pair(&gain2, 2 * k));
            let spin2 = wheels.spin(&implicit.wheels[k], &now[k], &then[k], &hub);
            let gained = ((spin1[k] + spin2) * V::splat(1.0 / GAMMA)).store();
            let motor = now[k].motor.store();
            let axles = of_group_mut(axles, k);
            for w in 0..2 * axles.len() {
                let axle = &mut axles[w / 2];
                axle.wheel_angle[w % 2] += h * (speed[k][w] + 0.5 * gained[w]);
                axle.wheel_speed[w % 2] += gained[w];
                axle.torque[w % 2] = motor[w];
            }
        }
        let directions = directions_of::<N, F>(&geometry);
        for i in 0..N {
            let axle = &mut axles[i];
            let (mut moved, mut velocity) = ([0.0; 3], [0.0; 3]);
            for n in 0..3 {
                moved[n] = h * (move1[i][n] + move2[i][n]);
                velocity[n] = start[i][n] + (gain1[i][n] + gain2[i][n]) / GAMMA;
            }
            let global = rotate(&[moved[0], moved[1]], directions[i]);
            axle.posture[0] += global[0];
            axle.posture[1] += global[1];
            axle.posture[2] += moved[2];
            axle.velocity = unturned(&velocity, small_turn(moved[2]));
        }
        let mut shapes = [frames[0].equilibrium.shape(); F];
        for f in 1..F {
            shapes[f] = frames[f].equilibrium.shape();
        }
        locate::<V>(axles, frames);
        // A creeping frame always settles. Creeping frames come last, since their shapes are no equilibria and cannot
        // be restored.
        for creeping in [false, true] {
            for f in 0..F {
                if frames[f].creeping != creeping || settled[f] {
                    continue;
                }
                settled[f] = true;
                let frame = &mut frames[f];
                let end = frame.end(&frame.geometry, frame.turn(&axles[f], &axles[f + 1]));
                if !frame.settle::<V>(end, h, force, &mut self.health) {
                    *axles = before;
                    for f in 0..F {
                        frames[f].geometry = geometry[f];
                        if settled[f] {
                            frames[f].restore(shapes[f]);
                        }
                    }
                    linearise(axles, frames);
                    return false;
                }
            }
        }
        linearise(axles, frames);
        for k in 0..G {
            let group = &mut groups[k];
            if group.drivetrain.has_backlash() {
                let axles = of_group_mut(axles, k);
                group
                    .drivetrain
                    .mesh(&mut group.wheels, axles, &group.conditions, (speed[k], h));
            }
        }
        true
    }
}

/// Updates the geometry of the frames from the postures of the axles.
#[inline(always)]
fn locate<V: Lanes>(axles: &[AxleState], frames: &mut [Frame]) {
    // Computes the directions of four axles at a time.
    let mut heading = [[0.0; 4]; MAX_AXLES.div_ceil(4)];
    for (i, axle) in axles.iter().enumerate() {
        heading[i / 4][i % 4] = axle.posture[2];
    }
    let mut direction = [[0.0; 2]; MAX_AXLES];
    for k in 0..axles.len().div_ceil(4) {
        let (sin, cos) = directions(V::load(&heading[k]));
        let (sin, cos) = (sin.store(), cos.store());
        for i in 4 * k..axles.len().min(4 * k + 4) {
            direction[i] = [cos[i % 4], sin[i % 4]];
        }
    }
    for (f, frame) in frames.iter_mut().enumerate() {
        let postures = [&axles[f].posture, &axles[f + 1].posture];
        frame.locate(postures, [direction[f], direction[f + 1]]);
    }
}

/// Updates wrench and stiffness of the frames.
#[inline(always)]
fn linearise(axles: &[AxleState], frames: &mut [Frame]) {
    for (f, frame) in frames.iter_mut().enumerate() {
        frame.linearise(&[axles[f].velocity, axles[f + 1].velocity]);
    }
}

#[cfg(test)]
mod tests;
