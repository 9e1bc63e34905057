//! `cfmmr drive`: scripts and single steps.

#[path = "../../../firmware-axle/examples/law/mod.rs"]
mod law;

use crate::program::command;
use core_algos::math::Posture;
use core_algos::node::lead::Task;
use core_algos::topology::{Role, Topology};
use host_sim::run::regulate::regulate;
use host_sim::run::robot::Robot;
use host_sim::scenario::Scenario;
use host_sim::scenario::own::Own;
use host_sim::targets::HostCommand;
use remote::board_link::BoardLink;
use remote::board_log::BoardLog;
use remote::images::Images;
use remote::virtual_robot::{Options, VirtualRobot};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};
use virtual_board::Time;

const SCRIPT: &str = "goto 0.3 0.1 0.2\nspeed 0.1 0.4 1\nstop\nclear\ngoto 0 0 0\n";

fn drive(folder: &Path, arguments: &[&str]) -> Output {
    command(folder, "drive").args(arguments).output().unwrap()
}

fn steps(output: &Output) -> Vec<Value> {
    let result: Value = serde_json::from_slice(&output.stdout).unwrap();
    result["steps"].as_array().unwrap().clone()
}

#[test]
fn script_is_driven_in_process_and_on_virtual_boards_alike() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("script"), SCRIPT).unwrap();
    let [simulated, boards] = ["in-process", "virtual"].map(|on| {
        let output = drive(
            folder.path(),
            &["--script", "script", "--on", on, "--json", "-"],
        );
        assert_eq!(output.status.code(), Some(0), "{on}: {output:?}");
        steps(&output)
    });
    assert_eq!((simulated.len(), boards.len()), (5, 5));
    for (simulated, board) in simulated.iter().zip(&boards) {
        assert_eq!(simulated["line"], board["line"]);
        for key in ["kind", "code"] {
            let [a, b] = [simulated, board].map(|step| &step["end"][key]);
            assert_eq!(a, b, "{simulated} {board}");
        }
        let kind = simulated["end"]["kind"].as_str().unwrap();
        assert!(["reached", "done"].contains(&kind), "{simulated}");
        let truth = |step: &Value, k: usize| step["end"]["truth"][k].as_f64().unwrap();
        let off = |k: usize| truth(simulated, k) - truth(board, k);
        assert!(off(0).hypot(off(1)) < 0.004, "{simulated} {board}");
    }
}

#[test]
fn failed_step_ends_the_script_with_exit_1_and_its_code() {
    let folder = tempfile::tempdir().unwrap();
    // With a low bend limit, the robot stops in the second step.
    let limit = "robot.lead.limits.bend_rad=0.06";
    let script = "speed 0.1 0 1\nspeed 0.1 1.5 5\nstop\n";
    fs::write(folder.path().join("script"), script).unwrap();
    let output = drive(
        folder.path(),
        &["--script", "script", "--set", limit, "--json", "-"],
    );
    assert_eq!(output.status.code(), Some(1), "{output:?}");
    let steps = steps(&output);
    assert_eq!(steps.len(), 2);
    let kinds = [0, 1].map(|k| steps[k]["end"]["kind"].as_str().unwrap());
    assert_eq!(kinds, ["done", "stopped"]);
    assert_eq!(steps[1]["end"]["code"], "0x86");
}

#[test]
fn single_step_is_executed_and_a_wrong_step_refused() {
    let folder = tempfile::tempdir().unwrap();
    let output = drive(
        folder.path(),
        &["goto", "-.4", "0", "0.1", "--from", "0,0,0", "--json", "-"],
    );
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let x = steps(&output)[0]["end"]["estimate"][0].as_f64().unwrap();
    assert!((x + 0.4).abs() < 0.01, "{x}");

    fs::write(folder.path().join("wrong"), "goto 1 0 0\nfolow circle\n").unwrap();
    for (arguments, named) in [
        (&["goto", "1", "2"][..], "goto X Y PHI"),
        (
            &["speed", "0.1", "0", "0"],
            "SECONDS = 0: must be a number from 0.05",
        ),
        (&["zero"], "zero: must have --on virtual"),
        (
            &[
                "speed", "0.1", "0", "1", "--on", "virtual", "--kill", "rear@12",
            ],
            "12 s: must be before the run ends, at 11.5 s",
        ),
        (&["--script", "wrong"], "line 2: folow circle"),
        (&["--script", "none"], "--script none"),
        (&["follow", "circle", "0.2"], "curvature"),
        (&[], "STEP or --script FILE"),
    ] {
        let output = drive(folder.path(), arguments);
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{text}");
        assert!(text.contains(named), "{text}");
    }
}

/// Default number of rounds of the reaction time tests; the environment variable `ROUNDS` overrides it.
const ROUNDS: u64 = 3;

fn rounds() -> u64 {
    std::env::var("ROUNDS").map_or(ROUNDS, |text| text.parse().unwrap())
}

