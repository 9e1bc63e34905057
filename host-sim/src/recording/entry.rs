//! What the messages of a log hold: written by the recorder, read by replay.
//!
//! Everything that replay needs is there bit by bit: numbers of the boards (`f32`) are written as
//! the same `f64`, whose shortest decimal reads back the same; structures also as the bytes
//! (postcard, as on the serial link) in hexadecimal.

use core_algos::beam::MAX_GAUGES;
use core_algos::bus::{CanFrame, LeadMode, Message};
use core_algos::control::regulator::Phase;
use core_algos::fusion::Estimate;
use core_algos::math::Posture;
use core_algos::node::lead;
use core_algos::safety::{Conditions, OperatingState};
use core_algos::topology::Role;
use serde::de::{DeserializeOwned, Error as _, Unexpected};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use serde_json::Value;

/// Name of the metadata record that says what a log is of.
pub const ABOUT: &str = "cfmmr";
/// Name of the metadata record that says how the run ended.
pub const END: &str = "cfmmr.end";
/// Version of what a log holds: changes with every change of its messages.
pub const FORMAT: &str = "2";

/// A number of the boards; what is not finite stands as its bits, `"0x7fc00000"`.
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

/// Bytes in hexadecimal.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Hex(pub Vec<u8>);

impl Hex {
    /// A value as postcard.
    pub fn of<T: Serialize>(value: &T) -> Self {
        // Only a `Serialize` that fails could fail here, and none of ours does.
        Self(postcard::to_extend(value, Vec::new()).unwrap_or_default())
    }

    /// The value; none if the bytes are those of another type.
    pub fn value<T: DeserializeOwned>(&self) -> Option<T> {
        match postcard::take_from_bytes(&self.0) {
            Ok((value, [])) => Some(value),
            _ => None,
        }
    }
}

const DIGITS: &[u8; 16] = b"0123456789abcdef";

/// Two digits of each byte.
fn in_hex(bytes: &[u8]) -> String {
    let digits = |byte: &u8| [byte >> 4, byte & 15].map(|digit| DIGITS[usize::from(digit)]);
    let text: Vec<u8> = bytes.iter().flat_map(digits).collect();
    // Digits are text.
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

/// A frame of the bus as `1a0#0011223344556677`: identifier, then data.
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

/// A board's nodes were started.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Start {
    /// The first tick, ms.
    pub tick: u32,
    /// `RobotConfig` as postcard.
    pub parameters: Hex,
    /// CRC-32C of these bytes, as the board checks it.
    pub parameters_hash: String,
    /// Initial estimate of the lead node: `Place` as postcard.
    pub place: Option<Hex>,
}

/// A board was switched off.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Off {
    /// Time, ms.
    pub tick: u32,
    /// Why.
    pub reason: String,
}

/// One tick of an axle board.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AxleTick {
    /// Time, ms.
    pub tick: u32,
    /// Encoder counts (left, right).
    pub encoder: [Option<i32>; 2],
    /// Yaw rate, rad/s.
    pub gyro_rad_s: Option<Exact>,
    /// Acceleration along the heading, m/s².
    pub acceleration_m_s2: Option<Exact>,
    /// Conditions reported by the drivers.
    pub conditions: Conditions,
    /// Frames that arrived before.
    pub received: Vec<Can>,
    /// Wheel torques commanded (left, right), N m.
    pub torque_nm: [Exact; 2],
}

/// One tick of the beam board.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct BeamTick {
    /// Time, ms.
    pub tick: u32,
    /// Counts of the bridges.
    pub counts: [i32; MAX_GAUGES],
    /// Frames that arrived before.
    pub received: Vec<Can>,
}

/// A command of the host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HostCommandEntry {
    /// Time, ms: before this tick.
    pub tick: u32,
    /// The command in words.
    pub text: String,
    /// `HostCommand` as postcard.
    pub bits: Hex,
}

/// Frames that a board sent at a tick.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BusEntry {
    /// Time, ms.
    pub tick: u32,
    /// The board.
    pub board: Role,
    /// The frames, in order.
    pub frames: Vec<LoggedFrame>,
}

/// A frame and what it says.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LoggedFrame {
    /// Name of the message.
    pub name: &'static str,
    /// The frame.
    pub frame: Can,
    /// Message, as the receivers decode it.
    pub message: Option<Message>,
}

