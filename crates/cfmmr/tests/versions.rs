//! Compatibility with logs and stored parameters of version 0.1.

use crate::program::cfmmr;
use core_algos::params::{BoardKind, Contents, Settings, TABLE, find};
use core_algos::topology::Role;
use recording::log::read;

/// Log of a robot at rest for 130 ms, recorded by version 0.1.
const LOG: &[u8] = include_bytes!("data/log_0.1.mcap");
/// Parameters of version 0.1: identifier, version, name, lowest and highest value.
const PARAMETERS: &str = include_str!("data/parameters_0.1.txt");

#[test]
fn log_of_version_0_1_is_read() {
    let log = read::read(LOG, "log_0.1.mcap").unwrap();
    assert_eq!(log.ticks(), 130);
    for events in &log.boards {
        let started = events[0].config().unwrap();
        assert_eq!(started.geometry.frame_length_m, 0.37);
        assert_eq!(started.lead.limits.bend_rad, 0.7);
    }
}

/// Replays a log whose scenario has keys of version 0.1.
#[test]
fn log_of_version_0_1_is_replayed() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("log.mcap"), LOG).unwrap();
    let run = cfmmr(folder.path(), "replay log.mcap");
    assert!(run.out.contains("beam board: 130 ticks"), "{}", run.error);
}

#[test]
fn stored_parameters_of_version_0_1_are_read() {
    for row in PARAMETERS.lines() {
        let columns: Vec<&str> = row.split(' ').collect();
        let [id, version, name, low, high] = columns[..] else {
            panic!("{row}");
        };
        let parameter = find(name).unwrap();
        let stands = (parameter.id.to_string(), parameter.version.to_string());
        assert_eq!(stands, (id.to_owned(), version.to_owned()), "{name}");
        for value in [low, high].map(|value| value.parse::<f32>().unwrap()) {
            assert_eq!(parameter.validate(value), Ok(value), "{name}");
        }
    }
    assert!(PARAMETERS.lines().count() <= TABLE.len());
    // Stored parameter: version 1, generation 7, value 0.0731 in single precision.
    let bytes = [1, 7, 0, 0, 0, 0x74, 0xb5, 0x95, 0x3d];
    let mut contents = Contents::default();
    contents.take(1, &bytes);
    let own = Settings::of(BoardKind::FrontAxle);
    let (settings, _) = contents.resolve(&own, |settings| settings.check(Role::LEAD));
    assert_eq!(settings.robot.geometry.wheel_radius_m, 0.0731);
}
