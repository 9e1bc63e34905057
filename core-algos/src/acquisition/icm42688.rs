//! Driver of the inertial sensor ICM-42688-P (TDK InvenSense, DS-000347): set-up of its registers, and one step each
//! millisecond. The sensor's x axis points along the heading, its z axis up.
//!
//! # Rate and filters
//!
//! Sensor and board have separate clocks. At equal rates the board would at times read a sample twice or miss a sample.
//! The sensor therefore runs at 8 kHz, and the board reads the latest sample each millisecond: always a new sample, 0
//! to 125 µs old. Two second-order low-pass filters in the sensor prevent aliasing: anti-alias filter 536 Hz, UI
//! filter 400 Hz. Their delays add to 1.0 ms (√2/2πf each: 0.42 and 0.56 ms), and to 1.0 to 1.1 ms with the age of
//! the sample. A vibration of 1 kHz, which would alias to 0 Hz, is attenuated by 27 dB.
//!
//! # Stalls
//!
//! After a reset the part adapts its full-scale range to the yaw rate (AFSR). Near 100 °/s the range changes and the
//! output freezes for 1 to 2 ms, which biases the heading. The data sheet does not mention AFSR. The set-up switches
//! AFSR off, as open-source flight controllers do (ArduPilot 25332, Betaflight 13132, INAV 9409).
//!
//! # Loss
//!
//! Each read ends with the interrupt status, which reports a reset. One configuration register is read back every
//! [`CHECK_EVERY`] reads, and samples must change. A sensor that fails one of these checks, or returns a wrong
//! identity, is *lost*: it gives no readings and is set up again. It stays lost until both biases are found at the
//! next standstill.
//!
//! # Panic contract
//!
//! [`Icm42688::new`] validates; [`Icm42688::step`] cannot fail, whatever the bus answers.

use super::inertial::{Channel, Config};
use crate::config::ConfigError;

// Registers. The top bit of an address selects a read; the address increments within a transfer.
const READ: u8 = 0x80;
const BANK_SELECT: u8 = 0x76;
// Addresses in register bank 0.
const DEVICE_CONFIG: u8 = 0x11;
const ACCEL_DATA_X1: u8 = 0x1f;
const INT_STATUS: u8 = 0x2d;
const INTF_CONFIG0: u8 = 0x4c;
const INTF_CONFIG1: u8 = 0x4d;
const PWR_MGMT0: u8 = 0x4e;
const GYRO_CONFIG0: u8 = 0x4f;
const ACCEL_CONFIG0: u8 = 0x50;
const GYRO_CONFIG1: u8 = 0x51;
const GYRO_ACCEL_CONFIG0: u8 = 0x52;
const ACCEL_CONFIG1: u8 = 0x53;
const WHO_AM_I: u8 = 0x75;
// Addresses in register bank 1.
const GYRO_CONFIG_STATIC3: u8 = 0x0c;
const GYRO_CONFIG_STATIC4: u8 = 0x0d;
const GYRO_CONFIG_STATIC5: u8 = 0x0e;
// Addresses in register bank 2.
const ACCEL_CONFIG_STATIC2: u8 = 0x03;
const ACCEL_CONFIG_STATIC3: u8 = 0x04;
const ACCEL_CONFIG_STATIC4: u8 = 0x05;

const IDENTITY: u8 = 0x47;
/// Bit of the interrupt status: the sensor has been reset.
const RESET_DONE: u8 = 1 << 4;
/// Range and rate: ±250 °/s for the gyroscope, ±2 g for the accelerometer, 8 kHz. Both registers take the same bits.
const RANGE_AND_RATE: u8 = 3 << 5 | 3;
/// Bandwidth of the UI filters of gyroscope and accelerometer: a twentieth of the sample rate, 400 Hz.
const UI_BANDWIDTH: u8 = 6 << 4 | 6;
/// Delay of anti-alias filter and UI filter plus the mean age of a sample, s.
pub const DELAY_S: f32 = 1.05e-3;
/// Second order of the UI filters; the other bits are the reset values of the two registers.
const GYRO_UI_ORDER: u8 = 0x12 | 1 << 2;
const ACCEL_UI_ORDER: u8 = 0x05 | 1 << 3;
/// Settings of the anti-alias filter for 536 Hz, from the data sheet's table.
const DELTA: u8 = 12;
const DELTA_SQUARED: u8 = 144;
const SHIFT: u8 = 8 << 4;
/// Gyroscope and accelerometer in low-noise mode.
const LOW_NOISE: u8 = 0x0f;
/// I²C off, so that SPI traffic is not mistaken for an I²C address.
const SERIAL_PORT_BITS: u8 = 0x03;
const I2C_OFF: u8 = 0x03;
/// Adaptive full-scale range (AFSR) off. The data sheet does not describe these two bits.
const ADAPTIVE_RANGE_BITS: u8 = 0xc0;
const ADAPTIVE_RANGE_OFF: u8 = 0x40;

/// Register write of the set-up.
struct Write {
    address: u8,
    /// Mask of the bits written. The register's other bits are read first and kept.
    bits: u8,
    value: u8,
    /// Time until the next write, ms.
    pause: u8,
}

