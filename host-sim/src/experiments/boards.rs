//! Links to the boards that a command line names.

use crate::base::error::Error;
use crate::experiments::arguments::{BoardArgs, LinkKind};
use crate::targets::board_log::BoardLog;
use crate::targets::emulated::{self, Emulated, Images, Wire};
use crate::targets::link::Link;
use crate::targets::serial::Serial;
use core_algos::topology::Role;
use std::path::{Path, PathBuf};

/// Folder of the flash files of boards that are not real.
pub const DEFAULT_FLASH: &str = "out/flash";

impl BoardArgs {
    /// The serial port of a board.
    pub fn port(&self, role: Role) -> Option<&Path> {
        match role {
            Role::Front => self.front.as_deref(),
            Role::Rear => self.rear.as_deref(),
            Role::Beam => self.beam.as_deref(),
        }
    }

    /// True if any board has a serial port.
    pub fn any_port(&self) -> bool {
        Role::ALL.iter().any(|role| self.port(*role).is_some())
    }

    /// True if any board is outside of this process.
    pub fn any(&self) -> bool {
        self.emulated || self.any_port()
    }
}

/// The file with the flash of a board.
pub fn flash_of(directory: &Path, role: Role) -> PathBuf {
    directory.join(format!("{}.flash", role.name()))
}

/// Opens links.
pub struct Links<'a> {
    args: &'a BoardArgs,
    images: Option<Images>,
    flash: Option<PathBuf>,
}

impl<'a> Links<'a> {
    /// Builds the images of emulated boards, if there are to be any; their flash is in this directory.
    pub fn new(args: &'a BoardArgs, flash: Option<PathBuf>) -> Result<Self, Error> {
        let images = match args.emulated {
            true => {
                emulated::check_qemu(&args.qemu)?;
                Some(Images::build()?)
            }
            false => None,
        };
        Ok(Self {
            args,
            images,
            flash,
        })
    }

    /// The link to a board; none if it is in this process.
    pub fn open(&self, role: Role, log: &BoardLog) -> Result<Option<Box<dyn Link>>, Error> {
        let args = self.args;
        let wire = match args.link {
            LinkKind::Pipe => Wire::Pipe,
            LinkKind::Uart => Wire::Uart,
        };
        Ok(match (&self.images, args.port(role)) {
            (Some(images), _) => {
                let flash = self.flash.as_ref().map(|flash| flash_of(flash, role));
                let (log, flash) = (log.clone(), flash.as_deref());
                let board = Emulated::start(&args.qemu, role, wire, images, log, flash)?;
                Some(Box::new(board))
            }
            (None, Some(port)) => {
                let port = Serial::open(port, args.baud)
                    .map_err(|error| Error::input(format!("--{} {error}", role.name())))?;
                Some(Box::new(port))
            }
            (None, None) => None,
        })
    }
}
