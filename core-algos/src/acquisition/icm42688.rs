//! The inertial sensor ICM-42688-P (TDK InvenSense, DS-000347): its registers, and what a driver does
//! each millisecond. Its x points along the heading and its z up.
//!
//! # Rate and filters
//!
//! Sensor and board have clocks of their own. At equal rates a board would now and then read a sample
//! twice or miss one, so the sensor runs at 8 kHz and the board takes the latest sample each
//! millisecond: another one every time, 0 to 125 µs old. What would alias is filtered before, by two
//! second-order low-passes in the sensor: anti-alias filter 536 Hz, UI filter 400 Hz. Together they
//! delay by 1.0 ms (√2/2πf each: 0.42 and 0.56 ms), the age of the sample included by 1.0 to 1.1 ms,
//! and take 27 dB from a vibration of 1 kHz, which would alias to standstill.
//!
//! # Loss
//!
//! Each read ends with the interrupt status, which tells of a reset. Besides, one register of the
//! configuration is read back every [`CHECK_EVERY`] reads, and samples must change. A sensor that
//! failed one of these, or does not know its name, is *lost*: it gives nothing, is set up again, and
//! its biases are sought anew at the next standstill. Only when they are known it is there again.
//!
//! # Panic contract
//!
//! [`Icm42688::new`] validates; [`Icm42688::step`] cannot fail, whatever the bus answers.

use super::inertial::{Channel, Config};
use crate::config::ConfigError;

// Registers; the top bit of an address reads, and the address rises along a transfer.
const READ: u8 = 0x80;
const BANK_SELECT: u8 = 0x76;
// Bank 0.
const DEVICE_CONFIG: u8 = 0x11;
const ACCEL_DATA_X1: u8 = 0x1f;
const INT_STATUS: u8 = 0x2d;
const PWR_MGMT0: u8 = 0x4e;
const GYRO_CONFIG0: u8 = 0x4f;
const ACCEL_CONFIG0: u8 = 0x50;
const GYRO_CONFIG1: u8 = 0x51;
const GYRO_ACCEL_CONFIG0: u8 = 0x52;
const ACCEL_CONFIG1: u8 = 0x53;
const WHO_AM_I: u8 = 0x75;
// Bank 1.
const GYRO_CONFIG_STATIC3: u8 = 0x0c;
const GYRO_CONFIG_STATIC4: u8 = 0x0d;
const GYRO_CONFIG_STATIC5: u8 = 0x0e;
// Bank 2.
const ACCEL_CONFIG_STATIC2: u8 = 0x03;
const ACCEL_CONFIG_STATIC3: u8 = 0x04;
const ACCEL_CONFIG_STATIC4: u8 = 0x05;

const IDENTITY: u8 = 0x47;
/// Interrupt status: a reset was done.
const RESET_DONE: u8 = 1 << 4;
/// ±250 °/s and ±2 g, 8 kHz.
const RANGE_AND_RATE: u8 = 3 << 5 | 3;
/// A twentieth of the rate, 400 Hz, for both.
const UI_BANDWIDTH: u8 = 6 << 4 | 6;
/// Second order; the other fields as after a reset.
const GYRO_UI_ORDER: u8 = 0x12 | 1 << 2;
const ACCEL_UI_ORDER: u8 = 0x05 | 1 << 3;
/// Anti-alias filter of 536 Hz: three numbers of the data sheet's table.
const DELTA: u8 = 12;
const DELTA_SQUARED: u8 = 144;
const SHIFT: u8 = 8 << 4;
/// Both sensors in their low-noise mode.
const LOW_NOISE: u8 = 0x0f;

/// One write of the set-up and the milliseconds until the next.
struct Write(u8, u8, u8);

/// The set-up. A reset takes 1 ms, the gyroscope 45 ms to come up.
const SET_UP: [Write; 17] = [
    Write(BANK_SELECT, 0, 1),
    Write(DEVICE_CONFIG, 1, 3),
    Write(BANK_SELECT, 1, 1),
    Write(GYRO_CONFIG_STATIC3, DELTA, 1),
    Write(GYRO_CONFIG_STATIC4, DELTA_SQUARED, 1),
    Write(GYRO_CONFIG_STATIC5, SHIFT, 1),
    Write(BANK_SELECT, 2, 1),
    Write(ACCEL_CONFIG_STATIC2, DELTA << 1, 1),
    Write(ACCEL_CONFIG_STATIC3, DELTA_SQUARED, 1),
    Write(ACCEL_CONFIG_STATIC4, SHIFT, 1),
    Write(BANK_SELECT, 0, 1),
    Write(GYRO_CONFIG0, RANGE_AND_RATE, 1),
    Write(ACCEL_CONFIG0, RANGE_AND_RATE, 1),
    Write(GYRO_CONFIG1, GYRO_UI_ORDER, 1),
    Write(GYRO_ACCEL_CONFIG0, UI_BANDWIDTH, 1),
    Write(ACCEL_CONFIG1, ACCEL_UI_ORDER, 1),
    Write(PWR_MGMT0, LOW_NOISE, 60),
];
/// Place in the set-up after the reset: the sensor is asked for its name.
const AFTER_RESET: usize = 2;

