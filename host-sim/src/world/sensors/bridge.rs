//! Strain bridges: gauges, amplifier and converter.

use super::SAMPLE_PERIOD_S;
use super::converter::ConverterError;
use super::delay::{Delay, Drift, MAX_DELAY_MS};
use crate::base::table::table;
use crate::world::drawn::FrameErrors;
use crate::world::random::SMALL;
use crate::world::random::normal;
use core_algos::beam::{MAX_GAUGES, strip};
use core_algos::config::{Allowed, ConfigError, require};
use rand_pcg::Pcg64;
use std::f64::consts::TAU;
use std::sync::Arc;

table! {
    /// Strain bridges: gauges, amplifier and converter.
    ///
    /// `counts = round(gauge_factor·active_gauges/4·strain·amplifier_gain·2^bits)`, zero at mid-scale
    /// and saturated at ±2^(bits−1). The bridge is fed from the converter's reference, so the supply voltage
    /// cancels. `strain` is the strain of the outer fibre at the gauge's true position, with gain error,
    /// offset, drift and noise, behind the amplifier's low-pass filter.
    pub struct BridgeConfig {
        /// Relative resistance change per strain.
        pub gauge_factor: f64 = 2.1, "": Positive;
        /// Active gauges of the bridge: 1, 2 (one on each face) or 4 (two on each face).
        pub active_gauges: u32 = 4, "": OneOf(&[1.0, 2.0, 4.0]);
        /// Gain of the amplifier.
        pub amplifier_gain: f64 = 60.0, "": Positive;
        /// Corner of the amplifier's first-order low-pass filter.
        pub bandwidth_hz: f64 = 200.0, "Hz": Positive;
        /// Effective bits of the converter over the whole range.
        pub converter_bits: u32 = 14, "": Range(2.0, 24.0);
        /// Noise at the converter as strain, rms at the sample rate.
        pub noise_strain: f64 = 0.7e-6, "strain": NonNegative;
        /// Largest integral nonlinearity of the chip's converter, in counts of its 4096; each frame draws its curve.
        /// STM32F405: 1.5 typically, 3 at most.
        pub nonlinearity_counts: f64 = 0.0, "counts": Range(0.0, 10.0);
        /// Relative standard deviation of each bridge's gain.
        pub gain_sigma: f64 = 3e-3, "": Range(0.0, SMALL);
        /// Relative standard deviation of the gain error common to all bridges, 1 to 2 %. Foil and glue add
        /// 40 to 60 µm to a half thickness of 0.5 mm, alike within a lot, and the strip's thickness is known to 2 %.
        pub common_gain_sigma: f64 = 0.0, "": Range(0.0, SMALL);
        /// Standard deviation of each bridge's unbalance before zeroing.
        pub offset_sigma_strain: f64 = 200e-6, "strain": NonNegative;
        /// Standard deviation of each bridge's change from zeroing to the start of a trial.
        pub drift_sigma_strain: f64 = 1e-6, "strain": NonNegative;
        /// Standard deviation of the error common to all bridges after zeroing: bulge of the edge against which
        /// the frame is held (strain = angle·half thickness/length).
        pub common_sigma_strain: f64 = 1e-6, "strain": NonNegative;
        /// Random walk of each bridge during a trial.
        pub drift_walk_strain: f64 = 0.05e-6, "strain/√s": NonNegative;
        /// Nominal positions of the gauges along the strip, from its root; at most eight.
        pub gauges_m: Vec<f64> = strip::Config::default().gauges_m.iter().map(f64::from).collect(), "m": NonNegative;
        /// Standard deviation of each gauge's position along the strip.
        pub position_sigma_m: f64 = 0.3e-3, "m": NonNegative;
        /// Final share of a sustained strain that a gauge loses by creep of its adhesive and carrier.
        pub creep_share: f64 = 0.0, "": Range(-0.05, 0.05);
        /// Standard deviation of the creep share, which is equal for all gauges of a robot.
        pub creep_sigma: f64 = 0.0, "": Range(0.0, SMALL);
        /// Time constant of the creep.
        pub creep_time_s: f64 = 60.0, "s": Positive;
        /// Final rise of the gauges' temperature since zeroing.
        pub warming_k: f64 = 0.0, "K": Range(-100.0, 100.0);
        /// Time constant of the warming.
        pub warming_time_s: f64 = 600.0, "s": Positive;
        /// Standard deviation of each bridge's zero shift for a rise of 1 K: 0.5 to 1 µε for half bridges.
        pub zero_per_k_sigma_strain: f64 = 0.2e-6, "strain/K": NonNegative;
        /// Relative change of all gains for a rise of 1 K.
        pub gain_per_k: f64 = 1e-4, "1/K": Range(-1e-3, 1e-3);
        /// Distance of the gauges from the strip's neutral axis.
        // Rounded to f32, so that results recorded with an f32 field stay bit-identical.
        pub half_thickness_m: f64 = f64::from(0.5e-3_f32), "m": Positive;
        /// Age of a sample when the board reads it.
        pub delay_ms: u32 = 1, "ms": Range(0.0, MAX_DELAY_MS as f32);
    }
}

