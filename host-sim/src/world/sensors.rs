//! Sensor models: from the state of the plant to the samples a board reads.
//!
//! [`TrialImperfections`] is what differs from robot to robot and from trial to trial: drawn once,
//! it also tells the plant its true wheel radii, track and start posture. [`Sensors`] then turns
//! each millisecond of the plant ([`Truth`]) into the numbers on a board's pins ([`Samples`]):
//! counts for encoders and strain bridges, SI values for the inertial sensor, whose scale factor
//! is fixed by its data sheet.
//!
//! Every random number comes from a generator that depends on nothing but (seed, trial, stream),
//! and every sensor has a stream of its own. Two trials of one number therefore meet the same
//! imperfections and the same noise, whatever sensors are fitted and whatever the node does with
//! them, so that they can be compared in pairs. Standard deviations only scale the draws.
//!
//! The defaults are what such parts do when they are fitted with ordinary care. `worlds/base.toml`
//! has each with its reason.

use crate::world::PlantErrors;
use core_algos::beam::strip;
use core_algos::config::{Allowed, ConfigError, in_range, non_negative, positive, require};
use rand::SeedableRng;
use rand_distr::{Distribution, StandardNormal, Uniform};
use rand_pcg::Pcg64;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// Samples a second of every sensor.
pub const SAMPLE_RATE_HZ: f64 = 1000.0;
/// Time between samples, s.
pub const SAMPLE_PERIOD_S: f64 = 1.0 / SAMPLE_RATE_HZ;
/// Largest number of strain bridges on the frame.
pub const MAX_GAUGES: usize = 8;
/// Longest delay from the instant of sampling to the board, ms.
pub const MAX_DELAY_MS: u32 = 31;

/// Slow drifts move once in this many samples: they are smooth on the scale of a tick.
const DRIFT_INTERVAL: u32 = 100;
const RING: usize = MAX_DELAY_MS as usize + 1;

/// All sensors of the robot and the care with which it was built and placed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SensorConfig {
    /// How well the robot is put on its start.
    pub placement: PlacementConfig,
    /// How well the odometry's constants are known.
    pub geometry: GeometryConfig,
    /// Wheel encoders.
    pub encoder: EncoderConfig,
    /// Yaw-rate gyroscope, one on each axle.
    pub gyro: InertialConfig<Gyro>,
    /// Longitudinal accelerometer, one on each axle.
    pub accelerometer: InertialConfig<Accelerometer>,
    /// Strain bridges on the frame.
    pub bridge: BridgeConfig,
}

/// How well the robot is put on its start.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlacementConfig {
    /// Standard deviation of the start position of O along each axis, m.
    pub position_sigma_m: f64,
    /// Standard deviation of the start heading, rad.
    pub heading_sigma_rad: f64,
}

impl Default for PlacementConfig {
    fn default() -> Self {
        Self {
            position_sigma_m: 2e-3,
            heading_sigma_rad: 2e-3,
        }
    }
}

/// How well the odometry's constants are known: true value over the value in the robot's
/// configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GeometryConfig {
    /// Relative standard deviation of each wheel's rolling radius.
    pub wheel_radius_sigma: f64,
    /// Relative standard deviation of each axle's effective track.
    pub track_sigma: f64,
}

impl Default for GeometryConfig {
    fn default() -> Self {
        Self {
            wheel_radius_sigma: 1e-3,
            track_sigma: 3e-3,
        }
    }
}

/// Wheel encoders: `counts = floor(angle·counts_per_revolution/2π + phase)`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EncoderConfig {
    /// Counts in one revolution of the wheel, all four edges of the quadrature counted. (An
    /// encoder of 500 lines before a gear of 26 to 1 would give 52000.)
    pub counts_per_revolution: u32,
    /// Age of a sample when the board has it, ms.
    pub delay_ms: u32,
}

impl Default for EncoderConfig {
    fn default() -> Self {
        Self {
            counts_per_revolution: 8192,
            delay_ms: 0,
        }
    }
}

/// Marks the yaw-rate channel of [`InertialConfig`]: rad/s.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Gyro;
/// Marks the longitudinal-acceleration channel of [`InertialConfig`]: m/s².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Accelerometer;

/// One channel of a micromechanical inertial sensor; `u` is rad/s for [`Gyro`], m/s² for
/// [`Accelerometer`].
///
/// `reading = quantised(truth·(1 + scale error) + bias + drift + noise)`, saturated at the range.
/// The defaults are those of a present 6-axis part of the ICM-42688 class; an older one of the
/// MPU-6050 class has twice to six times the noise and ten times the bias.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default, bound = "InertialConfig<Kind>: Default")]
pub struct InertialConfig<Kind> {
    /// Whether the axles carry it.
    pub fitted: bool,
    /// Standard deviation of the bias at power-up, u.
    pub bias_sigma: f64,
    /// Time at rest over which the driver averages at power-up and takes the mean as bias, s; 0
    /// hands the raw reading on.
    pub rest_average_s: f64,
    /// Time from that average to the start of a trial, s: the bias walks on while the robot is
    /// carried to its mark and set down.
    pub rest_age_s: f64,
    /// Random walk of the bias, u/√s.
    pub bias_walk: f64,
    /// White noise, u/√Hz, one-sided density; half the sample rate is the bandwidth.
    pub noise_density: f64,
    /// Relative standard deviation of the scale factor.
    pub scale_sigma: f64,
    /// Full scale to either side, u.
    pub range: f64,
    /// Bits of a reading over the whole range.
    pub bits: u32,
    /// Age of a sample when the board has it, ms.
    pub delay_ms: u32,
    #[serde(skip)]
    kind: Kind,
}

impl Default for InertialConfig<Gyro> {
    fn default() -> Self {
        Self {
            fitted: false,
            bias_sigma: 8.7e-3,
            rest_average_s: 1.0,
            rest_age_s: 60.0,
            bias_walk: 5e-5,
            noise_density: 4.9e-5,
            scale_sigma: 5e-3,
            range: 4.36,
            bits: 16,
            delay_ms: 1,
            kind: Gyro,
        }
    }
}

