//! The axle's tick, once a millisecond: sample → receive → node → limit → command → send.
//!
//! The front board's clock is the common time, and its lead node runs here too; the rear board
//! follows by [`TickSync`]. A board whose clock was stepped restarts its nodes with motors off.

use core_algos::acquisition::icm42688::Reading;
use core_algos::control::wheel_observer::{self, WheelObserver};
use core_algos::drive::winding::{self, Winding};
use core_algos::link::MotorState;
use core_algos::link::record::Entry;
use core_algos::node::board::{Board, Samples};
use core_algos::node::tick_sync::TickStep;
use core_algos::node::{Outbox, axle, lead};
use core_algos::params::Drive;
use core_algos::safety::{Condition, Conditions};
use core_algos::time::{Micros, since_epoch_start};
use core_algos::topology::Wheels;
use firmware_common::can::Arrived;
use firmware_common::fault;
use firmware_common::tick_loop::{self, BoardTick, Chip, Health, TickLoop};

use super::Own;
use super::encoders::Encoders;
use super::inertial::Inertial;
use super::motors::Motors;
use super::operator::Button;
use crate::rules::{Command, Feedback};

/// Report of the axle's tick for the board's log.
#[derive(Clone, Copy, Debug)]
pub struct AxleReport {
    /// Timing, misses and synchronisation of the ticks.
    pub health: Health,
    /// Measurements and faults of the motors.
    pub feedback: Feedback,
    /// Estimated temperatures of the motor windings (left, right), °C.
    pub winding_c: [f32; 2],
    /// Number of restarts of this board's nodes since the start.
    pub restarts: u16,
    /// True if the inertial sensor responds.
    pub inertial: bool,
}

/// State of the tick that all boards share, on this board's chip.
type Common = tick_loop::Common<Chip>;

/// Devices, nodes and limits that the axle's tick works with.
pub struct Axle {
    /// Interface to the motors' current loop.
    pub motors: Motors,
    /// Wheel encoders (left, right).
    pub encoders: Encoders,
    /// Gyro and accelerometer of the axle.
    pub inertial: Inertial,
    /// Operator's button.
    pub button: Button,
    /// Axle node, and lead node on the front board.
    pub nodes: &'static mut Board,
    /// Parts of the user in the lead node.
    pub own: Own,
    /// Wheel observers for the back-EMF.
    pub observer: WheelObserver,
    /// Thermal model of the motors.
    pub winding: Winding,
    /// Limits of drivers and supply.
    pub drive: Drive,
    /// Conditions from reading the stored parameters at the start.
    pub parameters: Conditions,
}

/// Parts of the tick that only an axle board has.
pub struct AxleTick {
    axle: Axle,
    /// Messages of this board's nodes at the last tick, as the other boards decode them.
    own: Outbox,
    wheels: [wheel_observer::State; 2],
    windings: [winding::State; 2],
    /// True after a fault restarted the board, or the nodes restarted while driving, until the fault is cleared.
    restarted: bool,
    /// True if the nodes commanded the motors on.
    driving: bool,
}

/// Samples of one tick and its time.
pub struct Sampled {
    /// Common time; `None` if the motors must not be driven.
    now: Option<Micros>,
    feedback: Feedback,
    encoder: Wheels<i32>,
    inertial: Reading,
}

/// Runs the tick for ever.
#[embassy_executor::task]
pub async fn run(mut tick: TickLoop<AxleTick>) -> ! {
    tick.run().await
}

impl BoardTick for AxleTick {
    type Hardware = Chip;
    type Input = ();
    type Samples = Sampled;
    type LogReport = AxleReport;

    async fn wait(&mut self) -> Option<(Micros, ())> {
        Some((self.axle.motors.tick().await, ()))
    }

    /// Reads the sensors and executes orders of button and host, before messages are received, as in a replay.
    fn begin(&mut self, local: Micros, (): (), common: &mut Common) -> Sampled {
        let feedback = self.axle.motors.feedback();
        let encoder = self.axle.encoders.read();
        let inertial = self.axle.inertial.read(!feedback.on);
        for (wheel, count) in self.wheels.iter_mut().zip(encoder.list()) {
            *wheel = self.axle.observer.step(wheel, Some(count));
        }
        let now = self.common_time(local, feedback.on, common);
        if let Some(now) = now {
            self.take_orders(now, common);
            for message in self.own.iter() {
                self.axle.nodes.receive(now, message);
            }
        }
        self.own.clear();
        Sampled {
            now,
            feedback,
            encoder,
            inertial,
        }
    }

    fn receive(&mut self, sampled: &Sampled, arrived: &Arrived) {
        if let Some(now) = sampled.now {
            self.axle.nodes.receive(now, &arrived.message);
        }
    }

