//! Expected times are calculated from RM0090: a counter starts at the second edge of its clock after CEN.

use super::*;
use crate::chip::interrupt::Interrupt;
use crate::chip::map::Unit;
use crate::chip::pin::Signal;
use crate::chip::testing::shared;
use crate::finding::FindingKind as Finding;
use Drive::{High, Low, Open};

/// Cycle at which a counter enabled at cycle 0 starts, if its clock is the core clock.
const START: Cycles = 1;

/// A timer with its shared state.
struct TimerBench {
    timer: Timer,
    shared: Shared,
    /// Effects, each with its cycle.
    effects: Vec<(Cycles, Effect)>,
}

impl TimerBench {
    fn new(id: TimerId) -> Self {
        Self {
            timer: Timer::new(id),
            shared: shared(),
            effects: Vec::new(),
        }
    }

    fn collect(&mut self) {
        let now = self.shared.now;
        self.effects
            .extend(self.shared.effects.drain(..).map(|effect| (now, effect)));
    }

    /// Advances to `end`, inclusive.
    fn pass(&mut self, end: Cycles) -> &mut Self {
        let source = self.timer.id.unit();
        while self.shared.arrive(source, end) {
            self.timer.event(&mut self.shared);
            self.collect();
        }
        self
    }

    fn write(&mut self, values: &[(u32, u32)]) -> &mut Self {
        for &(offset, value) in values {
            self.timer.write(offset, value, !0, &mut self.shared);
            self.collect();
        }
        self
    }

    fn read(&mut self, offset: u32) -> u32 {
        self.timer.read(offset, &mut self.shared)
    }

    fn input(&mut self, signal: Signal, level: bool) -> &mut Self {
        self.timer.input(signal, level, &mut self.shared);
        self.collect();
        self
    }

    /// Cycles at which an effect occurred.
    fn times(&mut self, of: Effect) -> Vec<Cycles> {
        let found = self.effects.iter().filter(|(_, effect)| *effect == of);
        found.map(|(at, _)| *at).collect()
    }

    /// Takes the recorded changes of an output, with their cycles.
    fn drives(&mut self, of: Signal) -> Vec<(Cycles, Drive)> {
        let found = self
            .effects
            .drain(..)
            .filter_map(|(at, effect)| match effect {
                Effect::Output(signal, drive) if signal == of => Some((at, drive)),
                _ => None,
            });
        found.collect()
    }
}

/// TIM1 centre-aligned (mode `cms`) up to 100, PWM with compare value 30 on channel 1, TRGO at updates.
fn centred(cms: u32, repetition: u32) -> TimerBench {
    let mut bench = TimerBench::new(TimerId::Tim1);
    let mode = cms << 5 | ARPE;
    bench.write(&[
        (ARR, 100),
        (RCR, repetition),
        (CCR1, 30),
        (CCMR1, 0x68),
        (CCER, 1),
        (CR2, 2 << 4),
        (BDTR, MOE | OSSI),
        (CR1, mode),
        (EGR, 1),
        (SR, 0),
    ]);
    bench.effects.clear();
    bench.write(&[(CR1, mode | CEN)]);
    bench
}

const TRGO1: Effect = Effect::Trigger {
    timer: TimerId::Tim1,
    rises: true,
};

#[test]
fn edge_aligned_timer_updates_every_reload_plus_one_steps() {
    let mut bench = TimerBench::new(TimerId::Tim2);
    bench.write(&[(ARR, 874), (CR2, 2 << 4), (EGR, 1)]);
    bench.effects.clear();
    bench.write(&[(CR1, CEN)]).pass(2701);
    let trgo = Effect::Trigger {
        timer: TimerId::Tim2,
        rises: true,
    };
    assert_eq!(bench.times(trgo), [876, 1751, 2626]);
    assert_eq!(bench.read(CNT), 75);
    assert_eq!(bench.read(SR) & UPDATE, UPDATE);
}

