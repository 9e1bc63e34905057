//! Parameters of in-process and virtual boards over their links, and the commands `cfmmr params`.

use crate::program::{assert_refused, json_file, succeed};
use core_algos::link::Identity;
use core_algos::params::{Source, find};
use core_algos::topology::{Role, Topology};
use host_sim::targets::Target;
use remote::Remote;
use remote::board_log::BoardLog;
use remote::images::Images;
use remote::link::{Link, Loopback};
use remote::parameters::BoardParameter;
use remote::virtual_link::VirtualLink;
use std::fs;
use std::path::Path;

const RADIUS: &str = "robot.geometry.wheel_radius_m";
const GAIN: &str = "robot.beam.calibration.gain[3]";

fn loopback(role: Role, flash: &Path) -> Box<dyn Link> {
    let build = "loopback";
    Box::new(Loopback::keeping(Topology::PAIR, Identity { build, role }, flash).unwrap())
}

fn kept(remote: &mut Remote, name: &str) -> BoardParameter {
    let all = remote.parameters().unwrap();
    *all.iter().find(|kept| kept.parameter.name == name).unwrap()
}

/// Sets and saves parameters, resets the board, and checks that the saved values remain.
fn set_save_and_reset(link: Box<dyn Link>, role: Role) {
    let mut board = Remote::new(Topology::PAIR, role, link);
    board.start_session().unwrap();
    let first = kept(&mut board, RADIUS);
    assert_eq!(
        (first.value, first.source, first.saved),
        (0.073, Source::Default, true)
    );
    let radius = find(RADIUS).unwrap();
    board.set_parameter(radius, 0.0731).unwrap();
    board.set_parameter(find(GAIN).unwrap(), 1.25).unwrap();
    assert!(!kept(&mut board, RADIUS).saved);
    assert_eq!(board.save_parameters().unwrap(), 2);
    // The new value is set, but not saved.
    board.set_parameter(radius, 0.08).unwrap();
    assert_eq!(kept(&mut board, RADIUS).value, 0.08);
    for value in [0.6, f32::NAN] {
        let error = board.set_parameter(radius, value).unwrap_err().to_string();
        assert!(error.contains("wheel_radius_m") && error.contains("0.01 to 0.5"));
    }
    // Saving checks the values, which needs stack; in-process boards do not measure their stack.
    let stack = board.stack();
    assert!(!stack.is_some_and(|stack| stack.is_beyond()), "{stack:?}");
    board.switch_off().unwrap();
    board.switch_on().unwrap();
    board.start_session().unwrap();
    let after = kept(&mut board, RADIUS);
    assert_eq!(
        (after.value, after.source, after.saved),
        (0.0731, Source::Stored, true)
    );
    let own = board.own_parameters().unwrap();
    let own: Vec<_> = own.iter().map(|(p, value)| (p.name, *value)).collect();
    assert_eq!(own, [(RADIUS, 0.0731), (GAIN, 1.25)]);
}

#[test]
fn saved_parameters_remain_after_a_reset() {
    let folder = tempfile::tempdir().unwrap();
    for role in Role::PAIR {
        let file = folder.path().join(Topology::PAIR.name(role));
        set_save_and_reset(loopback(role, &file), role);
        // A new board on the same flash file has the saved value.
        let mut board = Remote::new(Topology::PAIR, role, loopback(role, &file));
        board.start_session().unwrap();
        assert_eq!(kept(&mut board, RADIUS).value, 0.0731);
    }
}

/// The board's own image writes its store to the chip's flash, which is a file.
#[test]
fn saved_parameters_remain_after_a_reset_of_a_virtual_board() {
    let images = Images::open(None, None).unwrap();
    let folder = tempfile::tempdir().unwrap();
    for role in Role::PAIR {
        let file = folder
            .path()
            .join(format!("a, b {}", Topology::PAIR.name(role)));
        let log = BoardLog::new(Topology::PAIR.name(role));
        let board = VirtualLink::start(&images, (Topology::PAIR, role), &log, Some(&file)).unwrap();
        set_save_and_reset(Box::new(board), role);
    }
    // An in-process board reads the flash file of the virtual board.
    let file = folder.path().join("a, b rear");
    let mut board = Remote::new(
        Topology::PAIR,
        Role::axle(1),
        loopback(Role::axle(1), &file),
    );
    board.start_session().unwrap();
    assert_eq!(kept(&mut board, RADIUS).value, 0.0731);
}

