//! Circuit of an axle board: the parts wired to it, by docs/wiring.md.

use super::power::{BATTERY_V, Power};
use crate::serial_line::SerialLine;
use core_algos::topology::AxleId;
use host_sim::scenario::Scenario;
use host_sim::world::drawn::Drawn;
use host_sim::world::random::{Stream, generator, normal};
use rand::RngExt;
use virtual_board::Time;
use virtual_board::chip::{Circuit, Drive, Inputs, Net, Pin};
use virtual_board::device::{
    Amplifier, AmplifierConfig, Contact, Divider, DriverConfig, Drv8874, Encoder, EncoderConfig,
    Icm42688, InertialConfig, Motion, Motor, MotorConfig, Thermistor, olimex_h405,
};

const ENABLE: [Pin; 2] = [Pin::new('A', 8), Pin::new('A', 9)];
const DIRECTION: [Pin; 2] = [Pin::new('B', 14), Pin::new('B', 15)];
const AWAKE: Pin = Pin::new('C', 5);
const FAULT: [Pin; 2] = [Pin::new('C', 8), Pin::new('C', 9)];
const CURRENT: [Pin; 2] = [Pin::new('C', 0), Pin::new('C', 1)];
const SUPPLY: Pin = Pin::new('C', 2);
const TEMPERATURE: Pin = Pin::new('C', 3);
const STOP: Pin = Pin::new('B', 12);
const ENCODER: [[Pin; 2]; 2] = [
    [Pin::new('C', 6), Pin::new('C', 7)],
    [Pin::new('B', 6), Pin::new('B', 7)],
];
const SELECT: Pin = Pin::new('A', 4);
const STRAP: Pin = Pin::new('C', 13);
const BUTTON: Pin = Pin::new('A', 0);
const LED: Pin = Pin::new('C', 12);

/// Supply of the chip, the amplifiers and the sensors, V.
const LOGIC_V: f64 = 3.3;
/// Temperature of the thermistor between the drivers, °C.
const AMBIENT_C: f64 = 25.0;
/// Two PWM periods: after that time without a pulse a motor counts as not driven.
const PULSE_PERIODS: Time = Time::from_micros(100);
/// Limit of the bounce time of the contacts.
const BOUNCE: Time = Time::from_micros(5_000);

/// Motion of a wheel from a given time on: angle (rad) and speed (rad/s), positive forward.
#[derive(Clone, Copy, Debug, Default)]
pub struct WheelMotion {
    /// Wheel's angle at the given time, rad.
    pub angle_rad: f64,
    /// Wheel's speed, rad/s.
    pub speed_rad_s: f64,
}

/// Motion of an axle from a given time on.
#[derive(Clone, Copy, Debug, Default)]
pub struct AxleMotion {
    /// Motions of the wheels (left, right).
    pub wheels: [WheelMotion; 2],
    /// Motion at an inertial sensor in the middle of the axle.
    pub inertial: Motion,
}

/// Properties of an axle board's parts that differ between axles.
#[derive(Clone, Debug)]
pub struct AxleParts {
    /// True if the strap is at ground: an axle other than the front axle.
    pub grounded: bool,
    /// Lines of the encoders per revolution.
    pub lines: u32,
    /// Phases of the encoders (left, right), counts.
    pub phase: [f64; 2],
    /// Inertial sensor; `None` if not fitted.
    pub inertial: Option<InertialConfig>,
    /// Voltage of the battery without load, V.
    pub battery_v: f64,
    /// Seed of all noise of the axle's parts.
    pub seed: u64,
}

