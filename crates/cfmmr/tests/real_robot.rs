//! Robot at a serial port. The port is a pseudo-terminal, the robot has virtual boards.

#![allow(
    clippy::disallowed_methods,
    reason = "a test compares with another implementation"
)]

#[path = "shared/program.rs"]
mod program;
mod terminal;

use core_algos::safety::Condition;
use core_algos::topology::{Node, Role, Topology};
use host_sim::run::keyboard::Keyboard;
use host_sim::run::real_time::RealTimeLimiter;
use host_sim::run::robot::Robot;
use host_sim::scenario::Scenario;
use host_sim::targets::{Failure, FailureMode};
use host_sim::world;
use host_sim::world::World;
use program::{Run, json_file};
use recording::log::read;
use recording::log::read::Event;
use remote::board_log::BoardLog;
use remote::images::Images;
use remote::link::Descriptors;
use remote::virtual_robot::{Options, VirtualRobot};
use serde_json::Value;
use std::fs::{self, File};
use std::io::{Read, Write};
use std::os::fd::OwnedFd;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use terminal::pseudo_terminal;
use virtual_board::Time;

/// Port with a fixed name; `wire` is the board's end of the terminal, if plugged in.
struct Port {
    name: PathBuf,
    wire: Option<Descriptors>,
}

impl Port {
    fn plug(&mut self, plugged: bool) {
        if plugged == self.wire.is_some() {
            return;
        }
        self.wire = plugged.then(|| {
            let (master, path) = pseudo_terminal();
            // Not blocking, because a board sends on although the host does not read.
            rustix::io::ioctl_fionbio(&master, true).unwrap();
            symlink(path, &self.name).unwrap();
            let file = File::from(master);
            Descriptors::new(file.try_clone().unwrap(), file)
        });
        if !plugged {
            fs::remove_file(&self.name).unwrap();
        }
    }
}

/// Robot with its boards at ports, simulated in a thread until dropped.
struct RobotBench {
    topology: Topology,
    folder: TempDir,
    done: Arc<AtomicBool>,
    /// Switches the boards off for 0.5 s if true.
    cycle: Arc<AtomicBool>,
    robot: Option<JoinHandle<VirtualRobot>>,
}

impl RobotBench {
    /// Robot without failures. A `loose` cable is unplugged for 0.5 s of every 2 s from the first motion on.
    fn new(scenario: &Scenario, loose: bool) -> Self {
        Self::with(scenario, loose, Vec::new())
    }

