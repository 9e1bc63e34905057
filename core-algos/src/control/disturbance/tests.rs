use super::*;
use crate::config::refusal_of;
use crate::control::cascade::AxleReference;
use crate::control::dynamic::Dynamic;
use crate::math::{Posture, Twist};
use proptest::prelude::*;

fn observer(config: Config) -> Observer {
    config.build(&dynamic::Config::default()).unwrap()
}

/// An axle in `f64` that rolls straight on; its torques act one tick late.
struct Axle {
    controller: Dynamic,
    observer: Observer,
    v: f64,
    x: f64,
    force: f64,
    ground: f32,
}

impl Axle {
    fn new(config: Config) -> Self {
        Self {
            controller: dynamic::Config::default().build().unwrap(),
            observer: observer(config),
            v: 0.0,
            x: 0.0,
            force: 0.0,
            ground: 0.0,
        }
    }

    /// A tick with the reference speed `v_r` and a load of the ground (N). The reference lies at the axle, as that of
    /// the lead node does.
    fn tick(&mut self, v_r: f32, load: f64) {
        let input = Input {
            twist: Twist::new(self.v as f32, 0.0),
            reference: AxleReference {
                twist: Twist::new(v_r, 0.0),
                ..AxleReference::default()
            },
            ground_force_n: self.ground,
            ..Input::default()
        };
        let command = self.controller.step(&input);
        self.ground = self.observer.step(&input, &command);
        // Mass of the axle, and of its two wheels, which also turn.
        let mass = 4.76 + 2.0 * 0.004 / (0.073 * 0.073);
        self.v += 1e-3 * (self.force + load) / mass;
        self.x += 1e-3 * self.v;
        self.force = f64::from(command.torque_nm.left + command.torque_nm.right) / 0.073;
    }

    fn run(&mut self, seconds: f64, v_r: f32, load: f64) {
        for _ in 0..(1e3 * seconds) as usize {
            self.tick(v_r, load);
        }
    }
}

/// Force along the heading of an axle of 4.76 kg on a slope of 3°, N.
const UPHILL: f64 = -4.76 * 9.81 * 0.0523;

#[test]
fn axle_climbs_at_every_speed_and_is_slower_by_a_share() {
    for v_r in [0.2f32, 0.02, 2e-3, 2e-4] {
        let mut axle = Axle::new(Config::default());
        axle.run(5.0, v_r, UPHILL);
        // Balance of forces: K₁ ‖ξ‖² (v_r − v) − F = 2.44 N with F = −(v_r − v)/(c v_r).
        let v = f64::from(v_r);
        let xi = 1.0 + 3.0 * v * v;
        let behind = -UPHILL / (200.0 * xi + 1.0 / (0.15 * v));
        assert!(
            (axle.v / (v - behind) - 1.0).abs() < 0.03,
            "{v_r} {}",
            axle.v
        );
        // The law alone rolls back from 12 mm/s on.
        let mut alone = Axle::new(Config {
            rate_per_s: 0.0,
            ..Config::default()
        });
        alone.run(5.0, v_r, UPHILL);
        assert_eq!(alone.v > 0.0, v_r > 0.0122, "{v_r} {}", alone.v);
    }
}

#[test]
fn axle_holds_its_place_after_a_drive_on_a_slope() {
    for load in [UPHILL, -UPHILL] {
        let mut axle = Axle::new(Config::default());
        axle.run(2.0, 0.2, load);
        for tick in 0..=1000u16 {
            axle.tick(0.2 - 2e-4 * f32::from(tick), load);
        }
        let stopped = axle.x;
        axle.run(20.0, 0.0, load);
        assert!((axle.x - stopped).abs() < 1e-3, "{}", axle.x - stopped);
        assert!((f64::from(axle.ground) / load - 1.0).abs() < 1e-2);
        assert!(axle.v.abs() < 1e-5, "{}", axle.v);
    }
}

#[test]
fn load_at_rest_moves_the_axle_by_its_magnitude_over_the_stiffness() {
    let mut axle = Axle::new(Config::default());
    axle.run(5.0, 0.0, UPHILL);
    // ω_i K₁ = 2000 N/m.
    assert!(
        (axle.x / (UPHILL / 2000.0) - 1.0).abs() < 0.01,
        "{}",
        axle.x
    );
    axle.run(5.0, 0.0, 0.0);
    assert!(axle.x.abs() < 1e-5, "{}", axle.x);
}

