use super::*;
use proptest::prelude::*;

fn law(form: Form) -> Law {
    Config {
        form,
        denominator_floor: 0.0,
        ..Config::default()
    }
    .build()
    .unwrap()
}

/// Motion of a unicycle in f64 with constant inputs, by the midpoint rule in fine substeps, without polar
/// coordinates.
fn drive(mut q: [f64; 3], v: f64, omega: f64, time: f64) -> [f64; 3] {
    let n = 20;
    let h = time / n as f64;
    for _ in 0..n {
        let middle = q[2] + 0.5 * h * omega;
        q[0] += h * v * middle.cos();
        q[1] += h * v * middle.sin();
        q[2] += h * omega;
    }
    q
}

/// e, θ, α of a posture against a reference in f64, angles not wrapped by f32 code.
fn polar(q: [f64; 3], r: [f64; 3]) -> [f64; 3] {
    let (dx, dy) = (r[0] - q[0], r[1] - q[1]);
    let sight = dy.atan2(dx);
    let wrap = |a: f64| a.sin().atan2(a.cos());
    [dx.hypot(dy), wrap(sight - r[2]), wrap(sight - q[2])]
}

properties! {
    /// In the derived form, δ̇ = −k1 tanh δ and d(θ + α)/dt = −k2 tanh(θ + α), for a reference at rest or in motion.
    /// The rates are central differences in time.
    #[test]
    fn errors_decay_as_designed(
        x in -2.0f32..2.0, y in -2.0f32..2.0, phi in -3.0f32..3.0,
        v_r in -0.3f32..0.3, kappa_r in -2.0f32..2.0,
    ) {
        let law = law(Form::Derived);
        let posture = Posture::new(x, y, phi);
        let error = PolarError::between(posture, Posture::new(0.3, -0.2, 0.7));
        let command = law.command(error, v_r, kappa_r);
        let (s, c) = (error.theta.sin(), error.alpha.cos());
        let shape = (1e-3 + 2.0 * s * s).sqrt();
        let denominator = error.distance_m * shape * c
            + 0.2 * SQRT_2 * (2.0 * error.theta).sin() * error.alpha.sin();
        prop_assume!(error.distance_m > 0.3 && denominator.abs() > 0.1);
        prop_assume!((error.theta + error.alpha).abs() < 3.0);
        prop_assume!(error.theta.abs() < 3.0 && error.alpha.abs() < 3.0);

        let q = [x, y, phi].map(f64::from);
        let r = [0.3f32, -0.2, 0.7].map(f64::from);
        let h = 1e-4;
        let at = |time: f64| {
            let q = drive(q, command.v.into(), command.phi_dot.into(), time);
            let r = drive(r, v_r.into(), f64::from(v_r) * f64::from(kappa_r), time);
            let [e, theta, alpha] = polar(q, r);
            let delta = e - 0.2 * (2.0 * (1.001 - (2.0 * theta).cos())).sqrt();
            [delta, theta + alpha]
        };
        let (before, now, after) = (at(-h), at(0.0), at(h));
        let delta_dot = (after[0] - before[0]) / (2.0 * h);
        let sum_dot = (after[1] - before[1]) / (2.0 * h);
        prop_assert!((delta_dot + 1.5 * now[0].tanh()).abs() < 2e-4, "{delta_dot} {}", now[0]);
        prop_assert!((sum_dot + 2.0 * now[1].tanh()).abs() < 2e-4, "{sum_dot} {}", now[1]);
    }

    /// Along the approach path, dη/ds = −p η/e.
    #[test]
    fn arrival_error_decays_along_the_approach_path(
        x in -2.0f32..2.0, y in -2.0f32..2.0, phi in -3.0f32..3.0, reverse: bool,
    ) {
        let law = Config { softening_m: 0.0, ..Config::default() }.build().unwrap();
        let direction = if reverse { Direction::Reverse } else { Direction::Forward };
        let posture = Posture::new(x, y, phi);
        let error = PolarError::between(posture, Posture::ORIGIN);
        prop_assume!(error.distance_m > 0.3 && error.arrival().abs() < 3.0);
        let kappa = f64::from(direction.sign() * law.approach_curvature(error.in_direction(direction)));
        let h = 1e-4;
        let eta = |ds: f64| {
            let signed = ds * f64::from(direction.sign());
            let q = drive([x, y, phi].map(f64::from), signed / h, signed / h * kappa, h);
            let [_, theta, alpha] = polar(q, [0.0; 3]);
            (theta + alpha).sin().atan2((theta + alpha).cos())
        };
        let slope = (eta(h) - eta(-h)) / (2.0 * h);
        let expected = -3.0 * eta(0.0) / f64::from(error.distance_m);
        prop_assert!((slope - expected).abs() < 1e-3 * (1.0 + expected.abs()), "{slope} {expected}");
    }

    #[test]
    fn every_input_gives_a_finite_command(
        x in proptest::num::f32::ANY, y in proptest::num::f32::ANY,
        phi in proptest::num::f32::ANY, v_r in proptest::num::f32::ANY,
        kappa_r in proptest::num::f32::ANY, printed: bool,
    ) {
        let law = law(if printed { Form::Printed } else { Form::Derived });
        let posture = Posture::new(x, y, phi);
        let limits = LimitsConfig::default().build().unwrap();
        let error = PolarError::between(posture, Posture::ORIGIN);
        for command in [
            law.command(error, v_r, kappa_r),
            law.approach(error, Direction::Forward),
            law.approach(error, Direction::Reverse),
        ] {
            prop_assert!(command.v.is_finite() && command.kappa.is_finite());
            prop_assert!(command.phi_dot.is_finite());
            let limited = limits.limit(command);
            prop_assert!(limited.v.abs() <= 0.25);
            prop_assert!(limited.kappa.abs() <= limits.max_curvature());
        }
    }

    /// If only the speed is beyond its bound, the commanded curvature is kept.
    #[test]
    fn limits_keep_the_path(v in -3.0f32..3.0, kappa in -3.0f32..3.0) {
        let limits = Limits { max_speed: 0.25, max_curvature: 3.0 };
        let out = limits.limit(Command { v, kappa, phi_dot: v * kappa });
        prop_assert!((out.phi_dot - out.v * kappa).abs() < 1e-6);
        prop_assert!(out.v * v >= 0.0);
    }
}

