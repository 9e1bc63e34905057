//! Tyres, wheels and motors of one axle.

use super::config::PlantConfig;

/// Standard gravity, m/s².
const GRAVITY: f64 = 9.806_65;
/// Wheel speed below which rolling resistance fades, rad/s.
const ROLLING_FADE: f64 = 0.05;

/// Constants of the four wheels, in the order front left, front right, rear left, rear right.
#[derive(Clone, Debug)]
pub struct Wheels {
    friction: f64,
    creep: f64,
    excess: f64,
    decay: f64,
    /// Inertia of a wheel, kg m².
    pub inertia: f64,
    rolling: f64,
    stall: f64,
    slope: f64,
    limit: f64,
    /// Radius, m.
    pub radius: [f64; 4],
    /// Forward velocity of the contact point for a unit yaw rate (−d left, +d right), m.
    pub arm: [f64; 4],
}

/// What the wheels do at one instant, and its linearisation.
#[derive(Clone, Copy, Debug, Default)]
pub struct Contact {
    /// Force of the ground on the tyre, forward and left, N.
    pub force: [[f64; 4]; 2],
    /// −∂force/∂slip, N s/m: forward-forward, forward-left, left-left.
    pub slope: [[f64; 4]; 3],
    /// Torque on the wheel from motor, rolling resistance and ground, N m.
    pub torque: [f64; 4],
    /// −∂torque/∂speed without the tyre's part, N m s.
    pub drag: [f64; 4],
    /// Torque of the motor, N m.
    pub motor: [f64; 4],
}

/// Motion of the wheels' hubs: forward and left velocity of each contact point if it did not roll.
#[derive(Clone, Copy, Debug)]
pub struct Hub {
    /// Forward, m/s.
    pub forward: [f64; 4],
    /// Left, m/s.
    pub left: [f64; 4],
}

impl Wheels {
    /// From checked constants.
    pub fn new(config: &PlantConfig) -> Self {
        let [a, b] = config.wheel_radius_m;
        let [front, rear] = config.half_track_m;
        Self {
            friction: config.friction,
            creep: config.creep_velocity_m_s,
            excess: config.static_excess,
            decay: 1.0 / config.static_decay_m_s,
            inertia: config.wheel_inertia_kg_m2,
            rolling: config.rolling_resistance,
            stall: config.stall_torque_n_m,
            slope: config.stall_torque_n_m / config.no_load_speed_rad_s,
            limit: config.torque_limit_n_m,
            radius: [a[0], a[1], b[0], b[1]],
            arm: [-front, front, -rear, rear],
        }
    }

    /// From here on the ground exerts no force along itself.
    pub fn remove_friction(&mut self) {
        self.friction = 0.0;
    }

    /// Load of each wheel at rest for the two axle masses, N.
    pub fn static_load(mass: [f64; 2]) -> [f64; 4] {
        let [front, rear] = mass.map(|m| 0.5 * m * GRAVITY);
        [front, front, rear, rear]
    }

    /// Velocities at the wheels for body velocities (forward, left, yaw rate) of the two axles.
    #[inline(always)]
    pub fn hub(&self, body: &[[f64; 3]; 2]) -> Hub {
        let mut hub = Hub {
            forward: [0.0; 4],
            left: [0.0; 4],
        };
        for w in 0..4 {
            let v = &body[w / 2];
            hub.forward[w] = v[0] + self.arm[w] * v[2];
            hub.left[w] = v[1];
        }
        hub
    }

    /// Forces and torques. Tyre: force = −μ(|s|)·N·s/(|s| + v_eps) with slip
    /// s = (forward − r·speed, left); μ(|s|) = μ·(1 + excess·exp(−(|s|/decay)²)). Motor: the
    /// commanded torque within the speed–torque line τ_stall·(±1 − speed/no-load speed) and the
    /// current limit.
    #[inline(always)]
    pub fn contact(
        &self,
        hub: &Hub,
        speed: &[f64; 4],
        load: &[f64; 4],
        command: &[f64; 4],
    ) -> Contact {
        let mut c = Contact::default();
        for w in 0..4 {
            let sx = hub.forward[w] - self.radius[w] * speed[w];
            let sy = hub.left[w];
            let s = (sx * sx + sy * sy).sqrt();
            let grip = self.friction * load[w];
            let inverse = 1.0 / (s + self.creep);
            let f = grip * inverse;
            c.force[0][w] = -f * sx;
            c.force[1][w] = -f * sy;
            // d(f)/ds / s; the floor only matters where sx and sy vanish too.
            let h = f * inverse / (s + 1e-30);
            c.slope[0][w] = f - h * sx * sx;
            c.slope[1][w] = -h * sx * sy;
            c.slope[2][w] = f - h * sy * sy;
        }
        if self.excess > 0.0 {
            self.slip_stick(hub, speed, &mut c);
        }
        for w in 0..4 {
            let back = self.slope * speed[w];
            let (low, high) = (-self.stall - back, self.stall - back);
            let lined = command[w].max(low).min(high);
            let motor = lined.max(-self.limit).min(self.limit);
            let on_line = lined != command[w] && motor == lined;
            c.motor[w] = motor;
            c.drag[w] = if on_line { self.slope } else { 0.0 };
            c.torque[w] = motor - self.radius[w] * c.force[0][w];
        }
        if self.rolling > 0.0 {
            for w in 0..4 {
                let resist = self.rolling * load[w] * self.radius[w];
                let inverse = 1.0 / (speed[w].abs() + ROLLING_FADE);
                c.torque[w] -= resist * speed[w] * inverse;
                c.drag[w] += resist * ROLLING_FADE * inverse * inverse;
            }
        }
        c
    }

