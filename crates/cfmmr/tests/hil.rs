//! Hardware in the loop: boards behind serial frames give the same bits as in-process boards.

use crate::terminal::pseudo_terminal;
use cfmmr::experiments::posture::Variant;
use core_algos::link::Identity;
use core_algos::safety::{Condition, OperatingState};
use core_algos::topology::{Node, Role, Topology};
use host_sim::base::error::Error;
use host_sim::paths::Path;
use host_sim::run::bit_compare::Trace;
use host_sim::run::path_run;
use host_sim::run::path_run::{PathMode, Route};
use host_sim::run::regulate::{Outcome, regulate_on};
use host_sim::run::robot::Robot;
use host_sim::run::simulation::Simulation;
use host_sim::scenario::Scenario;
use host_sim::targets;
use host_sim::targets::{EventKind, Failure, FailureMode, InProcess, Target};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64;
use remote::Remote;
use remote::board_log::BoardLog;
use remote::images::Images;
use remote::link::{Link, Loopback};
use remote::serial::Serial;
use remote::virtual_link::VirtualLink;
use remote::virtual_robot::faults;
use remote::virtual_robot::faults::{End, FaultCase, RunKind, catalogue, model};
use std::fs::File;
use std::io::{self, Read, Write};
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::thread::{self, JoinHandle};
use std::time::Duration;

fn loopback(role: Role) -> Loopback {
    Loopback::new(Identity {
        build: "loopback",
        role,
    })
}

fn framed(role: Role) -> Box<dyn Target> {
    Box::new(Remote::new(Topology::PAIR, role, Box::new(loopback(role))))
}

/// Runs a mission and records its trace.
fn run(targets: Vec<Box<dyn Target>>, scenario: &Scenario, seed: u64) -> (Outcome, Trace) {
    let mut simulation = Simulation::on(targets, scenario, seed, 0).unwrap();
    simulation.record_trace();
    let outcome = regulate_on(&mut simulation, scenario, |_| {}).unwrap();
    for report in simulation.boards().reports() {
        println!("{report:?}");
    }
    (outcome, simulation.take_trace().unwrap())
}

fn assert_same(a: &Trace, b: &Trace) {
    if let Some(difference) = a.difference(b) {
        panic!("{difference}");
    }
}

/// Mission of a few seconds.
fn short() -> Scenario {
    let mut scenario = Scenario::default();
    scenario.mission.start = [-0.7, 0.0, 0.0];
    scenario
}

#[test]
fn paper_experiment_is_bit_identical_behind_frames() {
    for variant in Variant::PAIR {
        let scenario = variant.apply(&Scenario::default());
        let (outcome, framed) = run(Role::PAIR.map(framed).into(), &scenario, 1);
        let (reference, direct) = run(targets::in_process(Topology::PAIR), &scenario, 1);
        assert_same(&framed, &direct);
        assert!(
            outcome.end.is_success() && framed.ticks() > 8_000,
            "{}",
            framed.ticks()
        );
        assert_eq!(outcome.midpoint, reference.midpoint);
    }
}

#[test]
fn every_mixture_of_boards_is_bit_identical() {
    let scenario = short();
    let (_, direct) = run(targets::in_process(Topology::PAIR), &scenario, 2);
    for remote in Role::PAIR {
        let targets = Role::PAIR.map(|role| match role == remote {
            true => framed(role),
            false => Box::new(InProcess::new(Topology::PAIR, role)) as Box<dyn Target>,
        });
        assert_same(&run(targets.into(), &scenario, 2).1, &direct);
    }
}

#[test]
fn long_paths_are_bit_identical_behind_frames() {
    let mut scenario = Scenario::default();
    let route = Route::new(&Path::line(3.5).unwrap(), 1, &scenario).unwrap();
    scenario.mission.start = route.start();
    for path_mode in [PathMode::Follow, PathMode::Track] {
        let traces = [
            Role::PAIR.map(framed).into(),
            targets::in_process(Topology::PAIR),
        ]
        .map(|targets| {
            let mut simulation = Simulation::on(targets, &scenario, 3, 0).unwrap();
            simulation.record_trace();
            let outcome =
                path_run::drive_on(&mut simulation, &scenario, &route, path_mode, |_| {}).unwrap();
            assert!(outcome.end.is_success());
            simulation.take_trace().unwrap()
        });
        assert_same(&traces[0], &traces[1]);
    }
}

