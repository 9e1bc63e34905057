//! The one table of messages: identifier, sender, period, timeout and signals.
//!
//! Signals are little-endian, packed without gaps in the order of the table; the physical value is
//! `raw · scale + offset`, and the range follows from width and scale. Periods and timeouts stand
//! here alone: defaults elsewhere are taken from [`timeout_s`].

use super::message::{CalibrationResult, LeadMode, POSITION_BITS, POSITION_STEP_M};
use crate::safety::OperatingState;
use crate::topology::Node;

/// Bit rate of the bus, bit/s.
pub const BIT_RATE: u32 = 1_000_000;

/// Identifiers; those of the axles are the front one's, plus one for the rear.
pub mod id {
    /// Common time.
    pub const TIME_SYNC: u16 = 0x010;
    /// Operating state of the lead node; then front axle, rear axle, beam.
    pub const NODE_STATUS: u16 = 0x040;
    /// Mode and progress of the lead node.
    pub const LEAD_STATUS: u16 = 0x070;
    /// Reference posture of the front axle.
    pub const REFERENCE_POSTURE: u16 = 0x080;
    /// Reference motion of the front axle.
    pub const REFERENCE_MOTION: u16 = 0x090;
    /// Odometric posture of the front axle.
    pub const AXLE_POSTURE: u16 = 0x100;
    /// Velocity of the front axle.
    pub const AXLE_MOTION: u16 = 0x110;
    /// Covariance of the front axle's increment.
    pub const AXLE_UNCERTAINTY: u16 = 0x120;
    /// Relative posture of the axles.
    pub const BEAM_POSTURE: u16 = 0x200;
    /// Its covariance.
    pub const BEAM_UNCERTAINTY: u16 = 0x201;
    /// Wrench of the frame.
    pub const BEAM_WRENCH: u16 = 0x202;
    /// Health of the front board; plus one for the rear, plus two for the beam.
    pub const BOARD_HEALTH: u16 = 0x300;
    /// A calibration asked of the beam board.
    pub const BEAM_CALIBRATION: u16 = 0x600;
    /// Result of the calibration.
    pub const BEAM_CALIBRATED: u16 = 0x601;
    /// Identity of the front board; plus one for the rear, plus two for the beam.
    pub const BOARD_IDENTITY: u16 = 0x720;
}

/// One signal of a message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signal {
    /// Name, as in the bus description.
    pub name: &'static str,
    /// Width in bits, at most 24.
    pub bits: u8,
    /// True if the raw value is two's complement.
    pub signed: bool,
    /// Physical value of one raw unit.
    pub scale: f32,
    /// Physical value of raw zero.
    pub offset: f32,
    /// Unit of the physical value; empty for a pure number.
    pub unit: &'static str,
    /// Names of the raw values 0, 1, 2…, of which no other may occur; empty for a quantity.
    pub labels: &'static [&'static str],
}

impl Signal {
    const fn unsigned(name: &'static str, bits: u8) -> Self {
        Self {
            name,
            bits,
            signed: false,
            scale: 1.0,
            offset: 0.0,
            unit: "",
            labels: &[],
        }
    }

    const fn labelled(name: &'static str, bits: u8, labels: &'static [&'static str]) -> Self {
        Self {
            labels,
            ..Self::unsigned(name, bits)
        }
    }

    const fn signed(name: &'static str, bits: u8, scale: f32, unit: &'static str) -> Self {
        Self {
            name,
            bits,
            signed: true,
            scale,
            offset: 0.0,
            unit,
            labels: &[],
        }
    }

    const fn in_unit(self, unit: &'static str) -> Self {
        Self { unit, ..self }
    }

    /// Smallest and largest raw value.
    pub const fn raw_range(&self) -> (i32, i32) {
        if !self.labels.is_empty() {
            (0, self.labels.len() as i32 - 1)
        } else if self.signed {
            (-(1 << (self.bits - 1)), (1 << (self.bits - 1)) - 1)
        } else {
            (0, (1 << self.bits) - 1)
        }
    }

    /// Physical value of a raw one.
    pub fn physical(&self, raw: i32) -> f32 {
        raw as f32 * self.scale + self.offset
    }

    /// Smallest and largest physical value.
    pub fn range(&self) -> (f32, f32) {
        let (low, high) = self.raw_range();
        (self.physical(low), self.physical(high))
    }
}

/// One message of the bus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layout {
    /// CAN identifier (11 bits); a lower one wins arbitration.
    pub id: u16,
    /// Name, as in the bus description.
    pub name: &'static str,
    /// Who sends it.
    pub sender: Node,
    /// Time between two of them, ms; 0 if it is sent on request only.
    pub period_ms: u16,
    /// Age at which the content no longer counts, ms; 0 if it does not age.
    pub timeout_ms: u16,
    /// Signals in order.
    pub signals: &'static [Signal],
}

