use super::*;
use crate::control::funnel;
use crate::control::kinematic::PolarError;
use proptest::prelude::*;

fn search(planner: &Planner, from: Posture, budget: u32) -> (Progress, u32) {
    let mut search = planner.start(from, Posture::ORIGIN);
    for _ in 0..1_000_000 / budget {
        match planner.step(&mut search, budget) {
            Progress::Working => {}
            done => return (done, search.evaluated),
        }
    }
    panic!("no end after a million candidates");
}

properties! { cases 100;
    /// Every start within ±2 m is led into the funnel, checked by driving the segments in f64.
    #[test]
    fn any_start_is_led_into_the_funnel(
        x in -2.0f32..2.0, y in -2.0f32..2.0, phi in -3.1f32..3.1, max in 1.5f32..3.3,
    ) {
        let planner = Config::default().build(max).unwrap();
        let (progress, evaluated) = search(&planner, Posture::new(x, y, phi), 1000);
        let Progress::Found(plan) = progress else { panic!("{progress:?}") };
        prop_assert!(evaluated < 120_000, "{evaluated}");
        let mut q = [x, y, phi].map(f64::from);
        for segment in plan.segments() {
            prop_assert!(segment.curvature.abs() <= max && segment.length_m > 0.0);
            let n = 2000;
            let h = f64::from(segment.direction.sign() * segment.length_m) / n as f64;
            for _ in 0..n {
                let middle = q[2] + 0.5 * h * f64::from(segment.curvature);
                q[0] += h * middle.cos();
                q[1] += h * middle.sin();
                q[2] += h * f64::from(segment.curvature);
            }
        }
        let end = PolarError::between(q.map(|c| c as f32).into(), Posture::ORIGIN);
        let end = end.in_direction(plan.approach);
        prop_assert!(funnel::contains(end, planner.curvature() * 1.001));
        prop_assert!(end.distance_m >= 0.149);
    }

    /// The division of the work into ticks does not change the plan.
    #[test]
    fn budget_does_not_change_the_plan(
        x in -1.0f32..1.0, y in -1.0f32..1.0, phi in -3.1f32..3.1,
    ) {
        let planner = Config::default().build(3.0).unwrap();
        let from = Posture::new(x, y, phi);
        prop_assert_eq!(search(&planner, from, 7).0, search(&planner, from, 5000).0);
    }

    /// Segments a little longer or shorter cost no less.
    #[test]
    fn plan_with_slightly_changed_lengths_does_not_cost_less(
        x in -1.0f32..1.0, y in -1.0f32..1.0, phi in -3.1f32..3.1,
    ) {
        let planner = Config::default().build(3.0).unwrap();
        let mut search = planner.start(Posture::new(x, y, phi), Posture::ORIGIN);
        let Progress::Found(plan) = planner.step(&mut search, 1_000_000) else { panic!() };
        for changes in [[2e-3, 0.0], [-2e-3, 0.0], [0.0, 2e-3], [0.0, -2e-3]] {
            let (mut pose, mut spent, mut last) = (search.start, 0.0, None);
            for (segment, change) in plan.segments().zip(changes) {
                let segment = segment.with_length((segment.length_m + change).max(1e-4));
                pose = pose.compose(Pose::arc(segment));
                spent += segment.length_m + planner.config.stop_price_m;
                let turns = last.is_some_and(|last| last != segment.direction);
                spent += f32::from(u8::from(turns)) * planner.config.cusp_price_m;
                last = Some(segment.direction);
            }
            let beside = planner.evaluate(pose, spent, last, None).1;
            prop_assert!(beside.is_none_or(|(cost, _)| cost > plan.cost_m - 1e-3), "{changes:?}");
        }
    }

    /// The cost of the plan depends only on the start in the goal's frame.
    #[test]
    fn plan_moves_with_the_goal(phi in -3.0f32..3.0, gx in -5.0f32..5.0, turn in -3.0f32..3.0) {
        let planner = Config::default().build(2.0).unwrap();
        let relative = Posture::new(-0.4, 0.3, phi);
        let goal = Posture::new(gx, 1.0, turn);
        let mut moved = planner.start(goal.compose(relative), goal);
        let Progress::Found(a) = planner.step(&mut moved, 1_000_000) else { panic!() };
        let mut plain = planner.start(relative, Posture::ORIGIN);
        let Progress::Found(b) = planner.step(&mut plain, 1_000_000) else { panic!() };
        prop_assert!((a.cost_m - b.cost_m).abs() < 0.02, "{} {}", a.cost_m, b.cost_m);
    }
}

