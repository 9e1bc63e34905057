//! DRV8874 H-bridge driver in phase/enable mode (PMODE low), with its motor.
//!
//! Data sheet: Texas Instruments SLVSF66, "DRV8874 H-Bridge Motor Driver With Integrated Current Sense
//! and Regulation".
//!
//! | nSLEEP | EN/IN1 | PH/IN2 | OUT1 | OUT2 | |
//! |---|---|---|---|---|---|
//! | 0 | – | – | off | off | coast: current flows back through the diodes |
//! | 1 | 0 | – | low | low | brake, slow decay |
//! | 1 | 1 | 0 | low | high | reverse |
//! | 1 | 1 | 1 | high | low | forward |
//!
//! Modelled: propagation delay, dead time (the diodes conduct, so it takes voltage), resistance of the
//! transistors, wake and sleep times, over-current (retry or latch), undervoltage lockout, thermal
//! shutdown, current regulation with fixed off-time or cycle by cycle, nFAULT, and transistors that
//! stay on. Not modelled: rise and fall times (150 ns), the charge pump, sensing delay of the current
//! regulation, what nFAULT shows while the driver wakes up (the data sheet does not say; it is high
//! here).

use super::motor::{Motor, Source, Work};
use super::{later, span_s};
use crate::chip::Drive;
use crate::time::Time;
use std::collections::VecDeque;

/// How the driver limits the current at `trip_a`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Regulation {
    /// Not at all.
    Off,
    /// Brakes for the off-time, then drives again.
    FixedOffTime,
    /// Brakes until the next edge of EN, with nFAULT low meanwhile.
    CycleByCycle,
}

/// What follows an over-current.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OverCurrent {
    /// Off for the retry time, then on again.
    Retry,
    /// Off until nSLEEP was low or the supply away.
    Latched,
}

/// Characteristics of the driver and what is soldered to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriverConfig {
    /// Resistance of each transistor, Ω. Data sheet: 0.1 typical at 25 °C.
    pub on_ohm: f64,
    /// Forward voltage of the transistors' diodes, V. Data sheet: 0.9.
    pub diode_v: f64,
    /// From an input's edge to the output. Data sheet: 650 ns.
    pub propagation: Time,
    /// Both transistors of a half bridge off between one and the other. Data sheet: 300 ns.
    pub dead: Time,
    /// From nSLEEP high to driving. Data sheet: 1 ms.
    pub wake: Time,
    /// From nSLEEP low to off; the inputs are obeyed until then. Data sheet: 1 ms.
    pub sleep: Time,
    /// How the current is regulated, by the resistor at IMODE.
    pub regulation: Regulation,
    /// Where, A: V(VREF) over R(IPROPI) over 455 µA/A. Default 6.5: above 6 A.
    pub trip_a: f64,
    /// Off-time of the regulation. Data sheet: 25 µs.
    pub off_time: Time,
    /// From driving to the earliest regulation. Data sheet: 1.1 µs.
    pub blank: Time,
    /// What follows an over-current, by the resistor at IMODE.
    pub over_current: OverCurrent,
    /// Over-current, A. Data sheet: at least 6; default 8.
    pub over_current_a: f64,
    /// How long it must last. Data sheet: 3 µs.
    pub deglitch: Time,
    /// Until it is tried again. Data sheet: 2 ms.
    pub retry: Time,
    /// Undervoltage lockout: off below the first, on above the second, V. Data sheet: 4.35 and 4.45.
    pub lockout_v: (f64, f64),
    /// Thermal shutdown: off above the first, on below the second, °C. Data sheet: 175, 20 less.
    pub hot_c: (f64, f64),
}