impl Layout {
    /// Sum of the signals' widths.
    pub fn bits(&self) -> u32 {
        self.signals
            .iter()
            .map(|signal| u32::from(signal.bits))
            .sum()
    }

    /// Number of bytes of the frame.
    pub fn bytes(&self) -> u8 {
        self.bits().div_ceil(8) as u8
    }
}

const SEQUENCE: Signal = Signal::unsigned("sequence", 8);

const POSTURE: [Signal; 4] = [
    SEQUENCE,
    Signal::signed("x", POSITION_BITS, POSITION_STEP_M, "m"),
    Signal::signed("y", POSITION_BITS, POSITION_STEP_M, "m"),
    Signal::signed("phi", 16, 1e-4, "rad"),
];

const fn log_sigma(name: &'static str, unit: &'static str) -> Signal {
    Signal {
        name,
        bits: 10,
        signed: true,
        scale: 0.02,
        offset: -10.0,
        unit,
        labels: &[],
    }
}

/// Standard deviations as natural logarithms, so that 1e-8 and 1 are resolved alike (2 %), and
/// correlation coefficients.
const UNCERTAINTY: [Signal; 7] = [
    SEQUENCE,
    log_sigma("ln_sigma_x", "ln m"),
    log_sigma("ln_sigma_y", "ln m"),
    log_sigma("ln_sigma_phi", "ln rad"),
    Signal::signed("correlation_xy", 8, 1.0 / 127.0, ""),
    Signal::signed("correlation_xphi", 8, 1.0 / 127.0, ""),
    Signal::signed("correlation_yphi", 8, 1.0 / 127.0, ""),
];

const REFERENCE_MOTION: [Signal; 5] = [
    SEQUENCE,
    Signal::signed("velocity", 14, 2e-4, "m/s"),
    Signal::signed("yaw_rate", 14, 1e-3, "rad/s"),
    Signal::signed("acceleration", 14, 1e-3, "m/s2"),
    Signal::signed("yaw_acceleration", 14, 0.02, "rad/s2"),
];

const AXLE_MOTION: [Signal; 7] = [
    SEQUENCE,
    Signal::signed("velocity", 16, 1e-4, "m/s"),
    Signal::signed("yaw_rate", 16, 1e-3, "rad/s"),
    Signal::unsigned("refused", 8),
    Signal::unsigned("gyro_samples", 7),
    Signal::unsigned("gyro_zeroed", 1),
    Signal::unsigned("uptime", 8),
];

const NODE_STATUS: [Signal; 5] = [
    SEQUENCE,
    Signal::labelled("state", 8, &OperatingState::NAMES),
    Signal::unsigned("reason", 8),
    Signal::unsigned("notices", 24),
    Signal::unsigned("notices_high", 16),
];

const BOARD_HEALTH: [Signal; 6] = [
    SEQUENCE,
    Signal::unsigned("missed_ticks", 8),
    Signal::unsigned("tick_jitter", 12).in_unit("us"),
    Signal::unsigned("tick_worst", 12).in_unit("us"),
    Signal {
        scale: 0.1,
        ..Signal::unsigned("supply", 8)
    }
    .in_unit("V"),
    Signal::signed("temperature", 8, 1.0, "degC"),
];

const BOARD_IDENTITY: [Signal; 4] = [
    SEQUENCE,
    Signal::unsigned("chip", 24),
    Signal::unsigned("build", 24),
    Signal::unsigned("schema", 8),
];

/// A reference is two frames of one epoch, and one of them is lost twice as often as a message of one
/// frame: it may miss one epoch more. The mode shares its limit.
const COMMAND_TIMEOUT_MS: u16 = 60;

