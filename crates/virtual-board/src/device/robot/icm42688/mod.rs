//! ICM-42688-P inertial sensor on an SPI bus.
//!
//! Data sheet: TDK InvenSense DS-000347, "ICM-42688-P".
//!
//! Modelled: register banks 0 to 2; soft reset; power modes with their start-up times; ranges and data rates of the
//! low-noise mode; the anti-alias filter (second order) and the user-interface filter (order and bandwidth;
//! Butterworth, since the data sheet gives only orders and cut-off frequencies); samples timed by the sensor's own
//! oscillator; noise, bias and scale error; quantization and saturation; data registers latched while the chip is
//! selected; INT_STATUS, cleared by a read.
//!
//! The adaptive full-scale range (bits 7 and 6 of INTF_CONFIG1, on after a reset) is not in the data sheet. It is
//! modelled as described by open-source flight controllers (ArduPilot 25332, Betaflight 13132, INAV 9409).
//!
//! Not modelled, and recorded when the program enables them ([`Icm42688::findings`]): FIFO, time stamps, FSYNC,
//! low-power mode, temperature, motion detection, self-test, offsets (bank 4), INT1, INT2, little-endian data, other
//! clock sources. The notch filter is not modelled either, whatever its setting.

mod path;
mod registers;

use crate::device::span_s;
use crate::finding::{FindingKind, Findings};
use crate::time::Time;
use path::{Adaptive, Errors, Path, Settings, Truth};
use registers::*;

/// Standard gravity, m/s².
const GRAVITY: f64 = 9.80665;
const RESET_TIME: Time = Time::from_micros(1000);
/// Time after gyroscope or accelerometer are switched on in which no register may be written.
const QUIET_TIME: Time = Time::from_micros(200);
/// Shortest time for which the gyroscope must stay on.
const MIN_ON: Time = Time::from_micros(45_000);

// Bits of INT_STATUS.
const RESET_DONE: u8 = 0x10;
const DATA_READY: u8 = 0x08;

characteristics! {
    /// Errors of a sensor, and its start-up times.
    pub struct InertialConfig {
        /// Noise density of the gyroscope, rad/s/√Hz. Data sheet: 2.8 millidegree/s/√Hz.
        pub gyro_density: f64 = 2.8e-3f64.to_radians();
        /// Bias of the gyroscope, rad/s. Data sheet: ±0.5 °/s.
        pub gyro_bias: [f64; 3] = [0.0; 3];
        /// Scale error of the gyroscope, relative. Data sheet: ±0.5 %.
        pub gyro_scale: [f64; 3] = [0.0; 3];
        /// Noise density of the accelerometer, m/s²/√Hz. Data sheet: 65 to 70 µg/√Hz.
        pub accel_density: f64 = 70e-6 * GRAVITY;
        /// Bias of the accelerometer, m/s². Data sheet: ±20 mg.
        pub accel_bias: [f64; 3] = [0.0; 3];
        /// Scale error of the accelerometer, relative. Data sheet: ±0.5 %.
        pub accel_scale: [f64; 3] = [0.0; 3];
        /// Relative frequency error of the sensor's oscillator, positive if fast. Data sheet: up to ±1 % at 25 °C.
        pub clock_error: f64 = 0.0;
        /// Start-up time of the gyroscope to its first sample. Data sheet: 30 ms typical. The default is 45 ms, the
        /// shortest time for which the gyroscope must stay on.
        pub gyro_start: Time = Time::from_micros(45_000);
        /// Start-up time of the accelerometer to its first sample. Data sheet: 10 ms.
        pub accel_start: Time = Time::from_micros(10_000);
        /// Angular rate at which the adaptive full-scale range (AFSR) changes, rad/s. ArduPilot: near 100 °/s.
        pub adaptive_rate: f64 = 100f64.to_radians();
        /// Time for which the gyroscope's output stalls after a change of the adaptive range. ArduPilot: near 2 ms.
        pub adaptive_stall: Time = Time::from_micros(2_000);
    }
}

/// True motion of the sensor in its own axes, with derivatives.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Angular rates about the sensor's axes, rad/s.
    pub rate: [f64; 3],
    /// Derivatives of the angular rates, rad/s².
    pub rate_slope: [f64; 3],
    /// Specific forces, m/s²: acceleration minus gravity; at rest with z up, +9.81 on z.
    pub force: [f64; 3],
    /// Derivatives of the specific forces, m/s³.
    pub force_slope: [f64; 3],
}

/// Faults of a sensor; several may be present at once.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InertialFault {
    /// Level at which the output line is stuck; `None` if the line works.
    pub stuck_output: Option<bool>,
    /// True if the data registers are frozen; everything else works.
    pub frozen: bool,
    /// True if the data-ready bit stays clear.
    pub no_data_ready: bool,
}

