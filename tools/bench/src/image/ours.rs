//! Measures the boards' algorithms.

use super::counter::{Counter, Total};
use super::problem::{self, JERK, P0, R, SLIP, STEPS, T, TRACK, X0, YAW_JERK};
use core::hint::black_box;
use core_algos::beam::sensor::{Method, PostureSolver};

use core_algos::beam::{MAX_GAUGES, strip};
use core_algos::control::cascade::{self, Cascade};
use core_algos::control::dynamic;
use core_algos::control::governor::{self, Governor};
use core_algos::control::kinematic::{self, Law, Reference};
use core_algos::control::regulator::{Phase, Tolerance};
use core_algos::control::train::{self, State, Task};
use core_algos::fusion::ekf::{self, Measurements};
use core_algos::fusion::{Estimate, intersection, joint};
use core_algos::math::{AxleLoad, Posture, RelativeHeading, Transform, Twist, trig};
use core_algos::node::board::{Board, Ready, Samples};
use core_algos::node::lead;
use core_algos::node::robot::RobotConfig;
use core_algos::node::{Outbox, axle};
use core_algos::time::{EPOCH, EPOCH_S, TICK};
use core_algos::topology::{MAX_AXLES, Role, Topology};
use semihosting::println;

/// Measures all algorithms. Each group has its own function that is not inlined: the sum of the stack frames would
/// leave too little stack to paint.
pub fn measure(counter: &mut Counter) {
    elementary(counter);
    filter(counter);
    beam(counter);
    fusion(counter);
    joint(counter);
    control(counter);
    let three = [
        "train_3_begin",
        "train_3_plan",
        "train_3_drive",
        "train_3_ahead",
    ];
    train(counter, 3, 5, three);
    let five = [
        "train_5_begin",
        "train_5_plan",
        "train_5_drive",
        "train_5_ahead",
    ];
    train(counter, 5, 3, five);
    boards(counter);
}

#[inline(never)]
fn elementary(counter: &mut Counter) {
    let angle = |k: u32| k as f32 * 0.39 - 3.1;
    let vector = |k: u32| (angle(k), 1.7 - 0.2 * k as f32);
    counter.report_function("sin_cos", 16, angle, trig::sin_cos, |x| (x, x));
    counter.report_function("sqrt", 16, |k| k as f32 + 0.5, trig::sqrt, |x| x);
    counter.report_function("tanh", 16, angle, trig::tanh, |x| x);
    let atan2 = |(y, x)| trig::atan2(y, x);
    counter.report_function("atan2", 16, vector, atan2, |(y, _)| y);
}

/// Axle filter with the constants of [`problem`], and its state at the start.
pub fn axle_filter() -> (ekf::AxleFilter, ekf::State) {
    let config = ekf::Config {
        period_s: T,
        track_m: TRACK,
        left_sigma_m_s: trig::sqrt(R[0]),
        right_sigma_m_s: trig::sqrt(R[1]),
        gyro_sigma_rad_s: trig::sqrt(R[2]),
        accelerometer_sigma_m_s2: trig::sqrt(R[3]),
        noise: ekf::Densities {
            along_m_per_sqrt_m: 0.0,
            across_m_per_sqrt_m: 0.0,
            heading_rad_per_sqrt_m: 0.0,
            along_m_per_sqrt_s: SLIP,
            across_m_per_sqrt_s: SLIP,
            heading_rad_per_sqrt_s: SLIP,
            jerk_m_s3_per_sqrt_hz: JERK,
            yaw_jerk_rad_s3_per_sqrt_hz: YAW_JERK,
        },
        innovation_gate: None,
        ..ekf::Config::default()
    };
    let filter = config.build();
    let filter = filter.unwrap_or_else(|error| panic!("{error}"));
    (filter, ekf::State::from_parts(X0, &diagonal(&P0)))
}

fn diagonal<const N: usize>(values: &[f32; N]) -> [[f32; N]; N] {
    let mut m = [[0.0; N]; N];
    for i in 0..N {
        m[i][i] = values[i];
    }
    m
}