    /// Robot with failures of boards.
    fn with(scenario: &Scenario, loose: bool, failures: Vec<Failure>) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let topology = scenario.robot.topology();
        let port = |role| Port {
            name: folder.path().join(topology.name(role)),
            wire: None,
        };
        let mut ports: Vec<Port> = topology.boards().map(port).collect();
        ports.iter_mut().for_each(|port| port.plug(true));
        let images = Images::open(None, None).unwrap();
        let options = Options {
            host: false,
            ..Options::default()
        };
        let logs = BoardLog::quiet(topology);
        let mut robot = VirtualRobot::new(scenario, &images, 1, 0, &options, &logs).unwrap();
        robot.plan(failures, None);
        let done = Arc::new(AtomicBool::new(false));
        let cycle = Arc::new(AtomicBool::new(false));
        let (end, off) = (done.clone(), cycle.clone());
        let robot = thread::spawn(move || {
            robot.control_mut().pace = Some(RealTimeLimiter::new(Keyboard::default()));
            let (mut room, mut moved) = ([0; 512], None);
            while !end.load(Relaxed) {
                if off.swap(false, Relaxed) {
                    robot.power(false);
                    for _ in 0..500 {
                        robot.step().unwrap();
                    }
                    robot.power(true);
                }
                robot.step().unwrap();
                if robot.speed() > 0.01 {
                    moved.get_or_insert(robot.now());
                }
                let since = moved.map_or(0, |moved| robot.now() - moved);
                ports[0].plug(!loose || since / 500_000 % 4 != 1);
                let now = Time::from_micros((robot.boot_s() * 1e6).round() as u64 + robot.now());
                for (role, port) in topology.boards().zip(&mut ports) {
                    // Reading fails while the host has not opened its end of the terminal.
                    let count = port
                        .wire
                        .as_mut()
                        .map(|wire| wire.receive(&mut room, Duration::ZERO));
                    let count = count.and_then(Result::ok).unwrap_or(0);
                    let board = robot.serial(role).unwrap();
                    board.send(&room[..count], now);
                    let sent = std::mem::take(&mut board.sent);
                    let _ = port.wire.as_mut().map(|wire| wire.send(&sent));
                }
            }
            robot
        });
        Self {
            topology,
            folder,
            done,
            cycle,
            robot: Some(robot),
        }
    }

    /// Robot at the origin of the default world.
    fn at_origin(loose: bool) -> Self {
        let mut scenario = Scenario {
            world: World::load(world::DEFAULT).unwrap(),
            ..Scenario::default()
        };
        scenario.mission.start = [0.0; 3];
        Self::new(&scenario, loose)
    }

    fn command(&self, folder: &Path, arguments: &str) -> Command {
        let front = self.port(Role::LEAD);
        program::command(folder, &format!("{arguments} --on serial:{front}"))
    }

    /// Option of the number of axles, if it is not the default.
    fn axles(&self) -> String {
        match self.topology.axle_count() {
            2 => String::new(),
            count => format!(" --axles {count}"),
        }
    }

    /// Port of a board, in the form for `--on serial:`.
    fn port(&self, role: Role) -> String {
        let name = self.topology.name(role);
        format!("{name}={}", self.folder.path().join(name).display())
    }

    fn run(&self, folder: &Path, arguments: &str) -> Run {
        self.command(folder, arguments).output().unwrap().into()
    }

    /// Stops the bench and returns its robot 1500 ticks later.
    fn robot(mut self) -> VirtualRobot {
        let mut robot = self.stop().unwrap().unwrap();
        for _ in 0..1500 {
            robot.step().unwrap();
        }
        robot
    }

    fn stop(&mut self) -> Option<thread::Result<VirtualRobot>> {
        self.done.store(true, Relaxed);
        self.robot.take().map(JoinHandle::join)
    }
}

/// Stops the simulation, which would take time from the next test.
impl Drop for RobotBench {
    fn drop(&mut self) {
        self.stop();
    }
}

fn assert_motors_off(robot: &VirtualRobot) {
    let axles = robot.plant().unwrap().axles();
    assert!(axles.iter().all(|axle| axle.torque == [0.0; 2]));
}

fn result(folder: &Path, command: &str) -> Value {
    json_file(folder, &format!("out/{command}/result.json"))
}

/// Options without effect on a real robot are refused. The command drives the robot to its goal and switches its motors
/// off. Unknown values are missing from the log, not zero.
#[test]
fn robot_at_a_serial_port_drives_to_its_goal() {
    let folder = tempfile::tempdir().unwrap();
    let mut scenario = Scenario::default();
    scenario.mission.start = [-0.4, 0.1, 0.2];
    let bench = RobotBench::new(&scenario, false);
    for wrong in [
        "posture --imu",
        "posture --set plant.friction=0.5",
        "follow --world ordinary",
        "track --kill rear@1",
    ] {
        bench.run(folder.path(), wrong).ends_with(2);
    }
    let run = bench.run(folder.path(), "posture --from -0.4,0.1,0.2");
    run.ends_with(0);
    let report = result(folder.path(), "posture");
    assert_eq!(
        (&report["end"]["kind"], &report["lost"]),
        (&"reached".into(), &0.into())
    );
    assert!(report["e_estimated_m"].as_f64().unwrap() < 0.02, "{report}");
    assert!(report["end"]["error_95"][0].as_f64().unwrap() > 0.0);
    let log = fs::read_to_string(folder.path().join("out/posture/log.csv")).unwrap();
    let mut lines = log.lines();
    let columns: Vec<&str> = lines.next().unwrap().split(',').collect();
    let last: Vec<&str> = lines.next_back().unwrap().split(',').collect();
    let cell = |name: &str| last[columns.iter().position(|column| *column == name).unwrap()];
    assert_eq!(
        (cell("truth.robot.x_m"), cell("truth.torque_nm[0]")),
        ("", "")
    );
    assert!(cell("lead.robot.x_m").parse::<f64>().unwrap().abs() < 0.02);
    let robot = bench.robot();
    let [x, y, _] = robot.record().midpoint;
    assert!(x.hypot(y) < 0.05, "{x} {y}");
    assert_motors_off(&robot);
}

