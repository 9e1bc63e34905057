//! Common time of the boards, from the front board's [`Message::TimeSync`], and ticks in step with
//! it.
//!
//! # Theory
//!
//! The front board's local time is the common time. At the beginning of each epoch k it sends k, and with it the
//! delay d after the beginning of epoch k − 1 at which that epoch's message had left the bus. A board that received
//! message k − 1 at local time t thereby has the common time of t, `(k − 1)·10 ms + d`. Waiting for the bus and the
//! length of the frame cancel; only the reading of two clocks at the end of a frame remains. A tracking loop (offset
//! and rate, poles at about 1.4 rad/s) averages the pairs. A pair far from the prediction is left out; after many in
//! a row, and at the start, the offset is set anew.
//!
//! The ticks of a board come from a hardware timer of its own. [`Tick::trim`] makes the period of that timer a little
//! longer or shorter, so that ticks meet the whole milliseconds of the common time.
//! Nothing here can fail.

use crate::bus::Message;
use crate::time::{EPOCH, Micros, TICK};

/// Share of the error of a pair (local time, common time) that is added to the offset.
const OFFSET_GAIN: f32 = 0.02;
/// Share of the error of a pair (local time, common time) that is added to the rate, per epoch.
const RATE_GAIN: f32 = 1e-4;
/// Limit of the estimated rate between two crystals, 200 ppm, in µs per epoch.
const MAX_RATE: f32 = 200e-6 * EPOCH as f32;
/// Largest error at which a tick comes into step, µs.
const LOCK_US: i16 = 50;
/// Error beyond which a pair (local time, common time) is left out, µs.
const GATE_US: f32 = 100.0;
/// Number of successive pairs left out after which the offset is set anew.
const STUBBORN: u8 = 10;
/// Time without a pair of times after which the common time counts as lost: 1 s.
const LOST: Micros = 100 * EPOCH;

/// Common time on a board other than the front board.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CommonClock {
    /// The last message: its epoch, and the local time of its arrival.
    arrived: Option<(u32, Micros)>,
    fit: Option<Fit>,
    left_out: u8,
}

/// Common time as a line over local time.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Fit {
    /// Local time the line is anchored at.
    local: Micros,
    /// Common less local time at `local`: whole microseconds in `offset`, the fraction in `rest`.
    offset: i64,
    rest: f32,
    /// Advance of the common time relative to local time in an epoch, µs.
    rate: f32,
}

impl Fit {
    /// Common less local time at `local`: whole microseconds, and the fraction.
    fn at(&self, local: Micros) -> (i64, f32) {
        let epochs = local.saturating_sub(self.local) as f32 / EPOCH as f32;
        let rest = self.rest + self.rate * epochs;
        let whole = rest as i64;
        (self.offset + whole, rest - whole as f32)
    }
}

impl CommonClock {
    /// Takes in a message that arrived at local time `local`; only [`Message::TimeSync`] counts.
    pub fn receive(&mut self, local: Micros, message: &Message) {
        let Message::TimeSync {
            epoch,
            last_delay_us,
        } = *message
        else {
            return;
        };
        let last = self.arrived.replace((epoch, local));
        if let (Some((before, arrived)), Some(delay)) = (last, last_delay_us)
            && epoch == before.wrapping_add(1)
        {
            let common = Micros::from(before) * EPOCH + Micros::from(delay);
            self.pair(arrived, common as i64 - arrived as i64);
        }
    }

    /// Corrects the fit by a pair of times: at local time `local` the common time was ahead by `offset` (µs).
    fn pair(&mut self, local: Micros, offset: i64) {
        let Some(fit) = &mut self.fit else {
            self.begin(local, offset);
            return;
        };
        let (whole, rest) = fit.at(local);
        let error = offset.saturating_sub(whole) as f32 - rest;
        if !(error.abs() <= GATE_US) {
            self.left_out += 1;
            if self.left_out >= STUBBORN {
                self.begin(local, offset);
            }
            return;
        }
        self.left_out = 0;
        fit.local = local;
        fit.offset = whole;
        fit.rest = rest + OFFSET_GAIN * error;
        fit.rate = (fit.rate + RATE_GAIN * error).clamp(-MAX_RATE, MAX_RATE);
    }

    fn begin(&mut self, local: Micros, offset: i64) {
        self.left_out = 0;
        self.fit = Some(Fit {
            local,
            offset,
            rest: 0.0,
            rate: 0.0,
        });
    }

