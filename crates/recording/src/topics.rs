//! Table of a log's topics, from which the documentation is generated.

use super::entry::{
    AxleTick, AxleTruth, BeamTick, BusEntry, FrameTruth, HostCommandEntry, LeadEntry, Off, Start,
    TruthEntry, inner_names,
};
pub use super::schema::Schema;
use core_algos::topology::{Role, Topology};

/// Name, schema and rate of a topic in a log.
#[derive(Clone, Debug)]
pub struct Topic {
    /// Name of the topic.
    pub name: String,
    /// Schema of the messages.
    pub schema: Schema,
    /// Rate of the messages, in words.
    pub rate: &'static str,
}

/// Schema of one of Foxglove's messages.
macro_rules! foxglove {
    ($name:literal, $text:literal) => {
        Schema {
            name: concat!("foxglove.", $name),
            text: $text,
            fields: &[],
        }
    };
}

/// Declares topics: name, rate and schema.
macro_rules! topics {
    ($($name:literal, $rate:literal: $schema:expr;)*) => {
        /// Topics that belong to no board.
        const OF_ROBOT: &[(&str, &str, Schema)] = &[$(($name, $rate, $schema)),*];
    };
}

topics! {
    "/tf", "100 Hz": foxglove!("FrameTransforms", "postures in the frame world: robot, front_axle and rear_axle (true), robot_estimate (estimated)");
    "/truth/robot", "100 Hz": foxglove!("PoseInFrame", "true midpoint");
    "/estimate/robot", "100 Hz": foxglove!("PoseInFrame", "estimated midpoint");
    "/truth/path", "1 Hz": foxglove!("PosesInFrame", "path of the midpoint so far");
    "/goal", "once": foxglove!("PoseInFrame", "goal of the run");
    "/reference/path", "once": foxglove!("PosesInFrame", "reference path");
    "/scene", "20 Hz": foxglove!("SceneUpdate", "wheels, axles and the bent frame");
    "/log", "changes": foxglove!("Log", "changes of operating states, with their reasons");
    "/lead", "100 Hz": LeadEntry::SCHEMA;
    "/truth", "100 Hz": TruthEntry::SCHEMA;
    "/bus", "frames": BusEntry::SCHEMA;
    "/host/order", "commands": HostCommandEntry::SCHEMA;
}

/// All topics in the log of `robot`, with the topics of each board.
pub fn topics(robot: Topology) -> Vec<Topic> {
    let of_robot = OF_ROBOT.iter().map(|&(name, rate, schema)| Topic {
        name: name.to_owned(),
        schema,
        rate,
    });
    let is_chain = robot.axle_count() > 2;
    let truths = robot
        .boards()
        .filter(move |_| is_chain)
        .map(move |board| Topic {
            name: truth_of(robot.name(board)),
            schema: match board {
                Role::Axle(_) => AxleTruth::SCHEMA,
                Role::Beam(_) => FrameTruth::SCHEMA,
            },
            rate: "100 Hz",
        });
    let estimates = inner_names(robot).map(|name| Topic {
        name: estimate_of(name),
        schema: foxglove!("PoseInFrame", "estimated axle"),
        rate: "100 Hz",
    });
    let of_boards = |what: &'static str, rate, schema: fn(Role) -> Schema| {
        robot.boards().map(move |board| Topic {
            name: of_board(robot.name(board), what),
            schema: schema(board),
            rate,
        })
    };
    let tick = |board: Role| match board {
        Role::Axle(_) => AxleTick::SCHEMA,
        Role::Beam(_) => BeamTick::SCHEMA,
    };
    let starts = of_boards("start", "starts", |_| Start::SCHEMA);
    let ticks = of_boards("tick", "1 kHz", tick);
    let offs = of_boards("off", "failures", |_| Off::SCHEMA);
    let of_boards = starts.chain(ticks).chain(offs);
    of_robot
        .chain(truths)
        .chain(estimates)
        .chain(of_boards)
        .collect()
}

/// Topic with the true state of the axle or frame of a board.
pub(crate) fn truth_of(board: &str) -> String {
    format!("/truth/{board}")
}

/// Topic with the estimated posture of the axle of a board.
pub(crate) fn estimate_of(board: &str) -> String {
    format!("/estimate/{board}")
}

/// Name of the topic `what` of a board.
pub(crate) fn of_board(board: &str, what: &str) -> String {
    format!("/boards/{board}/{what}")
}