/// A port that closes while the robot drives is reopened, and the path continues.
#[test]
fn loose_cable_does_not_end_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let bench = RobotBench::at_origin(true);
    let run = bench.run(folder.path(), "follow --path line --size 1.2");
    run.ends_with(0);
    let report = result(folder.path(), "follow");
    assert!(report["reconnected"].as_u64().unwrap() >= 2, "{report}");
    let [x, y, _] = bench.robot().record().midpoint;
    assert!((x - 1.2).hypot(y) < 0.05, "{x} {y}");
}

/// A script runs through the port as in process. The next command starts at the robot's estimate.
#[test]
fn script_drives_a_robot_at_a_serial_port() {
    let folder = tempfile::tempdir().unwrap();
    let bench = RobotBench::at_origin(false);
    let script = "goto 0.3 0.1 0.2\nspeed 0.1 0.4 1\nstop\nclear\npose 1 1 0\n";
    fs::write(folder.path().join("script"), script).unwrap();
    let run = bench.run(folder.path(), "drive --script script --from 0,0,0");
    assert_eq!(run.code, Some(0), "{}", run.error);
    let report = result(folder.path(), "drive");
    let steps = report["steps"].as_array().unwrap();
    assert_eq!(steps.len(), 5);
    assert!(
        steps
            .iter()
            .all(|step| ["reached", "done"].contains(&step["end"]["kind"].as_str().unwrap())),
        "{steps:?}"
    );
    assert_eq!(steps[2]["end"]["code"], Value::Null);
    // The picture and the page show the estimate.
    let picture = fs::read_to_string(folder.path().join("out/drive/paths.svg")).unwrap();
    assert!(picture.contains("as estimated") && !picture.contains("NaN"));
    let page = fs::read_to_string(folder.path().join("out/drive/report.html")).unwrap();
    assert!(page.contains("\"known\":false") && !page.contains("Wheel torques"));
    let [x, y] = [0, 1].map(|k| steps[3]["end"]["estimate"][k].as_f64().unwrap());

    let run = bench.run(folder.path(), "drive goto 1.3 1 0");
    assert_eq!(run.code, Some(0), "{}", run.error);
    let report = result(folder.path(), "drive");
    assert!(
        (report["steps"][0]["end"]["estimate"][0].as_f64().unwrap() - 1.3).abs() < 0.02,
        "{report}"
    );
    let [true_x, true_y, heading] = bench.robot().record().midpoint;
    let moved = (true_x - x).hypot(true_y - y);
    assert!(
        (moved - 0.3).abs() < 0.05 && heading > 0.1,
        "{moved} {heading}"
    );
}

