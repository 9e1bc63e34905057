//! Robot on virtual boards, which run the images for real boards.

use crate::program;
use crate::program::{assert_refused, json_file, succeed};
use core_algos::bus::LeadMode;
use core_algos::bus::layout;
use core_algos::control::path::PathPoint;
use core_algos::link::framing::Decoder;
use core_algos::link::protocol::{self, Reply, Request};
use core_algos::link::{Order, Stamp};
use core_algos::math::Posture;
use core_algos::node::lead::Task;
use core_algos::topology::{Role, Topology};
use host_sim::run::robot::Robot;
use host_sim::scenario::Scenario;
use host_sim::targets::HostCommand;
use recording::log::read;
use recording::log::read::Event;
use remote::board_log::BoardLog;
use remote::images::Images;
use remote::virtual_robot::{Options, VirtualRobot};
use std::fs;
use virtual_board::Time;

const POSTURE: &str = "posture --on virtual";

#[test]
fn output_depends_on_seed_and_not_on_threads() {
    let folder = tempfile::tempdir().unwrap();
    let run = |name: &str, seed: &str, threads: &str| {
        let run = format!("--stop-after 0.8 --seed {seed} --threads {threads} --out {name}");
        succeed(folder.path(), &format!("{POSTURE} {run}"));
        program::RUN_FILES
            .map(|file| fs::read_to_string(folder.path().join(name).join(file)).unwrap())
    };
    let one = run("one", "1", "1");
    assert!(
        one[0].lines().count() > 50 && one[1].contains("front axle"),
        "{}",
        one[1]
    );
    let result = json_file(folder.path(), "one/result.json");
    for (log, board) in one[1..].iter().zip(result["boards"].as_array().unwrap()) {
        // The build that the board sends on the bus begins with the logged hash.
        let hash = log.lines().next().unwrap().rsplit(' ').next().unwrap();
        assert_eq!(board["build"], hash[..6], "{board}");
    }
    assert_eq!(one, run("two", "1", "2"));
    assert_ne!(one[0], run("other", "2", "1")[0]);
}

#[test]
fn file_that_is_no_image_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let program = fs::read(env!("CARGO_BIN_EXE_cfmmr")).unwrap();
    for (name, bytes) in [
        ("empty", &[][..]),
        ("cut", &program[..40]),
        ("of-this-machine", &program[..]),
        ("text", b"firmware"),
    ] {
        fs::write(folder.path().join(name), bytes).unwrap();
        let line = format!("--beam-image {name} --axle-image {name} | {name}");
        assert_refused(folder.path(), POSTURE, &line);
    }
    assert_refused(folder.path(), POSTURE, "--beam-image absent");
}

#[test]
fn damaged_or_wrong_image_is_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let image = remote::images::build("firmware-beam").unwrap();
    let keep = |bytes: &[u8]| fs::write(folder.path().join("beam"), bytes).unwrap();
    keep(&image);
    let line = "--axle-image beam | beam: firmware-beam image";
    assert_refused(folder.path(), POSTURE, line);
    // Flips a bit of the program, of the names in the log table, and of the last section's header.
    for place in [image.len() / 16, image.len() / 2, image.len() - 8] {
        let mut damaged = image.clone();
        damaged[place] ^= 4;
        keep(&damaged);
        assert_refused(folder.path(), POSTURE, "--beam-image beam | beam");
    }
    let note = image.windows(4).position(|part| part == b"GNU\0").unwrap();
    let mut stripped = image;
    stripped[note] = b'g';
    keep(&stripped);
    let line = "--beam-image beam | beam: damaged or stripped";
    assert_refused(folder.path(), POSTURE, line);
}

#[test]
fn options_without_effect_on_images_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let table = "
        --set robot.axle.rest_hold_s=0.2
        --set boards.front.button.goal.x=1.0
        --set robot.lead.course.path.min_speed_m_s=0.05
        --rows all";
    assert_refused(folder.path(), POSTURE, table);
}

#[test]
fn robot_drives_with_other_sensors_and_goals() {
    let folder = tempfile::tempdir().unwrap();
    for arguments in [
        "--imu --seed 1 --stop-after 0.3",
        "--imu --seed 2 --stop-after 0.3",
        "--no-rps --stop-after 2",
        "--from=-0.3,0.1,0.2 --set mission.goal=[0.2,0.1,0.1]",
    ] {
        succeed(folder.path(), &format!("{POSTURE} {arguments}"));
    }
}