/// Wrong commands, each with parts of its error.
const WRONG: &str = "
set --board rear robot.geometry.wheel_radius_m=9 | robot.geometry.wheel_radius_m = 9 | 0.01 to 0.5
set --board rear robot.geometry.wheel_radius_m=nan | wheel_radius_m = NaN | 0.01 to 0.5
set --board rear robot.geometry.wheel_radius_m=wide | wheel_radius_m = wide | 0.01 to 0.5
set --board rear wheel_radius_m=0.07 | no such parameter | robot.geometry.wheel_radius_m
set robot.geometry.wheel_radius_m=0.07 | --board
get nonsense | nonsense | cfmmr parameters
import none.toml | none.toml
import wrong.toml | boards.rear | max_speed_m_s = 3 | 0.01 to 2
import other.toml | other.toml | plant
";

#[test]
fn error_of_a_wrong_command_names_the_allowed_values() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(
        folder.path().join("wrong.toml"),
        "[boards.rear]\nrobot.geometry.wheel_radius_m = 0.0731\nrobot.limits.max_speed_m_s = 3.0\n",
    )
    .unwrap();
    fs::write(
        folder.path().join("other.toml"),
        "[plant]\nfriction = 0.7\n",
    )
    .unwrap();
    assert_refused(folder.path(), "params", WRONG);
}

#[test]
fn parameters_are_exported_imported_and_used_as_scenario() {
    let folder = tempfile::tempdir().unwrap();
    let run = |arguments: &str| succeed(folder.path(), arguments);
    // Gauge positions are ascending, so the first two are moved together.
    let set = "params set --board beam --save robot.beam.strip.gauges_m[0]=0.09";
    let shown = run(&format!("{set} robot.beam.strip.gauges_m[1]=0.1"));
    assert!(shown.contains("2 values written"), "{shown}");
    // Setting a gauge position to its stored value succeeds.
    run(set);
    let set = "robot.geometry.wheel_radius_m=0.0731";
    let shown = run(&format!("params set --board rear {set}"));
    assert!(
        shown.contains("0.073") && shown.contains("not saved"),
        "{shown}"
    );
    let get = format!("params get {RADIUS} --json values.json");
    run(&get);
    let read = || json_file(folder.path(), "values.json")["parameters"].clone();
    assert_eq!(read()[1]["value"], 0.073, "it was not saved");
    run(&format!("params set --board rear,front --save {set}"));
    run(&get);
    let values = read();
    for (i, board, value) in [
        (0, "front", 0.0731),
        (1, "rear", 0.0731),
        (2, "beam", 0.073),
    ] {
        assert_eq!(values[i]["board"], board);
        assert!((values[i]["value"].as_f64().unwrap() - value).abs() < 1e-7);
        assert_eq!(values[i]["unit"], "m");
    }
    let list = run("params list --board rear");
    let mut lines = list.lines().skip_while(|line| !line.starts_with(RADIUS));
    let line = [lines.next().unwrap(), lines.next().unwrap()].concat();
    for word in ["rear", "0.0731", " m,", "0.01", "0.5", "0.073", "stored"] {
        assert!(line.contains(word), "no {word} in {line}");
    }
    run("params export --out mine.toml");
    let file = fs::read_to_string(folder.path().join("mine.toml")).unwrap();
    assert!(
        file.contains("[boards.rear]\nrobot.geometry.wheel_radius_m = 0.0731  # m, 0.01 to 0.5")
    );
    assert!(
        file.contains("robot.beam.strip.\"gauges_m[0]\" = 0.09  # m"),
        "{file}"
    );
    // Import to boards with default parameters gives equal parameters.
    run("params import mine.toml --save --flash others");
    assert_eq!(run("params export --flash others"), file);
    // The exported file is also a scenario.
    let config = run("config --scenario mine.toml");
    assert!(config.contains("[boards.rear.robot.geometry]\nwheel_radius_m = 0.0731"));
}