impl AxleParts {
    /// Properties of an axle's parts in a scenario, as drawn for the trial.
    pub fn of(scenario: &Scenario, drawn: &Drawn, axle: AxleId, seed: u64) -> Self {
        let k = axle.index();
        let (gyro, accelerometer) = (
            &scenario.world.sensors.gyro,
            &scenario.world.sensors.accelerometer,
        );
        // Bias at power-on; the board removes it by averaging at rest. Once all nodes are ready, the world's sensor
        // model adds its own bias to the motion.
        let mut random = generator(seed, 0, Stream::Other(0x202));
        let third = |value: f64| [0.0, 0.0, value];
        let first = |value: f64| [value, 0.0, 0.0];
        Self {
            grounded: axle != AxleId(0),
            lines: scenario.world.sensors.encoder.counts_per_revolution / 4,
            phase: drawn.encoder_phase[k],
            inertial: gyro.fitted.then(|| InertialConfig {
                gyro_density: gyro.noise_density,
                gyro_bias: third(normal(&mut random, gyro.bias_sigma)),
                gyro_scale: third(drawn.gyro_scale_error[k]),
                accel_density: accelerometer.noise_density,
                accel_bias: first(normal(&mut random, accelerometer.bias_sigma)),
                accel_scale: first(drawn.accelerometer_scale_error[k]),
                ..InertialConfig::default()
            }),
            battery_v: BATTERY_V,
            seed,
        }
    }
}

/// Circuit around an axle board: drivers, motors, sensors, contacts, supplies.
#[derive(Clone)]
pub struct AxleBoard {
    pub(super) drivers: [Drv8874; 2],
    pub(super) amplifiers: [Amplifier; 2],
    pub(super) encoders: [Encoder; 2],
    pub(super) inertial: Option<Icm42688>,
    pub(super) power: Power,
    divider: Divider,
    pub(super) thermistor: Thermistor,
    pub(super) stop: Contact,
    pub(super) button: Contact,
    pub(super) serial: SerialLine,
    /// Times of the LED's edges. The LED is lit from each edge of even index to the next edge.
    pub(super) led: Vec<Time>,
    /// True if the strap is closed to ground, and true once this level was passed to the chip.
    strap: (bool, bool),
    /// Times of future events at the drivers, such as the start and the end of a fault.
    driver_events: Vec<Time>,
    /// Latest levels of the drivers' fault pins that were passed to the chip.
    faults: [Drive; 2],
    /// True until the first levels of the fault pins were passed to the chip.
    fresh: bool,
}

/// Drivers with their motors, amplifiers, and resistors of the supply's divider (Ω), with random errors within their
/// tolerances.
fn power_parts(parts: &AxleParts) -> ([Drv8874; 2], [Amplifier; 2], [f64; 2]) {
    // Standard deviations are a third of the data sheets' tolerances: relative values, except the offset in V.
    let mut random = generator(parts.seed, 0, Stream::Other(0x203));
    let mut scaled = |nominal: f64, sigma: f64| nominal * (1.0 + normal(&mut random, sigma));
    let resistors = [47e3, 10e3].map(|ohm| scaled(ohm, 3e-3));
    let mut driver = || {
        let nominal = MotorConfig::default();
        let motor = Motor::new(MotorConfig {
            resistance_ohm: scaled(nominal.resistance_ohm, 0.03),
            inductance_h: scaled(nominal.inductance_h, 0.06),
            constant_nm_a: scaled(nominal.constant_nm_a, 0.02),
        });
        let nominal = DriverConfig::default();
        let config = DriverConfig {
            on_ohm: scaled(nominal.on_ohm, 0.06),
            trip_a: scaled(nominal.trip_a, 0.02),
            ..nominal
        };
        Drv8874::new(config, motor, parts.battery_v)
    };
    let drivers = [driver(), driver()];
    let mut amplifier = |k: u64| {
        let config = AmplifierConfig {
            gain_error: normal(&mut random, 4e-3),
            offset_v: normal(&mut random, 8e-6),
            edge_tau_s: random.random_range(0.4e-6..=4.8e-6),
            ..AmplifierConfig::default()
        };
        Amplifier::new(config, part_seed(parts.seed, 1 + k))
    };
    let amplifiers = [amplifier(0), amplifier(1)];
    (drivers, amplifiers, resistors)
}

/// Random seed of a part of an axle.
fn part_seed(seed: u64, part: u64) -> u64 {
    seed ^ part.wrapping_mul(0x9e37_79b9_7f4a_7c15)
}

