//! The axle's tick, once a millisecond: sample → receive → node → limit → command → send.
//!
//! The front board's clock is the common time, and its lead node runs here too; the rear board
//! follows by [`CommonClock`]. A board whose clock was moved begins anew with motors off, since
//! nothing it remembers has a valid time.

use core_algos::bus::{Axle, Message};
use core_algos::control::wheel_observer::{self, WheelObserver};
use core_algos::drive::winding::{self, Winding, fold_back};
use core_algos::node::board::{Board, Output, Role, Samples};
use core_algos::node::clock::{CommonClock, Tick};
use core_algos::node::{EPOCH, Micros, Outbox, TICK, axle, is_epoch_start, sequence};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::watch;
use firmware_common::can::{Receiver, Sender};
use firmware_common::timing::Stopwatch;

use super::encoders::Encoders;
use super::inertial::Inertial;
use super::motors::{Command, Feedback, Motors};
use super::operator::Button;

/// Temperatures of the driver, °C: fold-back begins, nothing is left.
const DRIVER_C: (f32, f32) = (85.0, 105.0);
/// Ticks between health reports on the bus.
const HEALTH: Micros = 100 * TICK;
/// Ticks missed in a row that the nodes pass over; more of them, or a clock that was moved, and they
/// begin anew.
const PASSED_OVER: Micros = 5 * TICK;

/// What the log is told.
#[derive(Clone, Copy, Debug)]
pub struct Report {
    /// Motors.
    pub feedback: Feedback,
    /// Windings, °C.
    pub winding_c: [f32; 2],
    /// Whether the common time is known and ticks are in step with it.
    pub in_step: bool,
    /// Largest jitter and longest tick since the last report, µs.
    pub timing_us: (u16, u16),
    /// Ticks missed and times the nodes began anew, since the start.
    pub missed: u16,
    /// Times the nodes began anew because the clock was moved.
    pub restarts: u16,
    /// Whether the inertial sensor answers.
    pub inertial: bool,
}

/// Where the tick leaves its report.
pub type Reports = watch::Sender<'static, CriticalSectionRawMutex, Report, 1>;

/// Everything the tick works with.
pub struct Axis {
    /// Motors.
    pub motors: Motors,
    /// Encoders.
    pub encoders: Encoders,
    /// Inertial sensor.
    pub inertial: Inertial,
    /// Operator's button.
    pub button: Button,
    /// Bus, outwards.
    pub sender: Sender,
    /// Bus, inwards.
    pub receiver: Receiver,
    /// The nodes, and the same as they were at the start.
    pub nodes: (&'static mut Board, &'static Board),
    /// Wheel observers for the back-EMF.
    pub observer: WheelObserver,
    /// Thermal model of the motors.
    pub winding: Winding,
    /// Where reports go.
    pub reports: Reports,
}

/// All that changes from tick to tick.
struct State {
    clock: CommonClock,
    last: Option<Micros>,
    /// When the latest epoch began, on the front board.
    epoch_began: Micros,
    own: Outbox,
    wheels: [wheel_observer::State; 2],
    windings: [winding::State; 2],
    missed: u16,
    restarts: u16,
}

/// Runs the tick for ever.
#[embassy_executor::task]
pub async fn run(mut axis: Axis) -> ! {
    let mut stopwatch = Stopwatch::new(TICK as u32);
    let mut state = State {
        clock: CommonClock::default(),
        last: None,
        epoch_began: 0,
        own: Outbox::new(),
        wheels: [wheel_observer::State::default(); 2],
        windings: [axis.winding.at_start(); 2],
        missed: 0,
        restarts: 0,
    };
    loop {
        let local = axis.motors.tick().await;
        stopwatch.begin();
        let command = axis.tick(&mut state, local);
        axis.motors.command(command);
        stopwatch.end();
        if local / HEALTH != local.saturating_sub(TICK) / HEALTH {
            axis.report_health(&mut state, local, stopwatch.take());
        }
    }
}

impl Axis {
    /// One tick at local time `local`.
    fn tick(&mut self, state: &mut State, local: Micros) -> Command {
        let feedback = self.motors.feedback();
        let encoder = self.encoders.read();
        let inertial = self.inertial.read(!feedback.on);
        for i in 0..2 {
            state.wheels[i] = self.observer.step(&state.wheels[i], Some(encoder[i]));
        }

        let now = self.now(state, local);
        self.receive(state, now);
        let Some(now) = now else {
            return Command::default();
        };
        self.synchronise(state, now);
        self.button.step(now, self.nodes.0);
        let samples = Samples::Axle(axle::Samples {
            encoder: encoder.map(Some),
            gyro_rad_s: inertial.gyro_rad_s,
            acceleration_m_s2: inertial.acceleration_m_s2,
        });
        let mut outbox = Outbox::new();
        let output = self.nodes.0.step(now, &samples, &mut outbox);
        for message in outbox.iter() {
            self.send(state, message);
        }
        self.limited(state, &feedback, &output)
    }

