//! The coordinated stop: every axle slows down by the same law, with the steering held.
//!
//! With ψ̇ = 0 a midpoint speed v_O bends the frame no further when both axles drive at
//! v_O / cos ψ and turn at κ(ψ) v_O (paper eq. 5 and 6). All axles heard the same broadcast of v_O
//! and ψ, and every one of them begins when the stop is announced or the references cease, so each
//! can compute its own share without hearing from the others again.
//!
//! A frame that is bent at rest pushes the axles: with the motors off at once it would spring back and
//! swing them about for seconds. So the torque that holds it is let go gradually.

use crate::config::{Allowed, ConfigError, config, require};
use crate::math::trig::{clamp, sin_cos};
use crate::math::{Posture, Steering, Twist};

/// Steering angle beyond which the paths of the axles are not told apart, rad: cos ψ stays away
/// from zero.
const STEEPEST: f32 = 1.2;

/// Time by which a stop is over before the supervisor would end it, s.
const MARGIN: f32 = 0.1;

config! {
    /// Parameters of the stop.
    pub struct Config {
        /// Deceleration of the midpoint, m/s²; more from a speed at which the stop would outlast the
        /// supervisor's patience.
        pub deceleration_m_s2: f32 = 1.0, Range(0.1, 10.0);
        /// Shortest duration of a stop, s: a slow robot is not jerked to rest.
        pub shortest_s: f32 = 0.1, Range(0.01, 1.0);
        /// Time at rest before the frame is let go, s: the axles settle together.
        pub rest_s: f32 = 0.1, Positive;
        /// Time in which the torque that holds the bent frame fades, s; then the motors are off. Over
        /// about a period of its swing a spring that is let go evenly does not swing on.
        pub release_s: f32 = 0.75, Range(0.01, 5.0);
    }
}

impl Config {
    /// The ready form of a stop that the supervisor waits `timeout_s` for; an error names the
    /// parameter out of range.
    pub fn build(&self, timeout_s: f32) -> Result<Ramp, ConfigError> {
        self.check_ranges()?;
        let shortest = self.shortest_s;
        let rest = self.rest_s;
        let release = self.release_s;
        let longest = timeout_s - MARGIN - rest - release;
        require(
            longest >= shortest,
            "release_s",
            self.release_s,
            Allowed::Condition("with shortest_s, rest_s and 0.1 s at most stop_timeout_s"),
        )?;
        Ok(Ramp {
            deceleration: self.deceleration_m_s2,
            shortest,
            longest,
            rest,
            release,
        })
    }
}

/// The stop, ready to run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ramp {
    deceleration: f32,
    shortest: f32,
    longest: f32,
    rest: f32,
    release: f32,
}

/// A stop under way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct State {
    /// Twist of the axle when the stop began.
    start: Twist,
    /// Reference posture when the stop began.
    posture: Posture,
    /// Duration of the deceleration, s.
    duration: f32,
    /// Time since the stop began, s.
    elapsed: f32,
}

/// The reference of an axle during the stop.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reference {
    /// Posture, in the frame of the reference that the stop began at.
    pub posture: Posture,
    /// Forward speed (m/s) and yaw rate (rad/s).
    pub twist: Twist,
    /// Their derivatives, m/s² and rad/s².
    pub acceleration: Twist,
    /// Share of the torque that held the axle at rest that it may still use: 1 until the time at
    /// rest is over, then falling to 0.
    pub hold: f32,
    /// The stop is over: the motors may be switched off.
    pub halted: bool,
}

impl Ramp {
    /// Begins a stop of an axle whose reference posture is `posture`, of a robot whose midpoint
    /// drives at `speed` (m/s) with the steering angle `psi` on a frame of `length` (m).
    /// Numbers that are not finite count as standstill.
    pub fn begin(
        &self,
        posture: Posture,
        speed: f32,
        Steering(psi): Steering,
        length: f32,
    ) -> State {
        let within = clamp(psi, -STEEPEST, STEEPEST);
        let (_, c) = sin_cos(within);
        let start = Twist::new(speed / c, 2.0 * within / (length * c) * speed);
        if !(posture.is_finite() && psi.is_finite() && start.is_finite()) {
            return State {
                start: Twist::default(),
                posture: Posture::ORIGIN,
                duration: self.shortest,
                elapsed: 0.0,
            };
        }
        State {
            start,
            posture,
            duration: clamp(speed.abs() / self.deceleration, self.shortest, self.longest),
            elapsed: 0.0,
        }
    }

