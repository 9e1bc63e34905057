//! The same robot by another route: explicit fourth-order Runge–Kutta at a step far below every
//! time constant, velocities in the global frame, the strip by shooting at every stage. Hundreds
//! of times slower than [`super::Plant`], and written apart from it: the check of its accuracy.
//!
//! Covers tyres of both kinds with stiction, rolling resistance, side slip and drift of the ground,
//! motors within their limits, payloads, a sloping floor, the elastic and damped frame with its clamps. Load
//! transfer, a radius that depends on the load, play, cogging and the lag of the current loop are
//! left out, and so is snap-through.

use super::config::{PlantConfig, Tyre};
use super::elastica::{Elastica, Load, solve};

/// x, y, φ of the front axle, then of the rear; their rates; wheel speeds.
type Coordinates = [f64; 16];

/// The robot, at rest at the start.
#[derive(Clone, Debug)]
pub struct Reference {
    config: PlantConfig,
    strip: Elastica,
    y: Coordinates,
    /// Load found last and the end it belongs to, with the derivative of one by the other.
    load: Load,
    end: [f64; 3],
    by_end: [[f64; 3]; 3],
    /// True if the strip's equilibrium was lost.
    pub lost: bool,
}

impl Reference {
    /// The robot of `config` with the given postures of front and rear axle.
    pub fn new(config: &PlantConfig, postures: [[f64; 3]; 2]) -> Self {
        let slope = config.natural_slope_rad;
        let strip = Elastica {
            length: config.strip_length_m,
            bending: config.bending_stiffness_n_m2,
            axial: config.axial_stiffness_n,
            waves: [slope / 0.096_225, 0.5 * slope / 0.073_193],
            steps: 40,
        };
        let mut y = [0.0; 16];
        y[..3].copy_from_slice(&postures[0]);
        y[3..6].copy_from_slice(&postures[1]);
        let mut reference = Self {
            config: config.clone(),
            strip,
            y,
            load: [0.0; 3],
            end: [0.0; 3],
            by_end: [[0.0; 3]; 3],
            lost: false,
        };
        let (end, _) = reference.strip_end(&y);
        match strip.solve(end, [0.0; 3]) {
            Some(load) => reference.load = load,
            None => reference.lost = true,
        }
        reference.end = end;
        reference
    }

    /// Postures of front and rear axle.
    pub fn postures(&self) -> [[f64; 3]; 2] {
        let y = &self.y;
        [[y[0], y[1], y[2]], [y[3], y[4], y[5]]]
    }

    /// Angle of a clamp (0 front, 1 rear) and from the axle's midpoint to the strip, global.
    fn clamp(&self, y: &Coordinates, i: usize) -> (f64, [f64; 2]) {
        let c = &self.config;
        let (angle, length) = match i {
            0 => (c.clamp_angle_tip_rad, -c.rigid_tip_m),
            _ => (c.clamp_angle_root_rad, c.rigid_root_m),
        };
        let angle = y[3 * i + 2] + angle;
        (
            angle,
            [length * libm::cos(angle), length * libm::sin(angle)],
        )
    }

    /// End of the strip in its root's frame, and its rate.
    fn strip_end(&self, y: &Coordinates) -> ([f64; 3], [f64; 3]) {
        let ((front, to_tip), (rear, to_root)) = (self.clamp(y, 0), self.clamp(y, 1));
        let dx = y[0] + to_tip[0] - y[3] - to_root[0];
        let dy = y[1] + to_tip[1] - y[4] - to_root[1];
        let turning = y[11];
        let vx = y[6] - y[8] * to_tip[1] - y[9] + turning * to_root[1];
        let vy = y[7] + y[8] * to_tip[0] - y[10] - turning * to_root[0];
        let (s, c) = libm::sincos(rear);
        let (x, z) = (c * dx + s * dy, c * dy - s * dx);
        (
            [x, z, front - rear],
            [
                c * vx + s * vy + turning * z,
                c * vy - s * vx - turning * x,
                y[8] - turning,
            ],
        )
    }

