//! Wrapper of a board that records its inputs and outputs.

use super::entry::{Can, HostCommandEntry, Off, Start};
use super::{Line, Session};
use core_algos::bus::{self, CanFrame, Message};
use core_algos::link::protocol::{Placement, StackUse};
use core_algos::node::board::Samples;
use core_algos::node::robot::RobotConfig;
use core_algos::time::Micros;
use core_algos::topology::Role;
use host_sim::base::error::Error;
use host_sim::targets::{
    Fault, HostCommand, Outgoing, Output, Room, Target, TargetReport, Traffic,
};

/// A board whose inputs and outputs are recorded.
pub struct Tap {
    role: Role,
    target: Box<dyn Target>,
    session: Session,
    /// True if the wrapper encodes the messages of a board in this process.
    encoded: bool,
    /// Tick whose reply is awaited, ms, and its samples.
    begun: Option<(u32, Samples)>,
    /// Next tick of the board, ms.
    next: u32,
    received: Vec<Can>,
    sent: Vec<CanFrame>,
}

impl Tap {
    /// Wraps a board, so that its inputs and outputs go to `session`.
    pub fn new(role: Role, target: Box<dyn Target>, session: Session, encoded: bool) -> Self {
        Self {
            role,
            target,
            session,
            encoded,
            sent: Vec::new(),
            begun: None,
            next: 0,
            received: Vec::new(),
        }
    }

    fn record_off(&mut self, tick: u32, reason: String) {
        self.begun = None;
        self.received.clear();
        self.sent.clear();
        self.session
            .note(Line::Off(self.role, Off { tick, reason }));
    }

    /// Records that the board did not reply to the latest tick.
    fn record_failure(&mut self, fault: &Fault) {
        let reason = match fault {
            Fault::Restarted => "restarted without a command".to_owned(),
            Fault::Silent(why) => why.clone(),
            Fault::Fatal(error) => error.to_string(),
        };
        self.record_off(self.next.saturating_sub(1), reason);
    }

    /// Records the reply to a tick.
    fn record_reply(&mut self, output: &Output) {
        let Some((tick, samples)) = self.begun.take() else {
            return;
        };
        if !self.sent.is_empty() {
            let sent = std::mem::take(&mut self.sent);
            self.session.note(Line::Frames {
                role: self.role,
                tick,
                frames: sent,
            });
        }
        if let Some(lead) = &output.lead {
            self.session.note(Line::Lead(tick, Box::new(*lead)));
        }
        let received = std::mem::take(&mut self.received);
        self.session.note(Line::of_tick(
            self.role,
            (tick, &samples),
            received,
            output.torque_nm,
        ));
    }
}

impl Target for Tap {
    fn start(
        &mut self,
        config: &RobotConfig,
        tick: u32,
        place: Option<&Placement>,
    ) -> Result<(), Fault> {
        self.target.start(config, tick, place)?;
        self.received.clear();
        self.next = tick;
        let entry = Start::new(tick, config, place);
        let started = Box::new((entry, Some(self.target.report())));
        self.session.note(Line::Start(self.role, started));
        Ok(())
    }

    fn command(&mut self, command: &HostCommand) -> Result<(), Fault> {
        self.target.command(command)?;
        let entry = HostCommandEntry::new(self.next, command);
        self.session.note(Line::Command(entry));
        Ok(())
    }

    fn room(&mut self) -> Room {
        self.target.room()
    }

    fn receive(&mut self, now: Micros, frame: &CanFrame, message: &Message) {
        self.received.push(Can(*frame));
        self.target.receive(now, frame, message);
    }

    fn begin(&mut self, tick: u32, samples: &Samples) -> Result<(), Fault> {
        self.next = tick + 1;
        self.begun = Some((tick, *samples));
        let begun = self.target.begin(tick, samples);
        begun.inspect_err(|fault| self.record_failure(fault))
    }

    fn finish(&mut self, send: &mut dyn FnMut(Outgoing)) -> Result<Output, Fault> {
        let Self {
            target,
            sent,
            encoded,
            ..
        } = self;
        let finished = target.finish(&mut |outgoing| {
            let frame = match outgoing {
                Outgoing::Message(message) => bus::encode(message).ok(),
                Outgoing::Frame(frame) => Some(*frame),
            };
            sent.extend(frame);
            match (&frame, outgoing) {
                // The bus need not encode the message again.
                (Some(frame), Outgoing::Message(_)) if *encoded => send(Outgoing::Frame(frame)),
                _ => send(outgoing),
            }
        });
        match &finished {
            Ok(output) => self.record_reply(output),
            Err(fault) => self.record_failure(fault),
        }
        finished
    }

    fn resume(&mut self, tick: u32) -> Result<(), Fault> {
        self.target.resume(tick)
    }

    fn halt(&mut self, halted: bool) -> Result<(), Error> {
        self.target.halt(halted)
    }

    fn crash(&mut self) -> Result<(), Error> {
        self.target.crash()
    }

    fn stack(&mut self) -> Option<StackUse> {
        self.target.stack()
    }

    fn switch_off(&mut self) -> Result<(), Error> {
        self.record_off(self.next, "switched off".to_owned());
        self.target.switch_off()
    }

    fn switch_on(&mut self) -> Result<(), Error> {
        self.target.switch_on()
    }

    fn traffic(&self) -> Option<Traffic> {
        self.target.traffic()
    }

    fn report(&self) -> TargetReport {
        self.target.report()
    }
}
