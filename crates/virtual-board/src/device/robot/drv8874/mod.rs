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
//! Modelled: propagation delay, dead time (the diodes conduct, which costs voltage), resistance of the transistors,
//! wake and sleep times, undervoltage lockout, nFAULT, transistors stuck on; with IMODE at ground, current regulation
//! with fixed off-time, and retry after an over-current. Not modelled: other settings of IMODE, rise and fall times
//! (150 ns), the charge pump, thermal shutdown, the sensing delay of the current regulation, nFAULT during wake-up (not
//! specified in the data sheet; high here).

mod config;

use super::motor::{Motor, Source, Work};
use crate::chip::Drive;
use crate::device::{later, span_s};
use crate::time::Time;
pub use config::DriverConfig;
use std::collections::VecDeque;

/// Half bridge of the driver, by its output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Half {
    /// Half bridge of the output OUT1.
    One,
    /// Half bridge of the output OUT2.
    Two,
}

/// Transistor of a half bridge that conducts: none, the lower or the upper.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Gate {
    Off,
    Low,
    High,
}

/// A half bridge: its target state, and the end of the dead time with both transistors off.
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

    /// True if a stuck transistor conducts together with the opposite one.
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
    /// nSLEEP is low; the driver works until this time.
    FallingAsleep(Time),
}

/// DRV8874 with its motor.
#[derive(Clone, Debug)]
pub struct Drv8874 {
    config: DriverConfig,
    motor: Motor,
    now: Time,
    due: Time,
    /// Input edges in propagation: arrival time, EN, PH.
    edges: VecDeque<(Time, bool, bool)>,
    /// EN and PH at the pins.
    pins: (bool, bool),
    /// EN and PH at the bridge, after propagation.
    inputs: (bool, bool),
    power: Power,
    supply_v: f64,
    locked_out: bool,
    /// Start of the present over-current, and end of the shutdown after an over-current; `None` if there is none.
    over_since: Option<Time>,
    over_until: Option<Time>,
    /// End of the off-time of the current regulation, in which the bridge brakes; `None` outside of an off-time.
    braking: Option<Time>,
    /// Start of the present or latest pulse, in which the bridge drives the motor.
    driving_since: Time,
    /// End of the latest pulse in which the bridge drove the motor.
    driven_until: Time,
    /// Interval in which nFAULT is forced low and the bridge off; `None` if never forced.
    forced: Option<(Time, Time)>,
    legs: [Leg; 2],
    /// Voltage of OUT1, V, and its latest edge: time and height, V.
    lead_v: f64,
    edge: (Time, f64),
}

