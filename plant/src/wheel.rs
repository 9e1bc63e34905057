//! Tyres, wheels and motors of one axle.

use super::config::PlantConfig;
use super::lanes::Lanes;

/// Standard gravity, m/s².
const GRAVITY: f64 = 9.806_65;
/// Wheel speed below which rolling resistance fades, rad/s.
const ROLLING_FADE: f64 = 0.05;

/// Constants of the four wheels, in the order front left, front right, rear left, rear right.
#[derive(Clone, Debug)]
pub struct Wheels {
    friction: [f64; 4],
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

/// What the wheels do at one instant, and its linearisation, wheel by wheel.
#[derive(Clone, Copy, Debug)]
pub struct Contact<V> {
    /// Force of the ground on the tyre, forward and left, N.
    pub force: [V; 2],
    /// −∂force/∂slip, N s/m: forward-forward, forward-left, left-left.
    pub slope: [V; 3],
    /// Torque on the wheel from motor, rolling resistance and ground, N m.
    pub torque: V,
    /// −∂torque/∂speed without the tyre's part, N m s.
    pub drag: V,
    /// Torque of the motor, N m.
    pub motor: V,
}

/// Motion of the wheels' hubs: forward and left velocity of each contact point if it did not roll.
#[derive(Clone, Copy, Debug)]
pub struct Hub<V> {
    /// Forward, m/s.
    pub forward: V,
    /// Left, m/s.
    pub left: V,
}

impl Wheels {
    /// From checked constants.
    pub fn new(config: &PlantConfig) -> Self {
        let [a, b] = config.wheel_radius_m;
        let [front, rear] = config.half_track_m;
        Self {
            friction: [config.friction; 4],
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

    /// From here on the ground exerts nothing along itself on this wheel.
    pub fn lift(&mut self, wheel: usize) {
        self.friction[wheel] = 0.0;
    }

    /// From here on the ground exerts no force along itself.
    pub fn remove_friction(&mut self) {
        self.friction = [0.0; 4];
    }

    /// Load of each wheel at rest for the two axle masses, N.
    pub fn static_load(mass: [f64; 2]) -> [f64; 4] {
        let [front, rear] = mass.map(|m| 0.5 * m * GRAVITY);
        [front, front, rear, rear]
    }

    /// Velocities at the wheels for body velocities (forward, left, yaw rate) of the two axles.
    #[inline(always)]
    pub fn hub<V: Lanes>(&self, [f, r]: &[[f64; 3]; 2]) -> Hub<V> {
        let turn = V::load(&[f[2], f[2], r[2], r[2]]);
        Hub {
            forward: V::load(&[f[0], f[0], r[0], r[0]]) + V::load(&self.arm) * turn,
            left: V::load(&[f[1], f[1], r[1], r[1]]),
        }
    }

    /// Forces and torques. Tyre: force = −μ(|s|)·N·s/(|s| + v_eps) with slip
    /// s = (forward − r·speed, left); μ(|s|) = μ·(1 + excess·exp(−(|s|/decay)²)). Motor: the
    /// commanded torque within the speed–torque line τ_stall·(±1 − speed/no-load speed) and the
    /// current limit.
    #[inline(always)]
    pub fn contact<V: Lanes>(
        &self,
        hub: &Hub<V>,
        speed: V,
        load: &[f64; 4],
        command: &[f64; 4],
    ) -> Contact<V> {
        let (radius, load, none) = (V::load(&self.radius), V::load(load), V::splat(0.0));
        let (sx, sy) = (hub.forward - radius * speed, hub.left);
        let s = (sx * sx + sy * sy).sqrt();
        let inverse = V::splat(1.0) / (s + V::splat(self.creep));
        let f = V::load(&self.friction) * load * inverse;
        // d(f)/ds / s; the floor only matters where sx and sy vanish too.
        let h = f * inverse / (s + V::splat(1e-30));
        let mut force = [none - f * sx, none - f * sy];
        let mut slope = [f - h * sx * sx, none - h * sx * sy, f - h * sy * sy];
        if self.excess > 0.0 {
            let share = V::load(&self.slip_stick(sx.store(), sy.store()));
            for n in 0..2 {
                force[n] = force[n] * share;
            }
            for n in 0..3 {
                slope[n] = slope[n] * share;
            }
        }
        let (stall, limit) = (V::splat(self.stall), V::splat(self.limit));
        let (gain, wanted) = (V::splat(self.slope), V::load(command));
        let back = gain * speed;
        let lined = wanted.max(none - stall - back).min(stall - back);
        let motor = lined.max(none - limit).min(limit);
        // The slope of the speed–torque line where that is what limits the torque.
        let free = gain.where_equal(lined, wanted);
        let mut drag = (gain - free).where_equal(motor, lined);
        let mut torque = motor - radius * force[0];
        if self.rolling > 0.0 {
            let resist = V::splat(self.rolling) * load * radius;
            let fade = V::splat(ROLLING_FADE);
            let inverse = V::splat(1.0) / (speed.abs() + fade);
            torque = torque - resist * speed * inverse;
            drag = drag + resist * fade * inverse * inverse;
        }
        Contact {
            force,
            slope,
            torque,
            drag,
            motor,
        }
    }

    /// The excess of static friction, as a factor of force and slope. Its falling part has a
    /// negative slope, which is left out of the linearisation: the solver then still meets a
    /// positive definite system.
    #[cold]
    #[inline(never)]
    fn slip_stick(&self, sx: [f64; 4], sy: [f64; 4]) -> [f64; 4] {
        let mut share = [1.0; 4];
        for w in 0..4 {
            let square = sx[w] * sx[w] + sy[w] * sy[w];
            share[w] += self.excess * libm::exp(-square * self.decay * self.decay);
        }
        share
    }
}

/// The wheels' part of a linearly implicit step, with the wheel speeds eliminated: the axles see
/// tyres of reduced slope.
#[derive(Clone, Copy, Debug)]
pub struct Eliminated<V> {
    /// h over the wheel's effective inertia.
    gain: V,
    /// Reduced slope, forward-forward, forward-left, left-left.
    slope: [V; 3],
}

/// Sums over the two wheels of each axle of four quantities: `[axle][quantity]`.
#[inline(always)]
fn axles<V: Lanes>(v: [V; 4]) -> [[f64; 4]; 2] {
    let [a, b, c, d] = V::transposed(v);
    [(a + b).store(), (c + d).store()]
}

impl Wheels {
    /// Eliminates the wheel speeds for a step `h`.
    #[inline(always)]
    pub fn eliminate<V: Lanes>(&self, c: &Contact<V>, h: f64) -> Eliminated<V> {
        let (r, h) = (V::load(&self.radius), V::splat(h));
        let lever = h * r * r;
        let own = V::splat(self.inertia) + h * c.drag;
        let inverse = V::splat(1.0) / (own + lever * c.slope[0]);
        let keep = own * inverse;
        Eliminated {
            gain: h * inverse,
            slope: [
                keep * c.slope[0],
                keep * c.slope[1],
                c.slope[2] - lever * inverse * c.slope[1] * c.slope[1],
            ],
        }
    }

    /// Damping matrix of each axle (forward, left, yaw; xx, xy, xφ, yy, yφ, φφ).
    #[inline(always)]
    pub fn damping<V: Lanes>(&self, e: &Eliminated<V>) -> [[f64; 6]; 2] {
        let (arm, none) = (V::load(&self.arm), V::splat(0.0));
        let [xx, xy, yy] = e.slope;
        let turn = arm * xx;
        let [f, r] = axles([xx, xy, turn, yy]);
        let [g, s] = axles([arm * xy, arm * turn, none, none]);
        [
            [f[0], f[1], f[2], f[3], g[0], g[1]],
            [r[0], r[1], r[2], r[3], s[0], s[1]],
        ]
    }

    /// Force (forward, left) and yaw moment on each axle of the tyre forces in `now`, with what
    /// the wheels' own acceleration adds to them; `at` is the point of linearisation.
    #[inline(always)]
    pub fn load<V: Lanes>(
        &self,
        e: &Eliminated<V>,
        at: &Contact<V>,
        now: &Contact<V>,
    ) -> [[f64; 3]; 2] {
        let spin = V::load(&self.radius) * e.gain * now.torque;
        let x = now.force[0] + at.slope[0] * spin;
        let y = now.force[1] + at.slope[1] * spin;
        let [f, r] = axles([x, y, V::load(&self.arm) * x, V::splat(0.0)]);
        [[f[0], f[1], f[2]], [r[0], r[1], r[2]]]
    }

    /// Change of the wheel speeds for a change `d` of the hub velocities.
    #[inline(always)]
    pub fn spin<V: Lanes>(
        &self,
        e: &Eliminated<V>,
        at: &Contact<V>,
        now: &Contact<V>,
        d: &Hub<V>,
    ) -> V {
        let pull = at.slope[0] * d.forward + at.slope[1] * d.left;
        e.gain * (now.torque + V::load(&self.radius) * pull)
    }
}

impl Wheels {
    /// Kinetic energy of the spin of two wheels, J.
    pub fn energy(&self, speed: &[f64; 2]) -> f64 {
        0.5 * self.inertia * (speed[0] * speed[0] + speed[1] * speed[1])
    }
}