#[test]
fn degenerate_points_are_finite() {
    for form in [Form::Derived, Form::Printed] {
        let law = law(form);
        let at_goal = law.track(Posture::ORIGIN, Reference::default());
        assert_eq!(at_goal, Command::REST);
        // Abeam of the goal, where the derived denominator passes zero.
        let error = PolarError {
            distance_m: 0.5,
            theta: 0.0,
            alpha: PI / 2.0,
        };
        let command = law.command(error, 0.0, 0.0);
        assert!(command.v.is_finite() && command.kappa.is_finite());
    }
}

#[test]
fn floor_keeps_the_velocity_towards_the_goal_bounded() {
    let law = Config::default().build().unwrap();
    for i in -300..=300 {
        let error = PolarError {
            distance_m: 1.0,
            theta: 0.3,
            alpha: i as f32 * 0.01,
        };
        let v = law.command(error, 0.0, 0.0).v;
        assert!((0.0..=1.5 / 0.3).contains(&v), "{v}");
    }
}

#[test]
fn a_reference_ahead_is_trailed_at_the_rest_distance() {
    let law = Config::default().build().unwrap();
    let rest = law.rest_distance();
    assert!((rest - 0.2 * (2.0f32 * 1e-3).sqrt()).abs() < 1e-7);
    let reference = Reference {
        posture: Posture::new(rest, 0.0, 0.0),
        v: 0.2,
        kappa: 0.0,
    };
    let command = law.track(Posture::ORIGIN, reference);
    assert!((command.v - 0.2).abs() < 1e-5 && command.kappa.abs() < 1e-5);
}

/// The robot catches up with a led reference on a circle or a line, forward or in reverse, and then follows it within
/// 3 mm.
#[test]
fn a_moving_reference_is_followed() {
    let law = Config::default().build().unwrap();
    let limits = Limits {
        max_speed: 0.4,
        max_curvature: 3.0,
    };
    for v_r in [0.2f32, -0.2] {
        for kappa_r in [0.0f32, 1.0, -0.5] {
            let (mut q, mut r) = ([-0.3f64 * f64::from(v_r.signum()), 0.15, 0.2], [0.0f64; 3]);
            for _ in 0..6000 {
                // The reference is led by the distance at which O trails it.
                let ahead = law.rest_distance().copysign(v_r);
                let led = Reference {
                    posture: Posture::from(r.map(|c| c as f32)).advance(ahead, ahead * kappa_r),
                    v: v_r,
                    kappa: kappa_r,
                };
                let command = limits.limit(law.track(Posture::from(q.map(|c| c as f32)), led));
                q = drive(q, command.v.into(), command.phi_dot.into(), 5e-3);
                r = drive(r, v_r.into(), f64::from(v_r * kappa_r), 5e-3);
            }
            let off = (q[0] - r[0]).hypot(q[1] - r[1]);
            assert!(off < 3e-3, "{v_r} {kappa_r}: {off}");
            assert!((q[2] - r[2]).abs() < 0.03, "{v_r} {kappa_r}: {q:?} {r:?}");
        }
    }
}

