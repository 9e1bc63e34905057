//! Inertial sensor: an ICM-42688-P on SPI1, its x along the heading and z up.

use core_algos::acquisition::inertial::{Channel, Config};
use core_algos::config::ConfigError;
use core_algos::params;
use embassy_stm32::Peri;
use embassy_stm32::gpio::{Level, Output, Speed};
use embassy_stm32::mode::Blocking;
use embassy_stm32::peripherals::{PA4, PA5, PA6, PA7, SPI1};
use embassy_stm32::spi::mode::Master;
use embassy_stm32::spi::{self, Spi};
use embassy_stm32::time::Hertz;
use embassy_time::Timer;

// Registers of bank 0; the top bit of the address reads.
const DEVICE_CONFIG: u8 = 0x11;
const ACCEL_DATA_X1: u8 = 0x1f;
const PWR_MGMT0: u8 = 0x4e;
const GYRO_CONFIG0: u8 = 0x4f;
const ACCEL_CONFIG0: u8 = 0x50;
const WHO_AM_I: u8 = 0x75;
const READ: u8 = 0x80;
const IDENTITY: u8 = 0x47;
/// ±250 °/s and ±2 g, 1 kHz.
const RANGE_AND_RATE: u8 = 3 << 5 | 6;
/// Both in their low-noise mode.
const LOW_NOISE: u8 = 0x0f;

/// Equal samples in a row after which the sensor is given up until the board restarts.
const STUCK: u8 = 50;

/// What the sensor says; `None` while the bias is not known, and when it does not answer.
#[derive(Clone, Copy, Debug, Default)]
pub struct Reading {
    /// Yaw rate, rad/s.
    pub gyro_rad_s: Option<f32>,
    /// Acceleration along the heading, m/s².
    pub acceleration_m_s2: Option<f32>,
}

/// The sensor.
pub struct Inertial {
    spi: Spi<'static, Blocking, Master>,
    select: Output<'static>,
    gyro: Channel,
    accelerometer: Channel,
    answers: bool,
    last: [u8; 13],
    repeats: u8,
}

impl Inertial {
    /// Sets it up. A sensor that does not answer is reported as such and the board goes on without.
    pub async fn start(
        spi: Peri<'static, SPI1>,
        select: Peri<'static, PA4>,
        clock: Peri<'static, PA5>,
        miso: Peri<'static, PA6>,
        mosi: Peri<'static, PA7>,
        scale: &params::Inertial,
    ) -> Result<Self, ConfigError> {
        let mut config = spi::Config::default();
        config.frequency = Hertz(10_500_000);
        let mut sensor = Self {
            spi: Spi::new_blocking(spi, clock, mosi, miso, config),
            select: Output::new(select, Level::High, Speed::High),
            gyro: scaled(Config::GYRO, scale.gyro_gain)?,
            accelerometer: scaled(Config::ACCELEROMETER, scale.accelerometer_gain)?,
            answers: false,
            last: [0; 13],
            repeats: 0,
        };
        sensor.transfer(&mut [DEVICE_CONFIG, 1]);
        // Data sheet: 1 ms after a reset, 45 ms until the gyroscope is up.
        Timer::after_millis(2).await;
        let mut identity = [WHO_AM_I | READ, 0];
        sensor.answers = sensor.transfer(&mut identity) && identity[1] == IDENTITY;
        for (register, value) in [
            (GYRO_CONFIG0, RANGE_AND_RATE),
            (ACCEL_CONFIG0, RANGE_AND_RATE),
            (PWR_MGMT0, LOW_NOISE),
        ] {
            sensor.transfer(&mut [register, value]);
        }
        Timer::after_millis(60).await;
        Ok(sensor)
    }

    /// Whether the sensor was found and answers.
    pub fn answers(&self) -> bool {
        self.answers
    }

    /// Reads the latest sample, in 10 µs. `still` says that the motors are off.
    pub fn read(&mut self, still: bool) -> Reading {
        let mut frame = [0; 13];
        frame[0] = ACCEL_DATA_X1 | READ;
        if !self.answers || !self.transfer(&mut frame) {
            return Reading::default();
        }
        // Six noisy channels do not repeat themselves: a sensor that does so is gone.
        self.repeats = if frame == self.last {
            self.repeats.saturating_add(1)
        } else {
            0
        };
        self.last = frame;
        self.answers = self.repeats < STUCK;
        // Accelerometer x, y, z, then gyroscope x, y, z, high byte first.
        let [_, ax1, ax0, .., gz1, gz0] = frame;
        Reading {
            gyro_rad_s: self.gyro.step(i16::from_be_bytes([gz1, gz0]), still),
            acceleration_m_s2: self
                .accelerometer
                .step(i16::from_be_bytes([ax1, ax0]), still),
        }
    }

    fn transfer(&mut self, bytes: &mut [u8]) -> bool {
        self.select.set_low();
        let done = self.spi.blocking_transfer_in_place(bytes).is_ok();
        self.select.set_high();
        done
    }
}

/// A channel whose counts are worth `gain` times what the data sheet says.
fn scaled(config: Config, gain: f32) -> Result<Channel, ConfigError> {
    let unit_per_count = gain * config.unit_per_count;
    Config {
        unit_per_count,
        ..config
    }
    .build()
}
