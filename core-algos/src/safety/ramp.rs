//! The coordinated stop: every axle slows down by the same law, with the steering held.
//!
//! With ψ̇ = 0 a midpoint speed v_O bends the frame no further if both axles drive at v_O / cos ψ and turn at κ(ψ) v_O
//! (paper eq. 5 and 6). All axles have received the same v_O and ψ. Each begins when the stop is announced or the
//! references cease, so each computes its own motion without further messages.
//!
//! Three and more axles drive at different curvatures. Each of them stops on its own last circle, with the curvature
//! ω/v of the reference that it followed ([`Ramp::begin_on_circle`]); all take the same duration.
//!
//! A bent frame at rest pushes the axles. If the motors were switched off at once, the frame would spring back and
//! swing the axles for seconds. So the holding torque fades.
//!
//! | condition | reference | from | until | reason |
//! |---|---|---|---|---|
//! | stop begins | the speed of the midpoint falls linearly to 0, with the steering held | at once | after its magnitude divided by 1 m/s², at least 0.1 s, at most the supervisor's timeout less 0.95 s | all axles follow the same law |
//! | three or more axles | speed and yaw rate of the last reference fall linearly to 0 | at once | as above | the bends of the frames differ |
//! | steering beyond 1.2 rad | as for 1.2 rad | at once | | cos ψ stays away from 0 |
//! | speed, steering, posture or derived twist not finite | standstill at the origin, for the shortest duration | at once | | the motion is unknown |
//! | at rest | full holding torque | the end of the deceleration | 0.1 s later | the axles settle together |
//! | rest over | share of the holding torque falls linearly from 1 to 0 | 0.1 s of rest | 0.75 s later | a spring released at once swings |
//! | holding torque 0 | halted | at once | for good | the motors may be switched off |
//! | interval not positive and finite | reference unchanged, no time passes | at once | the next interval | |
//!
//! Numbers are the defaults of [`Config`].

use crate::config::{Allowed, ConfigError, declare, require};
use crate::math::trig::{clamp, sin_cos};
use crate::math::{Posture, Steering, Twist};

/// Limit of the steering angle in the computation, rad: keeps cos ψ away from zero.
const STEEPEST: f32 = 1.2;

/// Margin from the end of the longest stop to the supervisor's timeout, s.
const MARGIN: f32 = 0.1;

declare! {
    /// Parameters of the stop.
    pub struct Config {
        /// Deceleration of the midpoint; higher from speeds at which the stop would exceed the supervisor's timeout.
        pub deceleration_m_s2: f32 = 1.0, "m/s²": Range(0.1, 10.0);
        /// Shortest duration of a stop, so that a slow robot does not jerk.
        pub shortest_s: f32 = 0.1, "s": Range(0.01, 1.0);
        /// Time at rest before the holding torque fades: the axles settle together.
        pub rest_s: f32 = 0.1, "s": Positive;
        /// Time in which the torque that holds the bent frame fades; then the motors are off. A spring released
        /// linearly over about one period of its oscillation comes to rest.
        pub release_s: f32 = 0.75, "s": Range(0.01, 5.0);
    }
}

impl Config {
    /// Builds the stop for a supervisor with the timeout `timeout_s`; an error names the parameter out of range.
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
            Allowed::Condition("at most stop_timeout_s - shortest_s - rest_s - 0.1 s"),
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

/// Course of a stop, with checked parameters: deceleration, rest, release of the bent frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ramp {
    deceleration: f32,
    shortest: f32,
    longest: f32,
    rest: f32,
    release: f32,
}

