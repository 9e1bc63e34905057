use super::*;
use crate::control::{cascade, kinematic};
use crate::math::trig::wrap_angle;
use proptest::prelude::*;

fn frame() -> Cascade {
    cascade::Config::default().build().unwrap()
}

fn law() -> Law {
    let config = kinematic::Config {
        epsilon: 0.1,
        ..kinematic::Config::default()
    };
    config.build().unwrap()
}

fn follower(config: Config) -> Follower {
    config.build(&frame(), &law()).unwrap()
}

/// A clothoid of curvature `start + slope s`, integrated in `f64`.
fn clothoid(start: f64, slope: f64, length: f64, at: f64) -> PathPoint {
    let (mut x, mut y) = (0.0, 0.0);
    let n = 400;
    let heading = |s: f64| start * s + 0.5 * slope * s * s;
    for i in 0..n {
        let phi = heading(at * (i as f64 + 0.5) / n as f64);
        x += at / n as f64 * phi.cos();
        y += at / n as f64 * phi.sin();
    }
    assert!(at <= length);
    PathPoint {
        posture: Posture::new(x as f32, y as f32, wrap_angle(heading(at) as f32)),
        kappa: (start + slope * at) as f32,
        s: at as f32,
    }
}

/// A circle of radius 0.5 m to the left from the origin, 100 segments.
fn circle() -> PathBuffer<128> {
    let mut path = PathBuffer::new();
    let length = std::f64::consts::PI;
    for i in 0..=100 {
        path.push(clothoid(2.0, 0.0, length, length * i as f64 / 100.0))
            .unwrap();
    }
    path
}

/// A point of a path along x.
fn on_line(s: f32) -> PathPoint {
    PathPoint {
        posture: Posture::new(s, 0.0, 0.0),
        kappa: 0.0,
        s,
    }
}

fn straight<const N: usize>(points: usize, spacing: f32) -> PathBuffer<N> {
    let mut path = PathBuffer::new();
    for i in 0..points {
        path.push(on_line(i as f32 * spacing)).unwrap();
    }
    path
}

