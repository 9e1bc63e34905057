//! Incremental encoder: lines of a disc on a wheel as two square waves a quarter period apart.
//!
//! After the data sheets of optical encoders as the Broadcom HEDS-5540 (500 lines) and its kin with
//! 2048 lines on the shaft. Turning forward A leads B: a timer in encoder mode counts up.
//!
//! The wheel's angle is a parabola of time between two calls of [`Encoder::motion`]; the instant at
//! which it meets the next edge of a line is the root of a quadratic equation, so no time is stepped.

use super::{later, span_s};
use crate::chip::Drive;
use crate::time::Time;
use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::ops::Range;

/// Edges that are late because the angle was corrected follow each other so closely, ps: 100 ns.
const CATCH_UP: Time = Time::from_nanos(100);

/// What drives the two lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutputStage {
    /// Both levels strongly.
    PushPull,
    /// Low strongly, high not at all: somebody else's resistor pulls up.
    OpenCollector,
}

/// An encoder.
#[derive(Clone, Debug, PartialEq)]
pub struct EncoderConfig {
    /// Lines of the disc; four counts each. Default 2048.
    pub lines: u32,
    /// Angle of the disc, counts, at the wheel's angle 0. From 0 to less than 1 it decides where in
    /// the first count the wheel stands.
    pub phase: f64,
    /// What drives the lines.
    pub output: OutputStage,
}

impl Default for EncoderConfig {
    fn default() -> Self {
        Self {
            lines: 2048,
            phase: 0.5,
            output: OutputStage::PushPull,
        }
    }
}

/// One of the two lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line {
    /// Leads when turning forward.
    A,
    /// Lags.
    B,
}

/// What can be wrong with it. Several may be at once.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct EncoderFault {
    /// A stands at this level.
    pub stuck_a: Option<bool>,
    /// B stands at this level.
    pub stuck_b: Option<bool>,
    /// The lines are swapped.
    pub swapped: bool,
    /// Lines of the disc that are covered: both outputs low there.
    pub missing: Range<u32>,
}

/// A disturbance of a line: its level is the other one.
#[derive(Clone, Copy, Debug)]
struct Glitch {
    line: Line,
    from: Time,
    to: Time,
}

/// An encoder on a wheel.
#[derive(Clone, Debug)]
pub struct Encoder {
    config: EncoderConfig,
    fault: EncoderFault,
    /// Counts per radian.
    scale: f64,
    /// The motion: since when, counts, counts/s, counts/s².
    from: Time,
    position: f64,
    speed: f64,
    acceleration: f64,
    /// The wheel stands in the count from this number to the next.
    count: i64,
    /// When the count changes next, and to what.
    edge: (Time, i64),
    glitches: VecDeque<Glitch>,
    now: Time,
}

impl Encoder {
    /// At rest at angle 0.
    pub fn new(config: EncoderConfig) -> Self {
        let phase = config.phase;
        Self {
            scale: f64::from(config.lines) * 4.0 / TAU,
            config,
            fault: EncoderFault::default(),
            from: Time(0),
            position: phase,
            speed: 0.0,
            acceleration: 0.0,
            count: phase.floor() as i64,
            edge: (Time::NEVER, 0),
            glitches: VecDeque::new(),
            now: Time(0),
        }
    }

    /// From now on the wheel's angle (rad) moves on from here with this speed (rad/s) and acceleration
    /// (rad/s²). Where this is not where the last motion ended, the edges in between follow at once,
    /// 100 ns apart.
    pub fn motion(&mut self, at: Time, angle_rad: f64, speed_rad_s: f64, acceleration_rad_s2: f64) {
        self.advance(at);
        self.from = at;
        self.position = angle_rad * self.scale + self.config.phase;
        self.speed = speed_rad_s * self.scale;
        self.acceleration = acceleration_rad_s2 * self.scale;
        self.find_edge();
    }

    /// Breaks it, or mends it.
    pub fn set_fault(&mut self, fault: EncoderFault) {
        self.fault = fault;
    }

    /// Disturbs a line for a time (200 ns, say). Disturbances are told in the order of time.
    pub fn glitch(&mut self, line: Line, from: Time, width: Time) {
        let to = from + width;
        self.glitches.push_back(Glitch { line, from, to });
    }

    /// Counts from the angle 0 of the disc: what a perfect counter would have.
    pub fn count(&self) -> i64 {
        self.count
    }

    /// When a level changes next, as far as it is known now.
    pub fn next(&self) -> Time {
        let glitch = self.glitches.iter().fold(Time::NEVER, |next, g| {
            let due = if g.from > self.now { g.from } else { g.to };
            next.min(due)
        });
        self.edge.0.min(glitch)
    }

    /// Goes on until a time.
    pub fn advance(&mut self, to: Time) {
        while self.edge.0 <= to {
            self.now = self.edge.0;
            self.count = self.edge.1;
            self.find_edge();
        }
        self.now = self.now.max(to);
        while self.glitches.front().is_some_and(|g| g.to <= to) {
            self.glitches.pop_front();
        }
    }

