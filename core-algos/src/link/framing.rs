//! Frames in a byte stream: payload and checksum, byte-stuffed (COBS) so that 0 is the delimiter.
//!
//! ```text
//! payload (at most 248 bytes) | CRC-32C, little-endian (4)   → COBS (+1) → 0
//! ```
//!
//! CRC-32C detects every error of up to five bits and every burst of up to 32 bits in a payload of this length. Other
//! damage passes with a probability of 2⁻³². One error in the stuffing can cause many errors in the payload, so 2⁻³²
//! applies: of a million damaged frames 2.3·10⁻⁴ are expected to pass.
//!
//! | condition | reaction | reason |
//! |---|---|---|
//! | payload of 1 to 248 bytes | frame, 6 bytes longer | |
//! | payload empty or longer | no frame | |
//! | 0 after valid stuffing with a payload and its checksum | payload; counted as received | |
//! | 0 after other bytes, or after more than 255 | no payload; counted as one damaged frame | |
//! | 0 without bytes before it | ignored, not counted | a repeated frame begins with a 0 |
//! | next byte after a 0 | a new frame begins | damage ends with its frame |
//!
//! A payload has at least one byte: the checksum of no bytes is 0, which noise matches too easily.
//!
//! A repeated frame begins with a 0. This delimiter ends the rest of a truncated frame, which then does not damage the
//! repetition.

use crc::{CRC_32_ISCSI, Crc};

/// Largest payload, bytes.
pub const MAX_PAYLOAD: usize = 248;
/// Largest frame, bytes, with a 0 at both ends.
pub const MAX_FRAME: usize = MAX_PAYLOAD + CRC_BYTES + 3;

const CRC_BYTES: usize = 4;
const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISCSI);

/// CRC-32C of `bytes`.
pub fn crc32c(bytes: &[u8]) -> u32 {
    CRC.checksum(bytes)
}

/// One frame, ready to be sent.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SerialFrame(heapless::Vec<u8, MAX_FRAME>);

impl SerialFrame {
    /// The frame of a payload; `None` if the payload is empty or longer than [`MAX_PAYLOAD`].
    pub fn new(payload: &[u8]) -> Option<Self> {
        if payload.is_empty() {
            return None;
        }
        let mut checked = [0; MAX_PAYLOAD + CRC_BYTES];
        let (head, tail) = checked
            .get_mut(..payload.len() + CRC_BYTES)?
            .split_at_mut_checked(payload.len())?;
        head.copy_from_slice(payload);
        tail.copy_from_slice(&crc32c(payload).to_le_bytes());
        let mut frame = heapless::Vec::from_array([0; MAX_FRAME]);
        let room = frame.get_mut(1..MAX_FRAME - 1)?;
        let stuffed = cobs::try_encode(checked.get(..payload.len() + CRC_BYTES)?, room).ok()?;
        frame.truncate(stuffed + 2);
        // The encoder writes no delimiter.
        *frame.last_mut()? = 0;
        Some(Self(frame))
    }

    /// The bytes to send.
    pub fn bytes(&self) -> &[u8] {
        self.0.get(1..).unwrap_or_default()
    }

    /// The bytes to send if the frame is a repetition; they begin with a 0.
    pub fn repeated(&self) -> &[u8] {
        &self.0
    }
}

/// Counters of a decoder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Counters {
    /// Frames with a correct checksum.
    pub received: u32,
    /// Damaged frames: too long, invalid stuffing or wrong checksum.
    pub damaged: u32,
}

