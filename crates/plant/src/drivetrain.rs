//! Drivetrain between a motor and its wheel: backlash of the gears, and cogging.
//!
//! **Backlash.** Motor shaft and wheel turn together while the teeth of a flank press on each
//! other, and apart within the backlash (dead-zone model with inelastic flanks: Nordin and Gutman,
//! *Controlling mechanical systems with backlash: a survey*, Automatica 38, 2002). The teeth transmit
//! the motor's torque minus the inertial torque of the rotor. When the teeth would have to pull, they
//! separate. The encoder is on the motor.
//!
//! **Cogging.** A torque that is periodic in the motor's angle, of mean zero (Hanselman, *Brushless
//! Permanent Magnet Motor Design*, 2nd edition, 2003). Each part of a step takes the mean over the
//! angle turned in the part, so that cogging faster than the steps averages out instead of appearing
//! at another frequency.

use super::config::PlantConfig;
use super::lanes::Lanes;
use super::sincos::directions;
use super::state::AxleState;
use super::wheel::{Conditions, Wheels};

/// Gears of the four wheels of two neighbouring axles, in the order of [`Wheels`].
#[derive(Clone, Debug)]
pub struct Drivetrain {
    /// Half of the backlash, rad at the wheel.
    half_backlash: [f64; 4],
    has_backlash: bool,
    /// Inertia of a rotor, at the wheel, kg m².
    rotor: f64,
    cogging: f64,
    periods: f64,
    phase: [f64; 4],
    /// Angle of the motor minus angle of the wheel, rad at the wheel.
    gap: [f64; 4],
    /// Speed of the motor, rad/s at the wheel.
    speed: [f64; 4],
}

impl Drivetrain {
    /// Gears of axle `first` and the axle behind it, from checked constants.
    pub fn new(config: &PlantConfig, first: usize) -> Self {
        let last = (first + 1).min(config.axles() - 1);
        let [[a, b], [c, d]] = [config.backlash_rad[first], config.backlash_rad[last]];
        let phase = &config.cogging_phase_rad;
        let [[e, f], [g, h]] = [phase[first], phase[last]];
        // A missing second axle gets no backlash: with backlash the group would take the slower code.
        let half = if last == first { 0.0 } else { 0.5 };
        let half_backlash = [0.5 * a, 0.5 * b, half * c, half * d];
        Self {
            half_backlash,
            has_backlash: half_backlash != [0.0; 4],
            rotor: config.rotor_inertia_share * config.wheel_inertia_kg_m2,
            cogging: config.cogging_torque_n_m,
            periods: config.cogging_periods,
            phase: [e, f, g, h],
            gap: [0.0; 4],
            speed: [0.0; 4],
        }
    }

    /// Sets the gears to rest, each motor in the middle of its backlash.
    pub fn place(&mut self, wheels: &mut Wheels) {
        (self.gap, self.speed) = ([0.0; 4], [0.0; 4]);
        for w in 0..4 {
            if self.half_backlash[w] > 0.0 {
                wheels.disengage(w, self.rotor);
            }
        }
    }

    /// True if any gear has backlash.
    #[inline(always)]
    pub fn has_backlash(&self) -> bool {
        self.has_backlash
    }

    /// True if the motors cog.
    #[inline(always)]
    pub fn cogs(&self) -> bool {
        self.cogging > 0.0
    }

    /// Mean of the cogging torque over the next `h` (s), N m at the wheel.
    #[inline(always)]
    pub fn cogging<V: Lanes>(&self, axle: &[AxleState], h: f64) -> [f64; 4] {
        let (mut half, mut middle) = ([0.0; 4], [0.0; 4]);
        for w in 0..2 * axle.len() {
            let (angle, speed) = self.motor(axle, w);
            half[w] = 0.5 * self.periods * h * speed;
            middle[w] = self.periods * angle + half[w] + self.phase[w];
        }
        // Factor of the mean over the turned angle: sin(x)/x.
        let x = V::load(&half);
        let share = if x.abs().all_at_most(0.5) {
            let (z, one) = (x * x, V::splat(1.0));
            let rest = one - z * V::splat(1.0 / 42.0);
            one - z * V::splat(1.0 / 6.0) * (one - z * V::splat(0.05) * rest)
        } else {
            let x = x + V::splat(1e-30);
            directions(x).0 / x
        };
        let (wave, _) = directions(V::load(&middle));
        (V::splat(self.cogging) * share * wave).store()
    }

    /// Angle and speed of a motor, at the wheel.
    #[inline(always)]
    fn motor(&self, axle: &[AxleState], w: usize) -> (f64, f64) {
        let (axle, side) = (&axle[w / 2], w % 2);
        let speed = if self.half_backlash[w] > 0.0 {
            self.speed[w]
        } else {
            axle.wheel_speed[side]
        };
        (axle.wheel_angle[side] + self.gap[w], speed)
    }

    /// Separates or engages teeth after a part `h` (s) of a step; `before` holds the wheel speeds at the start of the
    /// part.
    #[cold]
    pub fn mesh(
        &mut self,
        wheels: &mut Wheels,
        axle: &mut [AxleState],
        c: &Conditions,
        (before, h): ([f64; 4], f64),
    ) {
        for w in 0..2 * axle.len() {
            if self.half_backlash[w] == 0.0 {
                continue;
            }
            let (axle, side) = (&mut axle[w / 2], w % 2);
            let now = axle.wheel_speed[side];
            if wheels.meshed(w) {
                let passed = axle.torque[side] - self.rotor * (now - before[w]) / h;
                self.speed[w] = now;
                if passed * self.gap[w] < 0.0 {
                    wheels.disengage(w, self.rotor);
                }
                continue;
            }
            let was = self.speed[w];
            let driving = wheels.motor_torque(was, c.command[w]) + c.cogging[w];
            let spun = was + h * driving / self.rotor;
            axle.torque[side] = driving;
            self.gap[w] += 0.5 * h * (was + spun - before[w] - now);
            self.speed[w] = spun;
            if self.gap[w].abs() >= self.half_backlash[w] {
                self.gap[w] = self.half_backlash[w].copysign(self.gap[w]);
                let wheel = wheels.inertia[w];
                wheels.engage(w);
                let common = (self.rotor * spun + wheel * now) / wheels.inertia[w];
                (self.speed[w], axle.wheel_speed[side]) = (common, common);
            }
        }
    }

    /// Writes angles and speeds of the motors to the states of the axles.
    #[inline(always)]
    pub fn publish(&self, axle: &mut [AxleState]) {
        for w in 0..2 * axle.len() {
            let (angle, speed) = self.motor(axle, w);
            axle[w / 2].motor_angle[w % 2] = angle;
            axle[w / 2].motor_speed[w % 2] = speed;
        }
    }

    /// Kinetic energy of the rotors whose teeth are separated, J.
    pub fn energy(&self, wheels: &Wheels) -> f64 {
        (0..4)
            .filter(|w| !wheels.meshed(*w))
            .map(|w| 0.5 * self.rotor * self.speed[w] * self.speed[w])
            .sum()
    }
}