#[test]
fn runs_with_imu_and_bus_losses_are_bit_identical_behind_frames() {
    let mut scenario = Variant::ALL[6].apply(&short());
    scenario.world.bus.loss = 0.05;
    scenario.world.bus.latency_ms = 4;
    let (_, framed) = run(Role::PAIR.map(framed).into(), &scenario, 4);
    let (_, direct) = run(targets::in_process(Topology::PAIR), &scenario, 4);
    assert_same(&framed, &direct);
}

/// Serial link that loses and damages messages.
struct Unreliable {
    link: Loopback,
    random: Pcg64,
    loss: f64,
    damage: f64,
}

impl Unreliable {
    /// Bytes after random loss and damage.
    fn corrupt(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut bytes = bytes.to_vec();
        if self.random.random::<f64>() < self.loss {
            bytes.clear();
        }
        if self.random.random::<f64>() < self.damage && !bytes.is_empty() {
            let place = self.random.random_range(0..bytes.len());
            match self.random.random_range(0..3) {
                0 => bytes[place] ^= 1 << self.random.random_range(0..8),
                1 => drop(bytes.remove(place)),
                _ => bytes.truncate(place),
            }
        }
        bytes
    }
}

impl Link for Unreliable {
    fn name(&self) -> &'static str {
        "unreliable"
    }

    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let bytes = self.corrupt(bytes);
        self.link.send(&bytes)
    }

    fn receive(&mut self, room: &mut [u8], timeout: Duration) -> io::Result<usize> {
        let count = self.link.receive(room, timeout)?;
        let bytes = self.corrupt(&room[..count]);
        room[..bytes.len()].copy_from_slice(&bytes);
        Ok(bytes.len())
    }

    fn switch_off(&mut self) -> Result<(), Error> {
        self.link.switch_off()
    }

    fn switch_on(&mut self) -> Result<(), Error> {
        self.link.switch_on()
    }
}

#[test]
fn lost_and_damaged_serial_messages_are_repeated_without_effect() {
    let scenario = short();
    let targets = Role::PAIR.map(|role| {
        let link = Unreliable {
            link: loopback(role),
            random: Pcg64::seed_from_u64(Topology::PAIR.place(role) as u64),
            loss: 0.05,
            damage: 0.05,
        };
        Box::new(Remote::new(Topology::PAIR, role, Box::new(link))) as Box<dyn Target>
    });
    let mut simulation = Simulation::on(targets.into(), &scenario, 5, 0).unwrap();
    simulation.record_trace();
    regulate_on(&mut simulation, &scenario, |_| {}).unwrap();
    let trace = simulation.take_trace().unwrap();
    for report in simulation.boards().reports() {
        // Request or answer fails in one of five or six exchanges.
        let share = report.lost as f64 / trace.ticks() as f64;
        assert!(share > 0.1 && share < 0.4, "{report:?}");
        assert!(report.damaged > 100, "{report:?}");
    }
    assert_same(
        &trace,
        &run(targets::in_process(Topology::PAIR), &scenario, 5).1,
    );
}

/// Runs a mission in which a board is switched off after 3 s. With `clear` the host clears faults 1 s after a restart.
fn with_failure(
    targets: Vec<Box<dyn Target>>,
    role: Role,
    restart_after: Option<u32>,
    clear: bool,
) -> (Outcome, Simulation) {
    let scenario = Scenario::default();
    let mut simulation = Simulation::on(targets, &scenario, 1, 0).unwrap();
    let failure = Failure {
        role,
        at: 3000,
        mode: FailureMode::Off,
    };
    simulation.boards().plan(vec![failure], restart_after);
    if restart_after.is_some() && clear {
        simulation.recover();
    }
    let outcome = regulate_on(&mut simulation, &scenario, |_| {}).unwrap();
    for event in simulation.boards().events() {
        println!("{event}");
    }
    for status in simulation.monitor().changes() {
        println!("{status}");
    }
    (outcome, simulation)
}

fn assert_torques_zero(simulation: &Simulation) {
    let axles = simulation.plant().axles();
    assert!(axles.iter().all(|axle| axle.torque == [0.0; 2]));
}

/// Time from the failure of an axle's board until the motors of the other axle were off, ms; `None` if they stayed on.
fn motors_off(simulation: &mut Simulation) -> Option<u32> {
    let events = simulation.boards().events().iter();
    let mut times = events.filter_map(|event| match event.what {
        EventKind::MotorsOff(after) => Some(after),
        _ => None,
    });
    times.next()
}