/// A write of a whole register.
const fn write(address: u8, value: u8, pause: u8) -> Write {
    Write {
        address,
        bits: !0,
        value,
        pause,
    }
}

/// Set-up sequence. A reset takes 1 ms, the start of the gyroscope 45 ms.
const SET_UP: [Write; 19] = [
    write(BANK_SELECT, 0, 1),
    write(DEVICE_CONFIG, 1, 3),
    write(BANK_SELECT, 1, 1),
    write(GYRO_CONFIG_STATIC3, DELTA, 1),
    write(GYRO_CONFIG_STATIC4, DELTA_SQUARED, 1),
    write(GYRO_CONFIG_STATIC5, SHIFT, 1),
    write(BANK_SELECT, 2, 1),
    write(ACCEL_CONFIG_STATIC2, DELTA << 1, 1),
    write(ACCEL_CONFIG_STATIC3, DELTA_SQUARED, 1),
    write(ACCEL_CONFIG_STATIC4, SHIFT, 1),
    write(BANK_SELECT, 0, 1),
    Write {
        address: INTF_CONFIG0,
        bits: SERIAL_PORT_BITS,
        value: I2C_OFF,
        pause: 1,
    },
    Write {
        address: INTF_CONFIG1,
        bits: ADAPTIVE_RANGE_BITS,
        value: ADAPTIVE_RANGE_OFF,
        pause: 1,
    },
    write(GYRO_CONFIG0, RANGE_AND_RATE, 1),
    write(ACCEL_CONFIG0, RANGE_AND_RATE, 1),
    write(GYRO_CONFIG1, GYRO_UI_ORDER, 1),
    write(GYRO_ACCEL_CONFIG0, UI_BANDWIDTH, 1),
    write(ACCEL_CONFIG1, ACCEL_UI_ORDER, 1),
    write(PWR_MGMT0, LOW_NOISE, 60),
];
/// Step of the set-up after the reset, at which the identity is read.
const AFTER_RESET: usize = 2;

/// Registers that are read back in operation: address, mask of the checked bits, required value of these bits.
const CHECKED: [(u8, u8, u8); 9] = [
    (WHO_AM_I, !0, IDENTITY),
    // Big endian, I²C off.
    (INTF_CONFIG0, 0x33, 0x33),
    // Adaptive range off, clock of the PLL.
    (INTF_CONFIG1, 0xc3, 0x41),
    (PWR_MGMT0, !0, LOW_NOISE),
    (GYRO_CONFIG0, !0, RANGE_AND_RATE),
    (ACCEL_CONFIG0, !0, RANGE_AND_RATE),
    (GYRO_CONFIG1, !0, GYRO_UI_ORDER),
    (GYRO_ACCEL_CONFIG0, !0, UI_BANDWIDTH),
    (ACCEL_CONFIG1, !0, ACCEL_UI_ORDER),
];
/// Number of sample reads between two read-backs of a register.
pub const CHECK_EVERY: u8 = 16;
/// Equal samples in a row after which the sensor is lost: six noisy channels do not repeat.
const STUCK: u8 = 50;
/// Delay before the set-up is repeated after a wrong identity, ms.
const RETRY: u8 = 100;

/// Length of a read: address, three accelerations, three angular rates, time stamp, interrupt status.
const FRAME: usize = 1 + 6 + 6 + 2 + 1;

/// Readings of the sensor. A reading is `None` until its bias is known, after a failed transfer, and for a saturated
/// sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reading {
    /// Yaw rate, rad/s.
    pub gyro_rad_s: Option<f32>,
    /// Acceleration along the heading, m/s².
    pub acceleration_m_s2: Option<f32>,
}

/// State of the driver.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// `wait` milliseconds remain until write `next` of the set-up.
    SetUp { wait: u8, next: u8 },
    /// `check_in` reads remain until a register is read back.
    Running { check_in: u8 },
}

const BEGIN: Phase = Phase::SetUp { wait: 0, next: 0 };

/// Driver of one sensor: set-up, checks and readings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Icm42688 {
    gyro: Channel,
    accelerometer: Channel,
    phase: Phase,
    lost: bool,
    last: [u8; 12],
    repeats: u8,
    /// Register that is read back next, and true if its last value was wrong.
    check: (u8, bool),
}

impl Icm42688 {
    /// Driver of a sensor before its set-up. A gain is the true value of a count divided by the data sheet's value.
    pub fn new(gyro_gain: f32, accelerometer_gain: f32) -> Result<Self, ConfigError> {
        Ok(Self {
            gyro: scaled(Config::GYRO, gyro_gain)?,
            accelerometer: scaled(Config::ACCELEROMETER, accelerometer_gain)?,
            phase: BEGIN,
            lost: false,
            last: [0; 12],
            repeats: 0,
            check: (0, false),
        })
    }

    /// True if the sensor is lost: a check failed, and the biases are not found again yet.
    pub fn is_lost(&self) -> bool {
        self.lost
    }

