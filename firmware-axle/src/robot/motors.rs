//! Both motors: pulse-width modulation, current sensing and the current loop, at 20 kHz.
//!
//! TIM1 drives the enable pins of two DRV8874 in phase/enable mode and starts the injected
//! conversions of ADC1 once a period, where no edge is near ([`timer`]): both currents (INA240 on a
//! shunt in the motor's lead), supply and driver temperature. Their interrupt has the highest priority
//! of the board and runs the current loops, whose output takes effect at the next update of the timer.
//! No critical section delays this interrupt ([`critical`]). Every twentieth period is a tick of the
//! board. An interrupt of lower priority announces the tick, because a task cannot be woken from the
//! current loop.
//!
//! The motors are driven while a command with `on` has arrived within the last 2 ms and no fault is latched. Otherwise
//! the bridges short the motors, which brakes them, and the drivers sleep once the wheels stand still ([`braking`]). A
//! driver fault or an overcurrent puts the drivers to sleep at once.

mod exchange;
mod timer;

use core::cell::RefCell;
use core::sync::atomic::{AtomicU32, Ordering};

use core_algos::acquisition::analog::{Supply, Thermistor, ThermistorConfig};
use core_algos::config::ConfigError;
use core_algos::drive::braking::{self, Braking};
use core_algos::drive::bridge::{self, Pins};
use core_algos::drive::current::{self, CurrentLoop};
use core_algos::drive::protection::{self, Limits, Protection};
use core_algos::drive::response::{self, Response};
use core_algos::drive::shunt::{Shunt, Zeroed, Zeroing};
use core_algos::params;
use core_algos::safety::Condition;
use core_algos::time::Micros;
use cortex_m::peripheral::DWT;
use critical_section::Mutex;
use embassy_stm32::adc::{Adc, AdcChannel, Exten, InjectedAdc, SampleTime};
use embassy_stm32::gpio::{Input, Level, Output, Pull, Speed};
use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::pac::GPIOC;
use embassy_stm32::peripherals::{
    ADC1, PA8, PA9, PB12, PB14, PB15, PC0, PC1, PC2, PC3, PC5, PC8, PC9, WWDG,
};
use embassy_stm32::{Peri, interrupt as handler, peripherals, triggers};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use embassy_time::Instant;
use firmware_common::clock::CORE_HZ;
use firmware_common::task_watchdog::CheckIn;
use firmware_common::watchdog::WindowWatchdog;
use firmware_common::{critical, fault};

use crate::rules::{Command, Feedback};
use timer::{Pwm, TOP};

/// Core cycles in a microsecond.
const CYCLES_PER_US: u32 = CORE_HZ / 1_000_000;
/// Periods in a tick.
const PERIODS: u8 = 20;
/// Timeout of the command, periods: 2 ms. The motors are then switched off.
const COMMAND_TIMEOUT: u8 = 40;
/// Trip current, A, and periods until the trip: 2 ms.
const TRIP: (f32, u16) = (6.0, 40);
/// Wake-up time of the drivers, periods: 2 ms. No current is commanded meanwhile.
const WAKE_PERIODS: u8 = 40;
/// Time in which the drivers fall asleep, periods: 2 ms. An earlier wake-up might not restart a driver.
const SLEEP_PERIODS: u8 = 40;
/// Successive periods of a driver fault until the trip: 200 µs. A driver that switched itself off reports a fault for
/// milliseconds; a spike from the bridges lasts for one sample.
const FAULT_PERIODS: u16 = 4;
/// Standstill: both limits hold for 0.1 s. A shorted motor has a current of 20 mA at 0.1 rad/s. The speed detects the
/// motion of a motor with an open lead; a single count of the encoder gives 0.1 rad/s.
const STANDSTILL: braking::Limits = braking::Limits {
    current_a: 0.02,
    speed_rad_s: 0.3,
    periods: 2000,
};
/// Periods of a supply beyond its limits until the trip: 20 ms.
const SUPPLY_PERIODS: u16 = 400;

/// Number of the sleep pin in port C, for code that must not rely on the state of the program.
pub const SLEEP: usize = 5;