    /// The excess of static friction. Its falling part has a negative slope, which is left out of
    /// the linearisation: the solver then still meets a positive definite system.
    #[cold]
    fn slip_stick(&self, hub: &Hub, speed: &[f64; 4], c: &mut Contact) {
        for w in 0..4 {
            let sx = hub.forward[w] - self.radius[w] * speed[w];
            let sy = hub.left[w];
            let share = self.excess * libm::exp(-(sx * sx + sy * sy) * self.decay * self.decay);
            for n in 0..2 {
                c.force[n][w] *= 1.0 + share;
            }
            for n in 0..3 {
                c.slope[n][w] *= 1.0 + share;
            }
        }
    }
}

/// The wheels' part of a linearly implicit step, with the wheel speeds eliminated: the axles see
/// tyres of reduced slope.
#[derive(Clone, Copy, Debug, Default)]
pub struct Eliminated {
    /// h over the wheel's effective inertia.
    gain: [f64; 4],
    /// Reduced slope, forward-forward, forward-left, left-left.
    slope: [[f64; 4]; 3],
}

impl Wheels {
    /// Eliminates the wheel speeds for a step `h`.
    #[inline(always)]
    pub fn eliminate(&self, c: &Contact, h: f64) -> Eliminated {
        let mut e = Eliminated::default();
        for w in 0..4 {
            let r = self.radius[w];
            let own = self.inertia + h * c.drag[w];
            let inverse = 1.0 / (own + h * r * r * c.slope[0][w]);
            let keep = own * inverse;
            e.gain[w] = h * inverse;
            e.slope[0][w] = keep * c.slope[0][w];
            e.slope[1][w] = keep * c.slope[1][w];
            e.slope[2][w] = c.slope[2][w] - h * r * r * inverse * c.slope[1][w] * c.slope[1][w];
        }
        e
    }

    /// Damping matrix of each axle (forward, left, yaw; xx, xy, xφ, yy, yφ, φφ).
    #[inline(always)]
    pub fn damping(&self, e: &Eliminated) -> [[f64; 6]; 2] {
        let mut d = [[0.0; 6]; 2];
        for w in 0..4 {
            let (arm, out) = (self.arm[w], &mut d[w / 2]);
            out[0] += e.slope[0][w];
            out[1] += e.slope[1][w];
            out[2] += arm * e.slope[0][w];
            out[3] += e.slope[2][w];
            out[4] += arm * e.slope[1][w];
            out[5] += arm * arm * e.slope[0][w];
        }
        d
    }

    /// Force (forward, left) and yaw moment on each axle of the tyre forces in `now`, with what
    /// the wheels' own acceleration adds to them; `at` is the point of linearisation.
    #[inline(always)]
    pub fn load(&self, e: &Eliminated, at: &Contact, now: &Contact) -> [[f64; 3]; 2] {
        let mut sum = [[0.0; 3]; 2];
        for w in 0..4 {
            let spin = self.radius[w] * e.gain[w] * now.torque[w];
            let x = now.force[0][w] + at.slope[0][w] * spin;
            let y = now.force[1][w] + at.slope[1][w] * spin;
            let out = &mut sum[w / 2];
            out[0] += x;
            out[1] += y;
            out[2] += self.arm[w] * x;
        }
        sum
    }

    /// Change of the wheel speeds for a change `d` of the hub velocities.
    #[inline(always)]
    pub fn spin(&self, e: &Eliminated, at: &Contact, now: &Contact, d: &Hub) -> [f64; 4] {
        let mut out = [0.0; 4];
        for w in 0..4 {
            let pull = at.slope[0][w] * d.forward[w] + at.slope[1][w] * d.left[w];
            out[w] = e.gain[w] * (now.torque[w] + self.radius[w] * pull);
        }
        out
    }
}

impl Wheels {
    /// Kinetic energy of the spin of two wheels, J.
    pub fn energy(&self, speed: &[f64; 2]) -> f64 {
        0.5 * self.inertia * (speed[0] * speed[0] + speed[1] * speed[1])
    }
}