properties! { cases 64;
    /// Between its points, which are 2 cm apart, a path matches the curve of the points.
    #[test]
    fn interpolated_path_matches_the_curve(
        start in -3.0f64..3.0, slope in -3.0f64..3.0, at in 0.0f64..1.0,
    ) {
        let mut path = PathBuffer::<64>::new();
        for i in 0..=50 {
            path.push(clothoid(start, slope, 1.0, i as f64 / 50.0)).unwrap();
        }
        let exact = clothoid(start, slope, 1.0, at);
        let sample = path.at(at as f32).unwrap();
        prop_assert!(sample.posture.distance(exact.posture) < 2e-6);
        prop_assert!(wrap_angle(sample.posture.phi - exact.posture.phi).abs() < 1e-5);
        prop_assert!((sample.kappa - exact.kappa).abs() < 1e-4);
        prop_assert!((sample.kappa_slope - slope as f32).abs() < 1e-2);
    }

    /// With the lead, the manifold error of law (4) vanishes for a reference on the circle of the path.
    #[test]
    fn lead_puts_the_robot_on_the_manifold(
        kappa in -2.5f32..2.5, lateral in -0.05f32..0.05,
    ) {
        let (law, lead) = (law(), Lead::of(&law()));
        // O is beside the origin of a path that begins along x; the reference is on the path's circle.
        let ahead = lead.distance(kappa, lateral);
        let center = Posture::new(0.0, lateral, 0.0);
        let reference = Posture::ORIGIN.advance(ahead, kappa * ahead);
        let error = kinematic::PolarError::between(center, reference);
        let tolerance = 5e-3 + 0.15 * lateral.abs();
        prop_assert!(law.manifold_error(error).abs() < tolerance);
    }

    #[test]
    fn references_are_finite_for_any_posture(
        x in prop::num::f32::ANY, y in prop::num::f32::ANY, phi in prop::num::f32::ANY,
    ) {
        let mut path = circle();
        path.finish();
        let follower = follower(Config::default());
        let center = Posture::new(x, y, phi);
        match follower.step(&Progress::default(), &path, center) {
            None => prop_assert!(!center.is_finite()),
            Some((progress, out)) => {
                prop_assert!(progress.s >= 0.0 && progress.s <= path.end());
                prop_assert!(out.reference.posture.is_finite() && out.reference.v.is_finite());
            }
        }
    }

    /// Feedforward of steering: derivative of the steering angle along the path, times the speed.
    #[test]
    fn steering_rate_feedforward_matches_the_path(start in -1.0f64..1.0, slope in -2.0f64..2.0) {
        let mut path = PathBuffer::<64>::new();
        for i in 0..=50 {
            path.push(clothoid(start, slope, 1.0, i as f64 / 50.0)).unwrap();
        }
        let center = clothoid(start, slope, 1.0, 0.41).posture;
        let progress = Progress { s: 0.41, ..Progress::default() };
        let (_, out) = follower(Config::default()).step(&progress, &path, center).unwrap();
        let psi = |s: f64| f64::from(frame().steering((start + slope * s) as f32).0);
        let rate = (psi(0.42) - psi(0.40)) / 0.02 * f64::from(out.reference.v);
        prop_assert!(out.reference.v > 0.05);
        let found = f64::from(out.psi_rate);
        let bound = 0.02 * rate.abs() + 2e-3;
        prop_assert!((found - rate).abs() < bound, "{found} {rate}");
    }

    /// A robot at the reference speed with ideal steering keeps the steering limits on any path.
    #[test]
    fn reference_speed_keeps_the_steering_limits(
        bends in prop::collection::vec(-2.8f32..2.8, 3..10),
    ) {
        let mut path = PathBuffer::<512>::new();
        let mut posture = Posture::ORIGIN;
        // Between bends the curvature changes as a cosine over 40 cm.
        let mut kappa_before = 0.0;
        let mut s = 0.0f32;
        for bend in bends {
            for i in 0..40 {
                let u = i as f64 / 40.0;
                let blend = 0.5 - 0.5 * (std::f64::consts::PI * u).cos();
                let kappa = kappa_before + (bend - kappa_before) * blend as f32;
                path.push(PathPoint { posture, kappa, s }).unwrap();
                posture = posture.advance(0.01, kappa * 0.01);
                s += 0.01;
            }
            kappa_before = bend;
        }
        path.finish();
        let config = Config::default();
        let follower = follower(config);
        let mut at = 0.0f32;
        let mut speed = follower.speed(&path, at, path.end()).0;
        while at < path.end() - 0.01 {
            let next = follower.speed(&path, at, path.end()).0;
            // Braking is at most as configured, apart from steps between samples.
            prop_assert!(speed - next <= config.deceleration_m_s2 * 0.01 + 0.02);
            speed = next;
            let here = path.at(at).unwrap();
            let by_psi = frame().curvature_derivatives(frame().steering(here.kappa))[1];
            let rate = (here.kappa_slope * speed / by_psi).abs();
            prop_assert!(
                rate <= config.max_steering_rate_rad_s * 1.02
                    || speed <= config.min_speed_m_s
            );
            at += (speed * 0.01).max(1e-4);
        }
        prop_assert!(follower.speed(&path, path.end(), path.end()).0 < 1e-3);
    }
}

#[test]
fn buffer_streams_points_and_rejects_them_when_full() {
    let mut path = straight::<16>(16, 0.02);
    assert_eq!(path.push(on_line(0.32)), Err(PathError::Full));
    path.discard_before(0.1);
    assert_eq!((path.len(), path.room()), (11, 5));
    assert!((path.start() - 0.1).abs() < 1e-6);
    for i in 16..21 {
        path.push(on_line(i as f32 * 0.02)).unwrap();
    }
    assert_eq!(path.room(), 0);
    // These arc lengths go across the wrap of the ring buffer.
    for i in 0..60 {
        let s = 0.1 + i as f32 * 0.005;
        assert!((path.at(s).unwrap().posture.x - s).abs() < 1e-6);
    }
    assert_eq!(path.push(on_line(0.3)), Err(PathError::NotAdvancing));
    assert_eq!(path.push(on_line(path.end())), Err(PathError::NotAdvancing));
    path.discard_before(10.0);
    assert_eq!(path.len(), 2, "the last segment stays");
    assert_eq!(path.push(on_line(f32::NAN)), Err(PathError::NotFinite));
    path.finish();
    assert_eq!(path.push(on_line(9.0)), Err(PathError::Ended));
}

