use super::*;

fn with(change: impl Fn(&mut Config)) -> Result<Strip, ConfigError> {
    let mut config = Config::default();
    change(&mut config);
    config.build()
}

fn gauges(list: &[f32]) -> Result<Strip, ConfigError> {
    with(|c| c.gauges_m = PerGauge::new(list).unwrap())
}

#[test]
fn gauges_out_of_order_outside_or_not_numbers_are_refused_by_name() {
    for list in [
        &[0.1, 0.05][..],
        &[0.1, 0.1],
        &[0.1, 0.1001],
        &[-0.01, 0.1],
        &[0.1, 0.371],
        &[0.1, f32::NAN],
        &[f32::NEG_INFINITY, 0.1],
        &[0.1],
        &[],
    ] {
        assert_eq!(gauges(list).unwrap_err().field, "gauges_m", "{list:?}");
    }
    assert!(gauges(&[0.0, 0.37]).is_ok());
    // Least spacing: a thousandth of the length.
    for (second, accepted) in [(1e-3f32, true), (1e-3f32.next_down(), false)] {
        let strip = with(|c| {
            c.length_m = 1.0;
            c.gauges_m = PerGauge::new(&[0.0, second]).unwrap();
        });
        assert_eq!(strip.is_ok(), accepted);
    }
}