/// Pins and peripherals of the motors.
pub struct Parts {
    /// A/D converter of currents, supply and temperature.
    pub adc: Peri<'static, ADC1>,
    /// PWM timer.
    pub timer: Peri<'static, peripherals::TIM1>,
    /// Enable pins (left, right).
    pub enable: (Peri<'static, PA8>, Peri<'static, PA9>),
    /// Direction pins (left, right).
    pub direction: (Peri<'static, PB14>, Peri<'static, PB15>),
    /// Sleep pin of both drivers, low: asleep. During a reset the drivers' pull-downs hold the pin low.
    pub sleep: Peri<'static, PC5>,
    /// Fault pins of the drivers (left, right), low: fault.
    pub fault: (Peri<'static, PC8>, Peri<'static, PC9>),
    /// Inputs of the motor currents (left, right).
    pub current: (Peri<'static, PC0>, Peri<'static, PC1>),
    /// Input of the supply voltage, behind a divider.
    pub supply: Peri<'static, PC2>,
    /// Input of the thermistor between the drivers.
    pub temperature: Peri<'static, PC3>,
    /// Emergency stop, a contact to ground that opens: high or a broken wire means stop. The timer's
    /// break input.
    pub stop: Peri<'static, PB12>,
    /// Window watchdog of the current loop.
    pub watchdog: Peri<'static, WWDG>,
    /// Handle with which the current loop reports to the task watchdog.
    pub check_in: CheckIn,
}

static DRIVE: Mutex<RefCell<Option<Drive>>> = Mutex::new(RefCell::new(None));
static TICK: Signal<CriticalSectionRawMutex, Micros> = Signal::new();
/// Cycle counter at the beginning of the tick's first period.
static TICK_BEGAN: AtomicU32 = AtomicU32::new(0);

/// Interface of the tick to the motors.
pub struct Motors(());

impl Motors {
    /// Sets up timer, converter and drivers with the motors off, and starts the current loop.
    pub fn start(parts: Parts, config: &params::Drive) -> Result<Self, ConfigError> {
        let drive = Drive::new(parts, config)?;
        critical::all(|cs| DRIVE.borrow_ref_mut(cs).replace(drive));
        fault::on_fault(make_safe);
        interrupt::ADC.set_priority(Priority::P0);
        interrupt::TIM7.set_priority(Priority::P2);
        // SAFETY: the handlers' data are in place.
        unsafe {
            interrupt::TIM7.enable();
            interrupt::ADC.enable();
        }
        Pwm::start();
        Ok(Self(()))
    }

    /// Waits for the next tick; returns the local time of its beginning.
    pub async fn tick(&mut self) -> Micros {
        TICK.wait().await
    }

    /// Sets the command until the next tick.
    pub fn command(&mut self, command: Command) {
        exchange::put_command(command);
    }

    /// Measurements of the last tick.
    pub fn feedback(&self) -> Feedback {
        exchange::feedback()
    }

    /// Lengthens the periods of the next tick by `by` parts in 4200; negative values shorten them.
    pub fn trim(&mut self, by: i8) {
        Pwm::trim(by);
    }
}

