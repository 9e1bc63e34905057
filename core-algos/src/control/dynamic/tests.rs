use super::*;
use crate::math::trig::hypot;
use proptest::prelude::*;

/// A rigid axle in `f64` that rolls without slip under two wheel torques, which act one tick late.
struct Axle {
    at: [f64; 3],
    v: f64,
    omega: f64,
    torque: [f64; 2],
    /// External moment, N m.
    moment: f64,
}

impl Axle {
    fn new(at: [f64; 3], v: f64, omega: f64) -> Self {
        Self {
            at,
            v,
            omega,
            torque: [0.0; 2],
            moment: 0.0,
        }
    }

    fn tick(&mut self, torque: [f32; 2]) {
        let (d, r, mass, inertia, wheel) = (0.162, 0.073, 4.76, 0.0186, 0.004);
        let dt = 1e-3;
        let [left, right] = self.torque;
        let rolling = 2.0 * wheel / (r * r);
        self.v += dt * (left + right) / r / (mass + rolling);
        self.omega += dt * ((right - left) * d / r + self.moment) / (inertia + rolling * d * d);
        let middle = self.at[2] + 0.5 * dt * self.omega;
        self.at[0] += dt * self.v * middle.cos();
        self.at[1] += dt * self.v * middle.sin();
        self.at[2] += dt * self.omega;
        self.torque = torque.map(f64::from);
    }

    fn posture(&self) -> Posture {
        Posture::new(self.at[0] as f32, self.at[1] as f32, self.at[2] as f32)
    }
}

fn controller() -> Dynamic {
    Config::default().build().unwrap()
}

/// The controller with the given source of the frame load.
fn controller_with(frame_force: FrameForce) -> Dynamic {
    let config = Config {
        frame_force,
        ..Config::default()
    };
    config.build().unwrap()
}

/// A frame load of a moment only, N m.
fn turning(moment: f32) -> AxleLoad {
    AxleLoad {
        moment,
        ..AxleLoad::default()
    }
}

/// Drives along a circle of constant `twist` for `time`; returns the last command.
fn drive(dynamic: &Dynamic, axle: &mut Axle, twist: Twist, load: AxleLoad, time: f32) -> Command {
    let mut last = Command::default();
    for i in 0..(time * 1e3) as usize {
        let t = i as f32 * 1e-3;
        let input = Input {
            posture: axle.posture(),
            twist: Twist::new(axle.v as f32, axle.omega as f32),
            reference: AxleReference {
                posture: Posture::ORIGIN.advance(twist.v * t, twist.omega * t),
                twist,
                acceleration: Twist::REST,
            },
            reference_load: load,
            beam_load: None,
            ground_force_n: 0.0,
        };
        last = dynamic.step(&input);
        assert!(last.valid);
        axle.tick(last.torque_nm.list());
    }
    last
}

