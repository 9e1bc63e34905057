//! The topics of a log: one table, from which schemas and documentation follow.

use serde_json::{Value, json};

/// Type of a field.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A whole number.
    Integer,
    /// A number; of the boards one that is not finite stands as its bits in hexadecimal.
    Number,
    /// Yes or no.
    Truth,
    /// Text.
    Text,
    /// A list of so many whole numbers; those missing are null.
    Integers(usize),
    /// A list of so many numbers.
    Numbers(usize),
    /// A list of numbers.
    List,
    /// A list of texts.
    Texts,
    /// x_m, y_m (m) and phi_rad (rad).
    Pose,
    /// A posture and its covariance.
    Estimate,
    /// A list of frames, each with name, frame and message, whose fields depend on the name.
    Frames,
}

/// One field of a message.
#[derive(Clone, Copy, Debug)]
pub struct Field {
    /// Name.
    pub name: &'static str,
    /// Type.
    pub kind: Kind,
    /// True if the field may be null.
    pub optional: bool,
    /// Unit and meaning.
    pub text: &'static str,
}

/// A kind of message.
#[derive(Clone, Copy, Debug)]
pub struct Schema {
    /// Name; those of Foxglove are encoded as protobuf, ours as JSON.
    pub name: &'static str,
    /// Description of the message.
    pub text: &'static str,
    /// Fields; none where the schema is Foxglove's.
    pub fields: &'static [Field],
}