    /// Common time at local time `local`; `None` before the first pair of times and after a second without a pair.
    pub fn common(&self, local: Micros) -> Option<Micros> {
        let fit = self.fit.as_ref()?;
        if local.saturating_sub(fit.local) > LOST {
            return None;
        }
        let (whole, rest) = fit.at(local);
        let round = if rest >= 0.5 {
            1
        } else if rest < -0.5 {
            -1
        } else {
            0
        };
        Micros::try_from(local as i64 + whole + round).ok()
    }
}

/// A tick in step with the common time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tick {
    /// The whole millisecond of common time that the tick stands for.
    pub now: Micros,
    /// Lateness of the tick, µs; negative if early.
    pub late_us: i16,
}

impl Tick {
    /// The tick of common time `common`: the nearest whole millisecond.
    pub fn of(common: Micros) -> Self {
        let now = (common + TICK / 2) / TICK * TICK;
        Self {
            now,
            // Within half a tick.
            late_us: (common as i64 - now as i64) as i16,
        }
    }

    /// True if the tick is close enough to its millisecond to run a node: within 0.1 ms if the tick before was in step
    /// (`before`), otherwise within 0.05 ms. Without this hysteresis an error near the limit would let single ticks
    /// through.
    pub fn in_step(&self, before: bool) -> bool {
        self.late_us.abs() <= if before { 2 * LOCK_US } else { LOCK_US }
    }

