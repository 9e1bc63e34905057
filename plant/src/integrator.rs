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

use super::config::PlantConfig;
use super::frame::{Column, Equilibrium, Station, Strip};
#[cfg(target_arch = "x86_64")]
use super::lanes::Wide;
use super::lanes::{Lanes, Narrow};
use super::sincos::directions;
use super::wheel::{Contact, Eliminated, Wheels};

type Vec3 = [f64; 3];
type Mat3 = [[f64; 3]; 3];

/// Coefficient of the implicit part, 1 − 1/√2: the method damps what is infinitely stiff.
const GAMMA: f64 = 1.0 - std::f64::consts::FRAC_1_SQRT_2;
/// Finest division of a step: `1 << FINEST` parts.
const FINEST: u32 = 4;
/// Ratios of internal viscosity τ to the whole time step tried when the strip snaps through.
const CREEP: [f64; 5] = [5.0, 20.0, 100.0, 500.0, 5000.0];

/// One axle as it is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxleState {
    /// Midpoint (m, m) and heading (rad, not wrapped) in the global frame.
    pub posture: Vec3,
    /// Velocity of the midpoint forward and to the left (m/s) and yaw rate (rad/s).
    pub velocity: Vec3,
    /// Acceleration of the midpoint forward and to the left (m/s², what an accelerometer there
    /// feels) and yaw acceleration (rad/s²), mean of the last step.
    pub acceleration: Vec3,
    /// Wheel speeds, left and right, rad/s, positive forward.
    pub wheel_speed: [f64; 2],
    /// Wheel angles since the start, rad.
    pub wheel_angle: [f64; 2],
    /// Torques of the motors at the wheels after all limits, N m.
    pub torque: [f64; 2],
    /// Loads on the wheels, N.
    pub load: [f64; 2],
}

/// Both axles, front first.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PlantState {
    /// Front, rear.
    pub axle: [AxleState; 2],
}

/// What the frame exerts: (+force, +root moment) on the rear axle, (−force, −end moment) on the
/// front axle, in the frame of the rear axle.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wrench {
    /// Force forward and to the left, N.
    pub force: [f64; 2],
    /// Moment about the midpoint of the rear axle, N m.
    pub root_moment: f64,
    /// Moment about the midpoint of the front axle, N m.
    pub end_moment: f64,
}

/// Places along the frame, prepared by [`Plant::outline`]: on the strip, and how far beyond it.
#[derive(Clone, Debug)]
pub struct Outline(Vec<(Station, f64)>);

/// How the solution of the frame has fared since [`Plant::place`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Health {
    /// Steps taken.
    pub steps: u64,
    /// Factorisations of the frame's equations.
    pub factorisations: u64,
    /// Most factorisations for one equilibrium.
    pub most_factorisations: u32,
    /// Parts that the steps were divided into.
    pub parts: u64,
    /// Parts in which the frame's force was taken from its tangent.
    pub linear_wrenches: u64,
    /// Times the frame left one branch for another.
    pub snap_throughs: u64,
    /// Parts of steps spent under internal viscosity while it did.
    pub creep_steps: u64,
    /// Parts of steps whose equilibrium was not found at all: the frame kept its shape.
    pub failures: u64,
}

/// The robot.
#[derive(Clone, Debug)]
pub struct Plant {
    wheels: Wheels,
    strip: Strip,
    /// Whether the processor works on four numbers at once. The results are the same.
    #[cfg(target_arch = "x86_64")]
    wide: bool,
    mass: [f64; 2],
    inertia: [f64; 2],
    static_load: [f64; 4],
    step: f64,
    damping: f64,
    root: f64,
    tip: f64,
    half_track: [f64; 2],
    height: f64,
    tolerance: f64,
    load_share: f64,
    current_share: f64,

