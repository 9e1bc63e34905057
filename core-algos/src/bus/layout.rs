//! Layout of a message: identifier, sender, period, timeout and signals.
//!
//! Signals are little-endian, packed without gaps in the order of the table; the physical value is
//! `raw · scale + offset`, and the range follows from width and scale. Default timeouts of the nodes come from
//! [`timeout_s`].

pub use super::message::{MESSAGES, id};
pub use super::signal::{Layout, Of, Sender, Signal, frame_bits};

use super::message::Placed;
use crate::topology::{AxleId, FrameId, Node, Role, Topology};
use core::fmt;

/// Bit rate of the bus, bit/s.
pub const BIT_RATE: u32 = 1_000_000;

/// Message on the bus of a robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OnBus {
    /// CAN identifier (11 bits).
    pub id: u16,
    /// Layout of the message.
    pub layout: &'static Layout,
    /// Node that sends the message.
    pub sender: Node,
    /// Number of periods of the layout between two messages.
    spacing: u16,
    /// Suffix of the name: axle, frame, board or node; empty for a message of the robot.
    suffix: &'static str,
}

/// Epochs between two uncertainties of a board. From four axles on, an uncertainty in each epoch would load the bus by
/// up to 67 %.
pub const fn uncertainty_epochs(topology: Topology) -> u8 {
    match topology.axle_count() {
        ..4 => 1,
        _ => 5,
    }
}

/// True in the epochs in which a board sends its uncertainty. The boards, by number of axle or frame, take turns.
pub const fn is_uncertainty_due(epochs: u8, sequence: u8, number: u8) -> bool {
    epochs <= 1 || sequence.wrapping_add(number).is_multiple_of(epochs)
}

impl OnBus {
    /// Period, ms; 0 if the message is sent only on request.
    pub const fn period_ms(&self) -> u16 {
        self.layout.period_ms * self.spacing
    }

    /// Age from which the content is not used, ms; 0 if there is none.
    pub const fn timeout_ms(&self) -> u16 {
        self.layout.timeout_ms * self.spacing
    }

    /// Worst-case load of the message, bit/s; 0 if the message is sent on request.
    pub fn bits_per_second(&self) -> f32 {
        self.layout.bits_per_second() / f32::from(self.spacing)
    }
}

impl fmt::Display for OnBus {
    /// Writes the name of the message in the bus description.
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "{}{}", self.layout.name, self.suffix)
    }
}

/// Node that owns the message `offset` above the first identifier of its kind; `None` for a message of the robot and
/// for an unknown offset.
fn owner(of: Of, offset: u16) -> Option<Node> {
    match of {
        Of::Robot => None,
        Of::Axle => AxleId::at(offset).map(Node::Axle),
        Of::Frame => FrameId::at(offset).map(Node::Beam),
        Of::Board => Some(match Role::at(offset)? {
            Role::Axle(axle) => Node::Axle(axle),
            Role::Beam(frame) => Node::Beam(frame),
        }),
        Of::Node => Node::at(offset),
    }
}

/// The messages on the bus of a robot, in the order of their identifiers.
pub fn messages(topology: Topology) -> impl Iterator<Item = OnBus> {
    MESSAGES.iter().flat_map(move |layout| {
        // The boards of frames have the largest offsets, below 0x20.
        (0..0x20).filter_map(move |offset| on_bus(topology, layout, offset))
    })
}

/// Message `offset` above the first identifier of `layout`; `None` if the robot has no such message.
fn on_bus(topology: Topology, layout: &'static Layout, offset: u16) -> Option<OnBus> {
    let owner = match layout.of {
        Of::Robot if offset > 0 => return None,
        Of::Robot => None,
        of => Some(owner(of, offset)?),
    };
    if owner.is_some_and(|owner| topology.nodes().all(|node| node != owner)) {
        return None;
    }
    Some(OnBus {
        id: layout.id + offset,
        layout,
        sender: match (layout.sender, owner) {
            (Sender::Node(node), _) => node,
            (Sender::Own, owner) => owner?,
        },
        spacing: match layout.id {
            id::AXLE_UNCERTAINTY | id::BEAM_UNCERTAINTY => uncertainty_epochs(topology).into(),
            _ => 1,
        },
        suffix: owner.map_or("", |owner| suffix(topology, layout.of, owner)),
    })
}

/// Suffix of a message's name: the axle, frame, board or node that `owner` stands for.
fn suffix(topology: Topology, of: Of, owner: Node) -> &'static str {
    let name = topology.node_name(owner);
    match (of, owner) {
        (Of::Frame, _) => name.strip_prefix("Beam").unwrap_or_default(),
        (Of::Axle | Of::Board, Node::Axle(_)) => name.strip_suffix("Axle").unwrap_or(name),
        _ => name,
    }
}

/// Check number (FNV-1a) of the messages of two axles: identifiers, and the signals' widths, signs, scales and offsets.
pub fn schema() -> u8 {
    let mut sum = 0x811c_9dc5_u32;
    let mut add = |word: u32| {
        for byte in word.to_le_bytes() {
            sum = (sum ^ u32::from(byte)).wrapping_mul(0x0100_0193);
        }
    };
    for OnBus { id, layout, .. } in messages(Topology::PAIR) {
        add(id.into());
        for signal in layout.signals {
            add(u32::from(signal.bits) << 1 | u32::from(signal.signed));
            add(signal.scale.to_bits());
            add(signal.offset.to_bits());
        }
    }
    (sum ^ sum >> 8 ^ sum >> 16 ^ sum >> 24) as u8
}

