//! Table of the bus messages: the source of [`Message`], codec, timeouts of the nodes, bus description and docs/bus.md.
//!
//! Every periodic message carries as sequence number the 10 ms epoch, modulo 256, to which its content refers.
//! Odometric postures are cumulative, so a lost message delays information and loses none. Their positions are sent
//! modulo [`POSITION_SPAN_M`](super::field::POSITION_SPAN_M), and only differences are used.
//!
//! An identifier is 16 times a function number, plus the offset of the axle, frame, board or node. The offset of the
//! board or node of frame i is 16 + i.

use super::field::{
    Calibrate, CalibrationResult, Field, Hash24, LeadMode, Odometric, POSITION_BITS,
    POSITION_STEP_M, Values,
};
use super::signal::{Layout, Of, Sender, Signal};
use crate::math::Posture;
use crate::math::matrix::Mat3;
use crate::math::wrench::Wrench;
use crate::safety::{Conditions, OperatingState};
use crate::topology::{AxleId, FrameId, MAX_AXLES, MAX_FRAMES, Node, Role};

/// Timeout of references and mode, ms. A reference needs two frames of one epoch and is lost twice as often as a
/// message of one frame, so its timeout is one epoch longer.
const COMMAND_MS: u16 = 60;

const SEQUENCE: [Signal; 1] = [Signal::unsigned("sequence", 8)];

const POSTURE: [Signal; 3] = [
    Signal::signed("x", POSITION_BITS, POSITION_STEP_M, "m"),
    Signal::signed("y", POSITION_BITS, POSITION_STEP_M, "m"),
    Signal::signed("phi", 16, 1e-4, "rad"),
];

/// Standard deviations as natural logarithms, which have a resolution of 2 % from 1e-8 to 1, and correlation
/// coefficients.
const UNCERTAINTY: [Signal; 6] = [
    Signal::log_sigma("ln_sigma_x", "ln m"),
    Signal::log_sigma("ln_sigma_y", "ln m"),
    Signal::log_sigma("ln_sigma_phi", "ln rad"),
    Signal::signed("correlation_xy", 8, 1.0 / 127.0, ""),
    Signal::signed("correlation_xphi", 8, 1.0 / 127.0, ""),
    Signal::signed("correlation_yphi", 8, 1.0 / 127.0, ""),
];

