//! Messages of a log, written by the recorder and read by replay.
//!
//! Everything that replay needs is stored exactly. Values of the boards (`f32`) are written as the equal `f64`,
//! whose shortest decimal reads back unchanged. Structures are also stored as postcard bytes in hexadecimal, as on
//! the serial link.

use super::schema::{Field, Kind, Schema, kinds, messages};
use core_algos::beam::MAX_GAUGES;
use core_algos::bus::{CanFrame, LeadMode, Message};
use core_algos::control::regulator::Phase;
use core_algos::fusion::Estimate;
use core_algos::math::Posture;
use core_algos::node::lead;
use core_algos::safety::{Conditions, OperatingState};
use core_algos::topology::{Node, Role, Topology};
use host_sim::run::robot::{AxleRecord, FrameRecord, Record};
use output::files::Cell;
use serde::de::{DeserializeOwned, Error as _, Unexpected};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::Value;

/// Name of the metadata record that describes the run.
pub const ABOUT: &str = "cfmmr";
/// Name of the metadata record that describes the end of the run.
pub const END: &str = "cfmmr.end";
/// Version of the format of a log of two axles; it changes with every change of a message.
const FORMAT: &str = "3";
/// Version of the format of a log of more axles, with topics of each axle and frame.
const FORMAT_OF_CHAIN: &str = "4";
/// Versions that this program reads.
pub const FORMATS: [&str; 2] = [FORMAT, FORMAT_OF_CHAIN];

/// Version of the format of a robot's log.
pub fn format_of(robot: Topology) -> &'static str {
    match robot.axle_count() {
        2 => FORMAT,
        _ => FORMAT_OF_CHAIN,
    }
}

/// Names of the axles between the first and the last.
pub fn inner_names(robot: Topology) -> impl Iterator<Item = &'static str> {
    let inner = robot.axles().take(robot.axle_count() - 1).skip(1);
    inner.map(move |axle| robot.name(Role::Axle(axle)))
}

/// Single-precision value of a board. NaN and infinities are written as their bits, `"0x7fc00000"`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Exact(pub f32);

impl PartialEq for Exact {
    fn eq(&self, other: &Self) -> bool {
        self.0.to_bits() == other.0.to_bits()
    }
}

impl Serialize for Exact {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        match self.0.is_finite() {
            true => to.serialize_f64(self.0.into()),
            false => to.collect_str(&format_args!("{:#010x}", self.0.to_bits())),
        }
    }
}

impl<'de> Deserialize<'de> for Exact {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let value = Value::deserialize(from)?;
        let bits = |text: &str| u32::from_str_radix(text.strip_prefix("0x")?, 16).ok();
        let number = match &value {
            Value::Number(number) => number.as_f64().map(|number| number as f32),
            Value::String(text) => bits(text).map(f32::from_bits),
            _ => None,
        };
        number.map(Self).ok_or_else(|| {
            D::Error::custom(format!(
                "{value}: must be a number, or the bits of one as 0x and eight digits"
            ))
        })
    }
}

/// Bytes that a log stores as hexadecimal digits.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Hex(pub Vec<u8>);

impl Hex {
    /// Encodes a value as postcard bytes.
    pub fn of<T: Serialize>(value: &T) -> Self {
        // Encoding fails only if `Serialize` fails, which no type of this project does.
        Self(postcard::to_extend(value, Vec::new()).unwrap_or_default())
    }

    /// Decodes a value; `None` if the bytes do not fit the type `T`.
    pub fn value<T: DeserializeOwned>(&self) -> Option<T> {
        match postcard::take_from_bytes(&self.0) {
            Ok((value, [])) => Some(value),
            _ => None,
        }
    }

    /// As [`Self::value`], also for a value of an earlier version, which lacked the bytes `before` and `after`.
    pub fn value_or_earlier<T: DeserializeOwned>(&self, before: &[u8], after: &[u8]) -> Option<T> {
        let whole = || Self([before, &self.0, after].concat());
        self.value().or_else(|| whole().value())
    }
}