    /// The common time of this tick; `None` while it is not known or the tick is out of step, when
    /// nothing may be driven.
    fn now(&mut self, state: &mut State, local: Micros) -> Option<Micros> {
        let common = match self.nodes.0.role() {
            Role::Front => Some(local),
            _ => state.clock.common(local),
        };
        let tick = common.map(Tick::of);
        self.motors.trim(tick.map_or(0, |tick| tick.trim()));
        let now = tick.filter(Tick::in_step).map(|tick| tick.now);
        if let (Some(now), Some(last)) = (now, state.last) {
            let passed = now.saturating_sub(last);
            if passed > TICK && passed <= PASSED_OVER {
                let missed = (passed / TICK - 1) as u16;
                state.missed = state.missed.saturating_add(missed);
            } else if passed != TICK {
                self.nodes.0.clone_from(self.nodes.1);
                self.button.forget();
                state.own.clear();
                state.restarts = state.restarts.saturating_add(1);
            }
        }
        if now.is_some() {
            state.last = now;
        }
        now
    }

    /// Hands the nodes what came since the last tick, and what they sent each other then.
    fn receive(&mut self, state: &mut State, now: Option<Micros>) {
        if let Some(now) = now {
            for message in state.own.iter() {
                self.nodes.0.receive(now, message);
            }
        }
        state.own.clear();
        while let Some(arrived) = self.receiver.take() {
            state.clock.receive(arrived.local, &arrived.message);
            if let Some(now) = now {
                self.nodes.0.receive(now, &arrived.message);
            }
        }
    }

    /// On the front board: begins each epoch with the common time.
    fn synchronise(&mut self, state: &mut State, now: Micros) {
        if self.nodes.0.role() != Role::Front || !is_epoch_start(now) {
            return;
        }
        let sent = self.sender.take_sync_sent();
        let last_delay_us = sent
            .and_then(|sent| sent.checked_sub(state.epoch_began))
            .filter(|&delay| delay < EPOCH)
            .map(|delay| delay as u16);
        state.epoch_began = now;
        self.sender.send(&Message::TimeSync {
            epoch: (now / EPOCH) as u32,
            last_delay_us,
        });
    }

    /// Sends a message; the nodes of this board get it at the next tick, as the others read it.
    fn send(&mut self, state: &mut State, message: &Message) {
        if let Some(message) = self.sender.send(message) {
            state.own.push(message);
        }
    }

    /// What the node asks for, within what motors and drivers stand.
    fn limited(&self, state: &mut State, feedback: &Feedback, output: &Output) -> Command {
        // Without its thermistor a driver is taken as half warm.
        let driver = match feedback.temperature_c {
            Some(temperature) => fold_back(temperature, DRIVER_C.0, DRIVER_C.1),
            None => 0.5,
        };
        let mut command = Command {
            on: output.active,
            torque_nm: output.torque_nm,
            ..Command::default()
        };
        for i in 0..2 {
            command.speed_rad_s[i] = state.wheels[i].speed_rad_s;
            command.limit_a[i] =
                self.winding
                    .step(&mut state.windings[i], feedback.current_a[i], driver);
        }
        command
    }

    fn report_health(&mut self, state: &mut State, local: Micros, timing_us: (u16, u16)) {
        let feedback = self.motors.feedback();
        let winding_c = state.windings.map(|winding| winding.temperature_c);
        let board = self.nodes.0.role();
        let now = state.last.unwrap_or(local);
        let warmest = winding_c[0]
            .max(winding_c[1])
            .max(feedback.temperature_c.unwrap_or(-128.0));
        self.sender.send(&Message::BoardHealth {
            board,
            sequence: sequence(now),
            missed_ticks: state.missed.min(255) as u8,
            tick_jitter_us: timing_us.0,
            tick_worst_us: timing_us.1,
            supply_v: feedback.supply_v.clamp(0.0, 25.5),
            temperature_c: warmest.clamp(-128.0, 127.0),
        });
        self.reports.send(Report {
            feedback,
            winding_c,
            in_step: state.last.is_some(),
            timing_us,
            missed: state.missed,
            restarts: state.restarts,
            inertial: self.inertial.answers(),
        });
    }
}

/// The role of an axle's board.
pub fn role(axle: Axle) -> Role {
    match axle {
        Axle::Front => Role::Front,
        Axle::Rear => Role::Rear,
    }
}
