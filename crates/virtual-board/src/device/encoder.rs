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

/// Edges that are late because the angle was corrected follow each other so closely, ps: 100 ns.
const CATCH_UP: Time = Time::from_nanos(100);

characteristics! {
    /// An encoder.
    pub struct EncoderConfig {
        /// Lines of the disc; four counts each. Default 2048.
        pub lines: u32 = 2048;
        /// Angle of the disc, counts, at the wheel's angle 0. From 0 to less than 1 it decides where in
        /// the first count the wheel stands.
        pub phase: f64 = 0.5;
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
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EncoderFault {
    /// A stands at this level.
    pub stuck_a: Option<bool>,
    /// B stands at this level.
    pub stuck_b: Option<bool>,
    /// The lines are swapped.
    pub swapped: bool,
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
        let mut a = matches!(quarter, 1 | 2);
        let mut b = matches!(quarter, 2 | 3);
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
        let (a, b) = self.levels();
        (Drive::to(a), Drive::to(b))
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
mod tests;