impl Default for DriverConfig {
    fn default() -> Self {
        Self {
            on_ohm: 0.1,
            diode_v: 0.9,
            propagation: Time::from_nanos(650),
            dead: Time::from_nanos(300),
            wake: Time::from_micros(1000),
            sleep: Time::from_micros(1000),
            regulation: Regulation::FixedOffTime,
            trip_a: 6.5,
            off_time: Time::from_micros(25),
            blank: Time::from_nanos(1100),
            over_current: OverCurrent::Retry,
            over_current_a: 8.0,
            deglitch: Time::from_micros(3),
            retry: Time::from_micros(2000),
            lockout_v: (4.35, 4.45),
            hot_c: (175.0, 155.0),
        }
    }
}

/// A half bridge.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Half {
    /// OUT1.
    One,
    /// OUT2.
    Two,
}

/// What a half bridge does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Gate {
    Off,
    Low,
    High,
}

/// A half bridge: what it is to do, and until when both transistors are still off.
#[derive(Clone, Copy, Debug)]
struct Leg {
    target: Gate,
    dead_until: Time,
    stuck: Option<Gate>,
}

impl Leg {
    const OFF: Self = Self {
        target: Gate::Off,
        dead_until: Time(0),
        stuck: None,
    };

    fn gate(&self, at: Time) -> Gate {
        match self.stuck {
            Some(gate) => gate,
            None if at < self.dead_until => Gate::Off,
            None => self.target,
        }
    }

    fn set(&mut self, target: Gate, at: Time, dead: Time) {
        if target != self.target {
            let crosses = target != Gate::Off && self.target != Gate::Off;
            self.target = target;
            self.dead_until = if crosses { at + dead } else { at };
        }
    }

