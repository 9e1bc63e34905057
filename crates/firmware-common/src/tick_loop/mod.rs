//! Tick loop that all boards share, once a millisecond.
//!
//! Wait for the tick → check in → begin (sample) → receive → step (nodes, messages, actuators) → frame of the link.
//! Every hundredth tick also sends health on the bus and a report to the log. A board supplies its own parts
//! ([`BoardTick`]); the hardware of the loop is behind [`Hardware`].

#[cfg(target_os = "none")]
mod chip;
#[cfg(test)]
mod tests;

use core_algos::bus::Message;
use core_algos::link::MotorState;
use core_algos::link::record::{Entry, Reference};
use core_algos::node::board::Samples;
use core_algos::node::led::Led;
use core_algos::node::role_conflict::RoleConflict;
use core_algos::node::tick_sync::TickSync;
use core_algos::safety::{Condition, Conditions};
use core_algos::time::{Micros, TICK, sequence};
use core_algos::topology::{Role, Wheels};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::watch;

use crate::can::Arrived;
use crate::identity::Identity;
use crate::link::TickEnd;
use crate::timing::{Every, Stopwatch, Timing};

#[cfg(target_os = "none")]
pub use chip::Chip;

/// Ticks between health reports.
const HEALTH: u8 = 100;

/// Destination of a board's reports for the log.
pub type Reports<R> = watch::Sender<'static, CriticalSectionRawMutex, R, 1>;

/// Hardware that the tick loop uses.
pub trait Hardware {
    /// Reports to the task watchdog that the tick runs.
    fn check_in(&mut self);
    /// Local time, µs.
    fn now(&self) -> Micros;
    /// Value of the cycle counter, core cycles.
    fn cycles(&self) -> u32;
    /// True if the board cannot send on the bus.
    fn is_bus_off(&self) -> bool;
    /// Switches the LED on or off.
    fn set_led(&mut self, lit: bool);
    /// The next message that arrived; `None` if none waits.
    fn receive(&mut self) -> Option<Arrived>;
    /// Sends a message and returns it as other boards decode it; `None` if it cannot be encoded.
    fn send(&mut self, message: &Message) -> Option<Message>;
    /// Sends the next frame of the link.
    fn send_link_frame(&mut self);
}

/// Board-specific parts of the tick, in the order in which the loop calls them.
pub trait BoardTick {
    /// Hardware of the tick loop.
    type Hardware: Hardware;
    /// Input that arrives with the tick.
    type Input;
    /// Sensor samples of the tick.
    type Samples;
    /// Board-specific report for the log.
    type LogReport: Clone + 'static;

    /// Waits for the tick; returns its local time and input. `None` skips the tick.
    fn wait(&mut self) -> impl Future<Output = Option<(Micros, Self::Input)>>;
    /// Samples the sensors, and executes orders that must precede the messages received in this tick.
    fn begin(
        &mut self,
        local: Micros,
        input: Self::Input,
        common: &mut Common<Self::Hardware>,
    ) -> Self::Samples;
    /// Handles a message that arrived since the last tick.
    fn receive(&mut self, samples: &Self::Samples, arrived: &Arrived);
    /// Steps the nodes, sends their messages and commands the actuators.
    fn step(&mut self, samples: &Self::Samples, common: &mut Common<Self::Hardware>);
    /// State of the motors.
    fn motors(&self) -> MotorState;
    /// Sends the board's health; returns the report for the log.
    fn report(
        &mut self,
        samples: &Self::Samples,
        health: Health,
        common: &mut Common<Self::Hardware>,
    ) -> Self::LogReport;
}

/// Health of the tick, common to all boards.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Health {
    /// Sequence number of the health messages.
    pub sequence: u8,
    /// Largest jitter and longest tick since the last report.
    pub timing: Timing,
    /// Ticks missed since the start.
    pub missed: u16,
    /// True if the common time is known and the ticks are synchronised to it.
    pub in_step: bool,
}

impl Health {
    /// Health message of a board with this supply and temperature.
    pub fn message(&self, board: Role, supply_v: f32, temperature_c: f32) -> Message {
        Message::BoardHealth {
            board,
            sequence: self.sequence,
            missed_ticks: self.missed.min(255) as u8,
            tick_jitter_us: self.timing.jitter_us,
            tick_worst_us: self.timing.longest_us,
            supply_v: supply_v.clamp(0.0, 25.5),
            temperature_c: temperature_c.clamp(-128.0, 127.0),
        }
    }
}

