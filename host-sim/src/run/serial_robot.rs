//! A real robot behind the serial port of its front board. Its true state is not known.
//!
//! Time is the computer's. The board needs no host to drive: when the run ends, or is dropped, the host stops the robot
//! and has its motors switched off.

use crate::base::error::Error;
use crate::bus::virtual_bus::BusStatistics;
use crate::plant::Plant;
use crate::run::recovery::Monitor;
use crate::run::robot::{Record, Robot, RunControl};
use crate::targets::lead_link::LeadLink;
use crate::targets::link::Link;
use crate::targets::{BoardTraffic, HostCommand, Room, Traffic};
use core_algos::link::protocol::Place;
use core_algos::node::lead::{self, Task};
use core_algos::time::{Micros, TICK};
use core_algos::topology::{Node, Role};
use std::time::{Duration, Instant};

/// Longest time without a byte from the board, µs.
const SILENCE: Micros = 1_000_000;
/// Longest time that the robot gets to stop at the end of a run, and then to switch its motors off.
const STOP: Duration = Duration::from_secs(5);

/// The robot.
pub struct SerialRobot {
    port: Box<dyn Link>,
    link: LeadLink,
    began: Instant,
    tick: u64,
    /// Time of the latest bytes, µs.
    heard: Micros,
    lead: lead::Output,
    monitor: Monitor,
    frames: u64,
    control: RunControl,
}

impl SerialRobot {
    /// A robot at rest at a place; waits for the first output of its lead node.
    pub fn open(port: Box<dyn Link>, place: Place) -> Result<Self, Error> {
        let mut robot = Self {
            port,
            link: LeadLink::default(),
            began: Instant::now(),
            tick: 0,
            heard: 0,
            lead: lead::Output::default(),
            monitor: Monitor::default(),
            frames: 0,
            control: RunControl::default(),
        };
        robot.link.open(place);
        while robot.link.latest().is_none() || !robot.link.is_settled() {
            robot.step()?;
        }
        // The run begins now.
        robot.tick = 0;
        robot.heard = 0;
        robot.began = Instant::now();
        Ok(robot)
    }

    /// Build of the front board's image.
    pub fn build(&self) -> &str {
        self.link.build()
    }

    /// Bus frames that the front board had no room for.
    pub fn lost(&self) -> u16 {
        self.link.lost()
    }

    /// Exchanges bytes with the board until `until`.
    fn exchange(&mut self, until: Instant) -> Result<(), Error> {
        let now = self.now();
        if let Some(bytes) = self.link.to_send(now)? {
            self.port.send(bytes)?;
        }
        let mut room = [0; 512];
        loop {
            let left = until.saturating_duration_since(Instant::now());
            let count = self.port.receive(&mut room, left)?;
            if count > 0 {
                self.heard = now;
                if self.link.take(&room[..count])?
                    && let Some(latest) = self.link.latest()
                {
                    self.lead = latest.output;
                }
            }
            if left.is_zero() {
                break;
            }
        }
        if now.saturating_sub(self.heard) > SILENCE && self.link.is_settled() {
            return Err(Error::Failure(format!(
                "front board: silent at its serial port for {} s: the robot goes on with its task; press its button \
                 to stop it",
                SILENCE / 1_000_000
            )));
        }
        let tick = self.tick as u32;
        let frames = self.link.take_frames();
        for frame in &frames {
            self.monitor.see(tick, frame);
        }
        self.frames += frames.len() as u64;
        if !frames.is_empty() {
            for observer in &mut self.control.observers {
                observer.frames(Role::Front, tick, frames.clone());
            }
        }
        Ok(())
    }

    /// Stops the robot and switches its motors off.
    fn stop(&mut self) -> Result<(), Error> {
        for task in [Task::Stop, Task::Idle] {
            self.command(&HostCommand::Task(task))?;
            let end = Instant::now() + STOP;
            let moving = |lead: &lead::Output| lead.motion.v.abs() > 1e-3;
            while Instant::now() < end && (!self.link.is_settled() || moving(&self.lead)) {
                self.step()?;
            }
        }
        Ok(())
    }
}

impl Drop for SerialRobot {
    fn drop(&mut self) {
        self.control.observers.clear();
        // A robot that does not answer was reported.
        let _ = self.stop();
    }
}

impl Robot for SerialRobot {
    fn now(&self) -> Micros {
        self.tick * TICK
    }

    fn command(&mut self, command: &HostCommand) -> Result<(), Error> {
        self.link.command(command);
        Ok(())
    }

    fn is_settled(&self) -> bool {
        self.link.is_settled()
    }

    fn room(&mut self) -> Room {
        self.link.room()
    }

    fn failure(&self) -> Option<String> {
        self.monitor.fault_since(Node::Lead)?;
        self.monitor.why_stopped()
    }

    fn step(&mut self) -> Result<(), Error> {
        let until = self.began + Duration::from_micros((self.tick + 1) * TICK);
        self.exchange(until)?;
        self.tick += 1;
        self.show()
    }

    fn record(&self) -> Record {
        Record::without_truth(self.now(), self.lead)
    }

    fn plant(&self) -> Option<&Plant> {
        None
    }

    fn monitor(&self) -> &Monitor {
        &self.monitor
    }

    fn control(&self) -> &RunControl {
        &self.control
    }

    fn control_mut(&mut self) -> &mut RunControl {
        &mut self.control
    }

    fn builds(&self) -> Vec<(Role, String)> {
        vec![(Role::Front, self.link.build().to_owned())]
    }

    fn traffic(&self) -> Vec<BoardTraffic> {
        let of = |role: Role| BoardTraffic {
            role,
            on: true,
            traffic: (role == Role::Front).then(|| Traffic {
                frames: self.frames,
                lost: self.link.lost().into(),
                damaged: self.link.damaged().into(),
            }),
        };
        Role::ALL.map(of).to_vec()
    }

    fn bus(&self) -> BusStatistics {
        BusStatistics {
            sent: self.frames,
            ..BusStatistics::default()
        }
    }
}