    /// A transistor that stays on against one that is switched on.
    fn is_short(&self) -> bool {
        matches!(
            (self.stuck, self.target),
            (Some(Gate::High), Gate::Low) | (Some(Gate::Low), Gate::High)
        )
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Power {
    Asleep,
    Waking(Time),
    Awake,
    /// nSLEEP is low, the driver works on until then.
    Dozing(Time),
}

/// Driver and motor.
#[derive(Clone, Debug)]
pub struct Drv8874 {
    config: DriverConfig,
    motor: Motor,
    now: Time,
    due: Time,
    /// Inputs on their way through the driver: when they arrive, EN, PH.
    edges: VecDeque<(Time, bool, bool)>,
    /// EN and PH at the pins.
    pins: (bool, bool),
    /// EN and PH as the bridge has them.
    inputs: (bool, bool),
    power: Power,
    supply_v: f64,
    locked_out: bool,
    hot: bool,
    /// Over-current: since when it lasts, and until when the driver is off for it.
    over_since: Option<Time>,
    over_until: Option<Time>,
    /// The current regulation brakes until then ([`Time::NEVER`]: until the next edge).
    braking: Option<Time>,
    /// Since when the bridge drives.
    driving_since: Time,
    /// nFAULT held low, and the bridge off, from outside.
    forced: Option<(Time, Time)>,
    legs: [Leg; 2],
    /// Voltage of OUT1, and its latest edge: when, and by how much.
    lead_v: f64,
    edge: (Time, f64),
}

impl Drv8874 {
    /// Asleep, its supply at `supply_v`.
    pub fn new(config: DriverConfig, motor: Motor, supply_v: f64) -> Self {
        let mut driver = Self {
            config,
            motor,
            now: Time(0),
            due: Time::NEVER,
            edges: VecDeque::with_capacity(8),
            pins: (false, false),
            inputs: (false, false),
            power: Power::Asleep,
            supply_v,
            locked_out: supply_v < config.lockout_v.1,
            hot: false,
            over_since: None,
            over_until: None,
            braking: None,
            driving_since: Time(0),
            forced: None,
            legs: [Leg::OFF; 2],
            lead_v: 0.0,
            edge: (Time(0), 0.0),
        };
        driver.settle();
        driver
    }

    /// EN/IN1 has this level from now on.
    pub fn enable(&mut self, level: bool, at: Time) {
        self.input((level, self.pins.1), at);
    }

    /// PH/IN2 has this level from now on.
    pub fn phase(&mut self, level: bool, at: Time) {
        self.input((self.pins.0, level), at);
    }

    fn input(&mut self, pins: (bool, bool), at: Time) {
        self.advance(at);
        if pins != self.pins {
            self.pins = pins;
            let arrives = at + self.config.propagation;
            self.edges.push_back((arrives, pins.0, pins.1));
            self.due = self.due.min(arrives);
        }
    }

    /// nSLEEP has this level from now on.
    pub fn awake(&mut self, level: bool, at: Time) {
        self.advance(at);
        self.power = match (self.power, level) {
            (Power::Asleep, true) => Power::Waking(at + self.config.wake),
            (Power::Dozing(_), true) => Power::Awake,
            (Power::Awake, false) => Power::Dozing(at + self.config.sleep),
            (Power::Waking(_), false) => Power::Asleep,
            (power, _) => power,
        };
        self.settle();
    }

    /// The supply at VM, V, from now on.
    pub fn supply(&mut self, volts: f64, at: Time) {
        self.advance(at);
        self.supply_v = volts;
        if volts < self.config.lockout_v.0 {
            self.locked_out = true;
            self.over_until = None;
        } else if volts > self.config.lockout_v.1 {
            self.locked_out = false;
        }
        self.settle();
    }

    /// Temperature of the driver, °C, from now on.
    pub fn junction(&mut self, celsius: f64, at: Time) {
        self.advance(at);
        if celsius > self.config.hot_c.0 {
            self.hot = true;
        } else if celsius < self.config.hot_c.1 {
            self.hot = false;
        }
        self.settle();
    }

    /// Speed of the wheel, rad/s, from now on.
    pub fn speed(&mut self, rad_s: f64, at: Time) {
        self.advance(at);
        self.motor.set_speed(rad_s);
        self.settle();
    }

    /// Breaks a lead of the motor, or mends it.
    pub fn set_motor_open(&mut self, open: bool, at: Time) {
        self.advance(at);
        self.motor.set_open(open);
        self.settle();
    }

    /// A transistor of a half bridge stays on, the upper or the lower one; `None` mends it.
    pub fn set_stuck(&mut self, half: Half, upper: Option<bool>, at: Time) {
        self.advance(at);
        self.legs[half as usize].stuck = upper.map(|up| if up { Gate::High } else { Gate::Low });
        self.settle();
    }

    /// From one time to another the driver reports a fault and is off.
    pub fn force_fault(&mut self, from: Time, to: Time) {
        self.forced = Some((from, to));
        self.settle();
    }

    /// Current from OUT1 through the motor to OUT2, A: positive forward.
    pub fn current(&mut self, at: Time) -> f64 {
        self.advance(at);
        self.motor.current_a()
    }

    /// Derivative of the current at the time of the latest call, A/s.
    pub fn current_slope(&self) -> f64 {
        self.motor.slope_a_s()
    }

    /// The latest edge of OUT1, to which the shunt's amplifier answers: when, and by how much, V.
    pub fn latest_edge(&self) -> (Time, f64) {
        self.edge
    }

    /// What the motor did since the last call.
    pub fn take_work(&mut self, at: Time) -> Work {
        self.advance(at);
        self.motor.take_work()
    }

    /// The motor.
    pub fn motor(&self) -> &Motor {
        &self.motor
    }

    /// How nFAULT is driven: an open drain.
    pub fn fault_pin(&self) -> Drive {
        if self.faults() {
            Drive::Low
        } else {
            Drive::Open
        }
    }

    fn faults(&self) -> bool {
        let works = matches!(self.power, Power::Awake | Power::Dozing(_));
        let chops = self.braking.is_some() && self.config.regulation == Regulation::CycleByCycle;
        let own = self.locked_out || self.hot || self.over_until.is_some() || chops;
        (works && own) || self.is_forced()
    }

    fn is_forced(&self) -> bool {
        self.forced
            .is_some_and(|(from, to)| from <= self.now && self.now < to)
    }

    /// When something of it changes by itself.
    pub fn next(&self) -> Time {
        self.due
    }

    /// Goes on until a time, with all that happens by itself until then.
    pub fn advance(&mut self, to: Time) {
        while self.due <= to {
            self.integrate(self.due);
            self.settle();
        }
        self.integrate(to);
    }

    /// Voltage at an output and its resistance; `flow` is the current's direction out of it.
    fn output(&self, leg: usize, flow: f64) -> (f64, f64) {
        let DriverConfig {
            on_ohm, diode_v, ..
        } = self.config;
        match self.legs[leg].gate(self.now) {
            Gate::Low => (0.0, on_ohm),
            Gate::High => (self.supply_v, on_ohm),
            Gate::Off if flow > 0.0 => (-diode_v, 0.0),
            Gate::Off => (self.supply_v + diode_v, 0.0),
        }
    }

    /// Whether the supply is at this output.
    fn is_at_supply(&self, leg: usize, flow: f64) -> bool {
        match self.legs[leg].gate(self.now) {
            Gate::Low => false,
            Gate::High => true,
            Gate::Off => flow < 0.0,
        }
    }

    /// What the motor sees while its current flows in a direction.
    fn source(&self, flow: f64) -> Source {
        let (first, second) = (self.output(0, flow), self.output(1, -flow));
        let share = |leg, flow| f64::from(u8::from(self.is_at_supply(leg, flow)));
        Source {
            volts: first.0 - second.0,
            ohms: first.1 + second.1,
            share: share(0, flow) - share(1, -flow),
        }
    }

    /// Goes on under constant conditions.
    fn integrate(&mut self, to: Time) {
        if to <= self.now {
            return;
        }
        let mut span = span_s(self.now, to);
        let diodes = [0, 1]
            .map(|leg| self.legs[leg].gate(self.now))
            .contains(&Gate::Off);
        if !diodes {
            self.motor.advance(self.source(1.0), span);
            span = 0.0;
        }
        while span > 0.0 {
            let current = self.motor.current_a();
            let (forward, backward) = (self.source(1.0), self.source(-1.0));
            let emf = self.motor.emf_v();
            let source = if current > 0.0 || (current == 0.0 && forward.volts > emf) {
                forward
            } else if current < 0.0 || backward.volts < emf {
                backward
            } else {
                // Neither diode conducts.
                self.motor.idle(span);
                break;
            };
            let stop = self.motor.time_to(0.0, source);
            if stop < span {
                self.motor.advance(source, stop);
                self.motor.idle(0.0);
                span -= stop;
            } else {
                self.motor.advance(source, span);
                if self.motor.is_open() {
                    self.motor.idle(0.0);
                }
                break;
            }
        }
        self.now = to;
    }

    /// Brings everything to the present moment and finds out when it changes next.
    fn settle(&mut self) {
        self.take_inputs();
        self.take_power();
        self.switch();
        self.watch_current();
        self.switch();
        let lead_v = self.output(0, self.motor.current_a()).0;
        if lead_v != self.lead_v {
            self.edge = (self.now, lead_v - self.lead_v);
            self.lead_v = lead_v;
        }
        self.due = self.find_due();
    }

    /// Has the half bridges do what they are to do now.
    fn switch(&mut self) {
        let [first, second] = self.targets();
        let was_driving = self.is_driving();
        self.legs[0].set(first, self.now, self.config.dead);
        self.legs[1].set(second, self.now, self.config.dead);
        if self.is_driving() && !was_driving {
            self.driving_since = self.now;
        }
    }

    fn take_inputs(&mut self) {
        while let Some(&(at, enable, phase)) = self.edges.front() {
            if at > self.now {
                break;
            }
            self.edges.pop_front();
            self.inputs = (enable, phase);
            if self.braking == Some(Time::NEVER) {
                self.braking = None;
            }
        }
    }

    fn take_power(&mut self) {
        match self.power {
            Power::Waking(at) if at <= self.now => self.power = Power::Awake,
            Power::Dozing(at) if at <= self.now => {
                self.power = Power::Asleep;
                (self.over_until, self.over_since, self.braking) = (None, None, None);
            }
            _ => {}
        }
        if self.over_until.is_some_and(|until| until <= self.now) {
            self.over_until = None;
        }
        if self.braking.is_some_and(|until| until <= self.now) {
            self.braking = None;
        }
    }

    /// Over-current and the regulation's limit.
    fn watch_current(&mut self) {
        let current = self.motor.current_a().abs();
        let works = matches!(self.power, Power::Awake | Power::Dozing(_));
        let transistors = self.legs.iter().any(|leg| leg.target != Gate::Off);
        let shorted = self.legs.iter().any(Leg::is_short);
        let over = current >= self.config.over_current_a * (1.0 - 1e-12) || shorted;
        if !(works && transistors && over) {
            self.over_since = None;
        } else if let Some(since) = self.over_since {
            if since + self.config.deglitch <= self.now && self.over_until.is_none() {
                self.over_since = None;
                self.over_until = Some(match self.config.over_current {
                    OverCurrent::Retry => self.now + self.config.retry,
                    OverCurrent::Latched => Time::NEVER,
                });
            }
        } else {
            self.over_since = Some(self.now);
        }
        let trips = self.config.regulation != Regulation::Off
            && self.is_driving()
            && self.braking.is_none()
            && current >= self.config.trip_a * (1.0 - 1e-12)
            && self.driving_since + self.config.blank <= self.now;
        if trips {
            self.braking = Some(match self.config.regulation {
                Regulation::FixedOffTime => self.now + self.config.off_time,
                _ => Time::NEVER,
            });
        }
    }

    fn is_driving(&self) -> bool {
        let [a, b] = self.legs.map(|leg| leg.target);
        a != Gate::Off && b != Gate::Off && a != b
    }

    fn targets(&self) -> [Gate; 2] {
        let works = matches!(self.power, Power::Awake | Power::Dozing(_));
        let off =
            !works || self.locked_out || self.hot || self.over_until.is_some() || self.is_forced();
        match self.inputs {
            _ if off => [Gate::Off; 2],
            _ if self.braking.is_some() => [Gate::Low; 2],
            (false, _) => [Gate::Low; 2],
            (true, false) => [Gate::Low, Gate::High],
            (true, true) => [Gate::High, Gate::Low],
        }
    }

    fn find_due(&self) -> Time {
        let mut due = Time::NEVER;
        let mut see = |at: Time| {
            if at > self.now && at < due {
                due = at;
            }
        };
        if let Some(edge) = self.edges.front() {
            see(edge.0);
        }
        for leg in &self.legs {
            see(leg.dead_until);
        }
        if let Power::Waking(at) | Power::Dozing(at) = self.power {
            see(at);
        }
        if let Some((from, to)) = self.forced {
            see(from);
            see(to);
        }
        for at in [self.over_until, self.braking].into_iter().flatten() {
            see(at);
        }
        if let Some(since) = self.over_since {
            see(since + self.config.deglitch);
        }
        let current = self.motor.current_a();
        let source = self.source(if current < 0.0 { -1.0 } else { 1.0 });
        let mut reach = |level: f64, earliest: Time| {
            let up = self.motor.time_to(level, source);
            let down = self.motor.time_to(-level, source);
            let at = later(self.now, up.min(down));
            if at != Time::NEVER {
                // Not before it is really there: the time was rounded down.
                see((at + Time(1)).max(earliest));
            }
            if current.abs() >= level {
                see(earliest);
            }
        };
        if self.legs.iter().any(|leg| leg.target != Gate::Off) && self.over_since.is_none() {
            reach(self.config.over_current_a, Time(0));
        }
        let regulates = self.config.regulation != Regulation::Off && self.braking.is_none();
        if regulates && self.is_driving() {
            reach(self.config.trip_a, self.driving_since + self.config.blank);
        }
        due
    }
}

#[cfg(test)]
mod tests {
    use super::super::motor::MotorConfig;
    use super::*;

    const MS: u64 = 1_000_000_000;
    const NS: u64 = 1_000;

    fn ideal() -> DriverConfig {
        DriverConfig {
            propagation: Time(0),
            dead: Time(0),
            ..DriverConfig::default()
        }
    }

    /// Awake since 1 ms.
    fn awake(config: DriverConfig, motor: MotorConfig) -> Drv8874 {
        let mut driver = Drv8874::new(config, Motor::new(motor), 12.0);
        driver.awake(true, Time(0));
        driver.advance(Time(MS));
        driver
    }

    /// Periods of 50 µs with `duty`; gives the least and the largest current of the last one.
    fn run(driver: &mut Drv8874, from: Time, periods: u64, duty: f64) -> (f64, f64) {
        let period = Time::from_micros(50);
        let on = Time((period.0 as f64 * duty) as u64);
        let (mut low, mut high) = (0.0, 0.0);
        for k in 0..periods {
            let at = Time(from.0 + k * period.0);
            driver.enable(true, at);
            low = driver.current(at);
            driver.enable(false, at + on);
            high = driver.current(at + on);
        }
        driver.advance(Time(from.0 + periods * period.0));
        (low, high)
    }

    #[test]
    fn ripple_and_mean_as_in_the_textbook() {
        let motor = MotorConfig::default();
        let mut driver = awake(ideal(), motor);
        driver.phase(true, Time(MS));
        driver.speed(3.0, Time(MS));
        run(&mut driver, Time(MS), 400, 0.4);
        driver.take_work(Time(21 * MS));
        let (low, high) = run(&mut driver, Time(21 * MS), 20, 0.4);
        // Steady state of an R-L circuit that is switched between 12 V and 0.
        let ohms = motor.resistance_ohm + 0.2;
        let tau = motor.inductance_h / ohms;
        let emf = motor.constant_nm_a * 3.0 / ohms;
        let (on, off) = (20e-6 / tau, 30e-6 / tau);
        let peak = 12.0 / ohms * (1.0 - (-on).exp()) / (1.0 - (-on - off).exp()) - emf;
        let valley = (peak + emf) * (-off).exp() - emf;
        assert!((high - peak).abs() < 1e-9, "{high} {peak}");
        assert!((low - valley).abs() < 1e-9, "{low} {valley}");
        let mean = driver.take_work(Time(22 * MS)).mean_current_a();
        let expected = (0.4 * 12.0 - motor.constant_nm_a * 3.0) / ohms;
        assert!((mean - expected).abs() < 1e-9, "{mean} {expected}");
    }

    #[test]
    fn dead_time_takes_voltage_and_the_propagation_none() {
        let motor = MotorConfig::default();
        let mut driver = awake(DriverConfig::default(), motor);
        driver.phase(true, Time(MS));
        run(&mut driver, Time(MS), 400, 0.5);
        driver.take_work(Time(21 * MS));
        run(&mut driver, Time(21 * MS), 20, 0.5);
        let work = driver.take_work(Time(22 * MS));
        // Of each period: both edges have 300 ns at −0.9 V; the rising one shortens ON by as much.
        let ohms = motor.resistance_ohm + 0.2;
        let volts = (12.0 * (25.0 - 0.3) - 0.9 * 0.6) / 50.0;
        let expected = volts / ohms;
        let mean = work.mean_current_a();
        assert!((mean - expected).abs() < 3e-3, "{mean} {expected}");
        // The supply gives current while ON only.
        let share = work.mean_supplied_a() / mean;
        assert!((share - 0.494).abs() < 2e-3, "{share}");
    }

    #[test]
    fn wakes_after_a_millisecond_and_sleeps_after_one() {
        let mut driver = Drv8874::new(
            DriverConfig::default(),
            Motor::new(MotorConfig::default()),
            12.0,
        );
        driver.phase(true, Time(0));
        driver.enable(true, Time(0));
        driver.awake(true, Time(5 * MS));
        assert_eq!(driver.current(Time(6 * MS - 1)), 0.0);
        assert_eq!(driver.next(), Time(6 * MS));
        assert!(driver.current(Time(6 * MS + 100_000 * NS)) > 0.4);
        driver.awake(false, Time(7 * MS));
        assert!(driver.current(Time(8 * MS - 1)) > 2.0);
        // Off: the current falls against 12 V and two diodes and stops, it does not turn back.
        assert_eq!(driver.current(Time(9 * MS)), 0.0);
        let work = driver.take_work(Time(9 * MS));
        assert!(work.supplied_as < work.charge_as);
        driver.awake(true, Time(9 * MS));
        driver.awake(false, Time(9 * MS + 1));
        assert_eq!(driver.next(), Time::NEVER);
    }

    #[test]
    fn coasting_current_ends_when_the_closed_form_says() {
        let motor = MotorConfig::default();
        let mut driver = awake(ideal(), motor);
        driver.phase(true, Time(MS));
        driver.enable(true, Time(MS));
        driver.awake(false, Time(MS));
        let start = driver.current(Time(2 * MS));
        // i(t) = (i₀ + V/R) e^(−t/τ) − V/R with V = 12 + 2·0.9, R of the motor alone.
        let (ohms, volts) = (motor.resistance_ohm, 13.8);
        let end = motor.inductance_h / ohms * (1.0 + start * ohms / volts).ln();
        let end_ps = (end * 1e12) as u64;
        assert!(driver.current(Time(2 * MS + end_ps - 1000 * NS)) > 0.0);
        assert_eq!(driver.current(Time(2 * MS + end_ps + NS)), 0.0);
    }

    #[test]
    fn braking_turns_speed_into_current_backwards() {
        let motor = MotorConfig::default();
        let mut driver = awake(ideal(), motor);
        driver.speed(10.0, Time(MS));
        let expected = -motor.constant_nm_a * 10.0 / (motor.resistance_ohm + 0.2);
        assert!((driver.current(Time(101 * MS)) - expected).abs() < 1e-9);
        // Turned faster than the supply, a sleeping bridge rectifies.
        driver.awake(false, Time(101 * MS));
        driver.speed(30.0, Time(110 * MS));
        let charging = -(0.6 * 30.0 - 13.8) / motor.resistance_ohm;
        assert!((driver.current(Time(200 * MS)) - charging).abs() < 1e-9);
        driver.take_work(Time(200 * MS));
        let work = driver.take_work(Time(201 * MS));
        assert!((work.mean_supplied_a() - charging).abs() < 1e-9);
    }

    #[test]
    fn over_current_switches_off_and_tries_again() {
        let stalled = MotorConfig {
            resistance_ohm: 0.5,
            ..MotorConfig::default()
        };
        let config = DriverConfig {
            regulation: Regulation::Off,
            ..ideal()
        };
        let mut driver = awake(config, stalled);
        driver.phase(true, Time(MS));
        driver.enable(true, Time(MS));
        // 8 A of 12/0.7 after −τ ln(1 − 8·0.7/12), and 3 µs more.
        let tau = 2.3e-3 / 0.7;
        let trips = -tau * (1.0f64 - 8.0 * 0.7 / 12.0).ln() + 3e-6;
        let at = Time(MS + (trips * 1e12) as u64);
        driver.advance(at - Time(10 * NS));
        assert_eq!(driver.fault_pin(), Drive::Open);
        driver.advance(at + Time(10 * NS));
        assert_eq!(driver.fault_pin(), Drive::Low);
        driver.advance(at + Time(2 * MS - 20 * NS));
        assert_eq!(
            (driver.fault_pin(), driver.current_slope()),
            (Drive::Low, 0.0)
        );
        driver.advance(at + Time(2 * MS + 20 * NS));
        assert_eq!(driver.fault_pin(), Drive::Open);
        assert!(driver.current_slope() > 0.0);
    }

    #[test]
    fn regulation_holds_the_current_near_its_limit() {
        for (regulation, low) in [
            (Regulation::FixedOffTime, false),
            (Regulation::CycleByCycle, true),
        ] {
            let config = DriverConfig {
                regulation,
                trip_a: 2.0,
                ..ideal()
            };
            let mut driver = awake(config, MotorConfig::default());
            driver.phase(true, Time(MS));
            driver.enable(true, Time(MS));
            // The limit is reached at −τ ln(1 − 2·3.08/12) = 0.537 ms.
            driver.advance(Time(MS + 545_000 * NS));
            assert_eq!(driver.fault_pin() == Drive::Low, low);
            let mut largest = 0.0f64;
            for k in 0..2000 {
                largest = largest.max(driver.current(Time(2 * MS + k * 1000 * NS)));
            }
            assert!(largest <= 2.0 + 1e-6, "{largest}");
            // It brakes for 25 µs of 2 A: down by 6.7 %. Cycle by cycle it brakes until an edge.
            let held = driver.current(Time(4 * MS));
            assert_eq!(held > 1.8, !low, "{held}");
            driver.enable(false, Time(4 * MS));
            driver.enable(true, Time(4 * MS + 1));
            driver.advance(Time(4 * MS + 1000 * NS));
            assert_eq!(driver.fault_pin(), Drive::Open);
        }
    }

    #[test]
    fn supply_and_temperature_switch_off_and_on_by_themselves() {
        let mut driver = awake(ideal(), MotorConfig::default());
        for (volts, low) in [(5.0, false), (4.3, true), (4.4, true), (4.5, false)] {
            driver.supply(volts, Time(2 * MS));
            assert_eq!(driver.fault_pin() == Drive::Low, low, "{volts}");
        }
        for (celsius, low) in [(170.0, false), (176.0, true), (160.0, true), (150.0, false)] {
            driver.junction(celsius, Time(3 * MS));
            assert_eq!(driver.fault_pin() == Drive::Low, low, "{celsius}");
        }
    }

    #[test]
    fn faults_from_outside() {
        let mut driver = awake(ideal(), MotorConfig::default());
        driver.phase(true, Time(MS));
        driver.force_fault(Time(2 * MS), Time(3 * MS));
        driver.enable(true, Time(MS));
        for (at, low) in [(1999, false), (2001, true), (2999, true), (3001, false)] {
            driver.advance(Time(at * MS / 1000));
            assert_eq!(driver.fault_pin() == Drive::Low, low, "{at}");
        }
        driver.set_motor_open(true, Time(4 * MS));
        assert_eq!(driver.current(Time(5 * MS)), 0.0);
        driver.set_motor_open(false, Time(5 * MS));
        assert!(driver.current(Time(6 * MS)) > 1.0);
        // The upper transistor of OUT1 stays on: braking is a short, which the driver ends; asleep
        // the motor gets no current through it, as OUT2 is off.
        driver.set_stuck(Half::One, Some(true), Time(6 * MS));
        driver.enable(false, Time(7 * MS));
        driver.advance(Time(7 * MS + 3001 * NS));
        assert_eq!(driver.fault_pin(), Drive::Low);
        driver.awake(false, Time(8 * MS));
        assert_eq!(driver.current(Time(20 * MS)), 0.0);
        // Both halves stay on: nothing stops the motor.
        driver.set_stuck(Half::Two, Some(false), Time(20 * MS));
        assert!((driver.current(Time(40 * MS)) - 12.0 / 3.08).abs() < 1e-6);
    }
}
