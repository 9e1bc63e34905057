//! Zeroing of inertial sensors at standstill.
//!
//! A robot with motors off and still wheels neither turns nor accelerates, so gyro and accelerometer read their bias
//! (and the slope of the floor). A scalar Kalman filter estimates the bias, a random walk in white noise, at rest and
//! keeps it while driving.
//!
//! Still wheels alone do not show that an axle does not turn: a bent frame turns an axle on creeping tyres. The gyro
//! therefore also requires the motors to be off until the frame has unwound. Between wheels that roll freely the
//! frame swings for long, too little for the encoders at its turning points; the gyro's readings then differ by more
//! than noise. Creep is steady, so for the accelerometer still wheels are enough.
//!
//! Times are those of an axle node with its default configuration.
//!
//! | condition | reaction | after | until | reason |
//! |---|---|---|---|---|
//! | both encoder counts equal those of the tick before | wheels at rest | 0.1 s | the tick at which a count changes or is missing | a creeping wheel keeps its count for some ticks |
//! | wheels still, motors off, and the gyro's readings since then finite and apart by at most 14 σ of its noise | axle at rest | 0.1 s | the tick at which one of these ends | a swinging frame turns slowest where the encoders see least |
//! | motors on | axle not at rest, wheels as they are | at once | 60 s after the last tick with motors on | the frame unwinds |
//! | motors off since the start | no wait for the frame | at once | motors on | nothing has bent the frame |
//! | no reading of the gyro | gyro does not prevent rest | at once | a reading | axles without a gyro can be at rest too |
//! | at rest, reading finite and at most [`Config::limit`] | bias follows | each reading | end of rest | a reading at rest is bias and noise |
//! | at rest, magnitude of a reading above the limit | bias stays | at once | end of rest | during a motion only a biased selection of readings is within the limit |
//! | not at rest, or no reading, or reading not finite | bias stays, its variance grows | each tick | the variance is that of an unknown bias | random walk |
//! | standard deviation of a measured bias above [`Config::largest_sigma`] | reading withheld | at once | bias measured again | such a bias makes the reading worse than none |
//! | bias never measured | bias taken as 0 | at once | bias measured | calibration has removed the bias |
//! | reading not finite | reading passed on | at once | the next reading | the receiver counts it |
//!
//! [`Config::build`] validates; after it nothing fails or panics. Cost per tick: one division at rest, else one
//! addition.

use crate::config::{ConfigError, declare, positive};
use crate::math::trig::sqrt;
use crate::topology::Wheels;

declare! {
    /// Parameters of one sensor, in its unit: rad/s for a gyro, m/s² for an accelerometer.
    pub struct Config {
        /// Largest accepted magnitude of a bias.
        pub limit: f32 = Self::GYRO.limit, "rad/s or m/s²": Positive;
        /// Density of the white noise, one-sided.
        pub noise_per_sqrt_hz: f32 = Self::GYRO.noise_per_sqrt_hz, "rad/s/√Hz or m/s²/√Hz": Positive;
        /// Random walk of the bias.
        pub walk_per_sqrt_s: f32 = Self::GYRO.walk_per_sqrt_s, "rad/s/√s or m/s²/√s": NonNegative;
        /// Largest standard deviation of a measured bias; above it readings are withheld until the bias is measured
        /// again.
        pub largest_sigma: f32 = Self::GYRO.largest_sigma, "rad/s or m/s²": Positive;
    }
}

impl Config {
    /// Parameters for a yaw-rate gyro of the ICM-42688 class, with or without averaging at power-up.
    pub const GYRO: Self = Self {
        limit: 0.05,
        noise_per_sqrt_hz: 4.9e-5,
        walk_per_sqrt_s: 5e-5,
        // Up to this bias the gyro is better than wheels on creeping tyres.
        largest_sigma: 0.01,
    };
    /// Parameters for an accelerometer of the ICM-42688 class. The limit is the gravity along a floor inclined by 3°.
    pub const ACCELEROMETER: Self = Self {
        limit: 0.5,
        noise_per_sqrt_hz: 6.9e-4,
        walk_per_sqrt_s: 5e-3,
        // The standard deviation reaches this value after half a minute without rest. A bias of this size makes an axle
        // at rest appear to move at a few mm/s.
        largest_sigma: 0.03,
    };

    /// Builds the zeroing for one sample every `period_s`; an error names the parameter out of range.
    pub fn build(&self, period_s: f32) -> Result<Zeroing, ConfigError> {
        let period = positive("period_s", period_s)?;
        self.check_ranges()?;
        let Self {
            limit,
            noise_per_sqrt_hz: noise,
            walk_per_sqrt_s: walk,
            largest_sigma: largest,
        } = *self;
        Ok(Zeroing {
            limit,
            // The bandwidth of the noise is half the sample rate.
            noise: 0.5 * noise * noise / period,
            walk: walk * walk * period,
            // Variance of a bias that is uniform within ± the limit.
            unknown: limit * limit / 3.0,
            largest: largest * largest,
        })
    }
}

