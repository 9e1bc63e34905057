use super::*;

/// Masks of the default strip's gauges, and of the largest number of gauges.
const FIVE: GaugeMask = GaugeMask(0b11111);
const ALL: GaugeMask = GaugeMask(0xff);

fn monitor() -> Monitor {
    Config::default().build().unwrap()
}

fn only(i: usize, fault: Fault) -> [Fault; MAX_GAUGES] {
    core::array::from_fn(|j| if i == j { fault } else { Fault::None })
}

#[test]
fn sample_fault_is_reported_after_5_bad_periods_and_ends_after_50_good_ones() {
    let monitor = monitor();
    for gauge in 0..MAX_GAUGES {
        for fault in [Fault::Missing, Fault::Saturated, Fault::OutOfRange] {
            let (mut state, mut foreign) = (State::default(), State::default());
            for (verdict, periods, reported) in [
                (fault, 4, Fault::None),
                (Fault::None, 1, Fault::None),
                (fault, 4, Fault::None),
                (fault, 1, fault),
                (Fault::None, 49, fault),
                (fault, 1, fault),
                (Fault::None, 49, fault),
                (Fault::None, 1, Fault::None),
                (fault, 4, Fault::None),
                (fault, 300, fault),
                (Fault::None, 300, Fault::None),
                // Bad periods of any kind count; the latest fault is reported.
                (Fault::Missing, 2, Fault::None),
                (Fault::Saturated, 2, Fault::None),
                (Fault::OutOfRange, 1, Fault::OutOfRange),
                (fault, 1, fault),
            ] {
                for _ in 0..periods {
                    monitor.close_period(&mut state, ALL, &only(gauge, verdict));
                    let others = ALL.without(gauge);
                    monitor.close_period(&mut foreign, others, &only(gauge, verdict));
                }
                assert_eq!(state.faults(), only(gauge, reported), "{verdict:?}");
                assert_eq!(state.latched(), GaugeMask::NONE);
                assert_eq!(foreign.faults(), [Fault::None; MAX_GAUGES]);
            }
        }
    }
}

#[test]
fn latched_fault_outlasts_good_and_bad_samples() {
    let monitor = monitor();
    for fault in [Fault::Dead, Fault::Inconsistent] {
        let mut state = State::default();
        state.latch(6, fault);
        for verdict in [Fault::Saturated, Fault::None] {
            for _ in 0..100 {
                monitor.close_period(&mut state, ALL, &only(6, verdict));
            }
            assert_eq!(state.faults(), only(6, fault));
            assert_eq!(state.latched(), GaugeMask(0b100_0000));
        }
    }
}

/// Runs a window of 50 periods in which the counts of each gauge cover its range. Asserts that nothing changes before
/// the last period.
fn pass_window(monitor: &Monitor, state: &mut State, mask: GaugeMask, ranges: [i32; MAX_GAUGES]) {
    for period in 0..50 {
        let before = (state.flat, state.faults);
        for (i, range) in ranges.into_iter().enumerate().filter(|it| it.1 != NONE) {
            // Counts in the middle, then at the upper and at the lower end of the range.
            let offset = [range / 2, range, 0][(period as usize / 10).min(2)];
            state.add_sample(i, 2000 + offset);
        }
        assert_eq!((state.flat, state.faults), before, "{period}");
        monitor.close_period(state, mask, &[Fault::None; MAX_GAUGES]);
        if period < 49 {
            assert_eq!((state.flat, state.faults), before, "{period}");
        }
    }
}

/// Range of a gauge without samples.
const NONE: i32 = -1;

