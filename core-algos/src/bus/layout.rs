//! The one table of messages: identifier, sender, period, timeout and signals.
//!
//! Signals are little-endian, packed without gaps in the order of the table; the physical value is
//! `raw · scale + offset`.

/// A node of the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Node {
    /// Central node, on the front board.
    Lead,
    /// Front axle board.
    FrontAxle,
    /// Rear axle board.
    RearAxle,
    /// Beam board.
    Beam,
}

/// One signal of a message.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Signal {
    /// Name, as in the bus description.
    pub name: &'static str,
    /// Width in bits, at most 24.
    pub bits: u8,
    /// Whether the raw value is two's complement.
    pub signed: bool,
    /// Physical value of one raw unit.
    pub scale: f32,
    /// Physical value of raw zero.
    pub offset: f32,
    /// Unit of the physical value; empty for a pure number.
    pub unit: &'static str,
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
        }
    }

    /// Smallest and largest raw value.
    pub const fn raw_range(&self) -> (i32, i32) {
        if self.signed {
            (-(1 << (self.bits - 1)), (1 << (self.bits - 1)) - 1)
        } else {
            (0, (1 << self.bits) - 1)
        }
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
    /// Time between two of them, ms.
    pub period_ms: u16,
    /// Age at which the content no longer counts, ms.
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
    Signal::signed("x", 20, 1e-4, "m"),
    Signal::signed("y", 20, 1e-4, "m"),
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

const AXLE_MOTION: [Signal; 4] = [
    SEQUENCE,
    Signal::signed("velocity", 16, 1e-4, "m/s"),
    Signal::signed("yaw_rate", 16, 1e-3, "rad/s"),
    Signal::unsigned("refused", 8),
];

const fn layout(id: u16, name: &'static str, sender: Node, signals: &'static [Signal]) -> Layout {
    Layout {
        id,
        name,
        sender,
        period_ms: 10,
        timeout_ms: 50,
        signals,
    }
}

/// Every message of the bus.
pub const MESSAGES: [Layout; 14] = [
    layout(
        0x070,
        "LeadStatus",
        Node::Lead,
        &[
            SEQUENCE,
            Signal::unsigned("mode", 8),
            Signal::signed("steering", 16, 1e-4, "rad"),
            Signal::signed("velocity", 16, 1e-4, "m/s"),
        ],
    ),
    layout(0x080, "ReferencePostureFront", Node::Lead, &POSTURE),
    layout(0x081, "ReferencePostureRear", Node::Lead, &POSTURE),
    layout(0x090, "ReferenceMotionFront", Node::Lead, &REFERENCE_MOTION),
    layout(0x091, "ReferenceMotionRear", Node::Lead, &REFERENCE_MOTION),
    layout(0x100, "AxlePostureFront", Node::FrontAxle, &POSTURE),
    layout(0x101, "AxlePostureRear", Node::RearAxle, &POSTURE),
    layout(0x110, "AxleMotionFront", Node::FrontAxle, &AXLE_MOTION),
    layout(0x111, "AxleMotionRear", Node::RearAxle, &AXLE_MOTION),
    layout(0x120, "AxleUncertaintyFront", Node::FrontAxle, &UNCERTAINTY),
    layout(0x121, "AxleUncertaintyRear", Node::RearAxle, &UNCERTAINTY),
    layout(
        0x200,
        "BeamPosture",
        Node::Beam,
        &[
            SEQUENCE,
            Signal::signed("x", 18, 5e-6, "m"),
            Signal::signed("y", 18, 5e-6, "m"),
            Signal::signed("phi", 16, 1e-4, "rad"),
            Signal::unsigned("gauges", 4),
        ],
    ),
    layout(0x201, "BeamUncertainty", Node::Beam, &UNCERTAINTY),
    layout(
        0x202,
        "BeamWrench",
        Node::Beam,
        &[
            SEQUENCE,
            Signal::signed("force_x", 14, 0.05, "N"),
            Signal::signed("force_y", 14, 0.05, "N"),
            Signal::signed("moment_root", 14, 1e-3, "N m"),
            Signal::signed("moment_end", 14, 1e-3, "N m"),
        ],
    ),
];

/// The entry of the table for an identifier.
pub fn find(id: u16) -> Option<&'static Layout> {
    MESSAGES.iter().find(|layout| layout.id == id)
}

/// Bits one frame of `bytes` data bytes takes on the bus in the worst case: 47 of frame overhead
/// and interframe space, and a stuff bit for each four of the stuffed part.
pub const fn frame_bits(bytes: u8) -> u32 {
    let data = 8 * bytes as u32;
    47 + data + (34 + data - 1) / 4
}

/// Worst-case share of the bus all messages of the table take at their periods, 0 to 1.
pub fn load(bit_rate: f32) -> f32 {
    MESSAGES
        .iter()
        .map(|layout| frame_bits(layout.bytes()) as f32 * 1000.0 / f32::from(layout.period_ms))
        .sum::<f32>()
        / bit_rate
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
    fn bus_load_leaves_room() {
        // 135 bits is the textbook worst case of an 8-byte frame with an 11-bit identifier.
        assert_eq!(frame_bits(8), 135);
        let load = load(1e6);
        assert!(load > 0.1 && load < 0.5, "{load}");
    }
}
