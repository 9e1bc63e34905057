//! Crash record in memory that a reset keeps: counts of faults and the last message, with a checksum.
//!
//! After power-on the memory holds random bits, after a reset during a write half a record. The checksum detects
//! both.

use core::fmt::{self, Write};

/// Counts of faults since power-on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(target_os = "none", derive(defmt::Format))]
pub struct Faults {
    /// Number of panics of the program.
    pub panics: u32,
    /// Processor faults, interrupts without a handler, a stopped crystal, a low supply, a watchdog that does not run.
    pub processor: u32,
    /// Number of resets by a watchdog.
    pub watchdog: u32,
    /// Number of stack overflows.
    pub stack: u32,
}

impl Faults {
    /// No faults: all counts are zero.
    pub const NONE: Self = Self {
        panics: 0,
        processor: 0,
        watchdog: 0,
        stack: 0,
    };
}

/// Length limit of a message, bytes; a longer message is cut off.
pub const MAX_BYTES: usize = 160;

/// Marks memory as a record of this layout; each layout has its own value.
const MAGIC: u32 = 0x6661_7533;

/// Text of at most [`MAX_BYTES`] bytes; longer text is cut off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct Text {
    bytes: [u8; MAX_BYTES],
    length: u32,
}

impl Text {
    /// No text.
    pub const EMPTY: Self = Self {
        bytes: [0; MAX_BYTES],
        length: 0,
    };

    /// The text; `None` if the memory holds no valid text.
    pub fn as_str(&self) -> Option<&str> {
        core::str::from_utf8(self.bytes.get(..self.length as usize)?).ok()
    }
}

impl Write for Text {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        let from = self.length as usize;
        let room = MAX_BYTES.saturating_sub(from);
        let fit = text.floor_char_boundary(room);
        let places = self.bytes.iter_mut().skip(from);
        for (place, byte) in places.zip(text.as_bytes().iter().take(fit)) {
            *place = *byte;
        }
        self.length += fit as u32;
        if fit == text.len() {
            Ok(())
        } else {
            Err(fmt::Error)
        }
    }
}

/// Crash record in memory that a reset keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(C)]
pub struct Record {
    magic: u32,
    /// Counts of faults.
    pub faults: Faults,
    /// Message of the last fault.
    pub message: Text,
    sum: u32,
}

impl Record {
    /// A record without faults.
    pub fn new() -> Self {
        Self {
            magic: MAGIC,
            faults: Faults::NONE,
            message: Text::EMPTY,
            sum: 0,
        }
        .sealed()
    }

    /// The record with a correct checksum.
    pub fn sealed(mut self) -> Self {
        self.sum = self.check_sum();
        self
    }

    /// The record, or a new one if the memory holds no valid record.
    pub fn or_new(self) -> Self {
        let sound =
            self.magic == MAGIC && self.sum == self.check_sum() && self.message.as_str().is_some();
        if sound { self } else { Self::new() }
    }

    /// FNV-1a hash of all fields before the checksum.
    fn check_sum(&self) -> u32 {
        let Faults {
            panics,
            processor,
            watchdog,
            stack,
        } = self.faults;
        let length = self.message.length;
        let words = [self.magic, panics, processor, watchdog, stack, length];
        let bytes = words.iter().flat_map(|word| word.to_le_bytes());
        bytes
            .chain(self.message.bytes)
            .fold(0x811c_9dc5, |sum: u32, byte| {
                (sum ^ u32::from(byte)).wrapping_mul(0x0100_0193)
            })
    }
}

impl Default for Record {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record() -> Record {
        let mut record = Record::new();
        record.faults.panics = 3;
        write!(record.message, "panicked at tick.rs:{}", 120).unwrap();
        record.sealed()
    }

    #[test]
    fn valid_record_is_kept_unchanged() {
        let kept = record().or_new();
        assert_eq!(kept, record());
        assert_eq!(kept.message.as_str(), Some("panicked at tick.rs:120"));
    }

    /// A record with one bit changed anywhere, and memory filled with one pattern, are rejected.
    #[test]
    fn record_with_a_changed_bit_is_replaced_by_a_new_one() {
        const SIZE: usize = size_of::<Record>();
        // SAFETY: a record consists of integers and arrays of integers without gaps, so any bytes are a valid value.
        let to_bytes =
            |record: Record| unsafe { core::mem::transmute::<Record, [u8; SIZE]>(record) };
        // SAFETY: any bytes are a valid record, because a record consists of integers and arrays of integers.
        let from_bytes = |bytes| unsafe { core::mem::transmute::<[u8; SIZE], Record>(bytes) };
        for bit in 0..8 * SIZE {
            let mut bytes = to_bytes(record());
            bytes[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(from_bytes(bytes).or_new(), Record::new(), "bit {bit}");
        }
        for pattern in [0x00, 0xff, 0x55, 0xaa] {
            assert_eq!(from_bytes([pattern; SIZE]).or_new(), Record::new());
        }
    }

    #[test]
    fn long_message_is_cut_at_a_character_boundary() {
        let mut text = Text::EMPTY;
        let long = "µ".repeat(MAX_BYTES);
        assert!(write!(text, "a{long}").is_err());
        let kept = text.as_str().unwrap();
        assert_eq!(kept.len(), MAX_BYTES - 1);
        assert!(kept.starts_with("aµ") && kept.ends_with('µ'));
        assert!(write!(text, "b").is_ok() && write!(text, "c").is_err());
    }
}
