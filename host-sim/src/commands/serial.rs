//! `cfmmr serial`: what host and board say to each other on the serial link, as Markdown.

use crate::error::Error;
use core_algos::hil::framing::{MAX_FRAME, MAX_PAYLOAD};
use core_algos::hil::protocol::{
    self, CONFIG_CHUNK, MAX_BUS_FRAMES, MAX_SENT_FRAMES, POINTS, PROTOCOL, Request,
};
use std::fmt::Write;

/// One variant of a message: its number is its place in the list.
struct Row {
    name: &'static str,
    /// Names with type, unit and meaning; one without a name is the content itself.
    fields: &'static [(&'static str, &'static str)],
    /// What it is for, and of a request what answers it.
    text: &'static str,
}

const fn row(
    name: &'static str,
    fields: &'static [(&'static str, &'static str)],
    text: &'static str,
) -> Row {
    Row { name, fields, text }
}

const TICK: (&str, &str) = ("tick", "u32, ms");
const BUS: (&str, &str) = ("bus", "bytes: bus frames, packed");

const REQUESTS: &[Row] = &[
    row(
        "Hello",
        &[("protocol", "u16: version"), ("nonce", "u32: comes back")],
        "begins a session: the board stops and forgets its parameters → Hello",
    ),
    row(
        "Configure",
        &[
            ("total", "u16: bytes of the whole"),
            ("offset", "u16: place of this part"),
            ("bytes", "bytes: the part"),
        ],
        "a part of the encoded `RobotConfig` → Configured",
    ),
    row(
        "Start",
        &[
            ("hash", "u32: CRC-32C of the encoded parameters"),
            ("tick", "u32, ms: the first that will come"),
            (
                "place",
                "optional: midpoint and relative posture (m, m, rad) with covariances",
            ),
        ],
        "builds the nodes → Done",
    ),
    row(
        "Command",
        &[(
            "",
            "task: Idle, Stop, Clear, Regulate (goal: m, m, rad), Follow, Track",
        )],
        "gives the lead node a task → Done",
    ),
    row(
        "Path",
        &[
            (
                "points",
                "optional points: posture (m, m, rad), curvature (1/m), arc length (m)",
            ),
            ("end", "bool: they are the last"),
        ],
        "appends to the lead node's path → Done",
    ),
    row(
        "Trajectory",
        &[
            (
                "points",
                "optional points: time (s), speed (m/s), point as above",
            ),
            ("end", "bool: they are the last"),
        ],
        "appends to the lead node's trajectory → Done",
    ),
    row(
        "Axle",
        &[
            TICK,
            (
                "samples",
                "encoder (2 optional i32, counts), gyro (optional f32, rad/s), acceleration \
                 (optional f32, m/s²), conditions (bits)",
            ),
            BUS,
        ],
        "one tick of an axle board → Axle",
    ),
    row(
        "Beam",
        &[TICK, ("counts", "i32 each: bridges, from the root")],
        "one tick of the beam board → Beam",
    ),
    row(
        "Resume",
        &[("tick", "u32, ms: the next that will come")],
        "the board stood still and goes on → Done",
    ),
    row("Stack", &[], "asks for the use of the stack → Stack"),
    row(
        "Parameters",
        &[],
        "asks how many parameters the board keeps → Parameters",
    ),
    row(
        "Parameter",
        &[("index", "u8: place in the table of parameters")],
        "asks for one → Parameter",
    ),
    row(
        "SetParameter",
        &[
            ("index", "u8: place in the table of parameters"),
            ("value", "f32"),
        ],
        "gives one another value until a reset or a save; motors off → Done",
    ),
    row(
        "SaveParameters",
        &[],
        "writes what has changed to the flash; motors off → Saved",
    ),
];