#[test]
fn bad_gains_are_named() {
    crate::config::refusal_of(Config::default(), |c| c.build())
        .names(&[("epsilon", |c| c.epsilon = f32::NAN)]);
    crate::config::refusal_of(LimitsConfig::default(), |c| c.build())
        .names(&[("max_steering_rad", |c| c.max_steering_rad = 1.6)]);
}

#[test]
fn steering_bound_gives_the_curvature_bound() {
    // 2 · 0.5 / (0.37 · cos 0.5) by hand.
    let limits = LimitsConfig::default().build().unwrap();
    assert!((limits.max_curvature() - 3.079_7).abs() < 1e-3);
}

#[test]
fn error_without_a_line_of_sight_is_that_of_the_headings() {
    let reference = Posture::new(0.3, -0.2, 0.7);
    let error = PolarError::between(Posture::new(0.3, -0.2, 0.5), reference);
    assert_eq!((error.distance_m, error.theta), (0.0, 0.0));
    assert!((error.alpha - 0.2).abs() < 1e-6);
}

#[test]
fn command_with_a_number_that_is_not_finite_is_rest() {
    let limits = LimitsConfig::default().build().unwrap();
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        for (v, kappa) in [(bad, 0.1), (0.1, bad)] {
            let command = Command {
                v,
                kappa,
                phi_dot: 0.0,
            };
            assert_eq!(limits.limit(command), Command::REST, "{v} {kappa}");
        }
    }
}

/// Equation 4 with the guards of its docs, in f64.
fn equation_four(c: &Config, [e, theta, alpha]: [f64; 3], v_r: f64, kappa_r: f64) -> [f64; 2] {
    let [r, k1, k2] = [c.circle_radius_m, c.approach_gain_m_s, c.heading_gain_rad_s].map(f64::from);
    let shape = (f64::from(c.epsilon) + 2.0 * theta.sin().powi(2)).sqrt();
    let (es, root) = (e * shape, r * std::f64::consts::SQRT_2);
    let double = root * (2.0 * theta).sin();
    let turning = double * alpha.sin();
    let denominator = match (c.form, f64::from(c.denominator_floor)) {
        (Form::Printed, _) => es + turning,
        (Form::Derived, 0.0) => es * alpha.cos() + turning,
        (Form::Derived, floor) => (es * alpha.cos() + turning).max(floor * es),
    };
    let feedforward = v_r * (es * theta.cos() + double * (theta.sin() + kappa_r * e));
    let v = (k1 * es * (e - root * shape).tanh() + feedforward) / denominator;
    let turn = (2.0 / e) * (v * alpha.sin() - v_r * theta.sin());
    [v, k2 * (theta + alpha).tanh() + turn - v_r * kappa_r]
}