impl AxleBoard {
    /// Circuit with its parts at rest.
    pub fn new(parts: &AxleParts) -> Self {
        let seed = |part: u64| part_seed(parts.seed, part);
        let (drivers, amplifiers, resistors) = power_parts(parts);
        let encoder = |k: usize| {
            let phase = match k {
                0 => parts.phase[k],
                // The right motor turns in the opposite direction.
                _ => 1.0 - parts.phase[k],
            };
            Encoder::new(EncoderConfig {
                lines: parts.lines,
                phase,
            })
        };
        Self {
            drivers,
            amplifiers,
            encoders: [encoder(0), encoder(1)],
            inertial: parts.inertial.map(|config| Icm42688::new(config, seed(3))),
            divider: Divider::new(resistors[0], resistors[1], 100e-9, parts.battery_v),
            power: Power::new(parts.battery_v),
            thermistor: Thermistor::default(),
            stop: Contact::new(true, BOUNCE, seed(4)),
            button: Contact::new(false, BOUNCE, seed(5)),
            serial: SerialLine::default(),
            led: Vec::new(),
            strap: (parts.grounded, false),
            driver_events: Vec::new(),
            faults: [Drive::Open; 2],
            fresh: true,
        }
    }

    /// Presses or releases the button.
    pub fn press(&mut self, pressed: bool, at: Time) {
        self.button.set(pressed, at);
    }

    /// Presses or releases the emergency stop.
    pub fn stop(&mut self, pressed: bool, at: Time) {
        self.stop.set(!pressed, at);
    }

    /// Sets the motion of the axle from `at` on.
    pub fn motion(&mut self, at: Time, motion: &AxleMotion) {
        for (k, wheel) in motion.wheels.iter().enumerate() {
            let sign = if k == 0 { 1.0 } else { -1.0 };
            let (angle, speed) = (sign * wheel.angle_rad, sign * wheel.speed_rad_s);
            self.encoders[k].motion(at, angle, speed, 0.0);
            self.drivers[k].speed(wheel.speed_rad_s, at);
        }
        if let Some(inertial) = &mut self.inertial {
            inertial.motion(at, motion.inertial);
        }
    }

    /// Mean torques at the wheels since the last call, N m. The battery voltage sags with the current drawn.
    pub fn take_torque(&mut self, at: Time) -> [f64; 2] {
        let works = [0, 1].map(|k: usize| self.drivers[k].take_work(at));
        let amperes = works.iter().map(|work| work.mean_supplied_a()).sum();
        let volts = self.power.battery.battery_v(at, amperes);
        self.divider.input(at, volts);
        for driver in &mut self.drivers {
            driver.supply(volts, at);
        }
        [0, 1].map(|k: usize| {
            works[k].mean_current_a() * self.drivers[k].motor().config().constant_nm_a
        })
    }

    /// Closes the strap to ground or opens it.
    pub fn strap(&mut self, closed: bool) {
        self.strap = (closed, false);
    }

    /// Makes a driver report a fault and switch off, from `from` to `to`.
    pub fn force_fault(&mut self, side: usize, from: Time, to: Time) {
        self.drivers[side].force_fault(from, to);
        self.driver_events.extend([from, to]);
    }

    /// Currents of the motors, A; zero while a motor is braked by a short circuit.
    pub fn driven_currents(&mut self, at: Time) -> [f64; 2] {
        [0, 1].map(|k: usize| {
            let driver = &mut self.drivers[k];
            let current = driver.current(at);
            // Between two pulses a bridge also shorts its motor.
            let brakes = driver.brakes() && at > driver.driven_until() + PULSE_PERIODS;
            if brakes { 0.0 } else { current }
        })
    }

    /// True if the supply has driven a motor within the last two PWM periods.
    pub fn is_driven(&self, at: Time) -> bool {
        let drivers = self.drivers.iter();
        drivers
            .map(Drv8874::driven_until)
            .any(|until| at <= until + PULSE_PERIODS)
    }

    /// True if both drivers are awake.
    pub fn is_awake(&self) -> bool {
        self.drivers.iter().all(Drv8874::is_awake)
    }

    fn fault_pins(&self) -> [Drive; 2] {
        [0, 1].map(|k: usize| self.drivers[k].fault_pin())
    }
}

