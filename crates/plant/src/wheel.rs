//! Tyres, wheels and motors of two neighbouring axles.
//!
//! **Tyre.** Force = −μ(|s|)·N·s/(|s| + v_eps) with slip s = (forward − r·Ω, left), so that forward
//! and sideways slip share one friction circle. [`Tyre::Creep`] has a constant v_eps.
//! [`Tyre::Brush`] has v_eps = μ(0)·|r·Ω|/C, at least that of a wheel at rest: at small slip the
//! force is C·N times the slip divided by the speed of rolling, the slip stiffness of the brush model, and
//! at large slip it is μN (Pacejka, *Tire and Vehicle Dynamics*, 3rd edition, 2012, chapter 3; the
//! hyperbola between the two limits stands for the brush model's cubic, as in Dugoff, Fancher and
//! Segel, SAE 700377, 1970).
//!
//! **Stiction.** μ(|s|) = μ·(1 + excess/(1 + (|s|/decay)²)), the Stribeck curve in the form of Hess
//! and Soom (Armstrong-Hélouvry, Dupont and Canudas de Wit, *A survey of models […] of machines with
//! friction*, Automatica 30, 1994).
//!
//! **Rolling resistance.** A torque of a share of load times radius against the rolling, faded out
//! below 0.05 rad/s (Wong, *Theory of Ground Vehicles*, 4th edition, 2008, chapter 1).
//!
//! **Side slip and drift of the ground.** A wheel that rolls free of force does not move exactly ahead. It also moves
//! aside by a share of the distance rolled (toe, ply steer and conicity: Pacejka, chapter 4), and along a fixed
//! direction of the floor, the grain of a carpet (Goel, Eade, Fong and Munich, *Carpet drift estimation using
//! differential sensors or visual measurements*, US 9 223 312, 2015). The wheel's torque acts along that direction
//! too, so that contact never adds energy.
//!
//! **Rolling radius.** The radius decreases linearly with the load (Pacejka, chapter 1; Wong, chapter 1).

use super::config::{PlantConfig, Tyre};
use super::lanes::Lanes;
use super::state::AxleState;

/// Wheel speed below which rolling resistance and the drift of the ground fade, rad/s.
const ROLLING_FADE_RAD_S: f64 = 0.05;

/// Constants of the four wheels of two neighbouring axles: left and right ahead, then left and right behind. The last
/// axle of an odd number has no neighbour: two wheels without friction fill the four.
#[derive(Clone, Debug)]
pub struct Wheels {
    friction: [f64; 4],
    /// Slip velocity at which the tyre gives half its friction, per rolling speed. `creep` is the least such slip
    /// velocity, m/s.
    compliance: [f64; 4],
    creep: f64,
    /// Weight between the secant (0) and the tangent (1) of force over slip in the linearisation. The step is of second
    /// order for any weight.
    tangent: f64,
    excess: f64,
    decay: f64,
    whole_inertia: f64,
    /// Inertia that turns with each wheel, kg m².
    pub inertia: [f64; 4],
    /// 1 where a motor turns with its wheel, 0 where the teeth are apart.
    meshed: [f64; 4],
    any_disengaged: bool,
    rolling: f64,
    /// Side slip of each wheel: motion aside per motion ahead.
    side: [f64; 4],
    has_drift: bool,
    stall: f64,
    slope: f64,
    limit: f64,
    /// Radius under the present load, m.
    pub radius: [f64; 4],
    /// Measured radius, m, and load at the measurement, N.
    nominal: [[f64; 4]; 2],
    softness: f64,
    /// Forward velocity of the contact point for a unit yaw rate (−d left, +d right), m.
    pub arm: [f64; 4],
}

/// Conditions of the wheels during one part of a step.
#[derive(Clone, Copy, Debug, Default)]
pub struct Conditions {
    /// Load of each wheel, N.
    pub load: [f64; 4],
    /// Commanded torque of each wheel's motor, N m.
    pub command: [f64; 4],
    /// Cogging torque of each wheel's motor, N m.
    pub cogging: [f64; 4],
    /// Displacement by the ground per distance rolled, forward and left.
    pub drift: [[f64; 4]; 2],
}

/// Forces and torques of the wheels at one instant, and their linearisation, wheel by wheel.
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

/// Motion of the wheels' hubs: forward and left velocity that each contact point would have without wheel rotation.
#[derive(Clone, Copy, Debug)]
pub struct Hub<V> {
    /// Forward velocity, m/s.
    pub forward: V,
    /// Velocity to the left, m/s.
    pub left: V,
}