/// Parts of the tick that all boards share.
pub struct Common<H> {
    /// Hardware of the tick loop.
    pub hardware: H,
    /// The tick's end of the link.
    pub link: TickEnd,
    /// Common time of the boards, to which the ticks are synchronised.
    pub sync: TickSync,
    /// Local time of the tick, µs.
    local: Micros,
    role_conflict: RoleConflict,
    identity: Identity,
    led: Led,
    /// Ticks since the start, the LED's time in ms; counted, because a conversion from µs needs a slow division.
    ticks: u32,
    /// The latest tick that was recorded.
    reference: Reference,
}

impl<H: Hardware> Common<H> {
    /// State at the start, for a board with this role.
    pub fn new(role: Role, hardware: H, link: TickEnd, sync: TickSync, identity: Identity) -> Self {
        Self {
            hardware,
            link,
            sync,
            local: 0,
            role_conflict: RoleConflict::new(role),
            identity,
            led: Led::default(),
            ticks: 0,
            reference: Reference::default(),
        }
    }

    /// Conditions of clock and bus.
    pub fn conditions(&self) -> Conditions {
        let conflict = self.role_conflict.is_present(self.local);
        let conditions = self.sync.conditions();
        conditions
            .with(Condition::RoleTaken, conflict)
            .with(Condition::BusOff, self.hardware.is_bus_off())
    }

    /// Sends a message and returns it as other boards decode it; `None` if it cannot be encoded.
    pub fn send(&mut self, message: &Message) -> Option<Message> {
        self.hardware.send(message)
    }

    /// Sends a message of a node; the LED shows the state in it.
    pub fn send_of_node(&mut self, message: &Message) -> Option<Message> {
        self.led.receive(message);
        self.hardware.send(message)
    }

    /// Sends the board's identity, once a second.
    pub fn send_identity(&mut self, board: Role, health: &Health) {
        if let Some(message) = self.identity.message(board, health.sequence) {
            self.hardware.send(&message);
        }
    }

    /// Records that the nodes restarted before the tick at `now`.
    pub fn record_begin(&mut self, now: Micros) {
        self.link.put(&self.reference.begin(now));
    }

    /// Records a tick of the nodes at `now`.
    pub fn record_tick(&mut self, now: Micros, samples: &Samples, torque_nm: Wheels<f32>) {
        self.link.put(&self.reference.tick(now, samples, torque_nm));
    }

    /// Records the end of the replayable part, because the nodes no longer match the board's configuration.
    pub fn record_end(&mut self) {
        self.link.put(&Entry::End);
    }

    fn update_led(&mut self) {
        self.ticks = self.ticks.wrapping_add(1);
        self.hardware.set_led(self.led.is_lit(self.ticks));
    }

    fn health(&self, local: Micros, timing: Timing) -> Health {
        Health {
            sequence: sequence(self.sync.last().unwrap_or(local)),
            timing,
            missed: self.sync.missed(),
            in_step: self.sync.in_step(),
        }
    }
}

/// Tick loop of a board.
pub struct TickLoop<B: BoardTick> {
    board: B,
    common: Common<B::Hardware>,
    reports: Reports<B::LogReport>,
    stopwatch: Stopwatch,
    health: Every,
}

impl<B: BoardTick> TickLoop<B> {
    /// Creates the loop, before its first tick.
    pub fn new(board: B, common: Common<B::Hardware>, reports: Reports<B::LogReport>) -> Self {
        Self {
            board,
            common,
            reports,
            stopwatch: Stopwatch::new(TICK),
            health: Every::new(HEALTH),
        }
    }

    /// Runs the tick for ever. Takes a reference, because a future that owned the loop would store it twice.
    pub async fn run(&mut self) -> ! {
        loop {
            self.run_tick().await;
        }
    }

    /// Waits for a tick and does its work.
    async fn run_tick(&mut self) {
        let Self { board, common, .. } = self;
        let tick = board.wait().await;
        common.hardware.check_in();
        let Some((local, input)) = tick else {
            return;
        };
        let (cycles, now) = (common.hardware.cycles(), common.hardware.now());
        self.stopwatch.begin(now, cycles);
        common.local = local;
        common.update_led();
        let samples = board.begin(local, input, common);
        while let Some(arrived) = common.hardware.receive() {
            common.sync.receive(arrived.local, &arrived.message);
            common.role_conflict.receive(local, &arrived.message);
            board.receive(&samples, &arrived);
        }
        board.step(&samples, common);
        common.link.set_motors(board.motors());
        common.hardware.send_link_frame();
        self.stopwatch.end(common.hardware.cycles());
        if self.health.tick() {
            let health = common.health(local, self.stopwatch.take());
            self.reports.send(board.report(&samples, health, common));
        }
    }
}