const DIGITS: &[u8; 16] = b"0123456789abcdef";

/// Text with two hexadecimal digits per byte.
fn in_hex(bytes: &[u8]) -> String {
    let digits = |byte: &u8| [byte >> 4, byte & 15].map(|digit| DIGITS[usize::from(digit)]);
    let text: Vec<u8> = bytes.iter().flat_map(digits).collect();
    // Digits are valid UTF-8.
    String::from_utf8(text).unwrap_or_default()
}

fn from_hex(text: &str) -> Option<Vec<u8>> {
    let digit = |c: u8| char::from(c).to_digit(16).map(|digit| digit as u8);
    let pairs = text.as_bytes().chunks(2);
    let byte = |pair: &[u8]| match pair {
        [high, low] => Some(digit(*high)? << 4 | digit(*low)?),
        _ => None,
    };
    pairs.map(byte).collect()
}

impl Serialize for Hex {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(&in_hex(&self.0))
    }
}

impl<'de> Deserialize<'de> for Hex {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let text = String::deserialize(from)?;
        let bytes = from_hex(&text);
        bytes.map(Self).ok_or_else(|| {
            D::Error::invalid_value(
                Unexpected::Str(&text),
                &"bytes as pairs of hexadecimal digits",
            )
        })
    }
}

/// Bus frame written as `1a0#0011223344556677`: identifier, then data.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Can(pub CanFrame);

impl Serialize for Can {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        let CanFrame { id, length, data } = self.0;
        let mut text = [b'#'; 20];
        let digit = |nibble: u16| DIGITS[usize::from(nibble & 15)];
        for (place, shift) in text.iter_mut().zip([8, 4, 0]) {
            *place = digit(id >> shift);
        }
        for (pair, byte) in text[4..].chunks_mut(2).zip(data) {
            pair.copy_from_slice(&[digit(u16::from(byte >> 4)), digit(byte.into())]);
        }
        let used = text.get(..4 + 2 * usize::from(length)).unwrap_or(&text);
        to.serialize_str(str::from_utf8(used).unwrap_or_default())
    }
}

impl<'de> Deserialize<'de> for Can {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let text = String::deserialize(from)?;
        let frame = || {
            let (id, bytes) = text.split_once('#')?;
            let id = u16::from_str_radix(id, 16).ok().filter(|id| *id < 0x800)?;
            let bytes = from_hex(bytes)?;
            let mut data = [0; 8];
            data.get_mut(..bytes.len())?.copy_from_slice(&bytes);
            let length = bytes.len() as u8;
            Some(Self(CanFrame { id, length, data }))
        };
        frame().ok_or_else(|| {
            let expected = "a frame as 1a0#0011, with at most eight bytes";
            D::Error::invalid_value(Unexpected::Str(&text), &expected)
        })
    }
}

/// Table cell of a number; empty for NaN.
fn number(value: f64) -> Cell {
    match value.is_nan() {
        true => Cell::Empty,
        false => Cell::Double(value),
    }
}

/// Table cell of a word, as the log writes the word.
fn word(value: &impl Serialize) -> Cell {
    let value = serde_json::to_value(value).unwrap_or_default();
    Cell::Text(
        value
            .as_str()
            .map_or_else(|| value.to_string(), str::to_owned),
    )
}

