//! Masses of the axles, and the weight that each wheel bears.

use super::config::{PlantConfig, TICK_S};
use super::geometry::{Mat3, Vec3, add, inverse, times, turned};
use super::state::AxleState;
use declare::{Allowed, Checked, ConfigError};

/// Standard gravity, m/s².
const GRAVITY_M_S2: f64 = 9.806_65;

/// Gravity into the floor (m/s²) and along the floor, in the global frame (m/s²).
pub fn gravity(config: &PlantConfig) -> (f64, [f64; 2]) {
    let (slope, downhill) = (config.slope_rad, config.downhill_rad);
    let downslope = GRAVITY_M_S2 * libm::sin(slope);
    (
        GRAVITY_M_S2 * libm::cos(slope),
        [
            downslope * libm::cos(downhill),
            downslope * libm::sin(downhill),
        ],
    )
}

/// Inertia of one axle with payload and sensing, about the axle's midpoint.
#[derive(Clone, Copy, Debug)]
pub struct Body {
    /// Mass of the axle, kg.
    pub mass: f64,
    /// Yaw inertia about the axle's midpoint, kg m².
    pub inertia: f64,
    /// First moment: mass times the position of the centre of mass, forward and to the left, kg m.
    pub moment: [f64; 2],
    inverse: Mat3,
}

impl Body {
    /// The axles, front first, from checked constants with an entry for each axle. A payload is a point mass.
    pub fn all(config: &PlantConfig) -> Vec<Self> {
        let body = |i: usize| {
            let (payload, [x, y]) = (config.payload_kg[i], config.payload_position_m[i]);
            let bare = match i {
                0 => config.mass_kg[0],
                _ => config.mass_kg[i] + config.sensing_mass_kg,
            };
            let mut body = Self {
                mass: bare + payload,
                inertia: config.yaw_inertia_kg_m2[i] + payload * (x * x + y * y),
                moment: [payload * x, payload * y],
                inverse: [[0.0; 3]; 3],
            };
            body.inverse = inverse(&body.with_damping(&[0.0; 6]));
            body
        };
        (0..config.axles()).map(body).collect()
    }

    /// Mass matrix (forward, left, yaw) with a symmetric matrix (xx, xy, xφ, yy, yφ, φφ) added.
    #[inline(always)]
    pub fn with_damping(&self, [xx, xy, xt, yy, yt, tt]: &[f64; 6]) -> Mat3 {
        let [x, y] = self.moment;
        [
            [self.mass + xx, *xy, xt - y],
            [*xy, self.mass + yy, yt + x],
            [xt - y, yt + x, self.inertia + tt],
        ]
    }

    /// Rate of momentum for an acceleration of the midpoint.
    #[inline(always)]
    pub fn momentum(&self, a: &Vec3) -> Vec3 {
        let [x, y] = self.moment;
        [
            self.mass * a[0] - y * a[2],
            self.mass * a[1] + x * a[2],
            self.inertia * a[2] + (x * a[1] - y * a[0]),
        ]
    }

    /// Load plus the centrifugal force at a yaw rate.
    #[inline(always)]
    pub fn with_centrifugal_force(&self, load: &Vec3, rate: f64) -> Vec3 {
        let square = rate * rate;
        [
            load[0] + square * self.moment[0],
            load[1] + square * self.moment[1],
            load[2],
        ]
    }

    /// Load plus gravity along the floor (m/s², in the body's frame).
    #[inline(always)]
    pub fn with_gravity(&self, load: &Vec3, gravity: [f64; 2]) -> Vec3 {
        add(load, 1.0, &self.momentum(&[gravity[0], gravity[1], 0.0]))
    }

    /// Converts a load in the frame of a body that has turned since the start of the step. The result gives the same
    /// acceleration with the mass matrix at the start of the step.
    #[inline(always)]
    pub fn turned(&self, load: &Vec3, turn: [f64; 2]) -> Vec3 {
        if self.moment == [0.0; 2] {
            return turned(load, turn);
        }
        self.momentum(&turned(&times(&self.inverse, load), turn))
    }

    /// Kinetic energy at the velocity `v`, J.
    pub fn energy(&self, v: &Vec3) -> f64 {
        let [x, y] = self.moment;
        0.5 * self.mass * (v[0] * v[0] + v[1] * v[1])
            + 0.5 * self.inertia * v[2] * v[2]
            + v[2] * (x * v[1] - y * v[0])
    }
}

/// Loads on the wheels, `[axle][left, right]`.
///
/// Load transfer is quasi-static: the moment of the inertial force at the height of the centre of
/// mass is borne by the wheels after a short lag, which stands for the tyres' vertical springs
/// (Gillespie, *Fundamentals of Vehicle Dynamics*, SAE 1992, chapter 1). Longitudinal acceleration
/// shifts load between the axles (the strips stand upright and carry the moment), lateral
/// acceleration between the wheels of each axle (a strip is soft in torsion). The loads add up to
/// the weight also where a wheel leaves the ground.
///
/// Two axles share a pitching moment by statics. For more axles the model assumes that each axle
/// bears its own weight and that equal springs under a rigid beam share the moment. The moment grows no
/// further once an axle lifts off.
#[derive(Clone, Debug)]
pub struct Loads {
    at_rest: Vec<[f64; 2]>,
    half_track: Vec<f64>,
    mass: Vec<f64>,
    height: f64,
    share: f64,
    /// Specific force of each axle after the lag, forward and left, m/s²: the loads are computed from it.
    acceleration: Vec<[f64; 2]>,
    /// Present load of each wheel, N.
    pub now: Vec<[f64; 2]>,
}