/// The part of a [`BusEntry`] that replay reads.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct BusFrames {
    /// Time, ms.
    pub tick: u32,
    /// The board.
    pub board: Role,
    /// The frames, in order.
    pub frames: Vec<SaidFrame>,
}

/// The part of a [`LoggedFrame`] that replay reads.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct SaidFrame {
    /// The frame.
    pub frame: Can,
}

/// Position and heading.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// m.
    pub x_m: f64,
    /// m.
    pub y_m: f64,
    /// rad.
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

/// A posture with its covariance.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimated {
    /// Posture.
    #[serde(flatten)]
    pub pose: Pose,
    /// Covariance of (x, y, phi).
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

/// Output of the lead node at a step.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LeadEntry {
    /// Tick of the board's answer, ms.
    pub tick: u32,
    /// The instant at which the estimates hold, s.
    pub epoch_s: f64,
    /// Mode sent to the axles.
    pub mode: LeadMode,
    /// Phase of the regulator.
    pub phase: Phase,
    /// Operating state of the lead node.
    pub state: OperatingState,
    /// Code of the condition that stopped it, 0 if none.
    pub reason: u8,
    /// The task is fulfilled.
    pub done: bool,
    /// Midpoint.
    pub robot: Estimated,
    /// Front axle.
    pub front: Estimated,
    /// Rear axle.
    pub rear: Estimated,
    /// Measured less predicted relative posture.
    pub innovation: [f32; 3],
    /// Normalised innovation squared.
    pub nis: f32,
    /// Commanded velocity.
    pub velocity_m_s: f32,
    /// Commanded acceleration.
    pub acceleration_m_s2: f32,
    /// Commanded steering angle.
    pub steering_rad: f32,
    /// Commanded steering rate.
    pub steering_rate_rad_s: f32,
    /// Reference of the midpoint.
    pub target: Option<Pose>,
    /// `lead::Output` as postcard.
    pub bits: Hex,
}

impl LeadEntry {
    /// The entry of an output that came at `tick`.
    pub fn new(tick: u32, output: &lead::Output) -> Self {
        let lead::Output { fused, motion, .. } = output;
        let supervision = &output.supervision;
        Self {
            tick,
            epoch_s: f64::from(epoch_of(tick)) * 1e-3,
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
            bits: Hex::of(output),
        }
    }
}

/// The part of a [`LeadEntry`] that replay reads.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct LeadBits {
    /// Tick of the board's answer, ms.
    pub tick: u32,
    /// `lead::Output` as postcard.
    pub bits: Hex,
}

/// Beginning of the epoch of a tick, ms.
pub fn epoch_of(tick: u32) -> u32 {
    const TICKS: u32 = (core_algos::time::EPOCH / core_algos::time::TICK) as u32;
    tick / TICKS * TICKS
}

/// The simulated robot as it really is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TruthEntry {
    /// Time, s.
    pub time_s: f64,
    /// Midpoint.
    pub robot: Pose,
    /// Front axle.
    pub front: Pose,
    /// Rear axle.
    pub rear: Pose,
    /// Front axle in the rear axle's frame.
    pub relative: Pose,
    /// Wheel speeds: front left, front right, rear left, rear right, rad/s.
    pub wheel_speed_rad_s: [f64; 4],
    /// Torques at the wheels, in the same order, N m.
    pub torque_nm: [f64; 4],
    /// Force of the frame on the rear axle, in its frame, N.
    pub force_n: [f64; 2],
    /// Moments of the frame at root and end, N m.
    pub moment_nm: [f64; 2],
    /// Strains as measured, from the root.
    pub strain: Vec<f32>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn text_that_is_none_of_ours_is_refused() {
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
        fn every_bit_of_a_number_comes_back(bits: u32) {
            let value = Exact(f32::from_bits(bits));
            let text = serde_json::to_string(&value).unwrap();
            prop_assert_eq!(serde_json::from_str::<Exact>(&text).unwrap(), value);
        }

        #[test]
        fn every_frame_comes_back(id in 0u16..0x800, data: Vec<u8>) {
            let mut frame = CanFrame { id, length: data.len().min(8) as u8, data: [0; 8] };
            let length = usize::from(frame.length);
            frame.data[..length].copy_from_slice(&data[..length]);
            let text = serde_json::to_string(&Can(frame)).unwrap();
            prop_assert_eq!(serde_json::from_str::<Can>(&text).unwrap(), Can(frame));
        }
    }
}
