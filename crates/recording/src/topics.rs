//! The topics of a log: one table, from which the documentation follows.

use super::entry::{
    AxleTick, BeamTick, BusEntry, HostCommandEntry, LeadEntry, Off, Start, TruthEntry,
};
pub use super::schema::Schema;

/// A topic.
#[derive(Clone, Copy, Debug)]
pub struct Topic {
    /// Name.
    pub name: &'static str,
    /// Its messages.
    pub schema: Schema,
    /// Rate.
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
        /// Every topic.
        pub const TOPICS: [Topic; 21] = [$(Topic {
            name: $name,
            schema: $schema,
            rate: $rate,
        }),*];
    };
}

topics! {
    "/tf", "100 Hz": foxglove!("FrameTransforms", "true robot, front_axle, rear_axle, and estimated robot_estimate, in the coordinates world");
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
    "/boards/front/start", "starts": Start::SCHEMA;
    "/boards/rear/start", "starts": Start::SCHEMA;
    "/boards/beam/start", "starts": Start::SCHEMA;
    "/boards/front/tick", "1 kHz": AxleTick::SCHEMA;
    "/boards/rear/tick", "1 kHz": AxleTick::SCHEMA;
    "/boards/beam/tick", "1 kHz": BeamTick::SCHEMA;
    "/boards/front/off", "failures": Off::SCHEMA;
    "/boards/rear/off", "failures": Off::SCHEMA;
    "/boards/beam/off", "failures": Off::SCHEMA;
}