/// State of an SPI transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Transfer {
    Idle,
    Address,
    Read(u8),
    Write(u8),
}

/// The sensor.
#[derive(Clone, Debug)]
pub struct Icm42688 {
    config: InertialConfig,
    fault: InertialFault,
    findings: Findings,
    banks: [[u8; 128]; 3],
    bank: u8,
    transfer: Transfer,
    /// End of the present reset; `None` if no reset is in progress.
    resetting: Option<Time>,
    status: u8,
    gyro: Path,
    accel: Path,
    /// Data registers from ACCEL_DATA_X1 on, and their latched values during a transfer.
    data: [i16; 6],
    shown: [i16; 6],
    quiet_until: Time,
    gyro_on_since: Option<Time>,
}

impl Icm42688 {
    /// A sensor whose power comes on at time 0.
    pub fn new(config: InertialConfig, seed: u64) -> Self {
        let settings = Settings {
            rate_hz: 1000.0,
            unit: 1.0,
            anti_alias_hz: f64::INFINITY,
            corner_hz: f64::INFINITY,
            order: 1,
        };
        let gyro = Errors {
            density: config.gyro_density,
            bias: config.gyro_bias,
            scale: config.gyro_scale,
        };
        let accel = Errors {
            density: config.accel_density,
            bias: config.accel_bias,
            scale: config.accel_scale,
        };
        let mut sensor = Self {
            config,
            fault: InertialFault::default(),
            findings: Findings::default(),
            banks: [[0; 128]; 3],
            bank: 0,
            transfer: Transfer::Idle,
            resetting: None,
            status: 0,
            gyro: Path::new(gyro, settings, config.clock_error, seed),
            accel: Path::new(accel, settings, config.clock_error, !seed),
            data: [i16::MIN; 6],
            shown: [i16::MIN; 6],
            quiet_until: Time(0),
            gyro_on_since: None,
        };
        sensor.reset(Time(0));
        sensor
    }

    /// Sets the true motion from `at` on.
    pub fn motion(&mut self, at: Time, motion: Motion) {
        self.advance(at);
        self.gyro.truth = Truth {
            at,
            value: motion.rate,
            slope: motion.rate_slope,
        };
        self.accel.truth = Truth {
            at,
            value: motion.force,
            slope: motion.force_slope,
        };
    }

    /// Sets or clears faults.
    pub fn set_fault(&mut self, at: Time, fault: InertialFault) {
        self.advance(at);
        self.fault = fault;
    }

    /// Resets the sensor: by the program, after a power failure, or spontaneously.
    pub fn reset(&mut self, at: Time) {
        self.advance(at);
        self.banks = [[0; 128]; 3];
        for r in REGISTERS {
            self.banks[usize::from(r.bank)][usize::from(r.address)] = r.reset;
        }
        self.bank = 0;
        self.status = 0;
        self.gyro.switch(None);
        self.accel.switch(None);
        self.gyro_on_since = None;
        self.quiet_until = at;
        self.data = [i16::MIN; 6];
        self.shown = self.data;
        self.resetting = Some(at + RESET_TIME);
        self.apply(at);
    }

    /// Uses of unmodelled features, and violations of the data sheet.
    pub fn findings(&self) -> &Findings {
        &self.findings
    }

    fn note(&mut self, at: Time, text: impl Into<String>) {
        self.findings.note(FindingKind::NotModelled, 0, at, text);
    }

    /// Sets the select line: low means selected.
    pub fn select(&mut self, low: bool, at: Time) {
        self.advance(at);
        let was = self.transfer != Transfer::Idle;
        if low && !was {
            // Data are latched while the chip is selected, so the values of one transfer are consistent.
            self.shown = self.data;
            self.transfer = Transfer::Address;
        } else if !low {
            self.transfer = Transfer::Idle;
        }
    }

    /// Exchanges a byte that ends at `at`.
    pub fn exchange(&mut self, byte: u8, at: Time) -> u8 {
        self.advance(at);
        let answer = match self.transfer {
            // While the sensor does not drive the line, the master reads ones.
            Transfer::Idle => return 0xff,
            Transfer::Address => {
                let address = byte & 0x7f;
                self.transfer = if byte & 0x80 != 0 {
                    Transfer::Read(address)
                } else {
                    Transfer::Write(address)
                };
                0xff
            }
            Transfer::Read(address) => {
                self.transfer = Transfer::Read(next_address(address));
                self.read(address, at)
            }
            Transfer::Write(address) => {
                self.transfer = Transfer::Write(next_address(address));
                self.write(address, byte, at);
                0xff
            }
        };
        match self.fault.stuck_output {
            Some(level) => u8::from(level) * 0xff,
            None => answer,
        }
    }