/// Zeroing of one sensor with checked parameters: estimates the bias at standstill and subtracts it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Zeroing {
    limit: f32,
    /// Variance of the noise of a sample.
    noise: f32,
    /// Variance of the bias's change from sample to sample.
    walk: f32,
    /// Variance of a bias that was never measured.
    unknown: f32,
    /// Variance above which a measured bias counts as unknown.
    largest: f32,
}

/// Bias of one sensor: estimate and variance.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Bias {
    value: f32,
    /// Variance of the estimate; `None` before the first reading at rest.
    variance: Option<f32>,
    /// True if a reading of the current rest was beyond the limit.
    beyond: bool,
}

impl Bias {
    /// Estimated bias, in the sensor's unit.
    pub fn value(&self) -> f32 {
        self.value
    }
}

/// Limit of the difference between gyro readings at rest, in standard deviations of the noise. Noise alone stays below
/// this limit for days.
const SPREAD: f32 = 14.0;

impl Zeroing {
    /// Limit of the difference between readings at rest, in the sensor's unit.
    pub fn spread(&self) -> f32 {
        SPREAD * sqrt(self.noise)
    }

    /// Takes one sample. Returns the reading less the bias, or `None` while a measured bias counts as unknown. A
    /// reading that is not finite is passed on.
    pub fn step(&self, bias: &mut Bias, at_rest: bool, reading: Option<f32>) -> Option<f32> {
        let variance = bias.variance.map(|v| (v + self.walk).min(self.unknown));
        bias.variance = variance;
        bias.beyond &= at_rest;
        let reading = reading?;
        bias.beyond |= at_rest && reading.abs() > self.limit;
        if at_rest && !bias.beyond && reading.is_finite() {
            let before = variance.unwrap_or(self.unknown);
            let gain = before / (before + self.noise);
            bias.value += gain * (reading - bias.value);
            bias.variance = Some(gain * self.noise);
        }
        let known = bias
            .variance
            .is_none_or(|variance| variance <= self.largest);
        (known || !reading.is_finite()).then_some(reading - bias.value)
    }
}

/// Thresholds of the rest detector; times in ticks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestTimes {
    /// Time for which the wheels must be still and, for the gyro, the motors off.
    pub hold: u16,
    /// For the gyro: shortest time since the motors were last on.
    pub settle: u32,
    /// For the gyro: limit of the difference between readings since the rest began, rad/s.
    pub spread: f32,
}

/// Detects that an axle has stood still for some time, by its encoders, motors and gyro.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestDetector {
    counts: Wheels<Option<i32>>,
    still: u16,
    off: u16,
    /// Ticks since the motors were last on.
    since_on: u32,
    /// Lowest and highest reading of the gyro since rest was last interrupted; `None` before the first reading.
    readings: Option<[f32; 2]>,
}

impl Default for RestDetector {
    /// State at power-up: the motors have never been on.
    fn default() -> Self {
        Self {
            counts: Wheels::both(None),
            still: 0,
            off: 0,
            since_on: u32::MAX,
            readings: None,
        }
    }
}

/// Rest of the wheels and of the axle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Rest {
    /// True if both wheels have kept their counts for the hold time.
    pub wheels: bool,
    /// True if the axle does not turn either: motors off for long enough, gyro readings within the spread.
    pub axle: bool,
}

impl RestDetector {
    /// Runs one tick with the encoder counts of the wheels, the state of the motors and the gyro's reading (rad/s).
    pub fn step(
        &mut self,
        counts: Wheels<Option<i32>>,
        motors_on: bool,
        gyro: Option<f32>,
        times: &RestTimes,
    ) -> Rest {
        let still = counts.left.is_some() && counts.right.is_some() && counts == self.counts;
        self.counts = counts;
        let count = |before: u16, still: bool| if still { before.saturating_add(1) } else { 0 };
        self.still = count(self.still, still);
        self.since_on = if motors_on {
            0
        } else {
            self.since_on.saturating_add(1)
        };
        let mut quiet = still && !motors_on;
        if self.off == 0 {
            self.readings = None;
        }
        if let Some(reading) = gyro {
            let [low, high] = self.readings.unwrap_or([reading; 2]);
            let (low, high) = (low.min(reading), high.max(reading));
            // A reading that is not finite ends the rest too.
            quiet &= reading.is_finite() && high - low <= times.spread;
            self.readings = Some([low, high]);
        }
        self.off = count(self.off, quiet);
        Rest {
            wheels: self.still >= times.hold,
            axle: self.off >= times.hold && self.since_on >= times.settle,
        }
    }
}

#[cfg(test)]
mod tests;