    /// Levels of A and B at the time of the latest call.
    pub fn levels(&self) -> (bool, bool) {
        let quarter = self.count.rem_euclid(4);
        let line = self
            .count
            .div_euclid(4)
            .rem_euclid(self.config.lines.into());
        let covered = self.fault.missing.contains(&(line as u32));
        let mut a = !covered && matches!(quarter, 1 | 2);
        let mut b = !covered && matches!(quarter, 2 | 3);
        if self.fault.swapped {
            (a, b) = (b, a);
        }
        for glitch in &self.glitches {
            if glitch.from <= self.now && self.now < glitch.to {
                match glitch.line {
                    Line::A => a = !a,
                    Line::B => b = !b,
                }
            }
        }
        (
            self.fault.stuck_a.unwrap_or(a),
            self.fault.stuck_b.unwrap_or(b),
        )
    }

    /// How A and B are driven.
    pub fn drives(&self) -> (Drive, Drive) {
        let drive = |level| match self.config.output {
            OutputStage::OpenCollector if level => Drive::Open,
            _ => Drive::to(level),
        };
        let (a, b) = self.levels();
        (drive(a), drive(b))
    }

    /// Finds the next change of the count after now.
    fn find_edge(&mut self) {
        let t = span_s(self.from, self.now);
        let speed = self.speed + self.acceleration * t;
        let position = self.position + (self.speed + 0.5 * self.acceleration * t) * t;
        // Distances to the two edges between which the count stands.
        let up = (self.count + 1) as f64 - position;
        let down = self.count as f64 - position;
        // A wheel that has just passed an edge stands on it, but for rounding.
        const ROUNDING: f64 = 1e-6;
        self.edge = if up < -ROUNDING {
            (self.now + CATCH_UP, self.count + 1)
        } else if down > ROUNDING {
            (self.now + CATCH_UP, self.count - 1)
        } else {
            // The edge ahead, unless the wheel turns round before it.
            let (ahead, behind) = ((up.max(0.0), 1), (-down.min(0.0), -1));
            let (ahead, behind) = if speed >= 0.0 {
                (ahead, behind)
            } else {
                (behind, ahead)
            };
            let mut found = (self.reach(ahead, speed), ahead.1);
            if found.0 == f64::INFINITY {
                found = (self.reach(behind, speed), behind.1);
            }
            (later(self.now, found.0) + Time(1), self.count + found.1)
        };
    }

