//! Sensor models: from the state of the plant to the samples a board reads.
//!
//! Each millisecond [`Sensors`] converts the state of the plant ([`Truth`]) to readings of the boards ([`Samples`]):
//! counts for encoders and strain bridges, SI values for the inertial sensor, whose scale factor is fixed by its data
//! sheet. [`Drawn`] holds the errors of one robot. Standard deviations only scale the random numbers.
//!
//! The defaults are typical of such parts when fitted with ordinary care. `worlds/base.toml` gives the reason of each
//! default.

mod bridge;
mod converter;
mod delay;
mod inertial;

#[cfg(test)]
mod tests;
pub use bridge::{BridgeConfig, GaugeAgeing};
pub use core_algos::beam::MAX_GAUGES;
pub use delay::MAX_DELAY_MS;
pub use inertial::{Accelerometer, Gyro};

use crate::base::error::{Error, within};
use crate::base::table::table;
use crate::world::drawn::{Drawn, FrameErrors};
use crate::world::random::SMALL;
use crate::world::random::{BOUND, Stream, bounded, generator, mix, normal};
use bridge::Bridge;
use core_algos::topology::Topology;
use delay::Delay;
use inertial::{Channel, InertialChannel};
use rand::RngExt;
use rand::distr::{Distribution, Uniform};
use std::f64::consts::TAU;
use std::sync::Arc;

/// Sample rate of every sensor, Hz.
pub const SAMPLE_RATE_HZ: f64 = 1000.0;
/// Time between samples, s.
pub const SAMPLE_PERIOD_S: f64 = 1.0 / SAMPLE_RATE_HZ;

table! {
    /// All sensors of the robot, and the accuracy of its assembly and placement.
    pub struct SensorConfig {
        /// Placement accuracy at the start.
        pub placement: PlacementConfig = PlacementConfig::default();
        /// Accuracy of the odometry's constants.
        pub geometry: GeometryConfig = GeometryConfig::default();
        /// Wheel encoders.
        pub encoder: EncoderConfig = EncoderConfig::default();
        /// Yaw-rate gyroscope, one on each axle.
        pub gyro: Gyro = Gyro::default();
        /// Longitudinal accelerometer, one on each axle.
        pub accelerometer: Accelerometer = Accelerometer::default();
        /// Strain bridges on the frame.
        pub bridge: BridgeConfig = BridgeConfig::default();
    }
}

table! {
    /// Placement accuracy at the start.
    pub struct PlacementConfig {
        /// Standard deviation of the start position of O along each axis.
        pub position_sigma_m: f64 = 2e-3, "m": NonNegative;
        /// Standard deviation of the start heading.
        pub heading_sigma_rad: f64 = 2e-3, "rad": NonNegative;
    }
}

table! {
    /// Accuracy of the odometry's constants: ratio of the true value to the value in the robot's
    /// configuration.
    pub struct GeometryConfig {
        /// Relative standard deviation of each wheel's rolling radius.
        pub wheel_radius_sigma: f64 = 1e-3, "": Range(0.0, SMALL);
        /// Relative standard deviation of each axle's effective track.
        pub track_sigma: f64 = 3e-3, "": Range(0.0, SMALL);
    }
}

table! {
    /// Wheel encoders: `counts = floor(angle·counts_per_revolution/2π + phase)`.
    pub struct EncoderConfig {
        /// Counts in one revolution of the wheel, all four edges of the quadrature counted; an encoder of
        /// 500 lines before a gear of 26 to 1 gives 52000.
        pub counts_per_revolution: u32 = 8192, "": Range(1.0, 1_048_576.0);
        /// Age of a sample when the board reads it.
        pub delay_ms: u32 = 0, "ms": Range(0.0, MAX_DELAY_MS as f32);
    }
}

impl GeometryConfig {
    /// Factors of wheel radius and track at the lower (-1) or upper (1) bound of their draws.
    pub fn extreme(&self, side: f64) -> [f64; 2] {
        [self.wheel_radius_sigma, self.track_sigma].map(|sigma| 1.0 + side * BOUND * sigma)
    }
}

impl SensorConfig {
    /// Checks the range of every value.
    pub fn check(&self) -> Result<(), Error> {
        within("sensors.placement", self.placement.check_ranges())?;
        within("sensors.geometry", self.geometry.check_ranges())?;
        within("sensors.encoder", self.encoder.check_ranges())?;
        within("sensors.gyro", self.gyro.check_ranges())?;
        within("sensors.accelerometer", self.accelerometer.check_ranges())?;
        within("sensors.bridge", self.bridge.check())
    }

