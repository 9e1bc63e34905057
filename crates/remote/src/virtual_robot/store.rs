//! Stored parameters of a calibrated robot's board, in the format that the board itself writes.

use super::beam::{BridgeParts, zero};
use crate::link::stored_flash;
use core_algos::acquisition::oversampling::FULL_SCALE;
use core_algos::params::{BoardKind, Button, Settings, TABLE};
use core_algos::topology::Role;
use host_sim::base::error::Error;
use host_sim::scenario::Scenario;
use host_sim::world::drawn::{Drawn, FrameErrors};

/// Offset of the store's first sector in the flash, bytes. The store has sectors 1 to 3.
pub const FIRST: usize = 16 << 10;

/// Contents of the flash sectors that hold a board's parameters in a scenario.
pub fn sectors(
    scenario: &Scenario,
    role: Role,
    (drawn, bridges): &(Drawn, Vec<Vec<BridgeParts>>),
) -> Result<Vec<u8>, Error> {
    let base = Settings::of(BoardKind::of(role));
    let mut settings = configured_settings(scenario, role)?;
    if let Role::Beam(frame) = role {
        let (bridges, drawn) = (&bridges[frame.index()], &drawn.frames[frame.index()]);
        calibrate(scenario, &mut settings, bridges, drawn)?;
    }
    stored_flash(&settings, &base)
}

/// Settings of a board in a scenario. Settings without a board parameter must keep their default.
fn configured_settings(scenario: &Scenario, role: Role) -> Result<Settings, Error> {
    let mut configured = Settings::new(scenario.completed_robot()).placed(role);
    let [start, goal] = [scenario.mission.start, scenario.mission.goal].map(super::posture);
    configured.button = Button {
        start,
        goal,
        ..Button::default()
    };
    scenario.boards.apply(role, &mut configured)?;
    let mut settings = Settings::of(BoardKind::of(role));
    for parameter in TABLE
        .iter()
        .filter(|parameter| !is_calibrated(parameter.name))
    {
        parameter.set(&mut settings, parameter.get(&configured))?;
    }
    // Completed configurations are compared, because some values follow from other values of the same board.
    let configured = configured.robot.completed();
    let mut left = settings.robot.completed();
    left.beam.calibration = configured.beam.calibration;
    if left != configured {
        return Err(Error::input(
            "robot: the default images take only the parameters of `cfmmr params list`; settings without a \
             board parameter must keep their default",
        ));
    }
    Ok(settings)
}

/// True if a calibration determines the parameter.
fn is_calibrated(name: &str) -> bool {
    name.starts_with("robot.beam.calibration.")
}

/// Stores the gauges' calibration: zeros as read with the strip at a straight edge, and nominal gains from data sheets.
fn calibrate(
    scenario: &Scenario,
    settings: &mut Settings,
    bridges: &[BridgeParts],
    drawn: &FrameErrors,
) -> Result<(), Error> {
    let config = &scenario.world.sensors.bridge;
    let converter = config.converter(drawn);
    let amplified =
        f64::from(config.active_gauges) / 4.0 * config.gauge_factor * config.amplifier_gain;
    let nominal = 1.0 / (f64::from(FULL_SCALE) * amplified);
    let gain = nominal / f64::from(settings.robot.beam.calibration.strain_per_count);
    let error = |ratio: f64| converter.as_ref().map_or(0.0, |error| error.at(ratio));
    // The board divides by the excitation, which the same converter measures at half of its range.
    let excitation = 1.0 + 2.0 * error(0.5);
    for (k, parts) in bridges.iter().enumerate() {
        let ratio = zero(config, parts);
        let counts = f64::from(FULL_SCALE) * (ratio + error(ratio)) / excitation;
        for (name, value) in [("zero_counts", counts), ("gain", gain)] {
            let name = format!("robot.beam.calibration.{name}[{k}]");
            let parameter = TABLE.iter().find(|parameter| parameter.name == name);
            if let Some(parameter) = parameter {
                parameter.set(settings, value as f32)?;
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::fusion::robot::Mode;

    #[test]
    fn wheel_and_track_of_one_board_are_stored_in_that_board() {
        let file = "[boards.rear]\nrobot.geometry.wheel_radius_m = 0.07\nrobot.geometry.half_track_m = 0.16\n";
        let scenario = Scenario::parse(None, file, "test", &[]).unwrap();
        let radius = |role| {
            configured_settings(&scenario, role)
                .unwrap()
                .robot
                .geometry
                .wheel_radius_m
        };
        assert_eq!(radius(Role::axle(1)), 0.07);
        assert_eq!(radius(Role::axle(0)), 0.073);
    }

    /// The place read from the stored bytes is the place of the board, for each number of axles.
    #[test]
    fn each_board_stores_its_place_and_the_number_of_axles() {
        for axles in 2..=5 {
            let set = [format!("robot.geometry.axles={axles}")];
            let scenario = Scenario::parse(None, "", "test", &set).unwrap();
            let robot = scenario.robot.topology();
            for role in robot.boards() {
                let settings = configured_settings(&scenario, role).unwrap();
                let kind = BoardKind::of(role);
                assert_eq!(settings.check_role(kind), Ok(role));
                assert_eq!(settings.robot.geometry.axles, axles);
                let blank = crate::link::placed_flash(robot, role).unwrap();
                assert_eq!(blank.iter().all(|byte| *byte == 0xff), axles == 2);
            }
        }
    }

    #[test]
    fn robot_without_rps_stores_odometry_as_its_fusion() {
        let mut scenario = Scenario::default();
        for rps in [true, false] {
            scenario.mission.rps = rps;
            let stored = configured_settings(&scenario, Role::LEAD).unwrap();
            assert_eq!(stored.robot.lead.fusion.mode, scenario.fusion());
        }
        assert_eq!(scenario.fusion(), Mode::Odometry);
    }
}
