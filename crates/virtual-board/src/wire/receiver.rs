//! Parser of an incoming frame, bit by bit.

use super::frame::{Frame, Id, crc_step};
use super::node::ErrorKind;

/// Meaning of a bit for a receiver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum ReceiverStep {
    /// The bit has no special meaning; the frame continues.
    More,
    /// The checksum is complete and correct: the bit after the next one acknowledges.
    Acknowledge,
    /// The frame is valid for a receiver: last but one bit of the end of frame.
    Valid,
    /// Last bit of the end of frame.
    End,
    /// Dominant last bit of the end of frame: no error, but an overload frame follows.
    Overload,
    /// An error, to be signalled from the next bit on.
    Error(ErrorKind),
}

/// Bits from the start of frame to the data field, for both identifier lengths.
const STANDARD: u16 = 19;
const EXTENDED: u16 = 39;

/// A frame being received.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Receiver {
    run: u8,
    last: bool,
    /// Number of bits received so far, without stuff bits.
    count: u16,
    /// Number of bits up to the end of the checksum, without stuff bits; `None` until the length code has arrived.
    total: Option<u16>,
    crc: u16,
    identifier: u32,
    extended: bool,
    remote: bool,
    code: u8,
    data: u64,
    /// Number of bits received since the end of the checksum.
    tail: u8,
}

impl Receiver {
    /// Number of bits received so far, without stuff bits.
    pub fn count(&self) -> u16 {
        self.count
    }

    pub fn frame(&self) -> Frame {
        let id = if self.extended {
            Id::Extended(self.identifier)
        } else {
            Id::Standard(self.identifier as u16)
        };
        let bytes = 8 * u32::from(self.code.min(8));
        let data = if bytes == 0 || self.remote {
            0
        } else {
            self.data << (64 - bytes)
        };
        Frame::raw(id, self.remote, self.code, data.to_be_bytes())
    }

    /// Takes the next bit.
    pub fn step(&mut self, dominant: bool) -> ReceiverStep {
        if self.total == Some(self.count) && self.run != 5 {
            return self.tail(dominant);
        }
        if self.run == 5 {
            if dominant == self.last {
                return ReceiverStep::Error(ErrorKind::Stuff);
            }
            (self.run, self.last) = (1, dominant);
            return ReceiverStep::More;
        }
        self.run = if self.run > 0 && dominant == self.last {
            self.run + 1
        } else {
            1
        };
        self.last = dominant;
        self.crc = crc_step(self.crc, !dominant);
        self.field(!dominant);
        self.count += 1;
        ReceiverStep::More
    }

    fn field(&mut self, bit: bool) {
        let value = u32::from(bit);
        let head = if self.extended { EXTENDED } else { STANDARD };
        match self.count {
            0 => {}
            1..=11 => self.identifier = self.identifier << 1 | value,
            12 => self.remote = bit,
            13 => self.extended = bit,
            14..=31 if self.extended => self.identifier = self.identifier << 1 | value,
            32 if self.extended => self.remote = bit,
            // The bits of the checksum carry no data.
            n if self.total.is_some_and(|total| n >= total - 15) => {}
            n if n >= head => self.data = self.data << 1 | u64::from(bit),
            n if n >= head - 4 => {
                self.code = self.code << 1 | bit as u8;
                if n == head - 1 {
                    let bytes = if self.remote { 0 } else { self.code.min(8) };
                    self.total = Some(head + 8 * u16::from(bytes) + 15);
                }
            }
            _ => {}
        }
    }

    fn tail(&mut self, dominant: bool) -> ReceiverStep {
        self.tail += 1;
        self.run = 0;
        match self.tail {
            1 if dominant => ReceiverStep::Error(ErrorKind::Form),
            1 if self.crc == 0 => ReceiverStep::Acknowledge,
            1 | 2 => ReceiverStep::More,
            3 if dominant => ReceiverStep::Error(ErrorKind::Form),
            3 if self.crc != 0 => ReceiverStep::Error(ErrorKind::Crc),
            10 if dominant => ReceiverStep::Overload,
            10 => ReceiverStep::End,
            _ if dominant => ReceiverStep::Error(ErrorKind::Form),
            9 => ReceiverStep::Valid,
            _ => ReceiverStep::More,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn receive(bits: impl Iterator<Item = bool>) -> (Vec<ReceiverStep>, Receiver) {
        let mut receiver = Receiver::default();
        let steps = bits.map(|recessive| receiver.step(!recessive)).collect();
        (steps, receiver)
    }

    #[test]
    fn received_frame_equals_the_sent_frame() {
        let frames = [
            Frame::new(Id::Standard(0), &[0; 8]),
            Frame::new(Id::Standard(0x7ff), &[0xff; 8]),
            Frame::new(Id::Standard(0x123), &[1, 2, 3]),
            Frame::new(Id::Extended(0x1fff_ffff), &[0x1f, 0x07, 0xe0]),
            Frame::remote(Id::Extended(0x0012_3456), 5),
            Frame::remote(Id::Standard(0x321), 0),
            Frame::raw(Id::Standard(0x10), false, 13, [9; 8]),
        ];
        for frame in frames {
            let bits = frame.bits();
            let (steps, receiver) = receive(bits.iter());
            assert_eq!(receiver.frame(), frame);
            let n = bits.length();
            assert_eq!(steps[n - 1], ReceiverStep::End);
            assert_eq!(steps[n - 2], ReceiverStep::Valid);
            assert_eq!(steps[n - 10], ReceiverStep::Acknowledge);
            assert_eq!(
                steps.iter().filter(|&&s| s != ReceiverStep::More).count(),
                3
            );
        }
    }

    #[test]
    fn single_bit_flip_is_an_error_except_in_the_acknowledgement_and_last_bit() {
        let frame = Frame::new(Id::Standard(0x2a5), &[0x12, 0x34, 0x5f]);
        let bits = frame.bits();
        let n = bits.length();
        for flipped in 1..n {
            let line = (0..n + 40).map(|i| (i >= n || bits.recessive(i)) != (i == flipped));
            let (steps, _) = receive(line.take(n.max(flipped + 1)));
            let error = steps.iter().any(|s| matches!(s, ReceiverStep::Error(_)));
            let valid = steps.contains(&ReceiverStep::Valid);
            // Either level is valid in the acknowledgement slot and in the last bit.
            let harmless = flipped == n - 9 || flipped == n - 1;
            assert_eq!(valid && !error, harmless, "bit {flipped}");
        }
    }
}