/// What is read back, and what it must be.
const CHECKED: [(u8, u8); 7] = [
    (WHO_AM_I, IDENTITY),
    (PWR_MGMT0, LOW_NOISE),
    (GYRO_CONFIG0, RANGE_AND_RATE),
    (ACCEL_CONFIG0, RANGE_AND_RATE),
    (GYRO_CONFIG1, GYRO_UI_ORDER),
    (GYRO_ACCEL_CONFIG0, UI_BANDWIDTH),
    (ACCEL_CONFIG1, ACCEL_UI_ORDER),
];
/// Reads between two registers that are read back.
pub const CHECK_EVERY: u8 = 16;
/// Equal samples in a row after which the sensor is lost: six noisy channels do not repeat.
const STUCK: u8 = 50;
/// Milliseconds until a sensor that does not know its name is asked again.
const RETRY: u8 = 100;

/// Address, three accelerations, three yaw rates, a time stamp, the interrupt status.
const FRAME: usize = 1 + 6 + 6 + 2 + 1;

/// What the sensor says; `None` while the bias is not known, and when it is lost.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reading {
    /// Yaw rate, rad/s.
    pub gyro_rad_s: Option<f32>,
    /// Acceleration along the heading, m/s².
    pub acceleration_m_s2: Option<f32>,
}

/// Where the driver stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Milliseconds to wait, then the next write of the set-up.
    SetUp { wait: u8, next: u8 },
    /// Reads until a register is read back.
    Running { check_in: u8 },
}

const BEGIN: Phase = Phase::SetUp { wait: 0, next: 0 };

/// The sensor's driver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Icm42688 {
    gyro: Channel,
    accelerometer: Channel,
    phase: Phase,
    lost: bool,
    last: [u8; 12],
    repeats: u8,
    /// Which register is read back next, and whether it was wrong when last read.
    check: (u8, bool),
}

impl Icm42688 {
    /// A sensor not set up yet, whose readings are worth these gains times what the data sheet says.
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

    /// Whether the sensor is lost: it did not answer, was reset or stuck, and its biases are not
    /// known again yet.
    pub fn is_lost(&self) -> bool {
        self.lost
    }

    /// Whether the set-up is through.
    pub fn is_set_up(&self) -> bool {
        matches!(self.phase, Phase::Running { .. })
    }

    /// To be called every millisecond. `still` says that the motors are off; `transfer` exchanges
    /// bytes with the sensor and says whether that worked. At most one read and one of two bytes, or
    /// one write, pass the bus; after a reset two reads of two bytes and a write.
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
                self.lose();
                return Phase::SetUp {
                    wait: RETRY,
                    next: 0,
                };
            }
            // Forgets this reset, so that the next one is seen.
            register(INT_STATUS, transfer);
        }
        let Some(&Write(address, value, pause)) = SET_UP.get(usize::from(next)) else {
            self.repeats = 0;
            return Phase::Running {
                check_in: CHECK_EVERY,
            };
        };
        // A write that failed shows when the register is read back.
        transfer(&mut [address, value]);
        Phase::SetUp {
            wait: pause - 1,
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
            self.lose();
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

    /// Reads a register back. One that is wrong is read again at the next step, so that a disturbed
    /// transfer is no loss.
    fn read_back(&mut self, transfer: &mut impl FnMut(&mut [u8]) -> bool) {
        let (which, doubted) = self.check;
        let (address, expected) = CHECKED[usize::from(which) % CHECKED.len()];
        let right = register(address, transfer) == Some(expected);
        if !right && doubted {
            self.lose();
        }
        if self.is_set_up() {
            self.phase = Phase::Running {
                check_in: if right { CHECK_EVERY } else { 0 },
            };
        }
        self.check = if right || doubted {
            ((which + 1) % CHECKED.len() as u8, false)
        } else {
            (which, true)
        };
    }

    /// The sensor is set up again from the beginning, and its biases are not believed.
    fn lose(&mut self) {
        self.lost = true;
        self.phase = BEGIN;
        self.repeats = 0;
        self.gyro.forget();
        self.accelerometer.forget();
    }
}

