//! Real robot behind the serial port of its front board. Its true state is unknown.
//!
//! The clock is the computer's. At the end of the run, or on drop, the host stops the robot and switches its motors
//! off. A port that closes is opened again: meanwhile the robot continues its task until the lease lapses, then
//! stops.

use crate::board_link::BoardLink;
use crate::interrupt;
use crate::link::Link;
use crate::unanswered::Unanswered;
use core_algos::bus::CanFrame;
use core_algos::link::lease::TERM;
use core_algos::link::protocol::Placement;
use core_algos::node::lead::{self, Task};
use core_algos::safety::{Condition, OperatingState};
use core_algos::time::{Micros, TICK};
use core_algos::topology::{Node, Role, Topology};
use host_sim::base::error::Error;
use host_sim::bus::virtual_bus::{BusStatistics, sender};
use host_sim::run::recovery::Monitor;
use host_sim::run::robot::{Record, Robot, RunControl};
use host_sim::scenario::Scenario;
use host_sim::targets::board_record::BoardEvent;
use host_sim::targets::{BoardTraffic, HostCommand, Room, Traffic};
use plant::Plant;
use std::io::Write;
use std::thread;
use std::time::{Duration, Instant};

/// Time without a report from the board after which its port is opened again, µs.
const REOPEN_AFTER_US: Micros = 1_000_000;
/// Time between attempts to open the port, µs.
const REOPEN_INTERVAL_US: Micros = 100_000;
/// Time without a report from the board after which the run ends, µs.
const REPORT_TIMEOUT_US: Micros = 10_000_000;
/// Delay of the program beyond which missed ticks are skipped.
const SKIP_TICKS_AFTER: Duration = Duration::from_millis(50);
/// Time after which the lease of an earlier program has lapsed.
const LEASE_LAPSE: Duration = Duration::from_micros(TERM + 100_000);

/// Timeout of a request to a board that sends reports, ms.
const WAIT_MS: u64 = 11_000;

/// Timeout for the boards to restart their nodes and to start their records, ms.
const RECORD_MS: u64 = 5000;

/// Opens the port of the front board.
pub type Connect = Box<dyn FnMut() -> Result<Box<dyn Link>, Error>>;

/// Board other than the front board, recorded through its own port.
pub struct OtherBoard {
    /// None once the port has closed.
    port: Option<Box<dyn Link>>,
    link: BoardLink,
    /// Number of reports received, and time of the latest, µs.
    last_report: (u64, Micros),
}

impl OtherBoard {
    /// A board at this port, not yet recorded.
    pub fn new(robot: Topology, role: Role, port: Box<dyn Link>) -> Self {
        Self {
            port: Some(port),
            link: BoardLink::new(robot, role, owner()),
            last_report: (0, 0),
        }
    }

    /// Exchanges bytes with the board. A closed port or a silent board ends the record.
    fn exchange(&mut self, now: Micros) -> Result<(), Error> {
        let Some(port) = &mut self.port else {
            return Ok(());
        };
        if let Some(bytes) = self.link.to_send(now)? {
            // A request that cannot be sent is repeated later.
            let _ = port.send(bytes);
        }
        let mut buffer = [0; 512];
        loop {
            match port.receive(&mut buffer, Duration::ZERO) {
                Ok(0) => break,
                Ok(count) => {
                    self.link.take(&buffer[..count])?;
                    self.link.take_frames();
                }
                Err(_) => {
                    self.port = None;
                    self.link.end_record("its serial port was closed");
                    return Ok(());
                }
            }
        }
        let reports = self.link.reports();
        if self.last_report.0 != reports {
            self.last_report = (reports, now);
        } else if now.saturating_sub(self.last_report.1) > REOPEN_AFTER_US {
            self.link.end_record("no reports at its serial port");
        }
        Ok(())
    }
}