/// Reaction of the robot to a speed command: torque within 25 ms of the command, and a lower speed reference within
/// 220 ms of the last command. Commands come at different phases of the boards' epochs.
#[test]
fn speed_command_acts_within_25_ms_and_its_absence_within_220_ms() {
    let images = Images::open(None, None).unwrap();
    let logs = BoardLog::quiet(Topology::PAIR);
    let scenario = Scenario::default();
    let mut robot =
        VirtualRobot::new(&scenario, &images, 1, 0, &Options::default(), &logs).unwrap();
    let rounds = rounds();
    let torque = |robot: &VirtualRobot| {
        let axles = robot.plant().unwrap().axles();
        axles
            .iter()
            .map(|axle| axle.torque.iter().sum::<f64>())
            .sum::<f64>()
            .abs()
    };
    let speed = |speed_m_s: f32| {
        HostCommand::Task(Task::Drive {
            speed_m_s,
            curvature: 0.0,
        })
    };
    let run = |robot: &mut VirtualRobot, ticks: u64| {
        for _ in 0..ticks {
            robot.step().unwrap();
        }
    };
    let (mut most_to_torque, mut most_to_brake) = (0, 0);
    for round in 0..rounds {
        robot.command(&HostCommand::Task(Task::Stop)).unwrap();
        run(&mut robot, 1500 + 7 * round);
        let noise = (0..100).map(|_| {
            robot.step().unwrap();
            torque(&robot)
        });
        let noise = noise.fold(0.0, f64::max);
        let direction = if round % 2 == 0 { 0.2 } else { -0.2 };
        robot.command(&speed(direction)).unwrap();
        let to_torque = (1..100).find(|_| {
            robot.step().unwrap();
            torque(&robot) > 1.5 * noise + 0.002
        });
        most_to_torque = most_to_torque.max(to_torque.unwrap());
        for _ in 0..20 {
            robot.command(&speed(direction)).unwrap();
            run(&mut robot, 50);
        }
        robot.command(&speed(direction)).unwrap();
        let before = robot.record().lead.motion.v.abs();
        assert!(before > 0.15, "{before}");
        let to_brake = (1..400).find(|_| {
            robot.step().unwrap();
            robot.record().lead.motion.v.abs() < before - 1e-4
        });
        most_to_brake = most_to_brake.max(to_brake.unwrap());
    }
    println!("{rounds} rounds: torque after {most_to_torque} ms, brake after {most_to_brake} ms");
    assert!(
        most_to_torque <= 25 && most_to_brake <= 220,
        "{most_to_torque} {most_to_brake}"
    );
    for board in robot.reports() {
        assert!(
            board.longest_tick_us <= 750 && board.findings.is_empty(),
            "{board:?}"
        );
    }
}

/// The serial cable is unplugged while the robot drives, at different phases of drive, lease and epochs. The robot
/// stops, and a host that reconnects commands it again.
#[test]
fn robot_without_cable_stops_and_a_reconnected_host_commands_it() {
    let images = Images::open(None, None).unwrap();
    let logs = BoardLog::quiet(Topology::PAIR);
    let (scenario, options) = (
        Scenario::default(),
        Options {
            host: false,
            ..Options::default()
        },
    );
    let mut robot = VirtualRobot::new(&scenario, &images, 1, 0, &options, &logs).unwrap();
    let boot = (robot.boot_s() * 1e6).round() as u64;
    let mut link = BoardLink::new(Topology::PAIR, Role::LEAD, 7);
    link.open();
    let place = scenario
        .robot
        .placement(Posture::ORIGIN, &scenario.mission.configured_placement());
    link.command(&HostCommand::SetPose(place));
    let mut tick = |link: &mut BoardLink, plugged: bool| {
        let now = boot + robot.now();
        let sent = plugged.then(|| link.to_send(now).unwrap()).flatten();
        let port = robot.serial(Role::LEAD).unwrap();
        port.send(sent.unwrap_or_default(), Time::from_micros(now));
        robot.step().unwrap();
        let answer = std::mem::take(&mut robot.serial(Role::LEAD).unwrap().sent);
        if plugged {
            link.take(&answer).unwrap();
            link.take_frames();
        }
        robot.speed()
    };
    let mut longest = 0;
    for round in 0..rounds() {
        let goal = Posture::new(if round % 2 == 0 { 2.0 } else { -2.0 }, 0.0, 0.0);
        link.command(&HostCommand::Task(Task::regulate(goal)));
        let driven = (0..1500 + 17 * round).map(|_| tick(&mut link, true)).last();
        let driven = driven.unwrap();
        assert!(driven > 0.05, "{round}: {driven}");
        let stopped = (0..3000).find(|_| tick(&mut link, false) < 2e-3).unwrap();
        assert!(stopped > 900, "{round}: {stopped}");
        longest = longest.max(stopped);
        link.rejoin();
        (0..300).for_each(|_| assert!(tick(&mut link, true) < 1.0));
        assert!(link.is_settled() && link.is_fresh());
    }
    println!("{} rounds: at rest within {longest} ms", rounds());
    assert!(longest <= 2000, "{longest}");
}

/// The control law of the example drives the robot, in process and in the image of the example.
#[test]
fn own_controller_replaces_the_regulator() {
    let mut scenario = Scenario::default();
    scenario.own = Own::default().with_controller(law::Polar::default);
    let outcome = regulate(&scenario, 1, 0, |_| ()).unwrap();
    assert!(outcome.end.is_success() && outcome.plans == 0);
    let [x, y, _] = outcome.midpoint;
    assert!(x.hypot(y) < 0.05, "{x} {y}");

    let target = "thumbv7em-none-eabihf";
    let package = ["--package", "firmware-axle", "--example", "own_controller"];
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let built = Command::new(env!("CARGO"))
        .args([
            "build",
            "--quiet",
            "--locked",
            "--profile",
            "image",
            "--target",
            target,
        ])
        .args(package)
        .current_dir(&root)
        .status();
    assert!(built.unwrap().success());
    let folders = std::env::var("CARGO_TARGET_DIR").map_or(root.join("target"), Into::into);
    let image = folders.join(target).join("image/examples/own_controller");
    let folder = tempfile::tempdir().unwrap();
    let line = "posture --on virtual --from=-0.5,0.1,0.1 --json - --axle-image";
    let run = command(folder.path(), line).arg(image).output().unwrap();
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let result: Value = serde_json::from_slice(&run.stdout).unwrap();
    let e_m = result["e_m"].as_f64().unwrap();
    assert!(e_m < 0.05, "{e_m}");
}