/// The record of a robot replays bit-identically for each board with a connected port. The second command needs no
/// start posture.
#[test]
fn record_at_serial_ports_replays_identically() {
    let folder = tempfile::tempdir().unwrap();
    let bench = RobotBench::at_origin(false);
    let [front, rear, beam] = Role::PAIR.map(|role| bench.port(role));
    for (task, ports, boards) in [
        (
            "goto 0.3 0.1 0.2 --from 0,0,0",
            format!("{front},{rear},{beam}"),
            3,
        ),
        ("goto 0.6 0.1 0", front, 1),
    ] {
        let drive = format!("drive {task} --log run.mcap --on serial:{ports}");
        program::cfmmr(folder.path(), &drive).ends_with(0);
        program::cfmmr(folder.path(), "replay run.mcap --json replay.json").ends_with(0);
        let replayed = json_file(folder.path(), "replay.json");
        assert_eq!(replayed["identical"], true, "{replayed}");
        let bytes = fs::read(folder.path().join("run.mcap")).unwrap();
        let recording = read::read(&bytes, "run.mcap").unwrap();
        let ticks = recording.boards.iter().map(|events| {
            let ticks = events
                .iter()
                .filter(|event| matches!(event, Event::Tick(_)));
            ticks.count()
        });
        assert_eq!(ticks.filter(|ticks| *ticks > 2000).count(), boards);
    }
    let report = result(folder.path(), "drive");
    let x = report["steps"][0]["end"]["estimate"][0].as_f64().unwrap();
    assert!((x - 0.6).abs() < 0.02, "{report}");
}

/// A recording restarts the nodes, which is refused in a fault state.
#[test]
fn record_is_refused_while_a_node_is_in_fault() {
    let folder = tempfile::tempdir().unwrap();
    let (role, at, mode) = (Role::axle(1), 2500, FailureMode::Off);
    let mut scenario = Scenario::default();
    scenario.mission.start = [0.0; 3];
    let bench = RobotBench::with(&scenario, false, vec![Failure { role, at, mode }]);
    bench
        .run(folder.path(), "drive speed 0.1 0 60 --from 0,0,0")
        .ends_with(1);
    let run = bench
        .run(folder.path(), "drive goto 1 0 0 --log run.mcap")
        .ends_with(1);
    assert!(
        run.error
            .contains("Lead: Fault, neighbour lost (0x82): clear the fault"),
        "{}",
        run.error
    );
    assert_motors_off(&bench.robot());
}

/// A path longer than the board's buffer is sent in parts while the robot drives, followed by a second path.
#[test]
fn long_paths_are_fed_to_a_robot_at_a_serial_port() {
    let folder = tempfile::tempdir().unwrap();
    let bench = RobotBench::at_origin(false);
    let script = "follow line 2.7\nfollow line 0.2\n";
    fs::write(folder.path().join("script"), script).unwrap();
    let run = bench.run(folder.path(), "drive --script script --from 0,0,0");
    assert_eq!(run.code, Some(0), "{}{}", run.out, run.error);
    let [x, y, _] = bench.robot().record().midpoint;
    // The tolerance is wide because dead reckoning drifts over 3 m.
    assert!((x - 2.9).hypot(y) < 0.1, "{x} {y}");
}

/// Client in Python, written from the protocol page.
#[test]
fn python_client_drives_a_robot_to_its_goal() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let tools = Command::new(root.join("tools/scripts/client_python.sh")).output();
    let tools = Run::from(tools.unwrap()).ends_with(0);
    let bench = RobotBench::at_origin(false);
    let client = Command::new(tools.out.trim())
        .arg(root.join("tools/client/drive.py"))
        .arg(bench.folder.path().join(bench.topology.name(Role::LEAD)))
        .args(["0.3", "-0.1", "-0.2"])
        .output();
    let run = Run::from(client.unwrap()).ends_with(0);
    let [x, y, _] = bench.robot().record().midpoint;
    assert!((x - 0.3).hypot(y + 0.1) < 0.05, "{x} {y} {}", run.out);
}