    /// When the wheel has gone a distance (counts, not negative) in a direction (1 or −1), s from now;
    /// infinite if never.
    fn reach(&self, (distance, direction): (f64, i64), speed: f64) -> f64 {
        // Seen so that the direction is positive.
        let sign = direction as f64;
        let (d, v, a) = (distance, sign * speed, sign * self.acceleration);
        let square = v * v + 2.0 * a * d;
        if square < 0.0 || (v <= 0.0 && a <= 0.0) {
            return f64::INFINITY;
        }
        let root = square.sqrt();
        if v >= 0.0 {
            // Also at a = 0, and without cancellation.
            if d == 0.0 { 0.0 } else { 2.0 * d / (v + root) }
        } else {
            // It turns round first.
            (root - v) / a
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000_000;

    /// Counts of a decoder that sees nothing but the levels.
    #[derive(Default)]
    struct Decoder {
        last: (bool, bool),
        count: i64,
        jumps: u32,
    }

    impl Decoder {
        fn see(&mut self, levels: (bool, bool)) {
            let place = |(a, b): (bool, bool)| (i64::from(a) ^ i64::from(b)) + 2 * i64::from(b);
            match (place(levels) - place(self.last)).rem_euclid(4) {
                1 => self.count += 1,
                3 => self.count -= 1,
                2 => self.jumps += 1,
                _ => {}
            }
            self.last = levels;
        }

        fn run(&mut self, encoder: &mut Encoder, to: Time) -> u32 {
            let mut edges = 0;
            while encoder.next() <= to {
                encoder.advance(encoder.next());
                self.see(encoder.levels());
                edges += 1;
            }
            encoder.advance(to);
            edges
        }
    }

    #[test]
    fn edges_come_when_the_angle_meets_them() {
        let mut encoder = Encoder::new(EncoderConfig::default());
        // One revolution in 1/8.192 s is 67.1 edges a millisecond; the first after half a count.
        let speed = TAU * 8.192;
        encoder.motion(Time(0), 0.0, speed, 0.0);
        let period = 1e12 / (8192.0 * 8.192);
        for k in 0..1000 {
            let expected = period * (f64::from(k) + 0.5);
            let found = encoder.next();
            assert!((found.0 as f64 - expected).abs() < 1000.0, "{k} {found:?}");
            encoder.advance(found);
            assert_eq!(encoder.count(), i64::from(k) + 1);
        }
    }

    #[test]
    fn a_decoder_follows_every_motion() {
        let mut encoder = Encoder::new(EncoderConfig::default());
        let mut decoder = Decoder::default();
        // Forward, through standstill and back, in millisecond pieces with rounded states.
        let angle = |t: f64| 3.0 * t - 4.0 * t * t + 0.3 * (20.0 * t).sin();
        let speed = |t: f64| 3.0 - 8.0 * t + 6.0 * (20.0 * t).cos();
        let mut edges = 0;
        for k in 0..1000u64 {
            let t = k as f64 * 1e-3;
            let acceleration = (speed(t + 1e-3) - speed(t)) / 1e-3;
            encoder.motion(Time(k * MS), angle(t), speed(t), acceleration);
            edges += decoder.run(&mut encoder, Time((k + 1) * MS));
            let ideal = (angle(t + 1e-3) * 8192.0 / TAU + 0.5).floor() as i64;
            assert_eq!(decoder.count, encoder.count());
            assert!((decoder.count - ideal).abs() <= 1, "{k}");
        }
        assert_eq!(decoder.jumps, 0);
        // As many edges as the way is long, but for a few at each turn and rounding.
        let way: f64 = (0..100_000)
            .map(|k| speed(f64::from(k) * 1e-5).abs() * 1e-5)
            .sum();
        let expected = way * 8192.0 / TAU;
        assert!(
            (f64::from(edges) - expected).abs() < 30.0,
            "{edges} {expected}"
        );
    }

    #[test]
    fn a_wheel_that_turns_round_between_two_edges_makes_none() {
        let mut encoder = Encoder::new(EncoderConfig::default());
        // Up by 0.4 counts and back by 0.6: the lower edge, half a count below, is met on the way.
        let count = TAU / 8192.0;
        encoder.motion(Time(0), 0.0, 40.0 * count, -2000.0 * count);
        // x(t) = 40 t − 1000 t² = −0.5 at t = 0.02 + √(0.0004 + 0.0005) = 50 ms.
        let found = encoder.next();
        assert!((found.0 as f64 - 50e9).abs() < 1e4, "{found:?}");
        encoder.advance(found);
        assert_eq!(encoder.count(), -1);
    }

    #[test]
    fn a_wheel_that_goes_on_as_told_makes_no_edge_twice() {
        let mut encoder = Encoder::new(EncoderConfig {
            phase: 0.0,
            ..EncoderConfig::default()
        });
        // A whole number of counts a millisecond: each piece begins at an edge, but for rounding.
        let step = 64.0 * TAU / 8192.0;
        let mut edges = 0;
        for k in 0..500u64 {
            encoder.motion(Time(k * MS), k as f64 * step, step * 1e3, 0.0);
            edges += Decoder::default().run(&mut encoder, Time((k + 1) * MS));
        }
        assert!((31_999..=32_000).contains(&edges), "{edges}");
    }

    #[test]
    fn broken_encoders() {
        let mut encoder = Encoder::new(EncoderConfig::default());
        encoder.motion(Time(0), 0.0, 1.0, 0.0);
        encoder.set_fault(EncoderFault {
            stuck_a: Some(true),
            ..EncoderFault::default()
        });
        let mut decoder = Decoder::default();
        decoder.see(encoder.levels());
        decoder.run(&mut encoder, Time(100 * MS));
        // It sees B alone, which leads nowhere.
        assert!(decoder.count.abs() <= 2 && encoder.count() > 100);

        let mut swapped = Encoder::new(EncoderConfig::default());
        swapped.set_fault(EncoderFault {
            swapped: true,
            ..EncoderFault::default()
        });
        swapped.motion(Time(0), 0.0, 1.0, 0.0);
        let mut decoder = Decoder::default();
        decoder.run(&mut swapped, Time(100 * MS));
        assert_eq!(decoder.count, -swapped.count());

        // Ten covered lines of 2048 cost forty counts a turn.
        let mut covered = Encoder::new(EncoderConfig {
            phase: 0.0,
            ..EncoderConfig::default()
        });
        covered.set_fault(EncoderFault {
            missing: 100..110,
            ..EncoderFault::default()
        });
        covered.motion(Time(0), 0.0, TAU, 0.0);
        let mut decoder = Decoder::default();
        decoder.run(&mut covered, Time(1000 * MS));
        assert_eq!(covered.count() - decoder.count, 40);
    }

    #[test]
    fn a_glitch_is_there_and_gone() {
        let mut encoder = Encoder::new(EncoderConfig {
            output: OutputStage::OpenCollector,
            ..EncoderConfig::default()
        });
        encoder.glitch(Line::A, Time(1000), Time::from_nanos(200));
        let mut seen = Vec::new();
        while encoder.next() != Time::NEVER {
            encoder.advance(encoder.next());
            seen.push((encoder.next().0, encoder.drives()));
        }
        let (open, low) = (Drive::Open, Drive::Low);
        assert_eq!(seen, [(201_000, (open, low)), (u64::MAX, (low, low))]);
    }

    #[test]
    fn a_corrected_angle_is_caught_up_with() {
        let mut encoder = Encoder::new(EncoderConfig::default());
        encoder.motion(Time(MS), 5.0 * TAU / 8192.0, 0.0, 0.0);
        let mut decoder = Decoder::default();
        assert_eq!(decoder.run(&mut encoder, Time(2 * MS)), 5);
        assert_eq!((decoder.count, decoder.jumps), (5, 0));
        assert_eq!(encoder.next(), Time::NEVER);
    }
}