/// Rows: identifier, name, sender, period and timeout in ms, signals.
macro_rules! messages {
    ($($id:ident $(+ $index:literal)?, $name:literal, $sender:ident, $period:literal, $timeout:expr;
        $signals:expr;)+) => {
        /// Every message of the bus.
        pub const MESSAGES: [Layout; [$($name),+].len()] = [$(Layout {
            id: id::$id $(+ $index)?,
            name: $name,
            sender: Node::$sender,
            period_ms: $period,
            timeout_ms: $timeout,
            signals: &$signals,
        }),+];
    };
}

messages! {
    TIME_SYNC, "TimeSync", FrontAxle, 10, 50; [
        SEQUENCE,
        Signal::unsigned("epoch_high", 24),
        Signal::unsigned("last_delay", 16).in_unit("us"),
    ];
    NODE_STATUS, "NodeStatusLead", Lead, 10, 50; NODE_STATUS;
    NODE_STATUS + 1, "NodeStatusFrontAxle", FrontAxle, 10, 50; NODE_STATUS;
    NODE_STATUS + 2, "NodeStatusRearAxle", RearAxle, 10, 50; NODE_STATUS;
    NODE_STATUS + 3, "NodeStatusBeam", Beam, 10, 50; NODE_STATUS;
    LEAD_STATUS, "LeadStatus", Lead, 10, COMMAND_TIMEOUT_MS; [
        SEQUENCE,
        Signal::labelled("mode", 8, &LeadMode::NAMES),
        Signal::signed("steering", 16, 1e-4, "rad"),
        Signal::signed("velocity", 16, 1e-4, "m/s"),
    ];
    REFERENCE_POSTURE, "ReferencePostureFront", Lead, 10, COMMAND_TIMEOUT_MS; POSTURE;
    REFERENCE_POSTURE + 1, "ReferencePostureRear", Lead, 10, COMMAND_TIMEOUT_MS; POSTURE;
    REFERENCE_MOTION, "ReferenceMotionFront", Lead, 10, COMMAND_TIMEOUT_MS; REFERENCE_MOTION;
    REFERENCE_MOTION + 1, "ReferenceMotionRear", Lead, 10, COMMAND_TIMEOUT_MS; REFERENCE_MOTION;
    AXLE_POSTURE, "AxlePostureFront", FrontAxle, 10, 50; POSTURE;
    AXLE_POSTURE + 1, "AxlePostureRear", RearAxle, 10, 50; POSTURE;
    AXLE_MOTION, "AxleMotionFront", FrontAxle, 10, 50; AXLE_MOTION;
    AXLE_MOTION + 1, "AxleMotionRear", RearAxle, 10, 50; AXLE_MOTION;
    AXLE_UNCERTAINTY, "AxleUncertaintyFront", FrontAxle, 10, 50; UNCERTAINTY;
    AXLE_UNCERTAINTY + 1, "AxleUncertaintyRear", RearAxle, 10, 50; UNCERTAINTY;
    BEAM_POSTURE, "BeamPosture", Beam, 10, 50; [
        SEQUENCE,
        Signal::signed("x", 18, 5e-6, "m"),
        Signal::signed("y", 18, 5e-6, "m"),
        Signal::signed("phi", 16, 1e-4, "rad"),
        Signal::unsigned("gauges", 4),
    ];
    BEAM_UNCERTAINTY, "BeamUncertainty", Beam, 10, 50; UNCERTAINTY;
    BEAM_WRENCH, "BeamWrench", Beam, 10, 50; [
        SEQUENCE,
        Signal::signed("force_x", 14, 0.05, "N"),
        Signal::signed("force_y", 14, 0.05, "N"),
        Signal::signed("moment_root", 14, 1e-3, "N m"),
        Signal::signed("moment_end", 14, 1e-3, "N m"),
    ];
    BOARD_HEALTH, "BoardHealthFront", FrontAxle, 100, 500; BOARD_HEALTH;
    BOARD_HEALTH + 1, "BoardHealthRear", RearAxle, 100, 500; BOARD_HEALTH;
    BOARD_HEALTH + 2, "BoardHealthBeam", Beam, 100, 500; BOARD_HEALTH;
    BEAM_CALIBRATION, "BeamCalibration", Service, 0, 0; [
        SEQUENCE,
        Signal::labelled("command", 8, &["zero", "gain"]),
        Signal::signed("curvature", 16, 1e-3, "1/m"),
    ];
    BEAM_CALIBRATED, "BeamCalibrated", Beam, 0, 0; [
        SEQUENCE,
        Signal::labelled("result", 8, &CalibrationResult::NAMES),
        Signal::unsigned("gauge", 4),
    ];
    BOARD_IDENTITY, "BoardIdentityFront", FrontAxle, 1000, 5000; BOARD_IDENTITY;
    BOARD_IDENTITY + 1, "BoardIdentityRear", RearAxle, 1000, 5000; BOARD_IDENTITY;
    BOARD_IDENTITY + 2, "BoardIdentityBeam", Beam, 1000, 5000; BOARD_IDENTITY;
}

