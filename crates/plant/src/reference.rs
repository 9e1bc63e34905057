//! Independent reference of the plant: explicit fourth-order Runge–Kutta at a step far below every
//! time constant, velocities in the global frame, the strip by shooting at every stage. The reference
//! checks the accuracy of [`super::Plant`], shares no code with its step, and is hundreds of times slower.
//!
//! Covers tyres of both kinds with stiction, rolling resistance, side slip and drift of the ground,
//! motors within their limits, payloads, a sloping floor, the elastic and damped frame with its clamps. Left out are
//! load transfer, a radius that depends on the load, backlash, cogging, the lag of the current loop and snap-through.

use super::config::{PlantConfig, Tyre};
use super::elastica::{Elastica, Load, solve};
use declare::ConfigError;

/// For each axle: x, y, φ; their rates; speeds of the left and the right wheel.
type Coordinates = Vec<[f64; 8]>;

/// The robot, at rest at the start.
#[derive(Clone, Debug)]
pub struct Reference {
    config: PlantConfig,
    strip: Elastica,
    y: Coordinates,
    frames: Vec<Frame>,
    /// True if the equilibrium of a strip was lost.
    pub lost: bool,
}

/// Latest load of a strip, its end, and the derivative of the load with respect to the end.
#[derive(Clone, Copy, Debug, Default)]
struct Frame {
    load: Load,
    end: [f64; 3],
    by_end: [[f64; 3]; 3],
}

impl Reference {
    /// The robot of `config` with these postures of its axles, front first.
    pub fn new(config: &PlantConfig, postures: &[[f64; 3]]) -> Result<Self, ConfigError> {
        let slope = config.natural_slope_rad;
        let strip = Elastica {
            length: config.strip_length_m,
            bending: config.bending_stiffness_n_m2,
            axial: config.axial_stiffness_n,
            waves: [slope / 0.096_225, 0.5 * slope / 0.073_193],
            steps: 40,
        };
        let at = |p: &[f64; 3]| [p[0], p[1], p[2], 0.0, 0.0, 0.0, 0.0, 0.0];
        let mut reference = Self {
            config: config.for_axles(postures.len())?,
            strip,
            y: postures.iter().map(at).collect(),
            frames: vec![Frame::default(); postures.len() - 1],
            lost: false,
        };
        for f in 0..reference.frames.len() {
            let (end, _) = reference.strip_end(&reference.y, f);
            let load = reference.strip.solve(end, [0.0; 3]);
            reference.lost |= load.is_none();
            reference.frames[f] = Frame {
                load: load.unwrap_or_default(),
                end,
                by_end: [[0.0; 3]; 3],
            };
        }
        Ok(reference)
    }

    /// Postures of the axles, front first.
    pub fn postures(&self) -> impl Iterator<Item = [f64; 3]> {
        self.y.iter().map(|axle| [axle[0], axle[1], axle[2]])
    }

    /// Angle of an axle's clamp of the frame ahead or behind, and the vector from the axle's midpoint to the strip,
    /// global.
    fn clamp(&self, axle: &[f64; 8], ahead: bool) -> (f64, [f64; 2]) {
        let c = &self.config;
        let (angle, length) = match ahead {
            false => (c.clamp_angle_tip_rad, -c.rigid_tip_m),
            true => (c.clamp_angle_root_rad, c.rigid_root_m),
        };
        let angle = axle[2] + angle;
        (
            angle,
            [length * libm::cos(angle), length * libm::sin(angle)],
        )
    }

    /// End of a strip in its root's frame, and its rate.
    fn strip_end(&self, y: &Coordinates, f: usize) -> ([f64; 3], [f64; 3]) {
        let (a, b) = (&y[f], &y[f + 1]);
        let ((front, to_tip), (rear, to_root)) = (self.clamp(a, false), self.clamp(b, true));
        let dx = a[0] + to_tip[0] - b[0] - to_root[0];
        let dy = a[1] + to_tip[1] - b[1] - to_root[1];
        let turning = b[5];
        let vx = a[3] - a[5] * to_tip[1] - b[3] + turning * to_root[1];
        let vy = a[4] + a[5] * to_tip[0] - b[4] - turning * to_root[0];
        let (s, c) = libm::sincos(rear);
        let (x, z) = (c * dx + s * dy, c * dy - s * dx);
        (
            [x, z, front - rear],
            [
                c * vx + s * vy + turning * z,
                c * vy - s * vx - turning * x,
                a[5] - turning,
            ],
        )
    }