#[test]
fn flat_gauge_is_suspect_or_dead_by_the_number_of_gauges_and_the_motion_of_the_others() {
    const N: i32 = NONE;
    let (suspect, dead) = (0b1, 0b1);
    let monitor = monitor();
    for (ranges, suspects, deads) in [
        // Of four other gauges, two must move.
        ([0, 60, 60, 60, 60, N, N, N], suspect, 0),
        ([0, 60, 1, 1, 60, N, N, N], suspect, 0),
        ([0, 59, 59, 1, 60, N, N, N], 0, 0),
        ([0, 59, 59, 59, 59, N, N, N], 0, 0),
        ([1, 60, 60, 60, 60, N, N, N], 0, 0),
        ([0, 0, 60, 60, 1, N, N, N], 0b11, 0),
        ([0, 0, 0, 60, 1, N, N, N], 0, 0),
        ([0, 0, 0, 0, 0, N, N, N], 0, 0),
        // Of five, three and seven other gauges, three, two and four must move.
        ([0, 60, 60, 1, 1, 1, N, N], 0, 0),
        ([0, 60, 60, 60, 1, 1, N, N], suspect, 0),
        ([0, 60, 1, 1, N, N, N, N], 0, 0),
        ([0, 60, 60, 1, N, N, N, N], suspect, 0),
        ([0, 60, 60, 60, 1, 1, 1, 1], 0, 0),
        ([0, 60, 60, 60, 60, 1, 1, 1], suspect, 0),
        // Too few other gauges for a comparison.
        ([0, 60, 1, N, N, N, N, N], 0, dead),
        ([0, 59, 59, N, N, N, N, N], 0, 0),
        ([0, 0, 60, N, N, N, N, N], 0, 0b11),
        ([0, 60, N, N, N, N, N, N], 0, dead),
        ([0, 59, N, N, N, N, N, N], 0, 0),
        ([0, N, N, N, N, N, N, N], 0, 0),
    ] {
        for shift in 0..MAX_GAUGES as u32 {
            let mut rotated = ranges;
            rotated.rotate_right(shift as usize);
            let mut state = State::default();
            pass_window(&monitor, &mut state, ALL, rotated);
            let expected: [u8; 2] = [suspects, deads];
            let [suspects, deads] = expected.map(|mask| GaugeMask(mask.rotate_left(shift)));
            assert_eq!(state.flat, suspects, "{rotated:?}");
            assert_eq!(state.latched(), deads, "{rotated:?}");
            // The next window, with all gauges at rest, does not use the counts of this window.
            pass_window(&monitor, &mut state, ALL, [0; MAX_GAUGES]);
            assert_eq!((state.flat, state.latched()), (GaugeMask::NONE, deads));
        }
    }
}

#[test]
fn flatness_ignores_foreign_and_latched_gauges_but_counts_faulty_gauges() {
    let monitor = monitor();
    let ranges = [0, 60, 60, 1, 1, 0, 0, 0];
    for (mask, fault, suspects, deads) in [
        (FIVE, Fault::None, 0b1, 0),
        (GaugeMask(0b111), Fault::None, 0, 0b1),
        (FIVE, Fault::Saturated, 0b1, 0),
        // One of the two moving gauges is latched: only one of the three other gauges moves.
        (FIVE, Fault::Dead, 0, 0b10),
        (FIVE, Fault::Inconsistent, 0, 0b10),
        (GaugeMask(0b1111), Fault::Dead, 0, 0b11),
    ] {
        let mut state = State::default();
        state.faults[1] = fault;
        pass_window(&monitor, &mut state, mask, ranges);
        assert_eq!(state.flat, GaugeMask(suspects), "{mask:?} {fault:?}");
        assert_eq!(state.latched(), GaugeMask(deads), "{mask:?} {fault:?}");
    }
    // The range of extreme counts does not overflow.
    let mut state = State::default();
    for count in [i32::MAX, i32::MIN] {
        state.add_sample(0, count);
    }
    pass_window(&monitor, &mut state, FIVE, [60, 0, 60, 60, 60, 0, 0, 0]);
    assert_eq!(state.flat, GaugeMask(0b10));
}

/// Contradicting fits are counted within one spell of flatness, over any number of windows.
#[test]
fn contradictions_of_a_suspect_count_until_it_moves() {
    let monitor = monitor();
    let flat = [0, 60, 60, 60, 60, NONE, NONE, NONE];
    let moving = [60; MAX_GAUGES];
    for (between, dead) in [(flat, true), (moving, false)] {
        let mut state = State::default();
        for (ranges, fits) in [(flat, 4), (between, 0), (flat, 1)] {
            pass_window(&monitor, &mut state, ALL, ranges);
            (0..fits).for_each(|_| monitor.add_flat_difference(&mut state, 0, 1e-3));
        }
        assert_eq!(state.latched() == GaugeMask(1), dead);
    }
}

#[test]
fn suspects_take_turns_by_the_period() {
    let monitor = monitor();
    let mut state = State {
        flat: GaugeMask(0b1_0010),
        ..State::default()
    };
    let turns = [1, 1, 4, 4, 4, 1, 1, 1, 1, 1, 4].map(|expected| {
        let suspect = state.suspect();
        monitor.close_period(&mut state, FIVE, &[Fault::None; MAX_GAUGES]);
        (suspect, Some(expected))
    });
    assert!(turns.iter().all(|turn| turn.0 == turn.1), "{turns:?}");
    state.flat = GaugeMask::NONE;
    assert_eq!(state.suspect(), None);
}