/// Load on an axle per unit of M/l, with pitching moment M and distance l of neighbouring axles.
fn pitch_share(axle: usize, axles: usize) -> f64 {
    let middle = (axles as f64 - 1.0) / 2.0;
    let squares: f64 = (0..axles)
        .map(|i| (middle - i as f64) * (middle - i as f64))
        .sum();
    (middle - axle as f64) / squares
}

impl Loads {
    /// Loads at rest.
    pub fn new(config: &PlantConfig, bodies: &[Body]) -> Self {
        let at_rest = at_rest(config, bodies);
        Self {
            now: at_rest.clone(),
            acceleration: vec![[0.0; 2]; at_rest.len()],
            at_rest,
            half_track: config.half_track_m.entries().to_vec(),
            mass: bodies.iter().map(|body| body.mass).collect(),
            height: config.center_of_mass_height_m,
            share: 1.0
                - libm::exp(-TICK_S / f64::from(config.substeps) / config.load_transfer_time_s),
        }
    }

    /// Resets the loads to rest.
    pub fn settle(&mut self) {
        self.acceleration.fill([0.0; 2]);
        self.now.clone_from(&self.at_rest);
    }

    /// True if acceleration shifts the loads.
    #[inline(always)]
    pub fn shift(&self) -> bool {
        self.height > 0.0
    }

    /// Updates the loads after a step from the acceleration of the axles; neighbours are `base` (m) apart.
    #[cold]
    pub fn follow(&mut self, axles: &[AxleState], base: f64) {
        for (follower, axle) in self.acceleration.iter_mut().zip(axles) {
            for n in 0..2 {
                follower[n] += self.share * (axle.acceleration[n] - follower[n]);
            }
        }
        let (a, rest) = (&self.acceleration, &self.at_rest);
        let weight = |i: usize| rest[i][0] + rest[i][1];
        let mut ahead = self.mass[0] * a[0][0];
        for (mass, acceleration) in self.mass.iter().zip(a).skip(1) {
            ahead += mass * acceleration[0];
        }
        let mut pitch = ahead * self.height / base.max(1e-3);
        for i in 0..axles.len() {
            // Limits the pitching moment, so that no axle gets a negative load.
            let share = pitch_share(i, axles.len());
            if share > 0.0 {
                pitch = pitch.min(weight(i) / share);
            } else if share < 0.0 {
                pitch = pitch.max(weight(i) / share);
            }
        }
        for i in 0..axles.len() {
            // Rounding may leave a negative load.
            let axle = (weight(i) - pitch * pitch_share(i, axles.len())).max(0.0);
            let roll = self.mass[i] * a[i][1] * self.height / (2.0 * self.half_track[i]);
            let left = 0.5 * (axle + rest[i][0] - rest[i][1]) - roll;
            self.now[i][0] = left.clamp(0.0, axle);
            self.now[i][1] = axle - self.now[i][0];
        }
    }
}

/// Distance of neighbouring axles with their frame straight, m.
fn base(config: &PlantConfig) -> f64 {
    config.strip_length_m + config.rigid_root_m + config.rigid_tip_m
}

/// Loads of the robot at rest with its frames straight.
pub fn at_rest(config: &PlantConfig, bodies: &[Body]) -> Vec<[f64; 2]> {
    let (gravity, _) = gravity(config);
    // A payload ahead of its axle's midpoint loads the axles ahead, through the frames.
    let ahead: f64 = bodies.iter().map(|body| body.moment[0]).sum();
    let pitch = gravity * ahead / base(config);
    let load = |(i, body): (usize, &Body)| {
        let half = 0.5 * body.mass * gravity + 0.5 * pitch * pitch_share(i, bodies.len());
        let roll = gravity * body.moment[1] / (2.0 * config.half_track_m[i]);
        [half + roll, half - roll]
    };
    bodies.iter().enumerate().map(load).collect()
}

/// Refuses a payload that lifts a wheel off the ground.
pub fn check_payload(config: &PlantConfig) -> Result<(), ConfigError> {
    let bodies = Body::all(config);
    let load = at_rest(config, &bodies);
    let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
    for (i, body) in bodies.iter().enumerate() {
        // First moment of all payloads about their axles, kg m, at which this axle has no load.
        let share = pitch_share(i, bodies.len());
        let bound = -body.mass * base(config) / share;
        if share > 0.0 {
            low = low.max(bound);
        } else if share < 0.0 {
            high = high.min(bound);
        }
    }
    for i in 0..bodies.len() {
        let payload = config.payload_kg[i];
        if payload == 0.0 {
            continue;
        }
        let place = config.payload_position_m[i];
        let check = |n: usize, low: f64, high: f64| {
            let allowed = Allowed::Range(low as f32, high as f32);
            let checked = place[n].check("payload_position_m", allowed);
            checked.map_err(|error| error.at(n).at(i))
        };
        let others = bodies.iter().enumerate().filter(|(j, _)| *j != i);
        let others: f64 = others.map(|(_, body)| body.moment[0]).sum();
        check(0, (low - others) / payload, (high - others) / payload)?;
        // The payload may shift at most half the axle's load from one wheel to the other; otherwise a wheel lifts off.
        let half = 0.5 * (load[i][0] + load[i][1]);
        let roll = 0.5 * (load[i][0] - load[i][1]);
        if roll.abs() > half {
            let reach = (place[1] * half / roll).abs();
            check(1, -reach, reach)?;
        }
    }
    Ok(())
}