properties! { cases 400;
    #[test]
    fn command_is_equation_four(
        e in 0.05f32..2.0, theta in -3.0f32..3.0, alpha in -3.0f32..3.0,
        v_r in -0.3f32..0.3, kappa_r in -2.0f32..2.0, printed: bool, floored: bool,
    ) {
        let config = Config {
            form: if printed { Form::Printed } else { Form::Derived },
            denominator_floor: if floored { 0.3 } else { 0.0 },
            ..Config::default()
        };
        let error = PolarError { distance_m: e, theta, alpha };
        let found = config.build().unwrap().command(error, v_r, kappa_r);
        let polar = [e, theta, alpha].map(f64::from);
        let [v, phi_dot] = equation_four(&config, polar, v_r.into(), kappa_r.into());
        prop_assume!(v.abs() < 20.0 && v.abs() > 1e-3);
        let tolerance = 1e-4 * (1.0 + v * v) / polar[0];
        prop_assert!((f64::from(found.v) - v).abs() < tolerance, "{found:?} {v}");
        prop_assert!((f64::from(found.phi_dot) - phi_dot).abs() < 10.0 * tolerance, "{found:?} {phi_dot}");
        let kappa = f64::from(found.phi_dot) / f64::from(found.v);
        prop_assert!((f64::from(found.kappa) - kappa).abs() < 1e-5 * (1.0 + kappa.abs()));
        // A reversing reference is followed rear first.
        let (center, goal) = (Posture::new(0.1, -0.2, alpha), Posture::new(0.4, 0.3, theta));
        let law = config.build().unwrap();
        let tracked = law.track(center, Reference { posture: goal, v: v_r, kappa: kappa_r });
        let polar = PolarError::between(center, goal);
        let polar = if v_r < 0.0 { polar.reversed() } else { polar };
        let same = law.command(polar, v_r.abs(), kappa_r * 1f32.copysign(v_r));
        prop_assume!(same.v.abs() < 20.0 && same.v.abs() > 1e-3);
        prop_assert!((tracked.v - same.v * 1f32.copysign(v_r)).abs() < 1e-3, "{tracked:?} {same:?}");
        prop_assert!((tracked.phi_dot - same.phi_dot).abs() < 1e-2, "{tracked:?} {same:?}");
    }

    /// From four softening lengths down to two, a factor of max(0, cos α) is blended into the speed.
    #[test]
    fn approach_slows_down_abeam_of_the_goal(
        e in 0.01f32..0.3, theta in -3.0f32..3.0, alpha in -1.5f32..1.5, reverse: bool,
    ) {
        let config = Config::default();
        let law = config.build().unwrap();
        let direction = if reverse { Direction::Reverse } else { Direction::Forward };
        let polar = PolarError { distance_m: e, theta, alpha };
        let found = law.approach(polar.in_direction(direction), direction);
        let [d, t, a] = [e, theta, alpha].map(f64::from);
        let [v, _] = equation_four(&config, [d, t, a], 0.0, 0.0);
        let far = (d / 0.06 - 1.0).clamp(0.0, 1.0);
        let v = v.max(0.0) * (far + (1.0 - far) * a.cos().max(0.0));
        let eta = (t + a).sin().atan2((t + a).cos());
        prop_assume!(eta.abs() < 3.1);
        let kappa = (2.0 * a.sin() + 3.0 * eta) * d / (d * d + 0.03 * 0.03);
        let sign = f64::from(direction.sign());
        prop_assert!((f64::from(found.v) - sign * v).abs() < 2e-3 * (0.1 + v), "{found:?} {v}");
        prop_assert!((f64::from(found.kappa) - sign * kappa).abs() < 2e-4 * (1.0 + kappa.abs()), "{found:?} {kappa}");
    }
}

/// Below the least distance the error is computed from the angles, above from the sines and cosines of the headings.
#[test]
fn reference_near_zero_distance_is_tracked_by_the_angles() {
    let law = Config::default().build().unwrap();
    for distance in [0.0, 0.5, 1.0, 1.5, 40.0].map(|part| part * MIN_DISTANCE_M) {
        for (phi, v) in [(0.3, 0.2), (-0.4, 0.0), (0.0, 0.1)] {
            let (center, posture) = (
                Posture::new(0.0, 0.0, phi),
                Posture::new(distance, 0.0, 0.0),
            );
            let found = law.track(
                center,
                Reference {
                    posture,
                    v,
                    kappa: 0.5,
                },
            );
            let same = law.command(PolarError::between(center, posture), v, 0.5);
            for (a, b) in [(found.v, same.v), (found.phi_dot, same.phi_dot)] {
                assert!(
                    (a - b).abs() <= 1e-4 * (1.0 + b.abs()),
                    "{distance} {phi}: {found:?} {same:?}"
                );
            }
        }
    }
}

#[test]
fn away_from_zero_keeps_sign_and_least_magnitude() {
    for (x, expected) in [
        (0.0, 1e-6),
        (1e-7, 1e-6),
        (-1e-7, -1e-6),
        (1e-6, 1e-6),
        (-1e-6, -1e-6),
        (2e-6, 2e-6),
        (-2e-6, -2e-6),
    ] {
        assert_eq!(away_from_zero(x, 1e-6), expected, "{x}");
    }
}