impl Wheels {
    /// Wheels of axle `first` and the axle behind it, from checked constants. The configured radii are the radii under
    /// the loads `load` (N).
    pub fn new(config: &PlantConfig, first: usize, load: [f64; 4]) -> Self {
        let last = (first + 1).min(config.axles() - 1);
        let [a, b] = [config.wheel_radius_m[first], config.wheel_radius_m[last]];
        let [front, rear] = [config.half_track_m[first], config.half_track_m[last]];
        let [ahead, behind] = [config.side_slip[first], config.side_slip[last]];
        let highest = config.friction * (1.0 + config.static_excess);
        let (compliance, creep, tangent) = match &config.tyre {
            Tyre::Creep(creep) => ([0.0; 4], creep.velocity_m_s, 1.0),
            Tyre::Brush(brush) => {
                let [c, d] = [brush.slip_stiffness[first], brush.slip_stiffness[last]];
                let stiffness = [c[0], c[1], d[0], d[1]];
                (
                    stiffness.map(|c| highest / c),
                    brush.rest_velocity_m_s,
                    // Half secant, half tangent, because a tyre that slides may stick before the step is over.
                    0.5,
                )
            }
        };
        let radius = [a[0], a[1], b[0], b[1]];
        let other = if last == first { 0.0 } else { config.friction };
        Self {
            friction: [config.friction, config.friction, other, other],
            compliance,
            creep,
            tangent,
            excess: config.static_excess,
            decay: 1.0 / config.static_decay_m_s,
            whole_inertia: config.wheel_inertia_kg_m2,
            inertia: [config.wheel_inertia_kg_m2; 4],
            meshed: [1.0; 4],
            any_disengaged: false,
            rolling: config.rolling_resistance,
            side: [ahead, ahead, behind, behind],
            has_drift: config.side_slip.entries().iter().any(|slip| *slip != 0.0)
                || config.carpet_drift != [0.0; 2],
            stall: config.stall_torque_n_m,
            slope: config.stall_torque_n_m / config.no_load_speed_rad_s,
            limit: config.torque_limit_n_m,
            radius,
            nominal: [radius, load],
            softness: config.radius_load_sensitivity,
            arm: [-front, front, -rear, rear],
        }
    }

    /// Removes the friction between this wheel and the ground.
    pub fn lift(&mut self, wheel: usize) {
        self.friction[wheel] = 0.0;
    }

    /// Sets the friction of the wheels that have friction; the slip stiffness of their tyres stays.
    pub fn set_friction(&mut self, friction: f64) {
        for (own, compliance) in self.friction.iter_mut().zip(&mut self.compliance) {
            if *own > 0.0 {
                *compliance *= friction / *own;
                *own = friction;
            }
        }
    }

    /// Removes the friction between all wheels and the ground.
    pub fn remove_friction(&mut self) {
        self.friction = [0.0; 4];
    }

    /// Separates a motor from its wheel; `rotor` is the inertia of the rotor at the wheel, kg m².
    pub fn disengage(&mut self, wheel: usize, rotor: f64) {
        self.meshed[wheel] = 0.0;
        self.inertia[wheel] = self.whole_inertia - rotor;
        self.any_disengaged = true;
    }

    /// Couples a motor to its wheel.
    pub fn engage(&mut self, wheel: usize) {
        self.meshed[wheel] = 1.0;
        self.inertia[wheel] = self.whole_inertia;
        self.any_disengaged = self.meshed != [1.0; 4];
    }

    /// True if the motor of this wheel turns with the wheel.
    #[inline(always)]
    pub fn meshed(&self, wheel: usize) -> bool {
        self.meshed[wheel] == 1.0
    }

    /// Sets the rolling radii of the wheels under the loads `load`, N.
    #[inline(always)]
    pub fn update_radii(&mut self, load: &[f64; 4]) {
        if self.softness > 0.0 {
            let [radius, nominal] = &self.nominal;
            for w in 0..4 {
                let excess = load[w] / nominal[w] - 1.0;
                self.radius[w] = radius[w] * (1.0 - self.softness * excess);
            }
        }
    }