/// Two axles on a frame have one speed; with wheel radii that differ by a share δ they measure two.
#[test]
fn forces_of_two_axles_against_each_other_end_at_the_share_over_the_yield() {
    let (observer, half_share) = (observer(Config::default()), 0.005);
    let mut forces = [0.0f32; 2];
    let command = Command {
        valid: true,
        scale: 1.0,
        ..Command::default()
    };
    for _ in 0..60_000 {
        for (force, sign) in forces.iter_mut().zip([1.0, -1.0]) {
            let input = Input {
                twist: Twist::new(0.1 * (1.0 + sign * half_share), 0.0),
                reference: AxleReference {
                    twist: Twist::new(0.1, 0.0),
                    ..AxleReference::default()
                },
                ground_force_n: *force,
                ..Input::default()
            };
            *force = observer.step(&input, &command);
        }
    }
    let between = forces[0] - forces[1];
    assert!(
        (between - 2.0 * half_share / 0.15).abs() < 1e-3,
        "{forces:?}"
    );
}

/// A frame that bends at rest turns the axles: the outer wheel moves at 0.162 m times the yaw rate.
#[test]
fn axle_yields_while_it_turns_on_the_spot() {
    let observer = observer(Config::default());
    let command = Command {
        valid: true,
        scale: 1.0,
        ..Command::default()
    };
    for omega in [0.5, -0.5] {
        let mut input = Input {
            twist: Twist::new(0.0, omega),
            ground_force_n: 4.0,
            ..Input::default()
        };
        input.reference.twist.omega = omega;
        // Decays at the rate ω_i K₁ c s = 24.3 1/s.
        for _ in 0..100 {
            input.ground_force_n = observer.step(&input, &command);
        }
        let expected = 4.0 * (-24.3f32 * 0.1).exp();
        assert!((input.ground_force_n / expected - 1.0).abs() < 0.05);
    }
}

#[test]
fn posture_error_does_not_change_the_force() {
    let observer = observer(Config::default());
    let controller = dynamic::Config::default().build().unwrap();
    let mut input = Input::default();
    input.reference.posture = Posture::new(0.01, 0.0, 0.0);
    let command = controller.step(&input);
    assert!(command.velocity.v > 0.01);
    assert_eq!(observer.step(&input, &command), 0.0);
}

#[test]
fn force_does_not_grow_while_the_torques_are_limited() {
    let observer = observer(Config::default());
    let step = |force, v, scale| {
        let input = Input {
            twist: Twist::new(v, 0.0),
            ground_force_n: force,
            ..Input::default()
        };
        let command = Command {
            valid: true,
            scale,
            ..Command::default()
        };
        observer.step(&input, &command)
    };
    for sign in [1.0, -1.0] {
        // Change in a tick at 0.1 m/s: 0.2 N.
        let at = |force, v| sign * step(sign * force, sign * v, 0.9);
        assert_eq!(at(5.0, 0.1), 5.0);
        assert!((at(5.0, -0.1) - 4.8).abs() < 1e-6);
        let free = |force, v| sign * step(sign * force, sign * v, 1.0);
        assert!((free(5.0, 0.1) - 5.2).abs() < 1e-6);
        assert_eq!(free(9.95, 0.1), 10.0);
    }
}

#[test]
fn invalid_fields_are_named() {
    let build = |config: Config| config.build(&dynamic::Config::default());
    refusal_of(Config::default(), build).names(&[
        ("rate_per_s", |config| config.rate_per_s = 51.0),
        ("yield_per_n", |config| config.yield_per_n = -0.1),
        ("max_force_n", |config| config.max_force_n = f32::NAN),
    ]);
}

properties! {
    #[test]
    fn force_is_finite_and_bounded_for_any_input(bits in proptest::array::uniform6(any::<u32>())) {
        let [v, omega, v_r, omega_r, x, force] = bits.map(f32::from_bits);
        let observer = observer(Config::default());
        let controller = dynamic::Config::default().build().unwrap();
        let input = Input {
            twist: Twist::new(v, omega),
            reference: AxleReference {
                posture: Posture::new(x, 0.0, 0.0),
                twist: Twist::new(v_r, omega_r),
                acceleration: Twist::REST,
            },
            ground_force_n: force,
            ..Input::default()
        };
        let command = controller.step(&input);
        let force = observer.step(&input, &command);
        prop_assert!(force.abs() <= 10.0, "{force}");
        prop_assert!(command.valid || force == 0.0, "{force}");
    }
}
