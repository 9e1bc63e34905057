//! Reaction of the robot to faults during a drive: it drives on degraded, or makes a controlled stop.

use core_algos::safety::{Condition, OperatingState};
use core_algos::topology::{Node, Role};
use host_sim::run::end::EndKind;
use host_sim::run::recovery::{SENSORS, Status};
use host_sim::run::regulate::{Outcome, regulate_on};
use host_sim::run::robot::{Record, Robot as _};
use host_sim::run::simulation::Simulation;
use host_sim::scenario::Scenario;
use host_sim::world::faults::Fault;

/// Time of the failures, ms, in the middle of the drive.
const AT: u32 = 3000;

/// Mission with all its records.
struct Run {
    outcome: Outcome,
    records: Vec<Record>,
    simulation: Simulation,
}

impl Run {
    fn new(scenario: &Scenario, fault: Fault, tick: u32) -> Self {
        let mut simulation = Simulation::new(scenario, 1, 0).unwrap();
        simulation.inject(fault, tick);
        let mut records = Vec::new();
        let outcome = regulate_on(&mut simulation, scenario, |record| {
            records.push(record.clone())
        })
        .unwrap();
        for change in simulation.monitor().changes() {
            println!("{change}");
        }
        Self {
            outcome,
            records,
            simulation,
        }
    }

    /// Runs a scenario with changed keys.
    fn with(changes: &[String]) -> Self {
        let scenario = Scenario::parse(None, "", "test", changes).unwrap();
        Self::new(&scenario, Fault::None, 0)
    }

    fn without_beam(scenario: &Scenario) -> Self {
        Self::new(scenario, Fault::Loss(Role::beam(0)), AT)
    }

    /// First change of a node to a state.
    fn change(&self, node: Node, state: OperatingState) -> Status {
        let mut changes = self.simulation.monitor().changes().iter();
        let found = changes.find(|change| change.node == node && change.state == state);
        *found.unwrap_or_else(|| panic!("{node:?} was never {state:?}"))
    }

    /// Largest true steering angle |ψ| from a time on, rad.
    fn steering_from(&self, time_s: f64) -> f64 {
        let late = self.records.iter().filter(|record| record.time_s >= time_s);
        late.map(|record| 0.5 * record.frames[0].relative[2].abs())
            .fold(0.0, f64::max)
    }

    /// Path length of the true midpoint from a time on, m.
    fn distance_from(&self, time_s: f64) -> f64 {
        let pairs = self.records.windows(2);
        let late = pairs.filter(|pair| pair[0].time_s >= time_s);
        late.map(|pair| {
            let [a, b] = [pair[0].midpoint, pair[1].midpoint];
            (b[0] - a[0]).hypot(b[1] - a[1])
        })
        .sum()
    }

    /// Checks a controlled stop: no further bending, motors off, at rest.
    fn assert_stopped(&self, since: f64) {
        let before = self.records.iter().rfind(|record| record.time_s <= since);
        let steering = 0.5 * before.unwrap().frames[0].relative[2].abs();
        let later = self.steering_from(since);
        assert!(
            later < steering + 0.03,
            "bent from {steering:.3} to {later:.3} rad"
        );
        let axles = self.simulation.plant().axles();
        assert!(axles.iter().all(|axle| axle.torque == [0.0; 2]));
        println!("speed at the end {:.4} m/s", self.simulation.speed());
        assert!(self.simulation.speed() < 0.02);
        assert!(!self.outcome.end.is_success());
    }
}

#[test]
fn robot_without_beam_drives_on() {
    let run = Run::without_beam(&Scenario::default());
    assert!(run.outcome.end.is_success());
    let noticed = run.simulation.monitor().noticed(Node::Lead);
    assert!(noticed.contains(Condition::BeamLost));
    let [x, y, _] = run.outcome.midpoint;
    println!("{:.3} m from the goal", x.hypot(y));
    assert!(x.hypot(y) < 0.3, "{x} {y}");
}

#[test]
fn robot_without_beam_stops_at_the_degraded_limits() {
    // The beam counts as lost after ten epochs without a measurement and the hold time of 50 ms.
    let counts = f64::from(AT) * 1e-3 + 0.15;
    let mut scenario = Scenario::default();
    scenario.robot.lead.supervisor.degraded_time_s = 1.5;
    let run = Run::without_beam(&scenario);
    let stop = run.change(Node::Lead, OperatingState::SafeStop);
    assert_eq!(stop.reason, Some(Condition::DegradedTooLong));
    assert!((stop.time_s - counts - 1.5).abs() < 0.03, "{stop}");
    run.assert_stopped(stop.time_s);

    let mut scenario = Scenario::default();
    scenario.robot.lead.supervisor.degraded_distance_m = 0.4;
    let run = Run::without_beam(&scenario);
    let stop = run.change(Node::Lead, OperatingState::SafeStop);
    assert_eq!(stop.reason, Some(Condition::DegradedTooLong));
    // The limit is 0.4 m; braking from 0.25 m/s at 1 m/s² adds 3 cm.
    let distance = run.distance_from(counts);
    assert!((0.38..0.47).contains(&distance), "{distance} m");
    run.assert_stopped(stop.time_s);
    for axle in [Node::axle(0), Node::axle(1)] {
        let latest = run.simulation.monitor().latest(axle).unwrap();
        assert_eq!(latest.state.permit(), core_algos::safety::Permit::Off);
    }
}