kinds! {
    Kind::Integer => u8, value: [Cell::Integer((*value).into())];
    Kind::Integer => u32, value: [Cell::from(*value)];
    Kind::Integer => Conditions, value: [word(value)];
    Kind::Number => f32, value: [number((*value).into())];
    Kind::Number => f64, value: [number(*value)];
    Kind::Number => Exact, value: [Cell::Single(value.0)];
    Kind::Truth => bool, value: [Cell::from(*value)];
    Kind::Text => String, value: [Cell::Text(value.clone())];
    Kind::Text => LeadMode, value: [word(value)];
    Kind::Text => Phase, value: [word(value)];
    Kind::Text => OperatingState, value: [word(value)];
    Kind::Bytes => Hex, _value: [] as [Cell; 0];
    Kind::Integers(2) => [Option<i32>; 2], value: value.map(Cell::from);
    Kind::Integers(MAX_GAUGES) => [i32; MAX_GAUGES], value: value.map(Cell::from);
    Kind::Numbers(2) => [f64; 2], value: value.map(number);
    Kind::Numbers(2) => [Exact; 2], value: value.map(|value| Cell::Single(value.0));
    Kind::Numbers(3) => [f32; 3], value: value.map(|value| number(value.into()));
    Kind::Numbers(4) => [f64; 4], value: value.map(number);
    Kind::Numbers(MAX_GAUGES) => [f32; MAX_GAUGES], value: value.map(|value| number(value.into()));
    Kind::Texts => Vec<Can>, _value: [] as [Cell; 0];
    Kind::Pose => Pose, value: <[f64; 3]>::from(*value).map(number);
    Kind::Estimate => Estimated, value: {
        let covariance = value.covariance.as_flattened().iter();
        let covariance = covariance.map(|value| number((*value).into()));
        <[f64; 3]>::from(value.pose).map(number).into_iter().chain(covariance)
    };
    Kind::Frames => Vec<LoggedFrame>, _value: [] as [Cell; 0];
}