impl BridgeConfig {
    /// Checks the range of every value, and the number of gauges.
    pub(super) fn check(&self) -> Result<(), ConfigError> {
        self.check_ranges()?;
        let count = self.gauges_m.len();
        let allowed = Allowed::Condition("1 to 8 positions");
        require(
            (1..=MAX_GAUGES).contains(&count),
            "gauges_m",
            count as f32,
            allowed,
        )
        .map(drop)
    }

    /// Share of the converter's range for a strain of 1 without gain error.
    pub fn range_per_strain(&self) -> f64 {
        self.gauge_factor * f64::from(self.active_gauges) / 4.0 * self.amplifier_gain
    }

    /// Nonlinearity of a drawn frame's converter; `None` for an ideal converter.
    pub fn converter(&self, drawn: &FrameErrors) -> Option<ConverterError> {
        let noise = self.noise_strain * self.range_per_strain();
        ConverterError::new(self.nonlinearity_counts, noise, drawn.converter)
    }

    /// Strain of one count of a bridge without gain error: the board's nominal scale factor.
    pub fn strain_per_count(&self) -> f64 {
        1.0 / (self.range_per_strain() * libm::exp2(f64::from(self.converter_bits)))
    }

    /// Largest magnitude of a count: the converter is saturated there.
    pub fn full_scale_counts(&self) -> i32 {
        1 << (self.converter_bits - 1)
    }

    /// Counts of the bridges of the unbent frame, without noise and quantisation. The board stores these counts as its
    /// calibration.
    pub fn zero_counts(&self, drawn: &FrameErrors) -> [f64; MAX_GAUGES] {
        let limit = f64::from(self.full_scale_counts());
        let converter = self.converter(drawn);
        drawn.bridge_offset.map(|strain| {
            let counts = converted(strain / self.strain_per_count(), limit, converter.as_ref());
            counts.clamp(-limit, limit - 1.0)
        })
    }
}

/// Counts about mid-scale with the converter's error added.
fn converted(counts: f64, limit: f64, converter: Option<&ConverterError>) -> f64 {
    let ratio = 0.5 + 0.5 * counts / limit;
    counts + converter.map_or(0.0, |error| 2.0 * limit * error.at(ratio))
}

/// First-order low-pass filter, exact for an input that is linear between samples.
#[derive(Clone, Debug)]
pub(super) struct LowPass {
    pole: f64,
    weight_old: f64,
    weight_new: f64,
    input: f64,
    output: f64,
    started: bool,
}

impl LowPass {
    pub fn new(bandwidth_hz: f64) -> Self {
        let ratio = TAU * bandwidth_hz * SAMPLE_PERIOD_S;
        let pole = libm::exp(-ratio);
        let weight_new = 1.0 - (1.0 - pole) / ratio;
        Self {
            pole,
            weight_old: 1.0 - pole - weight_new,
            weight_new,
            input: 0.0,
            output: 0.0,
            started: false,
        }
    }

    pub fn pass(&mut self, input: f64) -> f64 {
        if self.started {
            self.output =
                self.pole * self.output + self.weight_old * self.input + self.weight_new * input;
        } else {
            self.output = input;
            self.started = true;
        }
        self.input = input;
        self.output
    }
}