/// Measurements of step `k` as input of the axle filter.
pub fn measurements(k: u32) -> Measurements {
    let [left, right, gyro, acceleration] = problem::measurement(k);
    Measurements {
        left_m_s: Some(left),
        right_m_s: Some(right),
        gyro_rad_s: Some(gyro),
        acceleration_m_s2: Some(acceleration),
    }
}

#[inline(never)]
fn filter(counter: &mut Counter) {
    let (filter, mut state) = axle_filter();
    counter.report("axle_filter_predict_update", STEPS, |k| {
        filter.step(&mut state, &measurements(k))
    });
    let p = state.posture();
    println!("state ours {} {} {}", p.x, p.y, p.phi);
}

/// Curvatures (1/m) at the default gauges of strips bent by end loads up to 9 EI/L², computed in
/// double precision: readings of a sound sensor.
const BENDS: [[f32; 5]; 8] = [
    [2.7027, 2.7027, 2.7027, 2.7027, 2.7027],
    [-1.2091, -1.7379, -2.6053, -3.5831, -4.2837],
    [2.2952, 1.5802, 0.2053, -1.2231, -2.0338],
    [1.0585, 1.8646, 2.3220, 1.7590, 0.9066],
    [-2.5990, -1.2400, 0.5932, 2.5338, 4.0661],
    [0.9589, -0.6840, -2.5958, -2.8479, -1.9219],
    [1.8981, 2.0447, 2.6374, 3.7601, 4.8748],
    [-0.7941, -1.7864, -3.2053, -4.4532, -5.0746],
];

#[inline(never)]
fn beam(counter: &mut Counter) {
    let strip = strip::Config::default().build();
    let strip = strip.unwrap_or_else(|error| panic!("{error}"));
    let half_thickness = strip::Config::default().half_thickness_m;
    let strain = |k: u32| {
        let mut strain = [0.0; MAX_GAUGES];
        for (i, value) in strain.iter_mut().take(5).enumerate() {
            *value = half_thickness * (0.2 * k as f32 + 0.3 * i as f32 - 1.0);
        }
        strain
    };
    for (name, method) in [
        ("rps_piecewise_100", Method::Piecewise),
        ("rps_quadrature", Method::Quadrature),
        ("rps_elastica_contradiction", Method::Elastica),
    ] {
        let solver = PostureSolver::new(strip, method, 100);
        let solver = solver.unwrap_or_else(|error| panic!("{error}"));
        counter.report(name, 8, |k| {
            solver.solve(&black_box(strain(k)), strip.gauges())
        });
    }
    let solver = PostureSolver::new(strip, Method::Elastica, 100);
    let solver = solver.unwrap_or_else(|error| panic!("{error}"));
    counter.report("rps_elastica", 8, |k| {
        let mut strain = [0.0; MAX_GAUGES];
        for (value, bend) in strain.iter_mut().zip(BENDS[k as usize % BENDS.len()]) {
            *value = half_thickness * bend;
        }
        solver.solve(&black_box(strain), strip.gauges())
    });
}

#[inline(never)]
fn fusion(counter: &mut Counter) {
    let intersection = intersection::Config::default().build();
    let intersection = intersection.unwrap_or_else(|error| panic!("{error}"));
    let a = Estimate::with_sigmas(Posture::new(0.1, 0.2, 0.3), [0.01, 0.02, 0.01]);
    let b = Estimate::with_sigmas(Posture::new(-0.26, 0.1, 0.25), [0.02, 0.01, 0.02]);
    counter.report("covariance_intersection", 4, |_| {
        intersection.fuse(&black_box(a), &black_box(b))
    });
    let least_trace = intersection::Config {
        criterion: intersection::Criterion::Trace,
        ..intersection::Config::default()
    };
    let least_trace = least_trace.build();
    let least_trace = least_trace.unwrap_or_else(|error| panic!("{error}"));
    counter.report("covariance_intersection_trace", 4, |_| {
        least_trace.fuse(&black_box(a), &black_box(b))
    });
    // Covariance of an ellipse that is very long and thin: correlation 0.999.
    let mut slender = a;
    slender.covariance[1][0] = 0.999 * 0.01 * 0.02;
    slender.covariance[0][1] = slender.covariance[1][0];
    counter.report("covariance_intersection_slender", 4, |_| {
        intersection.fuse(&black_box(slender), &black_box(b))
    });
}