messages! {
    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct Start = "cfmmr.Start", "The nodes of a board were started" {
        tick: u32, "ms, common time of the boards; in process the time since the start";
        parameters: Hex, "parameters of the robot, postcard in hexadecimal";
        parameters_hash: String, "CRC-32C of these bytes";
        place: Option<Hex>, "initial estimate of the lead node, postcard in hexadecimal";
    }

    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct Off = "cfmmr.Off", "A board was switched off" {
        tick: u32, "ms, common time of the boards; in process the time since the start";
        reason: String, "reason";
    }

    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct AxleTick = "cfmmr.AxleTick", "One tick of an axle board: inputs and commanded torques" {
        tick: u32, "ms, common time of the boards; in process the time since the start";
        encoder: [Option<i32>; 2], "counts of the encoders (left, right), wrapping; null if missing";
        gyro_rad_s: Option<Exact>, "rad/s, yaw rate";
        acceleration_m_s2: Option<Exact>, "m/s², along the heading";
        conditions: Conditions, "conditions reported by the drivers, bit k is row k of the table of conditions";
        received: Vec<Can>, "frames that arrived before the tick, each as identifier#data in hexadecimal";
        torque_nm: [Exact; 2], "N m, wheel torques commanded (left, right)";
    }

    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct BeamTick = "cfmmr.BeamTick", "One tick of the beam board: inputs" {
        tick: u32, "ms, common time of the boards; in process the time since the start";
        counts: [i32; MAX_GAUGES], "counts of the strain bridges from the root on; 0 if not fitted";
        conditions: Conditions, "conditions reported by the drivers, bit k is row k of the table of conditions";
        received: Vec<Can>, "frames that arrived before the tick, each as identifier#data in hexadecimal";
    }

    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct HostCommandEntry = "cfmmr.Order", "Command of the host to the lead node before a tick" {
        tick: u32, "ms, common time of the boards; in process the time since the start";
        text: String, "the command in words";
        bits: Hex, "the command, postcard in hexadecimal";
    }

    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct BusEntry = "cfmmr.BusFrames", "Frames that a board sent on the bus at a tick" {
        tick: u32, "ms, common time of the boards; in process the time since the start";
        board: String, "front, rear or beam";
        frames: Vec<LoggedFrame>, "frames in order: name of the message as in the DBC, frame as identifier#data in hexadecimal, and message as the receivers decode it, in SI units as in its names";
    }

    #[derive(Clone, Debug, PartialEq, Serialize)]
    pub struct LeadEntry = "cfmmr.Lead", "Estimate and commands of the lead node in an epoch" {
        tick: u32, "ms, common time of the boards; in process the time since the start";
        epoch_s: f64, "s, time of validity of the estimates";
        mode: LeadMode, "mode sent to the axles: idle, active, hold, clear";
        phase: Phase, "phase of the regulator: stop, plan, steer, segment, approach, hold, done, gave-up";
        state: OperatingState, "operating state of the lead node";
        reason: u8, "code of the condition that stopped the node, 0 if none";
        done: bool, "true if the task is done and the robot at rest";
        robot: Estimated, "midpoint, global coordinates";
        front: Estimated, "front axle, global coordinates";
        rear: Estimated, "rear axle, global coordinates";
        innovation: [f32; 3], "m, m, rad: measured less predicted posture of the front axle in the rear axle's coordinates";
        nis: f32, "1, normalised innovation squared of the beam; mean 0.1 to 0.5, because the beam board states the covariance of its worst posture";
        velocity_m_s: f32, "m/s, commanded velocity of the midpoint";
        acceleration_m_s2: f32, "m/s², commanded";
        steering_rad: f32, "rad, commanded steering ψ";
        steering_rate_rad_s: f32, "rad/s, commanded";
        target: Option<Pose>, "reference of the midpoint on a path or trajectory, global coordinates";
        bits: Hex, "the whole output, postcard in hexadecimal";
    }

    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct TruthEntry = "cfmmr.Truth", "True state of the simulated robot, and measured strains" {
        time_s: f64, "s";
        robot: Pose, "midpoint, global coordinates";
        front: Pose, "front axle, global coordinates";
        rear: Pose, "rear axle, global coordinates";
        relative: Pose, "front axle in the rear axle's coordinates";
        wheel_speed_rad_s: [f64; 4], "rad/s: front left, front right, rear left, rear right";
        torque_nm: [f64; 4], "N m at the wheels, in the same order";
        force_n: [f64; 2], "N, force of the frame on the rear axle, in the coordinates of that axle";
        moment_nm: [f64; 2], "N m, moment of the frame at root and tip";
        strain: [f32; MAX_GAUGES], "1, measured strains from the root on; 0 where no gauge is fitted";
    }

    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct AxleTruth = "cfmmr.AxleTruth", "True state of an axle of a simulated robot with more than two axles" {
        time_s: f64, "s";
        axle: Pose, "midpoint of the axle, global coordinates";
        wheel_speed_rad_s: [f64; 2], "rad/s: left, right";
        torque_nm: [f64; 2], "N m at the wheels: left, right";
    }

    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    pub struct FrameTruth = "cfmmr.FrameTruth", "True state of a frame of a simulated robot with more than two axles, and measured strains" {
        time_s: f64, "s";
        relative: Pose, "axle ahead in the coordinates of the axle behind";
        force_n: [f64; 2], "N, force of the frame on the axle behind, in the coordinates of that axle";
        moment_nm: [f64; 2], "N m, moment of the frame at root and tip";
        strain: [f32; MAX_GAUGES], "1, measured strains from the root on; 0 where no gauge is fitted";
    }
}

/// A bus frame with its decoded message; replay reads only the frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LoggedFrame {
    /// Name of the bus message.
    #[serde(skip_deserializing)]
    pub name: &'static str,
    /// Encoded frame, as on the bus.
    pub frame: Can,
    /// Message as the receivers decode it; `None` if the frame does not decode.
    #[serde(skip_deserializing)]
    pub message: Option<Decoded>,
}

/// Decoded message of a logged frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(untagged)]
pub enum Decoded {
    /// Message of a robot of two axles.
    OfPair(Message),
    /// Message of a robot of more axles, with the names of its boards and nodes.
    Named(Value),
}