    /// True if the set-up is complete.
    fn is_set_up(&self) -> bool {
        matches!(self.phase, Phase::Running { .. })
    }

    /// One step, to be called every millisecond. `still` is true while the motors are off; `transfer` exchanges bytes
    /// with the sensor and returns true on success. A step reads at most one sample and one register, or writes one
    /// register. Some steps of the set-up read registers before they write.
    pub fn step(&mut self, still: bool, mut transfer: impl FnMut(&mut [u8]) -> bool) -> Reading {
        match self.phase {
            Phase::SetUp { wait, next } => {
                self.phase = self.set_up(wait, next, &mut transfer);
                Reading::default()
            }
            Phase::Running { check_in } => {
                let reading = self.read(still, &mut transfer);
                match check_in.checked_sub(1) {
                    _ if !self.is_set_up() => {}
                    Some(check_in) => self.phase = Phase::Running { check_in },
                    None => self.read_back(&mut transfer),
                }
                reading
            }
        }
    }

    fn set_up(
        &mut self,
        wait: u8,
        next: u8,
        transfer: &mut impl FnMut(&mut [u8]) -> bool,
    ) -> Phase {
        if let Some(wait) = wait.checked_sub(1) {
            return Phase::SetUp { wait, next };
        }
        if usize::from(next) == AFTER_RESET {
            if register(WHO_AM_I, transfer) != Some(IDENTITY) {
                self.mark_lost();
                return Phase::SetUp {
                    wait: RETRY,
                    next: 0,
                };
            }
            // Clears the flag of this reset, so that the next reset is detected.
            register(INT_STATUS, transfer);
        }
        let Some(step) = SET_UP.get(usize::from(next)) else {
            self.repeats = 0;
            return Phase::Running {
                check_in: CHECK_EVERY,
            };
        };
        let kept = match step.bits {
            0xff => 0,
            bits => match register(step.address, transfer) {
                Some(value) => value & !bits,
                // The bits to be kept are unknown: the write is repeated at the next step.
                None => return Phase::SetUp { wait: 0, next },
            },
        };
        // A failed write is detected when the register is read back.
        transfer(&mut [step.address, kept | step.value]);
        Phase::SetUp {
            wait: step.pause - 1,
            next: next + 1,
        }
    }

    fn read(&mut self, still: bool, transfer: &mut impl FnMut(&mut [u8]) -> bool) -> Reading {
        let mut frame = [0; FRAME];
        frame[0] = ACCEL_DATA_X1 | READ;
        let done = transfer(&mut frame);
        let [_, samples @ .., _, _, status] = frame;
        self.repeats = if done && samples != self.last {
            0
        } else {
            self.repeats.saturating_add(1)
        };
        self.last = samples;
        if status & RESET_DONE != 0 || self.repeats >= STUCK {
            self.mark_lost();
        }
        if !done || !self.is_set_up() {
            return Reading::default();
        }
        // Accelerometer x, y, z, then gyroscope x, y, z, high byte first.
        let [ax1, ax0, .., gz1, gz0] = samples;
        let gyro = i16::from_be_bytes([gz1, gz0]);
        let acceleration = i16::from_be_bytes([ax1, ax0]);
        let reading = Reading {
            gyro_rad_s: self.gyro.step(gyro, still),
            acceleration_m_s2: self.accelerometer.step(acceleration, still),
        };
        self.lost &= !(self.gyro.is_zeroed() && self.accelerometer.is_zeroed());
        reading
    }

    /// Reads a register back. A wrong value is read again at the next step, so that one disturbed transfer does not
    /// lose the sensor.
    fn read_back(&mut self, transfer: &mut impl FnMut(&mut [u8]) -> bool) {
        let (which, repeated) = self.check;
        let (address, bits, expected) = CHECKED[usize::from(which) % CHECKED.len()];
        let right = register(address, transfer).is_some_and(|value| value & bits == expected);
        if !right && repeated {
            self.mark_lost();
        }
        if self.is_set_up() {
            self.phase = Phase::Running {
                check_in: if right { CHECK_EVERY } else { 0 },
            };
        }
        self.check = if right || repeated {
            ((which + 1) % CHECKED.len() as u8, false)
        } else {
            (which, true)
        };
    }

    /// Marks the sensor as lost: restarts the set-up and discards both biases.
    fn mark_lost(&mut self) {
        self.lost = true;
        self.phase = BEGIN;
        self.repeats = 0;
        self.gyro.forget();
        self.accelerometer.forget();
    }
}

/// Value of a register; `None` if the transfer failed.
fn register(address: u8, transfer: &mut impl FnMut(&mut [u8]) -> bool) -> Option<u8> {
    let mut bytes = [address | READ, 0];
    transfer(&mut bytes).then_some(bytes[1])
}

/// Channel of `config` with its value of a count multiplied by `gain`.
fn scaled(config: Config, gain: f32) -> Result<Channel, ConfigError> {
    let unit_per_count = gain * config.unit_per_count;
    Config {
        unit_per_count,
        ..config
    }
    .build()
}

#[cfg(test)]
mod tests;