#[test]
fn lists_hold_up_to_eight_numbers() {
    assert!(PerGauge::new(&[0.0; 9]).is_none());
    assert_eq!(PerGauge::new(&[2.0; 8]).unwrap().padded(), [2.0; 8]);
    assert_eq!(PerGauge::uniform(9, 2.0), PerGauge::new(&[2.0; 8]).unwrap());
    let mut list = PerGauge::uniform(2, 3.0);
    for i in [1, 2, 8] {
        list.set(i, 4.0);
    }
    assert_eq!(
        (list.count(), list.iter().collect::<Vec<_>>()),
        (2, vec![3.0, 4.0])
    );
    assert_eq!(list.padded(), [3.0, 4.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
}

/// The noise of the readings grows; errors that strains do not show keep their size.
#[test]
fn excess_noise_scales_the_noise_of_the_readings() {
    let strip = with(|c| {
        let u = &mut c.uncertainty;
        (u.noise_strain, u.position_m, u.heading_rad) = (2e-6, 1e-3, 2e-3);
    });
    let strip = strip.unwrap();
    let of_readings: Mat3 = [[4e-6, 1e-6, 2e-6], [1e-6, 3e-6, 1e-6], [2e-6, 1e-6, 5e-6]];
    let unseen: Mat3 = [[1e-6, 0.0, 0.0], [0.0, 1e-6, 0.0], [0.0, 0.0, 4e-6]];
    let relative = RelativePosture {
        posture: Posture::new(0.37, 0.0, 0.1),
        covariance: [[1e-4; 3]; 3],
        noise: matrix::add(&of_readings, &unseen),
    };
    let found = strip.with_excess_noise(relative, 12e-12);
    for (i, j) in (0..9).map(|k| (k / 3, k % 3)) {
        // Excess of 12 µε² over configured 4 µε².
        let more = 3.0 * of_readings[i][j];
        for (found, before) in [
            (found.covariance, relative.covariance),
            (found.noise, relative.noise),
        ] {
            assert!((found[i][j] - before[i][j] - more).abs() < 1e-10, "{i} {j}");
        }
    }
    for none in [0.0, -1e-12, f32::INFINITY, f32::NAN] {
        assert_eq!(strip.with_excess_noise(relative, none), relative, "{none}");
    }
}

/// The nodes are the roots of 63 u⁵ − 70 u³ + 15 u, eight times the Legendre polynomial of degree five.
#[test]
fn default_gauges_stand_at_the_gauss_nodes() {
    for place in Config::default().gauges_m.iter() {
        let u = 2.0 * f64::from(place) / 0.37 - 1.0;
        assert!(
            (63.0 * u.powi(5) - 70.0 * u.powi(3) + 15.0 * u).abs() < 1e-4,
            "{u}"
        );
    }
}

#[test]
fn a_posture_is_sound_if_finite_with_positive_variances() {
    let posture = Posture::new(0.37, 0.0, 0.1);
    let variances = [[1e-9, 0.0, 0.0], [0.0, 1e-9, 0.0], [0.0, 0.0, 1e-8]];
    let sound = RelativePosture {
        posture,
        covariance: variances,
        noise: variances,
    };
    assert!(sound.is_sound());
    for (i, j) in (0..9).map(|k| (k / 3, k % 3)) {
        for bad in [f32::NAN, f32::INFINITY, 0.0, -1e-9] {
            let (mut covariance, mut noise) = (sound, sound);
            covariance.covariance[i][j] = bad;
            noise.noise[i][j] = bad;
            assert_eq!(covariance.is_sound(), i != j && bad.is_finite());
            assert_eq!(noise.is_sound(), bad.is_finite());
        }
    }
}

/// Reference: normal equations of a line through strains of gauges mostly on one side.
#[test]
fn sigmas_are_those_of_a_fitted_line() {
    let places = [0.05, 0.11, 0.16, 0.3];
    let mut config = Config {
        gauges_m: PerGauge::new(&places).unwrap(),
        ..Config::default()
    };
    let u = &mut config.uncertainty;
    (u.offset_strain, u.common_offset_strain) = (3e-5, 1e-5);
    (u.gain, u.common_gain) = (0.01, 0.03);
    let (mut n, mut s, mut ss) = (0.0, 0.0, 0.0);
    for place in places.map(f64::from) {
        let at = 2.0 * place / 0.37 - 1.0;
        (n, s, ss) = (n + 1.0, s + at, ss + at * at);
    }
    let determinant = n * ss - s * s;
    let (level, slope) = ((ss / determinant).sqrt(), (n / determinant).sqrt());
    let (per_strain, tilt) = (0.37 / 0.5e-3, 0.37 / 6.0 * slope);
    let found = config.sigmas();
    for (found, expected) in [
        (found.zero_rad, per_strain * (level * 3e-5).hypot(1e-5)),
        (found.zero_tilt_m, per_strain * tilt * 3e-5),
        (found.walk_rad_per_sqrt_s, per_strain * level * 5e-8),
        (found.walk_tilt_m_per_sqrt_s, per_strain * tilt * 5e-8),
        (found.gain, (level * 0.01).hypot(0.03)),
        (found.gain_tilt_m, tilt * 0.01),
    ] {
        let error = f64::from(found) / expected - 1.0;
        assert!(error.abs() < 1e-4, "{found} {expected}");
    }
}

#[test]
fn every_scalar_refuses_zero_or_nan() {
    type Field = fn(&mut Config) -> &mut f32;
    let fields: [(&str, Field); 6] = [
        ("length_m", |c| &mut c.length_m),
        ("half_thickness_m", |c| &mut c.half_thickness_m),
        ("bending_stiffness_n_m2", |c| &mut c.bending_stiffness_n_m2),
        ("noise_strain", |c| &mut c.uncertainty.noise_strain),
        ("load_prior", |c| &mut c.uncertainty.load_prior),
        ("rigid_tip_m", |c| &mut c.rigid_tip_m),
    ];
    for (name, field) in fields {
        for bad in [f32::NAN, f32::INFINITY, -1.0] {
            assert_eq!(with(|c| *field(c) = bad).unwrap_err().field, name);
        }
        if name != "rigid_tip_m" {
            assert_eq!(with(|c| *field(c) = 0.0).unwrap_err().field, name);
        }
    }
}

#[test]
fn gauge_masks_are_sets() {
    let set = GaugeMask::first(5).without(2);
    assert_eq!(set.count(), 4);
    let held: Vec<usize> = (0..100).filter(|i| set.contains(*i)).collect();
    assert_eq!(held, [0, 1, 3, 4]);
    assert_eq!(set.iter().collect::<Vec<_>>(), held);
    assert_eq!(set.with(2), GaugeMask::first(5));
    for beyond in [8, 99] {
        assert_eq!([set.with(beyond), set.without(beyond)], [set; 2]);
    }
    assert_eq!([8, 9, 99].map(|count| GaugeMask::first(count).0), [255; 3]);
    assert_eq!([1, 0].map(|count| GaugeMask::first(count).0), [1, 0]);
}

#[test]
fn unusable_readings_are_left_out() {
    let strip = with(|c| {
        c.length_m = 0.5;
        c.gauges_m = PerGauge::uniform(5, 0.0);
        (0..5).for_each(|i| c.gauges_m.set(i, 0.1 * i as f32));
    });
    // The limit of 50 rad on 0.5 m is a curvature of 100 1/m.
    let curvature = [
        100.0,
        f32::NAN,
        -100.0,
        100.0f32.next_up(),
        0.0,
        0.0,
        0.0,
        0.0,
    ];
    let usable = strip.unwrap().usable(&curvature, GaugeMask(0xef));
    assert_eq!(usable, GaugeMask(0b00101));
}
