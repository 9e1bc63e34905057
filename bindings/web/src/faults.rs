//! Faults that a visitor injects.

use core_algos::topology::{AxleId, FrameId, Role, Side, Topology};
use host_sim::bus::virtual_bus::BusConfig;
use host_sim::world::faults::{Fault, Rail, Wheel};

/// Fault with its name and its effect in words.
pub struct Entry {
    /// Name on the button.
    pub name: String,
    /// Effect of the fault.
    pub text: String,
    /// The fault.
    pub fault: Fault,
}

fn entry(name: impl Into<String>, text: impl Into<String>, fault: Fault) -> Entry {
    Entry {
        name: name.into(),
        text: text.into(),
        fault,
    }
}

/// Faults of a robot, in the order of their numbers. Faults of the front axle, the rear axle and the first frame come first.
/// Faults of the other axles and frames follow.
pub fn of(robot: Topology) -> Vec<Entry> {
    let mut all = ends(robot);
    let inner = robot.axles().skip(1).take(robot.axle_count() - 2);
    all.extend(inner.flat_map(|axle| of_axle(robot, axle)));
    all.extend(
        robot
            .frames()
            .skip(1)
            .flat_map(|frame| of_frame(robot, frame)),
    );
    all
}

/// Faults of front, rear, first frame and bus.
#[expect(clippy::too_many_lines, reason = "one list of faults")]
fn ends(robot: Topology) -> Vec<Entry> {
    let rear = robot.axle_count() - 1;
    let rear_board = Role::Axle(AxleId(rear as u8));
    let front_left = Wheel {
        axle: 0,
        side: Side::Left,
    };
    let rear_right = Wheel {
        axle: rear,
        side: Side::Right,
    };
    let beam = robot.name(Role::beam(0));
    // Two axles have one frame, which needs no name.
    let (at, strip) = match robot.frame_count() {
        1 => (String::new(), "strip breaks".to_owned()),
        _ => (format!(" of {beam}"), format!("strip of {beam} breaks")),
    };
    let bus = BusConfig {
        loss: 0.5,
        ..BusConfig::default()
    };
    vec![
        entry(
            "gauge wire breaks",
            format!("The first gauge{at} from the rear reads full scale."),
            Fault::GaugeRail {
                count: 1,
                rail: Rail::FullScale,
            },
        ),
        entry(
            "gauge stuck",
            format!("The third gauge{at} repeats its last reading."),
            Fault::GaugeStuck(2),
        ),
        entry(
            "gauge drifts",
            format!("The zero of the second gauge{at} drifts by 20 counts per second."),
            Fault::GaugeDrift {
                gauge: 1,
                counts_per_s: 20.0,
            },
        ),
        entry(
            "encoder stuck",
            "The encoder of the front left wheel repeats its last count.",
            Fault::EncoderStuck(front_left),
        ),
        entry(
            "encoder missing",
            "The encoder of the rear right wheel gives no count.",
            Fault::EncoderMissing(rear_right),
        ),
        entry(
            "gyro biased",
            "The front gyro reads 0.02 rad/s too much; without an IMU nothing happens.",
            Fault::GyroBias {
                axle: 0,
                bias_rad_s: 0.02,
            },
        ),
        entry(
            "motor weak",
            "The front left motor gives a fifth of the commanded torque.",
            Fault::MotorWeak {
                wheel: front_left,
                share: 0.2,
            },
        ),
        entry(
            "motor stuck on",
            "The rear right motor gives 1 N m whenever the motors are on.",
            Fault::MotorStuckOn {
                wheel: rear_right,
                torque_n_m: 1.0,
            },
        ),
        entry(
            "wheel lifted",
            "The front left wheel does not touch the ground.",
            Fault::WheelLifted(front_left),
        ),
        entry(
            strip,
            format!("The frame{at} breaks in two."),
            Fault::FrameSnapped,
        ),
        entry(
            "bus loses frames",
            "Every second frame on the CAN bus is lost.",
            Fault::Bus(bus),
        ),
        entry(
            format!("{beam} board off"),
            format!("The board of the gauges{at} loses its supply."),
            Fault::Loss(Role::beam(0)),
        ),
        entry(
            "rear board off",
            "The board of the rear axle loses its supply.",
            Fault::Loss(rear_board),
        ),
        entry(
            "rear board restarts",
            "The board of the rear axle loses its supply for 0.2 s.",
            Fault::Reset {
                board: rear_board,
                off_ms: 200,
            },
        ),
    ]
}

/// Faults of an axle between front and rear.
fn of_axle(robot: Topology, axle: AxleId) -> [Entry; 3] {
    let board = Role::Axle(axle);
    let name = robot.name(board);
    let wheel = Wheel {
        axle: axle.index(),
        side: Side::Left,
    };
    [
        entry(
            format!("{name} encoder stuck"),
            format!("The encoder of the left wheel of {name} repeats its last count."),
            Fault::EncoderStuck(wheel),
        ),
        entry(
            format!("{name} motor weak"),
            format!("The left motor of {name} gives a fifth of the commanded torque."),
            Fault::MotorWeak { wheel, share: 0.2 },
        ),
        entry(
            format!("{name} board off"),
            format!("The board of {name} loses its supply."),
            Fault::Loss(board),
        ),
    ]
}

/// Faults of a frame behind the first one.
fn of_frame(robot: Topology, frame: FrameId) -> [Entry; 3] {
    let board = Role::Beam(frame);
    let name = robot.name(board);
    let at = |fault| Fault::OfFrame {
        frame: frame.index(),
        fault: Box::new(fault),
    };
    let rail = Fault::GaugeRail {
        count: 1,
        rail: Rail::FullScale,
    };
    [
        entry(
            format!("{name} gauge wire breaks"),
            format!("The first gauge of {name} from the rear reads full scale."),
            at(rail),
        ),
        entry(
            format!("strip of {name} breaks"),
            format!("The frame of {name} breaks in two."),
            at(Fault::FrameSnapped),
        ),
        entry(
            format!("{name} board off"),
            format!("The board of the gauges of {name} loses its supply."),
            Fault::Loss(board),
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::topology::MAX_AXLES;

    /// Each board but the front one, whose loss ends every run, can lose its supply; names differ.
    #[test]
    fn every_board_behind_the_front_can_be_switched_off() {
        for axles in 2..=MAX_AXLES {
            let robot = Topology::new(axles).unwrap();
            let all = of(robot);
            for board in robot.boards().skip(1) {
                let off = |entry: &Entry| entry.fault == Fault::Loss(board);
                assert_eq!(all.iter().filter(|it| off(it)).count(), 1, "{board:?}");
            }
            let mut names: Vec<_> = all.iter().map(|entry| &entry.name).collect();
            names.sort();
            names.dedup();
            assert_eq!(names.len(), all.len());
        }
    }
}
