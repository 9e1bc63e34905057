//! Arguments that several experiments take.

use crate::experiments::result::JsonArgs;
use clap::{Args, ValueEnum};
use core_algos::topology::Role;
use host_sim::base::error::Error;
use host_sim::base::numbers::{number, posture, whole};
use host_sim::base::{spelling, toml_file};
use host_sim::scenario::Scenario;
use host_sim::scenario::effect::GivenKeys;
use recording::Destinations;
use remote::images::Images;
use std::net::SocketAddr;
use std::path::PathBuf;
use toml::Table;

/// The world that an experiment is in.
#[derive(Clone, Debug, Default, Args)]
pub struct WorldChoice {
    /// World: a name that `cfmmr world` lists, or a TOML file [default: the scenario's, or careful]
    #[arg(long, value_name = "NAME|FILE")]
    pub world: Option<String>,
}

/// The scenario that an experiment runs.
#[derive(Clone, Debug, Default, Args)]
pub struct ScenarioArgs {
    /// The world.
    #[command(flatten)]
    pub choice: WorldChoice,
    /// Scenario file (TOML); missing keys keep their default, see `cfmmr config`
    #[arg(long, value_name = "FILE")]
    pub scenario: Option<PathBuf>,
    /// Change one key of the scenario, for example --set plant.friction=0.5; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

impl ScenarioArgs {
    /// The scenario; an error says what to type instead.
    pub fn load(&self) -> Result<Scenario, Error> {
        let file = self.scenario.as_deref();
        Scenario::load(self.choice.world.as_deref(), file, &self.set).map_err(|error| {
            let defaults = Table::try_from(Scenario::default()).unwrap_or_default();
            spelling::on_scenario(error, file, &defaults)
        })
    }

    /// True if any option was given.
    pub fn is_given(&self) -> bool {
        self.choice.world.is_some() || self.scenario.is_some() || !self.set.is_empty()
    }

    /// The keys that were given.
    pub fn given(&self) -> Result<GivenKeys, Error> {
        let (file, _) = toml_file::read(self.scenario.as_deref())?;
        GivenKeys::new(&self.set, &file)
    }
}

/// Arguments every experiment takes.
#[derive(Clone, Debug, Args)]
pub struct Common {
    /// The scenario.
    #[command(flatten)]
    pub scenario: ScenarioArgs,
    /// Seed of all random draws; one seed gives the same bytes
    #[arg(long, default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    pub seed: u64,
    /// Folder for pictures, tables and logs [default: out/COMMAND]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Destination of the result as JSON.
    #[command(flatten)]
    pub json: JsonArgs,
    /// Number of threads; does not change the result [default: one a core]
    #[arg(long, value_name = "N", value_parser = whole::<u16>(1..=1024))]
    pub threads: Option<u16>,
}

/// Recording, dashboard and server of a run.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
pub struct LogArgs {
    /// Record the inputs and outputs of the boards in this MCAP file (docs/logs.md); with several
    /// trials: the plotted one
    #[arg(long, value_name = "FILE")]
    pub log: Option<PathBuf>,
    /// Write the run as CSV: epochs to FILE.csv, or epochs, ticks and bus frames to DIR
    #[arg(long, value_name = "DIR|FILE")]
    pub csv: Option<PathBuf>,
    /// Show the run on the terminal in real time; q ends the run
    #[arg(long)]
    pub dashboard: bool,
    /// Serve the run to Foxglove by websocket in real time, from the first viewer on; ADDR is
    /// ADDRESS:PORT or a port [default: 127.0.0.1:8765] (docs/live.md)
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = "127.0.0.1:8765", value_parser = recording::address)]
    pub live: Option<SocketAddr>,
    /// Let web pages of this origin (scheme and host) connect to --live; may be repeated [default: pages of this machine
    /// only]
    #[arg(long, value_name = "ORIGIN", requires = "live")]
    pub live_origin: Vec<String>,
}

impl LogArgs {
    /// Files and address that the run is recorded to.
    pub fn destinations(&self) -> Destinations {
        Destinations {
            log: self.log.clone(),
            csv: self.csv.clone(),
            live: self.live,
            live_origin: self.live_origin.clone(),
        }
    }