/// Robot with the logs of its boards.
fn robot(scenario: &Scenario) -> (VirtualRobot, Vec<BoardLog>) {
    let images = Images::open(None, None).unwrap();
    let logs = BoardLog::quiet(Topology::PAIR);
    let robot = VirtualRobot::new(scenario, &images, 1, 0, &Options::default(), &logs);
    (robot.unwrap(), logs)
}

#[test]
fn copy_of_a_robot_continues_identically() {
    let scenario = Scenario::default();
    let (mut robot, _) = robot(&scenario);
    robot
        .command(&HostCommand::Task(Task::regulate(Posture::default())))
        .unwrap();
    let course = |robot: &mut VirtualRobot| {
        let tick = |_| {
            robot.step().unwrap();
            (robot.record(), robot.frames())
        };
        format!("{:?}", (0..300).map(tick).collect::<Vec<_>>())
    };
    let before = course(&mut robot);
    let mut copies = [(); 2].map(|()| robot.clone());
    let after = course(&mut copies[0]);
    assert_ne!(before, after);
    assert!(course(&mut robot) == after && course(&mut copies[1]) == after);
}

/// With the motors off, the beam board logs the noise of its bridges, caused by gauges and converter.
#[test]
fn beam_board_at_rest_logs_noise_of_its_bridges() {
    let scenario = Scenario::default();
    let (mut robot, logs) = robot(&scenario);
    for _ in 0..11_500 {
        robot.step().unwrap();
    }
    let log = logs[2].text();
    let line = log
        .lines()
        .find(|line| line.contains("noise of the bridges"));
    let counts = line.unwrap_or_else(|| panic!("{log}"));
    let counts = counts
        .split(['[', ']', ','])
        .filter_map(|part| part.trim().parse::<f64>().ok());
    let counts: Vec<f64> = counts.filter(|&count| count > 0.0).collect();
    // A 12-bit conversion has a noise of 0.6 counts and a rounding noise of 0.29; a reading is the sum of 96.
    let bridge = &scenario.world.sensors.bridge;
    let gauge = bridge.noise_strain * bridge.gauge_factor * f64::from(bridge.active_gauges) / 4.0;
    let converter = 0.6f64.hypot(0.29) / 4096.0 / 96f64.sqrt();
    let expected = 96.0 * 4096.0 * (gauge * bridge.amplifier_gain).hypot(converter);
    assert_eq!(counts.len(), 5, "{counts:?}");
    for count in counts {
        assert!(
            (0.8..1.3).contains(&(count / expected)),
            "{count}, expected {expected}"
        );
    }
}

/// Reply of the rear board to a request at its serial port.
fn reply_of_rear(robot: &mut VirtualRobot, number: u8, request: &Request) -> String {
    let frame = protocol::encode(number, request).unwrap();
    let now = Time::from_micros(((robot.boot_s() * 1e6).round() as u64) + robot.now());
    robot
        .serial(Role::axle(1))
        .unwrap()
        .send(frame.bytes(), now);
    for _ in 0..20 {
        robot.step().unwrap();
    }
    let mut decoder = Decoder::new();
    let sent = std::mem::take(&mut robot.serial(Role::axle(1)).unwrap().sent);
    let mut replies = sent.iter().filter_map(|&byte| {
        let (answered, reply) = protocol::decode::<Reply>(decoder.take_byte(byte)?)?;
        (answered == number).then(|| format!("{reply:?}"))
    });
    replies.next().unwrap()
}

/// The rear board refuses an order, and the robot refuses a path that is too tight. An order at the front board's port
/// drives the robot to its goal.
#[test]
fn orders_at_the_serial_port_drive_the_robot() {
    let scenario = Scenario::default();
    let (mut robot, _) = robot(&scenario);
    let [x, y, _] = scenario.mission.start.map(|value| value as f32);
    let goal = Posture::new(x + 0.8, y + 0.1, 0.2);
    let drive = HostCommand::Task(Task::regulate(goal));
    let stamp = Stamp::default();
    let order = Order::Task(Task::regulate(goal));
    let request = Request::Order { stamp, order };
    assert!(reply_of_rear(&mut robot, 1, &request).contains("OtherBoard"));
    let tight = PathPoint {
        posture: goal,
        kappa: 100.0,
        s: 0.0,
    };
    robot
        .command(&HostCommand::Path {
            points: vec![tight],
            end: true,
        })
        .unwrap();
    let error = (0..100).find_map(|_| robot.step().err()).unwrap();
    assert_eq!(error.exit_code(), 2, "{error}");
    robot.command(&drive).unwrap();
    assert!(!robot.is_settled());
    for _ in 0..3000 {
        robot.step().unwrap();
    }
    // A driving board refuses a session.
    assert!(robot.is_settled() && robot.speed() > 0.05);
    assert!(reply_of_rear(&mut robot, 2, &Request::Rig).contains("Armed"));
    for _ in 0..8000 {
        robot.step().unwrap();
    }
    let [dx, dy] = [0, 1].map(|i| robot.record().midpoint[i] - [goal.x, goal.y].map(f64::from)[i]);
    let lead = robot.record().lead;
    assert_eq!((lead.mode, lead.done), (LeadMode::Hold, true));
    assert!(dx.hypot(dy) < 0.05, "{dx} {dy}");
    for board in robot.reports() {
        assert!(
            board.resets.is_empty() && board.findings.is_empty(),
            "{board:?}"
        );
        assert!(
            board.longest_tick_us <= 750 && board.missed_ticks == 0,
            "{board:?}"
        );
    }
}

