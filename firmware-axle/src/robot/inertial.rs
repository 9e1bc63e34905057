//! Inertial sensor: an ICM-42688-P on SPI1, set up and read by [`icm42688`].
//!
//! [`icm42688`]: core_algos::acquisition::icm42688

use core_algos::acquisition::icm42688::{Icm42688, Reading};
use core_algos::config::ConfigError;
use core_algos::params;
use embassy_stm32::Peri;
use embassy_stm32::gpio::{Level, Output, Speed};
use embassy_stm32::mode::Blocking;
use embassy_stm32::peripherals::{PA4, PA5, PA6, PA7, SPI1};
use embassy_stm32::spi::mode::Master;
use embassy_stm32::spi::{self, Spi};
use embassy_stm32::time::Hertz;

/// Inertial sensor of the axle, on its SPI bus.
pub struct Inertial {
    bus: Bus,
    sensor: Icm42688,
}

struct Bus {
    spi: Spi<'static, Blocking, Master>,
    select: Output<'static>,
}

impl Inertial {
    /// Starts the SPI. [`Self::read`] sets the sensor up, so that the start of the board does not wait for the sensor.
    /// If the sensor does not respond, this is reported and the board runs without it.
    pub fn start(
        spi: Peri<'static, SPI1>,
        select: Peri<'static, PA4>,
        clock: Peri<'static, PA5>,
        miso: Peri<'static, PA6>,
        mosi: Peri<'static, PA7>,
        scale: &params::Inertial,
    ) -> Result<Self, ConfigError> {
        let mut config = spi::Config::default();
        config.frequency = Hertz(10_500_000);
        Ok(Self {
            bus: Bus {
                spi: Spi::new_blocking(spi, clock, mosi, miso, config),
                select: Output::new(select, Level::High, Speed::High),
            },
            sensor: Icm42688::new(scale.gyro_gain, scale.accelerometer_gain)?,
        })
    }

    /// True if the sensor responds with its configuration.
    pub fn responds(&self) -> bool {
        !self.sensor.is_lost()
    }

    /// Continues the set-up or reads the latest sample, which takes 12 µs, at times 14 µs. Call every millisecond;
    /// `still` is true if the motors are off.
    pub fn read(&mut self, still: bool) -> Reading {
        let Self { bus, sensor } = self;
        sensor.step(still, |bytes| bus.transfer(bytes))
    }
}

impl Bus {
    fn transfer(&mut self, bytes: &mut [u8]) -> bool {
        self.select.set_low();
        let done = self.spi.blocking_transfer_in_place(bytes).is_ok();
        self.select.set_high();
        done
    }
}