impl Decoded {
    /// Message on the bus of `robot`.
    pub fn new(robot: Topology, message: &Message) -> Self {
        if robot.axle_count() == 2 {
            return Self::OfPair(*message);
        }
        let mut value = serde_json::to_value(message).unwrap_or_default();
        let bodies = value.as_object_mut().into_iter();
        for body in bodies.flat_map(|kinds| kinds.values_mut()) {
            for key in ["axle", "board", "node"] {
                let Some(name) = body.get_mut(key) else {
                    continue;
                };
                // Text names boards and nodes as those of two axles.
                let named = |role: &Role| {
                    let node = match *role {
                        Role::Axle(axle) => Node::Axle(axle),
                        Role::Beam(frame) => Node::Beam(frame),
                    };
                    let names = [serde_json::to_value(role), serde_json::to_value(node)];
                    names.into_iter().flatten().any(|own| own == *name)
                };
                if let Some(role) = robot.boards().find(named) {
                    *name = robot.name(role).into();
                }
            }
        }
        Self::Named(value)
    }
}

/// Posture as JSON object: position and heading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// x of the position, m.
    pub x_m: f64,
    /// y of the position, m.
    pub y_m: f64,
    /// Heading, rad.
    pub phi_rad: f64,
}

impl From<[f64; 3]> for Pose {
    fn from([x_m, y_m, phi_rad]: [f64; 3]) -> Self {
        Self { x_m, y_m, phi_rad }
    }
}

impl From<Posture> for Pose {
    fn from(posture: Posture) -> Self {
        [posture.x, posture.y, posture.phi].map(f64::from).into()
    }
}

impl From<Pose> for [f64; 3] {
    fn from(pose: Pose) -> Self {
        [pose.x_m, pose.y_m, pose.phi_rad]
    }
}

/// Posture that the lead node estimates, with its covariance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimated {
    /// Estimated posture.
    #[serde(flatten)]
    pub pose: Pose,
    /// Covariance of the estimate's (x, y, phi), in m and rad.
    pub covariance: [[f32; 3]; 3],
}

impl From<&Estimate> for Estimated {
    fn from(estimate: &Estimate) -> Self {
        Self {
            pose: estimate.posture.into(),
            covariance: estimate.covariance,
        }
    }
}

impl LeadEntry {
    /// Log entry for an output of the lead node that arrived at `tick`, with estimates valid at `epoch_s`, s. The field
    /// `bits` stays empty; only a log has it.
    pub fn new(tick: u32, epoch_s: f64, output: &lead::Output) -> Self {
        let lead::Output { fused, motion, .. } = output;
        let supervision = &output.supervision;
        Self {
            tick,
            epoch_s,
            mode: output.mode,
            phase: output.phase,
            state: supervision.state,
            reason: supervision.reason.map_or(0, |reason| reason.entry().code),
            done: output.done,
            robot: (&fused.robot).into(),
            front: (&fused.front).into(),
            rear: (&fused.rear).into(),
            innovation: fused.beam.innovation,
            nis: fused.beam.nis,
            velocity_m_s: motion.v,
            acceleration_m_s2: motion.v_rate,
            steering_rad: motion.psi.0,
            steering_rate_rad_s: motion.psi_rate,
            target: output.target.map(Pose::from),
            bits: Hex::default(),
        }
    }
}

impl From<&Record> for TruthEntry {
    /// Front and rear are the first and the last axle; force, moments and strains are those of the first frame.
    fn from(record: &Record) -> Self {
        let axle = |axle: Option<&AxleRecord>| axle.copied().unwrap_or_default();
        let (front, rear) = (axle(record.axles.first()), axle(record.axles.last()));
        let frame = record.frames.first().copied().unwrap_or_default();
        let four = |[left, right]: [f64; 2], rear: [f64; 2]| [left, right, rear[0], rear[1]];
        let relative = match record.frames.len() {
            1 => frame.relative,
            _ => seen_from(front.posture, rear.posture),
        };
        Self {
            time_s: record.time_s,
            robot: record.midpoint.into(),
            front: front.posture.into(),
            rear: rear.posture.into(),
            relative: relative.into(),
            wheel_speed_rad_s: four(front.wheel_speed, rear.wheel_speed),
            torque_nm: four(front.torque, rear.torque),
            force_n: frame.wrench.force,
            moment_nm: [frame.wrench.root_moment, frame.wrench.end_moment],
            strain: frame.strain,
        }
    }
}

