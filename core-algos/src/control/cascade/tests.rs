use super::*;
use proptest::prelude::*;

fn cascade(rigid_end_m: f32, form: Form) -> Cascade {
    Config {
        rigid_end_m,
        max_steering_rad: 1.4,
        form,
        ..Config::default()
    }
    .build()
    .unwrap()
}

/// Posture of the front axle in the rear axle's coordinates by walking along the frame in `f64`.
fn walked(length: f64, end: f64, psi: f64) -> (f64, f64) {
    let n = 20_000;
    let (mut x, mut y) = (end, 0.0);
    for i in 0..n {
        let theta = 2.0 * psi * (i as f64 + 0.5) / n as f64;
        x += length / n as f64 * theta.cos();
        y += length / n as f64 * theta.sin();
    }
    let (s, c) = (2.0 * psi).sin_cos();
    (x + end * c, y + end * s)
}

/// κ of eq. 5 solved by bisection in `f64`.
fn bisected(length: f64, kappa: f64) -> f64 {
    let (mut low, mut high) = (0.0, std::f64::consts::FRAC_PI_2);
    for _ in 0..100 {
        let mid = 0.5 * (low + high);
        if 2.0 * mid < kappa.abs() * length * mid.cos() {
            low = mid;
        } else {
            high = mid;
        }
    }
    low * kappa.signum()
}

properties! {
    #[test]
    fn steering_solves_equation_five(kappa in -30.0f32..30.0, length in 0.05f32..1.0) {
        let cascade = Config { frame_length_m: length, max_steering_rad: 1.5, ..Config::default() }
            .build().unwrap();
        prop_assume!(kappa.abs() < cascade.max_curvature());
        let exact = bisected(length as f64, kappa as f64);
        prop_assert!((f64::from(cascade.steering(kappa).0) - exact).abs() < 3e-7);
    }

    #[test]
    fn axle_postures_match_the_bent_frame(psi in -1.3f32..1.3, end in 0.0f32..0.1) {
        let cascade = cascade(end, Form::Exact);
        let center = Posture::new(0.4, -0.3, 2.0);
        let motion = Motion { psi: Steering(psi), ..Motion::default() };
        let [front, rear] = cascade.references(center, &motion).map(|axle| axle.posture);
        let relative = front.relative_to(rear);
        let (x, y) = walked(0.37, end as f64, psi as f64);
        prop_assert!((relative.x as f64 - x).abs() < 1e-6);
        prop_assert!((relative.y as f64 - y).abs() < 1e-6);
        prop_assert!((wrap_angle(relative.phi - 2.0 * psi)).abs() < 1e-6);
        prop_assert!((0.5 * (front.x + rear.x) - center.x).abs() < 1e-6);
        prop_assert!((0.5 * (front.y + rear.y) - center.y).abs() < 1e-6);
        let heading = crate::math::trig::atan2(front.y - rear.y, front.x - rear.x);
        prop_assert!((heading - center.phi).abs() < 1e-6);
    }

    /// The velocities match central differences, in `f64`, of the axle postures for O and ψ; no axle moves sideways.
    #[test]
    fn velocities_are_the_rates_of_the_postures(
        v in -0.5f32..0.5, psi in -1.2f32..1.2, psi_rate in -2.0f32..2.0, end in 0.0f32..0.1,
    ) {
        let cascade = cascade(end, Form::Exact);
        let motion = Motion { v, psi: Steering(psi), psi_rate, ..Motion::default() };
        let twists = cascade.axle_twists(&motion);
        let chord = |p: f64| 0.37 * if p == 0.0 { 1.0 } else { p.sin() / p }
            + 2.0 * end as f64 * p.cos();
        let yaw_rate = v as f64 * cascade.curvature(Steering(psi)) as f64;
        let h = 1e-4;
        // O moves sideways as the chord changes: ½ tan ψ ċ.
        let stretch = (chord(psi as f64 + h) - chord(psi as f64 - h)) / (2.0 * h);
        let lateral = 0.5 * (psi as f64).tan() * stretch * psi_rate as f64;
        for (side, (twist, _)) in [1.0, -1.0].into_iter().zip(twists) {
            let at = |t: f64| {
                let p = psi as f64 + psi_rate as f64 * t;
                let phi = yaw_rate * t;
                let half = side * 0.5 * chord(p);
                (
                    v as f64 * t + half * phi.cos(),
                    lateral * t + half * phi.sin(),
                    phi + side * p,
                )
            };
            let (a, b) = (at(-h), at(h));
            let (s, c) = (side * psi as f64).sin_cos();
            let (dx, dy) = ((b.0 - a.0) / (2.0 * h), (b.1 - a.1) / (2.0 * h));
            prop_assert!((c * dx + s * dy - twist.v as f64).abs() < 2e-6);
            prop_assert!((c * dy - s * dx).abs() < 2e-6, "slips sideways");
            prop_assert!(((b.2 - a.2) / (2.0 * h) - twist.omega as f64).abs() < 5e-6);
        }
    }

    #[test]
    fn accelerations_are_central_differences_of_velocities(
        v in -0.3f32..0.3, v_rate in -0.4f32..0.4,
        psi in -0.9f32..0.9, psi_rate in -1.0f32..1.0, psi_acceleration in -8.0f32..8.0,
        printed: bool,
    ) {
        let form = if printed { Form::Printed } else { Form::Exact };
        let cascade = cascade(0.03, form);
        let at = |t: f32| cascade.axle_twists(&Motion {
            v: v + v_rate * t,
            psi: Steering(psi + (psi_rate + 0.5 * psi_acceleration * t) * t),
            psi_rate: psi_rate + psi_acceleration * t,
            ..Motion::default()
        });
        let motion = Motion { v, v_rate, psi: Steering(psi), psi_rate, psi_acceleration };
        let h = 4e-3;
        for i in 0..2 {
            let analytic = cascade.axle_twists(&motion)[i].1;
            let (low, high) = (at(-h)[i].0, at(h)[i].0);
            let dv = (high.v - low.v) / (2.0 * h);
            let dw = (high.omega - low.omega) / (2.0 * h);
            prop_assert!((dv - analytic.v).abs() < 2e-3, "{dv} {}", analytic.v);
            prop_assert!((dw - analytic.omega).abs() < 2e-2, "{dw} {}", analytic.omega);
        }
    }

    #[test]
    fn steering_rates_are_central_differences(
        kappa in -3.0f32..3.0, rate in -4.0f32..4.0, acceleration in -10.0f32..10.0,
    ) {
        let cascade = cascade(0.0, Form::Exact);
        let motion = cascade.steering_motion(kappa, rate, acceleration);
        let at = |t: f64| bisected(
            0.37f32 as f64,
            kappa as f64 + (rate as f64 + 0.5 * acceleration as f64 * t) * t,
        );
        let h = 1e-4;
        prop_assert!((((at(h) - at(-h)) / (2.0 * h)) - motion.rate as f64).abs() < 1e-5);
        let second = (at(h) - 2.0 * at(0.0) + at(-h)) / (h * h);
        prop_assert!((second - motion.acceleration as f64).abs() < 1e-3);
    }
}