#[test]
fn path_continues_beyond_its_ends_on_the_end_circle() {
    let path = straight::<16>(11, 0.02);
    assert!((path.at(0.3).unwrap().posture.x - 0.3).abs() < 1e-6);
    assert!((path.at(-0.1).unwrap().posture.x + 0.1).abs() < 1e-6);
    assert!(PathBuffer::<4>::new().at(0.0).is_none());
    let beyond = circle().at(std::f32::consts::PI * 1.25).unwrap().posture;
    assert!(beyond.distance(Posture::new(0.5, 0.5, 0.0)) < 1e-4);
}

#[test]
fn reference_waits_for_the_robot_and_never_goes_back() {
    let path = straight::<128>(101, 0.02);
    let follower = follower(Config::default());
    let mut progress = Progress::default();
    let mut step = |x: f32, y: f32| {
        let (next, out) = follower
            .step(&progress, &path, Posture::new(x, y, 0.0))
            .unwrap();
        progress = next;
        (progress.s, out)
    };
    let (s, out) = step(0.7, 0.01);
    assert!((s - 0.7).abs() < 1e-5 && (out.lateral_error_m - 0.01).abs() < 1e-6);
    let rest = law().rest_distance();
    assert!(out.reference.posture.x > 0.7 + rest - 1e-4);
    assert!((step(0.75, 0.0).0 - 0.75).abs() < 1e-5);
    assert!((step(0.60, 0.0).0 - 0.75).abs() < 1e-5, "not back");
    // O jumps beyond the search window: progress grows by at most the window (0.1 m) plus one segment (0.02 m).
    assert!(step(1.9, 0.0).0 < 0.75 + 0.1 + 0.021);
}

#[test]
fn unfinished_path_is_driven_to_its_last_point_but_not_ended() {
    let mut path = straight::<64>(51, 0.02);
    let follower = follower(Config::default());
    let near = Posture::new(0.9995, 0.0, 0.0);
    let start = Progress {
        s: 0.95,
        started: true,
        finished: false,
    };
    let (open, out) = follower.step(&start, &path, near).unwrap();
    assert!(!open.finished && out.reference.v < 0.01);
    path.finish();
    let (end, out) = follower.step(&start, &path, near).unwrap();
    assert!(end.finished && end.s == path.end());
    assert_eq!((out.reference.v, out.v_rate), (0.0, 0.0));
    // Once finished, the path stays finished for a robot that is pushed back.
    let pushed = Posture::new(0.9, 0.0, 0.0);
    assert!(follower.step(&end, &path, pushed).unwrap().0.finished);
}

#[test]
fn trajectory_reference_matches_its_time() {
    // Constant acceleration 0.1 m/s² along x for 2 s, in points 0.1 s apart.
    let mut buffer = TrajectoryBuffer::<32>::new();
    for i in 0..=20 {
        let time_s = i as f32 * 0.1;
        let s = 0.05 * time_s * time_s;
        let point = TrajectoryPoint {
            time_s,
            v: 0.1 * time_s,
            point: on_line(s),
        };
        buffer.push(point).unwrap();
        assert_eq!(buffer.push(point), Err(PathError::NotAdvancing));
    }
    let tracker = Tracker::new(&frame(), &law(), 0.2).unwrap();
    let rest = law().rest_distance();
    for i in 1..60 {
        let t = i as f32 * 0.0333;
        let out = tracker.at(&buffer, t).unwrap();
        assert!((out.target.x - 0.05 * t * t).abs() < 1e-5);
        assert!((out.reference.v - 0.1 * t).abs() < 1e-5);
        assert!((out.acceleration - 0.1).abs() < 1e-3);
        assert!((out.reference.posture.x - out.target.x - rest).abs() < 1e-5);
        assert!(!out.finished);
    }
    assert!(tracker.at(&buffer, 2.0).unwrap().finished);
    let end = tracker.at(&buffer, 5.0).unwrap();
    assert!(end.finished && end.reference.v == 0.0 && (end.target.x - 0.2).abs() < 1e-6);
    assert!(tracker.at(&buffer, f32::NAN).is_none());
    assert!(tracker.at(&TrajectoryBuffer::<4>::new(), 0.0).is_none());
    for (key, len) in [(1.05, 11), (11.0f32 * 0.1, 10)] {
        buffer.discard_before(key);
        assert_eq!(buffer.len(), len, "{key}");
    }
}