    /// Counts by which the period of the board's timer is to differ from the nominal period until the next tick: −1, 0
    /// or 1 near the millisecond, −4 or 4 far from the millisecond. One count in 4200 would gain little on a crystal
    /// that is off by 200 ppm.
    pub fn trim(&self) -> i8 {
        // A tick that comes late needs shorter periods.
        -(self.late_us.signum() as i8) * if self.in_step(false) { 1 } else { 4 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fusion::testing::Random;

    /// Two clocks and the bus between them, in true time (µs, double precision).
    struct ClockBench {
        random: Random,
        /// Local time of the follower: `offset + (1 + rate) t`.
        offset: f64,
        rate: f64,
        last_delay: Option<u16>,
    }

    impl ClockBench {
        fn local(&self, common: f64) -> Micros {
            (self.offset + (1.0 + self.rate) * common) as Micros
        }

        /// Runs one epoch with its message; returns the largest error of the follower's time in this epoch, µs.
        fn epoch(&mut self, clock: &mut CommonClock, epoch: u32, lost: bool) -> f64 {
            let start = f64::from(epoch) * EPOCH as f64;
            // The message is delayed by up to one frame of another board, its own 111 to 115 bits, and interrupts.
            let delay = 111.0 + 135.0 * self.random.uniform() + 4.0 * self.random.uniform();
            let message = Message::TimeSync {
                epoch,
                last_delay_us: self.last_delay,
            };
            let stamp = |random: &mut Random| 3.0 * random.uniform();
            self.last_delay = Some((delay + stamp(&mut self.random)) as u16);
            if !lost {
                let arrival = start + delay + stamp(&mut self.random);
                let local = self.local(arrival);
                clock.receive(local, &message);
            }
            (0..10)
                .filter_map(|tick| {
                    let now = start + f64::from(tick) * 1e3 + 500.0;
                    let common = clock.common(self.local(now))?;
                    Some((common as f64 - now).abs())
                })
                .fold(0.0, f64::max)
        }
    }

    fn bench(offset: f64, rate: f64) -> ClockBench {
        ClockBench {
            random: Random::new(11),
            offset,
            rate,
            last_delay: None,
        }
    }

    /// Ceramic resonators or two poor crystals: 100 ppm between the clocks.
    #[test]
    fn drifting_clocks_are_kept_together_within_microseconds() {
        for (offset, rate) in [(5e6, 1e-4), (1e3, -1e-4), (3.6e9, 3e-5)] {
            let mut bench = bench(offset, rate);
            let mut clock = CommonClock::default();
            let mut worst = 0.0f64;
            for epoch in 0..6000 {
                let error = bench.epoch(&mut clock, epoch, epoch % 7 == 3);
                if epoch > 1500 {
                    worst = worst.max(error);
                }
            }
            println!("offset {offset}, rate {rate}: largest error {worst:.1} µs");
            assert!(worst < 10.0, "{worst}");
        }
    }

    #[test]
    fn without_messages_the_time_continues_and_is_lost_after_a_second() {
        let mut bench = bench(1e6, 5e-5);
        let mut clock = CommonClock::default();
        for epoch in 0..2000 {
            bench.epoch(&mut clock, epoch, false);
        }
        for epoch in 2000..2090 {
            let error = bench.epoch(&mut clock, epoch, true);
            assert!(error < 15.0, "{error}");
        }
        assert_eq!(clock.common(bench.local(2102.0 * EPOCH as f64)), None);
    }

    #[test]
    fn clock_follows_a_restarted_front_board() {
        let mut clock = CommonClock::default();
        let mut before = bench(1e6, 0.0);
        for epoch in 0..2000 {
            before.epoch(&mut clock, epoch, false);
        }
        // The front board counts from zero again.
        let mut after = bench(1e6 + 2000.0 * EPOCH as f64, 0.0);
        for epoch in 0..200 {
            let error = after.epoch(&mut clock, epoch, false);
            if epoch > 50 {
                assert!(error < 10.0, "{epoch} {error}");
            }
        }
    }

    #[test]
    fn common_time_is_unknown_before_two_messages_in_a_row() {
        let mut clock = CommonClock::default();
        let sync = |epoch, last_delay_us| Message::TimeSync {
            epoch,
            last_delay_us,
        };
        let lost = [
            (100, 5, Some(120)),
            (20_100, 7, Some(120)),
            (30_100, 8, None),
        ];
        for (local, epoch, delay) in lost {
            clock.receive(local, &sync(epoch, delay));
            assert_eq!(clock.common(local), None);
        }
        clock.receive(40_100, &sync(9, Some(130)));
        // Message 8 arrived at local time 30 100 µs; it had left at common time 80 130 µs.
        assert_eq!(clock.common(30_100), Some(80_130));
    }

    #[test]
    fn tick_is_in_step_within_50_us_or_100_us_if_the_tick_before_was() {
        for (late_us, first, next) in [
            (50, true, true),
            (-50, true, true),
            (51, false, true),
            (-51, false, true),
            (100, false, true),
            (-100, false, true),
            (101, false, false),
            (-101, false, false),
        ] {
            let tick = Tick { now: 0, late_us };
            assert_eq!(
                (tick.in_step(false), tick.in_step(true)),
                (first, next),
                "{late_us}"
            );
        }
        let mut clock = CommonClock::default();
        for (rest, expected) in [(0.5, 101), (0.49, 100), (-0.5, 100), (-0.51, 99)] {
            clock.begin(0, 100);
            clock.fit.as_mut().unwrap().rest = rest;
            assert_eq!(clock.common(0), Some(expected), "{rest}");
        }
    }

    /// A pair of times that is off by more than 100 µs is left out. The tenth in a row restarts the fit, and a good
    /// pair resets the count.
    #[test]
    fn pair_beyond_the_gate_is_left_out_until_ten_in_a_row() {
        let begun = || {
            let mut clock = CommonClock::default();
            clock.pair(0, 1_000_000);
            clock
        };
        for (error, taken) in [(100, true), (-100, true), (101, false), (-101, false)] {
            let mut clock = begun();
            clock.pair(10_000, 1_000_000 + error);
            assert_eq!(clock.fit != begun().fit, taken, "{error}");
            assert_eq!(clock.left_out, u8::from(!taken));
        }
        let mut clock = begun();
        for (good, bad) in [(0, 9), (1, 9), (1, 9)] {
            (0..good).for_each(|_| clock.pair(0, 1_000_000));
            assert!(good == 0 || clock.left_out == 0);
            (0..bad).for_each(|_| clock.pair(10_000, 2_000_000));
            assert_eq!(clock.common(0), Some(1_000_000));
        }
        clock.pair(10_000, 2_000_000);
        assert_eq!((clock.common(10_000), clock.left_out), (Some(2_010_000), 0));
    }

    /// A timer trimmed by one count in 4200 meets the milliseconds and stays there.
    #[test]
    fn ticks_come_in_step_with_the_common_time() {
        for (start, rate) in [(499.0f64, 2e-4), (-499.0, -2e-4), (30.0, 0.0)] {
            let mut common = 1e6 + start;
            let (mut trim, mut last) = (0, None);
            for k in 0..20_000 {
                let tick = Tick::of(common as Micros);
                if k > 5000 {
                    assert!(tick.late_us.abs() <= 2 && tick.in_step(false), "{tick:?}");
                    assert_eq!(Some(tick.now), last.map(|now: Micros| now + TICK));
                }
                last = Some(tick.now);
                trim = tick.trim();
                common += 1000.0 * (1.0 + f64::from(trim) / 4200.0) * (1.0 + rate);
            }
            assert!(trim.abs() <= 1);
        }
    }
}