impl Default for InertialConfig<Accelerometer> {
    fn default() -> Self {
        Self {
            fitted: false,
            bias_sigma: 0.2,
            rest_average_s: 1.0,
            rest_age_s: 60.0,
            bias_walk: 5e-3,
            noise_density: 6.9e-4,
            scale_sigma: 5e-3,
            range: 19.6,
            bits: 16,
            delay_ms: 1,
            kind: Accelerometer,
        }
    }
}

/// Strain bridges: gauges, amplifier and converter.
///
/// `counts = round(gauge_factor·active_gauges/4·strain·amplifier_gain·2^bits)`, zero at mid-scale
/// and saturated at ±2^(bits−1). The bridge is fed from the converter's reference, so the supply
/// drops out. `strain` is that of the outer fibre at the gauge's true place, with gain error,
/// offset, drift and noise, behind the amplifier's low-pass filter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BridgeConfig {
    /// Relative resistance change over strain.
    pub gauge_factor: f64,
    /// Gauges of the bridge that see the strain: 1, 2 (one on each face) or 4 (two on each face).
    pub active_gauges: u32,
    /// Gain of the amplifier.
    pub amplifier_gain: f64,
    /// Corner of the amplifier's first-order low-pass filter, Hz.
    pub bandwidth_hz: f64,
    /// Effective bits of the converter over the whole range.
    pub converter_bits: u32,
    /// Noise at the converter as strain, rms at the sample rate.
    pub noise_strain: f64,
    /// Relative standard deviation of each bridge's gain.
    pub gain_sigma: f64,
    /// Relative standard deviation of the gain error that all bridges share. 1 to 2 %: foil and
    /// glue stand 40 to 60 µm off a half thickness of 0.5 mm, which a lot has alike, and the strip's
    /// thickness is known to 2 %.
    pub common_gain_sigma: f64,
    /// Standard deviation of each bridge's unbalance before zeroing, strain.
    pub offset_sigma_strain: f64,
    /// Standard deviation of each bridge's change from zeroing to the start of a trial, strain.
    pub drift_sigma_strain: f64,
    /// Standard deviation of the error that all bridges share after zeroing, strain: that of the edge
    /// against which the frame is held (strain = angle·half thickness/length).
    pub common_sigma_strain: f64,
    /// Random walk of each bridge during a trial, strain/√s.
    pub drift_walk_strain: f64,
    /// Where along the strip the gauges are meant to sit, from its root, m; at most eight.
    pub gauges_m: Vec<f64>,
    /// Standard deviation of each gauge's place along the strip, m.
    pub position_sigma_m: f64,
    /// Share of a sustained strain that a gauge loses in the end, as its adhesive and carrier creep:
    /// −0.05 to 0.05.
    pub creep_share: f64,
    /// Standard deviation of that share, the same for all gauges of a robot.
    pub creep_sigma: f64,
    /// Time constant of the creep, s.
    pub creep_time_s: f64,
    /// Rise of the gauges' temperature since zeroing, in the end, K.
    pub warming_k: f64,
    /// Time constant of the warming, s.
    pub warming_time_s: f64,
    /// Standard deviation of what each bridge's zero moves by for a rise of 1 K, strain:
    /// 0.5 to 1 µε for half bridges.
    pub zero_per_k_sigma_strain: f64,
    /// Relative change of all gains for a rise of 1 K.
    pub gain_per_k: f64,
    /// Distance of the gauges from the strip's neutral axis, m.
    pub half_thickness_m: f64,
    /// Age of a sample when the board has it, ms.
    pub delay_ms: u32,
}

impl Default for BridgeConfig {
    fn default() -> Self {
        Self {
            gauge_factor: 2.1,
            active_gauges: 4,
            amplifier_gain: 60.0,
            bandwidth_hz: 200.0,
            converter_bits: 14,
            noise_strain: 0.7e-6,
            gain_sigma: 3e-3,
            common_gain_sigma: 0.0,
            offset_sigma_strain: 200e-6,
            drift_sigma_strain: 1e-6,
            common_sigma_strain: 1e-6,
            drift_walk_strain: 0.05e-6,
            gauges_m: strip::Config::default()
                .gauges_m
                .iter()
                .map(f64::from)
                .collect(),
            position_sigma_m: 0.3e-3,
            creep_share: 0.0,
            creep_sigma: 0.0,
            creep_time_s: 60.0,
            warming_k: 0.0,
            warming_time_s: 600.0,
            zero_per_k_sigma_strain: 0.2e-6,
            gain_per_k: 1e-4,
            // As single precision has it, so that figures of earlier versions stay to the bit.
            half_thickness_m: f64::from(0.5e-3_f32),
            delay_ms: 1,
        }
    }
}

impl BridgeConfig {
    /// Strain of one count of a bridge without gain error: the board's nominal scale factor.
    pub fn strain_per_count(&self) -> f64 {
        let gain = self.gauge_factor * f64::from(self.active_gauges) / 4.0 * self.amplifier_gain;
        1.0 / (gain * f64::from(self.converter_bits).exp2())
    }

    /// Largest magnitude of a count: the converter is saturated there.
    pub fn full_scale_counts(&self) -> i32 {
        1 << (self.converter_bits - 1)
    }
}