properties! { cases 40;
    /// The axle starts with errors; its reference drives a circle or a line, forward or in reverse.
    #[test]
    fn axle_converges_to_its_reference(
        speed in 0.1f32..0.3, reverse: bool, kappa in -2.0f32..2.0,
        x in -0.05f64..0.05, y in -0.05f64..0.05, phi in -0.4f64..0.4,
    ) {
        let v = if reverse { -speed } else { speed };
        let mut axle = Axle::new([x, y, phi], 0.0, 0.0);
        let last = drive(
            &controller(), &mut axle, Twist::new(v, v * kappa), AxleLoad::default(), 45.0,
        );
        prop_assert!(last.error.x.abs() < 1e-3 && last.error.y.abs() < 1e-3);
        prop_assert!(last.error.phi.abs() < 2e-3);
    }

    /// An axle that follows v_c exactly never raises
    /// `(e_X² + e_Y²)/2 + (1 − cos e_φ)/k_Y`, whatever the sign of its speed.
    #[test]
    fn lyapunov_function_never_rises(
        v in -0.3f32..0.3, omega in -1.0f32..1.0,
        x in -0.3f64..0.3, y in -0.3f64..0.3, phi in -3.0f64..3.0,
    ) {
        let dynamic = controller();
        let (mut ex, mut ey, mut ephi) = (x, y, phi);
        let level = |ex: f64, ey: f64, ephi: f64|
            0.5 * (ex * ex + ey * ey) + (1.0 - ephi.cos()) / 20.0;
        let start = level(ex, ey, ephi);
        let mut last = start;
        let h = 1e-3;
        for _ in 0..4000 {
            let error = Posture::new(ex as f32, ey as f32, ephi as f32);
            let c = dynamic.velocity_command(error, Twist::new(v, omega));
            let (cv, cw, v, omega) = (c.v as f64, c.omega as f64, v as f64, omega as f64);
            let (dx, dy) = (cw * ey - cv + v * ephi.cos(), -cw * ex + v * ephi.sin());
            ex += h * dx;
            ey += h * dy;
            ephi += h * (omega - cw);
            let now = level(ex, ey, ephi);
            // Euler's method adds h²/2 of the squared rates.
            prop_assert!(now <= last + h * h * (cw * cw * (ex * ex + ey * ey) + 1.0));
            last = now;
        }
        prop_assert!(last < start * 1.001 + 1e-9);
    }

    /// The torques against a load of the frame, multiplied by `SᵀE` written out as matrices, are the force and the
    /// moment that balance the load.
    #[test]
    fn torques_realise_force_and_moment(
        force in -40.0f32..40.0, moment in -5.0f32..5.0, phi in -3.0f64..3.0,
    ) {
        let controller = Config { max_torque_nm: 50.0, ..Config::default() }.build().unwrap();
        let reference_load = AxleLoad { forward: -force, lateral: 0.0, moment: -moment };
        let Wheels { left, right } = controller
            .step(&Input { reference_load, ..Input::default() })
            .torque_nm
            .map(f64::from);
        let (s, c) = phi.sin_cos();
        let (d, r) = (0.162, 0.073);
        let e = [[c, c], [s, s], [-d, d]].map(|row| (row[0] * left + row[1] * right) / r);
        prop_assert!((c * e[0] + s * e[1] - force as f64).abs() < 1e-4);
        prop_assert!((e[2] - moment as f64).abs() < 1e-4);
    }

    /// The torques for an acceleration give a simulated axle the fed-forward share of the acceleration.
    #[test]
    fn acceleration_is_fed_forward(v in -0.5f32..0.5, omega in -2.0f32..2.0, share in 0.1f32..1.0) {
        let config = Config {
            inertia_feedforward: share, max_torque_nm: 50.0, ..Config::default()
        };
        let reference = AxleReference { acceleration: Twist::new(v, omega), ..Default::default() };
        let input = Input { reference, ..Input::default() };
        let torque = config.build().unwrap().step(&input).torque_nm.list();
        let mut axle = Axle::new([0.0; 3], 0.0, 0.0);
        axle.tick(torque);
        axle.tick(torque);
        let [v, omega] = [v, omega].map(|rate| 1e-3 * f64::from(share * rate));
        prop_assert!((axle.v - v).abs() < 1e-7 && (axle.omega - omega).abs() < 1e-7);
    }

    /// Equations 7 and 8, written out in `f64` from the velocity command.
    #[test]
    fn velocity_errors_make_force_and_moment_with_xi_squared(
        v in -0.4f32..0.4, omega in -0.8f32..0.8, v_r in -0.3f32..0.3, y in -0.02f32..0.02,
        most in 1.0f32..4.0,
    ) {
        let reference = AxleReference {
            posture: Posture::new(0.0, y, 0.0), twist: Twist::new(v_r, 0.0), ..Default::default()
        };
        let input = Input { twist: Twist::new(v, omega), reference, ..Input::default() };
        let config = Config { max_torque_nm: 50.0, max_xi_squared: most, ..Config::default() };
        let command = config.build().unwrap().step(&input);
        let square = |t: Twist| f64::from(t.v).powi(2) + f64::from(t.omega).powi(2);
        let speed = square(input.twist);
        let xi = square(command.velocity) + speed + f64::from(v_r).powi(2) + speed * speed + 1.0;
        let xi = xi.min(most.into());
        let Wheels { left, right } = command.torque_nm.map(f64::from);
        let (force, moment) = ((left + right) / 0.073, (right - left) / 0.073 * 0.162);
        let [dv, dw] = [command.velocity.v - v, command.velocity.omega - omega].map(f64::from);
        prop_assert!((force - 200.0 * dv * xi).abs() < 2e-3, "{force}");
        prop_assert!((moment - 3.5 * dw * xi).abs() < 1e-4, "{moment}");
    }

    #[test]
    fn saturation_keeps_the_direction(
        x in -5.0f32..5.0, omega in -20.0f32..20.0, motor: bool,
        v in -2.0f32..2.0, turn in -8.0f32..8.0,
    ) {
        let config = Config {
            motor: motor.then_some(Motor { stall_torque_nm: 2.5, no_load_speed_rad_s: 20.0 }),
            velocity_gain_n_s_m: 20.0,
            yaw_rate_gain_nm_s_rad: 0.35,
            ..Config::default()
        };
        let input = Input {
            twist: Twist::new(v, turn),
            reference: AxleReference {
                posture: Posture::new(x, 0.0, 0.0),
                twist: Twist::new(0.2, omega),
                ..AxleReference::default()
            },
            ..Input::default()
        };
        let limited = config.build().unwrap().step(&input);
        let free = Config { max_torque_nm: 50.0, motor: None, ..config }.build().unwrap().step(&input);
        prop_assert_eq!(free.scale, 1.0);
        prop_assert!(limited.torque_nm.list().iter().all(|t| t.abs() <= 2.0));
        for (torque, free) in limited.torque_nm.list().into_iter().zip(free.torque_nm.list()) {
            prop_assert!((torque - limited.scale * free).abs() < 1e-5);
        }
        // Limit of each wheel in the direction of its torque. With torques above the limits, one wheel is at its
        // limit.
        let mut most = f64::INFINITY;
        for (side, torque) in [-1.0, 1.0].into_iter().zip(free.torque_nm.list().map(f64::from)) {
            let speed = (f64::from(input.twist.v) + side * 0.162 * f64::from(input.twist.omega)) / 0.073;
            let line = 2.5 * (1.0 - torque.signum() * speed / 20.0);
            let limit = if motor { line.clamp(0.0, 2.0) } else { 2.0 };
            most = most.min(limit / torque.abs());
        }
        prop_assert!((f64::from(limited.scale) - most.min(1.0)).abs() < 1e-5, "{most}");
    }

    #[test]
    fn any_input_that_is_not_finite_gives_no_torque(which in 0usize..10, kind in 0usize..3) {
        let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY][kind];
        let mut input = Input::default();
        *[
            &mut input.posture.x,
            &mut input.posture.y,
            &mut input.posture.phi,
            &mut input.twist.v,
            &mut input.twist.omega,
            &mut input.reference.posture.phi,
            &mut input.reference.twist.v,
            &mut input.reference.twist.omega,
            &mut input.reference.acceleration.omega,
            &mut input.reference_load.moment,
        ][which] = bad;
        for frame_force in [FrameForce::Reference, FrameForce::Beam] {
            let config = Config { frame_force, inertia_feedforward: 0.0, ..Config::default() };
            let command = config.build().unwrap().step(&input);
            prop_assert!(!command.valid);
            prop_assert_eq!(command.torque_nm, Wheels::both(0.0));
        }
    }
}