    /// The reference `dt` (s) later.
    pub fn step(&self, state: &mut State, dt: f32) -> Reference {
        if dt > 0.0 && dt.is_finite() {
            state.elapsed += dt;
        }
        let t = state.elapsed.min(state.duration);
        let left = 1.0 - t / state.duration;
        // ∫ of the falling ramp from its beginning.
        let share = t * (1.0 - 0.5 * t / state.duration);
        let Twist { v, omega } = state.start;
        let slowing = if state.elapsed < state.duration {
            -1.0 / state.duration
        } else {
            0.0
        };
        let rested = state.duration + self.rest;
        Reference {
            posture: state.posture.advance(v * share, omega * share),
            twist: Twist::new(v * left, omega * left),
            acceleration: Twist::new(v * slowing, omega * slowing),
            hold: clamp(1.0 - (state.elapsed - rested) / self.release, 0.0, 1.0),
            halted: state.elapsed >= rested + self.release,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TIMEOUT: f32 = 2.0;

    /// Two axles that stop by themselves end where a frame bent by the same ψ holds them.
    #[test]
    fn the_frame_keeps_its_bend_through_the_stop() {
        let (length, psi, speed) = (0.37f64, 0.4f64, 0.25f64);
        let chord = length * psi.sin() / psi;
        let ramp = Config::default().build(TIMEOUT).unwrap();
        // The midpoint at the origin, heading along x.
        let front = Posture::new(0.5 * chord as f32, 0.0, psi as f32);
        let rear = Posture::new(-0.5 * chord as f32, 0.0, -psi as f32);
        let mut states =
            [front, rear].map(|p| ramp.begin(p, speed as f32, Steering(psi as f32), length as f32));
        let mut halted = 0;
        let mut holding = 0;
        let mut half_let_go = 0;
        let (mut way, mut middle) = (0.0, [0.0; 2]);
        for _ in 0..1200 {
            let [a, b] = states.each_mut().map(|state| ramp.step(state, 1e-3));
            let at = [a.posture.x + b.posture.x, a.posture.y + b.posture.y].map(f64::from);
            way += (at[0] - middle[0]).hypot(at[1] - middle[1]);
            middle = at;
            let d = [a.posture.x - b.posture.x, a.posture.y - b.posture.y].map(f64::from);
            assert!((d[0].hypot(d[1]) - chord).abs() < 1e-5, "{d:?}");
            let steering = 0.5 * f64::from(a.posture.phi - b.posture.phi);
            assert!((steering - psi).abs() < 1e-5);
            assert_eq!(a.halted, b.halted);
            assert_eq!(a.hold, b.hold);
            holding += usize::from(a.hold == 1.0);
            half_let_go += usize::from(a.hold >= 0.5);
            halted += usize::from(a.halted);
        }
        // 0.25 s to slow down at 1 m/s², 0.1 s of rest, 0.75 s to let go.
        assert!((349..=351).contains(&holding), "{holding}");
        assert!((99..=102).contains(&halted), "{halted}");
        assert!((723..=727).contains(&half_let_go), "{half_let_go}");
        // The midpoint goes v²/(2a).
        assert!((0.5 * way - 0.03125).abs() < 2e-4, "{way}");
    }

    /// The reference is its own integral and derivative.
    #[test]
    fn posture_twist_and_acceleration_belong_together() {
        let ramp = Config::default().build(TIMEOUT).unwrap();
        let mut state = ramp.begin(Posture::new(1.0, 2.0, 0.3), 0.2, Steering(-0.3), 0.37);
        let dt = 1e-3f64;
        let mut last = ramp.step(&mut state, dt as f32);
        for _ in 0..190 {
            let next = ramp.step(&mut state, dt as f32);
            let [dx, dy, turn] = next.posture.minus(last.posture).map(f64::from);
            let v = 0.5 * f64::from(next.twist.v + last.twist.v);
            let omega = 0.5 * f64::from(next.twist.omega + last.twist.omega);
            assert!((dx.hypot(dy) - v.abs() * dt).abs() < 3e-7);
            assert!((turn - omega * dt).abs() < 3e-7);
            let dv = f64::from(next.twist.v - last.twist.v);
            assert!((dv - f64::from(last.acceleration.v) * dt).abs() < 3e-7);
            let change = f64::from(next.twist.omega - last.twist.omega);
            assert!((change - f64::from(last.acceleration.omega) * dt).abs() < 3e-7);
            last = next;
        }
    }

    #[test]
    fn what_is_not_finite_is_standstill() {
        let ramp = Config::default().build(TIMEOUT).unwrap();
        for (speed, psi) in [(f32::NAN, 0.1), (0.2, f32::NAN), (f32::INFINITY, 0.0)] {
            let mut state = ramp.begin(Posture::ORIGIN, speed, Steering(psi), 0.37);
            for interval in [f32::NAN, f32::INFINITY, -1.0] {
                let reference = ramp.step(&mut state, interval);
                assert_eq!((reference.twist, reference.hold), (Twist::default(), 1.0));
                assert!(!reference.halted && state.elapsed == 0.0);
            }
            for _ in 0..1000 {
                ramp.step(&mut state, 1e-3);
            }
            assert!(ramp.step(&mut state, 1e-3).halted);
        }
    }

    /// Whatever the speed, the supervisor does not have to cut the stop short.
    #[test]
    fn every_stop_ends_before_the_supervisor_loses_patience() {
        let ramp = Config::default().build(TIMEOUT).unwrap();
        for speed in [0.0, 0.3, -0.9, 1.5, 50.0, f32::MAX] {
            let mut state = ramp.begin(Posture::ORIGIN, speed, Steering(0.2), 0.37);
            let ticks = (1..5_000)
                .find(|_| ramp.step(&mut state, 1e-3).halted)
                .unwrap();
            assert!(ticks <= 1_901, "{speed}: {ticks}");
        }
        let slow = Config {
            release_s: 1.9,
            ..Config::default()
        };
        assert_eq!(slow.build(TIMEOUT).unwrap_err().field, "release_s");
        assert!(slow.build(2.5).is_ok());
        assert!(Config::default().build(f32::NAN).is_err());
    }
}