    /// Draws the errors of one robot's sensors; [`World::draw`](crate::world::World::draw) adds the errors of the
    /// plant, the gain error common to all bridges, and the creep of the gauges. The configuration only scales the
    /// random numbers.
    pub fn draw(&self, topology: Topology, seed: u64, trial: u64) -> Drawn {
        let mut drawn = Drawn::none(topology);

        let mut random = generator(seed, trial, Stream::Geometry);
        for factor in drawn.wheel_radius_factor.as_flattened_mut() {
            *factor += bounded(&mut random, self.geometry.wheel_radius_sigma);
        }
        for factor in &mut drawn.track_factor {
            *factor += bounded(&mut random, self.geometry.track_sigma);
        }

        let mut random = generator(seed, trial, Stream::Placement);
        let place = &self.placement;
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

        for axle in 0..topology.axle_count() {
            let mut random = generator(seed, trial, Stream::Gyro(axle));
            drawn.gyro_bias[axle] = Channel::from(self.gyro).draw_bias(&mut random);
            drawn.gyro_scale_error[axle] = normal(&mut random, self.gyro.scale_sigma);
            let mut random = generator(seed, trial, Stream::Accelerometer(axle));
            drawn.accelerometer_bias[axle] =
                Channel::from(self.accelerometer).draw_bias(&mut random);
            drawn.accelerometer_scale_error[axle] =
                normal(&mut random, self.accelerometer.scale_sigma);
        }

        let bridge = &self.bridge;
        let mut of_common = generator(seed, trial, Stream::BridgeCommon);
        let mut of_converter = generator(seed, trial, Stream::Converter);
        for (frame, drawn) in drawn.frames.iter_mut().enumerate() {
            let common = normal(&mut of_common, bridge.common_sigma_strain);
            drawn.converter = of_converter.random();
            for index in 0..MAX_GAUGES {
                let mut random = generator(seed, trial, Stream::Bridge(frame, index));
                drawn.bridge_gain_error[index] = normal(&mut random, bridge.gain_sigma);
                drawn.bridge_offset[index] = normal(&mut random, bridge.offset_sigma_strain);
                drawn.bridge_drift[index] = common + normal(&mut random, bridge.drift_sigma_strain);
                drawn.gauge_shift_m[index] = normal(&mut random, bridge.position_sigma_m);
                drawn.bridge_zero_per_k[index] =
                    normal(&mut random, bridge.zero_per_k_sigma_strain);
            }
        }
        drawn
    }
}

/// True motion and strains at one instant, the inputs of the sensors.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Truth {
    /// Inputs of the axles' sensors, front first.
    pub axles: Vec<AxleTruth>,
    /// Strains of the outer fibre at the true positions of each frame's gauges, positive where the frame bends left.
    /// Front frame first.
    pub strains: Vec<Vec<f64>>,
}

/// True motion of an axle, the input of its sensors. Wheel 0 is the left wheel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxleTruth {
    /// Angle of each wheel relative to the axle since the start, rad, forward positive.
    pub wheel_angle: [f64; 2],
    /// Yaw rate, rad/s, counter-clockwise positive.
    pub yaw_rate: f64,
    /// Specific force along the forward axis, m/s².
    pub forward_acceleration: f64,
}

/// Outputs of all sensors at one tick.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Samples {
    /// Samples of the axle boards, front first.
    pub axles: Vec<AxleSamples>,
    /// Converter counts of each frame's bridges, zero at mid-scale; zero where there is no gauge. Front frame first.
    pub frames: Vec<[i32; MAX_GAUGES]>,
}

/// Outputs of the sensors on an axle at one tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxleSamples {
    /// Encoder counters by wheel; they wrap around. `None` for an angle that is not finite.
    pub encoder_counts: [Option<i32>; 2],
    /// Yaw rate, rad/s; none where no gyro is fitted.
    pub gyro: Option<f32>,
    /// Longitudinal specific force, m/s²; none where no accelerometer is fitted.
    pub accelerometer: Option<f32>,
}

#[derive(Clone, Debug)]
struct AxleSensors {
    encoder_phase: [f64; 2],
    encoder_delay: Delay<[Option<i32>; 2]>,
    gyro: InertialChannel,
    accelerometer: InertialChannel,
}