    fn step(&mut self, sampled: &Sampled, common: &mut Common) {
        let command = match sampled.now {
            Some(now) => self.run_nodes(now, sampled, common),
            None => {
                common.link.put(&Entry::Wait);
                Command::default()
            }
        };
        self.axle.motors.command(command);
    }

    fn motors(&self) -> MotorState {
        match (self.driving, self.axle.motors.feedback().on) {
            (true, _) => MotorState::Driven,
            (false, true) => MotorState::Braking,
            (false, false) => MotorState::Off,
        }
    }

    fn report(&mut self, sampled: &Sampled, health: Health, common: &mut Common) -> AxleReport {
        let feedback = sampled.feedback;
        let winding_c = self.windings.map(|winding| winding.temperature_c);
        let warmest = winding_c[0]
            .max(winding_c[1])
            .max(feedback.temperature_c.unwrap_or(-128.0));
        let board = self.axle.nodes.role();
        common.send(&health.message(board, feedback.supply_v, warmest));
        common.send_identity(board, &health);
        AxleReport {
            health,
            feedback,
            winding_c,
            restarts: common.sync.restarts(),
            inertial: self.axle.inertial.responds(),
        }
    }
}

impl AxleTick {
    /// Creates the tick of an axle board, before its first tick.
    pub fn new(axle: Axle) -> Self {
        Self {
            own: Outbox::new(),
            wheels: [wheel_observer::State::default(); 2],
            windings: [axle.winding.at_start(); 2],
            restarted: fault::restarted(),
            driving: false,
            axle,
        }
    }

    /// The common time of this tick; `None` if the motors must not be driven.
    fn common_time(&mut self, local: Micros, on: bool, common: &mut Common) -> Option<Micros> {
        let step = common.sync.step(local);
        self.axle.motors.trim(common.sync.trim());
        let (now, begins) = match step {
            TickStep::Wait => return None,
            TickStep::Run(now) => (now, common.link.take_begin() && !self.driving && !on),
            TickStep::Restart(now) => (now, true),
        };
        if begins {
            // The restart erases the nodes' own record of driving, so `restarted` reports why the robot stops.
            self.restarted |= self.driving;
            self.axle.nodes.restart();
            self.own.clear();
            common.record_begin(now);
            // A replay has no parts of the user, so it could not reproduce this board's commands.
            let Own {
                controller,
                estimator,
            } = &self.axle.own;
            if controller.is_some() || estimator.is_some() {
                common.record_end();
            }
        }
        Some(now)
    }

    /// Executes orders of button and host.
    fn take_orders(&mut self, now: Micros, common: &mut Common) {
        let Axle { button, nodes, .. } = &mut self.axle;
        button.step(now, nodes, &mut common.link);
        // Orders are executed one tick before the lead node's work, in a tick with little other work.
        if let Some(lead) = nodes.lead()
            && since_epoch_start(now) == lead::order_phase(lead.topology())
        {
            common.link.execute_orders(lead);
        }
    }

    /// Steps the nodes at `now` and sends their messages.
    fn run_nodes(&mut self, now: Micros, sampled: &Sampled, common: &mut Common) -> Command {
        let sent = common.hardware.take_sync_sent();
        if let Some(message) = common.sync.sync(now, sent) {
            common.send(&message);
        }
        let inertial = &sampled.inertial;
        let samples = Samples::Axle(axle::Samples {
            encoder: sampled.encoder.map(Some),
            gyro_rad_s: inertial.gyro_rad_s,
            acceleration_m_s2: inertial.acceleration_m_s2,
            conditions: sampled
                .feedback
                .conditions(&self.axle.drive)
                .union(common.conditions())
                .union(self.axle.parameters)
                .with(Condition::InertialLost, inertial.gyro_rad_s.is_none())
                .with(Condition::Restarted, self.restarted),
        });
        let mut outbox = Outbox::new();
        let Axle { nodes, own, .. } = &mut self.axle;
        let mut own = lead::Own {
            controller: own.controller.as_deref_mut().map(|it| it as _),
            estimator: own.estimator.as_deref_mut().map(|it| it as _),
        };
        let output = nodes.step_with(now, &samples, &mut outbox, &mut own);
        common.record_tick(now, &samples, output.torque_nm);
        if let (Some(output), Some(lead)) = (output.lead, self.axle.nodes.lead()) {
            common.link.publish(now, output, lead);
        }
        self.restarted &= !output.clear;
        self.driving = output.active;
        for message in outbox.iter() {
            // The nodes of this board receive the message at the next tick, as the other boards decode it.
            if let Some(message) = common.send_of_node(message) {
                self.own.push(message);
            }
        }
        let parts = (&self.axle.drive, &self.axle.winding);
        let feedback = &sampled.feedback;
        Command::limited(&output, feedback, &self.wheels, parts, &mut self.windings)
    }
}