/// Check number of the table (FNV-1a): identifiers, widths, scales and offsets.
pub fn schema() -> u8 {
    let mut sum = 0x811c_9dc5_u32;
    let mut add = |word: u32| {
        for byte in word.to_le_bytes() {
            sum = (sum ^ u32::from(byte)).wrapping_mul(0x0100_0193);
        }
    };
    for layout in &MESSAGES {
        add(layout.id.into());
        for signal in layout.signals {
            add(u32::from(signal.bits) << 1 | u32::from(signal.signed));
            add(signal.scale.to_bits());
            add(signal.offset.to_bits());
        }
    }
    (sum ^ sum >> 8 ^ sum >> 16 ^ sum >> 24) as u8
}

/// The entry of the table for an identifier.
pub fn find(id: u16) -> Option<&'static Layout> {
    MESSAGES.iter().find(|layout| layout.id == id)
}

/// Age at which a message no longer counts, s; 0 for one that does not age or is unknown.
pub fn timeout_s(id: u16) -> f32 {
    find(id).map_or(0.0, |layout| f32::from(layout.timeout_ms) / 1000.0)
}

/// Bits one frame of `bytes` data bytes takes on the bus in the worst case: 47 of frame overhead
/// and interframe space, and a stuff bit for each four of the stuffed part.
pub const fn frame_bits(bytes: u8) -> u32 {
    let data = 8 * bytes as u32;
    47 + data + (34 + data - 1) / 4
}

impl Layout {
    /// Worst-case bits a second this message takes at its period; 0 for one sent on request.
    pub fn bits_per_second(&self) -> f32 {
        if self.period_ms == 0 {
            return 0.0;
        }
        frame_bits(self.bytes()) as f32 * 1000.0 / f32::from(self.period_ms)
    }
}

/// Worst-case share of the bus all periodic messages of the table take, 0 to 1.
pub fn load(bit_rate: f32) -> f32 {
    MESSAGES.iter().map(Layout::bits_per_second).sum::<f32>() / bit_rate
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_message_fits_a_classic_can_frame() {
        for layout in &MESSAGES {
            assert!(layout.bits() <= 64, "{} has {}", layout.name, layout.bits());
            assert!(layout.id <= 0x7ff);
            for signal in layout.signals {
                assert!(signal.bits <= 24 && signal.scale > 0.0);
                assert!(signal.labels.len() <= 1 << signal.bits);
            }
        }
    }

    #[test]
    fn identifiers_are_unique_and_rise() {
        for pair in MESSAGES.windows(2) {
            assert!(pair[0].id < pair[1].id);
        }
    }

    #[test]
    fn what_is_sent_every_epoch_is_so_by_the_table() {
        use crate::time::EPOCH;
        for layout in MESSAGES {
            let periodic = u64::from(layout.period_ms) * 1000;
            assert!(periodic.is_multiple_of(EPOCH), "{}", layout.name);
            assert!(layout.timeout_ms >= 5 * layout.period_ms, "{}", layout.name);
        }
        assert_eq!(timeout_s(id::AXLE_POSTURE), 0.05);
        // One limit stands for mode and reference in the axle node.
        for id in [
            id::LEAD_STATUS,
            id::REFERENCE_POSTURE,
            id::REFERENCE_POSTURE + 1,
            id::REFERENCE_MOTION,
            id::REFERENCE_MOTION + 1,
        ] {
            assert_eq!(timeout_s(id), 0.06);
        }
    }

    #[test]
    fn bus_load_leaves_room() {
        // 135 bits is the textbook worst case of an 8-byte frame with an 11-bit identifier.
        assert_eq!(frame_bits(8), 135);
        let load = load(BIT_RATE as f32);
        assert!(load > 0.1 && load < 0.5, "{load}");
    }
}