#[test]
fn suspect_is_dead_after_5_fits_in_a_row_that_contradict_it() {
    let monitor = monitor();
    let (within, beyond) = (2e-5f32, 2e-5f32.next_up());
    for gauge in 0..MAX_GAUGES {
        for sign in [1.0, -1.0] {
            let mut state = State {
                flat: ALL,
                ..State::default()
            };
            for (difference, fits, dead) in [
                (within, 9, false),
                (beyond, 4, false),
                (within, 1, false),
                (beyond, 4, false),
                (f32::NAN, 1, false),
                (f32::INFINITY, 4, false),
                (beyond, 1, true),
            ] {
                for _ in 0..fits {
                    // A second suspect, whose fits agree with its readings, is counted separately.
                    monitor.add_flat_difference(&mut state, (gauge + 1) % MAX_GAUGES, within);
                    monitor.add_flat_difference(&mut state, gauge, sign * difference);
                }
                let fault = if dead { Fault::Dead } else { Fault::None };
                assert_eq!(state.faults(), only(gauge, fault), "{difference}");
                let suspects = if dead { ALL.without(gauge) } else { ALL };
                assert_eq!(state.flat, suspects);
            }
        }
    }
}

#[test]
fn search_begins_with_the_fifth_bad_fit_in_a_row_of_5_or_more_gauges() {
    let monitor = monitor();
    let (good, bad) = (30.0f32, 30.0f32.next_up());
    for (used, searched) in [
        (FIVE, Some(0)),
        (ALL, Some(0)),
        (GaugeMask(0b1111_1000), Some(3)),
        (GaugeMask(0b1111), None),
        (GaugeMask(0b1111_0000), None),
    ] {
        for residual in [bad, f32::INFINITY, f32::NAN] {
            let mut state = State::default();
            for (chi_square, fits) in [(good, 9), (residual, 4), (good, 1), (residual, 4)] {
                for _ in 0..fits {
                    assert_eq!(monitor.add_residual(&mut state, used, chi_square), None);
                }
            }
            for _ in 0..300 {
                assert_eq!(monitor.add_residual(&mut state, used, residual), searched);
            }
            assert_eq!(monitor.add_residual(&mut state, used, good), None);
        }
    }
}

/// A state in which the search begins with the next bad fit.
fn before_search() -> State {
    State {
        inconsistent_periods: 4,
        ..State::default()
    }
}

/// One round of the search, with the residuals without each gauge.
fn search(state: &mut State, used: GaugeMask, residuals: [f32; MAX_GAUGES]) {
    let monitor = monitor();
    for i in used.iter() {
        assert_eq!(monitor.add_residual(state, used, 900.0), Some(i));
        monitor.add_residual_without(state, used, i, residuals[i]);
    }
}

/// Residuals that are `best` without gauge `i`, and 200 without others.
fn small_without(i: usize, best: f32) -> [f32; MAX_GAUGES] {
    core::array::from_fn(|j| if i == j { best } else { 200.0 })
}

#[test]
fn gauge_that_alone_explains_the_residual_is_inconsistent_after_2_rounds() {
    for (used, faulty, other) in [(FIVE, 0, 1), (FIVE, 4, 0), (FIVE, 2, 3), (ALL, 7, 2)] {
        for (best, second, latched) in [
            (1.0, 200.0, true),
            (15f32.next_down(), 200.0, true),
            (15.0, 200.0, false),
            (1.0, 16f32.next_up(), true),
            (1.0, 16.0, false),
            (1.0, 1.0, false),
            (f32::NAN, 200.0, false),
            (1.0, f32::INFINITY, false),
        ] {
            let mut residuals = small_without(faulty, best);
            residuals[other] = second;
            if second == f32::INFINITY {
                // No fit without one gauge has a small residual.
                residuals = small_without(faulty, f32::INFINITY);
            }
            let mut state = before_search();
            search(&mut state, used, residuals);
            assert_eq!(state.latched(), GaugeMask::NONE);
            search(&mut state, used, residuals);
            let fault = if latched {
                Fault::Inconsistent
            } else {
                Fault::None
            };
            assert_eq!(state.faults(), only(faulty, fault), "{best} {second}");
        }
    }
}