/// A lost board is detected after 35 to 60 ms: messages are valid for 50 ms from the beginning of their epoch. Braking
/// takes 0.1 to 0.25 s, followed by 0.1 s at rest and 0.75 s to release the frame.
const STOP_MS: RangeInclusive<u32> = 35 + 950..=60 + 1100;

#[test]
fn robot_stopped_by_a_restart_rests_until_cleared() {
    let (outcome, simulation) = with_failure(
        targets::in_process(Topology::PAIR),
        Role::axle(1),
        Some(100),
        false,
    );
    assert!(!outcome.end.is_success());
    assert_torques_zero(&simulation);
    assert!(simulation.failure().unwrap().contains("neighbour lost"));
    let monitor = simulation.monitor();
    for (node, state) in [
        (Node::Lead, OperatingState::Fault),
        (Node::axle(0), OperatingState::Fault),
        // The rear axle has restarted, so it waits without a fault.
        (Node::axle(1), OperatingState::Idle),
    ] {
        assert_eq!(monitor.latest(node).unwrap().state, state, "{node:?}");
    }
}

#[test]
fn restarted_rear_board_stops_the_robot_until_cleared() {
    for targets in [
        Role::PAIR.map(framed).into(),
        targets::in_process(Topology::PAIR),
    ] {
        let (outcome, mut simulation) = with_failure(targets, Role::axle(1), Some(500), true);
        let off = motors_off(&mut simulation).unwrap();
        assert!(STOP_MS.contains(&off), "{off} ms");
        let restarted = |event: &targets::Event| event.what == EventKind::Restarted;
        assert!(simulation.boards().events().iter().any(restarted));
        assert!(outcome.end.is_success(), "the robot goes on to its goal");
        let [x, y, phi] = outcome.midpoint;
        println!("{:.4} m, {:.4} rad", x.hypot(y), phi);
        // Without a restart 5 mm and 10 mrad are usual. While the motors are off, the bent frame swings the axles,
        // and the tyres slip.
        assert!(x.hypot(y) < 0.05 && phi.abs() < 0.05, "{x} {y} {phi}");
    }
}

#[test]
fn restarted_front_board_ends_the_run_with_motors_off() {
    for targets in [
        Role::PAIR.map(framed).into(),
        targets::in_process(Topology::PAIR),
    ] {
        let (outcome, mut simulation) = with_failure(targets, Role::LEAD, Some(500), true);
        let off = motors_off(&mut simulation).unwrap();
        assert!(STOP_MS.contains(&off), "{off} ms");
        assert!(!outcome.end.is_success());
        assert!(simulation.failure().unwrap().contains("front board"));
        assert_torques_zero(&simulation);
        assert!(simulation.now() < 5_200_000);
    }
}

#[test]
fn lost_axle_ends_the_run_and_lost_beam_does_not() {
    let (outcome, mut simulation) =
        with_failure(Role::PAIR.map(framed).into(), Role::axle(1), None, true);
    let off = motors_off(&mut simulation).unwrap();
    assert!(STOP_MS.contains(&off), "{off} ms");
    let fault = simulation.monitor().first_fault().unwrap();
    assert_eq!(fault.reason, Some(Condition::NeighbourLost));
    assert!(
        !outcome.end.is_success()
            && simulation
                .failure()
                .unwrap()
                .contains("rear board was lost")
    );
    assert_torques_zero(&simulation);

    for restart_after in [None, Some(500)] {
        let targets = Role::PAIR.map(framed).into();
        let (outcome, simulation) = with_failure(targets, Role::beam(0), restart_after, true);
        assert!(outcome.end.is_success() && simulation.failure().is_none());
    }
}

/// Runs a mission with a fault and records its trace.
fn faulty(
    targets: Vec<Box<dyn Target>>,
    case: &FaultCase,
    unannounced: Option<(Role, FailureMode)>,
) -> (faults::Outcome, Trace) {
    let scenario = Scenario::default();
    let mut simulation = Simulation::on(targets, &scenario, case.seed, 0).unwrap();
    let at = model::tick(&scenario, case);
    let RunKind::Model(fault) = case.entry.kind.clone() else {
        panic!("{}", case.entry.name);
    };
    if let Some((role, mode)) = unannounced {
        let failure = Failure { role, at, mode };
        simulation.boards().plan(vec![failure], None);
    }
    simulation.record_trace();
    let outcome = model::run_on(&mut simulation, &scenario, case, fault).unwrap();
    (outcome, simulation.take_trace().unwrap())
}