#[test]
fn bad_configuration_is_named() {
    crate::config::refusal_of(Config::default(), |c| c.build(&frame(), &law()))
        .names(&[("min_speed_m_s", |c| c.min_speed_m_s = 0.5)]);
    assert!(Tracker::new(&frame(), &law(), f32::NAN).is_err());
}

#[test]
fn invalid_point_is_rejected() {
    let good = TrajectoryPoint {
        time_s: 1.0,
        v: 0.0,
        point: on_line(0.5),
    };
    let push = |spoil: &dyn Fn(&mut TrajectoryPoint)| {
        let mut point = good;
        spoil(&mut point);
        let path = PathBuffer::<4>::new().push(point.point);
        (TrajectoryBuffer::<4>::new().push(point), path)
    };
    assert_eq!(push(&|_| ()), (Ok(()), Ok(())));
    let bad = Err(PathError::NotFinite);
    for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        assert_eq!(push(&|p| p.point.posture.x = value), (bad, bad));
        assert_eq!(push(&|p| p.point.posture.phi = value), (bad, bad));
        assert_eq!(push(&|p| p.point.kappa = value), (bad, bad));
        assert_eq!(push(&|p| p.point.s = value), (bad, bad));
        assert_eq!(push(&|p| p.time_s = value).0, bad);
        assert_eq!(push(&|p| p.v = value).0, bad);
    }
    assert_eq!(push(&|p| p.v = -1e-6).0, bad);
    // Arc length may stay constant while time increases.
    let mut buffer = TrajectoryBuffer::<4>::new();
    for (time_s, s, expected) in [
        (1.0, 0.5, Ok(())),
        (2.0, 0.5, Ok(())),
        (3.0, 0.49, Err(PathError::NotAdvancing)),
        (2.0, 0.6, Err(PathError::NotAdvancing)),
    ] {
        let point = TrajectoryPoint {
            time_s,
            v: 0.0,
            point: on_line(s),
        };
        assert_eq!(buffer.push(point), expected, "{time_s} {s}");
    }
}

/// Reference speed of the module docs in f64: the smallest, over all points ahead, from which braking after the
/// reaction time meets the limit of the point.
fn speed_by_the_docs(config: &Config, points: &[PathPoint], s: f32, end: f64) -> f64 {
    let [a, t] = [config.deceleration_m_s2, config.reaction_time_s].map(f64::from);
    let [rate, bend] = [
        config.max_steering_rate_rad_s,
        config.max_steering_acceleration_rad_s2,
    ]
    .map(f64::from);
    // v T + (v² − limit²)/2a = distance + limit T.
    let braking = |limit: f64, distance: f64| {
        let reach = limit + a * t;
        (reach * reach + 2.0 * a * distance.max(0.0)).sqrt() - a * t
    };
    let mut speed = braking(0.0, end - f64::from(s)).min(config.max_speed_m_s.into());
    let mut before: Option<(f64, f64)> = None;
    let first = points.iter().rposition(|p| p.s <= s).unwrap_or(0);
    for pair in points[first..].windows(2) {
        let [from, to] = [0, 1].map(|i| f64::from(frame().steering(pair[i].kappa).0));
        let length = f64::from(pair[1].s) - f64::from(pair[0].s);
        let slope = (to - from) / length;
        let mut limit = rate / slope.abs().max(1e-6);
        if let Some((last, last_length)) = before {
            let second = 2.0 * (slope - last).abs() / (last_length + length);
            let left = (bend - slope.abs().max(last.abs()) * a).max(0.0);
            limit = limit.min((left / second.max(1e-6)).sqrt());
        }
        before = Some((slope, length));
        let limit = limit.max(config.min_speed_m_s.into());
        speed = speed.min(braking(limit, f64::from(pair[0].s) - f64::from(s)));
    }
    speed
}