#[test]
fn timer_without_consumers_schedules_nothing_and_keeps_its_state() {
    let mut bench = TimerBench::new(TimerId::Tim3);
    // Channel 1 is PWM with its output off. The timer's clock is two core cycles, a step of the counter six.
    bench.shared.clocks.timer1 = 2;
    bench.write(&[
        (PSC, 2),
        (ARR, 9),
        (CCR1, 4),
        (CCMR1, 0x60),
        (EGR, 1),
        (SR, 0),
        (CR1, CEN),
    ]);
    assert_eq!(bench.shared.due(Unit::Tim3), NEVER);
    // The counter starts at cycle 2. After 1000 periods and 7 steps, the channel has matched 1001 times.
    bench.pass(2 + 6 * (10 * 1000 + 7) + 1);
    assert_eq!(bench.read(CNT), 7);
    assert_eq!(bench.read(SR) & 3, UPDATE | 2);
    assert!(!bench.timer.channels[0].reference);
    bench.pass(2 + 6 * (10 * 1001 + 2));
    bench.read(CNT);
    assert!(bench.timer.channels[0].reference);
}

#[test]
fn down_counter_starts_at_its_reload_value() {
    let mut bench = TimerBench::new(TimerId::Tim4);
    bench.write(&[(ARR, 9), (CR1, DIR), (EGR, 1), (SR, 0), (DIER, UPDATE)]);
    assert_eq!(bench.read(CNT), 9);
    bench.write(&[(CR1, DIR | CEN)]);
    for (steps, count) in [(9, 0), (10, 9)] {
        bench.pass(START + steps);
        assert_eq!(bench.read(CNT), count);
        assert_eq!(bench.shared.is_high(Interrupt::Tim4), steps > 9);
    }
    bench.write(&[(SR, 0)]);
    assert!(!bench.shared.is_high(Interrupt::Tim4));
}

#[test]
fn preloaded_reload_and_prescaler_take_effect_at_the_update() {
    let mut bench = TimerBench::new(TimerId::Tim2);
    bench.write(&[(ARR, 9), (CR1, ARPE | CEN), (EGR, 1), (PSC, 3), (ARR, 4)]);
    // UG at cycle 0 loads the values valid then, so the first period has the old length.
    bench.pass(9);
    assert_eq!(bench.read(CNT), 9);
    bench.pass(10 + 4 * 4);
    assert_eq!(bench.read(CNT), 4);
    bench.pass(10 + 4 * 5);
    assert_eq!(bench.read(CNT), 0);
    // Without preload the new reload value is active at once.
    bench.write(&[(CR1, CEN), (ARR, 99)]).pass(30 + 4 * 99);
    assert_eq!(bench.read(CNT), 99);
}

#[test]
fn udis_disables_updates_and_urs_limits_the_flag_to_the_counter() {
    let mut bench = TimerBench::new(TimerId::Tim2);
    bench.write(&[(CR1, URS), (ARR, 9), (CCR1, 5), (CCMR1, 8), (EGR, 1)]);
    assert_eq!(bench.read(SR), 0, "URS");
    bench.write(&[(CCR1, 7), (CR1, UDIS), (EGR, 1)]);
    assert_eq!(bench.timer.channels[0].compare, 5, "UDIS");
    bench.write(&[(CR1, UDIS | CEN)]).pass(100);
    assert_eq!(bench.read(SR) & UPDATE, 0);
    assert_eq!(bench.read(CNT), (100 - START as u32) % 10);
}

#[test]
fn centre_aligned_pulses_are_centred_on_the_underflow() {
    let mut bench = centred(1, 0);
    bench.pass(START + 450);
    let edges: Vec<_> = [(30, Low), (170, High), (230, Low), (370, High), (430, Low)]
        .map(|(at, drive)| (START + at, drive))
        .into();
    assert_eq!(bench.times(TRGO1), [101, 201, 301, 401]);
    assert_eq!(bench.drives(Signal::Tim1Ch1), edges);
}

#[test]
fn repetition_counter_counts_both_ends_of_a_centre_aligned_count() {
    // An update loaded RCR before the start: with an odd RCR, update events occur only at underflows.
    for (repetition, updates) in [
        (1, vec![200, 400, 600, 800]),
        (2, vec![300, 600, 900]),
        (3, vec![400, 800]),
    ] {
        let mut bench = centred(1, repetition);
        bench.pass(START + 950);
        let expected: Vec<_> = updates.iter().map(|at| at + START).collect();
        assert_eq!(bench.times(TRGO1), expected, "{repetition}");
    }
    // RCR is written after CEN but before the counter starts. The repetition counter is still 0, so the first overflow
    // is an update. Of the following overflows and underflows every second is an update: each overflow.
    let mut bench = centred(1, 0);
    bench.write(&[(RCR, 1)]).pass(START + 600);
    assert_eq!(bench.times(TRGO1), [101, 301, 501]);
}