/// Data of the current loop's interrupt.
struct Drive {
    adc: InjectedAdc<'static, ADC1, 4>,
    direction: [Output<'static>; 2],
    sleep: Output<'static>,
    faults: [Input<'static>; 2],
    pwm: Pwm,
    check_in: CheckIn,
    /// Fed once a period: if the loop stopped, the motors would keep their last duty.
    watchdog: WindowWatchdog,
    shunt: Shunt,
    supply: Supply,
    thermistor: Thermistor,
    current_loop: CurrentLoop,
    states: [current::State; 2],
    response: Response,
    response_states: [response::State; 2],
    zeroing: [Zeroing; 2],
    zeros: [Option<f32>; 2],
    command: Command,
    command_age: u8,
    /// Periods since the drivers were woken, saturating; 0 while they sleep.
    awake: u8,
    /// Periods since the drivers were put to sleep, saturating; 0 while they are awake.
    asleep: u8,
    /// True while the outputs of the timer are enabled; otherwise the bridges of awake drivers brake.
    driven: bool,
    braking: Braking,
    protection: Protection,
    fault: Option<Condition>,
    squares: [f32; 2],
    period: u8,
    /// Cycle counter at the beginning of this period's step.
    began: u32,
    longest: u32,
}

impl Drive {
    fn new(parts: Parts, config: &params::Drive) -> Result<Self, ConfigError> {
        let sleep = Output::new(parts.sleep, Level::Low, Speed::Low);
        let pwm = Pwm::new(parts.timer, parts.enable, parts.stop);
        // A source of 10 kΩ settles within 28 cycles at 21 MHz. Four conversions take 7.6 µs. The currents are first,
        // because they must not be sampled near an edge.
        let time = SampleTime::CYCLES28;
        let adc = Adc::new(parts.adc).setup_injected_conversions(
            [
                (parts.current.0.degrade_adc(), time),
                (parts.current.1.degrade_adc(), time),
                (parts.supply.degrade_adc(), time),
                (parts.temperature.degrade_adc(), time),
            ],
            triggers::TIM1_TRGO,
            Exten::RISING_EDGE,
            true,
        );
        Ok(Self {
            adc,
            direction: [
                Output::new(parts.direction.0, Level::Low, Speed::Low),
                Output::new(parts.direction.1, Level::Low, Speed::Low),
            ],
            sleep,
            faults: [
                Input::new(parts.fault.0, Pull::Up),
                Input::new(parts.fault.1, Pull::Up),
            ],
            pwm,
            check_in: parts.check_in,
            shunt: config.shunt().build()?,
            supply: config.supply().build()?,
            thermistor: ThermistorConfig::default().build()?,
            current_loop: config.current_loop().build()?,
            states: [current::State::default(); 2],
            response: config.response().build()?,
            response_states: [response::State::default(); 2],
            zeroing: [Zeroing::default(); 2],
            zeros: [None; 2],
            command: Command::default(),
            command_age: COMMAND_TIMEOUT,
            awake: 0,
            asleep: 0,
            driven: false,
            braking: Braking::new(STANDSTILL),
            protection: Protection::new(Limits {
                current: TRIP,
                fault_periods: FAULT_PERIODS,
                supply_v: config.supply_trip_v(),
                supply_periods: SUPPLY_PERIODS,
            }),
            fault: None,
            squares: [0.0; 2],
            period: 0,
            began: 0,
            longest: 0,
            // The watchdog starts last, because from then on the current loop must run.
            watchdog: WindowWatchdog::start(parts.watchdog),
        })
    }

    /// Runs one period: sample, check, control, actuate, report.
    fn step(&mut self) {
        let [left, right, supply, temperature] = self.adc.read_injected_samples();
        let counts = [left, right];
        let supply_v = self.supply.read(supply);
        self.take_command();
        let currents = self.currents(counts);
        self.check_trip_conditions(currents, supply_v);

        let on = self.command.on && self.fault.is_none() && self.zeros.iter().all(Option::is_some);
        self.switch(on, currents);
        let mut pins = [Pins::default(); 2];
        for i in 0..2 {
            // The drivers brake while they wake up and while a current cannot be read.
            let ready = self.driven && self.awake >= WAKE_PERIODS;
            let (Some(current_a), true) = (currents[i], ready) else {
                self.states[i] = current::State::default();
                self.response_states[i] = response::State::default();
                continue;
            };
            let output = self.current_loop.step(
                &mut self.states[i],
                &current::Input {
                    torque_nm: self.command.torque_nm[i],
                    current_a,
                    speed_rad_s: self.command.speed_rad_s[i],
                    supply_v,
                    limit_a: self.command.limit_a[i],
                },
            );
            let (voltage_v, speed_rad_s) = (output.duty * supply_v, self.command.speed_rad_s[i]);
            let response_state = &mut self.response_states[i];
            self.response
                .step(response_state, voltage_v, current_a, speed_rad_s);
            if output.valid {
                pins[i] = bridge::pins(output.duty, TOP);
            } else {
                self.trip(Condition::NotANumber);
            }
        }
        self.set_pins(pins);
        self.report(currents, supply_v, temperature);
        self.watchdog.feed();
    }

    fn take_command(&mut self) {
        match exchange::take_command() {
            Some(command) => {
                self.command = command;
                self.command_age = 0;
                // If the fault is still present, the next check latches it again.
                if command.clear {
                    self.fault = None;
                }
            }
            None if self.command_age >= COMMAND_TIMEOUT => self.command = Command::default(),
            None => self.command_age += 1,
        }
    }

    /// Motor currents, A; `None` without a zero or a valid reading. Unknown zeros are measured while the drivers sleep.
    fn currents(&mut self, counts: [u16; 2]) -> [Option<f32>; 2] {
        let asleep = self.awake == 0;
        let mut currents = [None; 2];
        for i in 0..2 {
            match self.zeros[i] {
                Some(zero) => currents[i] = self.shunt.read(counts[i], zero),
                None if asleep => {
                    if let Zeroed::Found(zero) = self.zeroing[i].step(&self.shunt, counts[i]) {
                        self.zeros[i] = Some(zero);
                    }
                }
                None => {}
            }
        }
        currents
    }

    /// Checks the conditions that switch the motors off.
    fn check_trip_conditions(&mut self, currents: [Option<f32>; 2], supply_v: f32) {
        let motor = |i: usize| protection::Motor {
            current_a: currents[i],
            zeroed: self.zeros[i].is_some(),
            faulty: self.faults[i].is_low(),
        };
        let sample = protection::Sample {
            motors: [motor(0), motor(1)],
            supply_v,
            stopped: self.pwm.contact_open() || (self.driven && self.pwm.broken()),
            awake: self.awake > 0,
            ready: self.awake >= WAKE_PERIODS,
        };
        if let Some(condition) = self.protection.step(&sample) {
            self.trip(condition);
        }
    }

    /// Latches the first cause and ends the pulses at once.
    fn trip(&mut self, condition: Condition) {
        self.fault.get_or_insert(condition);
        let driven = self.driven;
        self.brake();
        // A bridge that is broken or overloaded must not switch its transistors on to brake. A fast motor in a short
        // circuit may exceed the limit; the driver protects itself then.
        let overloaded = condition == Condition::OverCurrent && driven;
        if condition == Condition::DriverFault || overloaded {
            self.put_to_sleep();
        }
    }

    /// Drives the motors, or brakes them until they stand still and lets the drivers sleep.
    fn switch(&mut self, on: bool, currents: [Option<f32>; 2]) {
        if self.awake == 0 {
            self.asleep = self.asleep.saturating_add(1);
        }
        if on && (self.awake > 0 || self.asleep >= SLEEP_PERIODS) {
            if !self.driven {
                self.pwm.enable();
                self.driven = true;
            }
            self.braking.reset();
            self.sleep.set_high();
        } else {
            self.brake();
            if self.awake == 0 || self.braking.step(currents, self.command.speed_rad_s) {
                return self.put_to_sleep();
            }
        }
        self.awake = self.awake.saturating_add(1);
        self.asleep = 0;
    }

    /// Drives both enable pins low: the bridges of drivers that are awake short the motors.
    fn brake(&mut self) {
        Pwm::disable();
        self.driven = false;
    }

    fn put_to_sleep(&mut self) {
        self.sleep.set_low();
        self.awake = 0;
    }

    fn set_pins(&mut self, pins: [Pins; 2]) {
        for (pins, direction) in pins.iter().zip(&mut self.direction) {
            // The direction changes at once, the width at the next update. For at most 25 µs the old
            // width, which is small where a duty changes sign, is applied in the new direction.
            direction.set_level(pins.forward.into());
        }
        self.pwm.set(pins.map(|pins| pins.compare));
    }

    fn report(&mut self, currents: [Option<f32>; 2], supply_v: f32, temperature: u16) {
        for (square, current) in self.squares.iter_mut().zip(currents) {
            let current = current.unwrap_or(0.0);
            *square += current * current;
        }
        self.period += 1;
        if self.period < PERIODS {
            return;
        }
        self.period = 0;
        self.check_in.report();
        let mean = self.squares.map(|square| square / f32::from(PERIODS));
        self.squares = [0.0; 2];
        let feedback = Feedback {
            current_a: mean.map(core_algos::math::trig::sqrt),
            supply_v,
            temperature_c: self.thermistor.read(temperature.into(), 4096.0),
            on: self.awake >= WAKE_PERIODS,
            ready: self.zeros.iter().all(Option::is_some),
            stopped: self.pwm.contact_open(),
            unresponsive: self
                .response_states
                .iter()
                .any(response::State::unexplained),
            longest_cycles: self.longest,
            fault: self.fault,
        };
        exchange::put_feedback(feedback);
        let phase = self.pwm.phase_us() as u32 * CYCLES_PER_US;
        TICK_BEGAN.store(self.began.wrapping_sub(phase), Ordering::Relaxed);
        interrupt::TIM7.pend();
    }
}

#[handler]
fn ADC() {
    critical::all(|cs| {
        // Nothing else borrows `DRIVE` once this interrupt is enabled.
        if let Ok(mut drive) = DRIVE.borrow(cs).try_borrow_mut()
            && let Some(drive) = drive.as_mut()
        {
            drive.began = DWT::cycle_count();
            drive.step();
            let took = DWT::cycle_count().wrapping_sub(drive.began);
            drive.longest = drive.longest.max(took);
        }
    });
}

/// Announces a tick; the timer of this interrupt is not used.
#[handler]
fn TIM7() {
    let now = Instant::now().as_micros();
    let since = DWT::cycle_count().wrapping_sub(TICK_BEGAN.load(Ordering::Relaxed));
    TICK.signal(now.saturating_sub(u64::from(since / CYCLES_PER_US)));
}

/// Motors off by registers alone: drivers asleep, pulses off.
fn make_safe() {
    GPIOC.bsrr().write(|w| w.set_br(SLEEP, true));
    Pwm::disable();
}
