//! Sampling instants of the motor currents within a PWM period.
//!
//! The counter counts up to its top and down again, and the pulses are centred on zero. The converter is started when
//! the counter passes a compare value on the way up. Both currents are converted in one *window*, one after the other.
//! An edge of either motor within the window, or so shortly before it that driver and amplifier have not settled,
//! spoils the readings. Edges on the way up are at the compare values of the motors, edges on the way down are their
//! mirror images.
//!
//! There are three places for the window: around the top, in the middle of both OFF; just after zero, in the middle of
//! both ON; and half-way up, between the edges of one motor that is nearly off and one that is nearly full. A
//! common-mode step disturbs the amplifier for up to 10 µs. Of the first two places the window therefore takes the one
//! with the longer time since the latest edge. In the middle of ON or OFF a reading is the mean of the ripple. Half-way
//! up the error is about a third of the ripple of a small duty, so this place is used only if the other places are too
//! close to an edge.
//!
//! # Panic contract
//!
//! [`Timing::build`] validates at compile time; [`Sampling::compare`] cannot fail.

/// Times that converter, drivers and amplifiers need, counts of the timer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    /// Top of the counter.
    pub top: u16,
    /// Largest trim of the top to either side.
    pub trim: u16,
    /// Time from the trigger to the end of the last sampling.
    pub window: u16,
    /// Least time from an edge of the timer to the first reading, at any pair of duties.
    pub settling: u16,
    /// Least time from the end of the last sampling to the next edge.
    pub margin: u16,
    /// Smallest compare value whose trigger pulse is long enough for the converter.
    pub earliest: u16,
}

impl Timing {
    /// Builds the sampling; `None` if a pair of duties leaves no place for the window that is free of edges.
    pub const fn build(self) -> Option<Sampling> {
        let half = self.window / 2;
        let lowest_top = self.top.checked_sub(self.trim);
        let (Some(lowest_top), Some(between)) = (lowest_top, (self.top / 2).checked_sub(half))
        else {
            return None;
        };
        // The sums are computed in 32 bits, so that they do not overflow.
        let (lowest, window) = (lowest_top as u32, self.window as u32 + self.margin as u32);
        let (on, settling) = (self.earliest as u32, self.settling as u32);
        let off = self.top - half;
        // Around a top that is trimmed down, the edge on the way down comes earlier.
        let Some(off_up_to) = (2 * lowest).checked_sub(off as u32 + window) else {
            return None;
        };
        let (on_from, between_from) = (on + window, between as u32 + window);
        // The worst pairs of duties. In both the longer pulse is just too long for the window around the top. The
        // shorter pulse is just too short for the window after zero, or leaves equal clearance after zero and half-way
        // up.
        let at_the_top = between_from <= off_up_to + 1;
        let after_zero = on_from + settling <= between as u32;
        let equal = on + between as u32 >= 2 * settling;
        if !(self.earliest > 0 && off < lowest_top && at_the_top && after_zero && equal) {
            return None;
        }
        Some(Sampling {
            off,
            off_up_to: off_up_to as u16,
            on: self.earliest,
            on_from: on_from as u16,
            between,
            between_from: between_from as u16,
            settling: self.settling,
        })
    }
}

/// Timing of the axle board: 168 counts per microsecond, two conversions of 40 cycles at 21 MHz, of which 28 are the
/// sampling time.
pub const AXLE: Timing = Timing {
    top: 4200,
    trim: i8::MAX as u16,
    // 3.24 µs: one conversion and the sampling time of the next.
    window: 544,
    // 5.5 µs.
    settling: 930,
    // Delay of the trigger: the converter's clock is an eighth of the timer's.
    margin: 34,
    // The trigger is low for twice this time, 1 µs, which the converter's clock detects.
    earliest: 84,
};

/// The three places of the conversion window in a period, and the compare values of the motors without an edge there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sampling {
    off: u16,
    off_up_to: u16,
    on: u16,
    on_from: u16,
    between: u16,
    between_from: u16,
    settling: u16,
}

