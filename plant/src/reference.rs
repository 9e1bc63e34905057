//! The same robot by another route: explicit fourth-order Runge–Kutta at a step far below every
//! time constant, velocities in the global frame, the strip by shooting at every stage. Hundreds
//! of times slower than [`super::Plant`], and written apart from it: the check of its accuracy.
//!
//! Covers what moves the robot by default: tyres, rolling resistance, motors within their limits,
//! the elastic and damped frame. Load transfer, slip-stick, the lag of the current loop and rigid
//! ends are left out, and so is snap-through.

use super::config::PlantConfig;
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
    /// Whether the strip's equilibrium was lost.
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

    /// Wheel speeds, front left, front right, rear left, rear right, rad/s.
    pub fn wheel_speeds(&self) -> [f64; 4] {
        [self.y[12], self.y[13], self.y[14], self.y[15]]
    }

    /// End of the strip in the rear axle's frame, and its rate.
    fn strip_end(&self, y: &Coordinates) -> ([f64; 3], [f64; 3]) {
        let (dx, dy) = (y[0] - y[3], y[1] - y[4]);
        let (vx, vy) = (y[6] - y[9], y[7] - y[10]);
        let (s, c) = y[5].sin_cos();
        let (x, z) = (c * dx + s * dy, c * dy - s * dx);
        let turning = y[11];
        (
            [x, z, y[2] - y[5]],
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

    fn slope(&mut self, y: &Coordinates, command: &[f64; 4]) -> Coordinates {
        let [fx, fy, end_moment, root_moment] = self.frame(y);
        let c = &self.config;
        let (sin, cos) = y[5].sin_cos();
        let frame = [cos * fx - sin * fy, sin * fx + cos * fy];
        let mut d = [0.0; 16];
        d[..6].copy_from_slice(&y[6..12]);
        for i in 0..2 {
            let mass = c.mass_kg[i] + if i == 1 { c.sensing_mass_kg } else { 0.0 };
            let load = mass * 9.806_65 / 2.0;
            let sign = if i == 0 { -1.0 } else { 1.0 };
            let mut force = [sign * frame[0], sign * frame[1]];
            let mut moment = if i == 0 { -end_moment } else { root_moment };
            let (s, co) = y[3 * i + 2].sin_cos();
            let (vx, vy, yaw) = (y[6 + 3 * i], y[7 + 3 * i], y[8 + 3 * i]);
            for side in 0..2 {
                let w = 2 * i + side;
                let speed = y[12 + w];
                let lateral = if side == 0 { 1.0 } else { -1.0 } * c.half_track_m[i];
                // Contact point relative to the axle's middle, global.
                let (px, py) = (-s * lateral, co * lateral);
                let radius = c.wheel_radius_m[i][side];
                let gx = vx - yaw * py - radius * speed * co;
                let gy = vy + yaw * px - radius * speed * s;
                let grip = c.friction * load / (gx.hypot(gy) + c.creep_velocity_m_s);
                let (tx, ty) = (-grip * gx, -grip * gy);
                force[0] += tx;
                force[1] += ty;
                moment += px * ty - py * tx;
                let line = c.stall_torque_n_m * speed / c.no_load_speed_rad_s;
                let motor = command[w]
                    .clamp(-c.stall_torque_n_m - line, c.stall_torque_n_m - line)
                    .clamp(-c.torque_limit_n_m, c.torque_limit_n_m);
                let rolling = c.rolling_resistance * load * radius * speed / (speed.abs() + 0.05);
                d[12 + w] = (motor - rolling - radius * (tx * co + ty * s)) / c.wheel_inertia_kg_m2;
            }
            d[6 + 3 * i] = force[0] / mass;
            d[7 + 3 * i] = force[1] / mass;
            d[8 + 3 * i] = moment / c.yaw_inertia_kg_m2[i];
        }
        d
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