/// A posture in the coordinates of another posture: m, m, rad.
fn seen_from([x, y, phi]: [f64; 3], [from_x, from_y, from_phi]: [f64; 3]) -> [f64; 3] {
    let (s, c) = libm::sincos(from_phi);
    let (dx, dy) = (x - from_x, y - from_y);
    let turn = libm::remainder(phi - from_phi, std::f64::consts::TAU);
    [c * dx + s * dy, c * dy - s * dx, turn]
}

impl AxleTruth {
    /// Entry of an axle in a record of the time `time_s`.
    pub fn new(time_s: f64, axle: &AxleRecord) -> Self {
        Self {
            time_s,
            axle: axle.posture.into(),
            wheel_speed_rad_s: axle.wheel_speed,
            torque_nm: axle.torque,
        }
    }
}

impl FrameTruth {
    /// Entry of a frame in a record of the time `time_s`.
    pub fn new(time_s: f64, frame: &FrameRecord) -> Self {
        Self {
            time_s,
            relative: frame.relative.into(),
            force_n: frame.wrench.force,
            moment_nm: [frame.wrench.root_moment, frame.wrench.end_moment],
            strain: frame.strain,
        }
    }
}

/// Part of a [`LeadEntry`] that replay reads.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct LeadBits {
    /// Tick of the board's reply, ms.
    pub tick: u32,
    /// `lead::Output` encoded as postcard.
    pub bits: Hex,
}

/// First tick of the epoch that contains `tick`, ms.
pub fn epoch_of(tick: u32) -> u32 {
    const TICKS: u32 = (core_algos::time::EPOCH / core_algos::time::TICK) as u32;
    tick / TICKS * TICKS
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn malformed_text_is_refused() {
        for bad in ["\"12\"", "\"0xg\"", "true", "[]"] {
            assert!(serde_json::from_str::<Exact>(bad).is_err(), "{bad}");
        }
        for bad in ["\"123\"", "\"0g\"", "\"é1\"", "1"] {
            assert!(serde_json::from_str::<Hex>(bad).is_err(), "{bad}");
        }
        for bad in [
            "\"800#00\"",
            "\"100\"",
            "\"100#0\"",
            "\"100#001122334455667788\"",
        ] {
            assert!(serde_json::from_str::<Can>(bad).is_err(), "{bad}");
        }
        let text = serde_json::to_string(&Hex::of(&(1u8, 2u8))).unwrap();
        let hex: Hex = serde_json::from_str(&text).unwrap();
        assert_eq!(hex.value(), Some((1u8, 2u8)));
        assert_eq!(hex.value::<u8>(), None, "bytes are left over");
    }

    properties! {
        #[test]
        fn every_bit_of_a_number_survives_the_text(bits: u32) {
            let value = Exact(f32::from_bits(bits));
            let text = serde_json::to_string(&value).unwrap();
            prop_assert_eq!(serde_json::from_str::<Exact>(&text).unwrap(), value);
        }

        #[test]
        fn every_frame_survives_the_text(id in 0u16..0x800, data: Vec<u8>) {
            let mut frame = CanFrame { id, length: data.len().min(8) as u8, data: [0; 8] };
            let length = usize::from(frame.length);
            frame.data[..length].copy_from_slice(&data[..length]);
            let text = serde_json::to_string(&Can(frame)).unwrap();
            prop_assert_eq!(serde_json::from_str::<Can>(&text).unwrap(), Can(frame));
        }
    }
}
