//! Host at the boards' serial ports.

use super::axle::AxleBoard;
use super::beam::BeamBoard;
use super::{BOOT_TIMEOUT, VirtualRobot};
use crate::board_link::BoardLink;
use crate::serial_line::SerialLine;
use core_algos::bus::CanFrame;
use core_algos::topology::Role;
use host_sim::base::error::Error;
use host_sim::targets::HostCommand;
use virtual_board::network::Network;

impl VirtualRobot {
    /// Requests the reports of the front board, or records all boards if `record`, and sets the robot's posture in the
    /// lead node.
    pub(super) fn open_links(&mut self, record: bool) -> Result<(), Error> {
        self.recorded = record;
        if record {
            let others = self.roles.iter().filter(|role| **role != Role::LEAD);
            self.other_links = others
                .map(|role| BoardLink::new(self.topology, *role, 0))
                .collect();
        }
        // The front board is last, because the lead node's posture is set after the axle nodes have restarted.
        for role in self.roles.iter().rev().copied().collect::<Vec<_>>() {
            self.open_link(role);
            while record && !self.has_begun(role) {
                self.exchange()?;
            }
        }
        while record && !(self.link.is_settled() && self.waits_for().is_none()) {
            self.exchange()?;
        }
        Ok(())
    }

    /// Advances the boards by one millisecond before the experiment.
    fn exchange(&mut self) -> Result<(), Error> {
        self.send_due_bytes()?;
        self.advance();
        self.read_sent_bytes()?;
        match self.network.now() >= BOOT_TIMEOUT {
            true => Err(Error::Failure("no records from the boards".to_owned())),
            false => Ok(()),
        }
    }

    fn has_begun(&self, role: Role) -> bool {
        let mut links = std::iter::once(&self.link).chain(&self.other_links);
        links.any(|link| link.role() == role && link.has_begun())
    }

    /// Opens the link to a board that has just started.
    pub(super) fn open_link(&mut self, role: Role) {
        let links = std::iter::once(&mut self.link).chain(&mut self.other_links);
        for link in links.filter(|link| link.role() == role) {
            link.open();
            if self.recorded {
                link.record();
            }
        }
        if role == Role::LEAD {
            self.link.command(&HostCommand::SetPose(self.place));
        }
    }

    /// Sends due bytes to the serial ports.
    pub(super) fn send_due_bytes(&mut self) -> Result<(), Error> {
        let now = self.network.now();
        for link in std::iter::once(&mut self.link).chain(&mut self.other_links) {
            let role = link.role();
            if self.tools.is_off(role) {
                continue;
            }
            let Some(bytes) = link.to_send(now.micros())? else {
                continue;
            };
            if let Some(port) = port(&mut self.network, &self.roles, role) {
                port.send(bytes, now);
            }
        }
        Ok(())
    }

    /// Bus frames that the front board reported in the latest tick.
    pub fn reported(&self) -> &[CanFrame] {
        &self.reported
    }

    /// Link to the front board.
    pub fn link(&mut self) -> &mut BoardLink {
        &mut self.link
    }

    /// Serial port of a board.
    pub fn serial(&mut self, role: Role) -> Option<&mut SerialLine> {
        port(&mut self.network, &self.roles, role)
    }

    /// Switches all boards off or on.
    pub fn power(&mut self, on: bool) {
        for place in 0..self.roles.len() {
            if let Some(board) = self.network.board(place) {
                board.power(on);
            }
        }
    }

    /// Reads the bytes that the boards sent at their serial ports.
    pub(super) fn read_sent_bytes(&mut self) -> Result<(), Error> {
        if !self.hosted {
            return Ok(());
        }
        for link in &mut self.other_links {
            if let Some(port) = port(&mut self.network, &self.roles, link.role()) {
                link.take(&std::mem::take(&mut port.sent))?;
                link.take_frames();
            }
        }
        let port = self.serial(Role::LEAD);
        let sent = port.map(|port| std::mem::take(&mut port.sent));
        if self.link.take(&sent.unwrap_or_default())?
            && let Some(latest) = self.link.latest()
        {
            self.lead = latest.output;
            self.estimate_time = self.clock.estimate_time();
        }
        self.reported = self.link.take_frames();
        Ok(())
    }

    /// Passes recorded events to the observers.
    pub(super) fn publish(&mut self) {
        let zero = self.clock.common(self.booted.micros());
        for link in std::iter::once(&mut self.link).chain(&mut self.other_links) {
            for event in link.take_events() {
                for observer in &mut self.control.observers {
                    observer.event(link.role(), zero, &event);
                }
            }
        }
    }
}

/// Serial port of the board with this role.
fn port<'a>(network: &'a mut Network, roles: &[Role], role: Role) -> Option<&'a mut SerialLine> {
    let place = roles.iter().position(|other| *other == role)?;
    let chip = network.board(place)?.chip();
    match role {
        Role::Beam(_) => chip.circuit::<BeamBoard>().map(|beam| &mut beam.serial),
        _ => chip.circuit::<AxleBoard>().map(|axle| &mut axle.serial),
    }
}