/// The sum of two large torques overflows at one wheel, their difference does not.
#[test]
fn overflow_of_one_torque_gives_no_torque() {
    let dynamic = Dynamic {
        mass: 2e38,
        yaw_inertia: 2e38,
        ..controller()
    };
    for omega in [1.0, -1.0] {
        let mut input = Input::default();
        input.reference.acceleration = Twist::new(1.0, omega);
        assert_eq!(dynamic.step(&input), Command::default());
    }
}

/// A heading error at rest is corrected on the spot; without the speed floor the error stays.
#[test]
fn heading_error_is_corrected_at_standstill() {
    let end = |heading_speed_floor_m_s| {
        let config = Config {
            heading_speed_floor_m_s,
            ..Config::default()
        };
        let mut axle = Axle::new([0.0, 0.0, 0.2], 0.0, 0.0);
        let (controller, load) = (config.build().unwrap(), AxleLoad::default());
        let last = drive(&controller, &mut axle, Twist::REST, load, 8.0);
        last.error.phi
    };
    assert!(end(0.05).abs() < 1e-3);
    assert!(end(0.0).abs() > 0.1);
}

/// The frame's moment turns the axle; the feedforward has an error of 15 %.
#[test]
fn feedforward_of_the_frame_cuts_the_yaw_error() {
    let steady = |frame_force| {
        let mut axle = Axle::new([0.0; 3], 0.2, 0.0);
        axle.moment = 1.5;
        let (twist, load) = (Twist::new(0.2, 0.0), turning(1.5 * 0.85));
        drive(&controller_with(frame_force), &mut axle, twist, load, 15.0).error
    };
    let (without, with) = (steady(FrameForce::Off), steady(FrameForce::Reference));
    let size = |e: Posture| hypot(e.y, e.phi);
    assert!(size(without) > 0.02, "{without:?}");
    assert!(size(with) * 4.0 < size(without), "{with:?} {without:?}");
}

#[test]
fn missing_beam_estimate_falls_back_on_the_reference_bend() {
    let step = |frame_force, beam_load| {
        let input = Input {
            reference_load: turning(1.0),
            beam_load,
            ..Input::default()
        };
        controller_with(frame_force).step(&input)
    };
    let reference = step(FrameForce::Reference, None);
    assert!(reference.torque_nm.left > 0.0 && reference.torque_nm.right < 0.0);
    assert_eq!(step(FrameForce::Beam, None), reference);
    let broken = Some(turning(f32::NAN));
    assert_eq!(step(FrameForce::Beam, broken), reference);
    assert_ne!(step(FrameForce::Beam, Some(AxleLoad::default())), reference);
}

#[test]
fn bad_configuration_is_named() {
    crate::config::refusal_of(Config::default(), |c| c.build()).names(&[
        ("no_load_speed_rad_s", |c| {
            c.motor = Some(Motor {
                stall_torque_nm: 2.5,
                no_load_speed_rad_s: 0.0,
            })
        }),
        ("half_track_m", |c| c.half_track_m = f32::NAN),
    ]);
}
