//! Bit timing of the chip's CAN controller (RM0090, 32.7.7).
//!
//! A bit consists of a synchronisation segment of one quantum, segment 1 and segment 2; the sample point lies between
//! segments 1 and 2. A resynchronisation lengthens segment 1 or shortens segment 2 by at most the jump width.

/// Time quanta per bit.
const QUANTA: u32 = 14;
/// Quanta after the sample point, which lies at 78.6 % of the bit. The time before the sample point covers the round
/// trip over transceivers and cable.
const SEGMENT_2: u32 = 3;

/// Timing of a bit, in quanta.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BitTiming {
    /// Controller clock periods per quantum, 1 to 1024.
    pub prescaler: u32,
    /// Quanta between the synchronisation segment and the sample point, 1 to 16.
    pub segment_1: u32,
    /// Quanta after the sample point, 1 to 8.
    pub segment_2: u32,
    /// Jump width, quanta, 1 to 4.
    pub jump: u32,
}

impl BitTiming {
    /// Timing for `bit_rate` (bit/s) with the controller clock `clock_hz`; `None` if no prescaler gives that rate
    /// exactly.
    pub const fn new(clock_hz: u32, bit_rate: u32) -> Option<Self> {
        let quantum_rate = bit_rate.saturating_mul(QUANTA);
        if quantum_rate == 0 || !clock_hz.is_multiple_of(quantum_rate) {
            return None;
        }
        let prescaler = clock_hz / quantum_rate;
        if prescaler == 0 || prescaler > 1024 {
            return None;
        }
        Some(Self {
            prescaler,
            segment_1: QUANTA - 1 - SEGMENT_2,
            segment_2: SEGMENT_2,
            // The widest jump that segment 2 allows, for the largest clock tolerance.
            jump: SEGMENT_2,
        })
    }

    /// Register `CAN_BTR`: each field holds its value less one.
    pub const fn register(self) -> u32 {
        (self.jump - 1) << 24
            | (self.segment_2 - 1) << 20
            | (self.segment_1 - 1) << 16
            | (self.prescaler - 1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CLOCK_HZ: u32 = 42_000_000;
    const BIT_RATE: u32 = core_algos::bus::layout::BIT_RATE;

    #[test]
    fn bit_lasts_1_us_and_is_sampled_at_75_to_90_percent() {
        let timing = BitTiming::new(CLOCK_HZ, BIT_RATE).expect("14 quanta fit three times");
        let quantum_ns = 1e9 * f64::from(timing.prescaler) / f64::from(CLOCK_HZ);
        let before_ns = quantum_ns * f64::from(1 + timing.segment_1);
        let bit_ns = before_ns + quantum_ns * f64::from(timing.segment_2);
        assert!((bit_ns - 1000.0).abs() < 1e-9, "{bit_ns}");
        // CiA 301 demands a sample point at 75 to 90 % of the bit.
        assert!(
            (750.0..=900.0).contains(&before_ns),
            "sampled at {before_ns} ns"
        );
    }

    #[test]
    fn clock_tolerance_exceeds_that_of_crystals() {
        let t = BitTiming::new(CLOCK_HZ, BIT_RATE).expect("14 quanta fit three times");
        let quanta = f64::from(1 + t.segment_1 + t.segment_2);
        let (jump, after) = (f64::from(t.jump), f64::from(t.segment_2));
        // ISO 11898-1 limits the clock tolerance twice: over the ten bits between two edges, and over thirteen bits
        // from an error flag to the next sample.
        let tolerance = (jump / (20.0 * quanta)).min(after / (2.0 * (13.0 * quanta - after)));
        assert!(
            tolerance > 0.008,
            "{tolerance}: an internal oscillator would do"
        );
    }

    /// Common bit timing calculators give this value for 42 MHz, 1 Mbit/s and a sample point at 85.7 %.
    #[test]
    fn register_layout_matches_the_reference_manual() {
        let timing = BitTiming {
            prescaler: 3,
            segment_1: 11,
            segment_2: 2,
            jump: 1,
        };
        assert_eq!(timing.register(), 0x001a_0002);
        // The register after a reset is 0x0123_0000: jump 2, segments 4 and 3, prescaler 1.
        let reset = BitTiming {
            prescaler: 1,
            segment_1: 4,
            segment_2: 3,
            jump: 2,
        };
        assert_eq!(reset.register(), 0x0123_0000);
    }

    #[test]
    fn bit_rate_without_exact_prescaler_is_refused() {
        for (clock_hz, bit_rate) in [
            (42_000_000, 0),
            (42_000_000, 800_000),
            (8_000_000, 1_000_000),
            (16_000_000, 1_000_000),
            (0, 1_000_000),
            (42_000_000, u32::MAX),
            (42_000_000 * 100, 125),
        ] {
            assert_eq!(BitTiming::new(clock_hz, bit_rate), None, "{clock_hz}");
        }
        assert!(BitTiming::new(42_000_000, 500_000).is_some());
    }
}