impl SensorConfig {
    /// Checks every parameter; all that is built from the configuration relies on it.
    pub fn validate(&self) -> Result<(), ConfigError> {
        // The name in the message is the field's own.
        macro_rules! check {
            ($check:ident, $group:ident.$field:ident $(, $bound:expr)*) => {
                $check(
                    concat!("sensors.", stringify!($group), ".", stringify!($field)),
                    self.$group.$field
                    $(, $bound)*
                )?
            };
        }
        check!(at_least_0, placement.position_sigma_m);
        check!(at_least_0, placement.heading_sigma_rad);
        check!(small, geometry.wheel_radius_sigma);
        check!(small, geometry.track_sigma);
        check!(integer, encoder.counts_per_revolution, 1, 1 << 20);
        check!(integer, encoder.delay_ms, 0, MAX_DELAY_MS);
        check!(at_least_0, gyro.bias_sigma);
        check!(at_least_0, gyro.rest_average_s);
        check!(at_least_0, gyro.rest_age_s);
        check!(at_least_0, gyro.bias_walk);
        check!(at_least_0, gyro.noise_density);
        check!(small, gyro.scale_sigma);
        check!(above_0, gyro.range);
        check!(integer, gyro.bits, 2, 24);
        check!(integer, gyro.delay_ms, 0, MAX_DELAY_MS);
        check!(at_least_0, accelerometer.bias_sigma);
        check!(at_least_0, accelerometer.rest_average_s);
        check!(at_least_0, accelerometer.rest_age_s);
        check!(at_least_0, accelerometer.bias_walk);
        check!(at_least_0, accelerometer.noise_density);
        check!(small, accelerometer.scale_sigma);
        check!(above_0, accelerometer.range);
        check!(integer, accelerometer.bits, 2, 24);
        check!(integer, accelerometer.delay_ms, 0, MAX_DELAY_MS);
        check!(above_0, bridge.gauge_factor);
        check!(above_0, bridge.amplifier_gain);
        check!(above_0, bridge.bandwidth_hz);
        check!(one_two_or_four, bridge.active_gauges);
        check!(integer, bridge.converter_bits, 2, 24);
        check!(small, bridge.gain_sigma);
        check!(small, bridge.common_gain_sigma);
        check!(above_0, bridge.half_thickness_m);
        check!(at_least_0, bridge.noise_strain);
        check!(at_least_0, bridge.offset_sigma_strain);
        check!(at_least_0, bridge.drift_sigma_strain);
        check!(at_least_0, bridge.common_sigma_strain);
        check!(at_least_0, bridge.drift_walk_strain);
        check!(at_least_0, bridge.position_sigma_m);
        let count = self.bridge.gauges_m.len();
        require(
            (1..=MAX_GAUGES).contains(&count),
            "number of sensors.bridge.gauges_m",
            count as f32,
            Allowed::Range(1.0, MAX_GAUGES as f32),
        )?;
        check!(between, bridge.creep_share, 0.05);
        check!(small, bridge.creep_sigma);
        check!(above_0, bridge.creep_time_s);
        check!(between, bridge.warming_k, 100.0);
        check!(above_0, bridge.warming_time_s);
        check!(at_least_0, bridge.zero_per_k_sigma_strain);
        check!(between, bridge.gain_per_k, 1e-3);
        check!(integer, bridge.delay_ms, 0, MAX_DELAY_MS);
        Ok(())
    }
}

fn at_least_0(field: &'static str, value: f64) -> Result<(), ConfigError> {
    non_negative(field, value as f32).map(drop)
}

fn above_0(field: &'static str, value: f64) -> Result<(), ConfigError> {
    positive(field, value as f32).map(drop)
}

/// A relative standard deviation: a draw of ten of them must leave a positive factor.
fn small(field: &'static str, value: f64) -> Result<(), ConfigError> {
    in_range(field, value as f32, 0.0, 0.09).map(drop)
}

fn between(field: &'static str, value: f64, largest: f32) -> Result<(), ConfigError> {
    in_range(field, value as f32, -largest, largest).map(drop)
}

fn one_two_or_four(field: &'static str, value: u32) -> Result<(), ConfigError> {
    let allowed = Allowed::Condition("1, 2 or 4");
    require(matches!(value, 1 | 2 | 4), field, value as f32, allowed).map(drop)
}

fn integer(field: &'static str, value: u32, low: u32, high: u32) -> Result<(), ConfigError> {
    in_range(field, value as f32, low as f32, high as f32).map(drop)
}

/// A random stream. The number is part of the generator's seed: it must never change its meaning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stream {
    /// Wheel radii and tracks.
    Geometry,
    /// Where the robot is put.
    Placement,
    /// Phases of the encoders.
    Encoder,
    /// Gyro of an axle (0 front, 1 rear).
    Gyro(usize),
    /// Accelerometer of an axle (0 front, 1 rear).
    Accelerometer(usize),
    /// A strain bridge.
    Bridge(usize),
    /// What all bridges share.
    BridgeCommon,
    /// The plant's constants.
    Plant,
    /// How all bridges are made.
    BridgeMakeup,
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
            Self::Gyro(axle) => 0x100 + axle as u64,
            Self::Accelerometer(axle) => 0x200 + axle as u64,
            Self::Bridge(index) => 0x300 + index as u64,
            Self::Other(number) => (1 << 32) + number,
        }
    }
}

/// The generator of one stream of one trial.
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
fn mix(state: u64) -> u64 {
    let z = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A draw from the normal distribution of mean 0 and the given standard deviation.
pub fn normal(generator: &mut Pcg64, sigma: f64) -> f64 {
    let draw: f64 = StandardNormal.sample(generator);
    sigma * draw
}

/// What differs from trial to trial, constant within one. Axle 0 is the front, wheel 0 the left.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrialImperfections {
    /// True rolling radius over nominal, by axle and wheel.
    pub wheel_radius_factor: [[f64; 2]; 2],
    /// True track over nominal, by axle.
    pub track_factor: [f64; 2],
    /// True start posture of O minus the intended one: x (m), y (m), heading (rad).
    pub placement: [f64; 3],
    /// Phase of each encoder within a count, in [0, 1).
    pub encoder_phase: [[f64; 2]; 2],
    /// Bias of each gyro at the start as the driver hands it on, rad/s.
    pub gyro_bias: [f64; 2],
    /// Relative error of each gyro's scale factor.
    pub gyro_scale_error: [f64; 2],
    /// Bias of each accelerometer at the start as the driver hands it on, m/s².
    pub accelerometer_bias: [f64; 2],
    /// Relative error of each accelerometer's scale factor.
    pub accelerometer_scale_error: [f64; 2],
    /// Relative error of each bridge's gain.
    pub bridge_gain_error: [f64; MAX_GAUGES],
    /// Unbalance of each bridge when it was zeroed, strain.
    pub bridge_offset: [f64; MAX_GAUGES],
    /// Further offset of each bridge at the start of the trial, strain; what all share included.
    pub bridge_drift: [f64; MAX_GAUGES],
    /// What each bridge's zero moves by for a rise of 1 K, strain.
    pub bridge_zero_per_k: [f64; MAX_GAUGES],
    /// True place of each gauge along the strip minus the intended one, m: the plant's strain is
    /// to be taken there.
    pub gauge_shift_m: [f64; MAX_GAUGES],
    /// What the gauges lose of a sustained strain beyond the mean share.
    pub gauge_creep_error: f64,
    /// What the plant's constants are off by.
    pub plant: PlantErrors,
}

