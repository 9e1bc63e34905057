//! Properties that differ from chip to chip.

use super::transfer;
use crate::time::Time;

characteristics! {
    /// Properties of a chip and its crystal; typical by default.
    pub struct ChipVariation {
        /// Frequency of the crystal, Hz.
        pub crystal_hz: u64 = 8_000_000;
        /// Time from enabling the crystal to a stable clock (data sheet: 2 ms typically at 8 MHz).
        pub crystal_start: Time = Time::from_micros(2_000);
        /// Frequency of the fast internal oscillator, Hz (data sheet: 16 MHz ± 1 % at 25 °C, − 8 to + 4.5 % over
        /// all temperatures).
        pub internal_hz: u64 = 16_000_000;
        /// Frequency of the slow internal oscillator, Hz (data sheet: 17 to 47 kHz).
        pub slow_hz: u64 = 32_000;
        /// Brown-out level in the option bytes, as written by a flasher: 0 is the highest level, 3 is none.
        pub brown_out: u32 = 3;
        /// Noise of the analogue converter, counts rms.
        pub converter_noise: f64 = transfer::NOISE;
        /// Largest integral nonlinearity of the converter, counts (data sheet: 1.5 typically, 3 at most).
        pub converter_nonlinearity: f64 = 0.0;
        /// Seed of the nonlinearity curve.
        pub converter_seed: u64 = 1;
        /// Seed of the unique identifier, of the memory content after power-on, of the flash content after an
        /// interrupted operation, and of the converter's noise.
        pub seed: u64 = 1;
    }
}

impl ChipVariation {
    /// Duration of `periods` periods of the slow oscillator.
    pub(crate) fn slow(&self, periods: u64) -> Time {
        let picoseconds = u128::from(periods) * 1_000_000_000_000 / u128::from(self.slow_hz.max(1));
        Time(picoseconds as u64)
    }
}

/// Pseudo-random numbers (xorshift), reproducible by seed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        // The state is never zero, and adjacent seeds are spread far apart.
        Self((seed ^ 0x9e37_79b9_7f4a_7c15).wrapping_mul(0xbf58_476d_1ce4_e5b9) | 1)
    }

    pub fn next(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }
}