/// Real robot behind the serial port of its front board.
pub struct SerialRobot {
    connect: Connect,
    /// None while the port is closed.
    port: Option<Box<dyn Link>>,
    link: BoardLink,
    others: Vec<OtherBoard>,
    /// Common time of the boards at the start of the run, µs; None until known.
    zero: Option<i64>,
    began: Instant,
    /// Number of ticks since the program opened the port.
    tick: u64,
    /// Tick at which the run started, counted as `tick`.
    start: u64,
    /// Time of the latest report, µs; below, time of the latest attempt to open the port, µs.
    last_report: Micros,
    opened: Micros,
    /// Bytes received since the latest report.
    unanswered: Unanswered,
    reconnected: u32,
    lead: lead::Output,
    task: Task,
    frames: u64,
    control: RunControl,
    /// Heartbeats of the nodes.
    monitor: Monitor,
    closed: bool,
}

impl SerialRobot {
    /// Opens a robot at rest and waits for the first output of its lead node. The robot's posture is set to `place`, or
    /// remains its own estimate if `None`. If the robot is recorded, its nodes restart.
    pub fn open(
        topology: Topology,
        mut connect: Connect,
        place: Option<Placement>,
        record: Option<(&Scenario, Vec<OtherBoard>)>,
    ) -> Result<Self, Error> {
        let mut robot = Self {
            port: Some(connect()?),
            connect,
            link: BoardLink::new(topology, Role::LEAD, owner()),
            others: Vec::new(),
            zero: None,
            began: Instant::now(),
            tick: 0,
            start: 0,
            last_report: 0,
            opened: 0,
            unanswered: Unanswered::default(),
            reconnected: 0,
            lead: lead::Output::default(),
            task: Task::Idle,
            frames: 0,
            control: RunControl::default(),
            monitor: Monitor::new(topology),
            closed: false,
        };
        robot.guard();
        let mut ready = robot.await_lead(place);
        if robot.link.is_leased() {
            // A program that crashed leaves its lease behind.
            thread::sleep(LEASE_LAPSE);
            ready = robot.await_lead(place);
        }
        ready?;
        if let Some((config, others)) = record {
            robot.begin_record(place, config, others)?;
        }
        robot.start = robot.tick;
        Ok(robot)
    }

    /// Sets the last action of a program that ends at once: it switches the motors off over the open port.
    fn guard(&self) {
        let port = self.port.as_ref().and_then(|port| port.second());
        let mut frames = self.link.motors_off();
        interrupt::set_last_action(move || {
            // Several frames are sent, in case one is lost.
            for _ in 0..3 {
                let frame = frames();
                let _ = port
                    .as_ref()
                    .map(|mut port| port.write_all(frame.repeated()));
                thread::sleep(Duration::from_millis(20));
            }
        });
    }

    /// Requests reports and sets the robot's posture to `place`, if given; waits until both are done.
    fn await_lead(&mut self, place: Option<Placement>) -> Result<(), Error> {
        match place {
            Some(place) => {
                self.link.open();
                self.link.command(&HostCommand::SetPose(place));
            }
            None => self.link.watch(),
        }
        self.link.take_lease();
        self.settle()
    }

    /// Waits for every reply, and then for an output of the lead node.
    fn settle(&mut self) -> Result<(), Error> {
        // An output sent before the posture was set still has the former posture.
        self.wait(|robot| robot.link.is_settled() && robot.link.is_fresh())
    }

    /// Steps until the robot is `ready`; an error after 11 s, one second more than the timeout of reports.
    fn wait(&mut self, ready: impl Fn(&Self) -> bool) -> Result<(), Error> {
        let end = self.tick + WAIT_MS;
        while !ready(self) {
            if self.tick >= end {
                return Err(Error::Failure(format!(
                    "front board: it sends reports but has not executed the command within {} s",
                    WAIT_MS / 1000
                )));
            }
            self.step()?;
        }
        Ok(())
    }

