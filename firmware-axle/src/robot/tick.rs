//! The axle's tick, once a millisecond: sample → receive → node → limit → command → send.
//!
//! The front board's clock is the common time, and its lead node runs here too; the rear board
//! follows by [`TickSync`]. A board whose clock was moved begins anew with motors off.

use core_algos::bus::Message;
use core_algos::control::wheel_observer::{self, WheelObserver};
use core_algos::drive::winding::{self, Winding};
use core_algos::link::record::{Entry, Reference};
use core_algos::node::board::{Board, Samples};
use core_algos::node::tick_sync::{Step, TickSync};
use core_algos::node::{Outbox, axle};
use core_algos::params::Drive;
use core_algos::safety::{Condition, Conditions};
use core_algos::time::{EPOCH, LEAD_PHASE, Micros, TICK, sequence};
use core_algos::topology::{AxleId, Role};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::watch;
use firmware_common::can::{self, Receiver, Sender};
use firmware_common::fault;
use firmware_common::identity::Identity;
use firmware_common::led::Led;
use firmware_common::link;
use firmware_common::record;
use firmware_common::task_watchdog::CheckIn;
use firmware_common::timing::{Every, Stopwatch};

use super::encoders::Encoders;
use super::inertial::Inertial;
use super::motors::Motors;
use super::operator::Button;
use crate::rules::{Command, Feedback};

/// Time in an epoch at which orders of the link are carried out: the lead node's step follows.
const ORDER_PHASE: Micros = LEAD_PHASE - TICK;
/// Ticks between health reports on the bus.
const HEALTH: u8 = 100;

/// Report for the log.
#[derive(Clone, Copy, Debug)]
pub struct Report {
    /// Motors.
    pub feedback: Feedback,
    /// Windings, °C.
    pub winding_c: [f32; 2],
    /// True if the common time is known and the ticks are in step with it.
    pub in_step: bool,
    /// Largest jitter and longest tick since the last report, µs.
    pub timing_us: (u16, u16),
    /// Ticks missed since the start.
    pub missed: u16,
    /// Times the nodes began anew since the start.
    pub restarts: u16,
    /// True if the inertial sensor answers.
    pub inertial: bool,
}

/// Destination of the tick's report.
pub type Reports = watch::Sender<'static, CriticalSectionRawMutex, Report, 1>;

/// Everything the tick works with.
pub struct Axis {
    /// Motors.
    pub motors: Motors,
    /// Encoders.
    pub encoders: Encoders,
    /// Inertial sensor.
    pub inertial: Inertial,
    /// State of the node, to be seen.
    pub led: Led,
    /// Identity of the board, for the bus.
    pub identity: Identity,
    /// Operator's button.
    pub button: Button,
    /// Bus, outwards.
    pub sender: Sender,
    /// Bus, inwards.
    pub receiver: Receiver,
    /// The nodes.
    pub nodes: &'static mut Board,
    /// Wheel observers for the back-EMF.
    pub observer: WheelObserver,
    /// Thermal model of the motors.
    pub winding: Winding,
    /// Limits of drivers and supply.
    pub drive: Drive,
    /// State of the parameters at the start.
    pub parameters: Conditions,
    /// Destination of the reports.
    pub reports: Reports,
    /// For the watchdog.
    pub check_in: CheckIn,
}

/// All that changes from tick to tick.
struct State {
    sync: TickSync,
    /// Messages of this board's nodes at the last tick, as the other boards decode them.
    own: Outbox,
    wheels: [wheel_observer::State; 2],
    windings: [winding::State; 2],
    /// The board came back from a fault that nobody has cleared yet, or began anew under way.
    restarted: bool,
    /// The nodes wanted the motors on.
    driving: bool,
    /// The latest tick as a host was told it.
    reference: Reference,
}

/// Runs the tick for ever.
#[embassy_executor::task]
pub async fn run(mut axis: Axis) -> ! {
    let mut stopwatch = Stopwatch::new(TICK as u32);
    let mut health = Every::new(HEALTH);
    let mut state = State {
        sync: match axis.nodes.role() {
            Role::Front => TickSync::leading(),
            _ => TickSync::following(),
        },
        own: Outbox::new(),
        wheels: [wheel_observer::State::default(); 2],
        windings: [axis.winding.at_start(); 2],
        restarted: fault::restarted(),
        driving: false,
        reference: Reference::default(),
    };
    loop {
        let local = axis.motors.tick().await;
        axis.check_in.report();
        stopwatch.begin();
        let command = axis.tick(&mut state, local);
        link::set_armed(state.driving || axis.motors.feedback().on);
        axis.motors.command(command);
        axis.sender.serve();
        stopwatch.end();
        if health.tick() {
            axis.report_health(&mut state, local, stopwatch.take());
        }
    }
}