    fn advance(&mut self, to: Time) {
        if self.resetting.is_some_and(|until| until <= to) {
            self.resetting = None;
            self.status |= RESET_DONE;
        }
        let (gyro, accel) = (self.gyro.advance(to), self.accel.advance(to));
        if gyro.is_some() || accel.is_some() {
            if !self.fault.frozen {
                self.take(gyro, accel);
            }
            if !self.fault.no_data_ready {
                self.status |= DATA_READY;
            }
        }
    }

    fn take(&mut self, gyro: Option<[i16; 3]>, accel: Option<[i16; 3]>) {
        if let Some(sample) = accel {
            self.data[..3].copy_from_slice(&sample);
        }
        if let Some(sample) = gyro {
            self.data[3..].copy_from_slice(&sample);
        }
        if self.transfer == Transfer::Idle {
            self.shown = self.data;
        }
    }

    fn read(&mut self, address: u8, at: Time) -> u8 {
        if self.resetting.is_some() {
            self.note(at, "a read during a reset");
            return 0;
        }
        if let (0, ACCEL_DATA_X1..=GYRO_DATA_Z0) = (self.bank, address) {
            let place = address - ACCEL_DATA_X1;
            return self.shown[usize::from(place / 2)].to_be_bytes()[usize::from(place % 2)];
        }
        if register(self.bank, address).is_none() {
            let text = format!("a read of {address:#04x} in bank {}", self.bank);
            self.note(at, text);
            return 0;
        }
        match (self.bank, address) {
            (_, REG_BANK_SEL) => self.bank,
            (0, INT_STATUS) => std::mem::take(&mut self.status),
            (bank, address) => self.banks[usize::from(bank)][usize::from(address)],
        }
    }

    fn write(&mut self, address: u8, value: u8, at: Time) {
        if self.resetting.is_some() {
            return self.note(at, "a write during a reset");
        }
        let Some(register) = register(self.bank, address) else {
            let text = format!("a write to {address:#04x} in bank {}", self.bank);
            return self.note(at, text);
        };
        if at < self.quiet_until && address != REG_BANK_SEL {
            let text = format!("{} written within 200 µs of switching on", register.name);
            self.note(at, text);
        }
        if address == REG_BANK_SEL {
            self.bank = value & 7;
            return;
        }
        let old = self.banks[usize::from(self.bank)][usize::from(address)];
        let new = old & !register.writable | value & register.writable;
        let changed = old ^ value;
        self.note_unmodelled(register, changed, new, at);
        if (self.bank, address) == (0, DEVICE_CONFIG) && value & 1 != 0 {
            return self.reset(at);
        }
        self.banks[usize::from(self.bank)][usize::from(address)] = new;
        if (self.bank, address) == (0, PWR_MGMT0) {
            self.switch(old, new, at);
        }
        self.apply(at);
    }

    /// Records findings if changed bits are not modelled or reserved, or if SPI is switched off.
    fn note_unmodelled(&mut self, register: &Register, changed: u8, value: u8, at: Time) {
        let name = register.name;
        let foreign = changed & register.writable & !register.modelled;
        if foreign != 0 {
            let text = format!("{name}: bits {foreign:#04x} are not modelled ({value:#04x})");
            self.note(at, text);
        }
        let reserved = changed & !register.writable;
        if reserved != 0 {
            let text = format!("{name}: reserved bits {reserved:#04x} changed");
            self.note(at, text);
        }
        if (register.bank, register.address) == (0, INTF_CONFIG0) && value & 3 == 2 {
            self.note(at, format!("{name}: SPI switched off"));
        }
    }

    /// Applies a change of PWR_MGMT0.
    fn switch(&mut self, old: u8, new: u8, at: Time) {
        let is_on = |value: u8| value & 0x0f != 0;
        if !is_on(old) && is_on(new) {
            self.quiet_until = at + QUIET_TIME;
        }
        let (was, is) = (old >> 2 & 3, new >> 2 & 3);
        if is == 2 || new & 3 == 2 {
            let text = format!("PWR_MGMT0: {new:#04x}: low-power or reserved mode");
            self.note(at, text);
        }
        if was == 0 && is != 0 {
            self.gyro_on_since = Some(at);
        } else if is == 0
            && let Some(since) = self.gyro_on_since.take()
            && at < since + MIN_ON
        {
            let text = format!("gyroscope off after {:.1} ms", 1e3 * span_s(since, at));
            self.note(at, text);
        }
        if (was == 3) != (is == 3) {
            // Start-up from standby does not take longer than start-up from off.
            let started = self.gyro_on_since.unwrap_or(at) + self.config.gyro_start;
            self.gyro.switch((is == 3).then_some(started.max(at)));
        }
        if (old & 3 == 3) != (new & 3 == 3) {
            let started = at + self.config.accel_start;
            self.accel.switch((new & 3 == 3).then_some(started));
        }
    }