/// Measures the joint filter with gyros and beam while both axles drive a bend.
#[inline(never)]
fn joint(counter: &mut Counter) {
    let filter = joint::Config::default().build(0.01);
    let filter = filter.unwrap_or_else(|error| panic!("{error}"));
    let robot = Estimate::with_sigmas(Posture::new(-1.5, -1.3, 0.0), [5e-3, 5e-3, 1e-2]);
    let frame = Estimate::with_sigmas(Posture::new(0.36, 0.05, 0.2), [1e-3, 1e-3, 4e-3]);
    let way = Estimate::with_sigmas(Posture::new(2e-3, 0.0, 1e-3), [5e-5, 2e-5, 1e-4]);
    let seen = Estimate::with_sigmas(Posture::new(0.36, 0.05, 0.2), [1e-4, 1e-4, 5e-4]);
    let mut state = filter.start(&robot, &frame, 0.005);
    let alone = [RelativeHeading(0.0); 2];
    let [mut predict, mut update] = [Total::default(); 2];
    for _ in 0..20 {
        let way = black_box(way);
        let step = || filter.predict(&mut state, &way, &way, [1.0; 2], alone, 1.0);
        predict.add(counter.cost(step));
        let seen = black_box(seen);
        update.add(counter.cost(|| filter.update(&mut state, &seen, |nis| nis < 40.0)));
    }
    predict.print("joint_predict");
    update.print("joint_update");
}

#[inline(never)]
fn control(counter: &mut Counter) {
    let cascade = cascade::Config::default().build();
    let cascade = cascade.unwrap_or_else(|error| panic!("{error}"));
    let dynamic = dynamic::Config::default().build();
    let dynamic = dynamic.unwrap_or_else(|error| panic!("{error}"));
    let governor = governor::Config::default().build(&cascade, EPOCH_S);
    let governor = governor.unwrap_or_else(|error| panic!("{error}"));
    let law = kinematic::Config::default().build();
    let law = law.unwrap_or_else(|error| panic!("{error}"));

    let state = governor::State::default();
    let [reference, _] = cascade.references(Posture::ORIGIN, &state.motion);
    let input = |k: u32| dynamic::Input {
        posture: Posture::new(0.01 * k as f32, 0.002, 0.01),
        twist: Twist::new(0.1, 0.05),
        reference,
        reference_load: AxleLoad::default(),
        beam_load: None,
        ground_force_n: 0.0,
    };
    let step = |input| dynamic.step(&input);
    counter.report_function("dynamic_controller", 8, input, step, |_| ());
    midpoint(
        counter,
        &black_box(law),
        &black_box(governor),
        &black_box(cascade),
    );
}

/// Measures the computation from the posture of the midpoint to the references of both axles, at the start of a drive.
fn midpoint(counter: &mut Counter, law: &Law, governor: &Governor, cascade: &Cascade) {
    let goal = black_box(Reference::default());
    let postures = |k: u32| black_box(Posture::new(-1.3 + 0.001 * k as f32, -1.2, 0.4));
    let mut state = governor::State::default();
    let mut total = Total::default();
    for k in 0..50 {
        let posture = postures(k);
        total.add(counter.cost(|| {
            let center = Transform::from(posture);
            let command = law.track(center, goal);
            let governor_input =
                governor::GovernorInput::from_curvature(cascade, command.v, command.kappa);
            governor.step(&mut state, &governor_input);
            cascade.references(center, &state.motion)
        }));
    }
    total.print("kinematic_governor_cascade");
}