properties! { cases 64;
    /// The path has steps of curvature and clothoids. The rate is that of a robot at the reference speed.
    #[test]
    fn speed_is_the_largest_from_which_all_limits_ahead_are_met(
        kappas in prop::collection::vec(-2.8f32..2.8, 4..8), at in 0.0f32..1.0, gentle: bool,
    ) {
        let config = Config {
            deceleration_m_s2: if gentle { 0.1 } else { 0.3 },
            max_steering_acceleration_rad_s2: if gentle { 3.0 } else { 6.0 },
            ..Config::default()
        };
        let (follower, mut path) = (follower(config), PathBuffer::<256>::new());
        let mut points = std::vec::Vec::new();
        for pair in kappas.windows(2) {
            for i in 0..20 {
                let u = if pair[0] > 1.0 { 0.0 } else { i as f32 / 20.0 };
                let s = points.len() as f32 / 64.0;
                let point = PathPoint {
                    kappa: pair[0] + u * (pair[1] - pair[0]),
                    ..on_line(s)
                };
                points.push(point);
                path.push(point).unwrap();
            }
        }
        let (end, s) = (path.end(), at * path.end());
        let (v, v_rate) = follower.speed(&path, s, end);
        let exact = speed_by_the_docs(&config, &points, s, end.into());
        prop_assert!((f64::from(v) - exact).abs() < 2e-4 * (1.0 + exact), "{v} {exact}");
        let h = 1e-4f32;
        let around = [s - h, s + h].map(|s| speed_by_the_docs(&config, &points, s, end.into()));
        let rate = (around[1] - around[0]) / (2.0 * f64::from(h)) * exact;
        // The rate jumps where the active limit changes; arc lengths near a jump are skipped.
        let smooth = [s - 3.0 * h, s + 3.0 * h].map(|s| speed_by_the_docs(&config, &points, s, end.into()));
        let wide = (smooth[1] - smooth[0]) / (6.0 * f64::from(h)) * exact;
        if s > 1e-3 && (rate - wide).abs() < 1e-3 && s < end - 1e-3 {
            prop_assert!((f64::from(v_rate) - rate).abs() < 0.02, "{v_rate} {rate}");
        }
    }
}

#[test]
fn search_for_the_robot_covers_the_window_ahead_of_the_last_point() {
    // These numbers are exact in `f32`, so that a segment begins exactly where the search window ends.
    let config = Config {
        search_window_m: 0.125,
        ..Config::default()
    };
    let path = straight::<128>(65, 1.0 / 64.0);
    let last = Progress {
        s: 0.5,
        started: true,
        finished: false,
    };
    let beyond = Posture::new(0.9, 0.0, 0.0);
    let (progress, _) = follower(config).step(&last, &path, beyond).unwrap();
    assert_eq!(progress.s, 0.5 + 0.125 + 1.0 / 64.0);
    // The first search covers the whole path.
    let (progress, _) = follower(config)
        .step(&Progress::default(), &path, beyond)
        .unwrap();
    assert!((progress.s - 0.9).abs() < 1e-5);
}

#[test]
fn speed_at_a_limit_is_the_limit_and_does_not_fall() {
    let follower = follower(Config::default());
    for (limit, distance) in [(0.1, 0.0), (0.1, -1.0), (0.0, 0.0)] {
        let (speed, rate) = follower.braking(limit, distance);
        assert!(
            (speed - limit).abs() < 1e-7 && rate == 0.0,
            "{limit} {distance}: {speed} {rate}"
        );
    }
}