    /// True if the run is recorded or served.
    pub fn any(&self) -> bool {
        self.destinations().any()
    }

    /// True if the run is shown or served, so that it runs in real time.
    pub fn is_watched(&self) -> bool {
        self.dashboard || self.live.is_some()
    }
}

/// Place of the boards.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Place {
    /// Their nodes run in this program.
    #[default]
    InProcess,
    /// Their images run on virtual boards.
    Virtual,
    /// Serial ports of front, rear and beam board; boards without a port run in this program.
    Serial([Option<PathBuf>; 3]),
}

/// The place in `in-process`, `virtual` or `serial:front=PORT,rear=PORT,beam=PORT`.
pub fn place(text: &str) -> Result<Place, String> {
    const ALLOWED: &str =
        "must be in-process, virtual or serial:front=PORT[,rear=PORT][,beam=PORT]";
    let ports = match text {
        "in-process" => return Ok(Place::InProcess),
        "virtual" => return Ok(Place::Virtual),
        _ => text.strip_prefix("serial:").ok_or(ALLOWED)?,
    };
    let mut found = [None, None, None];
    for part in ports.split(',') {
        let (board, port) = part.split_once('=').ok_or(ALLOWED)?;
        let role = Role::ALL.into_iter().find(|role| role.name() == board);
        let place = &mut found[role.ok_or(ALLOWED)? as usize];
        if port.is_empty() || place.replace(PathBuf::from(port)).is_some() {
            return Err(format!("{board} {ALLOWED}"));
        }
    }
    Ok(Place::Serial(found))
}

/// Baud rate of the boards' images.
const BAUD: u32 = 921_600;

/// Place of the boards.
#[derive(Clone, Debug, Args)]
pub struct BoardArgs {
    /// Place of the boards: in-process, virtual (their images on virtual boards, built if needed),
    /// or serial:front=PORT,rear=PORT,beam=PORT (real ones); boards without a port run in this program (hil) or are
    /// reached over the bus
    #[arg(long, value_name = "PLACE", default_value = "in-process", value_parser = place)]
    pub on: Place,
    /// Baud rate of the serial ports
    #[arg(long, default_value_t = BAUD, value_parser = whole::<u32>(9_600..=12_000_000))]
    pub baud: u32,
}

impl Default for BoardArgs {
    fn default() -> Self {
        Self {
            on: Place::InProcess,
            baud: BAUD,
        }
    }
}

/// Sensors of the robot.
#[derive(Clone, Debug, Default, Args)]
pub struct SensorArgs {
    /// Run without the relative position sensor (strain gauges)
    #[arg(long)]
    pub no_rps: bool,
    /// Run with gyroscopes and accelerometers
    #[arg(long)]
    pub imu: bool,
}

impl SensorArgs {
    /// Fits the sensors.
    pub fn apply(&self, scenario: &mut Scenario) {
        scenario.mission.rps &= !self.no_rps;
        scenario.world.sensors.gyro.fitted |= self.imu;
        scenario.world.sensors.accelerometer.fitted |= self.imu;
    }
}

/// Duration of a run with boards, and their failures on the way.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Boards")]
pub struct PlanArgs {
    /// Run in real time: no tick begins early
    #[arg(long)]
    pub real_time: bool,
    /// Minimum run time, s
    #[arg(long, value_name = "S", value_parser = number)]
    pub duration: Option<f64>,
    /// End the run at this time, s
    #[arg(long, value_name = "S", value_parser = number)]
    pub stop_after: Option<f64>,
    /// Switch a board off at this time in s, for example front@8.0; may be repeated
    #[arg(long, value_name = "BOARD@S")]
    pub kill: Vec<String>,
    /// Restart a lost board after this time, s
    #[arg(long, value_name = "S", value_parser = number)]
    pub restart_after: Option<f64>,
}