impl Circuit for AxleBoard {
    fn nets(&self) -> &'static [Net] {
        olimex_h405::NETS
    }

    fn pin(&mut self, pin: Pin, drive: Drive, at: Time) {
        let level = drive == Drive::High;
        match pin {
            AWAKE => self
                .drivers
                .iter_mut()
                .for_each(|driver| driver.awake(level, at)),
            LED if (drive == Drive::Low) != self.led.len().is_multiple_of(2) => {}
            LED => self.led.push(at),
            SELECT => {
                if let Some(inertial) = &mut self.inertial {
                    inertial.select(drive == Drive::Low, at);
                }
            }
            _ => {
                for k in 0..2 {
                    if pin == ENABLE[k] {
                        self.drivers[k].enable(level, at);
                    } else if pin == DIRECTION[k] {
                        self.drivers[k].phase(level, at);
                    }
                }
            }
        }
    }

    fn voltage(&mut self, pin: Pin, at: Time) -> f64 {
        for k in 0..2 {
            if pin == CURRENT[k] {
                let driver = &mut self.drivers[k];
                let current = driver.current(at);
                let (slope, edge) = (driver.current_slope(), driver.latest_edge());
                return self.amplifiers[k].output(at, current, slope, edge, LOGIC_V);
            }
        }
        match pin {
            SUPPLY => self.divider.output(at),
            TEMPERATURE => self.thermistor.voltage(AMBIENT_C, LOGIC_V),
            _ => 0.0,
        }
    }

    fn spi(&mut self, word: u16, _bits: u32, at: Time) -> u16 {
        let inertial = self.inertial.as_mut();
        inertial.map_or(!0, |inertial| inertial.exchange(word as u8, at).into())
    }

    fn serial(&mut self, byte: u8, _at: Time) {
        self.serial.sent.push(byte);
    }

    fn supply(&mut self, at: Time) -> f64 {
        self.power.logic_v(at)
    }

    fn next(&self) -> Time {
        if self.fresh {
            return Time(0);
        }
        if self.faults != self.fault_pins() || !self.strap.1 {
            return Time(0);
        }
        let [left, right] = &self.encoders;
        let switches = self.stop.next().min(self.button.next());
        let driver_events = self
            .driver_events
            .iter()
            .copied()
            .min()
            .unwrap_or(Time::NEVER);
        let other = switches
            .min(driver_events)
            .min(self.power.next())
            .min(self.serial.next());
        left.next().min(right.next()).min(other)
    }

    fn advance(&mut self, at: Time, inputs: &mut Inputs) {
        for (encoder, pins) in self.encoders.iter_mut().zip(ENCODER) {
            if self.fresh || encoder.next() <= at {
                encoder.advance(at);
                let (a, b) = encoder.drives();
                inputs.pins.extend([(pins[0], a), (pins[1], b)]);
            }
        }
        self.serial.advance(at, inputs);
        if self.fresh || self.stop.next() <= at {
            self.stop.advance(at);
            let closed = self.stop.is_closed();
            inputs
                .pins
                .push((STOP, if closed { Drive::Low } else { Drive::Open }));
        }
        if self.fresh || self.button.next() <= at {
            self.button.advance(at);
            let closed = self.button.is_closed();
            inputs
                .pins
                .push((BUTTON, if closed { Drive::High } else { Drive::Open }));
        }
        self.power.advance(at, inputs);
        if self.driver_events.iter().any(|event| *event <= at) {
            self.driver_events.retain(|event| *event > at);
            self.drivers
                .iter_mut()
                .for_each(|driver| driver.advance(at));
        }
        let faults = self.fault_pins();
        if self.fresh || faults != self.faults {
            inputs
                .pins
                .extend([(FAULT[0], faults[0]), (FAULT[1], faults[1])]);
            self.faults = faults;
        }
        if self.fresh || !self.strap.1 {
            let closed = self.strap.0;
            let drive = if closed { Drive::Low } else { Drive::Open };
            inputs.pins.push((STRAP, drive));
            self.strap.1 = true;
        }
        self.fresh = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::drive::sampling;
    use virtual_board::chip::Usable;

    /// Rows of the pin tables in docs/wiring.md: pin and function.
    fn wiring() -> Vec<(Pin, String)> {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/wiring.md");
        let text = std::fs::read_to_string(path).unwrap();
        let mut pins = Vec::new();
        for row in text.lines().filter(|line| line.starts_with("| P")) {
            let cells: Vec<_> = row.split('|').map(str::trim).collect();
            for name in cells[1].split(", ") {
                let Some(number) = name.get(2..).and_then(|number| number.parse().ok()) else {
                    continue;
                };
                let port = name.chars().nth(1).unwrap();
                pins.push((Pin::new(port, number), cells[2].to_owned()));
            }
        }
        pins
    }

    #[test]
    fn wiring_uses_no_net_of_the_board_except_button_and_led() {
        let pins = wiring();
        assert_eq!(pins.len(), 37, "{pins:?}");
        for (pin, function) in pins {
            let net = olimex_h405::NETS.iter().find(|net| net.pin == pin);
            let usable = net.is_none_or(|net| match net.usable {
                Usable::Input => function.starts_with("input"),
                Usable::Output => function.starts_with("output"),
                Usable::No => false,
            });
            assert!(usable, "{pin}: {net:?}");
        }
    }

    /// The boot loader drives two wired pins. PA9 is harmless because the bridge stays off while nSLEEP is low; PB10 is
    /// an output of the image too.
    #[test]
    fn boot_loader_drives_no_wired_pin_against_a_part() {
        let driven = olimex_h405::LOADER.iter().filter(|pin| pin.driven);
        let wired: Vec<_> = driven
            .map(|loader| loader.pin)
            .filter(|pin| wiring().iter().any(|(wired, _)| wired == pin))
            .collect();
        assert_eq!(wired, [ENABLE[1], Pin::new('B', 10)]);
        assert!(!wired.contains(&AWAKE));
    }

    /// Largest error of the sampled motor currents, A, at the given duty cycles and with the slowest amplifier that the
    /// data sheet allows.
    fn sampling_error(duties: [f64; 2]) -> f64 {
        const TOP: u16 = sampling::AXLE.top;
        let compares = duties.map(|duty| (duty * f64::from(TOP)) as u16);
        let trigger = sampling::AXLE.build().unwrap().compare(compares);
        let counts = |count: u64| Time::from_nanos(count * 1000 / 168);
        let config = AmplifierConfig {
            edge_tau_s: 4.8e-6,
            noise_v: 0.0,
            ..AmplifierConfig::default()
        };
        let mut worst = 0.0f64;
        for (k, compare) in compares.into_iter().enumerate() {
            let mut amplifier = Amplifier::new(config, 1);
            let mut driver = Drv8874::new(
                DriverConfig::default(),
                Motor::new(MotorConfig::default()),
                12.0,
            );
            driver.awake(true, Time(0));
            driver.phase(true, Time(0));
            // The mean current is about 1 A.
            driver.speed(((12.0 * duties[k] - 3.1) / 0.6).max(-5.0), Time(0));
            let wakes = counts(400 * u64::from(TOP));
            for period in 0..200 {
                // The counter runs from zero to the top and back: the pulse ends at the compare value and begins at
                // the opposite count.
                let at = |count: u64| wakes + counts(2 * u64::from(TOP) * period + count);
                let (ends, begins) = (u64::from(compare), 2 * u64::from(TOP) - u64::from(compare));
                let sampled = at(u64::from(trigger) + [112, 432][k]);
                let mut events = vec![(at(ends), Some(false)), (at(begins), Some(true))];
                events.push((sampled, None));
                events.sort();
                for (time, level) in events {
                    if let Some(level) = level {
                        driver.enable(level, time);
                        continue;
                    }
                    let current = driver.current(time);
                    let (slope, edge) = (driver.current_slope(), driver.latest_edge());
                    let volts = amplifier.output(time, current, slope, edge, LOGIC_V);
                    if period > 150 {
                        worst = worst.max(((volts - 0.5 * LOGIC_V) / 0.2 - current).abs());
                    }
                }
            }
        }
        worst
    }

    #[test]
    fn currents_are_sampled_where_a_slow_amplifier_has_settled() {
        for percent in [10, 25, 45, 50, 60, 75, 80, 90] {
            let duty = f64::from(percent) / 100.0;
            let error = sampling_error([duty, duty]);
            // An edge shifts the output by 60 mV. After 10.9 µs, with a time constant of 4.8 µs, 6.2 mV remain: 31 mA.
            assert!(error < 0.035, "{percent} %: {error} A");
        }
        // This pair of duty cycles has the largest error.
        let error = sampling_error([0.2, 0.72]);
        assert!(error < 0.13, "{error} A");
    }
}