/// Measures the control of a chain of axles that stay on their references: the first step, the steps that plan and the
/// steps that drive; and the planner's work in each of `parts` ticks of an epoch.
#[inline(never)]
fn train(counter: &mut Counter, axles: u8, parts: u32, names: [&str; 4]) {
    let config = train::Config {
        axles,
        ..train::Config::default()
    };
    let train = config.build().unwrap_or_else(|error| panic!("{error}"));
    let mut state = State::default();
    let goal = Posture::new(0.2, 0.6, 0.5);
    // The chain rests on a bend.
    let mut at = [Posture::ORIGIN; MAX_AXLES];
    for k in 1..MAX_AXLES {
        at[k] = at[k - 1].compose(Posture::new(-0.365, 0.03, -0.2));
    }
    let totals = &mut [Total::default(); 3];
    let mut ahead = Total::default();
    for _ in 0..700 {
        let task: Task<'_, 2, 2> = Task::Regulate {
            goal,
            within: Tolerance::default(),
        };
        let phase = state.phase();
        let begins = state.curve().is_empty();
        let mut step = None;
        let cost = counter.cost(|| step = Some(train.step(&mut state, black_box(&at), task)));
        let Some(step) = step else { continue };
        at = step.references.map(|reference| reference.posture);
        let kind = match phase {
            _ if begins => 0,
            Phase::Plan => 1,
            _ => 2,
        };
        totals[kind].add(cost);
        // Plans in as many ticks of an epoch as the lead node.
        for _ in 0..parts {
            let cost = counter.cost(|| train.plan_ahead(&mut state, parts));
            if state.phase() == Phase::Plan {
                ahead.add(cost);
            }
        }
    }
    let [first, plan, drive, ahead_of] = names;
    ahead.print(ahead_of);
    for (total, name) in totals.iter().zip([first, plan, drive]) {
        total.print(name);
    }
}

/// Board of the default robot, in `place`. The function is not inlined, because building a board needs as much stack as
/// is painted.
#[inline(never)]
fn begin(place: &mut Option<Board>, role: Role) -> &mut Board {
    let ready = Ready::new(&RobotConfig::default(), role);
    let ready = ready.unwrap_or_else(|error| panic!("{error}"));
    ready.begin_in(place)
}

/// Measures whole ticks of each board: plain ticks, first ticks of an epoch, ticks of the lead node.
#[inline(never)]
fn boards(counter: &mut Counter) {
    let place = cortex_m::singleton!(: Option<Board> = None);
    let place = place.unwrap_or_else(|| panic!("the boards are measured once"));
    for role in Role::PAIR {
        let board = begin(place, role);
        let mut outbox = Outbox::new();
        let [mut plain, mut epoch, mut step] = [Total::default(); 3];
        for tick in 0..400u64 {
            let now = tick * TICK;
            let samples = match role {
                Role::Beam(_) => {
                    let wave = (tick % 3) as i32;
                    Samples::Beam([2048 + 40 + wave; MAX_GAUGES].into())
                }
                _ => Samples::Axle(axle::Samples {
                    encoder: [Some(tick as i32 / 4), Some(tick as i32 / 5)].into(),
                    gyro_rad_s: Some(0.01),
                    acceleration_m_s2: Some(0.02),
                    ..axle::Samples::default()
                }),
            };
            outbox.clear();
            let cost = counter.cost(|| board.step(now, &black_box(samples), &mut outbox));
            match now % EPOCH {
                0 => epoch.add(cost),
                phase if phase == lead::step_phase(Topology::PAIR) => step.add(cost),
                _ => plain.add(cost),
            }
        }
        let names = match role {
            Role::LEAD => ["tick_front", "tick_front_epoch", "tick_front_lead"],
            Role::Axle(_) => ["tick_rear", "tick_rear_epoch", ""],
            Role::Beam(_) => ["tick_beam", "tick_beam_epoch", ""],
        };
        for (total, name) in [plain, epoch, step].iter().zip(names) {
            if !name.is_empty() {
                total.print(name);
            }
        }
    }
}
