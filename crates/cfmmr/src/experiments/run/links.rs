//! Links to virtual boards, and to real boards at serial ports.

use super::place::BoardPlace;
use core_algos::topology::{Role, Topology};
use host_sim::base::error::Error;
use remote::board_log::BoardLog;
use remote::images::Images;
use remote::link::Link;
use remote::relay::Relay;
use remote::serial::Serial;
use remote::virtual_link::VirtualLink;
use std::path::{Path, PathBuf};

/// Folder of the flash files of boards that are not real.
pub const DEFAULT_FLASH: &str = "out/flash";

/// Path of a board's flash file in `directory`.
pub fn flash_of(directory: &Path, board: &str) -> PathBuf {
    directory.join(format!("{board}.flash"))
}

/// Opens the serial port of a board.
pub fn open_port(board: &str, port: &Path, baud: u32) -> Result<Box<dyn Link>, Error> {
    let named = |error| Error::input(format!("--on serial:{board}={error}"));
    let port = Serial::open(port, baud).map_err(named)?;
    Ok(Box::new(port))
}

/// Opens links to virtual boards, or to real boards at serial ports.
pub struct Links<'a> {
    /// Axles of the robot.
    pub robot: Topology,
    place: &'a BoardPlace,
    baud: u32,
    images: Option<Images>,
    flash: Option<PathBuf>,
}

impl<'a> Links<'a> {
    /// Builds the images if the boards are virtual; `flash` is the folder of their flash files.
    pub fn new(
        robot: Topology,
        place: &'a BoardPlace,
        baud: u32,
        flash: Option<PathBuf>,
    ) -> Result<Self, Error> {
        place.check(robot)?;
        let images = match place {
            BoardPlace::Virtual => Some(Images::open(None, None)?),
            _ => None,
        };
        Ok(Self {
            robot,
            place,
            baud,
            images,
            flash,
        })
    }

    /// Board through whose port a board is reached; `None` if no board has a port.
    pub fn port_of(&self, role: Role) -> Option<Role> {
        let has_port = |role: &Role| self.place.port(self.robot, *role).is_some();
        let any = self.robot.boards().find(has_port);
        Some(role).filter(has_port).or(any)
    }

    /// Link to a board, through another board if the board has no port; `None` if the board runs in this process.
    pub fn reach(&self, role: Role, log: &BoardLog) -> Result<Option<Box<dyn Link>>, Error> {
        let relay = self.port_of(role).filter(|port| *port != role);
        match relay {
            Some(relay) => match self.open(relay, log)? {
                Some(port) => Ok(Some(Box::new(Relay::open(self.robot, relay, port, role)?))),
                None => Ok(None),
            },
            None => self.open(role, log),
        }
    }

    /// Direct link to a board; `None` if the board has no port and is not virtual.
    pub fn open(&self, role: Role, log: &BoardLog) -> Result<Option<Box<dyn Link>>, Error> {
        let name = self.robot.name(role);
        Ok(match (&self.images, self.place.port(self.robot, role)) {
            (Some(images), _) => {
                let flash = self.flash.as_ref().map(|flash| flash_of(flash, name));
                Some(Box::new(VirtualLink::start(
                    images,
                    (self.robot, role),
                    log,
                    flash.as_deref(),
                )?))
            }
            (None, Some(port)) => Some(open_port(name, port, self.baud)?),
            (None, None) => None,
        })
    }
}
