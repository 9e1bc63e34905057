//! Selection of the boards: in-process, virtual or real.

use core_algos::topology::{Role, Topology};
use remote::virtual_robot::Options;
use std::path::{Path, PathBuf};

/// Robot whose boards the options of the command line name.
pub const ROBOT: Topology = Topology::PAIR;

/// Kind of the boards, and the ports of real boards.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum BoardPlace {
    /// The boards' nodes run in this program.
    #[default]
    InProcess,
    /// The boards' images run on virtual boards.
    Virtual,
    /// Real boards at these serial ports. A board without a port runs in this program (in the loop), or is reached over
    /// the bus (real robot).
    Serial(Vec<(Role, PathBuf)>),
}

impl BoardPlace {
    /// Parses `in-process`, `virtual` or `serial:front=PORT,rear=PORT,beam=PORT`.
    pub fn parse(text: &str) -> Result<Self, String> {
        const ALLOWED: &str =
            "must be in-process, virtual or serial:front=PORT[,rear=PORT][,beam=PORT]";
        let ports = match text {
            "in-process" => return Ok(Self::InProcess),
            "virtual" => return Ok(Self::Virtual),
            _ => text.strip_prefix("serial:").ok_or(ALLOWED)?,
        };
        let mut found: Vec<(Role, PathBuf)> = Vec::new();
        for part in ports.split(',') {
            let (board, port) = part.split_once('=').ok_or(ALLOWED)?;
            let role = board_named(board).ok_or(ALLOWED)?;
            if port.is_empty() || found.iter().any(|(other, _)| *other == role) {
                return Err(format!("{board}: must have one port: {ALLOWED}"));
            }
            found.push((role, port.into()));
        }
        Ok(Self::Serial(found))
    }

    /// Serial port of a board.
    pub fn port(&self, role: Role) -> Option<&Path> {
        match self {
            Self::Serial(ports) => {
                let own = ports.iter().find(|(board, _)| *board == role);
                own.map(|(_, port)| port.as_path())
            }
            _ => None,
        }
    }

    /// True if any board has a serial port.
    pub fn has_ports(&self) -> bool {
        matches!(self, Self::Serial(_))
    }

    /// True if any board is outside of this program.
    pub fn is_outside(&self) -> bool {
        *self != Self::InProcess
    }
}

/// Board of the given name.
pub fn board_named(name: &str) -> Option<Role> {
    ROBOT.boards().find(|&role| ROBOT.name(role) == name)
}

/// Kind and settings of the boards.
#[derive(Clone, Debug)]
pub struct Site {
    /// Kind of the boards, and the ports of real boards.
    pub place: BoardPlace,
    /// Baud rate of the serial ports.
    pub baud: u32,
    /// Images of axle and beam board for virtual boards; `None` for the image built from this checkout.
    pub images: [Option<PathBuf>; 2],
    /// True if virtual boards are profiled by function and interrupt.
    pub profile: bool,
    /// Number of threads for virtual boards.
    pub threads: usize,
}

impl Default for Site {
    fn default() -> Self {
        Self {
            place: BoardPlace::InProcess,
            baud: BAUD,
            images: [None, None],
            profile: false,
            threads: Options::threads(),
        }
    }
}

/// Baud rate of the boards' images.
pub const BAUD: u32 = 921_600;