const REPLIES: &[Row] = &[
    row(
        "Hello",
        &[
            ("protocol", "u16: version"),
            ("nonce", "u32: as in the request"),
            ("role", "front, rear or beam"),
            ("build", "text: what the image was built from"),
            ("counters", "2 u32: frames received, frames damaged"),
        ],
        "who the board is",
    ),
    row("Done", &[], "the request was carried out"),
    row(
        "Configured",
        &[("hash", "u32: CRC-32C of the parameters so far")],
        "a part was taken",
    ),
    row(
        "Axle",
        &[
            ("torque_nm", "2 f32, N m: left, right"),
            ("active", "bool: a reference is followed"),
            ("refused", "u8: frames that could not be decoded or encoded"),
            BUS,
            ("telemetry", "bytes: next part of the lead node's output"),
        ],
        "what an axle board did",
    ),
    row(
        "Beam",
        &[("refused", "u8: messages that could not be encoded"), BUS],
        "what the beam board did",
    ),
    row(
        "Refused",
        &[("", "why, see below")],
        "the request was not carried out",
    ),
    row(
        "Stack",
        &[("", "3 u32, bytes: used at most, budget, size")],
        "use of the stack since the start",
    ),
    row(
        "Parameters",
        &[
            ("table", "u32: hash of the table"),
            ("count", "u8"),
            ("unusable", "bool: what is stored makes no working node"),
        ],
        "what the board keeps, apart from the configuration of a session",
    ),
    row(
        "Parameter",
        &[
            ("value", "f32"),
            (
                "source",
                "where it came from at the start or the latest save",
            ),
            ("saved", "bool: it would be the same after a reset"),
        ],
        "one of them",
    ),
    row(
        "Saved",
        &[("values", "u8: values written")],
        "the flash holds them",
    ),
];

const REFUSALS: &[Row] = &[
    row(
        "NoSession",
        &[],
        "no session, or one of another protocol: say hello first; so answers a board that was \
         restarted",
    ),
    row("Malformed", &[], "the request is none of this version"),
    row(
        "OtherBoard",
        &[("role", "what this board is")],
        "the request is for another kind of board",
    ),
    row(
        "Part",
        &[("received", "u16: bytes so far")],
        "the part does not follow the one before, or the parameters are too long",
    ),
    row(
        "Hash",
        &[("found", "u32: that of the parameters received")],
        "the check sum is another one",
    ),
    row("Undecodable", &[], "the parameters cannot be decoded"),
    row(
        "Parameter",
        &[("text", "name, value and range")],
        "a parameter is out of range",
    ),
    row("NotStarted", &[], "the nodes have not been started"),
    row(
        "Tick",
        &[("expected", "u32, ms")],
        "a tick was left out or comes twice",
    ),
    row(
        "Point",
        &[("", "Full, NotFinite, NotAdvancing, Ended, NotClosed")],
        "a point of a path or trajectory was not taken",
    ),
    row(
        "Armed",
        &[],
        "motors may be on: an axle is driven, or the beam board's node has been started",
    ),
    row(
        "Index",
        &[("count", "u8: how many there are")],
        "there is no such parameter",
    ),
    row(
        "NotSaved",
        &[],
        "the flash could not be written, or does not hold what was written",
    ),
];

fn table(text: &mut String, title: &str, rows: &[Row]) {
    let _ = write!(
        text,
        "\n## {title}\n\n| number | name | content | what |\n|---|---|---|---|\n"
    );
    for (number, row) in rows.iter().enumerate() {
        let fields: Vec<String> = row
            .fields
            .iter()
            .map(|(name, what)| match *name {
                "" => (*what).to_owned(),
                name => format!("`{name}` {what}"),
            })
            .collect();
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "| {number} | `{}` | {} | {} |",
            row.name,
            fields.join("<br>"),
            row.text
        );
    }
}

fn hexadecimal(bytes: &[u8]) -> String {
    let bytes: Vec<String> = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    bytes.join(" ")
}