#[test]
fn start_on_the_goals_axis_needs_no_segment() {
    let planner = Config::default().build(3.0).unwrap();
    for (x, approach) in [(-1.0, Direction::Forward), (1.0, Direction::Reverse)] {
        let (progress, _) = search(&planner, Posture::new(x, 0.0, 0.0), 100);
        let Progress::Found(plan) = progress else {
            panic!()
        };
        assert_eq!(plan.segments().count(), 0);
        assert_eq!(plan.approach, approach);
        assert!((plan.cost_m - 1.0).abs() < 1e-5);
    }
}

#[test]
fn a_posture_that_is_not_finite_yields_no_plan() {
    let planner = Config::default().build(3.0).unwrap();
    let (progress, evaluated) = search(&planner, Posture::new(f32::NAN, 0.0, 0.0), 100);
    assert_eq!((progress, evaluated), (Progress::Impossible, 0));
}

/// Posture (m, m, rad) at the end of an arc.
fn drive([x, y, phi]: [f64; 3], forward: bool, curvature: f64, length: f64) -> [f64; 3] {
    let ds = if forward { length } else { -length };
    let half = 0.5 * ds * curvature;
    let chord = if half == 0.0 {
        ds
    } else {
        ds * half.sin() / half
    };
    let chord_heading = phi + half;
    [
        x + chord * chord_heading.cos(),
        y + chord * chord_heading.sin(),
        phi + 2.0 * half,
    ]
}

/// Cost of an approach from a posture to the origin in one direction, as in the docs of planner and funnel; `None`
/// outside the funnel.
fn approach_cost(
    [x, y, phi]: [f64; 3],
    forward: bool,
    last: Option<bool>,
    max: f64,
) -> Option<f64> {
    let wrap = |angle: f64| angle.sin().atan2(angle.cos());
    let (e, sight) = (x.hypot(y), (-y).atan2(-x));
    let eta = wrap(2.0 * sight - phi);
    let alpha = wrap(sight - phi + if forward { 0.0 } else { std::f64::consts::PI });
    let opposed = if alpha * eta < 0.0 { eta.abs() } else { 0.0 };
    let within = 2.0 * alpha.sin().abs() + 3.0 * eta.abs() + 0.05 <= max * e;
    if e < 0.15 || !within || alpha.abs() + opposed > 2.4 {
        return None;
    }
    let a = (alpha * alpha - 1.2 * alpha * eta + 18.0 / 35.0 * eta * eta).max(0.0);
    let a = a.sqrt().min(2.6);
    let length = if a > 1e-9 { e * a / a.sin() } else { e };
    let cusp = if last.is_some_and(|last| last != forward) {
        0.15
    } else {
        0.0
    };
    Some(length + cusp)
}

/// Starts over the planner's range. The first start may approach forward or, on a longer path, in reverse.
fn starts() -> impl Iterator<Item = [f64; 3]> {
    let beside = [-1.2f64.cos(), 1.2f64.sin(), -2.4];
    let others = (1..=40).map(|k| {
        let part = |step: f64, range: f64| range * (2.0 * (f64::from(k) * step).fract() - 1.0);
        let near = if k % 3 == 0 { 0.4 } else { 1.2 };
        [
            part(0.618_034, near),
            part(0.754_878, near),
            part(0.569_840, 3.0),
        ]
    });
    core::iter::once(beside).chain(others)
}

