//! Layout of a message: identifier, sender, period, timeout and signals.
//!
//! Signals are little-endian, packed without gaps in the order of the table; the physical value is
//! `raw · scale + offset`, and the range follows from width and scale. Defaults of timeouts elsewhere are taken
//! from [`timeout_s`].

pub use super::message::{MESSAGES, id};
pub use super::signal::{Layout, Signal, frame_bits};

/// Bit rate of the bus, bit/s.
pub const BIT_RATE: u32 = 1_000_000;

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

    /// The bytes of the 24-bit hash, whose vectors are published, fold to the check number.
    #[test]
    fn schema_is_the_hash_of_the_table() {
        let mut bytes = Vec::new();
        for layout in &MESSAGES {
            bytes.extend(u32::from(layout.id).to_le_bytes());
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
        let load = load(BIT_RATE as f32);
        assert!(load > 0.1 && load < 0.5, "{load}");
    }
}