/// A register's value.
fn register(address: u8, transfer: &mut impl FnMut(&mut [u8]) -> bool) -> Option<u8> {
    let mut bytes = [address | READ, 0];
    transfer(&mut bytes).then_some(bytes[1])
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

#[cfg(test)]
mod tests {
    use super::*;

    /// The sensor as its data sheet says: banks of registers, of which only those are kept that have
    /// a meaning here, and samples that vary once it is powered up.
    struct Part {
        banks: [[u8; 128]; 3],
        bank: usize,
        /// Bytes on the wire in the latest step.
        bytes: usize,
        noise: u32,
        yaw_counts: i16,
        mute: bool,
        frozen: bool,
    }

    impl Part {
        fn new() -> Self {
            let mut part = Self {
                banks: [[0; 128]; 3],
                bank: 0,
                bytes: 0,
                noise: 1,
                yaw_counts: 0,
                mute: false,
                frozen: false,
            };
            part.reset();
            part
        }

        /// Values after a reset, from the register map.
        fn reset(&mut self) {
            self.banks = [[0; 128]; 3];
            self.bank = 0;
            let values = [
                (0, 0x2d, 0x10),
                (0, 0x4f, 0x06),
                (0, 0x50, 0x06),
                (0, 0x51, 0x16),
                (0, 0x52, 0x11),
                (0, 0x53, 0x0d),
                (0, 0x75, 0x47),
                (1, 0x0c, 0x0d),
                (1, 0x0d, 0xaa),
                (1, 0x0e, 0x80),
                (2, 0x03, 0x30),
                (2, 0x04, 0x40),
                (2, 0x05, 0x62),
            ];
            for (bank, address, value) in values {
                self.banks[bank][address] = value;
            }
        }

        fn sample(&mut self) {
            let on = self.banks[0][0x4e] == 0x0f;
            for axis in 0..6 {
                self.noise = self
                    .noise
                    .wrapping_mul(1_664_525)
                    .wrapping_add(1_013_904_223);
                let noise = (self.noise >> 29) as i16 - 4;
                let value = match (on, axis) {
                    (false, _) => i16::MIN,
                    (true, 5) => self.yaw_counts + noise,
                    (true, 2) => 16_384 + noise,
                    (true, _) => noise,
                };
                let [high, low] = value.to_be_bytes();
                self.banks[0][0x1f + 2 * axis] = high;
                self.banks[0][0x20 + 2 * axis] = low;
            }
        }

        fn transfer(&mut self, bytes: &mut [u8]) -> bool {
            self.bytes += bytes.len();
            if !self.frozen {
                self.sample();
            }
            let first = usize::from(bytes[0] & 0x7f);
            let read = bytes[0] & 0x80 != 0;
            for (address, byte) in (first..).zip(&mut bytes[1..]) {
                let bank = if address == 0x76 { 0 } else { self.bank };
                let cell = &mut self.banks[bank][address];
                match (read, self.mute) {
                    (true, true) => *byte = 0xff,
                    (true, false) => {
                        *byte = *cell;
                        if (bank, address) == (0, 0x2d) {
                            *cell = 0;
                        }
                    }
                    (false, true) => {}
                    (false, false) if address == 0x76 => self.bank = usize::from(*byte),
                    (false, false) if (bank, address) == (0, 0x11) => {
                        if *byte == 1 {
                            self.reset();
                        }
                    }
                    (false, false) => *cell = *byte,
                }
            }
            true
        }
    }

    fn step(sensor: &mut Icm42688, part: &mut Part, still: bool) -> Reading {
        part.bytes = 0;
        let reading = sensor.step(still, |bytes| part.transfer(bytes));
        // 10.5 MHz: 18 bytes are 14 µs.
        assert!(part.bytes <= 18, "{}", part.bytes);
        reading
    }

    /// A sensor that ran for so many milliseconds, motors off.
    fn after(ms: usize) -> (Icm42688, Part) {
        let (mut sensor, mut part) = (Icm42688::new(1.0, 1.0).unwrap(), Part::new());
        for _ in 0..ms {
            step(&mut sensor, &mut part, true);
        }
        (sensor, part)
    }

    #[test]
    fn registers_are_those_of_the_data_sheet() {
        let (sensor, part) = after(100);
        assert!(sensor.is_set_up() && !sensor.is_lost());
        assert_eq!(part.bank, 0);
        // ±250 °/s and ±2 g at 8 kHz, UI filters of second order at a twentieth of that.
        assert_eq!(
            part.banks[0][0x4e..0x54],
            [0x0f, 0x63, 0x63, 0x16, 0x66, 0x0d]
        );
        // 536 Hz: delta 12, its square 144, shift 8; for the accelerometer beside a disable bit.
        assert_eq!(part.banks[1][0x0c..0x0f], [0x0c, 0x90, 0x80]);
        assert_eq!(part.banks[2][0x03..0x06], [0x18, 0x90, 0x80]);
    }

    #[test]
    fn a_warm_start_finds_its_bank() {
        let (mut sensor, mut part) = (Icm42688::new(1.0, 1.0).unwrap(), Part::new());
        part.bank = 2;
        for _ in 0..100 {
            step(&mut sensor, &mut part, true);
        }
        assert!(sensor.is_set_up() && !sensor.is_lost());
        assert_eq!(part.banks[0][0x52], 0x66);
    }

    #[test]
    fn yaw_rate_is_read_once_the_bias_is_known() {
        let (mut sensor, mut part) = after(1200);
        part.yaw_counts = 1310;
        let reading = step(&mut sensor, &mut part, false);
        // 131 counts per °/s, the noise of the part ±4 counts.
        let yaw = reading.gyro_rad_s.unwrap();
        assert!((yaw - 10f32.to_radians()).abs() < 6e-4, "{yaw}");
        assert!(reading.acceleration_m_s2.unwrap().abs() < 6e-3);
        for gain in [0.0, f32::NAN] {
            assert!(Icm42688::new(gain, 1.0).is_err());
        }
    }

    /// Lost at once, set up again, and back after a second of standstill, not before.
    #[test]
    fn a_reset_is_seen_at_once_and_the_bias_is_sought_anew() {
        let (mut sensor, mut part) = after(1200);
        part.reset();
        assert_eq!(step(&mut sensor, &mut part, false), Reading::default());
        assert!(sensor.is_lost());
        for _ in 0..5000 {
            assert_eq!(step(&mut sensor, &mut part, false), Reading::default());
        }
        assert!(sensor.is_lost() && sensor.is_set_up());
        assert_eq!(
            part.banks[0][0x4e..0x54],
            [0x0f, 0x63, 0x63, 0x16, 0x66, 0x0d]
        );
        for _ in 0..1000 {
            step(&mut sensor, &mut part, true);
        }
        assert!(!sensor.is_lost());
        assert!(step(&mut sensor, &mut part, false).gyro_rad_s.is_some());
    }

    #[test]
    fn a_changed_register_is_found_and_a_disturbed_transfer_is_not_a_loss() {
        for address in [0x4e, 0x4f, 0x50, 0x51, 0x52, 0x53] {
            let (mut sensor, mut part) = after(1200);
            part.banks[0][address] ^= 0x01;
            let until = (0..).find(|_| {
                step(&mut sensor, &mut part, false);
                sensor.is_lost()
            });
            // Seven registers, one every 17 ms.
            assert!(until.unwrap() <= 7 * 17 + 1, "{address:#x}: {until:?}");
        }
        let (mut sensor, mut part) = after(1200);
        let mut asked = 0;
        for _ in 0..3000 {
            sensor.step(false, |bytes| {
                let done = part.transfer(bytes);
                if bytes.len() == 2 {
                    asked += 1;
                    bytes[1] ^= if asked % 2 == 0 { 0x80 } else { 0 };
                }
                done
            });
        }
        assert!(asked > 100);
        assert!(!sensor.is_lost());
    }

    #[test]
    fn a_line_that_is_stuck_or_a_frozen_sample_is_a_loss() {
        let low = |bytes: &mut [u8]| {
            bytes.fill(0);
            true
        };
        let fails = |_: &mut [u8]| false;
        // Low: by the registers read back; no transfer at all: as if nothing changed.
        type Transfer = fn(&mut [u8]) -> bool;
        let broken: [(Transfer, usize); 2] = [(low, 18), (fails, 51)];
        for (transfer, within) in broken {
            let (mut sensor, _) = after(1200);
            let steps = (1..).find(|_| {
                sensor.step(false, transfer);
                sensor.is_lost()
            });
            assert!(steps.unwrap() <= within, "{steps:?}");
        }
        // High: the status tells of a reset.
        let (mut sensor, mut part) = after(1200);
        part.mute = true;
        step(&mut sensor, &mut part, false);
        assert!(sensor.is_lost());
        // Asked again until it answers.
        for _ in 0..1000 {
            assert_eq!(step(&mut sensor, &mut part, true), Reading::default());
        }
        part.mute = false;
        for _ in 0..1300 {
            step(&mut sensor, &mut part, true);
        }
        assert!(!sensor.is_lost());

        let (mut sensor, mut part) = after(1200);
        part.frozen = true;
        let steps = (1..).find(|_| {
            step(&mut sensor, &mut part, false);
            sensor.is_lost()
        });
        assert!(steps.unwrap() <= 51, "{steps:?}");
    }

    #[test]
    fn a_sensor_that_is_not_there_is_lost() {
        let (mut sensor, mut part) = (Icm42688::new(1.0, 1.0).unwrap(), Part::new());
        part.mute = true;
        for _ in 0..10 {
            step(&mut sensor, &mut part, true);
        }
        assert!(sensor.is_lost() && !sensor.is_set_up());
    }
}