/// First Ctrl-C: the robot brakes, its motors are switched off and the result is written. Second Ctrl-C: the motors are
/// switched off and the program ends at once.
#[test]
fn first_control_c_brakes_and_second_ends_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let bench = RobotBench::at_origin(false);
    for count in [1, 2] {
        let drive = format!("drive goto {} 0 0 --from 0,0,0", 2 * count);
        let mut child = bench.command(folder.path(), &drive).spawn().unwrap();
        thread::sleep(Duration::from_secs(4));
        for _ in 0..count {
            let process = rustix::process::Pid::from_child(&child);
            rustix::process::kill_process(process, rustix::process::Signal::INT).unwrap();
            thread::sleep(Duration::from_millis(100));
        }
        assert_eq!(child.wait().unwrap().code(), Some(130));
        let written = folder.path().join("out/drive/result.json");
        assert_eq!(written.exists(), count == 1);
        let _ = fs::remove_file(written);
    }
    let robot = bench.robot();
    assert_motors_off(&robot);
    assert!((0.3..1.9).contains(&robot.record().midpoint[0]));
}

/// The terminal of a drive by keyboard closes: the robot brakes, its motors are switched off, the result is written.
#[test]
fn closed_terminal_stops_the_robot_that_the_keyboard_drives() {
    let folder = tempfile::tempdir().unwrap();
    let bench = RobotBench::at_origin(false);
    let (master, path) = pseudo_terminal();
    let terminal = File::options().read(true).write(true).open(path).unwrap();
    let end = || Stdio::from(OwnedFd::from(terminal.try_clone().unwrap()));
    let mut command = bench.command(folder.path(), "drive --from 0,0,0");
    let command = command.stdin(end()).stdout(end()).stderr(end());
    let mut child = command.spawn().unwrap();
    rustix::io::ioctl_fionbio(&master, true).unwrap();
    let (mut keyboard, mut room) = (File::from(master), [0; 4096]);
    for tenth in 0..60 {
        // Discard the screen, so that the program does not block.
        while keyboard.read(&mut room).is_ok() {}
        if tenth == 25 {
            keyboard.write_all(b"wwww").unwrap();
        }
        thread::sleep(Duration::from_millis(100));
    }
    drop(keyboard);
    let deadline = Instant::now() + Duration::from_secs(30);
    while child.try_wait().unwrap().is_none() {
        if Instant::now() > deadline {
            child.kill().unwrap();
        }
        thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(child.wait().unwrap().code(), Some(130));
    let report = result(folder.path(), "drive");
    assert!(report["restless"].is_null(), "{report}");
    let robot = bench.robot();
    assert_motors_off(&robot);
    let [x, _, _] = robot.record().midpoint;
    assert!((0.05..1.0).contains(&x), "{x}");
}

/// A speed command needs a connected host: the robot brakes while the cable is unplugged, and then drives on.
#[test]
fn robot_brakes_while_its_cable_is_unplugged() {
    let folder = tempfile::tempdir().unwrap();
    let mut scenario = Scenario::default();
    scenario.mission.start = [0.0; 3];
    let bench = RobotBench::new(&scenario, true);
    let run = bench.run(folder.path(), "drive speed 0.15 0 7 --from 0,0,0");
    assert_eq!(run.code, Some(0), "{}", run.error);
    let report = result(folder.path(), "drive");
    let reconnected = &report["reconnected"];
    assert!(reconnected.as_u64().unwrap() >= 1, "{reconnected}");
    let robot = bench.robot();
    // Without interruption x would be 1.05 m; the port is unplugged for 0.5 s of every 2 s.
    let [x, _, _] = robot.record().midpoint;
    assert!((0.02..0.95).contains(&x), "{x}");
    let notices = robot.monitor().noticed(Node::Lead);
    assert!(notices.contains(Condition::CommanderSilent));
}

/// A robot whose host is killed stops on the way to its goal.
#[test]
fn robot_stops_when_its_host_is_lost() {
    let folder = tempfile::tempdir().unwrap();
    let bench = RobotBench::at_origin(false);
    let mut host = bench
        .command(folder.path(), "drive goto 4 0 0 --from 0,0,0")
        .spawn()
        .unwrap();
    thread::sleep(Duration::from_secs(6));
    host.kill().unwrap();
    host.wait().unwrap();
    thread::sleep(Duration::from_secs(4));
    let robot = bench.robot();
    let [x, _, _] = robot.record().midpoint;
    assert!((0.2..1.8).contains(&x), "{x}");
    let notices = robot.monitor().noticed(Node::Lead);
    assert!(robot.speed() < 0.01 && notices.contains(Condition::CommanderSilent));
}

/// A power cycle deletes the robot's task: the run ends with an error.
#[test]
fn power_cycle_of_the_robot_ends_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let bench = RobotBench::at_origin(false);
    for seconds in [2, 5] {
        let cycle = bench.cycle.clone();
        let cut = thread::spawn(move || {
            thread::sleep(Duration::from_secs(seconds));
            cycle.store(true, Relaxed);
        });
        let run = bench.run(folder.path(), "follow --path line --size 3");
        cut.join().unwrap();
        let error = run.ends_with(1).error;
        assert!(error.contains("front board: it was restarted"), "{error}");
    }
    // Only the motors are checked: without rolling resistance the simulated robot rolls on with its motors off.
    let robot = bench.robot();
    assert_motors_off(&robot);
}