impl Axis {
    /// One tick at local time `local`.
    fn tick(&mut self, state: &mut State, local: Micros) -> Command {
        self.led.step(local);
        let feedback = self.motors.feedback();
        let encoder = self.encoders.read();
        let inertial = self.inertial.read(!feedback.on);
        for i in 0..2 {
            state.wheels[i] = self.observer.step(&state.wheels[i], Some(encoder[i]));
        }

        let now = self.now(state, local, feedback.on);
        if let Some(now) = now {
            self.take_orders(now);
        }
        self.receive(state, now);
        let Some(now) = now else {
            record::put(&Entry::Wait);
            return Command::default();
        };
        if let Some(message) = state.sync.sync(now, self.sender.take_sync_sent()) {
            self.sender.send(&message);
        }
        let samples = Samples::Axle(axle::Samples {
            encoder: encoder.map(Some),
            gyro_rad_s: inertial.gyro_rad_s,
            acceleration_m_s2: inertial.acceleration_m_s2,
            conditions: self
                .conditions(&state.sync, &feedback)
                .with(Condition::InertialLost, inertial.gyro_rad_s.is_none())
                .with(Condition::Restarted, state.restarted),
        });
        let mut outbox = Outbox::new();
        let output = self.nodes.step(now, &samples, &mut outbox);
        record::put(&state.reference.tick(now, &samples, output.torque_nm));
        if let (Some(output), Some(lead)) = (output.lead, self.nodes.lead()) {
            link::tell(now, output, lead);
        }
        state.restarted &= !output.clear;
        state.driving = output.active;
        for message in outbox.iter() {
            self.send(state, message);
        }
        let parts = (&self.drive, &self.winding);
        Command::limited(
            &output,
            &feedback,
            &state.wheels,
            parts,
            &mut state.windings,
        )
    }

    fn conditions(&self, sync: &TickSync, feedback: &Feedback) -> Conditions {
        feedback
            .conditions(&self.drive)
            .with(Condition::BusOff, can::is_off())
            .union(sync.conditions())
            .union(self.parameters)
    }

    /// The common time of this tick; `None` when nothing may be driven.
    fn now(&mut self, state: &mut State, local: Micros, on: bool) -> Option<Micros> {
        let step = state.sync.step(local);
        self.motors.trim(state.sync.trim());
        let (now, begins) = match step {
            Step::Wait => return None,
            Step::Run(now) => (now, record::take_wanted() && !state.driving && !on),
            Step::Restart(now) => (now, true),
        };
        if begins {
            // The nodes forget that they drove; the user must be told why they stopped.
            state.restarted |= state.driving;
            self.nodes.restart();
            state.own.clear();
            record::put(&state.reference.begin(now));
            // Replay has no controller of the user.
            if self
                .nodes
                .lead()
                .is_some_and(|lead| lead.has_own_controller())
            {
                record::put(&Entry::End);
            }
        }
        Some(now)
    }

    /// Orders of button and host, before what came: replay knows the order.
    fn take_orders(&mut self, now: Micros) {
        self.button.step(now, self.nodes);
        // At a tick in which the lead node does little else.
        if let (ORDER_PHASE, Some(lead)) = (now % EPOCH, self.nodes.lead()) {
            link::carry_out_order(lead);
        }
    }

    /// Hands the nodes what came since the last tick, and what they sent each other then.
    fn receive(&mut self, state: &mut State, now: Option<Micros>) {
        if let Some(now) = now {
            for message in state.own.iter() {
                self.nodes.receive(now, message);
            }
        }
        state.own.clear();
        while let Some(arrived) = self.receiver.take() {
            state.sync.receive(arrived.local, &arrived.message);
            if let Some(now) = now {
                self.nodes.receive(now, &arrived.message);
            }
        }
    }

    /// Sends a message; the nodes of this board get it at the next tick, as the others read it.
    fn send(&mut self, state: &mut State, message: &Message) {
        self.led.see(message);
        if let Some(message) = self.sender.send(message) {
            state.own.push(message);
        }
    }

    fn report_health(&mut self, state: &mut State, local: Micros, timing_us: (u16, u16)) {
        let feedback = self.motors.feedback();
        let winding_c = state.windings.map(|winding| winding.temperature_c);
        let board = self.nodes.role();
        let now = state.sync.last().unwrap_or(local);
        let warmest = winding_c[0]
            .max(winding_c[1])
            .max(feedback.temperature_c.unwrap_or(-128.0));
        self.sender.send(&Message::BoardHealth {
            board,
            sequence: sequence(now),
            missed_ticks: state.sync.missed().min(255) as u8,
            tick_jitter_us: timing_us.0,
            tick_worst_us: timing_us.1,
            supply_v: feedback.supply_v.clamp(0.0, 25.5),
            temperature_c: warmest.clamp(-128.0, 127.0),
        });
        if let Some(message) = self.identity.message(board, sequence(now)) {
            self.sender.send(&message);
        }
        self.reports.send(Report {
            feedback,
            winding_c,
            in_step: state.sync.in_step(),
            timing_us,
            missed: state.sync.missed(),
            restarts: state.sync.restarts(),
            inertial: self.inertial.answers(),
        });
    }
}

/// The role of an axle's board.
pub fn role(axle: AxleId) -> Role {
    match axle {
        AxleId::Front => Role::Front,
        AxleId::Rear => Role::Rear,
    }
}