/// The front board reports every frame on the bus.
#[test]
fn reports_of_the_front_board_hold_every_frame_on_the_bus() {
    let (mut robot, _) = robot(&Scenario::default());
    let goal = Posture::ORIGIN;
    robot
        .command(&HostCommand::Task(Task::regulate(goal)))
        .unwrap();
    for _ in 0..500 {
        robot.step().unwrap();
    }
    let before = robot.frames();
    let mut frames = Vec::new();
    for _ in 0..2000 {
        robot.step().unwrap();
        frames.extend_from_slice(robot.reported());
    }
    let on_wire = (robot.frames() - before) as i64;
    assert_eq!(robot.link().lost(), 0);
    // A few frames are in transit at the start and at the end.
    assert!(on_wire > 3500, "{on_wire}");
    let difference = frames.len() as i64 - on_wire;
    assert!(difference.abs() <= 12, "{difference} of {on_wire}");
    let steps = |id| frames.iter().filter(|frame| frame.id == id).count();
    assert_eq!(steps(layout::id::LEAD_STATUS), 200);
    assert!((199..=201).contains(&steps(layout::id::TIME_SYNC)));
}

/// The replay of each board of a recorded run is bit-identical, also of a board that was restarted during the run.
#[test]
fn record_of_virtual_boards_replays_identically() {
    let folder = tempfile::tempdir().unwrap();
    for task in [
        "follow --path line --size 0.6 --imu",
        "drive goto 0.3 0.1 0.2 --kill rear@2 --restart-after 0.3",
    ] {
        succeed(
            folder.path(),
            &format!("{task} --on virtual --log run.mcap"),
        );
        succeed(folder.path(), "replay run.mcap --json replay.json");
        let report = json_file(folder.path(), "replay.json");
        assert_eq!(report["identical"], true, "{report}");
        let bytes = fs::read(folder.path().join("run.mcap")).unwrap();
        let recording = read::read(&bytes, "run.mcap").unwrap();
        let count = |role: Role| {
            let events = recording.boards[Topology::PAIR.place(role)].iter();
            events.fold([0; 2], |[starts, ticks], event| match event {
                Event::Start { .. } => [starts + 1, ticks],
                Event::Tick(_) => [starts, ticks + 1],
                _ => [starts, ticks],
            })
        };
        let restarted = usize::from(task.contains("--kill"));
        for (role, starts) in [
            (Role::LEAD, 1),
            (Role::axle(1), 1 + restarted),
            (Role::beam(0), 1),
        ] {
            let [begun, ticks] = count(role);
            assert_eq!(begun, starts, "{} board", Topology::PAIR.name(role));
            // The boards start one after the other; a board without power has no ticks.
            let least =
                recording.ticks() - 150 - 1000 * restarted * usize::from(role == Role::axle(1));
            assert!(
                ticks >= least,
                "{} board: {ticks}",
                Topology::PAIR.name(role)
            );
        }
        let outputs = report["recorded"]["count"].as_u64().unwrap() as usize;
        assert!(outputs * 10 + 170 > recording.ticks(), "{outputs}");
    }
}

/// Along a path and a trajectory, a robot on virtual boards and an in-process robot have nearly equal final errors.
#[test]
fn paths_on_virtual_boards_end_as_in_process() {
    let folder = tempfile::tempdir().unwrap();
    for command in ["follow", "track"] {
        let run = |place: &str| {
            let arguments = format!("{command} --path line --size 0.5 --on {place}");
            succeed(folder.path(), &arguments);
            let result = json_file(folder.path(), &format!("out/{command}/result.json"));
            assert_eq!(result["end"]["kind"], "reached", "{command} {place}");
            result["final_m"].as_f64().unwrap()
        };
        let [inside, outside] = ["in-process", "virtual"].map(run);
        assert!(
            (inside - outside).abs() < 0.002,
            "{command}: {inside} {outside}"
        );
    }
}