    /// Configures the signal paths from the registers.
    fn apply(&mut self, at: Time) {
        let [zero, one, two] = self.banks;
        let of = |bank: &[u8; 128], address: u8| bank[usize::from(address)];
        let is_adaptive = of(&zero, INTF_CONFIG1) & ADAPTIVE_RANGE_BITS != ADAPTIVE_RANGE_OFF;
        self.gyro.adapt(is_adaptive.then_some(Adaptive {
            threshold: self.config.adaptive_rate,
            stall: self.config.adaptive_stall,
        }));
        let filter = of(&zero, GYRO_ACCEL_CONFIG0);
        let aaf = GYRO_CONFIG_STATIC3;
        let gyro = Choice {
            name: "gyroscope",
            config: of(&zero, GYRO_CONFIG0),
            bandwidth: filter & 15,
            order: of(&zero, GYRO_CONFIG1) >> 2 & 3,
            delt: of(&one, aaf),
            square: u16::from(of(&one, aaf + 1)) | u16::from(of(&one, aaf + 2) & 15) << 8,
            shift: of(&one, aaf + 2) >> 4,
            unfiltered: of(&one, GYRO_CONFIG_STATIC2) & 2 != 0,
            widest: 2000f64.to_radians(),
        };
        let aaf = ACCEL_CONFIG_STATIC2;
        let accel = Choice {
            name: "accelerometer",
            config: of(&zero, ACCEL_CONFIG0),
            bandwidth: filter >> 4,
            order: of(&zero, ACCEL_CONFIG1) >> 3 & 3,
            delt: of(&two, aaf) >> 1,
            square: u16::from(of(&two, aaf + 1)) | u16::from(of(&two, aaf + 2) & 15) << 8,
            shift: of(&two, aaf + 2) >> 4,
            unfiltered: of(&two, aaf) & 1 != 0,
            widest: 16.0 * GRAVITY,
        };
        if let Some(settings) = gyro.settings(&mut self.findings, self.gyro.is_on(), at) {
            self.gyro.set(settings, at);
        }
        if let Some(settings) = accel.settings(&mut self.findings, self.accel.is_on(), at) {
            self.accel.set(settings, at);
        }
    }
}

/// Next address in a burst.
fn next_address(address: u8) -> u8 {
    (address + 1) & 0x7f
}

/// Register settings of one signal path.
struct Choice {
    name: &'static str,
    config: u8,
    bandwidth: u8,
    order: u8,
    delt: u8,
    square: u16,
    shift: u8,
    unfiltered: bool,
    /// Full scale of range 0, rad/s or m/s².
    widest: f64,
}

impl Choice {
    /// Settings of the path; `None` for register values that are not in the data sheet, with a finding if the path is
    /// on.
    fn settings(&self, findings: &mut Findings, is_on: bool, at: Time) -> Option<Settings> {
        let mut need = |found: Option<f64>, what: &str, value: u16| {
            if found.is_none() && is_on {
                let text = format!("{}: {what} {value}", self.name);
                findings.note(FindingKind::NotModelled, 0, at, text);
            }
            found
        };
        let range = self.config >> 5;
        let known = self.name == "gyroscope" || range < 4;
        let full_scale = known.then(|| self.widest / f64::from(1u32 << range));
        let full_scale = need(full_scale, "range", range.into())?;
        let rate_hz = need(rate_hz(self.config), "data rate", self.config.into())?;
        let corner = bandwidth_hz(self.bandwidth, rate_hz);
        let corner_hz = need(corner, "filter bandwidth", self.bandwidth.into())?;
        let order = (self.order < 3).then_some(f64::from(self.order) + 1.0);
        let order = need(order, "filter order", self.order.into())? as u32;
        let anti_alias = if self.unfiltered {
            Some(f64::INFINITY)
        } else {
            anti_alias_hz(self.delt, self.square, self.shift)
        };
        let anti_alias_hz = need(anti_alias, "anti-alias filter", self.delt.into())?;
        Some(Settings {
            rate_hz,
            unit: full_scale / 32_768.0,
            anti_alias_hz,
            corner_hz,
            order,
        })
    }
}

#[cfg(test)]
mod tests;