/// All sensors of one robot in one trial. Call [`Self::sample`] once a millisecond.
#[derive(Clone, Debug)]
pub struct Sensors {
    counts_per_radian: f64,
    axles: Vec<AxleSensors>,
    /// Bridges of each frame.
    frames: Vec<[Bridge; MAX_GAUGES]>,
    samples: Samples,
}

impl Sensors {
    /// Sensors of a drawn robot in one trial; refuses what [`SensorConfig::check`] refuses.
    pub fn new(config: &SensorConfig, drawn: &Drawn, seed: u64, trial: u64) -> Result<Self, Error> {
        config.check()?;
        // Noise has its own streams, so that it does not depend on how many numbers the draw of the errors took.
        let noise = |stream: Stream| generator(mix(seed), trial, stream);
        let axle = |axle: usize| AxleSensors {
            encoder_phase: drawn.encoder_phase[axle],
            encoder_delay: Delay::new(config.encoder.delay_ms),
            gyro: InertialChannel::new(
                config.gyro.into(),
                drawn.gyro_bias[axle],
                drawn.gyro_scale_error[axle],
                noise(Stream::Gyro(axle)),
            ),
            accelerometer: InertialChannel::new(
                config.accelerometer.into(),
                drawn.accelerometer_bias[axle],
                drawn.accelerometer_scale_error[axle],
                noise(Stream::Accelerometer(axle)),
            ),
        };
        let axles: Vec<_> = (0..drawn.encoder_phase.len()).map(axle).collect();
        let creep = drawn.gauge_creep_error;
        let frame = |(frame, errors): (usize, &FrameErrors)| {
            let converter = config.bridge.converter(errors).map(Arc::new);
            std::array::from_fn(|index| {
                let random = noise(Stream::Bridge(frame, index));
                let converter = converter.clone();
                Bridge::new(&config.bridge, (errors, creep), index, converter, random)
            })
        };
        let frames: Vec<_> = drawn.frames.iter().enumerate().map(frame).collect();
        Ok(Self {
            counts_per_radian: f64::from(config.encoder.counts_per_revolution) / TAU,
            samples: Samples {
                axles: vec![AxleSamples::default(); axles.len()],
                frames: vec![[0; MAX_GAUGES]; frames.len()],
            },
            axles,
            frames,
        })
    }

    /// Biases of the next inertial samples of each axle, after the average at rest: gyro, rad/s, and accelerometer,
    /// m/s². Replaces [`Self::sample`] where the sensors are simulated elsewhere.
    pub fn inertial_biases(&mut self) -> impl Iterator<Item = [f64; 2]> {
        let axles = self.axles.iter_mut();
        axles.map(|axle| [axle.gyro.bias(), axle.accelerometer.bias()])
    }

    /// Adds `strain` to the zeros of all gauges.
    pub fn drift_gauges(&mut self, strain: f64) {
        let bridges = self.frames.iter_mut().flatten();
        bridges.for_each(|bridge| bridge.drift(strain));
    }

    /// Samples of the latest call of [`Self::sample`].
    pub fn samples(&self) -> &Samples {
        &self.samples
    }

    /// Readings 1 ms after the last call; allocates nothing. An axle or gauge missing in `truth` keeps its last
    /// reading. A value that is not finite gives a missing encoder count, NaN of an inertial sensor, or a bridge at the
    /// end of its range.
    pub fn sample(&mut self, truth: &Truth) -> &Samples {
        let axles = self.axles.iter_mut().zip(&truth.axles);
        for (samples, (axle, truth)) in self.samples.axles.iter_mut().zip(axles) {
            let counts = std::array::from_fn(|wheel| {
                let angle = truth.wheel_angle[wheel];
                let counts = (angle * self.counts_per_radian + axle.encoder_phase[wheel]).floor();
                // Through i64: a hardware counter wraps where a float conversion would saturate.
                angle.is_finite().then_some(counts as i64 as i32)
            });
            *samples = AxleSamples {
                encoder_counts: axle.encoder_delay.pass(counts),
                gyro: axle.gyro.sample(truth.yaw_rate),
                accelerometer: axle.accelerometer.sample(truth.forward_acceleration),
            };
        }
        let frames = self.frames.iter_mut().zip(&truth.strains);
        for (samples, (bridges, strains)) in self.samples.frames.iter_mut().zip(frames) {
            for ((counts, bridge), &strain) in samples.iter_mut().zip(bridges).zip(strains) {
                *counts = bridge.sample(strain);
            }
        }
        &self.samples
    }
}