    /// Restarts the nodes with the posture `place` or the robot's estimate, and waits until all boards are recorded.
    fn begin_record(
        &mut self,
        place: Option<Placement>,
        scenario: &Scenario,
        others: Vec<OtherBoard>,
    ) -> Result<(), Error> {
        let fused = self.lead.fused;
        let known = fused.robot.covariance[0][0] > 0.0;
        let configured = scenario.mission.configured_placement();
        let mut here = scenario.robot.placement(fused.robot.posture, &configured);
        here.center = fused.robot;
        here.relative.posture = fused.front.posture.relative_to(fused.rear.posture);
        let place = place.or(known.then_some(here));
        let nodes = self.monitor.topology.nodes();
        if let Some(node) = nodes
            .filter_map(|node| self.monitor.latest(node))
            .find(|it| it.state == OperatingState::Fault)
        {
            return Err(Error::Failure(format!(
                "{node}: clear the fault before the run is recorded"
            )));
        }
        self.others = others;
        for other in &mut self.others {
            other.link.open();
            other.link.record();
        }
        // The lead node's posture is set after the axle nodes have restarted.
        self.await_record(|robot| robot.others.iter().all(|other| other.link.has_begun()))?;
        self.link.record();
        if let Some(place) = place {
            self.link.command(&HostCommand::SetPose(place));
        }
        self.settle()?;
        self.await_record(|robot| robot.link.has_begun() && robot.is_ready())
    }

    /// Steps until the boards are recorded and `ready`; an error if a board denies the record, or after 5 s.
    fn await_record(&mut self, ready: impl Fn(&Self) -> bool) -> Result<(), Error> {
        let end = self.tick + RECORD_MS;
        while !ready(self) {
            self.step()?;
            let mut links = self
                .others
                .iter()
                .map(|other| &other.link)
                .chain([&self.link]);
            if let Some(link) = links.find(|link| link.is_denied()) {
                let name = link.name();
                return Err(Error::Failure(format!(
                    "{name} board: its motors may be on: stop the robot before the run is recorded"
                )));
            }
            if self.tick >= end {
                return Err(Error::Failure(format!(
                    "the boards did not begin to record within {} s: check that all boards are on the bus",
                    RECORD_MS / 1000
                )));
            }
        }
        Ok(())
    }

    /// True if no node of any board is starting.
    fn is_ready(&self) -> bool {
        let ready = |node| {
            let latest = self.monitor.latest(node);
            latest.is_none_or(|latest| latest.state != OperatingState::Boot)
        };
        self.monitor.topology.nodes().all(ready)
    }

    /// Passes recorded events to the observers.
    fn publish(&mut self) {
        if self.control.observers.is_empty() {
            return;
        }
        let links = std::iter::once(&mut self.link)
            .chain(self.others.iter_mut().map(|other| &mut other.link));
        for link in links {
            let events = link.take_events();
            if self.zero.is_none() {
                let ticks = events.iter().rev().find_map(|event| match event {
                    BoardEvent::Tick(tick) => Some(i64::from(tick.tick)),
                    _ => None,
                });
                let run_tick = self.tick.saturating_sub(self.start) as i64;
                self.zero = ticks.map(|tick| 1000 * (tick - run_tick));
            }
            let Some(zero) = self.zero else {
                continue;
            };
            for event in &events {
                for observer in &mut self.control.observers {
                    observer.event(link.role(), zero, event);
                }
            }
        }
    }

    /// Time since the program opened the port, µs.
    fn clock(&self) -> Micros {
        self.tick * TICK
    }

    /// Tick of the run, ms.
    fn run_tick(&self) -> u32 {
        self.tick.saturating_sub(self.start) as u32
    }

    /// Build of the front board's image.
    pub fn build(&self) -> &str {
        self.link.build()
    }

    /// Number of bus frames and events that the front board dropped for lack of room.
    pub fn lost(&self) -> u16 {
        self.link.lost()
    }