/// Position and speed match the cubic, and acceleration its differences, for points that differ in heading, speed and
/// time.
#[test]
fn trajectory_position_speed_and_acceleration_are_consistent() {
    let mut buffer = TrajectoryBuffer::<8>::new();
    for (time_s, v, s) in [
        (0.5, 0.1, 0.0),
        (1.0, 0.3, 0.08),
        (2.0, 0.2, 0.4),
        (2.5, 0.0, 0.45),
    ] {
        let point = on_line(s);
        buffer.push(TrajectoryPoint { time_s, v, point }).unwrap();
        if buffer.len() > 1 {
            let [at, speed, _] = buffer.time_law(time_s - 1e-6).unwrap();
            assert!(
                (at - s).abs() < 1e-5 && (speed - v).abs() < 1e-4,
                "{time_s}"
            );
        }
    }
    for k in 0..190 {
        let t = 0.505 + 0.01 * k as f32;
        let near = |t: f32| [0.5, 1.0, 2.0].iter().any(|knot| (t - knot).abs() < 5e-3);
        let h = 2e-3;
        let [low, here, high] = [t - h, t, t + h].map(|t| buffer.time_law(t).unwrap());
        if !near(t) {
            assert!(
                ((high[0] - low[0]) / (2.0 * h) - here[1]).abs() < 2e-3,
                "{t}"
            );
            assert!(
                ((high[1] - low[1]) / (2.0 * h) - here[2]).abs() < 1e-2,
                "{t}"
            );
        }
    }
    for (time, s) in [(0.0, 0.0), (0.5, 0.0), (2.5, 0.45), (9.0, 0.45)] {
        assert_eq!(buffer.time_law(time), Some([s, 0.0, 0.0]), "{time}");
    }
}

/// At its end points and beyond, a path has a constant curvature.
#[test]
fn path_curvature_changes_between_points_only() {
    let (a, b) = (clothoid(0.0, 1.0, 1.0, 0.5), clothoid(0.0, 1.0, 1.0, 0.6));
    for (s, slope) in [
        (0.49, 0.0),
        (0.5, 0.0),
        (0.51, 1.0),
        (0.59, 1.0),
        (0.6, 0.0),
        (0.61, 0.0),
    ] {
        let found = buffer::between(a, b, s).kappa_slope;
        assert!((found - slope).abs() < 1e-5, "{s}: {found}");
    }
    // Two equal points, as for a path of one point.
    for s in [0.4, 0.5, 0.6] {
        let found = buffer::between(a, a, s);
        let exact = a.posture.advance(s - 0.5, 0.5 * (s - 0.5));
        assert!(
            found.posture.distance(exact) < 1e-6 && found.kappa == a.kappa,
            "{s}"
        );
    }
}

properties! { cases 200;
    /// The law of the module docs: heading gain per length, curvature within that of the frame, and at rest the
    /// path's curvature.
    #[test]
    fn input_is_equation_four_with_heading_gain_per_length(
        x in -0.3f32..0.0, y in -0.3f32..0.3, phi in -1.0f32..1.0, v in 0.0f32..0.3, kappa in -2.0f32..2.0,
    ) {
        let law = law();
        let center = Posture::new(x, y, phi);
        let reference = Reference { posture: Posture::new(0.05, 0.0, 0.1), v, kappa };
        let command = law.track(center, reference);
        let error = kinematic::PolarError::between(center, reference.posture);
        let by_heading = f64::from(law.config().heading_gain_rad_s)
            * (f64::from(error.theta) + f64::from(error.alpha)).tanh();
        let speed = f64::from(command.v);
        prop_assume!(speed.abs() > 2e-3);
        let turned = (f64::from(command.phi_dot) - by_heading) / speed + by_heading / 0.25 * speed.signum();
        let most = f64::from(frame().max_curvature());
        let share = (speed.abs() / 0.03).min(1.0);
        let wanted = share * turned.clamp(-most, most) + (1.0 - share) * 1.2;
        let target = PathReference { reference, kappa: 1.2, v_rate: -0.2, psi_rate: 0.3, ..PathReference::default() };
        let governor_input = follower(Config::default()).governor_input(center, &target);
        let found = f64::from(frame().curvature(governor_input.psi));
        prop_assert!((found - wanted.clamp(-most, most)).abs() < 2e-2, "{found} {wanted}");
        prop_assert_eq!((governor_input.v, governor_input.v_rate, governor_input.psi_rate), (command.v, -0.2, 0.3));
        prop_assert_eq!(governor_input.steering_slack, STEERING_SLACK_RAD);
        let tracker = Tracker::new(&frame(), &law, 0.25).unwrap();
        let target = TrajectoryReference {
            reference, kappa: 1.2, acceleration: -0.2, psi_rate: 0.3, ..TrajectoryReference::default()
        };
        prop_assert_eq!(tracker.governor_input(center, &target), governor_input);
    }
}