    state: PlantState,
    /// Command after the current loop.
    command: [f64; 4],
    load: [f64; 4],
    /// Acceleration that the loads follow.
    load_acceleration: [[f64; 2]; 2],
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

/// Where the strip's end is: everything in the rear axle's frame.
#[derive(Clone, Copy, Debug, Default)]
struct Geometry {
    /// Direction of the rear axle, (cos, sin).
    rear: [f64; 2],
    /// Direction of the front axle.
    front: [f64; 2],
    /// Front axle's midpoint seen from the rear axle.
    position: [f64; 2],
    /// Front axle's direction seen from the rear axle.
    turn: [f64; 2],
    /// Strip's end seen from the rear axle.
    end: [f64; 2],
    /// Length of the rigid tip.
    tip: f64,
}

impl Geometry {
    /// Rate of the strip's end in the root frame for body velocities of the axles.
    #[inline(always)]
    fn rate(&self, v: &[Vec3; 2]) -> Vec3 {
        let [c, s] = self.turn;
        let [f, r] = v;
        let across = f[1] - self.tip * f[2];
        [
            c * f[0] - s * across - r[0] + self.end[1] * r[2],
            s * f[0] + c * across - r[1] - self.end[0] * r[2],
            f[2] - r[2],
        ]
    }

    /// Its transpose: what the wrench `w` is to the axles' coordinates.
    #[inline(always)]
    fn transpose(&self, w: &Vec3) -> [Vec3; 2] {
        let [c, s] = self.turn;
        let across = c * w[1] - s * w[0];
        [
            [c * w[0] + s * w[1], across, w[2] - self.tip * across],
            [-w[0], -w[1], self.end[1] * w[0] - self.end[0] * w[1] - w[2]],
        ]
    }
}

#[inline(always)]
fn rotate(v: &[f64; 2], [c, s]: [f64; 2]) -> [f64; 2] {
    [c * v[0] - s * v[1], s * v[0] + c * v[1]]
}

#[inline(always)]
fn unrotate(v: &[f64; 2], [c, s]: [f64; 2]) -> [f64; 2] {
    [c * v[0] + s * v[1], c * v[1] - s * v[0]]
}

#[inline(always)]
fn turned(v: &Vec3, direction: [f64; 2]) -> Vec3 {
    let [x, y] = rotate(&[v[0], v[1]], direction);
    [x, y, v[2]]
}

#[inline(always)]
fn unturned(v: &Vec3, direction: [f64; 2]) -> Vec3 {
    let [x, y] = unrotate(&[v[0], v[1]], direction);
    [x, y, v[2]]
}

/// (cos, sin) of a small angle.
#[inline(always)]
fn small_turn(a: f64) -> [f64; 2] {
    if a.abs() < 0.1 {
        let z = a * a;
        [
            1.0 - z * (0.5 - z * (1.0 / 24.0 - z * (1.0 / 720.0 - z / 40_320.0))),
            a * (1.0 - z * (1.0 / 6.0 - z * (1.0 / 120.0 - z * (1.0 / 5040.0 - z / 362_880.0)))),
        ]
    } else {
        direction(a)
    }
}

#[inline(always)]
fn direction(a: f64) -> [f64; 2] {
    let (s, c) = libm::sincos(a);
    [c, s]
}

#[inline(always)]
fn times(m: &Mat3, v: &Vec3) -> Vec3 {
    [
        m[0][0] * v[0] + m[0][1] * v[1] + m[0][2] * v[2],
        m[1][0] * v[0] + m[1][1] * v[1] + m[1][2] * v[2],
        m[2][0] * v[0] + m[2][1] * v[1] + m[2][2] * v[2],
    ]
}

#[inline(always)]
fn add(a: &Vec3, k: f64, b: &Vec3) -> Vec3 {
    [a[0] + k * b[0], a[1] + k * b[1], a[2] + k * b[2]]
}

#[inline(always)]
fn scaled(k: f64, v: &Vec3) -> Vec3 {
    [k * v[0], k * v[1], k * v[2]]
}

/// Inverse, by cofactors: the matrices here are far from singular.
#[inline(always)]
fn inverse(m: &Mat3) -> Mat3 {
    let cofactor = |i: usize, j: usize| {
        let (a, b) = ((i + 1) % 3, (i + 2) % 3);
        let (c, d) = ((j + 1) % 3, (j + 2) % 3);
        m[a][c] * m[b][d] - m[a][d] * m[b][c]
    };
    let (x, y, z) = (cofactor(0, 0), cofactor(0, 1), cofactor(0, 2));
    let r = 1.0 / (m[0][0] * x + m[0][1] * y + m[0][2] * z);
    [
        [r * x, r * cofactor(1, 0), r * cofactor(2, 0)],
        [r * y, r * cofactor(1, 1), r * cofactor(2, 1)],
        [r * z, r * cofactor(1, 2), r * cofactor(2, 2)],
    ]
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
            let (xx, xy, xt) = (h * xx, h * xy, h * xt);
            let (yy, yt, tt) = (h * yy, h * yt, h * tt);
            axle[i] = inverse(&[
                [plant.mass[i] + xx, xy, xt],
                [xy, plant.mass[i] + yy, yt],
                [xt, yt, plant.inertia[i] + tt],
            ]);
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
    pub(super) fn new(config: &PlantConfig, mass: [f64; 2], strip: Strip) -> Self {
        let share = |time: f64| 1.0 - libm::exp(-config.step_s / time);
        let equilibrium = strip.unloaded();
        let static_load = Wheels::static_load(mass);
        let mut plant = Self {
            wheels: Wheels::new(config),
            #[cfg(target_arch = "x86_64")]
            wide: std::arch::is_x86_feature_detected!("avx2"),
            mass,
            inertia: config.yaw_inertia_kg_m2,
            static_load,
            step: config.step_s,
            damping: config.internal_damping_s,
            root: config.rigid_root_m,
            tip: config.rigid_tip_m,
            half_track: config.half_track_m,
            height: config.center_of_mass_height_m,
            tolerance: config.tolerance_m_s,
            load_share: share(config.load_transfer_time_s),
            current_share: share(config.current_loop_time_s),
            state: PlantState::default(),
            command: [0.0; 4],
            load: static_load,
            load_acceleration: [[0.0; 2]; 2],
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
        let offset = [end[0] + self.root + self.tip, end[1]];
        // The unloaded strip may leave its ends a hair apart sideways: O's heading is C2 → C1.
        let heading = midpoint[2] - libm::atan2(offset[1], offset[0]);
        let [dx, dy] = rotate(&offset, direction(heading));
        self.state = PlantState::default();
        for (axle, side) in self.state.axle.iter_mut().zip([0.5, -0.5]) {
            axle.posture = [midpoint[0] + side * dx, midpoint[1] + side * dy, heading];
            axle.load = [0.0; 2];
        }
        self.command = [0.0; 4];
        self.load = self.static_load;
        self.load_acceleration = [[0.0; 2]; 2];
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
        self.geometry = Geometry {
            rear,
            front,
            position,
            turn,
            end: [
                position[0] - self.tip * turn[0],
                position[1] - self.tip * turn[1],
            ],
            tip: self.tip,
        };
    }

    /// Strip's end in the strip's root frame.
    #[inline(always)]
    fn strip_end(&self) -> Vec3 {
        let [x, y] = self.geometry.end;
        let [f, r] = &self.state.axle;
        [x - self.root, y, f.posture[2] - r.posture[2]]
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

    fn publish_loads(&mut self) {
        for w in 0..4 {
            self.state.axle[w / 2].load[w % 2] = self.load[w];
        }
    }

    /// Advances one time step under the commanded wheel torques (N m, `[axle][left, right]`, held;
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
        for w in 0..4 {
            let wanted = torque[w / 2][w % 2];
            let wanted = if wanted.is_finite() { wanted } else { 0.0 };
            self.command[w] += self.current_share * (wanted - self.command[w]);
        }
        let before = [self.state.axle[0].velocity, self.state.axle[1].velocity];
        let turned = [self.state.axle[0].posture[2], self.state.axle[1].posture[2]];
        self.divide::<V>();
        for i in 0..2 {
            let axle = &mut self.state.axle[i];
            let was = unturned(&before[i], small_turn(axle.posture[2] - turned[i]));
            axle.acceleration = scaled(1.0 / self.step, &add(&axle.velocity, -1.0, &was));
        }
        self.health.steps += 1;
        if self.height > 0.0 {
            self.shift_loads();
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
    fn advance<V: Lanes>(&mut self, h: f64, force: bool) -> bool {
        const G: f64 = GAMMA;
        let start = [self.state.axle[0].velocity, self.state.axle[1].velocity];
        let speed = self.speeds();
        let geometry = self.geometry;
        let g = G * h;

        // First stage: u = γh·k, (I − γhA) k = f(start).
        let hub = self.wheels.hub(&start);
        let now = self
            .wheels
            .contact(&hub, V::load(&speed), &self.load, &self.command);
        let implicit = Implicit::<V>::new(self, &now, g);
        let pull = add(
            &self.total,
            g,
            &times(&self.stiffness, &geometry.rate(&start)),
        );
        let load = self.wheels.load(&implicit.wheels, &now, &now);
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
            there.end[0] - self.root,
            there.end[1],
            turn + a * (move1[0][2] - move1[1][2]),
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
        let mut then = self
            .wheels
            .contact(&hub, there_speed, &self.load, &self.command);

        // Second stage: (I − γhA) k = f(there) − k₁.
        then.torque = then.torque - spin1 * V::splat(self.wheels.inertia / g);
        let load = self.wheels.load(&implicit.wheels, &now, &then);
        let load = minus(&load, &there.transpose(&total));
        let mut load = [turned(&load[0], turns[0]), turned(&load[1], turns[1])];
        let mut move2 = [[0.0; 3]; 2];
        for i in 0..2 {
            for n in 0..3 {
                let inertia = if n == 2 {
                    self.inertia[i]
                } else {
                    self.mass[i]
                };
                load[i][n] -= inertia * k1[i][n];
                move2[i][n] = there_v[i][n] - move1[i][n];
            }
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
        let end = [
            position[0] - self.tip * turn[0],
            position[1] - self.tip * turn[1],
        ];
        let geometry = Geometry {
            position,
            turn,
            end,
            ..*from
        };
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

    /// Wheel loads from the acceleration, which they follow with a lag: longitudinal acceleration
    /// shifts load between the axles (the frame carries the moment), lateral between the wheels.
    #[cold]
    fn shift_loads(&mut self) {
        let base = libm::hypot(self.geometry.position[0], self.geometry.position[1]);
        for i in 0..2 {
            for n in 0..2 {
                let a = &mut self.load_acceleration[i][n];
                *a += self.load_share * (self.state.axle[i].acceleration[n] - *a);
            }
        }
        let a = &self.load_acceleration;
        let pitch =
            (self.mass[0] * a[0][0] + self.mass[1] * a[1][0]) * self.height / base.max(1e-3);
        for w in 0..4 {
            let (i, left) = (w / 2, w % 2 == 0);
            let roll = self.mass[i] * a[i][1] * self.height / (2.0 * self.half_track[i]);
            let lengthwise = if i == 0 { -0.5 * pitch } else { 0.5 * pitch };
            let across = if left { -roll } else { roll };
            self.load[w] = (self.static_load[w] + lengthwise + across).max(0.0);
        }
        self.publish_loads();
    }

    /// From now on a wheel (axle 0 front, 1 rear; side 0 left, 1 right) does not touch the ground.
    pub fn lift_wheel(&mut self, axle: usize, side: usize) {
        self.wheels.lift(2 * axle + side);
    }

    /// From now on the frame is in two pieces: it exerts nothing and is not bent.
    pub fn snap_frame(&mut self) {
        self.snapped = true;
        self.linearise();
    }

    /// The same robot computed without vector instructions, for checks that nothing depends on
    /// them.
    pub fn portable(&self) -> Self {
        let mut portable = self.clone();
        #[cfg(target_arch = "x86_64")]
        {
            portable.wide = false;
        }
        portable
    }

    /// The same robot on frictionless ground, for checks of what the frame alone does.
    pub fn without_friction(&self) -> Self {
        let mut free = self.clone();
        free.wheels.remove_friction();
        free
    }

    /// Time since [`Self::place`], s.
    pub fn time(&self) -> f64 {
        self.health.steps as f64 * self.step
    }

    /// Time step, s.
    pub fn step_s(&self) -> f64 {
        self.step
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

    /// What the frame exerts on the axles now, elastic and damping.
    pub fn wrench(&self) -> Wrench {
        self.on_axles(&self.total)
    }

    /// The elastic part of it: what the strains show.
    pub fn elastic_wrench(&self) -> Wrench {
        self.on_axles(&self.elastic)
    }

    fn on_axles(&self, w: &Vec3) -> Wrench {
        let [front, rear] = self.geometry.transpose(w);
        Wrench {
            force: [w[0], w[1]],
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
        let whole = self.root + length + self.tip;
        let place = |k: usize| {
            let along = whole * k as f64 / points.saturating_sub(1).max(1) as f64;
            let s = (along - self.root).clamp(0.0, length);
            (self.strip.station(s), along - self.root - s)
        };
        Outline((0..points).map(place).collect())
    }

    /// Points of the frame, global, m; as many as `out` and the outline both have.
    pub fn draw(&self, outline: &Outline, out: &mut [[f64; 2]]) {
        let rear = self.state.axle[1].posture;
        let tangents = self.strip.tangents(&self.equilibrium);
        let turn = self.geometry.turn;
        for ((station, rest), out) in outline.0.iter().zip(out) {
            let [x, y] = self.strip.position(&tangents, station);
            // The rigid end at the rear points ahead, the one at the front as the front axle does.
            let [c, s] = if *rest > 0.0 { turn } else { [1.0, 0.0] };
            let point = [x + self.root + rest * c, y + rest * s];
            let [x, y] = rotate(&point, self.geometry.rear);
            *out = [rear[0] + x, rear[1] + y];
        }
    }

    /// Points along the frame from the rear axle to the front axle, global, m.
    pub fn frame_curve(&self, points: usize) -> Vec<[f64; 2]> {
        let mut out = vec![[0.0; 2]; points];
        self.draw(&self.outline(points), &mut out);
        out
    }

    /// Kinetic energy of axles and wheels and elastic energy of the frame, J.
    pub fn energy(&self) -> f64 {
        let mut energy = self.strip.energy(&self.equilibrium);
        for (i, a) in self.state.axle.iter().enumerate() {
            let [u, v, w] = a.velocity;
            energy += 0.5 * self.mass[i] * (u * u + v * v) + 0.5 * self.inertia[i] * w * w;
            energy += self.wheels.energy(&a.wheel_speed);
        }
        energy
    }

    /// Counters since [`Self::place`].
    pub fn health(&self) -> Health {
        self.health
    }
}

#[inline(always)]
fn sum(a: &[Vec3; 2], b: &[Vec3; 2]) -> [Vec3; 2] {
    [add(&a[0], 1.0, &b[0]), add(&a[1], 1.0, &b[1])]
}

#[inline(always)]
fn minus(a: &[Vec3; 2], b: &[Vec3; 2]) -> [Vec3; 2] {
    [add(&a[0], -1.0, &b[0]), add(&a[1], -1.0, &b[1])]
}