    /// Number of times the port was opened again.
    pub fn reconnected(&self) -> u32 {
        self.reconnected
    }

    /// Waits until `until`, and opens the port again if an attempt is due.
    fn reconnect(&mut self, until: Instant) -> Result<(), Error> {
        let now = self.clock();
        if now.saturating_sub(self.last_report) > REPORT_TIMEOUT_US {
            let seconds = REPORT_TIMEOUT_US / 1_000_000;
            let never = self.link.build().is_empty();
            let what = match never {
                true => "no robot answered at the serial port of the front board",
                false => {
                    "no more reports from the front board; a robot without a host stops by itself"
                }
            };
            let unanswered = &self.unanswered;
            return Err(Error::NoAnswer(format!(
                "{what} within {seconds} s: {unanswered}"
            )));
        }
        thread::sleep(until.saturating_duration_since(Instant::now()));
        if now.saturating_sub(self.opened) < REOPEN_INTERVAL_US {
            return Ok(());
        }
        self.opened = now;
        // The last action would send its frames to the closed port.
        interrupt::clear_last_action();
        if let Ok(port) = (self.connect)() {
            self.port = Some(port);
            self.guard();
            self.reconnected += 1;
            self.link.rejoin();
        }
        Ok(())
    }

    /// Exchanges bytes with the board until `until`.
    fn exchange(&mut self, until: Instant) -> Result<(), Error> {
        let now = self.clock();
        let silent = now.saturating_sub(self.last_report.max(self.opened)) > REOPEN_AFTER_US;
        let Some(port) = self.port.as_mut().filter(|_| !silent) else {
            self.port = None;
            return self.reconnect(until);
        };
        if let Some(bytes) = self.link.to_send(now)? {
            if self.unanswered.is_new() {
                self.unanswered = Unanswered::to(bytes);
            }
            if port.send(bytes).is_err() {
                self.port = None;
                return Ok(());
            }
        }
        let mut buffer = [0; 512];
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let Ok(count) = port.receive(&mut buffer, left) else {
                self.port = None;
                break;
            };
            if count > 0 {
                let before = self.link.reports();
                self.unanswered.add(&buffer[..count]);
                if self.link.take(&buffer[..count])?
                    && let Some(latest) = self.link.latest()
                {
                    self.lead = latest.output;
                    if !self.link.is_recorded() {
                        for observer in &mut self.control.observers {
                            observer.lead(self.tick.saturating_sub(self.start) as u32, &self.lead);
                        }
                    }
                }
                if self.link.reports() > before {
                    self.last_report = now;
                    self.unanswered = Unanswered::default();
                }
            }
            if left.is_zero() {
                break;
            }
        }
        let tick = self.run_tick();
        let frames = self.link.take_frames();
        for frame in &frames {
            self.monitor.receive(tick, frame);
        }
        self.frames += frames.len() as u64;
        for role in self.monitor.topology.boards() {
            let recorded = match role {
                Role::LEAD => self.link.is_recorded(),
                _ => self
                    .others
                    .iter()
                    .any(|other| other.link.role() == role && other.link.is_recorded()),
            };
            let of_board = |frame: &&CanFrame| sender(self.monitor.topology, frame) == Some(role);
            let frames: Vec<_> = frames.iter().filter(of_board).copied().collect();
            if recorded || frames.is_empty() {
                continue;
            }
            for observer in &mut self.control.observers {
                observer.frames(role, tick, frames.clone());
            }
        }
        Ok(())
    }
}

/// Random number of this program for its lease; differs between runs.
fn owner() -> u16 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
    let nanoseconds = since.map_or(0, |since| since.subsec_nanos());
    (std::process::id() ^ nanoseconds ^ nanoseconds >> 16) as u16
}

impl Drop for SerialRobot {
    fn drop(&mut self) {
        // The error that ended the run is already reported.
        let _ = self.stop();
        interrupt::clear_last_action();
    }
}