impl TrialImperfections {
    /// A robot without any: for tests and comparisons.
    pub fn none() -> Self {
        Self {
            wheel_radius_factor: [[1.0; 2]; 2],
            track_factor: [1.0; 2],
            placement: [0.0; 3],
            encoder_phase: [[0.0; 2]; 2],
            gyro_bias: [0.0; 2],
            gyro_scale_error: [0.0; 2],
            accelerometer_bias: [0.0; 2],
            accelerometer_scale_error: [0.0; 2],
            bridge_gain_error: [0.0; MAX_GAUGES],
            bridge_offset: [0.0; MAX_GAUGES],
            bridge_drift: [0.0; MAX_GAUGES],
            bridge_zero_per_k: [0.0; MAX_GAUGES],
            gauge_shift_m: [0.0; MAX_GAUGES],
            gauge_creep_error: 0.0,
            plant: PlantErrors::NONE,
        }
    }

    /// Those of the sensors in one trial; [`World::draw`](crate::world::World::draw) gives them all. The
    /// same numbers are drawn whatever the configuration; it only scales them.
    pub fn draw(config: &SensorConfig, seed: u64, trial: u64) -> Self {
        let mut drawn = Self::none();

        let mut random = generator(seed, trial, Stream::Geometry);
        for factor in drawn.wheel_radius_factor.as_flattened_mut() {
            *factor += normal(&mut random, config.geometry.wheel_radius_sigma);
        }
        for factor in &mut drawn.track_factor {
            *factor += normal(&mut random, config.geometry.track_sigma);
        }

        let mut random = generator(seed, trial, Stream::Placement);
        let place = &config.placement;
        drawn.placement = [
            place.position_sigma_m,
            place.position_sigma_m,
            place.heading_sigma_rad,
        ]
        .map(|sigma| normal(&mut random, sigma));

        let mut random = generator(seed, trial, Stream::Encoder);
        let unit = Uniform::new(0.0, 1.0).expect("an interval that is not empty");
        for phase in drawn.encoder_phase.as_flattened_mut() {
            *phase = unit.sample(&mut random);
        }

        for axle in 0..2 {
            let mut random = generator(seed, trial, Stream::Gyro(axle));
            drawn.gyro_bias[axle] = config.gyro.draw_bias(&mut random);
            drawn.gyro_scale_error[axle] = normal(&mut random, config.gyro.scale_sigma);
            let mut random = generator(seed, trial, Stream::Accelerometer(axle));
            drawn.accelerometer_bias[axle] = config.accelerometer.draw_bias(&mut random);
            drawn.accelerometer_scale_error[axle] =
                normal(&mut random, config.accelerometer.scale_sigma);
        }

        let bridge = &config.bridge;
        let mut random = generator(seed, trial, Stream::BridgeCommon);
        let common = normal(&mut random, bridge.common_sigma_strain);
        for index in 0..MAX_GAUGES {
            let mut random = generator(seed, trial, Stream::Bridge(index));
            drawn.bridge_gain_error[index] = normal(&mut random, bridge.gain_sigma);
            drawn.bridge_offset[index] = normal(&mut random, bridge.offset_sigma_strain);
            drawn.bridge_drift[index] = common + normal(&mut random, bridge.drift_sigma_strain);
            drawn.gauge_shift_m[index] = normal(&mut random, bridge.position_sigma_m);
            drawn.bridge_zero_per_k[index] = normal(&mut random, bridge.zero_per_k_sigma_strain);
        }
        drawn
    }

    /// What the bridges read, in counts, when the unbent robot was zeroed: the mean of so many
    /// samples that noise and quantisation are gone. The board keeps it as its calibration.
    pub fn zero_counts(&self, config: &BridgeConfig) -> [f64; MAX_GAUGES] {
        let limit = f64::from(config.full_scale_counts());
        self.bridge_offset
            .map(|strain| (strain / config.strain_per_count()).clamp(-limit, limit - 1.0))
    }
}

impl<Kind> InertialConfig<Kind> {
    /// Standard deviation of one sample's noise.
    fn noise_sigma(&self) -> f64 {
        self.noise_density * (SAMPLE_RATE_HZ / 2.0).sqrt()
    }

    /// The bias at the start of the trial: what the driver's average at rest left, and what has
    /// come since.
    fn draw_bias(&self, random: &mut Pcg64) -> f64 {
        let raw = normal(random, self.bias_sigma);
        let rest: f64 = StandardNormal.sample(random);
        if self.rest_average_s > 0.0 {
            // White noise averaged over T has an equivalent bandwidth of 1/(2T).
            let averaged = self.noise_density / (2.0 * self.rest_average_s).sqrt();
            rest * averaged.hypot(self.bias_walk * self.rest_age_s.sqrt())
        } else {
            raw
        }
    }
}

/// What the sensors see of the plant at one instant. Axle 0 is the front, wheel 0 the left.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Truth {
    /// Angle each wheel has turned against its axle since the start, rad, forward positive.
    pub wheel_angle: [[f64; 2]; 2],
    /// Yaw rate of each axle, rad/s, counter-clockwise positive.
    pub yaw_rate: [f64; 2],
    /// Specific force of each axle along its forward axis, m/s².
    pub forward_acceleration: [f64; 2],
    /// Strain of the outer fibre at each gauge's true place, positive where the frame bends left.
    pub gauge_strain: [f64; MAX_GAUGES],
    /// Number of gauges on the strip: the others are not sampled.
    pub gauge_count: usize,
}

/// What the boards read at one tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Samples {
    /// Encoder counters, by axle and wheel; they wrap around.
    pub encoder_counts: [[i32; 2]; 2],
    /// Yaw rate of each axle, rad/s; none where no gyro is fitted.
    pub gyro: [Option<f32>; 2],
    /// Longitudinal specific force of each axle, m/s²; none where no accelerometer is fitted.
    pub accelerometer: [Option<f32>; 2],
    /// Converter counts of the bridges, zero at mid-scale; zero where there is no gauge.
    pub bridge_counts: [i32; MAX_GAUGES],
}

/// The last few samples of one kind, so that the board may get one that is some ms old.
#[derive(Clone, Debug)]
struct Delay<T> {
    ring: [T; RING],
    next: usize,
    delay: usize,
    filled: bool,
}