#[test]
fn faults_of_boards_and_bus_are_bit_identical_behind_frames() {
    let all = catalogue(Topology::PAIR);
    let (crash, hang) = (FailureMode::Crash, FailureMode::Hang);
    for (name, unannounced) in [
        ("front board resets", None),
        ("front board freezes 0.3 s", None),
        ("rear clock slow by 0.2 %, no common time", None),
        ("bus corrupts 5 %", None),
        ("encoder missing", None),
        ("rear board lost", Some((Role::axle(1), crash))),
        ("front board lost", Some((Role::LEAD, hang))),
    ] {
        let entry = all.iter().find(|entry| entry.name == name).unwrap();
        // The fault begins within an epoch, not at its beginning.
        let (after_ms, seed) = (2_003, 3);
        let case = FaultCase {
            entry,
            after_ms,
            seed,
        };
        let (outcome, trace) = faulty(Role::PAIR.map(framed).into(), &case, unannounced);
        let (reference, expected) = faulty(targets::in_process(Topology::PAIR), &case, None);
        assert_same(&trace, &expected);
        assert_eq!(outcome, reference, "{name}");
        // The robot may drive on if the bus damages few frames.
        assert!(
            outcome.end == End::Stopped || name.starts_with("bus"),
            "{name}"
        );
    }
}

/// Path of a pseudo-terminal, and the thread of the board behind it; the thread ends when the host closes the terminal.
fn terminal(mut board: impl Link + 'static) -> (PathBuf, JoinHandle<()>) {
    let (master, path) = pseudo_terminal();
    let path = PathBuf::from(path);
    // Kept open until the host has opened the terminal, so that the terminal does not hang up before.
    let keep = File::options().read(true).write(true).open(&path).unwrap();
    let mut port = File::from(master);
    let board = thread::spawn(move || {
        let (mut room, mut answer) = ([0; 512], [0; 512]);
        let mut keep = Some(keep);
        while let Ok(count @ 1..) = port.read(&mut room) {
            keep = None;
            board.send(&room[..count]).unwrap();
            while let count @ 1.. = board.receive(&mut answer, Duration::ZERO).unwrap() {
                // Writing the answer to the last request fails, because the host has closed the terminal.
                let _ = port.write_all(&answer[..count]);
            }
        }
        drop(keep);
    });
    (path, board)
}

/// Front and rear boards are virtual, run their own image, and restart when the session begins.
#[test]
fn boards_on_serial_ports_are_bit_identical() {
    let mut scenario = short();
    scenario.mission.time_limit_s = 1.5;
    let images = Images::open(None, None).unwrap();
    let mut boards = Vec::new();
    let targets = Role::PAIR.map(|role| {
        let (path, board) = match role {
            Role::Axle(_) => {
                let log = BoardLog::new(Topology::PAIR.name(role));
                terminal(VirtualLink::start(&images, (Topology::PAIR, role), &log, None).unwrap())
            }
            _ => terminal(loopback(role)),
        };
        boards.push(board);
        let port = Serial::open(&path, 921_600).unwrap();
        Box::new(Remote::new(Topology::PAIR, role, Box::new(port))) as Box<dyn Target>
    });
    let (_, serial) = run(targets.into(), &scenario, 6);
    let (_, direct) = run(targets::in_process(Topology::PAIR), &scenario, 6);
    assert_eq!(serial.ticks(), 2000);
    assert_same(&serial, &direct);
    for board in boards {
        board.join().unwrap();
    }
}

#[test]
fn error_names_a_missing_or_wrong_port() {
    for path in ["/no/such/port", "/dev/null"] {
        let error = Serial::open(path.as_ref(), 921_600).err().unwrap();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains(path), "{error}");
    }
}

#[test]
fn error_names_a_board_at_the_wrong_port() {
    let swapped = [Role::axle(1), Role::LEAD, Role::beam(0)].map(framed_as);
    let error = Simulation::on(swapped.into(), &Scenario::default(), 1, 0)
        .err()
        .unwrap();
    assert_eq!(error.exit_code(), 2);
    let text = error.to_string();
    assert!(
        text.contains("front board") && text.contains("rear board"),
        "{text}"
    );
}

/// Board with another role than the host expects.
fn framed_as(actual: Role) -> Box<dyn Target> {
    let expected = match actual {
        Role::LEAD => Role::axle(1),
        Role::Axle(_) => Role::LEAD,
        Role::Beam(_) => Role::beam(0),
    };
    Box::new(Remote::new(
        Topology::PAIR,
        expected,
        Box::new(loopback(actual)),
    ))
}