#[test]
fn reload_value_changed_at_the_overflow_is_the_start_of_the_down_count() {
    let mut bench = centred(1, 0);
    bench.write(&[(ARR, 54)]).pass(START + 99);
    assert_eq!(bench.read(CNT), 99);
    bench.pass(START + 100);
    assert_eq!(bench.read(CNT), 54);
    bench.pass(START + 101);
    assert_eq!((bench.read(CNT), bench.read(CR1) & DIR), (53, DIR));
    bench.pass(START + 100 + 54 * 2);
    assert_eq!(bench.times(TRGO1), [101, 155, 209]);
}

#[test]
fn compare_flags_follow_the_centre_aligned_mode() {
    // Times of the compare flag, as in the manual's figure. At compare value 40, CMS selects whether the flag is set
    // while counting down, up, or both. At 0 and 100 each mode sets the flag; at 120, beyond the reload value, the
    // overflow does.
    for (cms, at_40) in [(1, vec![160]), (2, vec![40]), (3, vec![40, 160])] {
        for (compare, times) in [
            (40, at_40.clone()),
            (100, vec![100]),
            (120, vec![100]),
            (0, vec![200]),
        ] {
            let mut bench = centred(cms, 0);
            bench.write(&[(0x38, compare), (CCMR1, 0x7060), (DIER, 4), (SR, 0)]);
            let mut cycles = Vec::new();
            for at in 1..=200 {
                bench.pass(START + at);
                if bench.shared.is_high(Interrupt::Tim1Compare) {
                    cycles.push(at);
                    bench.write(&[(SR, !4)]);
                }
            }
            assert_eq!(cycles, times, "{cms} {compare}");
        }
    }
}

#[test]
fn preloaded_compare_value_takes_effect_at_the_next_update() {
    let mut bench = centred(1, 0);
    bench.pass(51).write(&[(CCR1, 60)]);
    bench.pass(301);
    assert_eq!(bench.read(CCR1), 60);
    // The counter turns at cycle 101. The output becomes high at count 60 on the way down, cycle 141.
    let drives = bench.drives(Signal::Tim1Ch1);
    assert_eq!(drives, [(31, Low), (141, High), (261, Low)]);
}

#[test]
fn duty_cycles_of_0_and_100_percent_have_no_edges() {
    for (compare, level) in [(0, Low), (100, High), (0xffff, High)] {
        let mut bench = centred(1, 0);
        bench.write(&[(CCR1, compare)]).pass(START + 200);
        bench.effects.clear();
        bench.pass(START + 900);
        assert!(bench.drives(Signal::Tim1Ch1).is_empty(), "{compare}");
        assert_eq!(bench.timer.channels[0].drive, level);
    }
}

#[test]
fn pwm_modes_and_polarity_give_the_expected_edges() {
    // ARR 9, CCR 4: both PWM modes, then inverted polarity.
    for (mode, ccer, levels, times) in [
        (6, 1, [High, Low], [0, 5, 11, 15, 21, 25].as_slice()),
        (7, 1, [High, Low], &[5, 11, 15, 21, 25]),
        (6, 3, [Low, High], &[0, 5, 11, 15, 21, 25]),
    ] {
        let levels = levels.into_iter().cycle();
        let edges: Vec<_> = times.iter().copied().zip(levels).collect();
        let mut bench = TimerBench::new(TimerId::Tim3);
        bench.write(&[(ARR, 9), (CCR1, 4), (CCER, ccer)]);
        bench.effects.clear();
        bench.write(&[(CCMR1, mode << 4), (CR1, CEN)]).pass(29);
        assert_eq!(bench.drives(Signal::Tim3Ch1), edges, "{mode} {ccer}");
    }
}