    /// True if wheels have side slip or drift of the ground.
    #[inline(always)]
    pub fn has_drift(&self) -> bool {
        self.has_drift
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

    /// Forces and torques. Motor: the commanded torque within the speed–torque line
    /// τ_stall·(±1 − speed/no-load speed) and the current limit, plus cogging.
    #[inline(always)]
    pub fn contact<V: Lanes>(&self, hub: &Hub<V>, speed: V, c: &Conditions) -> Contact<V> {
        let (radius, load, none) = (V::load(&self.radius), V::load(&c.load), V::splat(0.0));
        let rolled = radius * speed;
        let (mut sx, mut sy) = (hub.forward - rolled, hub.left);
        // Drift and side slip of a wheel that rolls free of force, per unit of motion ahead. The linearisation leaves
        // out the slope of this motion.
        let (mut ahead, mut aside) = (none, none);
        let (fade, mut faded) = (V::splat(ROLLING_FADE_RAD_S), none);
        if self.has_drift || self.rolling > 0.0 {
            faded = V::splat(1.0) / (speed.abs() + fade);
        }
        if self.has_drift {
            let sign = speed * faded;
            ahead = sign * V::load(&c.drift[0]);
            aside = V::load(&self.side) + sign * V::load(&c.drift[1]);
            sx = sx - rolled * ahead;
            sy = sy - rolled * aside;
        }
        let s = (sx * sx + sy * sy).sqrt();
        // The linearisation leaves out the slope of this velocity with respect to the wheel speed.
        let creep = (V::load(&self.compliance) * rolled.abs()).max(V::splat(self.creep));
        let inverse = V::splat(1.0) / (s + creep);
        let f = V::load(&self.friction) * load * inverse;
        // −(df/ds)/s, weighted by `tangent`; the constant 1e-30 only matters where sx and sy vanish too.
        let h = V::splat(self.tangent) * f * inverse / (s + V::splat(1e-30));
        let mut force = [none - f * sx, none - f * sy];
        let mut slope = [f - h * sx * sx, none - h * sx * sy, f - h * sy * sy];
        if self.excess > 0.0 {
            // Stiction falls with slip. The linearisation leaves out this negative slope, so that the system stays
            // positive definite.
            let ratio = s * V::splat(self.decay);
            let share = V::splat(self.excess) / (V::splat(1.0) + ratio * ratio);
            let share = V::splat(1.0) + share;
            for n in 0..2 {
                force[n] = force[n] * share;
            }
            for n in 0..3 {
                slope[n] = slope[n] * share;
            }
        }
        let (stall, limit) = (V::splat(self.stall), V::splat(self.limit));
        let (gain, wanted) = (V::splat(self.slope), V::load(&c.command));
        let back = gain * speed;
        let lined = wanted.max(none - stall - back).min(stall - back);
        let motor = lined.max(none - limit).min(limit);
        // Slope of the speed–torque line where this line limits the torque.
        let free = gain.where_equal(lined, wanted);
        let mut drag = (gain - free).where_equal(motor, lined);
        let motor = motor + V::load(&c.cogging);
        let mut torque = motor - radius * force[0];
        if self.any_disengaged {
            let meshed = V::load(&self.meshed);
            drag = drag * meshed;
            torque = motor * meshed - radius * force[0];
        }
        if self.has_drift {
            torque = torque - radius * (ahead * force[0] + aside * force[1]);
        }
        if self.rolling > 0.0 {
            let resist = V::splat(self.rolling) * load * radius;
            torque = torque - resist * speed * faded;
            drag = drag + resist * fade * faded * faded;
        }
        Contact {
            force,
            slope,
            torque,
            drag,
            motor,
        }
    }

    /// Torque of a motor that turns apart from its wheel, N m, as in [`Self::contact`].
    pub fn motor_torque(&self, speed: f64, command: f64) -> f64 {
        let back = self.slope * speed;
        command
            .max(-self.stall - back)
            .min(self.stall - back)
            .clamp(-self.limit, self.limit)
    }
}

/// The wheels' part of a linearly implicit step. The wheel speeds are eliminated, which reduces the slope
/// of the tyres on the axles.
#[derive(Clone, Copy, Debug)]
pub struct Eliminated<V> {
    /// h divided by the wheel's effective inertia.
    gain: V,
    /// Slope of the tyre force, reduced by the elimination: forward-forward, forward-left, left-left.
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
        let own = V::load(&self.inertia) + h * c.drag;
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

