//! Segmentation of link bytes into bus frames of at most eight bytes, so that one serial port reaches every board.
//!
//! | identifier | bytes |
//! |---|---|
//! | 0x700 + axle | requests to the board of an axle |
//! | 0x710 + axle | replies of the board of an axle |
//! | 0x740 + frame | requests to the board of a frame |
//! | 0x750 + frame | replies of the board of a frame |
//!
//! | condition | reaction | reason |
//! |---|---|---|
//! | bytes to or from a board | frames of eight bytes in order, the last with the rest; unused data is 0 | |
//! | identifier of the table | board and direction | |
//! | any other identifier | none | messages are not for the link |
//!
//! These identifiers have lower priority on the bus than every message except the boards' identities, which are sent
//! once a second. A lost frame breaks the checksum of the payload ([`super::framing`]), and the host repeats its
//! request.

use crate::bus::CanFrame;
use crate::topology::{MAX_AXLES, MAX_FRAMES, Role};

/// Direction of a segment, as seen from the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Requests to the board.
    To,
    /// Replies of the board.
    From,
}

/// Board and direction of an identifier; `None` for an identifier outside of the table.
pub fn address(id: u16) -> Option<(Role, Direction)> {
    let number = (id & 0xf) as u8;
    let axle = (usize::from(number) < MAX_AXLES).then_some(Role::axle(number));
    let frame = (usize::from(number) < MAX_FRAMES).then_some(Role::beam(number));
    match id & !0xf {
        0x700 => Some((axle?, Direction::To)),
        0x710 => Some((axle?, Direction::From)),
        0x740 => Some((frame?, Direction::To)),
        0x750 => Some((frame?, Direction::From)),
        _ => None,
    }
}

/// Bus frames that carry `bytes` to or from a board.
pub fn frames(role: Role, direction: Direction, bytes: &[u8]) -> impl Iterator<Item = CanFrame> {
    let id = match (role, direction) {
        (Role::Axle(axle), Direction::To) => 0x700 + u16::from(axle.0),
        (Role::Axle(axle), Direction::From) => 0x710 + u16::from(axle.0),
        (Role::Beam(frame), Direction::To) => 0x740 + u16::from(frame.0),
        (Role::Beam(frame), Direction::From) => 0x750 + u16::from(frame.0),
    };
    bytes.chunks(8).map(move |chunk| {
        let mut data = [0; 8];
        for (slot, &byte) in data.iter_mut().zip(chunk) {
            *slot = byte;
        }
        CanFrame {
            id,
            length: chunk.len() as u8,
            data,
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bus::layout::MESSAGES;
    use crate::link::framing::{Decoder, MAX_PAYLOAD, SerialFrame};
    use crate::topology::Topology;
    use std::vec::Vec;

    #[test]
    fn payload_of_any_length_survives_segmentation() {
        for role in Topology::PAIR.boards() {
            for direction in [Direction::To, Direction::From] {
                for length in 1..=MAX_PAYLOAD {
                    let payload: Vec<u8> = (0..length).map(|i| (i * 7) as u8).collect();
                    let frame = SerialFrame::new(&payload).unwrap();
                    let mut decoder = Decoder::new();
                    let mut found = None;
                    for frame in frames(role, direction, frame.repeated()) {
                        assert_eq!(address(frame.id), Some((role, direction)));
                        for &byte in frame.bytes() {
                            found = found.or(decoder.take_byte(byte).map(<[u8]>::to_vec));
                        }
                    }
                    assert_eq!(found.as_ref(), Some(&payload));
                }
            }
        }
    }

    #[test]
    fn identifier_gives_board_and_direction() {
        for id in 0..0x800u16 {
            let expected = match id {
                0x700..0x705 => Some((Role::axle((id - 0x700) as u8), Direction::To)),
                0x710..0x715 => Some((Role::axle((id - 0x710) as u8), Direction::From)),
                0x740..0x744 => Some((Role::beam((id - 0x740) as u8), Direction::To)),
                0x750..0x754 => Some((Role::beam((id - 0x750) as u8), Direction::From)),
                _ => None,
            };
            assert_eq!(address(id), expected, "{id:#x}");
            if let Some((role, direction)) = expected {
                let frames: Vec<_> = frames(role, direction, &[7; 17]).collect();
                let full = CanFrame {
                    id,
                    length: 8,
                    data: [7; 8],
                };
                let rest = CanFrame {
                    id,
                    length: 1,
                    data: [7, 0, 0, 0, 0, 0, 0, 0],
                };
                assert_eq!(frames, [full, full, rest]);
            }
        }
        assert_eq!(frames(Role::axle(1), Direction::To, &[]).count(), 0);
        assert_eq!(frames(Role::axle(1), Direction::To, &[1; 8]).count(), 1);
    }

    #[test]
    fn link_identifiers_differ_from_message_identifiers() {
        for layout in MESSAGES {
            assert_eq!(address(layout.id), None, "{}", layout.name);
            // A lower identifier has priority. Only the boards' identities, sent once a second, are above 0x700.
            assert!(layout.id < 0x700 || layout.period_ms >= 1000);
        }
    }
}