/// Declares schemas: their fields with kind and meaning, `?` after the name of one that may be null.
macro_rules! schemas {
    ($($(#[$doc:meta])* pub const $schema:ident = $name:literal, $text:literal {
        $($rows:tt)*
    })*) => {$(
        $(#[$doc])*
        pub const $schema: Schema = Schema {
            name: $name,
            text: $text,
            fields: schemas!(@fields [] $($rows)*),
        };
    )*};
    (@fields [$($done:expr,)*]) => { &[$($done,)*] };
    (@fields [$($done:expr,)*] $shared:ident; $($rest:tt)*) => {
        schemas!(@fields [$($done,)* $shared,] $($rest)*)
    };
    (@fields [$($done:expr,)*] $name:ident: $kind:ident $(($n:expr))? $text:literal; $($rest:tt)*) => {
        schemas!(@fields [$($done,)* Field {
            name: stringify!($name), kind: Kind::$kind $(($n))?, optional: false, text: $text,
        },] $($rest)*)
    };
    (@fields [$($done:expr,)*] $name:ident?: $kind:ident $(($n:expr))? $text:literal; $($rest:tt)*) => {
        schemas!(@fields [$($done,)* Field {
            name: stringify!($name), kind: Kind::$kind $(($n))?, optional: true, text: $text,
        },] $($rest)*)
    };
}

const TICK: Field = Field {
    name: "tick",
    kind: Kind::Integer,
    optional: false,
    text: "ms, time since the start of the simulation",
};
const RECEIVED: Field = Field {
    name: "received",
    kind: Kind::Texts,
    optional: false,
    text: "frames that arrived before the tick, each as identifier#data in hexadecimal",
};

schemas! {
    /// A board's nodes were started.
    pub const START = "cfmmr.Start", "The nodes of a board were started" {
        TICK;
        parameters: Text "parameters of the robot, postcard in hexadecimal";
        parameters_hash: Text "CRC-32C of these bytes";
        place?: Text "initial estimate of the lead node, postcard in hexadecimal";
    }

    /// A board was switched off.
    pub const OFF = "cfmmr.Off", "A board was switched off" {
        TICK;
        reason: Text "reason";
    }

    /// One tick of an axle board.
    pub const AXLE_TICK = "cfmmr.AxleTick", "One tick of an axle board: inputs and commanded torques" {
        TICK;
        encoder: Integers(2) "counts of the encoders (left, right), wrapping; null if missing";
        gyro_rad_s?: Number "rad/s, yaw rate";
        acceleration_m_s2?: Number "m/s², along the heading";
        conditions: Integer "conditions reported by the drivers, bit k is row k of the table of conditions";
        RECEIVED;
        torque_nm: Numbers(2) "N m, wheel torques commanded (left, right)";
    }

    /// One tick of the beam board.
    pub const BEAM_TICK = "cfmmr.BeamTick", "One tick of the beam board: inputs" {
        TICK;
        counts: Integers(core_algos::beam::MAX_GAUGES) "counts of the strain bridges from the root on; 0 if not fitted";
        RECEIVED;
    }

    /// A command of the host.
    pub const ORDER = "cfmmr.Order", "Command of the host to the lead node before a tick" {
        TICK;
        text: Text "the command in words";
        bits: Text "the command, postcard in hexadecimal";
    }

    /// Frames on the bus.
    pub const BUS = "cfmmr.BusFrames", "Frames that a board sent on the bus at a tick" {
        TICK;
        board: Text "front, rear or beam";
        frames: Frames "frames in order: name of the message as in the DBC, frame as identifier#data in hexadecimal, and message as the receivers decode it, in SI units as in its names";
    }

    /// The lead node's output.
    pub const LEAD = "cfmmr.Lead", "Estimate and commands of the lead node in an epoch" {
        TICK;
        epoch_s: Number "s, time of validity of the estimates";
        mode: Text "mode sent to the axles: idle, active, hold, clear";
        phase: Text "phase of the regulator: stop, plan, steer, segment, approach, hold, done, gave-up";
        state: Text "operating state of the lead node";
        reason: Integer "code of the condition that stopped the node, 0 if none";
        done: Truth "true if the task is done and the robot at rest";
        robot: Estimate "midpoint, global frame";
        front: Estimate "front axle, global frame";
        rear: Estimate "rear axle, global frame";
        innovation: Numbers(3) "m, m, rad: measured less predicted posture of the front axle in the rear axle's frame";
        nis: Number "1, normalised innovation squared of the beam; 3 on average";
        velocity_m_s: Number "m/s, commanded velocity of the midpoint";
        acceleration_m_s2: Number "m/s², commanded";
        steering_rad: Number "rad, commanded steering ψ";
        steering_rate_rad_s: Number "rad/s, commanded";
        target?: Pose "reference of the midpoint on a path or trajectory, global frame";
        bits: Text "the whole output, postcard in hexadecimal";
    }

    /// The true state.
    pub const TRUTH = "cfmmr.Truth", "True state of the simulated robot, and measured strains" {
        time_s: Number "s";
        robot: Pose "midpoint, global frame";
        front: Pose "front axle, global frame";
        rear: Pose "rear axle, global frame";
        relative: Pose "front axle in the rear axle's frame";
        wheel_speed_rad_s: Numbers(4) "rad/s: front left, front right, rear left, rear right";
        torque_nm: Numbers(4) "N m at the wheels, in the same order";
        force_n: Numbers(2) "N, force of the frame on the rear axle, in the coordinates of that axle";
        moment_nm: Numbers(2) "N m, moment of the frame at root and tip";
        strain: List "1, measured strains from the root on";
    }
}

const fn foxglove(name: &'static str, text: &'static str) -> Schema {
    let fields = &[];
    Schema { name, text, fields }
}

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

const fn topic(name: &'static str, schema: Schema, rate: &'static str) -> Topic {
    Topic { name, schema, rate }
}

/// Every topic.
pub const TOPICS: [Topic; 21] = [
    topic(
        "/tf",
        foxglove(
            "foxglove.FrameTransforms",
            "true robot, front_axle, rear_axle, and estimated robot_estimate, in the coordinates world",
        ),
        "100 Hz",
    ),
    topic(
        "/truth/robot",
        foxglove("foxglove.PoseInFrame", "true midpoint"),
        "100 Hz",
    ),
    topic(
        "/estimate/robot",
        foxglove("foxglove.PoseInFrame", "estimated midpoint"),
        "100 Hz",
    ),
    topic(
        "/truth/path",
        foxglove("foxglove.PosesInFrame", "path of the midpoint so far"),
        "1 Hz",
    ),
    topic(
        "/goal",
        foxglove("foxglove.PoseInFrame", "goal of the run"),
        "once",
    ),
    topic(
        "/reference/path",
        foxglove("foxglove.PosesInFrame", "reference path"),
        "once",
    ),
    topic(
        "/scene",
        foxglove("foxglove.SceneUpdate", "wheels, axles and the bent frame"),
        "20 Hz",
    ),
    topic(
        "/log",
        foxglove(
            "foxglove.Log",
            "changes of operating states, with their reasons",
        ),
        "changes",
    ),
    topic("/lead", LEAD, "100 Hz"),
    topic("/truth", TRUTH, "100 Hz"),
    topic("/bus", BUS, "frames"),
    topic("/host/order", ORDER, "commands"),
    topic("/boards/front/start", START, "starts"),
    topic("/boards/rear/start", START, "starts"),
    topic("/boards/beam/start", START, "starts"),
    topic("/boards/front/tick", AXLE_TICK, "1 kHz"),
    topic("/boards/rear/tick", AXLE_TICK, "1 kHz"),
    topic("/boards/beam/tick", BEAM_TICK, "1 kHz"),
    topic("/boards/front/off", OFF, "failures"),
    topic("/boards/rear/off", OFF, "failures"),
    topic("/boards/beam/off", OFF, "failures"),
];

impl Kind {
    fn schema(self) -> Value {
        let number = json!({ "type": ["number", "string", "null"] });
        let pose = [("x_m", "m"), ("y_m", "m"), ("phi_rad", "rad")];
        let mut properties: serde_json::Map<String, Value> = pose
            .into_iter()
            .map(|(name, unit)| {
                (
                    name.to_owned(),
                    json!({ "type": "number", "description": unit }),
                )
            })
            .collect();
        match self {
            Self::Integer => json!({ "type": "integer" }),
            Self::Number => number,
            Self::Truth => json!({ "type": "boolean" }),
            Self::Text => json!({ "type": "string" }),
            Self::Integers(n) => json!({
                "type": "array", "minItems": n, "maxItems": n,
                "items": { "type": ["integer", "null"] },
            }),
            Self::Numbers(n) => {
                json!({ "type": "array", "minItems": n, "maxItems": n, "items": number })
            }
            Self::List => json!({ "type": "array", "items": number }),
            Self::Texts => json!({ "type": "array", "items": { "type": "string" } }),
            Self::Pose => json!({
                "type": "object", "additionalProperties": false,
                "required": ["x_m", "y_m", "phi_rad"], "properties": properties,
            }),
            Self::Estimate => {
                let row = json!({ "type": "array", "minItems": 3, "maxItems": 3, "items": number });
                let covariance = json!({
                    "description": "m², m rad, rad²: covariance of (x, y, phi)",
                    "type": "array", "minItems": 3, "maxItems": 3, "items": row,
                });
                properties.insert("covariance".to_owned(), covariance);
                json!({
                    "type": "object", "additionalProperties": false,
                    "required": ["x_m", "y_m", "phi_rad", "covariance"], "properties": properties,
                })
            }
            Self::Frames => {
                let text = json!({ "type": "string" });
                json!({
                    "type": "array",
                    "items": {
                        "type": "object", "additionalProperties": false,
                        "required": ["name", "frame", "message"],
                        "properties": {
                            "name": text, "frame": text, "message": { "type": ["object", "null"] },
                        },
                    },
                })
            }
        }
    }
}

impl Schema {
    /// As JSON schema.
    pub fn json(&self) -> String {
        let property = |field: &Field| {
            let mut schema = field.kind.schema();
            schema["description"] = field.text.into();
            if field.optional
                && let Some(text) = schema["type"].as_str()
            {
                schema["type"] = json!([text, "null"]);
            }
            (field.name.to_owned(), schema)
        };
        let properties: serde_json::Map<_, _> = self.fields.iter().map(property).collect();
        let required: Vec<_> = self.fields.iter().map(|field| field.name).collect();
        json!({
            "$schema": "http://json-schema.org/draft-07/schema#",
            "title": self.name,
            "description": self.text,
            "type": "object",
            "additionalProperties": false,
            "required": required,
            "properties": properties,
        })
        .to_string()
    }
}