#[test]
fn cost_is_length_of_segments_and_approach_and_price_of_stops_and_cusps() {
    let planner = Config::default().build(3.0).unwrap();
    let (mut cusps, mut pairs) = (0, 0);
    for start in starts() {
        let from = start.map(|it| it as f32).into();
        let Progress::Found(plan) = search(&planner, from, 1000).0 else {
            panic!("{start:?}")
        };
        let (mut q, mut spent, mut last) = (start, 0.0, None);
        for segment in plan.segments() {
            let forward = segment.direction == Direction::Forward;
            let length = f64::from(segment.length_m);
            q = drive(q, forward, f64::from(segment.curvature), length);
            spent += length + 0.08;
            if last.is_some_and(|last| last != forward) {
                (spent, cusps) = (spent + 0.15, cusps + 1);
            }
            last = Some(forward);
        }
        pairs += u32::from(plan.segment(1).is_some());
        // The funnel's curvature is 1e-3 larger, as an allowance for rounding at the bound of the funnel.
        let forward = plan.approach == Direction::Forward;
        let cost = spent + approach_cost(q, forward, last, 0.94 * 3.0 + 1e-3).unwrap();
        assert!(
            (cost - f64::from(plan.cost_m)).abs() < 1e-4,
            "{start:?}: {cost} {plan:?}"
        );
    }
    assert!(cusps > 2 && pairs > 5, "{cusps} {pairs}");
}

#[test]
fn plan_costs_no_more_than_any_on_the_grid() {
    let planner = Config::default().build(3.0).unwrap();
    let curvature = 0.94 * 3.0;
    let motions = [true, false].map(|forward| [0.0, 1.0, -1.0].map(|it| (forward, it * curvature)));
    let motions = motions.concat();
    let longest = |curvature: f64| match curvature == 0.0 {
        true => 3.0,
        false => std::f64::consts::TAU / curvature.abs(),
    };
    let approach = |q, last| {
        let costs = [true, false].map(|forward| approach_cost(q, forward, last, curvature));
        costs.into_iter().flatten().fold(f64::INFINITY, f64::min)
    };
    for start in starts() {
        let mut best = approach(start, None);
        for &(forward, kappa) in &motions {
            for k in 1..=(longest(kappa) / 0.04).ceil() as u32 {
                let length = 0.04 * f64::from(k);
                let q = drive(start, forward, kappa, length);
                best = best.min(length + 0.08 + approach(q, Some(forward)));
            }
            for k in 1..=(longest(kappa) / 0.08) as u32 {
                let first = 0.08 * f64::from(k);
                let middle = drive(start, forward, kappa, first);
                // The rest of the plan costs at least the line of sight.
                if first + 0.16 + middle[0].hypot(middle[1]) >= best {
                    continue;
                }
                for &(second_forward, second_kappa) in &motions {
                    let cusp = if second_forward == forward { 0.0 } else { 0.15 };
                    for k in 1..=(longest(second_kappa) / 0.08) as u32 {
                        let second = 0.08 * f64::from(k);
                        let q = drive(middle, second_forward, second_kappa, second);
                        let spent = first + second + 0.16 + cusp;
                        best = best.min(spent + approach(q, Some(second_forward)));
                    }
                }
            }
        }
        let from = start.map(|it| it as f32).into();
        let Progress::Found(plan) = search(&planner, from, 1000).0 else {
            panic!("{start:?}")
        };
        assert!(
            f64::from(plan.cost_m) < best + 1e-3,
            "{start:?}: {} {best}",
            plan.cost_m
        );
    }
}

#[test]
fn approach_begins_at_the_least_distance_and_no_nearer() {
    let planner = Config::default().build(3.0).unwrap();
    for (x, direct) in [(0.1501, true), (0.1499, false)] {
        for sign in [1.0, -1.0] {
            let (progress, _) = search(&planner, Posture::new(sign * x, 0.0, 0.0), 100);
            let Progress::Found(plan) = progress else {
                panic!("{x}")
            };
            assert_eq!(plan.segments().count() == 0, direct, "{x}");
        }
    }
}