/// A path is sent in parts while the robot drives. After `--stop-after` ends the run, the robot is at rest with its
/// motors off.
#[test]
fn robot_at_a_serial_port_is_stopped_at_the_end_of_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let bench = RobotBench::at_origin(false);
    let arguments = "follow --path line --size 3 --stop-after 4";
    bench.run(folder.path(), arguments).ends_with(0);
    let end = result(folder.path(), "follow")["end"].clone();
    assert!(
        end["kind"] == "interrupted" && end["reason"] == "by --stop-after",
        "{end}"
    );
    assert!(end["estimate"][0].as_f64().unwrap() > 0.1);
    let robot = bench.robot();
    let [x, y, _] = robot.record().midpoint;
    assert!((0.1..1.5).contains(&x) && y.abs() < 0.1, "{x} {y}");
    assert!(robot.speed() < 1e-3);
    assert_motors_off(&robot);
}

/// Parameters of all boards, read through the port of the front board.
fn parameters(bench: &RobotBench) -> Value {
    let folder = tempfile::tempdir().unwrap();
    let run = bench.run(
        folder.path(),
        &format!("params list{} --json -", bench.axles()),
    );
    run.ends_with(0).json()["parameters"].clone()
}

/// Each board keeps parameters saved through the port of the front board; a new robot imports them.
#[test]
fn parameters_of_all_boards_pass_the_port_of_the_front_board() {
    for axles in [2, 3] {
        parameters_pass_the_port_of_the_front_board(axles);
    }
}

fn parameters_pass_the_port_of_the_front_board(axles: u32) {
    let folder = tempfile::tempdir().unwrap();
    let mut scenario = Scenario::in_world(Some("ordinary")).unwrap();
    scenario.robot.geometry.axles = axles;
    let bench = RobotBench::new(&scenario, false);
    let run = |bench: &RobotBench, arguments: &str| {
        let arguments = format!("{arguments}{}", bench.axles());
        bench.run(folder.path(), &arguments).ends_with(0)
    };
    let before = parameters(&bench);
    let mut wanted = Vec::new();
    for (k, role) in bench.topology.boards().enumerate() {
        let (board, radius) = (bench.topology.name(role), 0.0731 + 1e-4 * k as f32);
        let value = format!("robot.geometry.wheel_radius_m={radius}");
        run(
            &bench,
            &format!("params set {value} --save --board {board}"),
        );
        wanted.push((Value::from(board), radius));
    }
    bench.cycle.store(true, Relaxed);
    let kept = parameters(&bench);
    let rows = kept.as_array().unwrap();
    let mut changed = Vec::new();
    for (before, after) in before.as_array().unwrap().iter().zip(rows) {
        if before != after {
            assert_eq!(
                (&after["source"], &after["saved"]),
                (&"stored".into(), &true.into())
            );
            changed.push((
                after["board"].clone(),
                after["value"].as_f64().unwrap() as f32,
            ));
        }
    }
    assert_eq!(changed, wanted);
    run(&bench, "params export --out robot.toml");
    drop(bench);

    let mut scenario = Scenario::default();
    scenario.robot.geometry.axles = axles;
    let new = RobotBench::new(&scenario, false);
    assert_ne!(parameters(&new), kept);
    run(&new, "params import robot.toml --save");
    new.cycle.store(true, Relaxed);
    assert_eq!(parameters(&new), kept);
}