impl Drv8874 {
    /// A driver in sleep mode, with its supply at `supply_v`.
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
            over_since: None,
            over_until: None,
            braking: None,
            driving_since: Time(0),
            driven_until: Time(0),
            forced: None,
            legs: [Leg::OFF; 2],
            lead_v: 0.0,
            edge: (Time(0), 0.0),
        };
        driver.settle();
        driver
    }

    /// Sets the level of EN/IN1 from `at` on.
    pub fn enable(&mut self, level: bool, at: Time) {
        self.input((level, self.pins.1), at);
    }

    /// Sets the level of PH/IN2 from `at` on.
    pub fn phase(&mut self, level: bool, at: Time) {
        self.input((self.pins.0, level), at);
    }

    /// True if EN/IN1 is high.
    pub fn is_enabled(&self) -> bool {
        self.pins.0
    }

    /// True if PH/IN2 is high.
    pub fn is_forward(&self) -> bool {
        self.pins.1
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

    /// Sets the level of nSLEEP from `at` on.
    pub fn awake(&mut self, level: bool, at: Time) {
        self.advance(at);
        self.power = match (self.power, level) {
            (Power::Asleep, true) => Power::Waking(at + self.config.wake),
            (Power::FallingAsleep(_), true) => Power::Awake,
            (Power::Awake, false) => Power::FallingAsleep(at + self.config.sleep),
            (Power::Waking(_), false) => Power::Asleep,
            (power, _) => power,
        };
        self.settle();
    }

    /// Sets the supply at VM, V, from `at` on.
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

    /// Sets the speed of the wheel, rad/s, from `at` on.
    pub fn speed(&mut self, rad_s: f64, at: Time) {
        self.advance(at);
        self.motor.set_speed(rad_s);
        self.settle();
    }

    /// Opens or restores a motor lead.
    pub fn set_motor_open(&mut self, open: bool, at: Time) {
        self.advance(at);
        self.motor.set_open(open);
        self.settle();
    }

    /// Sets a transistor of a half bridge stuck on: true for the upper transistor, false for the lower; `None` clears
    /// the fault.
    pub fn set_stuck(&mut self, half: Half, upper: Option<bool>, at: Time) {
        self.advance(at);
        self.legs[half as usize].stuck = upper.map(|up| if up { Gate::High } else { Gate::Low });
        self.settle();
    }

    /// Forces nFAULT low and the bridge off between the times `from` and `to`.
    pub fn force_fault(&mut self, from: Time, to: Time) {
        self.forced = Some((from, to));
        self.settle();
    }

    /// Current from OUT1 through the motor to OUT2, A: positive forward.
    pub fn current(&mut self, at: Time) -> f64 {
        self.advance(at);
        self.motor.current_a()
    }

    /// True while both outputs are low: the motor is shorted and brakes.
    pub fn brakes(&self) -> bool {
        self.legs.iter().all(|leg| leg.gate(self.now) == Gate::Low)
    }

    /// True from the end of the wake-up until the driver has fallen asleep.
    pub fn is_awake(&self) -> bool {
        matches!(self.power, Power::Awake | Power::FallingAsleep(_))
    }

    /// Derivative of the current at the time of the latest call, A/s.
    pub fn current_slope(&self) -> f64 {
        self.motor.slope_a_s()
    }

    /// End of the latest pulse: the latest time at which the supply drove the motor.
    pub fn driven_until(&self) -> Time {
        match self.is_driving() {
            true => self.now,
            false => self.driven_until,
        }
    }

    /// Latest edge of OUT1, which disturbs the current-sense amplifier: time and height, V.
    pub fn latest_edge(&self) -> (Time, f64) {
        self.edge
    }

    /// Integrals of the motor's current since the latest call, up to `at`.
    pub fn take_work(&mut self, at: Time) -> Work {
        self.advance(at);
        self.motor.take_work()
    }

    /// Motor at the driver's outputs.
    pub fn motor(&self) -> &Motor {
        &self.motor
    }

    /// Drive of nFAULT, an open-drain output.
    pub fn fault_pin(&self) -> Drive {
        if self.faults() {
            Drive::Low
        } else {
            Drive::Open
        }
    }

    fn faults(&self) -> bool {
        let works = matches!(self.power, Power::Awake | Power::FallingAsleep(_));
        let own = self.locked_out || self.over_until.is_some();
        (works && own) || self.is_forced()
    }

    fn is_forced(&self) -> bool {
        self.forced
            .is_some_and(|(from, to)| from <= self.now && self.now < to)
    }

    /// Advances to a time, through all events until then.
    pub fn advance(&mut self, to: Time) {
        while self.due <= to {
            self.integrate(self.due);
            self.settle();
        }
        self.integrate(to);
    }

    /// Voltage, V, and resistance, Ω, of an output; `flow` is the sign of the current that flows out.
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

    /// True if the current of this output flows from or to the supply.
    fn is_at_supply(&self, leg: usize, flow: f64) -> bool {
        match self.legs[leg].gate(self.now) {
            Gate::Low => false,
            Gate::High => true,
            Gate::Off => flow < 0.0,
        }
    }

    /// Source at the motor's terminals while its current has the sign of `flow`.
    fn source(&self, flow: f64) -> Source {
        let (first, second) = (self.output(0, flow), self.output(1, -flow));
        let share = |leg, flow| f64::from(u8::from(self.is_at_supply(leg, flow)));
        Source {
            volts: first.0 - second.0,
            ohms: first.1 + second.1,
            share: share(0, flow) - share(1, -flow),
        }
    }

    /// Advances the motor to a time before which no transistor switches and neither supply nor speed changes.
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
                // Neither diode conducts, so the current stays 0.
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

    /// Applies all changes due now and finds the time of the next change.
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

    /// Switches the half bridges to their target states.
    fn switch(&mut self) {
        let [first, second] = self.targets();
        let was_driving = self.is_driving();
        self.legs[0].set(first, self.now, self.config.dead);
        self.legs[1].set(second, self.now, self.config.dead);
        match (was_driving, self.is_driving()) {
            (false, true) => self.driving_since = self.now,
            (true, false) => self.driven_until = self.now,
            _ => {}
        }
    }

    fn take_inputs(&mut self) {
        while let Some(&(at, enable, phase)) = self.edges.front() {
            if at > self.now {
                break;
            }
            self.edges.pop_front();
            self.inputs = (enable, phase);
        }
    }

    fn take_power(&mut self) {
        match self.power {
            Power::Waking(at) if at <= self.now => self.power = Power::Awake,
            Power::FallingAsleep(at) if at <= self.now => {
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

    /// Checks over-current and the limit of the current regulation.
    fn watch_current(&mut self) {
        let current = self.motor.current_a().abs();
        let works = matches!(self.power, Power::Awake | Power::FallingAsleep(_));
        let transistors = self.legs.iter().any(|leg| leg.target != Gate::Off);
        let shorted = self.legs.iter().any(Leg::is_short);
        let over = current >= self.config.over_current_a * (1.0 - 1e-12) || shorted;
        if !(works && transistors && over) {
            self.over_since = None;
        } else if let Some(since) = self.over_since {
            if since + self.config.deglitch <= self.now && self.over_until.is_none() {
                self.over_since = None;
                self.over_until = Some(self.now + self.config.retry);
            }
        } else {
            self.over_since = Some(self.now);
        }
        let trips = self.is_driving()
            && self.braking.is_none()
            && current >= self.config.trip_a * (1.0 - 1e-12)
            && self.driving_since + self.config.blank <= self.now;
        if trips {
            self.braking = Some(self.now + self.config.off_time);
        }
    }

    fn is_driving(&self) -> bool {
        let [a, b] = self.legs.map(|leg| leg.target);
        a != Gate::Off && b != Gate::Off && a != b
    }

    fn targets(&self) -> [Gate; 2] {
        let works = matches!(self.power, Power::Awake | Power::FallingAsleep(_));
        let off = !works || self.locked_out || self.over_until.is_some() || self.is_forced();
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
        let mut consider = |at: Time| {
            if at > self.now && at < due {
                due = at;
            }
        };
        if let Some(edge) = self.edges.front() {
            consider(edge.0);
        }
        for leg in &self.legs {
            consider(leg.dead_until);
        }
        if let Power::Waking(at) | Power::FallingAsleep(at) = self.power {
            consider(at);
        }
        if let Some((from, to)) = self.forced {
            consider(from);
            consider(to);
        }
        for at in [self.over_until, self.braking].into_iter().flatten() {
            consider(at);
        }
        if let Some(since) = self.over_since {
            consider(since + self.config.deglitch);
        }
        let current = self.motor.current_a();
        let source = self.source(if current < 0.0 { -1.0 } else { 1.0 });
        let lowest = self.config.trip_a.min(self.config.over_current_a);
        if self.motor.stays_below(lowest, source) {
            return due;
        }
        let mut reach = |level: f64, earliest: Time| {
            let up = self.motor.time_to(level, source);
            let down = self.motor.time_to(-level, source);
            let at = later(self.now, up.min(down));
            if at != Time::NEVER {
                // The computed time is rounded down. One picosecond later the current has reached the level.
                consider((at + Time(1)).max(earliest));
            }
            if current.abs() >= level {
                consider(earliest);
            }
        };
        if self.legs.iter().any(|leg| leg.target != Gate::Off) && self.over_since.is_none() {
            reach(self.config.over_current_a, Time(0));
        }
        if self.braking.is_none() && self.is_driving() {
            reach(self.config.trip_a, self.driving_since + self.config.blank);
        }
        due
    }
}

#[cfg(test)]
mod tests;