/// One fault each, larger than ten of the configured standard deviations. The error of one wheel enters the mean of its
/// axle by half. With a gyro the robot does not use the track and detects skewed axles, so the faults of track and side
/// slip run without inertial sensors.
#[test]
fn fault_beyond_ten_standard_deviations_is_named() {
    use Condition::{GaugesInconsistent, GyrosInconsistent, WheelsInconsistent};
    let radius = |by: [[f64; 2]; 2]| {
        let radii = by.map(|axle| axle.map(|by| 0.073 * (1.0 + 0.0525 * by)));
        format!("plant.wheel_radius_m={radii:?}")
    };
    let gain = |gain: [f64; 5]| format!("boards.beam.robot.beam.calibration.gain={gain:?}");
    let wheels = [
        radius([[1.0, 1.0], [0.0, 0.0]]),
        radius([[0.0, 0.0], [-1.6, 0.0]]),
        "plant.half_track_m=[0.188, 0.162]".into(),
        "plant.side_slip=[0.0525, -0.0525]".into(),
        radius([[1.0, 0.0], [1.0, 0.0]]),
        radius([[1.0; 2]; 2]),
        "plant.clamp_angle_root_rad=0.0525".into(),
    ];
    let gauges = [
        gain([1.0, 1.105, 1.0, 1.0, 1.0]),
        gain([1.21; 5]),
        gain([1.0, 1.0, 1.0, 1.0, 0.895]),
    ];
    let gyro = "boards.front.inertial.gyro_gain=1.0525".to_owned();
    let named = wheels.map(|fault| (fault, WheelsInconsistent));
    let named = named.into_iter();
    let named = named.chain(gauges.map(|fault| (fault, GaugesInconsistent)));
    for (fault, name) in named.chain([(gyro, GyrosInconsistent)]) {
        let changes =
            ["gyro", "accelerometer"].map(|sensor| format!("sensors.{sensor}.fitted=true"));
        let imu = ["track", "side_slip"].iter().all(|of| !fault.contains(of));
        let changes = [
            &changes[..if imu { 2 } else { 0 }],
            std::slice::from_ref(&fault),
        ]
        .concat();
        let run = Run::with(&changes);
        assert!(
            run.outcome.end.notices.contains(name),
            "{fault}: {:?}",
            run.outcome.end.notices
        );
    }
}

/// Each sensor in turn has 3 and 10 times the noise of the world; encoders have no noise. Only bridges with 10 times
/// their noise are named. The robot measures the noise of its bridges; the axle filter allows for the noise of its
/// inertial sensors.
#[test]
fn noise_of_a_sensor_blames_no_sound_sensor() {
    let sensors = &Scenario::default().world.sensors;
    let (bridge, gyro) = (sensors.bridge.noise_strain, sensors.gyro.noise_density);
    for (key, figure, imu) in [
        ("bridge.noise_strain", bridge, false),
        ("bridge.noise_strain", bridge, true),
        ("gyro.noise_density", gyro, true),
        (
            "accelerometer.noise_density",
            sensors.accelerometer.noise_density,
            true,
        ),
    ] {
        for (factor, trial) in [3.0, 10.0].into_iter().flat_map(|by| [(by, 0), (by, 1)]) {
            let changes = [
                format!("sensors.{key}={:e}", factor * figure),
                format!("sensors.gyro.fitted={imu}"),
                format!("sensors.accelerometer.fitted={imu}"),
            ];
            let scenario = Scenario::parse(None, "", "test", &changes).unwrap();
            let mut simulation = Simulation::new(&scenario, 1, trial).unwrap();
            let outcome = regulate_on(&mut simulation, &scenario, |_| ()).unwrap();
            let named = SENSORS.into_iter();
            let named: Vec<_> = named
                .filter(|&one| outcome.end.notices.contains(one))
                .collect();
            let noisy = key.starts_with("bridge") && factor > 5.0;
            let gauges = [Condition::GaugesInconsistent];
            let faulty = &gauges[..usize::from(noisy)];
            assert_eq!(named, faulty, "{changes:?}, trial {trial}");
            assert!(
                outcome.end.is_success() && outcome.within,
                "{changes:?}, trial {trial}"
            );
        }
    }
}

/// A wrong zero of one gauge stops the robot; equal wrong zeros of all gauges do not.
#[test]
fn gauges_with_wrong_zeros_are_named() {
    let per_count = Scenario::default().world.sensors.bridge.strain_per_count();
    let [end, inner, all] = [
        [2.1e-4, 0.0, 0.0, 0.0, 0.0],
        [0.0, 2.1e-4, 0.0, 0.0, 0.0],
        [7.5e-5; 5],
    ];
    for (zeros, stop) in [
        (end, Some(Condition::WrenchHigh)),
        (inner, Some(Condition::EstimateInconsistent)),
        (all, None),
    ] {
        let counts = zeros.map(|zero| (zero / per_count) as i32);
        let run = Run::new(&Scenario::default(), Fault::GaugesShifted(counts), 0);
        let end = &run.outcome.end;
        let fault = end.condition.filter(|_| end.kind == EndKind::Stopped);
        assert_eq!(fault, stop, "{zeros:?}");
        assert!(
            run.outcome
                .end
                .notices
                .contains(Condition::GaugesInconsistent)
        );
        let why = run.simulation.monitor().why_stopped();
        assert_eq!(why.is_some(), stop.is_some());
        assert!(
            why.is_none_or(|why| why.contains("notices: ") && why.contains("gauges inconsistent"))
        );
    }
}

/// References of a front board that sends 100 ms late exceed the timeout of the rear axle, which does not arm.
#[test]
fn robot_does_not_drive_with_an_axle_that_does_not_arm() {
    let late = ["bus.late_ms=[100, 0, 0]".to_owned()];
    let run = Run::with(&late);
    let end = &run.outcome.end;
    assert_eq!(end.kind, EndKind::Stopped);
    assert_eq!(end.condition, Some(Condition::NeighbourFault));
    assert!(run.outcome.path_m < 0.05, "{}", run.outcome.path_m);
}