impl Sampling {
    /// Compare value of the trigger for a period with these compare values of the motors.
    pub const fn compare(&self, compares: [u16; 2]) -> u16 {
        let [a, b] = compares;
        let (shorter, longer) = if a < b { (a, b) } else { (b, a) };
        // A motor without pulses has no edges.
        let shorter = if shorter == 0 { longer } else { shorter };
        // Counts since the latest edge, for the window at the top and for the window after zero.
        let at_off = if longer <= self.off_up_to {
            self.off.saturating_sub(longer)
        } else {
            0
        };
        let at_on = if shorter >= self.on_from {
            // The level rises a count after the compare value, on the way down.
            self.on.saturating_add(shorter).saturating_sub(1)
        } else {
            0
        };
        let at_between = if longer >= self.between_from {
            self.between.saturating_sub(shorter)
        } else {
            0
        };
        let (place, clearance) = if at_off >= at_on {
            (self.off, at_off)
        } else {
            (self.on, at_on)
        };
        if clearance >= self.settling || clearance >= at_between {
            place
        } else {
            self.between
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TIMING: Timing = AXLE;

    /// Counter at every clock cycle of `periods` periods. By the reference manual, an output of a counter that counts
    /// up and down is active below its compare value.
    fn counter(top: u16, periods: usize) -> Vec<u16> {
        let up = 0..top;
        let down = (1..=top).rev();
        let period: Vec<u16> = up.chain(down).collect();
        period.repeat(periods)
    }

    fn edges(counter: &[u16], level: impl Fn(u16) -> bool) -> Vec<usize> {
        (1..counter.len())
            .filter(|&t| level(counter[t - 1]) != level(counter[t]))
            .collect()
    }

    /// Counts from the latest edge to the window, by a walk through the periods; asserts that the window has no edge.
    fn clearance(top: u16, compares: [u16; 2]) -> usize {
        let sampling = TIMING.build().unwrap();
        let compare = sampling.compare(compares);
        let counter = counter(top, 3);
        let begins: Vec<usize> = edges(&counter, |count| count >= compare)
            .into_iter()
            .filter(|&t| counter[t] > counter[t - 1])
            .collect();
        assert_eq!(begins.len(), 3, "{top} {compares:?}: one window a period");
        let begin = begins[1];
        let mut clearance = begin;
        for motor in compares {
            for edge in edges(&counter, |count| count < motor) {
                let after = edge >= begin + usize::from(TIMING.window + TIMING.margin);
                assert!(edge < begin || after, "{top} {compares:?}: {edge} {begin}");
                if edge < begin {
                    clearance = clearance.min(begin - edge);
                }
            }
        }
        clearance
    }

    fn check(top: u16, compares: [u16; 2]) {
        let clearance = clearance(top, compares);
        let least = usize::from(TIMING.settling);
        assert!(clearance >= least, "{top} {compares:?}: {clearance}");
    }

    /// An INA240 settles to 0.5 % in 9.6 µs, the driver in 1 µs.
    #[test]
    fn equal_duties_leave_the_time_for_the_amplifier_to_settle() {
        for duty in (0..=4200).step_by(60) {
            let clearance = clearance(4200, [duty, duty]);
            assert!(clearance as f64 / 168.0 >= 10.6, "{duty}: {clearance}");
            let alone = self::clearance(4200, [0, duty]);
            assert!(alone as f64 / 168.0 >= 10.6, "{duty}: {alone}");
        }
    }

    /// The compare values lie on both sides of each boundary between two places of the window.
    #[test]
    fn window_is_clean_at_each_change_of_the_place() {
        let limits = [
            0, 1, 661, 662, 845, 846, 847, 1921, 1922, 1923, 2405, 2406, 2407, 3056, 3639, 3640,
            3641, 4116, 4200,
        ];
        for top in [4073, 4200, 4327] {
            for left in limits {
                for right in limits {
                    check(top, [left, right]);
                }
            }
        }
    }

    #[test]
    fn places_match_hand_calculation() {
        let sampling = TIMING.build().unwrap();
        // Both duties up to 45.8 %: the window is centred on the top. Above: just after zero.
        assert_eq!(sampling.compare([0, 0]), 4200 - 272);
        assert_eq!(sampling.compare([1922, 1922]), 3928);
        assert_eq!(sampling.compare([1923, 1923]), 84);
        assert_eq!(sampling.compare([4200, 4200]), 84);
        assert_eq!(sampling.compare([0, 3000]), 84, "one motor has no edges");
        // One motor is nearly off, the other nearly full: half-way up. From 847 counts on: just after zero.
        assert_eq!(sampling.compare([661, 4116]), 2100 - 272);
        assert_eq!(sampling.compare([846, 4116]), 2100 - 272);
        assert_eq!(sampling.compare([847, 4116]), 84);
    }

    /// The ripple is integrated from the volt-seconds of each clock cycle, with a full pack and the default motor.
    /// 30 mA are seven counts.
    #[test]
    fn reading_is_the_mean_current_within_30_ma() {
        let sampling = TIMING.build().unwrap();
        let (supply, inductance, clock) = (16.8, 2.3e-3, 168e6);
        let mut worst: f64 = 0.0;
        for left in (0..=4116u16).step_by(84) {
            for right in (0..=4116u16).step_by(84) {
                let counter = counter(4200, 2);
                let begin = usize::from(sampling.compare([left, right]));
                // Middles of both sampling times: 14 cycles of the converter, then 40 more.
                for (motor, offset) in [(left, 112), (right, 432)] {
                    let duty = f64::from(motor) / 4200.0;
                    let mut current = 0.0;
                    let triangle: Vec<f64> = counter[..8400]
                        .iter()
                        .map(|&count| {
                            let on = if count < motor { 1.0 } else { 0.0 };
                            current += (on - duty) * supply / (inductance * clock);
                            current
                        })
                        .collect();
                    let mean = triangle.iter().sum::<f64>() / 8400.0;
                    let read = triangle[(begin + offset) % 8400];
                    worst = worst.max((read - mean).abs());
                }
            }
        }
        assert!(worst < 0.03, "{worst}");
        assert!(worst > 0.005, "{worst}");
    }

    /// Counts from the latest edge to a window that begins at `place`; `None` if the window has an edge. A compare
    /// value of 0 or above the top gives no edges.
    fn clear(timing: &Timing, top: u16, place: u16, compares: [u16; 2]) -> Option<i32> {
        let [top, place] = [top, place].map(i32::from);
        let end = place + i32::from(timing.window + timing.margin);
        let mut clearance = i32::MAX;
        for motor in compares
            .map(i32::from)
            .into_iter()
            .filter(|&m| m > 0 && m <= top)
        {
            // The level falls at the compare value, and rises a count after it on the way down.
            for edge in [motor, 2 * top - motor + 1]
                .map(|edge| [edge - 2 * top, edge])
                .concat()
            {
                if (place..end).contains(&edge) {
                    return None;
                }
                if edge < place {
                    clearance = clearance.min(place - edge);
                }
            }
        }
        Some(clearance)
    }

    /// Small random timings at all pairs of duties. The chosen window has no edge at any trim. It is the better of the
    /// windows at the top and after zero, or the window half-way up if neither has the settling time.
    #[test]
    fn chosen_place_is_the_best_by_the_edges_of_the_outputs() {
        let mut random = crate::fusion::testing::Random::new(3);
        let mut within =
            |low: u16, high: u16| random.between(low.into(), high.into()).round() as u16;
        let mut built = 0;
        for _ in 0..1500 {
            let timing = Timing {
                top: within(24, 50),
                trim: within(0, 3),
                window: within(1, 8),
                settling: within(1, 9),
                margin: within(0, 2),
                earliest: within(1, 5),
            };
            let Some(sampling) = timing.build() else {
                continue;
            };
            built += 1;
            let Timing { top, trim, .. } = timing;
            let half = timing.window / 2;
            let [off, on, between] = [top - half, timing.earliest, top / 2 - half];
            let lowest_first = |place, compares| {
                let tops = [top - trim, top, top + trim];
                let each = tops.map(|top| clear(&timing, top, place, compares));
                each.into_iter().min().flatten().unwrap_or(0)
            };
            for [a, b] in (0..=top).flat_map(|a| (0..=top).map(move |b| [a, b])) {
                let place = sampling.compare([a, b]);
                let [at_off, at_on, at_between] =
                    [off, on, between].map(|at| lowest_first(at, [a, b]));
                // A pulse that ends before the window after zero counts as too short for this window.
                let early = [a, b].iter().any(|motor| (1..on).contains(motor));
                let at_on = if early { 0 } else { at_on };
                let settling = i32::from(timing.settling);
                let better = if at_off >= at_on {
                    (off, at_off)
                } else {
                    (on, at_on)
                };
                let chosen = [(off, at_off), (on, at_on), (between, at_between)]
                    .into_iter()
                    .find(|choice| choice.0 == place);
                let clearance = chosen.unwrap().1;
                assert!(clearance >= settling, "{timing:?} {a} {b}: {place}");
                // `build` takes the edge on the way down as one count earlier.
                let spare = 2 * (top - trim) - off - timing.window - timing.margin + 1;
                if better.1 >= settling && a.max(b) != spare {
                    assert_eq!(place, better.0, "{timing:?} {a} {b}");
                }
            }
        }
        assert!(built > 200, "{built}");
    }

    /// Each limit of a timing and the next count beyond, one condition at a time.
    #[test]
    fn timing_is_accepted_up_to_its_exact_limits() {
        type Change = fn(&mut Timing, u16);
        // Limits. Settling: 84 + 1828 counts are twice 956. Settling with an earliest compare value of 400: 400 + 578 +
        // 850 counts are 1828. Trim: half a window is 272.
        let settling: Change = |timing, value| timing.settling = value;
        let late: Change = |timing, value| (timing.earliest, timing.settling) = (400, value);
        let margin: Change = |timing, value| {
            (timing.earliest, timing.settling, timing.margin) = (400, 850, value);
        };
        let trim: Change = |timing, value| timing.trim = value;
        // At a trim of 421 the lowest top is 3781, and 2 × 3781 − 3672 − 1160 is one less than 1571 + 1160: the limit.
        let wide: Change = |timing, value| {
            (timing.top, timing.window, timing.margin) = (4202, 1060, 100);
            (timing.settling, timing.trim) = (300, value);
        };
        let never: Change = |timing, value| (timing.settling, timing.earliest) = (100, 1 - value);
        for (k, (change, limit)) in [
            (settling, 956),
            (late, 850),
            (margin, 34),
            (trim, 271),
            (wide, 421),
            (never, 0),
        ]
        .into_iter()
        .enumerate()
        {
            for (value, accepted) in [(limit, true), (limit + 1, false)] {
                let mut timing = TIMING;
                change(&mut timing, value);
                assert_eq!(timing.build().is_some(), accepted, "{k}: {value}");
            }
        }
        // With these values a subtraction of the checks would give a negative result.
        for (trim, window) in [(5000, 544), (2200, 544), (127, 4300)] {
            let timing = Timing {
                trim,
                window,
                ..TIMING
            };
            assert_eq!(timing.build(), None);
        }
    }
}
