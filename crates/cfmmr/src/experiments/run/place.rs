//! Selection of the boards: in-process, virtual or real.

use core_algos::topology::{MAX_AXLES, Role, Topology};
use host_sim::base::error::Error;
use remote::virtual_robot::Options;
use std::path::{Path, PathBuf};

/// Robot of the commands that have no scenario.
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
    /// the bus (real robot). Boards are given by name, since the name `rear` depends on the number of axles.
    Serial(Vec<(&'static str, PathBuf)>),
}

impl BoardPlace {
    /// Parses `in-process`, `virtual` or `serial:front=PORT,rear=PORT,beam=PORT`, with the boards of any robot.
    pub fn parse(text: &str) -> Result<Self, String> {
        const ALLOWED: &str =
            "must be in-process, virtual or serial:front=PORT[,rear=PORT][,beam=PORT]";
        let ports = match text {
            "in-process" => return Ok(Self::InProcess),
            "virtual" => return Ok(Self::Virtual),
            _ => text.strip_prefix("serial:").ok_or(ALLOWED)?,
        };
        let mut found: Vec<(&str, PathBuf)> = Vec::new();
        for part in ports.split(',') {
            let (board, port) = part.split_once('=').ok_or(ALLOWED)?;
            let name = known_name(board).ok_or(ALLOWED)?;
            if port.is_empty() || found.iter().any(|(other, _)| *other == name) {
                return Err(format!("{board}: must have one port: {ALLOWED}"));
            }
            found.push((name, port.into()));
        }
        Ok(Self::Serial(found))
    }

    /// Refuses a port of a board that `robot` does not have.
    pub fn check(&self, robot: Topology) -> Result<(), Error> {
        let Self::Serial(ports) = self else {
            return Ok(());
        };
        let stranger = ports
            .iter()
            .find(|(name, _)| board_named(robot, name).is_none());
        match stranger {
            None => Ok(()),
            Some((name, _)) => Err(Error::input(format!(
                "--on serial: {name}: must be {} on a robot of {} axles",
                board_names(robot),
                robot.axle_count()
            ))),
        }
    }

    /// Serial port of a board of `robot`.
    pub fn port(&self, robot: Topology, role: Role) -> Option<&Path> {
        match self {
            Self::Serial(ports) => {
                let own = ports.iter().find(|(board, _)| *board == robot.name(role));
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

/// Board of `robot` with this name; `None` for another name.
pub fn board_named(robot: Topology, name: &str) -> Option<Role> {
    robot.boards().find(|&role| robot.name(role) == name)
}

/// Names of the boards of `robot` in words: front, rear or beam.
pub fn board_names(robot: Topology) -> String {
    let names: Vec<_> = robot.boards().map(|role| robot.name(role)).collect();
    match names.split_last() {
        Some((last, others)) => format!("{} or {last}", others.join(", ")),
        None => String::new(),
    }
}

/// `name` if a robot of any number of axles has a board of this name.
fn known_name(name: &str) -> Option<&'static str> {
    let robots = (2..=MAX_AXLES).filter_map(Topology::new);
    let named = |robot: Topology| board_named(robot, name).map(|role| robot.name(role));
    robots.filter_map(named).next()
}

/// Kind, images and settings of the boards that drive a run.
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