/// Table of messages. A message has: meaning and name; owner, if each axle, frame, board or node has such a message;
/// first identifier and sender; period and timeout, ms, 0 if none; fields with meaning, type and signals.
macro_rules! messages {
    ($(
        $(#[doc = $meaning:literal])+
        $constant:ident = $name:ident $(of $(#[$whose:meta])* $which:ident: $kind:ident)? at $id:literal from $sender:expr,
            every $period:literal counts $timeout:expr;
        {$(
            $(#[doc = $note:literal])+
            $field:ident: $type:ty $(as $wire:ident)? = $signals:expr,
        )+}
    )+) => {
        /// A message on the bus.
        #[derive(Clone, Copy, Debug, PartialEq)]
        #[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
        #[cfg_attr(feature = "serde", serde(deny_unknown_fields))]
        pub enum Message {$(
            $(#[doc = $meaning])+
            $name {
                $(
                    /// Axle, frame, board or node that owns the message.
                    $(#[$whose])*
                    $which: $kind,
                )?
                $($(#[doc = $note])+ $field: $type,)+
            },
        )+}

        /// First identifier of each message.
        pub mod id {$(
            $(#[doc = $meaning])+
            pub const $constant: u16 = $id;
        )+}

        mod signals {
            use super::*;
            $(pub const $constant: &[Signal] = {
                const FIELDS: &[&[Signal]] = &[$(&$signals),+];
                const NOTES: &[&str] = &[$(concat!($($note),+)),+];
                &super::flat::<{ super::count(FIELDS) }>(FIELDS, NOTES)
            };)+
        }

        /// Every message of the bus, in the order of the first identifiers.
        pub const MESSAGES: [Layout; [$($id),+].len()] = [$(Layout {
            id: $id,
            name: stringify!($name),
            meaning: concat!($($meaning),+),
            of: of!($($kind)?),
            sender: $sender,
            period_ms: $period,
            timeout_ms: $timeout,
            signals: signals::$constant,
        }),+];

        impl Message {
            /// Identifier and signal values; the identifier is `None` if the owner has no such message.
            pub(super) fn to_values(self) -> (Option<u16>, Values) {
                let mut values = Values::default();
                let mut to = values.iter_mut();
                let id = match self {$(
                    Self::$name { $($which,)? $($field),+ } => {
                        $($(let $field = $wire($field);)? $field.write(&mut to);)+
                        let _offset = Some(0);
                        $(let _offset = $which.offset();)?
                        _offset.map(|offset| $id + offset)
                    }
                )+};
                (id, values)
            }

            /// Message of a first identifier and an offset; `None` if no such message exists or a value is undefined.
            pub(super) fn from_values(first: u16, _offset: u16, values: &Values) -> Option<Self> {
                let mut from = values.iter();
                Some(match first {
                    $($id => {
                        $(let $which = $kind::at(_offset)?;)?
                        $(let $field = Field::read(&mut from)?; $(let $wire($field) = $field;)?)+
                        Self::$name { $($which,)? $($field),+ }
                    })+
                    _ => return None,
                })
            }
        }
    };
}

/// Kind of a message, from the type of its owner.
macro_rules! of {
    () => {
        Of::Robot
    };
    (AxleId) => {
        Of::Axle
    };
    (FrameId) => {
        Of::Frame
    };
    (Role) => {
        Of::Board
    };
    (Node) => {
        Of::Node
    };
}

/// Axle, frame, board or node as an offset from the first identifier of its message.
pub(super) trait Placed: Sized {
    /// Offset from the first identifier; `None` if the number is too large or the node has no such message.
    fn offset(self) -> Option<u16>;

    /// Owner of the message at this offset; `None` if no owner has the offset.
    fn at(offset: u16) -> Option<Self>;
}

/// Offset of the board of the first frame.
const FRAMES: u16 = 0x10;

impl Placed for AxleId {
    fn offset(self) -> Option<u16> {
        (self.index() < MAX_AXLES).then_some(self.0.into())
    }

    fn at(offset: u16) -> Option<Self> {
        (offset < MAX_AXLES as u16).then_some(Self(offset as u8))
    }
}

impl Placed for FrameId {
    fn offset(self) -> Option<u16> {
        (self.index() < MAX_FRAMES).then_some(self.0.into())
    }

    fn at(offset: u16) -> Option<Self> {
        (offset < MAX_FRAMES as u16).then_some(Self(offset as u8))
    }
}

impl Placed for Role {
    fn offset(self) -> Option<u16> {
        match self {
            Self::Axle(axle) => axle.offset(),
            Self::Beam(frame) => Some(FRAMES + frame.offset()?),
        }
    }

    fn at(offset: u16) -> Option<Self> {
        match offset.checked_sub(FRAMES) {
            Some(offset) => FrameId::at(offset).map(Self::Beam),
            None => AxleId::at(offset).map(Self::Axle),
        }
    }
}

impl Placed for Node {
    fn offset(self) -> Option<u16> {
        match self {
            Self::Lead => Some(0),
            Self::Axle(axle) => Some(1 + axle.offset()?),
            Self::Beam(frame) => Role::Beam(frame).offset(),
            Self::Service => None,
        }
    }

    fn at(offset: u16) -> Option<Self> {
        match offset {
            0 => Some(Self::Lead),
            1..FRAMES => AxleId::at(offset - 1).map(Self::Axle),
            _ => FrameId::at(offset - FRAMES).map(Self::Beam),
        }
    }
}

/// Number of signals of all fields.
const fn count(fields: &[&[Signal]]) -> usize {
    let (mut count, mut i) = (0, 0);
    while i < fields.len() {
        count += fields[i].len();
        i += 1;
    }
    count
}

/// Signals of all fields in order, each with the meaning of its field.
const fn flat<const N: usize>(fields: &[&[Signal]], notes: &[&'static str]) -> [Signal; N] {
    let mut all = [SEQUENCE[0]; N];
    let (mut place, mut i) = (0, 0);
    while i < fields.len() {
        let mut k = 0;
        while k < fields[i].len() {
            all[place] = fields[i][k];
            all[place].meaning = notes[i];
            (place, k) = (place + 1, k + 1);
        }
        i += 1;
    }
    all
}

messages! {
    /// Common time, sent by the front board at the beginning of every epoch.
    TIME_SYNC = TimeSync at 0x010 from Sender::Node(Node::axle(0)), every 10 counts 50;
    {
        /// Number of the epoch that begins.
        epoch: u32 = [Signal::unsigned("sequence", 8), Signal::unsigned("epoch_high", 24)],
        /// Delay of the previous `TimeSync`, from the beginning of its epoch to its end on the bus, µs; none if it was
        /// not sent within 65 ms.
        last_delay_us: Option<u16> = [Signal::unsigned("last_delay", 16).in_unit("us")],
    }
    /// Heartbeat of a node with its operating state.
    NODE_STATUS = NodeStatus of node: Node at 0x040 from Sender::Own, every 10 counts 50;
    {
        /// Epoch modulo 256.
        sequence: u8 = SEQUENCE,
        /// Operating state.
        state: OperatingState = [Signal::labelled("state", 4, &OperatingState::NAMES)],
        /// Code of the first stop or cut since the last clearing, see
        /// [`Condition`](crate::safety::Condition); before arming, code of the condition that prevents
        /// arming; 0 if there is none.
        reason: u8 = [Signal::unsigned("reason", 8)],
        /// Notices and degradations since the previous heartbeat.
        notices: Conditions = [Signal::unsigned("notices", 24), Signal::unsigned("notices_high", 20)],
    }
    /// Mode and progress of the lead node.
    LEAD_STATUS = LeadStatus at 0x070 from Sender::Node(Node::Lead), every 10 counts COMMAND_MS;
    {
        /// Epoch modulo 256.
        sequence: u8 = SEQUENCE,
        /// Mode commanded to the axles.
        mode: LeadMode = [Signal::labelled("mode", 8, &LeadMode::NAMES)],
        /// Commanded steering angle ψ, rad.
        steering_rad: f32 = [Signal::signed("steering", 16, 1e-4, "rad")],
        /// Commanded velocity of the midpoint, m/s.
        velocity_m_s: f32 = [Signal::signed("velocity", 16, 1e-4, "m/s")],
    }
    /// Reference posture of an axle in that axle's odometric frame.
    REFERENCE_POSTURE = ReferencePosture of axle: AxleId at 0x080 from Sender::Node(Node::Lead), every 10 counts COMMAND_MS;
    {
        /// Epoch modulo 256 at whose beginning the reference holds.
        sequence: u8 = SEQUENCE,
        /// Reference posture.
        posture: Posture as Odometric = POSTURE,
    }
    /// Reference velocities and accelerations of an axle.
    REFERENCE_MOTION = ReferenceMotion of axle: AxleId at 0x090 from Sender::Node(Node::Lead), every 10 counts COMMAND_MS;
    {
        /// Epoch modulo 256 at whose beginning the reference holds.
        sequence: u8 = SEQUENCE,
        /// Forward velocity, m/s.
        velocity_m_s: f32 = [Signal::signed("velocity", 14, 2e-4, "m/s")],
        /// Yaw rate, rad/s.
        yaw_rate_rad_s: f32 = [Signal::signed("yaw_rate", 14, 1e-3, "rad/s")],
        /// Forward acceleration, m/s².
        acceleration_m_s2: f32 = [Signal::signed("acceleration", 14, 1e-3, "m/s2")],
        /// Yaw acceleration, rad/s².
        yaw_acceleration_rad_s2: f32 = [Signal::signed("yaw_acceleration", 14, 0.02, "rad/s2")],
    }
    /// Odometric posture of an axle since its start, in its own odometric frame.
    AXLE_POSTURE = AxlePosture of axle: AxleId at 0x100 from Sender::Own, every 10 counts 50;
    {
        /// Epoch modulo 256 at whose beginning the posture holds.
        sequence: u8 = SEQUENCE,
        /// The posture.
        posture: Posture as Odometric = POSTURE,
    }
    /// Velocity of an axle.
    AXLE_MOTION = AxleMotion of axle: AxleId at 0x110 from Sender::Own, every 10 counts 50;
    {
        /// Epoch modulo 256.
        sequence: u8 = SEQUENCE,
        /// Forward velocity, m/s.
        velocity_m_s: f32 = [Signal::signed("velocity", 16, 1e-4, "m/s")],
        /// Yaw rate, rad/s.
        yaw_rate_rad_s: f32 = [Signal::signed("yaw_rate", 16, 1e-3, "rad/s")],
        /// Measurements refused by the innovation gate since the last message, at most 255.
        refused: u8 = [Signal::unsigned("refused", 8)],
        /// Yaw-rate samples used by the odometry since the last message, at most 127.
        gyro_samples: u8 = [Signal::unsigned("gyro_samples", 7)],
        /// True if the gyro was zeroed at rest since the last message.
        gyro_zeroed: bool = [Signal::unsigned("gyro_zeroed", 1)],
        /// Epochs since the axle node was started and its odometric frame began, at most 255.
        uptime: u8 = [Signal::unsigned("uptime", 8)],
    }
    /// Covariance of the odometric increment of an axle over the last epoch, in the axle's frame
    /// at the beginning of that epoch.
    AXLE_UNCERTAINTY = AxleUncertainty of axle: AxleId at 0x120 from Sender::Own, every 10 counts 50;
    {
        /// Epoch modulo 256.
        sequence: u8 = SEQUENCE,
        /// Covariance of (x, y, phi): m², m rad, rad².
        covariance: Mat3 = UNCERTAINTY,
    }
    /// Posture of the front axle in the rear axle's frame, from the strains of the strip.
    BEAM_POSTURE = BeamPosture of
        #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "FrameId::is_first"))] frame: FrameId at 0x200 from Sender::Own, every 10 counts 50;
    {
        /// Epoch modulo 256 at whose beginning the posture holds.
        sequence: u8 = SEQUENCE,
        /// The posture.
        posture: Posture = [
            Signal::signed("x", 18, 5e-6, "m"),
            Signal::signed("y", 18, 5e-6, "m"),
            Signal::signed("phi", 16, 1e-4, "rad"),
        ],
        /// Number of gauges in use; 0 when there is no valid estimate.
        gauges: u8 = [Signal::unsigned("gauges", 4)],
    }
    /// Covariance of the beam's posture.
    BEAM_UNCERTAINTY = BeamUncertainty of
        #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "FrameId::is_first"))] frame: FrameId at 0x210 from Sender::Own, every 10 counts 50;
    {
        /// Epoch modulo 256.
        sequence: u8 = SEQUENCE,
        /// Covariance of (x, y, phi): m², m rad, rad².
        covariance: Mat3 = UNCERTAINTY,
    }
    /// Wrench of the frame, from the strains.
    BEAM_WRENCH = BeamWrench of
        #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "FrameId::is_first"))] frame: FrameId at 0x220 from Sender::Own, every 10 counts 50;
    {
        /// Epoch modulo 256.
        sequence: u8 = SEQUENCE,
        /// The wrench.
        wrench: Wrench = [
            Signal::signed("force_x", 14, 0.05, "N"),
            Signal::signed("force_y", 14, 0.05, "N"),
            Signal::signed("moment_root", 14, 1e-3, "N m"),
            Signal::signed("moment_end", 14, 1e-3, "N m"),
        ],
    }
    /// Health of a board.
    BOARD_HEALTH = BoardHealth of board: Role at 0x300 from Sender::Own, every 100 counts 500;
    {
        /// Epoch modulo 256.
        sequence: u8 = SEQUENCE,
        /// Ticks missed since the start, at most 255.
        missed_ticks: u8 = [Signal::unsigned("missed_ticks", 8)],
        /// Largest lateness of a tick since the last report, µs, at most 4095.
        tick_jitter_us: u16 = [Signal::unsigned("tick_jitter", 12).in_unit("us")],
        /// Longest tick since the last report, µs, at most 4095.
        tick_worst_us: u16 = [Signal::unsigned("tick_worst", 12).in_unit("us")],
        /// Supply voltage of the board, V, at most 25.5.
        supply_v: f32 = [Signal { scale: 0.1, ..Signal::unsigned("supply", 8) }.in_unit("V")],
        /// Highest temperature on the board, °C, −128 to 127.
        temperature_c: f32 = [Signal::signed("temperature", 8, 1.0, "degC")],
    }
    /// Request for a calibration of the beam board.
    BEAM_CALIBRATION = BeamCalibration of
        #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "FrameId::is_first"))] frame: FrameId at 0x600 from Sender::Node(Node::Service), every 0 counts 0;
    {
        /// Number of the request, returned in the result.
        sequence: u8 = SEQUENCE,
        /// Requested calibration.
        calibrate: Calibrate = [
            Signal::labelled("command", 8, &["zero", "gain"]),
            Signal::signed("curvature", 16, 1e-3, "1/m"),
        ],
    }
    /// Result of a calibration of the beam board.
    BEAM_CALIBRATED = BeamCalibrated of
        #[cfg_attr(feature = "serde", serde(default, skip_serializing_if = "FrameId::is_first"))] frame: FrameId at 0x610 from Sender::Own, every 0 counts 0;
    {
        /// Number of the request.
        sequence: u8 = SEQUENCE,
        /// Result of the calibration.
        result: CalibrationResult = [Signal::labelled("result", 8, &CalibrationResult::NAMES)],
        /// Gauge that caused a refusal, counted from the root.
        gauge: u8 = [Signal::unsigned("gauge", 4)],
    }
    /// Identity of a board.
    BOARD_IDENTITY = BoardIdentity of board: Role at 0x720 from Sender::Own, every 1000 counts 5000;
    {
        /// Epoch modulo 256.
        sequence: u8 = SEQUENCE,
        /// Hash of the chip's unique identifier.
        chip: Hash24 = [Signal::unsigned("chip", 24)],
        /// First digits of the hash of the image's sources.
        build: Hash24 = [Signal::unsigned("build", 24)],
        /// [`schema`](super::layout::schema) of the image.
        schema: u8 = [Signal::unsigned("schema", 8)],
    }
}