impl<T: Copy + Default> Delay<T> {
    fn new(delay_ms: u32) -> Self {
        Self {
            ring: [T::default(); RING],
            next: 0,
            delay: delay_ms.min(MAX_DELAY_MS) as usize,
            filled: false,
        }
    }

    /// Takes the newest sample, gives the one that is due; before time zero the first one holds.
    fn pass(&mut self, sample: T) -> T {
        if !self.filled {
            self.ring = [sample; RING];
            self.filled = true;
        }
        self.ring[self.next] = sample;
        let due = self.ring[(self.next + RING - self.delay) % RING];
        self.next = (self.next + 1) % RING;
        due
    }
}

/// A constant plus a random walk.
#[derive(Clone, Debug)]
struct Drift {
    value: f64,
    step_sigma: f64,
    countdown: u32,
}

impl Drift {
    fn new(start: f64, walk: f64) -> Self {
        Self {
            value: start,
            step_sigma: walk * (f64::from(DRIFT_INTERVAL) * SAMPLE_PERIOD_S).sqrt(),
            countdown: DRIFT_INTERVAL,
        }
    }

    fn next(&mut self, random: &mut Pcg64) -> f64 {
        let value = self.value;
        self.countdown -= 1;
        if self.countdown == 0 {
            self.countdown = DRIFT_INTERVAL;
            self.value += normal(random, self.step_sigma);
        }
        value
    }
}

#[derive(Clone, Debug)]
struct InertialChannel {
    random: Pcg64,
    bias: Drift,
    scale: f64,
    noise_sigma: f64,
    resolution: f64,
    range: f64,
    fitted: bool,
    delay: Delay<f32>,
}

impl InertialChannel {
    fn new<Kind>(
        config: &InertialConfig<Kind>,
        bias: f64,
        scale_error: f64,
        random: Pcg64,
    ) -> Self {
        Self {
            random,
            bias: Drift::new(bias, config.bias_walk),
            scale: 1.0 + scale_error,
            noise_sigma: config.noise_sigma(),
            resolution: 2.0 * config.range / f64::from(config.bits).exp2(),
            range: config.range,
            fitted: config.fitted,
            delay: Delay::new(config.delay_ms),
        }
    }

    fn sample(&mut self, truth: f64) -> Option<f32> {
        if !self.fitted {
            return None;
        }
        let bias = self.bias.next(&mut self.random);
        let value = self.scale * truth + bias + normal(&mut self.random, self.noise_sigma);
        let value = (value / self.resolution).round() * self.resolution;
        let value = value.clamp(-self.range, self.range - self.resolution);
        Some(self.delay.pass(value as f32))
    }
}

/// First-order low-pass filter, exact for an input that is linear between samples.
#[derive(Clone, Debug)]
struct LowPass {
    pole: f64,
    weight_old: f64,
    weight_new: f64,
    input: f64,
    output: f64,
    started: bool,
}