#[test]
fn break_disables_the_outputs_until_inactive_and_moe_is_set_again() {
    let mut bench = centred(1, 0);
    bench.write(&[(BDTR, MOE | OSSI | BKE | BKP), (DIER, BREAK)]);
    bench.effects.clear();
    bench.pass(11).input(Signal::Tim1Bkin, true);
    assert_eq!(bench.drives(Signal::Tim1Ch1), [(11, Low)]);
    assert!(bench.shared.is_high(Interrupt::Tim1Break));
    bench.write(&[(SR, 0), (BDTR, MOE | OSSI | BKE | BKP)]);
    assert_eq!(bench.read(BDTR) & MOE, 0);
    assert_eq!(bench.read(SR) & BREAK, BREAK);
    bench.input(Signal::Tim1Bkin, false);
    assert_eq!(bench.read(BDTR) & MOE, 0);
    bench.write(&[(SR, 0), (BDTR, MOE | OSSI | BKE | BKP)]);
    assert_eq!(bench.read(BDTR) & MOE, MOE);
    assert_eq!(bench.read(SR) & BREAK, 0);
    assert_eq!(bench.drives(Signal::Tim1Ch1), [(11, High)]);
    // Updates continue during the break.
    bench.pass(450);
    assert_eq!(bench.times(TRGO1), [101, 201, 301, 401]);
}

#[test]
fn break_without_ossi_releases_the_pin() {
    let mut bench = centred(1, 0);
    bench.write(&[(BDTR, MOE | BKE)]);
    assert_eq!(bench.read(BDTR) & MOE, 0, "low is active and it is low");
    assert_eq!(bench.timer.channels[0].drive, Open);
    let mut bench = centred(1, 0);
    bench.write(&[(EGR, BREAK)]);
    assert_eq!(bench.read(BDTR) & MOE, 0);
    assert_eq!(bench.read(SR) & BREAK, BREAK);
}

#[test]
fn clock_failure_triggers_the_break_if_enabled() {
    let mut bench = centred(1, 0);
    bench.timer.clock_failure(&mut bench.shared);
    assert_eq!(bench.read(BDTR) & MOE, MOE, "the break is off");
    bench.write(&[(BDTR, MOE | OSSI | BKE | BKP)]);
    bench.timer.clock_failure(&mut bench.shared);
    assert_eq!(bench.read(BDTR) & MOE, 0);
}

#[test]
fn reference_of_channel_4_triggers_once_per_period() {
    let mut bench = centred(1, 0);
    bench.write(&[(BDTR, 0), (CCMR2, 0x7800), (CCR4, 90), (CR2, 7 << 4)]);
    bench.pass(START + 700);
    // The first trigger is immediate, because no compare value is loaded yet. The other triggers occur at count 90 on
    // the way up, with the outputs off.
    assert_eq!(bench.times(TRGO1), [0, 291, 491, 691]);
    let falls = Effect::Trigger {
        timer: TimerId::Tim1,
        rises: false,
    };
    assert_eq!(bench.times(falls), [111, 311, 511]);
}

#[test]
fn trigger_output_follows_software_update_enable_and_compare() {
    let mut bench = TimerBench::new(TimerId::Tim4);
    let trgo = Effect::Trigger {
        timer: TimerId::Tim4,
        rises: true,
    };
    bench.pass(5).write(&[(ARR, 9), (CCR1, 3), (EGR, 1)]);
    assert_eq!(bench.times(trgo), [5]);
    bench.pass(7).write(&[(CR2, 1 << 4), (CR1, CEN)]);
    assert_eq!(bench.times(trgo), [5, 7]);
    bench.write(&[(CR2, 3 << 4)]).pass(25);
    // The counter started at cycle 8; the compare value 3 matches once in each period of ten cycles.
    assert_eq!(bench.times(trgo), [5, 7, 11, 21]);
}

#[test]
fn halted_or_gated_timer_stops() {
    let mut bench = TimerBench::new(TimerId::Tim5);
    bench.write(&[(PSC, 9), (EGR, 1), (CR1, CEN)]).pass(26);
    bench.timer.freeze(true, &mut bench.shared);
    bench.pass(1000);
    assert_eq!(bench.read(CNT), 2);
    bench.timer.freeze(false, &mut bench.shared);
    bench.timer.gate(true, &mut bench.shared);
    bench.pass(2000);
    bench.timer.gate(false, &mut bench.shared);
    bench.pass(2004);
    assert_eq!(bench.read(CNT), 2);
    bench.pass(2005);
    assert_eq!(bench.read(CNT), 3);
}