    /// Force (forward, left) and yaw moment on each axle from the tyre forces in `now` and from the
    /// wheels' own acceleration; `at` is the point of linearisation.
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
    /// Kinetic energy of the spin of the wheels with their coupled rotors, J.
    pub fn energy(&self, axles: &[AxleState]) -> f64 {
        let speeds = axles.iter().flat_map(|axle| axle.wheel_speed);
        let energy = speeds
            .zip(self.inertia)
            .map(|(speed, inertia)| 0.5 * inertia * speed * speed);
        energy.sum()
    }
}

#[cfg(test)]
mod tests {
    use super::super::config::Brush;
    use super::super::lanes::Narrow;
    use super::*;

    const LOAD: f64 = 25.0;

    fn wheels(tyre: Tyre, static_excess: f64) -> Wheels {
        let config = PlantConfig {
            tyre,
            static_excess,
            ..PlantConfig::default()
        };
        Wheels::new(&config.for_axles(2).unwrap(), 0, [LOAD; 4])
    }

    fn brush() -> Tyre {
        Tyre::Brush(Brush {
            slip_stiffness: [[10.0, 20.0], [30.0, 40.0]].into(),
            ..Brush::default()
        })
    }

    /// Tyre forces of all wheels, [forward, left], at one slip velocity and speed of rolling.
    fn forces(wheels: &Wheels, slip: [f64; 2], rolling: f64) -> [[f64; 4]; 2] {
        let hub = Hub {
            forward: Narrow::splat(slip[0] + rolling),
            left: Narrow::splat(slip[1]),
        };
        let conditions = Conditions {
            load: [LOAD; 4],
            ..Conditions::default()
        };
        let speed = Narrow::splat(rolling / 0.073);
        let contact = wheels.contact(&hub, speed, &conditions);
        contact.force.map(Narrow::store)
    }

    /// Slip velocities of equal size in twelve directions, m/s.
    fn around(size: f64) -> impl Iterator<Item = [f64; 2]> {
        (0..12).map(move |k| {
            let angle = 0.3 + f64::from(k) * std::f64::consts::TAU / 12.0;
            [size * angle.cos(), size * angle.sin()]
        })
    }

    /// At large slip the forces reach the circle.
    #[test]
    fn tyre_forces_oppose_slip_within_the_friction_circle() {
        for tyre in [Tyre::default(), brush()] {
            let wheels = wheels(tyre, 0.0);
            for rolling in [-0.8, 0.0, 0.002, 0.3, 1.5] {
                for slip in [1e-6, 1e-3, 0.1, 5.0].into_iter().flat_map(around) {
                    let [fx, fy] = forces(&wheels, slip, rolling);
                    let size = slip[0].hypot(slip[1]);
                    for w in 0..4 {
                        let force = fx[w].hypot(fy[w]);
                        assert!(force < 0.7 * LOAD);
                        assert!(size < 1.0 || force > 0.95 * 0.7 * LOAD);
                        let opposing = -(fx[w] * slip[0] + fy[w] * slip[1]);
                        assert!((opposing - force * size).abs() < 1e-9 * force * size);
                    }
                }
            }
        }
    }

    /// Force per load is C times slip velocity per rolling speed, ahead and aside, with and without stiction.
    #[test]
    fn brush_tyre_has_its_slip_stiffness_at_small_slip() {
        for excess in [0.0, 0.2] {
            let wheels = wheels(brush(), excess);
            for (rolling, slip) in [(0.5f64, 1e-4), (-0.2, -1e-5)] {
                for share in [[1.0, 0.0], [0.0, 1.0], [0.6, 0.8]] {
                    let [fx, fy] = forces(&wheels, share.map(|s| s * slip * rolling), rolling);
                    for w in 0..4 {
                        let stiffness = fx[w].hypot(fy[w]) / (LOAD * slip.abs());
                        let expected = 10.0 * (w + 1) as f64;
                        assert!(
                            (stiffness / expected - 1.0).abs() < 0.01,
                            "{stiffness} {expected}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn stiction_raises_the_peak_force_and_vanishes_at_large_slip() {
        let (plain, sticky) = (wheels(brush(), 0.0), wheels(brush(), 0.2));
        let ahead = |wheels: &Wheels, slip: f64| -forces(wheels, [slip, 0.0], 0.0)[0][0];
        let peak = (1..2000)
            .map(|k| ahead(&sticky, 1e-5 * f64::from(k)))
            .fold(0.0, f64::max);
        assert!((1.13..1.2).contains(&(peak / (0.7 * LOAD))), "{peak}");
        assert!(ahead(&sticky, 2.0) / ahead(&plain, 2.0) < 1.001);
    }
}