/// Progress of a stop.
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
    /// Posture, in the coordinates of the reference posture at the beginning of the stop.
    pub posture: Posture,
    /// Forward speed (m/s) and yaw rate (rad/s).
    pub twist: Twist,
    /// Derivatives of speed and yaw rate, m/s² and rad/s².
    pub acceleration: Twist,
    /// Permitted share of the holding torque: 1 until the time at rest is over, then falling to 0.
    pub hold: f32,
    /// True once the stop is over; the motors may then be switched off.
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
        if !psi.is_finite() {
            return self.standstill();
        }
        self.begin_on_circle(posture, speed, start)
    }

    /// Begins a stop of an axle on its last circle: the axle's reference posture is `posture` and its twist `start`,
    /// and the lead node has sent the speed `speed` (m/s), from which all axles take the same duration. Numbers that
    /// are not finite count as standstill.
    pub fn begin_on_circle(&self, posture: Posture, speed: f32, start: Twist) -> State {
        if !(posture.is_finite() && speed.is_finite() && start.is_finite()) {
            return self.standstill();
        }
        State {
            start,
            posture,
            duration: clamp(speed.abs() / self.deceleration, self.shortest, self.longest),
            elapsed: 0.0,
        }
    }

    /// A stop of an axle whose motion is unknown.
    fn standstill(&self) -> State {
        State {
            start: Twist::default(),
            posture: Posture::ORIGIN,
            duration: self.shortest,
            elapsed: 0.0,
        }
    }

    /// Reference of the axle after a further `dt` (s) of the stop.
    pub fn step(&self, state: &mut State, dt: f32) -> Reference {
        if dt > 0.0 && dt.is_finite() {
            state.elapsed += dt;
        }
        let t = state.elapsed.min(state.duration);
        let left = 1.0 - t / state.duration;
        // Integral of the falling ramp from its beginning, s.
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

    /// Two axles that stop independently keep the chord and angle of a frame bent by ψ.
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
        let (mut distance, mut middle) = (0.0, [0.0; 2]);
        for _ in 0..1200 {
            let [a, b] = states.each_mut().map(|state| ramp.step(state, 1e-3));
            let at = [a.posture.x + b.posture.x, a.posture.y + b.posture.y].map(f64::from);
            distance += (at[0] - middle[0]).hypot(at[1] - middle[1]);
            middle = at;
            let d = [a.posture.x - b.posture.x, a.posture.y - b.posture.y].map(f64::from);
            assert!((d[0].hypot(d[1]) - chord).abs() < 1e-5, "{d:?}");
            let steering = 0.5 * f64::from(a.posture.phi - b.posture.phi);
            assert!((steering - psi).abs() < 1e-5);
            assert_eq!(a.halted, b.halted);
            assert_eq!(a.hold, b.hold);
        }
        // The midpoint travels v²/(2a).
        assert!((0.5 * distance - 0.03125).abs() < 2e-4, "{distance}");
    }

    #[test]
    fn posture_and_acceleration_are_integral_and_derivative_of_twist() {
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

    /// Rows of a straight stop: time, share of the speed, share of the holding torque, end.
    #[test]
    fn stop_decelerates_rests_and_fades_on_schedule() {
        let ramp = Config::default().build(TIMEOUT).unwrap();
        for (speed, duration) in [
            (0.0, 0.1),
            (0.05, 0.1),
            (0.1, 0.1),
            (0.12, 0.12),
            (-0.25, 0.25),
            (1.04, 1.04),
            (1.05, 1.05),
            (-1.2, 1.05),
            (f32::MAX, 1.05),
        ] {
            for (t, left, hold, halted) in [
                (1e-4, 1.0 - 1e-4 / duration, 1.0, false),
                (0.5 * duration, 0.5, 1.0, false),
                (duration - 1e-4, 1e-4 / duration, 1.0, false),
                (duration + 1e-4, 0.0, 1.0, false),
                (duration + 0.0999, 0.0, 1.0, false),
                (duration + 0.1 + 0.075, 0.0, 0.9, false),
                (duration + 0.1 + 0.375, 0.0, 0.5, false),
                (duration + 0.1 + 0.7499, 0.0, 0.00013, false),
                (duration + 0.1 + 0.7501, 0.0, 0.0, true),
                (duration + 1000.0, 0.0, 0.0, true),
            ] {
                let mut state = ramp.begin(Posture::ORIGIN, speed, Steering::STRAIGHT, 0.37);
                let found = ramp.step(&mut state, t);
                let expected = Twist::new(speed * left, 0.0);
                assert!(
                    (found.twist.v - expected.v).abs() <= 1e-5 * speed.abs(),
                    "{speed} {t}"
                );
                let slowing = if t < duration { -speed / duration } else { 0.0 };
                assert!((found.acceleration.v - slowing).abs() <= 1e-5 * slowing.abs());
                assert!(
                    (found.hold - hold).abs() < 1e-5,
                    "{speed} {t}: {}",
                    found.hold
                );
                assert_eq!(found.halted, halted, "{speed} {t}");
                for interval in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, -1.0, 0.0] {
                    assert_eq!(ramp.step(&mut state, interval), found, "{interval}");
                }
            }
        }
    }

    #[test]
    fn stop_lasts_the_speed_over_the_configured_deceleration() {
        let gentle = Config {
            deceleration_m_s2: 0.5,
            ..Config::default()
        };
        let ramp = gentle.build(TIMEOUT).unwrap();
        for (t, moves) in [(0.4999, true), (0.5001, false)] {
            let mut state = ramp.begin(Posture::ORIGIN, 0.25, Steering::STRAIGHT, 0.37);
            assert_eq!(ramp.step(&mut state, t).twist.v > 0.0, moves, "{t}");
        }
    }

    #[test]
    fn axle_begins_with_its_twist_and_steep_steering_is_bounded() {
        let ramp = Config::default().build(TIMEOUT).unwrap();
        let at = Posture::new(1.0, 2.0, 0.3);
        let begin = |psi| ramp.begin(at, 0.25, Steering(psi), 0.37);
        for sign in [1.0, -1.0] {
            let twist = begin(sign * 0.4).start;
            // Speed 0.25 / cos 0.4, yaw rate 2 · 0.4 / (0.37 cos 0.4) · 0.25.
            assert!((twist.v - 0.271_426).abs() < 1e-5, "{twist:?}");
            assert!((twist.omega - sign * 0.586_867).abs() < 1e-5, "{twist:?}");
            assert_eq!(begin(sign * 1.3), begin(sign * 1.2));
            assert_ne!(begin(sign * 1.19), begin(sign * 1.2));
        }
        assert_eq!(ramp.step(&mut begin(0.4), 0.0).posture, at);
    }

    /// An axle on its own circle stops after half of speed times duration, on this circle; the duration is that of the
    /// robot's speed.
    #[test]
    fn axle_stops_on_its_last_circle_in_the_time_of_the_robot() {
        let ramp = Config::default().build(TIMEOUT).unwrap();
        for (speed, own, kappa) in [(0.2f32, 0.21, 2.4), (-0.25, -0.22, -1.3), (0.3, 0.3, 0.0)] {
            let mut state =
                ramp.begin_on_circle(Posture::ORIGIN, speed, Twist::new(own, kappa * own));
            let before = ramp.step(&mut state, 0.999 * speed.abs());
            assert!(before.twist.v != 0.0);
            assert!((before.twist.omega - kappa * before.twist.v).abs() < 1e-6);
            let end = ramp.step(&mut state, 1.0);
            let way = 0.5 * f64::from(own) * f64::from(speed.abs());
            let turn = way * f64::from(kappa);
            assert_eq!(end.twist, Twist::REST);
            assert!((f64::from(end.posture.phi) - turn).abs() < 1e-6);
            let chord = f64::from(end.posture.x).hypot(f64::from(end.posture.y));
            let expected = match turn {
                0.0 => way.abs(),
                _ => (2.0 * (0.5 * turn).sin() / f64::from(kappa)).abs(),
            };
            assert!((chord - expected).abs() < 1e-6, "{chord} {expected}");
        }
        for odd in [f32::NAN, f32::INFINITY] {
            for (speed, v, omega) in [(odd, 0.2, 0.1), (0.2, odd, 0.1), (0.2, 0.2, odd)] {
                let at = Posture::new(1.0, 2.0, 0.3);
                let mut state = ramp.begin_on_circle(at, speed, Twist::new(v, omega));
                let found = ramp.step(&mut state, 1e-3);
                assert_eq!((found.posture, found.twist), Default::default());
            }
        }
    }

    #[test]
    fn input_that_is_not_finite_gives_standstill_at_the_origin() {
        let ramp = Config::default().build(TIMEOUT).unwrap();
        let (here, nan) = (Posture::new(1.0, 2.0, 0.3), f32::NAN);
        let lost = Posture { x: nan, ..here };
        for (posture, speed, psi, length) in [
            (here, nan, 0.1, 0.37),
            (here, 0.2, nan, 0.37),
            (here, f32::INFINITY, 0.0, 0.37),
            (here, 0.2, f32::NEG_INFINITY, 0.37),
            (here, 0.2, 0.1, 0.0),
            (lost, 0.2, 0.1, 0.37),
            (lost, nan, nan, nan),
        ] {
            let mut state = ramp.begin(posture, speed, Steering(psi), length);
            for (interval, hold, halted) in [
                (0.1999, 1.0, false),
                (0.75, 0.00013, false),
                (0.0002, 0.0, true),
            ] {
                let found = ramp.step(&mut state, interval);
                assert_eq!((found.posture, found.twist), Default::default());
                assert_eq!(found.acceleration, Twist::default());
                assert!((found.hold - hold).abs() < 1e-5, "{}", found.hold);
                assert_eq!(found.halted, halted);
            }
        }
    }

    #[test]
    fn stop_longer_than_the_supervisor_timeout_is_refused() {
        // A stop needs at least 0.1 s of deceleration, 0.1 s of rest, 0.75 s of fading and 0.1 s of margin.
        for (timeout, fits) in [(1.0499, false), (1.0501, true), (f32::NAN, false)] {
            let refused = Config::default().build(timeout).err();
            let field = refused.map(|error| error.field);
            assert_eq!(field, (!fits).then_some("release_s"), "{timeout}");
        }
        crate::config::refusal_of(Config::default(), |c| c.build(TIMEOUT)).names(&[
            ("deceleration_m_s2", |c| c.deceleration_m_s2 = 0.0),
            ("shortest_s", |c| c.shortest_s = f32::NAN),
            ("rest_s", |c| c.rest_s = 0.0),
            ("release_s", |c| c.release_s = f32::INFINITY),
        ]);
    }
}