/// Layout of the message with this identifier; `None` if no message has the identifier.
pub fn find(id: u16) -> Option<&'static Layout> {
    MESSAGES.iter().find(|layout| {
        id.checked_sub(layout.id)
            .is_some_and(|offset| match layout.of {
                Of::Robot => offset == 0,
                of => owner(of, offset).is_some(),
            })
    })
}

/// Sender of the message with this identifier; `None` if no message has the identifier.
pub fn sender(id: u16) -> Option<Node> {
    let layout = find(id)?;
    match layout.sender {
        Sender::Node(node) => Some(node),
        Sender::Own => owner(layout.of, id - layout.id),
    }
}

/// Timeout of the message with this first identifier, ms; 0 if the message has no timeout or does not exist.
pub const fn timeout_ms(id: u16) -> u16 {
    let mut i = 0;
    while i < MESSAGES.len() {
        if MESSAGES[i].id == id {
            return MESSAGES[i].timeout_ms;
        }
        i += 1;
    }
    0
}

/// Timeout of the message with this first identifier, s; 0 if the message has no timeout or does not exist.
pub const fn timeout_s(id: u16) -> f32 {
    timeout_ms(id) as f32 / 1000.0
}

/// Worst-case bus load of all periodic messages of a robot, 0 to 1.
pub fn load(topology: Topology, bit_rate: f32) -> f32 {
    let bits = messages(topology).map(|message| message.bits_per_second());
    bits.sum::<f32>() / bit_rate
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
        for axles in 2..=5 {
            let robot = Topology::new(axles).unwrap();
            let ids: Vec<u16> = messages(robot).map(|message| message.id).collect();
            assert!(ids.is_sorted_by(|a, b| a < b), "{ids:x?}");
            for OnBus {
                id,
                layout,
                sender: node,
                ..
            } in messages(robot)
            {
                assert_eq!((find(id), sender(id)), (Some(layout), Some(node)));
            }
        }
        // Three axles: a message for each, two frames, five boards, six nodes.
        let names: Vec<String> = messages(Topology::new(3).unwrap())
            .map(|message| message.to_string())
            .collect();
        for name in [
            "AxleMotionAxle2",
            "BeamWrench2",
            "BoardHealthRear",
            "BoardHealthBeam1",
            "NodeStatusLead",
        ] {
            assert!(names.iter().any(|found| found == name), "{name}: {names:?}");
        }
        assert_eq!(names.len(), 2 + 5 * 3 + 5 * 2 + 2 * 5 + 6);
    }

    #[test]
    fn periods_are_whole_epochs_and_timeouts_at_least_five_periods() {
        use crate::time::EPOCH;
        for layout in MESSAGES {
            let periodic = u64::from(layout.period_ms) * 1000;
            assert!(periodic.is_multiple_of(EPOCH), "{}", layout.name);
            assert!(layout.timeout_ms >= 5 * layout.period_ms, "{}", layout.name);
        }
        assert_eq!(timeout_s(id::AXLE_POSTURE), 0.05);
        // The axle node uses one timeout for mode and references.
        for id in [id::LEAD_STATUS, id::REFERENCE_POSTURE, id::REFERENCE_MOTION] {
            assert_eq!(timeout_s(id), 0.06);
        }
    }

    /// The check number is folded from the 24-bit hash, which another test compares with published vectors.
    #[test]
    fn schema_is_the_hash_of_the_table() {
        let mut bytes = Vec::new();
        for OnBus { id, layout, .. } in messages(Topology::PAIR) {
            bytes.extend(u32::from(id).to_le_bytes());
            for signal in layout.signals {
                let form = 2 * u32::from(signal.bits) + u32::from(signal.signed);
                bytes.extend(form.to_le_bytes());
                bytes.extend([signal.scale, signal.offset].map(f32::to_le_bytes).concat());
            }
        }
        let [low, middle, high, _] = crate::bus::field::Hash24::of(&bytes).0.to_le_bytes();
        assert_eq!(schema(), low ^ middle ^ high);
    }

    #[test]
    fn bus_load_leaves_room() {
        // Textbook worst cases of frames with an 11-bit identifier: 55 bits, and 10 for each byte of data.
        for bytes in 0..=8 {
            assert_eq!(frame_bits(bytes), 55 + 10 * u32::from(bytes));
        }
        for (id, bits) in [
            (id::TIME_SYNC, 11_500.0),
            (id::BOARD_IDENTITY, 135.0),
            (id::BEAM_CALIBRATION, 0.0),
        ] {
            assert_eq!(find(id).unwrap().bits_per_second(), bits);
        }
        let load = load(Topology::PAIR, BIT_RATE as f32);
        assert!(load > 0.1 && load < 0.5, "{load}");
        // Share of a bus with 2 to 5 axles, from the periods and lengths of all messages, %.
        let loads = [2, 3, 4, 5].map(|axles| {
            let robot = Topology::new(axles).unwrap();
            (100.0 * self::load(robot, BIT_RATE as f32)).round()
        });
        assert_eq!(loads, [26.0, 39.0, 46.0, 57.0]);
    }
}