/// The text of `docs/serial.md`.
pub fn markdown() -> String {
    let mut text = format!(
        "# Serial protocol\n\n\
         Written by `cfmmr serial`. Version {PROTOCOL} of what host and board say to each other in hardware\n\
         in the loop ([hil.md](hil.md)); types in `core-algos/src/hil/protocol.rs`, frames in\n\
         `core-algos/src/hil/framing.rs`. The host asks, the board answers, one request at a time.\n\n\
         ## Bytes\n\n\
         - A payload, at most {MAX_PAYLOAD} bytes: number of the request (one byte, comes back in the reply),\n\
         \x20 then request or reply in [postcard](https://postcard.jamesmunns.com/wire-format): variants by\n\
         \x20 the numbers below, whole numbers as varints (signed ones zigzag), f32 as four bytes, little-endian,\n\
         \x20 an optional value behind a byte 0 or 1, bytes and text behind their length.\n\
         - A frame, at most {MAX_FRAME} bytes: payload and its CRC-32C (four bytes, little-endian), stuffed by\n\
         \x20 COBS, then a byte 0. What is repeated has a 0 before it too.\n\
         - Bus frames, packed, at most {MAX_BUS_FRAMES} in a request and {MAX_SENT_FRAMES} in a reply: identifier and length\n\
         \x20 in two bytes, little-endian (bits 0 to 10 and 12 to 15), then the data.\n\
         - Parameters go in parts of at most {CONFIG_CHUNK} bytes, points of a path {POINTS} at a time.\n"
    );
    let hello = Request::Hello {
        protocol: PROTOCOL,
        nonce: 300,
    };
    if let Some(frame) = protocol::encode(1, &hello) {
        let _ = write!(
            text,
            "\nA hello with number 1 and nonce 300 is `{}`.\n",
            hexadecimal(frame.bytes())
        );
    }
    table(&mut text, "Requests", REQUESTS);
    table(&mut text, "Replies", REPLIES);
    table(&mut text, "Reasons of a refusal", REFUSALS);
    text
}

/// Prints the page.
pub fn run() -> Result<(), Error> {
    super::print(&markdown())
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::hil::protocol::{Reply, decode};
    use serde::{Deserialize, Serialize};
    use serde_json::Value;

    /// The variants there are, by decoding zeros behind each number: name and fields.
    fn variants<'a, T: Deserialize<'a> + Serialize>(
        head: &[u8],
        unwrap: fn(Value) -> Value,
    ) -> Vec<(String, Vec<String>)> {
        let mut found = Vec::new();
        'numbers: for number in 0..=255 {
            for zeros in 0..200 {
                let mut bytes = head.to_vec();
                bytes.push(number);
                bytes.resize(bytes.len() + zeros, 0);
                if let Some((_, message)) = decode::<T>(bytes.leak()) {
                    found.push(named(&unwrap(serde_json::to_value(&message).unwrap())));
                    continue 'numbers;
                }
            }
            break;
        }
        found
    }

    /// Name and fields of a variant.
    fn named(value: &Value) -> (String, Vec<String>) {
        match value {
            Value::String(name) => (name.clone(), Vec::new()),
            Value::Object(map) => {
                let (name, content) = map.iter().next().unwrap();
                let fields = match content {
                    Value::Object(fields) => fields.keys().cloned().collect(),
                    _ => Vec::new(),
                };
                (name.clone(), fields)
            }
            other => panic!("{other}"),
        }
    }

    fn assert_complete(rows: &[Row], variants: &[(String, Vec<String>)]) {
        let names: Vec<&str> = rows.iter().map(|row| row.name).collect();
        let found: Vec<&str> = variants.iter().map(|(name, _)| name.as_str()).collect();
        assert_eq!(names, found);
        for (row, (name, fields)) in rows.iter().zip(variants) {
            // The content of a variant without names is told in words.
            if row.fields.iter().all(|(name, _)| !name.is_empty()) {
                let mut told: Vec<&str> = row.fields.iter().map(|(name, _)| *name).collect();
                let mut fields: Vec<&str> = fields.iter().map(String::as_str).collect();
                told.sort_unstable();
                fields.sort_unstable();
                assert_eq!(told, fields, "{name}");
            }
        }
    }

    #[test]
    fn every_variant_and_field_of_the_protocol_is_in_the_table() {
        assert_complete(REQUESTS, &variants::<Request>(&[7], |value| value));
        assert_complete(REPLIES, &variants::<Reply>(&[7], |value| value));
        let refused = REPLIES.iter().position(|row| row.name == "Refused");
        let head = [7, refused.unwrap() as u8];
        let inner = |value: Value| value["Refused"].clone();
        assert_complete(REFUSALS, &variants::<Reply>(&head, inner));
    }
}