impl Robot for SerialRobot {
    fn now(&self) -> Micros {
        Micros::from(self.run_tick()) * TICK
    }

    fn command(&mut self, command: &HostCommand) -> Result<(), Error> {
        if let HostCommand::Task(task) = command {
            self.task = *task;
        }
        self.link.command(command);
        Ok(())
    }

    fn is_settled(&self) -> bool {
        self.link.is_settled()
    }

    fn send(&mut self, frame: &CanFrame) -> Result<(), Error> {
        self.link.send(frame);
        Ok(())
    }

    fn room(&mut self) -> Room {
        self.link.room()
    }

    fn failure(&self) -> Option<String> {
        // The node also gives notice `CommanderSilent` if a speed command is not renewed, so the notice counts only for
        // tasks that end by themselves.
        let ends_itself = matches!(
            self.task,
            Task::Regulate { .. } | Task::Follow { .. } | Task::Track { .. }
        );
        let lead = self.monitor.latest(Node::Lead);
        let lost = lead.is_some_and(|lead| lead.notices.contains(Condition::CommanderSilent));
        if ends_itself && lost && self.link.is_settled() && self.link.is_fresh() {
            let term = TERM / 1_000_000;
            return Some(format!(
                "the board was without a host for {term} s, and the robot stopped"
            ));
        }
        self.monitor.fault_since(Node::Lead)?;
        self.monitor.why_stopped()
    }

    fn step(&mut self) -> Result<(), Error> {
        let mut until = self.began + Duration::from_micros((self.tick + 1) * TICK);
        // A delayed program skips the missed ticks, because the link's timeouts count ticks.
        let behind = Instant::now().saturating_duration_since(until);
        if behind > SKIP_TICKS_AFTER {
            self.began += behind;
            until += behind;
        }
        let now = self.clock();
        for other in &mut self.others {
            other.exchange(now)?;
        }
        self.exchange(until)?;
        self.publish();
        self.tick += 1;
        self.notify_observers()
    }

    fn record(&self) -> Record {
        Record::without_truth(self.now(), self.monitor.topology, self.lead)
    }

    fn plant(&self) -> Option<&Plant> {
        None
    }

    /// Stops the robot and ends the lease; a second call does nothing.
    fn stop(&mut self) -> Result<(), Error> {
        // A board whose build is unknown may use another protocol and would reject the requests.
        if self.closed || self.link.build().is_empty() {
            return Ok(());
        }
        self.closed = true;
        // The host stops the robot over the front board's port only.
        self.others.clear();
        let stopped = self.bring_to_rest().and_then(|()| {
            self.link.release();
            self.wait(|robot| robot.link.is_settled())
        });
        stopped.map_err(|error| {
            Error::Failure(format!(
                "front board: the robot did not confirm that it stopped: press its button ({error})"
            ))
        })
    }

    fn monitor(&self) -> &Monitor {
        &self.monitor
    }

    fn monitor_mut(&mut self) -> &mut Monitor {
        &mut self.monitor
    }

    fn control(&self) -> &RunControl {
        &self.control
    }

    fn control_mut(&mut self) -> &mut RunControl {
        &mut self.control
    }

    fn builds(&self) -> Vec<(Role, String)> {
        vec![(Role::LEAD, self.link.build().to_owned())]
    }

    fn traffic(&self) -> Vec<BoardTraffic> {
        let of = |role: Role| BoardTraffic {
            name: self.monitor.topology.name(role),
            on: true,
            traffic: (role == Role::LEAD).then(|| Traffic {
                frames: self.frames,
                lost: self.link.lost().into(),
                damaged: self.link.damaged().into(),
            }),
        };
        self.monitor.topology.boards().map(of).collect()
    }

    fn bus(&self) -> BusStatistics {
        BusStatistics {
            sent: self.frames,
            ..BusStatistics::default()
        }
    }
}