#[test]
fn halted_tim1_has_its_outputs_off() {
    let mut bench = TimerBench::new(TimerId::Tim1);
    // The output of channel 1 is always high: the counter stays below the compare value.
    bench.write(&[
        (CCR1, 0xffff),
        (CCMR1, 0x60),
        (CCER, 1),
        (BDTR, MOE | OSSI),
        (CR1, CEN),
    ]);
    let drives = |bench: &TimerBench| bench.timer.channels[0].drive;
    assert_eq!(drives(&bench), Drive::High);
    bench.timer.freeze(true, &mut bench.shared);
    assert_eq!(drives(&bench), Drive::Low);
    assert_eq!(bench.read(BDTR) & MOE, MOE);
    bench.timer.freeze(false, &mut bench.shared);
    assert_eq!(drives(&bench), Drive::High);
}

#[test]
fn clock_change_affects_only_later_counts() {
    let mut bench = TimerBench::new(TimerId::Tim2);
    bench.write(&[(CR1, CEN)]).pass(101);
    bench.shared.clocks.timer1 = 4;
    bench.timer.clocks_changed(&mut bench.shared);
    bench.pass(301);
    assert_eq!(bench.read(CNT), 150);
}

#[test]
fn encoder_counts_filtered_edges_in_both_directions_and_wraps() {
    let mut bench = TimerBench::new(TimerId::Tim3);
    bench.write(&[(CCMR1, 0xf1f1), (CCER, 0x11), (SMCR, 3), (CR1, CEN)]);
    use Signal::{Tim3Ch1 as A, Tim3Ch2 as B};
    bench.pass(1000).input(A, true);
    // The filter samples every 32 cycles from 1024 on; the eighth sample is at 1248.
    bench.pass(1247);
    assert_eq!(bench.read(CNT), 0);
    bench.pass(1248);
    assert_eq!(bench.read(CNT), 1);
    bench.pass(2000).input(B, true);
    // This pulse of three cycles ends before the filter takes eight samples.
    bench.pass(3000).input(A, false).pass(3003).input(A, true);
    assert_eq!(bench.pass(4000).read(CNT), 2);
    bench.input(A, false).pass(5000).input(B, false);
    assert_eq!(bench.pass(6000).read(CNT), 4);
    // The encoder turns backward, so the count passes below zero.
    let backward = [(B, true), (A, true), (B, false), (A, false)];
    for (k, &(signal, level)) in backward.iter().cycle().take(6).enumerate() {
        bench.input(signal, level).pass(7000 + 1000 * k as u64);
    }
    assert_eq!((bench.read(CNT), bench.read(CR1) & DIR), (0xfffe, DIR));
    assert_eq!(bench.read(SR) & UPDATE, UPDATE);
    assert!(bench.shared.kinds().is_empty());
}

#[test]
fn inverted_polarity_reverses_an_encoder() {
    use Signal::{Tim4Ch1 as A, Tim4Ch2 as B};
    for (ccer, count) in [(0, 4), (2, -4)] {
        let mut bench = TimerBench::new(TimerId::Tim4);
        bench.write(&[(CCMR1, 0x101), (CCER, ccer), (SMCR, ENCODER), (CR1, CEN)]);
        bench.write(&[(CNT, 100)]);
        for (signal, level) in [(A, true), (B, true), (A, false), (B, false)] {
            bench.input(signal, level);
        }
        let expected = 100u32.wrapping_add_signed(count);
        assert_eq!(bench.read(CNT), expected, "{ccer}");
    }
}

#[test]
fn unmodelled_or_forbidden_settings_are_findings() {
    for (kind, writes) in [
        (Finding::NotModelled, vec![(DIER, 1 << 8)]),
        (Finding::NotModelled, vec![(SMCR, 4)]),
        (Finding::NotModelled, vec![(SMCR, 1)]),
        (Finding::NotModelled, vec![(CCMR1, 0x30)]),
        (
            Finding::NotModelled,
            vec![(CCMR1, 1), (CCER, 1), (CR1, CEN)],
        ),
        (Finding::NotModelled, vec![(CCMR1, 0x80)]),
        (Finding::NotModelled, vec![(CR2, TI1S)]),
        (Finding::NotModelled, vec![(CR1, OPM)]),
        (Finding::NotModelled, vec![(CCER, 4)]),
        (Finding::NotModelled, vec![(BDTR, AOE)]),
        (Finding::NotModelled, vec![(BDTR, LOCK)]),
        (Finding::Forbidden, vec![(CR1, CEN), (CR1, CEN | 1 << 5)]),
    ] {
        let mut bench = TimerBench::new(TimerId::Tim1);
        bench.write(&writes);
        assert_eq!(bench.shared.kinds(), [kind], "{writes:?}");
    }
}
