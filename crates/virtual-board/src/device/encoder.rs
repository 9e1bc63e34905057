//! Incremental encoder: the lines of a code disc on a wheel give two square waves, a quarter period apart.
//!
//! Modelled on the data sheets of optical encoders such as the Broadcom HEDS-5540 (500 lines), with 2048 lines on the
//! wheel shaft. In forward rotation A leads B, so a timer in encoder mode counts up.
//!
//! Between two calls of [`Encoder::motion`] the angle is a quadratic function of time. The time of the next edge is a
//! root of a quadratic equation, so no time step is needed.

use super::{later, span_s};
use crate::chip::Drive;
use crate::time::Time;
use std::collections::VecDeque;
use std::f64::consts::TAU;

/// Interval of the catch-up edges after a correction of the angle: 100 ns.
const CATCH_UP: Time = Time::from_nanos(100);

characteristics! {
    /// Characteristics of an encoder.
    pub struct EncoderConfig {
        /// Lines of the code disc, each with four counts. Default 2048.
        pub lines: u32 = 2048;
        /// Position of the disc at wheel angle 0, counts; values below 1 set the position within the first count.
        pub phase: f64 = 0.5;
    }
}

/// Output line of the encoder.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Line {
    /// Line A, which leads in forward rotation.
    A,
    /// Line B, which lags in forward rotation.
    B,
}

/// Faults of an encoder; several may be present at once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EncoderFault {
    /// Level at which A is stuck; `None` if A works.
    pub stuck_a: Option<bool>,
    /// Level at which B is stuck; `None` if B works.
    pub stuck_b: Option<bool>,
    /// True if the two lines are swapped.
    pub swapped: bool,
}

/// A glitch: the level of a line is inverted for a time.
#[derive(Clone, Copy, Debug)]
struct Glitch {
    line: Line,
    from: Time,
    to: Time,
}

/// Encoder on a wheel, with its motion, faults and glitches.
#[derive(Clone, Debug)]
pub struct Encoder {
    config: EncoderConfig,
    fault: EncoderFault,
    /// Counts per radian.
    scale: f64,
    /// Start time of the present motion; position, counts; speed, counts/s; acceleration, counts/s².
    from: Time,
    position: f64,
    speed: f64,
    acceleration: f64,
    /// Present count: the position is between this count and the next.
    count: i64,
    /// Time of the next change of the count, and the count after it.
    edge: (Time, i64),
    glitches: VecDeque<Glitch>,
    now: Time,
}

impl Encoder {
    /// Creates an encoder at rest at angle 0.
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

    /// Sets the motion from `at` on: angle in rad, speed in rad/s, acceleration in rad/s². If the angle differs from
    /// the end of the last motion, the missing edges follow at intervals of 100 ns.
    pub fn motion(&mut self, at: Time, angle_rad: f64, speed_rad_s: f64, acceleration_rad_s2: f64) {
        self.advance(at);
        self.from = at;
        self.position = angle_rad * self.scale + self.config.phase;
        self.speed = speed_rad_s * self.scale;
        self.acceleration = acceleration_rad_s2 * self.scale;
        self.find_edge();
    }

    /// Sets or clears faults.
    pub fn set_fault(&mut self, fault: EncoderFault) {
        self.fault = fault;
    }

    /// Inverts a line for a time, such as 200 ns. Glitches must be added in the order of time.
    pub fn glitch(&mut self, line: Line, from: Time, width: Time) {
        let to = from + width;
        self.glitches.push_back(Glitch { line, from, to });
    }

    /// True count from wheel angle 0, regardless of faults and glitches.
    pub fn count(&self) -> i64 {
        self.count
    }

    /// Time of the next edge of the present motion, or of the next start or end of a glitch; [`Time::NEVER`] if none is
    /// due.
    pub fn next(&self) -> Time {
        let glitch = self.glitches.iter().fold(Time::NEVER, |next, g| {
            let due = if g.from > self.now { g.from } else { g.to };
            next.min(due)
        });
        self.edge.0.min(glitch)
    }

    /// Advances to a time, through all edges until then.
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

    /// Drives of the outputs A and B at the time of the latest call.
    pub fn drives(&self) -> (Drive, Drive) {
        let (a, b) = self.levels();
        (Drive::to(a), Drive::to(b))
    }

    /// Finds the next change of the count.
    fn find_edge(&mut self) {
        let t = span_s(self.from, self.now);
        let speed = self.speed + self.acceleration * t;
        let position = self.position + (self.speed + 0.5 * self.acceleration * t) * t;
        // Distances to the edges on both sides of the present count.
        let up = (self.count + 1) as f64 - position;
        let down = self.count as f64 - position;
        // Tolerance, counts: right after an edge, rounding can put the position on either side of the edge.
        const ROUNDING: f64 = 1e-6;
        self.edge = if up < -ROUNDING {
            (self.now + CATCH_UP, self.count + 1)
        } else if down > ROUNDING {
            (self.now + CATCH_UP, self.count - 1)
        } else {
            // The next edge is the edge ahead; if the wheel reverses before that, the edge behind.
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

    /// Time until the wheel has moved by a distance (counts, not negative) in a direction (1 or −1), s; infinite if
    /// never.
    fn reach(&self, (distance, direction): (f64, i64), speed: f64) -> f64 {
        // Speed and acceleration are positive in the given direction.
        let sign = direction as f64;
        let (d, v, a) = (distance, sign * speed, sign * self.acceleration);
        let square = v * v + 2.0 * a * d;
        if square < 0.0 || (v <= 0.0 && a <= 0.0) {
            return f64::INFINITY;
        }
        let root = square.sqrt();
        if v >= 0.0 {
            // This form of the root holds for a = 0, too, and avoids cancellation.
            if d == 0.0 { 0.0 } else { 2.0 * d / (v + root) }
        } else {
            // The wheel reverses first.
            (root - v) / a
        }
    }
}

#[cfg(test)]
mod tests;