/// `doctor` reports all three boards. Wrong calibrations are refused, and the gauges are zeroed through the front board
/// and the bus.
#[test]
fn gauges_are_zeroed_through_the_serial_port() {
    let folder = tempfile::tempdir().unwrap();
    let scenario = Scenario::in_world(Some("ordinary")).unwrap();
    let bench = RobotBench::new(&scenario, false);
    let zeros = |bench: &RobotBench| -> Vec<f64> {
        let all = parameters(bench);
        let rows = all.as_array().unwrap().iter();
        let of_beam = rows.filter(|row| row["board"] == "beam");
        let zeros = of_beam.filter(|row| row["name"].as_str().unwrap().contains("zero_counts"));
        zeros.map(|row| row["value"].as_f64().unwrap()).collect()
    };
    let doctor = bench.run(folder.path(), "doctor --json -");
    let found = doctor.ends_with(0).json();
    assert!(found["ok"] == true, "{found}");
    for (board, name) in found["boards"]
        .as_array()
        .unwrap()
        .iter()
        .zip(["front", "rear", "beam"])
    {
        assert_eq!(
            (&board["board"], &board["panics"]),
            (&name.into(), &0.into())
        );
        assert!(board["build"].as_str().unwrap().len() > 5, "{board}");
        assert!(board["stack_used"].as_u64().unwrap() > 10_000, "{board}");
    }
    let before = zeros(&bench);
    for (wrong, code) in [
        ("calibrate wheels --yes", 2),
        ("calibrate gauges", 2),
        ("calibrate gauges --yes --world ideal", 2),
        // The strip is straight, so the gauges show no strain for a gain.
        ("calibrate gauges --yes --former 2", 1),
    ] {
        bench.run(folder.path(), wrong).ends_with(code);
    }
    bench.run(folder.path(), "drive zero").ends_with(0);
    bench.cycle.store(true, Relaxed);
    let after = zeros(&bench);
    let moved = before.iter().zip(&after).filter(|(a, b)| a != b).count();
    assert!(moved >= 5, "{before:?} {after:?}");
    // The zeros change due to drift only.
    let largest = before
        .iter()
        .zip(&after)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max);
    assert!(largest < 600.0, "{before:?} {after:?}");
}

/// Port without a robot at its other end.
#[test]
fn port_without_a_robot_ends_with_no_answer() {
    let folder = tempfile::tempdir().unwrap();
    let (_master, path) = pseudo_terminal();
    let arguments = format!("posture --on serial:front={path} --out out");
    let run = program::cfmmr(folder.path(), &arguments).ends_with(1);
    assert!(
        run.error.contains("no answer") && run.error.contains("no robot answered"),
        "{}",
        run.error
    );
    assert!(!run.error.contains("stopped by itself"), "{}", run.error);
    let end = program::json_file(folder.path(), "out/result.json")["end"].clone();
    assert_eq!(end["kind"], "no answer", "{end}");
    assert!(end["estimate"].is_null() && folder.path().join("out/ends.csv").exists());
}
