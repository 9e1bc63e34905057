//! The serial port of the front board, where the host is.

use super::VirtualRobot;
use crate::base::error::Error;
use crate::targets::lead_link::LeadLink;
use crate::targets::serial_line::SerialLine;
use core_algos::bus::CanFrame;
use core_algos::time::TICK;
use core_algos::topology::Role;

impl VirtualRobot {
    /// Sends what is due at the front board's serial port.
    pub(super) fn ask(&mut self) -> Result<(), Error> {
        let now = self.network.now();
        if self.tools.is_off(Role::Front) {
            return Ok(());
        }
        let bytes = self.link.to_send(self.tick * TICK)?;
        let bytes = bytes.map(<[u8]>::to_vec);
        if let (Some(bytes), Some(port)) = (bytes, self.serial(Role::Front)) {
            port.send(&bytes, now);
        }
        Ok(())
    }

    /// Bus frames that the front board reported in the latest tick.
    pub fn reported(&self) -> &[CanFrame] {
        &self.reported
    }

    /// The link to the front board.
    pub fn link(&mut self) -> &mut LeadLink {
        &mut self.link
    }

    /// The serial port of an axle's board.
    pub fn serial(&mut self, role: Role) -> Option<&mut SerialLine> {
        self.axle(role).map(|axle| &mut axle.serial)
    }

    /// Switches all boards off or on.
    pub fn power(&mut self, on: bool) {
        for place in 0..self.roles.len() {
            if let Some(board) = self.network.board(place) {
                board.power(on);
            }
        }
    }

    /// Takes what the front board sent at its serial port.
    pub(super) fn answer(&mut self) -> Result<(), Error> {
        if !self.hosted {
            return Ok(());
        }
        let port = self.serial(Role::Front);
        let sent = port.map(|port| std::mem::take(&mut port.sent));
        if self.link.take(&sent.unwrap_or_default())?
            && let Some(latest) = self.link.latest()
        {
            self.lead = latest.output;
            self.held = self.clock.held();
            self.tools.lead(self.held);
        }
        self.reported = self.link.take_frames();
        Ok(())
    }
}