/// Images of virtual boards.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Virtual boards")]
pub struct ImageArgs {
    /// Use this image (ELF) on both axle boards
    #[arg(long, value_name = "ELF")]
    pub axle_image: Option<PathBuf>,
    /// Use this image (ELF) on the beam board
    #[arg(long, value_name = "ELF")]
    pub beam_image: Option<PathBuf>,
}

impl ImageArgs {
    /// The images.
    pub fn open(&self) -> Result<Images, Error> {
        Images::open(self.axle_image.as_deref(), self.beam_image.as_deref())
    }

    /// The options, and whether each is given.
    pub fn given(&self) -> [(&'static str, bool); 2] {
        [
            ("--axle-image", self.axle_image.is_some()),
            ("--beam-image", self.beam_image.is_some()),
        ]
    }
}

/// The robot of `posture`, `follow` and `track`.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Boards")]
pub struct RobotArgs {
    /// Place of the boards.
    #[command(flatten)]
    pub boards: BoardArgs,
    /// Duration and failures.
    #[command(flatten)]
    pub plan: PlanArgs,
    /// Images.
    #[command(flatten)]
    pub images: ImageArgs,
    /// Print the time by function and interrupt
    #[arg(long)]
    pub profile: bool,
}

impl RobotArgs {
    /// True if the robot has boards of its own.
    pub fn has_boards(&self) -> bool {
        self.boards.on != Place::InProcess
    }

    /// Refuses options of boards for a robot without any.
    pub fn refuse_without_boards(&self) -> Result<(), Error> {
        let plan = &self.plan;
        refuse(&[
            ("--duration", plan.duration.is_some()),
            ("--stop-after", plan.stop_after.is_some()),
        ])?;
        self.refuse_of_virtual_boards()
    }

    /// Refuses options of virtual boards for others.
    pub fn refuse_of_virtual_boards(&self) -> Result<(), Error> {
        let plan = &self.plan;
        refuse(&self.images.given())?;
        refuse(&[
            ("--real-time", plan.real_time),
            ("--kill", !plan.kill.is_empty()),
            ("--restart-after", plan.restart_after.is_some()),
            ("--profile", self.profile),
        ])
    }
}

/// Refuses options of virtual boards that are given.
pub fn refuse(options: &[(&str, bool)]) -> Result<(), Error> {
    match options.iter().find(|(_, given)| *given) {
        Some((option, _)) => Err(Error::input(format!("{option}: only with --on virtual"))),
        None => Ok(()),
    }
}

/// A board of the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum BoardName {
    /// Front axle and lead node
    Front,
    /// Rear axle
    Rear,
    /// Instrumented frame
    Beam,
}

impl From<BoardName> for Role {
    fn from(name: BoardName) -> Self {
        match name {
            BoardName::Front => Self::Front,
            BoardName::Rear => Self::Rear,
            BoardName::Beam => Self::Beam,
        }
    }
}

/// A posture from `X,Y,PHI`: metres, metres, and a heading in radians, or in degrees when it ends
/// in `deg` or `°`.
pub fn parse_posture(text: &str) -> Result<[f64; 3], String> {
    let parts: Vec<&str> = text.split(',').map(str::trim).collect();
    let [x, y, phi] = parts[..] else {
        return Err(format!(
            "--from {text}: must be three numbers X,Y,PHI (m, m, rad), found {}: for example \
             --from -1.5,0.2,90deg",
            parts.len()
        ));
    };
    posture([x, y, phi], 50.0)
        .map_err(|error| format!("--from: {error}, for example --from -1.5,0.2,90deg"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn posture_in_radians_or_degrees() {
        assert_eq!(parse_posture("-1, 2 ,0.5"), Ok([-1.0, 2.0, 0.5]));
        let half_turn = parse_posture("0,0,180deg").unwrap()[2];
        assert!((half_turn - std::f64::consts::PI).abs() < 1e-15);
        assert_eq!(parse_posture("0,0,90°"), parse_posture("0,0,90 deg"));
        for bad in ["1,2", "1,2,3,4", "a,0,0", "nan,0,0", "0,inf,0", "0,0,7", ""] {
            assert!(parse_posture(bad).is_err(), "{bad}");
        }
    }
}