/// Creep and thermal drift of a gauge, each a first-order lag.
#[derive(Clone, Debug)]
pub struct GaugeAgeing {
    creep_share: f64,
    creep_step: f64,
    crept: f64,
    warming: f64,
    warming_step: f64,
    warmth: f64,
    zero_per_k: f64,
    gain_per_k: f64,
}

impl GaugeAgeing {
    /// Unstrained gauge. Its zero shifts by `zero_per_k` (strain) for a rise of 1 K; `creep_error` is its creep beyond
    /// the mean share.
    pub fn new(config: &BridgeConfig, zero_per_k: f64, creep_error: f64) -> Self {
        let step = |time: f64| -libm::expm1(-SAMPLE_PERIOD_S / time);
        Self {
            creep_share: config.creep_share + creep_error,
            creep_step: step(config.creep_time_s),
            crept: 0.0,
            warming: config.warming_k,
            warming_step: step(config.warming_time_s),
            warmth: 0.0,
            zero_per_k,
            gain_per_k: config.gain_per_k,
        }
    }

    /// Measured strain and zero shift of the gauge, 1 ms after the preceding call.
    pub fn next(&mut self, strain: f64) -> [f64; 2] {
        self.crept += self.creep_step * (strain - self.crept);
        self.warmth += self.warming_step * (self.warming - self.warmth);
        let held = strain - self.creep_share * self.crept;
        [
            (1.0 + self.gain_per_k * self.warmth) * held,
            self.zero_per_k * self.warmth,
        ]
    }
}

/// Errors, filter and converter of one bridge.
#[derive(Clone, Debug)]
pub(super) struct Bridge {
    random: Pcg64,
    gain: f64,
    ageing: GaugeAgeing,
    offset: Drift,
    filter: LowPass,
    noise_sigma: f64,
    counts_per_strain: f64,
    limit: f64,
    converter: Option<Arc<ConverterError>>,
    delay: Delay<i32>,
    /// Latest finite strain.
    strain: f64,
}

/// Limit to which strains are clamped, far beyond the range of every bridge.
const MAX_STRAIN: f64 = 1.0;

impl Bridge {
    /// Bridge number `index` of a frame. `creep_error` is the creep of its gauge beyond the mean share; `random` gives
    /// its noise.
    pub fn new(
        config: &BridgeConfig,
        (drawn, creep_error): (&FrameErrors, f64),
        index: usize,
        converter: Option<Arc<ConverterError>>,
        random: Pcg64,
    ) -> Self {
        Self {
            random,
            converter,
            gain: 1.0 + drawn.bridge_gain_error[index],
            ageing: GaugeAgeing::new(config, drawn.bridge_zero_per_k[index], creep_error),
            offset: Drift::new(
                drawn.bridge_offset[index] + drawn.bridge_drift[index],
                config.drift_walk_strain,
            ),
            filter: LowPass::new(config.bandwidth_hz),
            noise_sigma: config.noise_strain,
            counts_per_strain: 1.0 / config.strain_per_count(),
            limit: f64::from(config.full_scale_counts()),
            delay: Delay::new(config.delay_ms),
            strain: 0.0,
        }
    }

    /// Adds `strain` to the zero.
    pub fn drift(&mut self, strain: f64) {
        self.offset.shift(strain);
    }

    /// Counts of a reading 1 ms after the preceding call. A strain that is not finite gives the end of the range, and
    /// leaves filter and ageing of the gauge at the latest finite strain.
    pub fn sample(&mut self, strain: f64) -> i32 {
        let known = strain.is_finite();
        if known {
            self.strain = strain.clamp(-MAX_STRAIN, MAX_STRAIN);
        }
        let offset = self.offset.next(&mut self.random);
        let [strain, moved] = self.ageing.next(self.strain);
        let measured = self.filter.pass(self.gain * strain + (offset + moved));
        let measured = measured + normal(&mut self.random, self.noise_sigma);
        let counts = measured * self.counts_per_strain;
        let counts = converted(counts, self.limit, self.converter.as_deref()).round();
        let counts = if known { counts } else { self.limit };
        self.delay
            .pass(counts.clamp(-self.limit, self.limit - 1.0) as i32)
    }
}