    /// Force (global) and moment on the strip's end, and moment on the support of its root, N and N m. The support of
    /// the end gets the opposite force and moment.
    fn frame(&mut self, y: &Coordinates, f: usize) -> [f64; 4] {
        let (end, rate) = self.strip_end(y, f);
        let frame = &mut self.frames[f];
        // Linear prediction from the last stage, then Newton corrections until they converge.
        for i in 0..3 {
            for n in 0..3 {
                frame.load[i] += frame.by_end[i][n] * (end[n] - frame.end[n]);
            }
        }
        frame.end = end;
        for round in 0.. {
            let shot = self.strip.shoot(frame.load);
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
                    frame.by_end[i][n] = columns[n][i];
                }
                let step: f64 = (0..3).map(|n| frame.by_end[i][n] * error[n]).sum();
                frame.load[i] += step;
                change = change.max(step.abs());
            }
            if change < 1e-4 {
                let frame = *frame;
                let [fx, fy, end_moment, root_moment] =
                    self.wrench(&frame, &shot.dissipation, rate);
                let (sin, cos) = libm::sincos(self.clamp(&y[f + 1], true).0);
                return [
                    cos * fx - sin * fy,
                    sin * fx + cos * fy,
                    end_moment,
                    root_moment,
                ];
            }
            if round == 20 || !change.is_finite() {
                self.lost = true;
                return [0.0; 4];
            }
        }
        unreachable!()
    }

    fn wrench(&self, frame: &Frame, dissipation: &[[f64; 3]; 3], rate: [f64; 3]) -> [f64; 4] {
        let Frame { load, end, by_end } = *frame;
        let [mut fx, mut fy, mut moment] = self.strip.wrench(load, end);
        let loads: [f64; 3] = std::array::from_fn(|i| (0..3).map(|n| by_end[i][n] * rate[n]).sum());
        let lost: [f64; 3] =
            std::array::from_fn(|i| (0..3).map(|n| dissipation[i][n] * loads[n]).sum());
        let drag: [f64; 3] = std::array::from_fn(|n| {
            let force: f64 = (0..3).map(|i| by_end[i][n] * lost[i]).sum();
            self.config.internal_damping_s * force
        });
        fx += drag[0];
        fy += drag[1];
        moment += drag[2];
        [fx, fy, moment, moment + end[0] * fy - end[1] * fx]
    }

    /// Displacement per distance rolled of a wheel without tyre force: direction, side slip and carpet drift, global
    /// coordinates.
    fn rolling(&self, heading: f64, i: usize, speed: f64) -> [f64; 2] {
        let c = &self.config;
        let (s, co) = libm::sincos(heading);
        let sign = speed / (speed.abs() + 0.05);
        [
            co - c.side_slip[i] * s + sign * c.carpet_drift[0],
            s + c.side_slip[i] * co + sign * c.carpet_drift[1],
        ]
    }

    /// Force of a tyre per slip velocity, N s/m.
    fn grip(&self, (i, side): (usize, usize), slip: f64, rolled: f64, load: f64) -> f64 {
        let c = &self.config;
        let highest = c.friction * (1.0 + c.static_excess);
        let half = match &c.tyre {
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
        let count = self.y.len();
        let moment = |axle: usize, n: usize| c.payload_kg[axle] * c.payload_position_m[axle][n];
        let base = c.strip_length_m + c.rigid_root_m + c.rigid_tip_m;
        let mass = c.mass_kg[i] + c.payload_kg[i] + if i > 0 { c.sensing_mass_kg } else { 0.0 };
        // The axles are springs under a rigid beam: their deflection grows linearly from the middle to the ends.
        let lever = |axle: usize| base * (0.5 * (count - 1) as f64 - axle as f64);
        let stiffness: f64 = (0..count).map(|axle| lever(axle) * lever(axle)).sum();
        let pitch: f64 = (0..count).map(|axle| moment(axle, 0)).sum();
        let axle = mass + pitch * lever(i) / stiffness;
        let track = 2.0 * c.half_track_m[i];
        let left = axle / 2.0 + moment(i, 1) / track;
        let gravity = 9.806_65 * libm::cos(c.slope_rad);
        [gravity * left, gravity * (axle - left)]
    }

    fn slope(&mut self, y: &Coordinates, command: &[[f64; 2]]) -> Coordinates {
        let frames: Vec<_> = (0..self.frames.len()).map(|f| self.frame(y, f)).collect();
        let mut d = y.clone();
        for (i, (axle, d)) in y.iter().zip(&mut d).enumerate() {
            let c = &self.config;
            let load = self.loads(i);
            let (mut force, mut moment) = ([0.0; 2], 0.0);
            // At this axle the frame ahead has its root, and the frame behind its tip.
            let ahead = i.checked_sub(1).map(|f| (&frames[f], true));
            let behind = frames.get(i).map(|frame| (frame, false));
            for ([fx, fy, end_moment, root_moment], is_ahead) in ahead.into_iter().chain(behind) {
                let (_, arm) = self.clamp(axle, is_ahead);
                let (x, y, own) = match is_ahead {
                    true => (*fx, *fy, *root_moment),
                    false => (-fx, -fy, -end_moment),
                };
                force = [force[0] + x, force[1] + y];
                moment += own + arm[0] * y - arm[1] * x;
            }
            let [_, _, heading, vx, vy, yaw, ..] = *axle;
            let (s, co) = libm::sincos(heading);
            for side in 0..2 {
                let speed = axle[6 + side];
                let lateral = if side == 0 { 1.0 } else { -1.0 } * c.half_track_m[i];
                // Contact point relative to the axle's middle, global.
                let (px, py) = (-s * lateral, co * lateral);
                let radius = c.wheel_radius_m[i][side];
                let [ex, ey] = self.rolling(heading, i, speed);
                let gx = vx - yaw * py - radius * speed * ex;
                let gy = vy + yaw * px - radius * speed * ey;
                let grip = self.grip((i, side), libm::hypot(gx, gy), radius * speed, load[side]);
                let (tx, ty) = (-grip * gx, -grip * gy);
                force[0] += tx;
                force[1] += ty;
                moment += px * ty - py * tx;
                let line = c.stall_torque_n_m * speed / c.no_load_speed_rad_s;
                let motor = command[i][side]
                    .clamp(-c.stall_torque_n_m - line, c.stall_torque_n_m - line)
                    .clamp(-c.torque_limit_n_m, c.torque_limit_n_m);
                let rolling =
                    c.rolling_resistance * load[side] * radius * speed / (speed.abs() + 0.05);
                d[6 + side] =
                    (motor - rolling - radius * (tx * ex + ty * ey)) / c.wheel_inertia_kg_m2;
            }
            let acceleration = self.acceleration(i, [s, co], yaw, [force[0], force[1], moment]);
            d[..3].copy_from_slice(&axle[3..6]);
            d[3..6].copy_from_slice(&acceleration);
        }
        d
    }

    /// Acceleration of an axle's midpoint, global, from Newton's and Euler's laws for its centre of
    /// mass.
    fn acceleration(&self, i: usize, [s, co]: [f64; 2], yaw: f64, load: [f64; 3]) -> [f64; 3] {
        let c = &self.config;
        let bare = c.mass_kg[i] + if i > 0 { c.sensing_mass_kg } else { 0.0 };
        let (payload, [ahead, aside]) = (c.payload_kg[i], c.payload_position_m[i]);
        let mass = bare + payload;
        let share = payload / mass;
        // Vector from the midpoint to the centre of mass, and inertia about the centre of mass.
        let (x, y) = (
            share * (co * ahead - s * aside),
            share * (s * ahead + co * aside),
        );
        let reduced = bare * share * (ahead * ahead + aside * aside);
        let inertia = c.yaw_inertia_kg_m2[i] + reduced;
        let [fx, fy, moment] = load;
        let turning = (moment - (x * fy - y * fx)) / inertia;
        // Gravity along the floor acts at the centre of mass.
        let downslope = 9.806_65 * libm::sin(c.slope_rad);
        let (gx, gy) = (
            downslope * libm::cos(c.downhill_rad),
            downslope * libm::sin(c.downhill_rad),
        );
        [
            gx + fx / mass + turning * y + yaw * yaw * x,
            gy + fy / mass - turning * x + yaw * yaw * y,
            turning,
        ]
    }

    /// Advances by `time` (s) in `steps` equal steps under constant commands, `[axle][left, right]`.
    pub fn advance(&mut self, time: f64, steps: usize, torque: &[[f64; 2]]) {
        let h = time / steps as f64;
        for _ in 0..steps {
            let y = self.y.clone();
            let shifted = |k: f64, d: &Coordinates| -> Coordinates {
                let axles = y.iter().zip(d);
                axles
                    .map(|(y, d)| std::array::from_fn(|n| y[n] + k * d[n]))
                    .collect()
            };
            let a = self.slope(&y, torque);
            let b = self.slope(&shifted(0.5 * h, &a), torque);
            let c = self.slope(&shifted(0.5 * h, &b), torque);
            let d = self.slope(&shifted(h, &c), torque);
            for (i, y) in self.y.iter_mut().enumerate() {
                for n in 0..8 {
                    y[n] += h / 6.0 * (a[i][n] + 2.0 * (b[i][n] + c[i][n]) + d[i][n]);
                }
            }
        }
    }
}
