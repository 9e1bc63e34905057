//! Seeded random streams.
//!
//! A stream depends on (seed, trial, stream) only, and every sensor has its own stream. Trials of equal number have
//! the same errors and the same noise, whatever sensors are fitted: common random numbers for comparison in pairs.

use super::normal::standard_normal;
use rand::SeedableRng;
use rand_pcg::Pcg64;

/// Random stream. Its number is part of the generator's seed and must never change.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stream {
    /// Wheel radii and tracks.
    Geometry,
    /// Placement of the robot.
    Placement,
    /// Phases of the encoders.
    Encoder,
    /// Gyro of an axle, 0 at the front.
    Gyro(usize),
    /// Accelerometer of an axle, 0 at the front.
    Accelerometer(usize),
    /// A strain bridge, by frame and gauge.
    Bridge(usize, usize),
    /// Errors common to the bridges of a frame, front frame first.
    BridgeCommon,
    /// The plant's constants.
    Plant,
    /// Errors common to all bridges of a robot.
    BridgeMakeup,
    /// Nonlinearity of each frame's converter, front frame first.
    Converter,
    /// Any further stream, for users of this module.
    Other(u64),
}

impl Stream {
    fn number(self) -> u64 {
        match self {
            Self::Geometry => 1,
            Self::Placement => 2,
            Self::Encoder => 3,
            Self::BridgeCommon => 4,
            Self::Plant => 5,
            Self::BridgeMakeup => 6,
            Self::Converter => 7,
            Self::Gyro(axle) => 0x100 + axle as u64,
            Self::Accelerometer(axle) => 0x200 + axle as u64,
            Self::Bridge(frame, index) => 0x300 + (0x10 * frame + index) as u64,
            Self::Other(number) => (1 << 32) + number,
        }
    }
}

/// Generator of one stream of one trial.
///
/// The three numbers are hashed into the whole state (SplitMix64 finaliser), since generators of
/// this family that differ in their increment alone are correlated.
pub fn generator(seed: u64, trial: u64, stream: Stream) -> Pcg64 {
    let mut state = 0;
    for word in [seed, trial, stream.number()] {
        state = mix(state ^ word);
    }
    let mut bytes = [0; 32];
    for chunk in bytes.chunks_exact_mut(8) {
        state = mix(state);
        chunk.copy_from_slice(&state.to_le_bytes());
    }
    Pcg64::from_seed(bytes)
}

/// One step of SplitMix64: a bijection of 64 bits in which each bit of the input moves half of
/// the output's bits.
pub(super) fn mix(state: u64) -> u64 {
    let z = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Bound of a constant's draw, standard deviations: one unbounded draw in two million lies beyond.
pub const BOUND: f64 = 5.0;
/// Largest allowed relative standard deviation: a draw ten standard deviations below the mean still gives a positive
/// factor.
pub const SMALL: f32 = 0.09;

/// [`normal`], limited to [`BOUND`] standard deviations: for constants with an allowed range.
pub fn bounded(generator: &mut Pcg64, sigma: f64) -> f64 {
    let bound = BOUND * sigma;
    normal(generator, sigma).clamp(-bound, bound)
}

/// A draw from the normal distribution of mean 0 and the given standard deviation.
pub fn normal(generator: &mut Pcg64, sigma: f64) -> f64 {
    sigma * standard_normal(generator)
}