/// Finds frames in a stream.
#[derive(Clone, Copy, Debug)]
pub struct Decoder {
    bytes: [u8; MAX_FRAME],
    length: usize,
    counters: Counters,
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Decoder {
    /// A decoder at the beginning of a frame.
    pub const fn new() -> Self {
        Self {
            bytes: [0; MAX_FRAME],
            length: 0,
            counters: Counters {
                received: 0,
                damaged: 0,
            },
        }
    }

    /// Numbers of received and damaged frames.
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// Takes the next byte; returns the payload if the byte ends a valid frame.
    pub fn take_byte(&mut self, byte: u8) -> Option<&[u8]> {
        if byte != 0 {
            // Bytes beyond the buffer are only counted.
            if let Some(slot) = self.bytes.get_mut(self.length) {
                *slot = byte;
            }
            self.length = self.length.saturating_add(1);
            return None;
        }
        let length = core::mem::take(&mut self.length);
        if length == 0 {
            return None;
        }
        let payload = self.bytes.get_mut(..length).and_then(check);
        match &payload {
            Some(_) => self.counters.received = self.counters.received.wrapping_add(1),
            None => self.counters.damaged = self.counters.damaged.wrapping_add(1),
        }
        payload
    }
}

/// Decodes a stuffed frame in place; returns its payload if the checksum is correct.
fn check(stuffed: &mut [u8]) -> Option<&[u8]> {
    let length = cobs::decode_in_place(stuffed).ok()?;
    let (payload, sum) = stuffed
        .get(..length)?
        .split_at_checked(length.checked_sub(CRC_BYTES)?)?;
    let good = !payload.is_empty() && crc32c(payload).to_le_bytes() == sum;
    good.then_some(payload)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn decode(decoder: &mut Decoder, bytes: &[u8]) -> Vec<Vec<u8>> {
        let pushed = bytes
            .iter()
            .filter_map(|&byte| decoder.take_byte(byte).map(<[u8]>::to_vec));
        pushed.collect()
    }

    #[test]
    fn check_sum_is_crc_32c() {
        // Check value that the specification of the CRC gives for these digits.
        assert_eq!(crc32c(b"123456789"), 0xe306_9283);
    }

    #[test]
    fn frame_adds_six_bytes_and_contains_zero_only_at_its_ends() {
        for length in [1, 9, MAX_PAYLOAD] {
            for fill in [0, 1, 255] {
                let frame = SerialFrame::new(&vec![fill; length]).unwrap();
                let (end, inner) = frame.bytes().split_last().unwrap();
                assert_eq!((*end, inner.contains(&0)), (0, false));
                assert_eq!(frame.bytes().len(), length + 6);
                assert_eq!(frame.repeated(), [&[0], frame.bytes()].concat());
                let found = decode(&mut Decoder::new(), frame.repeated());
                assert_eq!(found, [vec![fill; length]]);
            }
        }
        assert!(SerialFrame::new(&[0; MAX_PAYLOAD + 1]).is_none());
        assert!(SerialFrame::new(&[]).is_none());
    }

    #[test]
    fn stream_with_damaged_byte_recovers_within_one_frame() {
        let payloads: Vec<Vec<u8>> = (0..4u8).map(|i| vec![i, 0, i, 77, 0]).collect();
        let frames: Vec<SerialFrame> = payloads
            .iter()
            .map(|p| SerialFrame::new(p).unwrap())
            .collect();
        let length = frames[1].bytes().len();
        for place in 0..length {
            for damage in 0..3 {
                let mut second = frames[1].bytes().to_vec();
                match damage {
                    0 => second[place] ^= 0x41,
                    1 => drop(second.remove(place)),
                    _ => second.insert(place, 0),
                }
                let rest = [frames[2].bytes(), frames[3].bytes()].concat();
                let mut decoder = Decoder::new();
                let found = decode(&mut decoder, &[frames[0].bytes(), &second, &rest].concat());
                assert_eq!(found.first(), Some(&payloads[0]));
                assert_eq!(found.last(), Some(&payloads[3]));
                // A lost delimiter damages the next frame too, unless that frame begins with a 0.
                let end_lost = place + 1 == length && damage < 2;
                let empty = damage == 2 && (place == 0 || place + 1 == length);
                assert_eq!(found.contains(&payloads[2]), !end_lost, "{place} {damage}");
                assert_eq!(found.contains(&payloads[1]), empty, "{place} {damage}");
                assert!(decoder.counters().damaged >= u32::from(!empty));
                let again = decode(
                    &mut Decoder::new(),
                    &[&second, frames[2].repeated()].concat(),
                );
                assert!(again.contains(&payloads[2]));
            }
        }
    }

    #[test]
    fn each_frame_is_counted_once_as_received_or_damaged() {
        let good = SerialFrame::new(&[5, 0, 6]).unwrap();
        let mut wrong_sum = good.bytes().to_vec();
        wrong_sum[1] ^= 1;
        // A frame that fills the decoder's buffer, and one byte more.
        let payload: Vec<u8> = (1..=250).collect();
        let checked = [&payload[..], &crc32c(&payload).to_le_bytes()].concat();
        let mut room = [0; 300];
        let used = cobs::try_encode(&checked, &mut room).unwrap();
        let mut too_long = room[..MAX_FRAME.min(used)].to_vec();
        too_long.extend_from_slice(&[1, 0]);
        let mut decoder = Decoder::new();
        let mut expected = Counters::default();
        for (bytes, received, damaged) in [
            (good.bytes(), 1, 0),
            (good.repeated(), 1, 0),
            (&wrong_sum, 0, 1),
            (&wrong_sum, 0, 1),
            (good.bytes(), 1, 0),
            (&[0, 0, 0], 0, 0),
            (&[9, 0], 0, 1),
            // Correct checksum of an empty payload.
            (&[1, 1, 1, 1, 1, 0], 0, 1),
            (&[7; 2550], 0, 0),
            (&[0], 0, 1),
            (&too_long, 0, 1),
            (good.bytes(), 1, 0),
        ] {
            expected.received += received;
            expected.damaged += damaged;
            assert_eq!(decode(&mut decoder, bytes).len(), received as usize);
            assert_eq!(decoder.counters(), expected, "{bytes:?}");
        }
    }

    properties! {
        #[test]
        fn payload_survives_framing(payload in prop::collection::vec(any::<u8>(), 1..=MAX_PAYLOAD)) {
            let frame = SerialFrame::new(&payload).unwrap();
            prop_assert_eq!(decode(&mut Decoder::new(), frame.bytes()), [payload]);
        }
    }
}