impl LowPass {
    fn new(bandwidth_hz: f64) -> Self {
        let ratio = TAU * bandwidth_hz * SAMPLE_PERIOD_S;
        let pole = (-ratio).exp();
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

    fn pass(&mut self, input: f64) -> f64 {
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

/// What time under strain and warmth do to a gauge. A first-order lag each.
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
    /// A gauge whose zero moves by `zero_per_k` (strain) for a rise of 1 K, and that creeps by so much
    /// more than its kind, at rest until now.
    pub fn new(config: &BridgeConfig, zero_per_k: f64, creep_error: f64) -> Self {
        let step = |time: f64| -(-SAMPLE_PERIOD_S / time).exp_m1();
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

    /// What the gauge makes of a strain, and what its zero has moved by, a millisecond after the
    /// last call.
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

#[derive(Clone, Debug)]
struct Bridge {
    random: Pcg64,
    gain: f64,
    ageing: GaugeAgeing,
    offset: Drift,
    filter: LowPass,
    noise_sigma: f64,
    counts_per_strain: f64,
    limit: f64,
    delay: Delay<i32>,
}

impl Bridge {
    fn sample(&mut self, strain: f64) -> i32 {
        let offset = self.offset.next(&mut self.random);
        let [strain, moved] = self.ageing.next(strain);
        let seen = self.filter.pass(self.gain * strain + (offset + moved));
        let seen = seen + normal(&mut self.random, self.noise_sigma);
        let counts = (seen * self.counts_per_strain).round();
        self.delay
            .pass(counts.clamp(-self.limit, self.limit - 1.0) as i32)
    }
}

/// All sensors of one robot in one trial. One call of [`Self::sample`] a millisecond.
#[derive(Clone, Debug)]
pub struct Sensors {
    counts_per_radian: f64,
    encoder_phase: [[f64; 2]; 2],
    encoder_delay: Delay<[[i32; 2]; 2]>,
    gyro: [InertialChannel; 2],
    accelerometer: [InertialChannel; 2],
    bridges: [Bridge; MAX_GAUGES],
}

impl Sensors {
    /// The sensors of one trial; refuses what [`SensorConfig::validate`] refuses.
    pub fn new(
        config: &SensorConfig,
        imperfections: &TrialImperfections,
        seed: u64,
        trial: u64,
    ) -> Result<Self, ConfigError> {
        config.validate()?;
        // Noise continues on streams of their own, so that it does not depend on how many numbers
        // the imperfections took.
        let noise = |stream: Stream| generator(mix(seed), trial, stream);
        let bridge = &config.bridge;
        Ok(Self {
            counts_per_radian: f64::from(config.encoder.counts_per_revolution) / TAU,
            encoder_phase: imperfections.encoder_phase,
            encoder_delay: Delay::new(config.encoder.delay_ms),
            gyro: [0, 1].map(|axle| {
                InertialChannel::new(
                    &config.gyro,
                    imperfections.gyro_bias[axle],
                    imperfections.gyro_scale_error[axle],
                    noise(Stream::Gyro(axle)),
                )
            }),
            accelerometer: [0, 1].map(|axle| {
                InertialChannel::new(
                    &config.accelerometer,
                    imperfections.accelerometer_bias[axle],
                    imperfections.accelerometer_scale_error[axle],
                    noise(Stream::Accelerometer(axle)),
                )
            }),
            bridges: std::array::from_fn(|index| Bridge {
                random: noise(Stream::Bridge(index)),
                gain: 1.0 + imperfections.bridge_gain_error[index],
                ageing: GaugeAgeing::new(
                    bridge,
                    imperfections.bridge_zero_per_k[index],
                    imperfections.gauge_creep_error,
                ),
                offset: Drift::new(
                    imperfections.bridge_offset[index] + imperfections.bridge_drift[index],
                    bridge.drift_walk_strain,
                ),
                filter: LowPass::new(bridge.bandwidth_hz),
                noise_sigma: bridge.noise_strain,
                counts_per_strain: 1.0 / bridge.strain_per_count(),
                limit: f64::from(bridge.full_scale_counts()),
                delay: Delay::new(bridge.delay_ms),
            }),
        })
    }

    /// The readings one millisecond after the last call; no allocation.
    pub fn sample(&mut self, truth: &Truth) -> Samples {
        let mut samples = Samples::default();
        for axle in 0..2 {
            for wheel in 0..2 {
                let counts = (truth.wheel_angle[axle][wheel] * self.counts_per_radian
                    + self.encoder_phase[axle][wheel])
                    .floor();
                // Through i64: a hardware counter wraps where a float conversion would saturate.
                samples.encoder_counts[axle][wheel] = counts as i64 as i32;
            }
            samples.gyro[axle] = self.gyro[axle].sample(truth.yaw_rate[axle]);
            samples.accelerometer[axle] =
                self.accelerometer[axle].sample(truth.forward_acceleration[axle]);
        }
        samples.encoder_counts = self.encoder_delay.pass(samples.encoder_counts);
        let strains = truth.gauge_strain.iter().take(truth.gauge_count);
        for ((counts, bridge), &strain) in samples
            .bridge_counts
            .iter_mut()
            .zip(&mut self.bridges)
            .zip(strains)
        {
            *counts = bridge.sample(strain);
        }
        samples
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// No randomness, no delay, all sensors fitted.
    fn clean() -> SensorConfig {
        let mut config = SensorConfig::default();
        config.gyro.fitted = true;
        config.accelerometer.fitted = true;
        config.gyro.delay_ms = 0;
        config.accelerometer.delay_ms = 0;
        config.bridge.delay_ms = 0;
        for sigma in [
            &mut config.gyro.noise_density,
            &mut config.gyro.bias_walk,
            &mut config.accelerometer.noise_density,
            &mut config.accelerometer.bias_walk,
            &mut config.bridge.noise_strain,
            &mut config.bridge.drift_walk_strain,
        ] {
            *sigma = 0.0;
        }
        config
    }

    fn sensors(config: &SensorConfig, imperfections: &TrialImperfections) -> Sensors {
        Sensors::new(config, imperfections, 1, 2).unwrap()
    }

    fn mean_and_sd(values: &[f64]) -> (f64, f64) {
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let square: f64 = values.iter().map(|v| (v - mean) * (v - mean)).sum();
        (mean, (square / (n - 1.0)).sqrt())
    }

    #[test]
    fn gauges_creep_and_warm() {
        let mut config = clean();
        config.bridge.converter_bits = 24;
        config.bridge.creep_share = 0.01;
        config.bridge.creep_time_s = 0.5;
        config.bridge.warming_k = 10.0;
        config.bridge.warming_time_s = 0.25;
        config.bridge.gain_per_k = 1e-4;
        let mut drawn = TrialImperfections::none();
        drawn.bridge_zero_per_k[1] = 0.4e-6;
        let mut sensors = Sensors::new(&config, &drawn, 1, 1).unwrap();
        let mut truth = Truth {
            gauge_count: 2,
            ..Truth::default()
        };
        truth.gauge_strain[..2].fill(1e-3);
        let per_count = config.bridge.strain_per_count();
        for tick in 1..=3000 {
            let counts = sensors.sample(&truth).bridge_counts;
            if ![500, 3000].contains(&tick) {
                continue;
            }
            let (t, left) = (1e-3 * f64::from(tick), |time: f64, t: f64| {
                (-t / time).exp()
            });
            let warmth = 10.0 * (1.0 - left(0.25, t));
            let held = 1e-3 * (1.0 - 0.01 * (1.0 - left(0.5, t))) * (1.0 + 1e-4 * warmth);
            for (bridge, zero) in [(0, 0.0), (1, 0.4e-6)] {
                let seen = f64::from(counts[bridge]) * per_count;
                let expected = held + zero * warmth;
                assert!((seen - expected).abs() < 2e-8, "{seen} {expected}");
            }
        }
    }

    #[test]
    fn defaults_are_valid_and_survive_toml() {
        let config = SensorConfig::default();
        config.validate().unwrap();
        let text = toml::to_string(&config).unwrap();
        assert_eq!(toml::from_str::<SensorConfig>(&text).unwrap(), config);
        let part: SensorConfig = toml::from_str("[gyro]\nfitted = true").unwrap();
        assert!(part.gyro.fitted && part.gyro.noise_density == config.gyro.noise_density);
        let error = toml::from_str::<SensorConfig>("[gyro]\nfited = true").unwrap_err();
        assert!(error.to_string().contains("fited"));
    }

    #[test]
    fn bad_parameters_are_named() {
        for (edit, field) in [
            (
                (|c| c.bridge.bandwidth_hz = 0.0) as fn(&mut SensorConfig),
                "sensors.bridge.bandwidth_hz",
            ),
            (
                |c| c.gyro.noise_density = f64::NAN,
                "sensors.gyro.noise_density",
            ),
            (|c| c.encoder.delay_ms = 32, "sensors.encoder.delay_ms"),
            (
                |c| c.bridge.active_gauges = 3,
                "sensors.bridge.active_gauges",
            ),
            (
                |c| c.bridge.converter_bits = 0,
                "sensors.bridge.converter_bits",
            ),
            (
                |c| c.geometry.track_sigma = -1.0,
                "sensors.geometry.track_sigma",
            ),
        ] {
            let mut config = SensorConfig::default();
            edit(&mut config);
            assert_eq!(config.validate().unwrap_err().field, field);
            assert!(Sensors::new(&config, &TrialImperfections::none(), 0, 0).is_err());
        }
    }

    #[test]
    fn encoder_counts_one_revolution_and_wraps() {
        let config = clean();
        let mut sensors = sensors(&config, &TrialImperfections::none());
        let mut at = |angle: f64| {
            let mut truth = Truth::default();
            truth.wheel_angle[1][0] = angle;
            sensors.sample(&truth).encoder_counts[1][0]
        };
        assert_eq!(at(0.0), 0);
        assert_eq!(at(TAU * 1.000_001), 8192);
        assert_eq!(at(-TAU * 0.999_999), -8192);
        // 2^31 counts are 2^18 revolutions: one count further the counter is at its other end.
        assert_eq!(at(TAU * (262_144.0 + 0.5 / 8192.0)), i32::MIN);
    }

    #[test]
    fn encoder_phase_spreads_the_edges() {
        let config = clean();
        let phases: Vec<f64> = (0..500)
            .flat_map(|trial| {
                let drawn = TrialImperfections::draw(&config, 3, trial);
                drawn.encoder_phase.into_iter().flatten()
            })
            .collect();
        assert!(phases.iter().all(|p| (0.0..1.0).contains(p)));
        let (mean, sd) = mean_and_sd(&phases);
        assert!((mean - 0.5).abs() < 0.03, "{mean}");
        assert!((sd - 12f64.sqrt().recip()).abs() < 0.02, "{sd}");
    }

    #[test]
    fn imperfections_have_the_stated_spread_and_are_the_same_in_pairs() {
        let config = SensorConfig::default();
        let drawn: Vec<_> = (0..2000)
            .map(|trial| TrialImperfections::draw(&config, 7, trial))
            .collect();
        let spread = |value: &dyn Fn(&TrialImperfections) -> f64, mean: f64, sigma: f64| {
            let values: Vec<f64> = drawn.iter().map(value).collect();
            let (m, s) = mean_and_sd(&values);
            assert!((m - mean).abs() < 0.09 * sigma, "mean {m} of {mean}");
            assert!((s / sigma - 1.0).abs() < 0.07, "sd {s} of {sigma}");
        };
        spread(&|d| d.wheel_radius_factor[1][0], 1.0, 1e-3);
        spread(&|d| d.track_factor[0], 1.0, 3e-3);
        spread(&|d| d.placement[2], 0.0, 2e-3);
        spread(&|d| d.bridge_offset[4], 0.0, 200e-6);
        spread(&|d| d.gauge_shift_m[2], 0.0, 0.3e-3);
        // Own and common part together; two bridges share the common part only.
        spread(&|d| d.bridge_drift[3], 0.0, 2f64.sqrt() * 1e-6);
        spread(
            &|d| d.bridge_drift[3] - d.bridge_drift[0],
            0.0,
            2f64.sqrt() * 1e-6,
        );
        // 4.9e-5 rad/s/√Hz averaged over one second, then a minute of 5e-5 rad/s/√s.
        let sigma = (4.9e-5f64.powi(2) * 0.5 + 5e-5f64.powi(2) * 60.0).sqrt();
        spread(&|d| d.gyro_bias[0], 0.0, sigma);

        let mut other = config.clone();
        other.gyro.fitted = true;
        other.geometry.wheel_radius_sigma = 2e-3;
        let twin = TrialImperfections::draw(&other, 7, 5);
        assert_eq!(twin.bridge_drift, drawn[5].bridge_drift);
        for (one, two) in drawn[5].wheel_radius_factor[0]
            .iter()
            .zip(twin.wheel_radius_factor[0])
        {
            assert!(((two - 1.0) - 2.0 * (one - 1.0)).abs() < 1e-12);
        }
        assert_ne!(drawn[5], drawn[6]);
        assert_ne!(drawn[5], TrialImperfections::draw(&config, 8, 5));
    }

    #[test]
    fn streams_do_not_depend_on_what_else_is_fitted() {
        let bare = SensorConfig::default();
        let mut full = bare.clone();
        full.gyro.fitted = true;
        full.accelerometer.fitted = true;
        let drawn = TrialImperfections::draw(&bare, 11, 0);
        let run = |config: &SensorConfig, gauge_count| {
            let mut sensors = Sensors::new(config, &drawn, 11, 0).unwrap();
            let truth = Truth {
                gauge_strain: [1e-4; MAX_GAUGES],
                gauge_count,
                ..Truth::default()
            };
            (0..300).map(|_| sensors.sample(&truth)).collect::<Vec<_>>()
        };
        let (few, many) = (run(&bare, 3), run(&full, 5));
        for (a, b) in few.iter().zip(&many) {
            assert_eq!(a.bridge_counts[..3], b.bridge_counts[..3]);
            assert_eq!(a.bridge_counts[3], 0);
            assert!(a.gyro[0].is_none() && b.gyro[0].is_some());
        }
        assert_eq!(many, run(&full, 5));
    }

    #[test]
    fn noise_of_the_sensors_is_white_and_uncorrelated() {
        let mut config = clean();
        config.bridge.noise_strain = 5e-6;
        config.gyro.noise_density = 4.9e-5;
        let mut sensors = sensors(&config, &TrialImperfections::none());
        let truth = Truth {
            gauge_count: 2,
            ..Truth::default()
        };
        let n = 20_000;
        let mut series = [const { Vec::new() }; 4];
        for _ in 0..n {
            let sample = sensors.sample(&truth);
            let scale = config.bridge.strain_per_count();
            series[0].push(f64::from(sample.bridge_counts[0]) * scale);
            series[1].push(f64::from(sample.bridge_counts[1]) * scale);
            series[2].push(f64::from(sample.gyro[0].unwrap()));
            series[3].push(f64::from(sample.gyro[1].unwrap()));
        }
        let correlation = |a: &[f64], b: &[f64]| {
            let ((ma, sa), (mb, sb)) = (mean_and_sd(a), mean_and_sd(b));
            let sum: f64 = a.iter().zip(b).map(|(x, y)| (x - ma) * (y - mb)).sum();
            sum / (n as f64 * sa * sb)
        };
        for i in 0..4 {
            for j in 0..i {
                assert!(correlation(&series[i], &series[j]).abs() < 0.03, "{i} {j}");
            }
            let lag = correlation(&series[i][1..], &series[i][..n - 1]);
            assert!(lag.abs() < 0.03, "{i}: {lag}");
        }
        // Quantisation adds q²/12 to the variance.
        let expected = (25e-12 + config.bridge.strain_per_count().powi(2) / 12.0).sqrt();
        assert!((mean_and_sd(&series[0]).1 / expected - 1.0).abs() < 0.03);
        // Half the sample rate is the bandwidth: 4.9e-5·√500 = 1.0957e-3.
        assert!((mean_and_sd(&series[2]).1 / 1.0957e-3 - 1.0).abs() < 0.03);
    }

    #[test]
    fn bridge_chain_gives_the_counts_of_a_hand_calculation() {
        let config = clean();
        // 1000 µε · 2.1 = 2.1 mV/V; ·60 = 0.126 of the reference; ·2^14 = 2064.4 counts.
        let mut truth = Truth {
            gauge_count: 1,
            ..Truth::default()
        };
        truth.gauge_strain[0] = 1e-3;
        let mut ideal = sensors(&config, &TrialImperfections::none());
        assert_eq!(ideal.sample(&truth).bridge_counts[0], 2064);
        // Half a bridge gives half as much.
        let mut half = config.clone();
        half.bridge.active_gauges = 2;
        let mut half = sensors(&half, &TrialImperfections::none());
        assert_eq!(half.sample(&truth).bridge_counts[0], 1032);
        // Gain error acts on the strain, not on the offset: 1110 µε, not 1111.
        let mut bad = TrialImperfections::none();
        bad.bridge_gain_error[0] = 0.01;
        bad.bridge_offset[0] = 100e-6;
        let mut bad = sensors(&config, &bad);
        assert_eq!(bad.sample(&truth).bridge_counts[0], 2291);
        truth.gauge_strain[0] = 1.0;
        assert_eq!(
            sensors(&config, &TrialImperfections::none())
                .sample(&truth)
                .bridge_counts[0],
            8191
        );
        truth.gauge_strain[0] = -1.0;
        assert_eq!(
            sensors(&config, &TrialImperfections::none())
                .sample(&truth)
                .bridge_counts[0],
            -8192
        );
    }

    #[test]
    fn stored_zero_leaves_the_drift_alone() {
        let config = clean();
        let mut drawn = TrialImperfections::draw(&config, 5, 9);
        drawn.bridge_drift = [3e-6; MAX_GAUGES];
        let zero = drawn.zero_counts(&config.bridge);
        let mut sensors = sensors(&config, &drawn);
        let sample = sensors.sample(&Truth {
            gauge_count: MAX_GAUGES,
            ..Truth::default()
        });
        for (counts, zero) in sample.bridge_counts.iter().zip(zero) {
            let strain = (f64::from(*counts) - zero) * config.bridge.strain_per_count();
            assert!((strain - 3e-6).abs() < 0.51 * config.bridge.strain_per_count());
        }
    }

    #[test]
    fn amplifier_lags_a_ramp_by_its_time_constant() {
        let mut filter = LowPass::new(200.0);
        let tau = 1.0 / (TAU * 200.0);
        filter.pass(0.0);
        let mut seen = 0.0;
        for k in 1..=50 {
            seen = filter.pass(f64::from(k) * SAMPLE_PERIOD_S);
            let t = f64::from(k) * SAMPLE_PERIOD_S;
            // Ramp response of a first-order lag.
            let exact = t - tau * (1.0 - (-t / tau).exp());
            assert!((seen - exact).abs() < 1e-12);
        }
        assert!((50.0 * SAMPLE_PERIOD_S - seen - tau).abs() < 1e-9);
    }

    #[test]
    fn samples_arrive_as_old_as_configured() {
        let mut config = clean();
        config.encoder.delay_ms = 3;
        config.gyro.delay_ms = 1;
        config.bridge.delay_ms = 31;
        config.bridge.bandwidth_hz = 1e9;
        let mut sensors = sensors(&config, &TrialImperfections::none());
        for k in 0..100 {
            let t = f64::from(k);
            let mut truth = Truth {
                wheel_angle: [[(t + 0.25) * TAU / 8192.0; 2]; 2],
                yaw_rate: [t * 0.01; 2],
                gauge_count: 1,
                ..Truth::default()
            };
            truth.gauge_strain[0] = t * config.bridge.strain_per_count();
            let sample = sensors.sample(&truth);
            assert_eq!(sample.encoder_counts[0][1], (k - 3).max(0));
            let late = f64::from((k - 1).max(0)) * 0.01;
            assert!((f64::from(sample.gyro[1].unwrap()) - late).abs() < 1e-4);
            assert_eq!(sample.bridge_counts[0], (k - 31).max(0));
        }
    }

    #[test]
    fn inertial_readings_are_scaled_biased_quantised_and_limited() {
        let config = clean();
        let mut drawn = TrialImperfections::none();
        drawn.gyro_bias = [0.01, -0.02];
        drawn.gyro_scale_error = [0.0, 0.005];
        let mut sensors = sensors(&config, &drawn);
        let mut truth = Truth {
            yaw_rate: [1.0, 2.0],
            forward_acceleration: [100.0, -100.0],
            ..Truth::default()
        };
        let sample = sensors.sample(&truth);
        let step = 2.0 * 4.36 / 65536.0;
        assert!((f64::from(sample.gyro[0].unwrap()) - 1.01).abs() < 0.51 * step);
        assert!((f64::from(sample.gyro[1].unwrap()) - 1.99).abs() < 0.51 * step);
        assert!((sample.accelerometer[0].unwrap() - 19.6).abs() < 1e-3);
        assert_eq!(sample.accelerometer[1], Some(-19.6));
        truth.yaw_rate[0] = 0.0;
        let counts = f64::from(sensors.sample(&truth).gyro[0].unwrap()) / step;
        assert!((counts - counts.round()).abs() < 1e-4);
    }

    #[test]
    fn bias_walks_with_the_square_root_of_time() {
        let mut config = clean();
        config.gyro.bias_walk = 0.01;
        let ends: Vec<f64> = (0..400)
            .map(|trial| {
                let none = TrialImperfections::none();
                let mut sensors = Sensors::new(&config, &none, 21, trial).unwrap();
                let truth = Truth::default();
                let last = (0..4001).map(|_| sensors.sample(&truth)).last().unwrap();
                f64::from(last.gyro[0].unwrap())
            })
            .collect();
        // 0.01 rad/s/√s over 4 s.
        let (mean, sd) = mean_and_sd(&ends);
        assert!(mean.abs() < 0.003, "{mean}");
        assert!((sd / 0.02 - 1.0).abs() < 0.12, "{sd}");
    }
}
