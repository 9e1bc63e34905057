//! A message's layout: its signals, little-endian and packed without gaps in the order of the table.

use crate::topology::Node;

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
    /// Names of the raw values 0, 1, 2…; no other raw value is valid. Empty for a quantity.
    pub labels: &'static [&'static str],
    /// Meaning of the message field to which the signal belongs.
    pub meaning: &'static str,
}

impl Signal {
    pub(super) const fn unsigned(name: &'static str, bits: u8) -> Self {
        Self {
            name,
            bits,
            signed: false,
            scale: 1.0,
            offset: 0.0,
            unit: "",
            labels: &[],
            meaning: "",
        }
    }

    pub(super) const fn labelled(
        name: &'static str,
        bits: u8,
        labels: &'static [&'static str],
    ) -> Self {
        Self {
            labels,
            ..Self::unsigned(name, bits)
        }
    }

    pub(super) const fn signed(
        name: &'static str,
        bits: u8,
        scale: f32,
        unit: &'static str,
    ) -> Self {
        Self {
            signed: true,
            scale,
            unit,
            ..Self::unsigned(name, bits)
        }
    }

    pub(super) const fn log_sigma(name: &'static str, unit: &'static str) -> Self {
        Self {
            offset: -10.0,
            ..Self::signed(name, 10, 0.02, unit)
        }
    }

    pub(super) const fn in_unit(self, unit: &'static str) -> Self {
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

    /// Physical value of a raw value.
    pub fn physical(&self, raw: i32) -> f32 {
        raw as f32 * self.scale + self.offset
    }

    /// Smallest and largest physical value.
    pub fn range(&self) -> (f32, f32) {
        let (low, high) = self.raw_range();
        (self.physical(low), self.physical(high))
    }
}

/// Kind of a message: one for the robot, or one for each axle, frame, board or node.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Of {
    /// One message for the robot.
    Robot,
    /// One message for each axle.
    Axle,
    /// One message for each frame.
    Frame,
    /// One message for each board.
    Board,
    /// One message for each node that has a status.
    Node,
}

/// Sender of a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sender {
    /// Always this node.
    Node(Node),
    /// Owner of the message: the node of the axle, frame or board, or the node itself.
    Own,
}

/// One message of the bus, or one for each axle, frame, board or node.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layout {
    /// First CAN identifier (11 bits); a lower one wins arbitration.
    pub id: u16,
    /// Name; the bus description appends the owner.
    pub name: &'static str,
    /// Meaning, one sentence.
    pub meaning: &'static str,
    /// Kind of the message.
    pub of: Of,
    /// Sender.
    pub sender: Sender,
    /// Period, ms; 0 if the message is sent only on request.
    pub period_ms: u16,
    /// Timeout: age from which the content is not used, ms; 0 if there is none.
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

/// Bits one frame of `bytes` data bytes takes on the bus in the worst case: 47 of frame overhead
/// and interframe space, and a stuff bit for each four of the stuffed part.
pub const fn frame_bits(bytes: u8) -> u32 {
    let data = 8 * bytes as u32;
    47 + data + (34 + data - 1) / 4
}

impl Layout {
    /// Worst-case load of this message at its period, bit/s; 0 if the message is sent on request.
    pub fn bits_per_second(&self) -> f32 {
        if self.period_ms == 0 {
            return 0.0;
        }
        frame_bits(self.bytes()) as f32 * 1000.0 / f32::from(self.period_ms)
    }
}