    /// Force and moment of the frame on the end's support, negated: (Fx, Fy, M_end, M_root).
    fn frame(&mut self, y: &Coordinates) -> [f64; 4] {
        let (end, rate) = self.strip_end(y);
        // Tangent from the last stage, then as many corrections as it takes.
        for i in 0..3 {
            for n in 0..3 {
                self.load[i] += self.by_end[i][n] * (end[n] - self.end[n]);
            }
        }
        self.end = end;
        for round in 0.. {
            let shot = self.strip.shoot(self.load);
            let error = [
                end[0] - shot.end[0],
                end[1] - shot.end[1],
                end[2] - shot.end[2],
            ];
            let columns: Option<Vec<[f64; 3]>> =
                [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
                    .iter()
                    .map(|unit| solve(&shot.compliance, unit))
                    .collect();
            let Some(columns) = columns else {
                self.lost = true;
                return [0.0; 4];
            };
            let mut change: f64 = 0.0;
            for i in 0..3 {
                for n in 0..3 {
                    self.by_end[i][n] = columns[n][i];
                }
                let step: f64 = (0..3).map(|n| self.by_end[i][n] * error[n]).sum();
                self.load[i] += step;
                change = change.max(step.abs());
            }
            if change < 1e-4 {
                return self.wrench(&shot.dissipation, end, rate);
            }
            if round == 20 || !change.is_finite() {
                self.lost = true;
                return [0.0; 4];
            }
        }
        unreachable!()
    }

    fn wrench(&self, dissipation: &[[f64; 3]; 3], end: [f64; 3], rate: [f64; 3]) -> [f64; 4] {
        let [mut fx, mut fy, mut moment] = self.strip.wrench(self.load, end);
        let loads: [f64; 3] =
            std::array::from_fn(|i| (0..3).map(|n| self.by_end[i][n] * rate[n]).sum());
        let lost: [f64; 3] =
            std::array::from_fn(|i| (0..3).map(|n| dissipation[i][n] * loads[n]).sum());
        let drag: [f64; 3] = std::array::from_fn(|n| {
            let force: f64 = (0..3).map(|i| self.by_end[i][n] * lost[i]).sum();
            self.config.internal_damping_s * force
        });
        fx += drag[0];
        fy += drag[1];
        moment += drag[2];
        [fx, fy, moment, moment + end[0] * fy - end[1] * fx]
    }

    /// Way of a wheel that rolls free of force over the way rolled, global.
    fn rolling(&self, heading: f64, i: usize, speed: f64) -> [f64; 2] {
        let c = &self.config;
        let (s, co) = libm::sincos(heading);
        let sign = speed / (speed.abs() + 0.05);
        [
            co - c.side_slip[i] * s + sign * c.carpet_drift[0],
            s + c.side_slip[i] * co + sign * c.carpet_drift[1],
        ]
    }

    /// Force of a tyre over its slip velocity, N s/m.
    fn grip(&self, (i, side): (usize, usize), slip: f64, rolled: f64, load: f64) -> f64 {
        let c = &self.config;
        let highest = c.friction * (1.0 + c.static_excess);
        let half = match c.tyre {
            Tyre::Creep(creep) => creep.velocity_m_s,
            Tyre::Brush(brush) => {
                let rolling = highest * rolled.abs() / brush.slip_stiffness[i][side];
                rolling.max(brush.rest_velocity_m_s)
            }
        };
        let relative = slip / c.static_decay_m_s;
        let decayed = c.static_excess / (1.0 + relative * relative);
        c.friction * (1.0 + decayed) * load / (slip + half)
    }

    /// Loads of the wheels of an axle, N.
    fn loads(&self, i: usize) -> [f64; 2] {
        let c = &self.config;
        let moment = |n: usize| -> [f64; 2] {
            std::array::from_fn(|i| c.payload_kg[i] * c.payload_position_m[i][n])
        };
        let base = c.strip_length_m + c.rigid_root_m + c.rigid_tip_m;
        let mass = c.mass_kg[i] + c.payload_kg[i] + if i == 1 { c.sensing_mass_kg } else { 0.0 };
        // Moments about the other axle, then about the other wheel.
        let ahead = (moment(0)[0] + moment(0)[1]) / base;
        let axle = mass + if i == 0 { ahead } else { -ahead };
        let track = 2.0 * c.half_track_m[i];
        let left = axle / 2.0 + moment(1)[i] / track;
        let gravity = 9.806_65 * libm::cos(c.slope_rad);
        [gravity * left, gravity * (axle - left)]
    }

    fn slope(&mut self, y: &Coordinates, command: &[f64; 4]) -> Coordinates {
        let [fx, fy, end_moment, root_moment] = self.frame(y);
        let (sin, cos) = libm::sincos(self.clamp(y, 1).0);
        let frame = [cos * fx - sin * fy, sin * fx + cos * fy];
        let mut d = [0.0; 16];
        d[..6].copy_from_slice(&y[6..12]);
        for i in 0..2 {
            let (_, arm) = self.clamp(y, i);
            let c = &self.config;
            let load = self.loads(i);
            let sign = if i == 0 { -1.0 } else { 1.0 };
            let mut force = [sign * frame[0], sign * frame[1]];
            let mut moment = if i == 0 { -end_moment } else { root_moment };
            moment += arm[0] * force[1] - arm[1] * force[0];
            let (s, co) = libm::sincos(y[3 * i + 2]);
            let (vx, vy, yaw) = (y[6 + 3 * i], y[7 + 3 * i], y[8 + 3 * i]);
            for side in 0..2 {
                let w = 2 * i + side;
                let speed = y[12 + w];
                let lateral = if side == 0 { 1.0 } else { -1.0 } * c.half_track_m[i];
                // Contact point relative to the axle's middle, global.
                let (px, py) = (-s * lateral, co * lateral);
                let radius = c.wheel_radius_m[i][side];
                let [ex, ey] = self.rolling(y[3 * i + 2], i, speed);
                let gx = vx - yaw * py - radius * speed * ex;
                let gy = vy + yaw * px - radius * speed * ey;
                let grip = self.grip((i, side), libm::hypot(gx, gy), radius * speed, load[side]);
                let (tx, ty) = (-grip * gx, -grip * gy);
                force[0] += tx;
                force[1] += ty;
                moment += px * ty - py * tx;
                let line = c.stall_torque_n_m * speed / c.no_load_speed_rad_s;
                let motor = command[w]
                    .clamp(-c.stall_torque_n_m - line, c.stall_torque_n_m - line)
                    .clamp(-c.torque_limit_n_m, c.torque_limit_n_m);
                let rolling =
                    c.rolling_resistance * load[side] * radius * speed / (speed.abs() + 0.05);
                d[12 + w] =
                    (motor - rolling - radius * (tx * ex + ty * ey)) / c.wheel_inertia_kg_m2;
            }
            let acceleration = self.acceleration(i, [s, co], yaw, [force[0], force[1], moment]);
            d[6 + 3 * i..9 + 3 * i].copy_from_slice(&acceleration);
        }
        d
    }

    /// Acceleration of an axle's midpoint, global, from Newton's and Euler's laws for its centre of
    /// mass.
    fn acceleration(&self, i: usize, [s, co]: [f64; 2], yaw: f64, load: [f64; 3]) -> [f64; 3] {
        let c = &self.config;
        let bare = c.mass_kg[i] + if i == 1 { c.sensing_mass_kg } else { 0.0 };
        let (payload, [ahead, aside]) = (c.payload_kg[i], c.payload_position_m[i]);
        let mass = bare + payload;
        let share = payload / mass;
        // Midpoint to centre of mass, and the inertia about the latter.
        let (x, y) = (
            share * (co * ahead - s * aside),
            share * (s * ahead + co * aside),
        );
        let reduced = bare * share * (ahead * ahead + aside * aside);
        let inertia = c.yaw_inertia_kg_m2[i] + reduced;
        let [fx, fy, moment] = load;
        let turning = (moment - (x * fy - y * fx)) / inertia;
        // Gravity along the floor acts at the centre of mass.
        let along = 9.806_65 * libm::sin(c.slope_rad);
        let (gx, gy) = (
            along * libm::cos(c.downhill_rad),
            along * libm::sin(c.downhill_rad),
        );
        [
            gx + fx / mass + turning * y + yaw * yaw * x,
            gy + fy / mass - turning * x + yaw * yaw * y,
            turning,
        ]
    }

    /// Advances by `time` (s) in `steps` equal steps under constant commands, `[axle][left, right]`.
    pub fn advance(&mut self, time: f64, steps: usize, torque: [[f64; 2]; 2]) {
        let command = [torque[0][0], torque[0][1], torque[1][0], torque[1][1]];
        let h = time / steps as f64;
        for _ in 0..steps {
            let y = self.y;
            let shifted = |k: f64, d: &Coordinates| -> Coordinates {
                std::array::from_fn(|i| y[i] + k * d[i])
            };
            let a = self.slope(&y, &command);
            let b = self.slope(&shifted(0.5 * h, &a), &command);
            let c = self.slope(&shifted(0.5 * h, &b), &command);
            let d = self.slope(&shifted(h, &c), &command);
            for i in 0..16 {
                self.y[i] += h / 6.0 * (a[i] + 2.0 * (b[i] + c[i]) + d[i]);
            }
        }
    }
}
