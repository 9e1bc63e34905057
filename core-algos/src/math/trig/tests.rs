use super::*;
use proptest::prelude::*;

#[test]
fn sin_cos_is_within_1e_7_of_f64() {
    let mut worst = 0.0f64;
    for i in -400_000..=400_000i32 {
        let x = i as f32 * 0.020_47;
        let (s, c) = sin_cos(x);
        let (rs, rc) = (x as f64).sin_cos();
        worst = worst.max((s as f64 - rs).abs()).max((c as f64 - rc).abs());
    }
    assert!(worst < 1e-7, "{worst:e}");
}

/// Points of a dense grid over [−limit, limit], and as many random points between them.
fn points(limit: f32) -> impl Iterator<Item = f32> {
    let mut random = crate::fusion::testing::Random::new(17);
    (-200_000..=200_000i32).flat_map(move |i| {
        let anywhere = limit * (2.0 * random.uniform() as f32 - 1.0);
        [i as f32 * (limit / 200_000.0), anywhere]
    })
}

#[test]
fn sin_cos_of_small_angles_is_within_1e_7_of_f64() {
    for x in points(7.0) {
        let (s, c) = sin_cos(x);
        let (rs, rc) = (x as f64).sin_cos();
        assert!(
            (s as f64 - rs).abs() < 1e-7 && (c as f64 - rc).abs() < 1e-7,
            "{x}"
        );
    }
}

#[test]
fn sin_cos_beyond_the_exact_reduction_stays_on_the_unit_circle() {
    for x in [8192.5f32, 1e5, -3e7, 1e20, -1e38, f32::MAX] {
        let (s, c) = sin_cos(x);
        assert!((s * s + c * c - 1.0).abs() < 1e-6, "{x}");
    }
}

#[test]
fn tanh_is_within_5e_7_of_f64() {
    for limit in [0.1, 1.0, 12.0] {
        for x in points(limit) {
            let (found, exact) = (tanh(x) as f64, (x as f64).tanh());
            assert!((found - exact).abs() < 5e-7, "{x}: {found} {exact}");
            assert!(
                (found - exact).abs() <= 1e-6 * exact.abs(),
                "{x}: {found} {exact}"
            );
        }
    }
    assert_eq!(tanh(f32::INFINITY), 1.0);
    assert_eq!(tanh(f32::NEG_INFINITY), -1.0);
    assert!(tanh(f32::NAN).is_nan());
}

#[test]
fn atan2_is_within_5e_7_of_f64() {
    let mut random = crate::fusion::testing::Random::new(5);
    let mut worst = 0.0f64;
    for i in 0..2_000_000 {
        // The vectors have all directions, and lengths of many orders of magnitude.
        let length = 10f64.powf(60.0 * random.uniform() - 30.0);
        let direction = if i % 2 == 0 {
            core::f64::consts::TAU * random.uniform()
        } else {
            core::f64::consts::PI * i as f64 * 1e-6
        };
        let (y, x) = (
            (length * direction.sin()) as f32,
            (length * direction.cos()) as f32,
        );
        let exact = (y as f64).atan2(x as f64);
        worst = worst.max((atan2(y, x) as f64 - exact).abs());
    }
    assert!(worst < 5e-7, "{worst:e}");
}

#[test]
fn atan2_on_the_axes_is_exact() {
    let half = core::f32::consts::FRAC_PI_2;
    let tiny = f32::from_bits(1);
    for size in [tiny, 1.0, f32::MAX] {
        assert_eq!(atan2(0.0, size), 0.0);
        assert_eq!(atan2(size, 0.0), half);
        assert_eq!(atan2(-size, 0.0), -half);
        assert_eq!(atan2(size, -0.0), half);
        assert_eq!(atan2(0.0, -size), PI);
        assert_eq!(atan2(-0.0, -size), -PI);
    }
    for (y, x) in [(0.0, 0.0), (-0.0, 0.0), (0.0, -0.0), (-0.0, -0.0)] {
        assert_eq!(atan2(y, x), 0.0);
    }
    assert_eq!(atan2(1.0, f32::INFINITY), 0.0);
    assert_eq!(atan2(1.0, f32::NEG_INFINITY), PI);
    assert_eq!(atan2(f32::INFINITY, 1.0), half);
    assert!(atan2(f32::NAN, 1.0).is_nan() && atan2(1.0, f32::NAN).is_nan());
    assert!(atan2(f32::INFINITY, f32::INFINITY).is_nan());
}

#[test]
fn non_finite_input_gives_nan() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
        let (s, c) = sin_cos(bad);
        assert!(s.is_nan() && c.is_nan());
        assert!(wrap_angle(bad).is_nan());
    }
}

#[test]
fn sinc_near_its_branch_limit_is_within_2e_7_of_f64() {
    for i in -2000..2000 {
        let x = i as f32 * 1e-5;
        let exact = if x == 0.0 {
            1.0
        } else {
            (x as f64).sin() / x as f64
        };
        assert!((sinc(x) as f64 - exact).abs() < 2e-7);
    }
}

properties! {
    #[test]
    fn wrapped_angle_is_the_same_direction(angle in -1000.0f32..1000.0) {
        let wrapped = wrap_angle(angle);
        prop_assert!(wrapped.abs() <= PI);
        let (s, c) = (angle as f64).sin_cos();
        let (ws, wc) = (wrapped as f64).sin_cos();
        prop_assert!((s - ws).abs() < 1e-4 && (c - wc).abs() < 1e-4);
        // The angles differ by whole turns of the `f32` nearest 2π.
        let turns = (angle as f64 - wrapped as f64) / f64::from(TAU);
        prop_assert!((turns - turns.round()).abs() < 1e-6);
    }

    #[test]
    fn clamp_never_leaves_its_bounds(x in proptest::num::f32::ANY) {
        let y = clamp(x, -2.0, 3.0);
        prop_assert!((-2.0..=3.0).contains(&y));
    }
}

#[test]
fn lag_gain_is_within_3e_7_of_f64() {
    for i in 0..40_000 {
        let x = 1e-4 * i as f32;
        let exact = -f64::from(-x).exp_m1();
        let error = (f64::from(lag_gain(x)) - exact).abs();
        assert!(error <= 3e-7 * exact, "{x}: {error:e}");
    }
    assert!(lag_gain(f32::NAN).is_nan());
}