#[test]
fn printed_form_is_the_small_angle_limit_of_the_exact_one() {
    let (exact, printed) = (cascade(0.0, Form::Exact), cascade(0.0, Form::Printed));
    let gap = |psi: f32| {
        let motion = Motion {
            v: 0.2,
            psi: Steering(psi),
            psi_rate: 1.0,
            ..Motion::default()
        };
        let (a, b) = (exact.axle_twists(&motion), printed.axle_twists(&motion));
        // The front axle is slower than the rear while the frame bends more, and faster while it straightens.
        assert!((a[0].0.v - a[1].0.v) * psi < 0.0);
        [0, 1].map(|i| (a[i].0.v - b[i].0.v).abs())
    };
    for psi in [-0.1, 0.1] {
        let (near, far) = (gap(0.5 * psi), gap(2.0 * psi));
        for i in 0..2 {
            // ½ ċ is 6 mm/s at 0.1 rad; the forms differ by the share ψ²/2 − ψ²/10 of this term.
            assert!(near[i] < 1e-5 && far[i] < 5e-4);
            assert!(far[i] > 30.0 * near[i], "a difference of third order");
        }
    }
}

#[test]
fn straight_frame_moves_as_one_body() {
    let motion = Motion {
        v: 0.2,
        v_rate: 0.1,
        ..Motion::default()
    };
    for (twist, rate) in cascade(0.02, Form::Exact).axle_twists(&motion) {
        assert_eq!(twist, Twist::new(0.2, 0.0));
        assert_eq!(rate, Twist::new(0.1, 0.0));
    }
}

#[test]
fn bounds_hold_and_nan_counts_as_straight() {
    let cascade = Config::default().build().unwrap();
    assert_eq!(cascade.steering(1e9).0, 0.5);
    assert_eq!(cascade.steering(cascade.max_curvature()).0, 0.5);
    assert_eq!(cascade.steering(f32::NEG_INFINITY).0, -0.5);
    assert_eq!(cascade.steering(f32::NAN).0, 0.0);
    assert_eq!(cascade.curvature(Steering(f32::NAN)), 0.0);
    assert_eq!(cascade.curvature(Steering(9.0)), cascade.max_curvature());
    // 2 · 0.5/(0.37 cos 0.5)
    assert!((cascade.max_curvature() - 3.079_712).abs() < 1e-5);
}

#[test]
fn headings_of_the_axles_are_within_half_a_turn() {
    for phi in [-3.1f32, -2.9, -2.5, 0.0, 2.5, 2.9, 3.1] {
        for psi in [-0.4f32, 0.0, 0.4] {
            let motion = Motion {
                psi: Steering(psi),
                ..Motion::default()
            };
            let axles = cascade(0.0, Form::Exact).references(Posture::new(0.0, 0.0, phi), &motion);
            for (axle, turned) in axles.iter().zip([phi + psi, phi - psi]) {
                let exact = f64::from(turned).sin().atan2(f64::from(turned).cos());
                assert!(
                    (f64::from(axle.posture.phi) - exact).abs() < 1e-6,
                    "{phi} {psi}"
                );
            }
        }
    }
}

#[test]
fn bad_geometry_is_named() {
    crate::config::refusal_of(Config::default(), |c| c.build()).names(&[
        ("frame_length_m", |c| c.frame_length_m = 0.0),
        ("max_steering_rad", |c| c.max_steering_rad = f32::NAN),
    ]);
}