#[test]
fn verdicts_must_be_consecutive_and_against_one_gauge() {
    let (third, first, unclear) = (
        small_without(3, 1.0),
        small_without(0, 1.0),
        [200.0; MAX_GAUGES],
    );
    for (rounds, latched) in [
        (&[third, third][..], Some(3)),
        (&[third, unclear, third], None),
        (&[third, unclear, third, third], Some(3)),
        (&[third, first, third, first], None),
        (&[third, first, first], Some(0)),
    ] {
        let mut state = before_search();
        for residuals in rounds {
            search(&mut state, FIVE, *residuals);
        }
        let expected = latched.map_or(GaugeMask::NONE, |i| GaugeMask::NONE.with(i));
        assert_eq!(state.latched(), expected);
    }
}

/// Each interruption comes after a verdict against gauge 6 and in the middle of the next round.
#[test]
fn search_begins_anew_after_a_good_fit_and_after_a_dead_gauge() {
    let monitor = monitor();
    for dead in [false, true] {
        let mut state = before_search();
        let mut used = ALL;
        search(&mut state, used, small_without(6, 1.0));
        for i in 0..3 {
            assert_eq!(monitor.add_residual(&mut state, used, 900.0), Some(i));
            monitor.add_residual_without(&mut state, used, i, 200.0);
        }
        if dead {
            for _ in 0..5 {
                monitor.add_flat_difference(&mut state, 2, 1e-3);
            }
            used = used.without(2);
        } else {
            assert_eq!(monitor.add_residual(&mut state, used, 30.0), None);
            for _ in 0..4 {
                assert_eq!(monitor.add_residual(&mut state, used, 900.0), None);
            }
        }
        search(&mut state, used, small_without(6, 1.0));
        assert!(!state.latched().contains(6));
        search(&mut state, used, small_without(6, 1.0));
        assert!(state.latched().contains(6));
        // The search continues among the other gauges.
        used = used.without(6);
        search(&mut state, used, small_without(0, 1.0));
        assert!(!state.latched().contains(0));
        search(&mut state, used, small_without(0, 1.0));
        assert!(state.latched().contains(0));
    }
}

#[test]
fn round_with_a_changed_set_of_gauges_gives_no_verdict() {
    let monitor = monitor();
    let (six, last_five) = (GaugeMask(0b11_1111), GaugeMask(0b11_1110));
    for (before, after) in [(last_five, six), (six, last_five)] {
        let mut state = before_search();
        let residuals = small_without(3, 1.0);
        search(&mut state, before, residuals);
        for i in six.iter() {
            let used = if i < 3 { before } else { after };
            if used.contains(i) {
                monitor.add_residual_without(&mut state, used, i, residuals[i]);
            }
        }
        assert_eq!(state.latched(), GaugeMask::NONE);
        search(&mut state, after, residuals);
        assert_eq!(state.latched(), GaugeMask::NONE);
        search(&mut state, after, residuals);
        assert_eq!(state.latched(), GaugeMask(0b1000));
    }
    // A gauge that is added between two rounds does not discard the first verdict.
    let mut state = before_search();
    for used in [FIVE, six] {
        assert_eq!(state.latched(), GaugeMask::NONE);
        search(&mut state, used, small_without(3, 1.0));
    }
    assert_eq!(state.latched(), GaugeMask(0b1000));
    // The last gauge of the round is no longer used.
    let mut state = before_search();
    for i in 0..5 {
        monitor.add_residual_without(&mut state, six, i, 200.0);
    }
    assert_eq!(monitor.add_residual(&mut state, FIVE, 900.0), Some(0));
}

#[test]
fn configuration_out_of_range_is_named() {
    let refusals = crate::config::refusal_of(Config::default(), |c| c.build());
    refusals.names(&[
        ("trip_periods", |c| c.trip_periods = 0),
        ("clear_periods", |c| c.clear_periods = 0),
        ("flat_window_periods", |c| c.flat_window_periods = 1),
        ("active_counts", |c| c.active_counts = 1),
        ("dead_strain", |c| c.dead_strain = f32::NAN),
        ("max_chi_square", |c| c.max_chi_square = 4.9),
        ("verdicts", |c| c.verdicts = 0),
    ]);
    let least = Config {
        active_counts: 2,
        ..Config::default()
    };
    assert!(least.build().is_ok());
}
