//! Arguments that several commands take.

use crate::experiments::result::Json;
use crate::experiments::run::Run;
use crate::experiments::run::mission::Mission;
use crate::experiments::run::place::{BAUD, BoardPlace, Site, board_named, board_names};
use crate::experiments::run::plan::Plan;
use crate::experiments::run::stage::Outputs;
use crate::experiments::{Context, Inputs};
use clap::Args;
use core_algos::time::Micros;
use core_algos::topology::{MAX_AXLES, Topology};
use host_sim::base::error::Error;
use host_sim::base::numbers::{number, posture, whole};
use host_sim::base::{spelling, toml_file};
use host_sim::run::robot::Span;
use host_sim::scenario::Scenario;
use host_sim::scenario::effect::GivenKeys;
use host_sim::scenario::own::Own;
use host_sim::targets::{Failure, FailureMode};
use recording::Destinations;
use remote::images::Images;
use remote::virtual_robot::Options;
use std::net::SocketAddr;
use std::path::PathBuf;

/// World of an experiment.
#[derive(Clone, Debug, Default, Args)]
pub struct WorldChoice {
    /// Simulate this world: a name that `cfmmr world` lists, or a TOML file [default: the scenario's, or careful]
    #[arg(long, value_name = "NAME|FILE")]
    pub world: Option<String>,
}

/// Number of the robot's axles.
#[derive(Clone, Copy, Debug, Default, Args)]
pub struct AxlesArg {
    /// Give the robot this number of axles, joined by frames; as --set robot.geometry.axles=N [default: the scenario's,
    /// or 2]
    #[arg(long, value_name = "N", value_parser = whole::<u8>(2..=MAX_AXLES as u8))]
    pub axles: Option<u8>,
}

impl AxlesArg {
    /// Robot of a command without a scenario; two axles without this option.
    pub fn topology(&self) -> Topology {
        let axles = self.axles.map(usize::from);
        axles.and_then(Topology::new).unwrap_or_default()
    }

    /// Changes of the scenario by `--set` and this option; refuses two numbers of axles.
    pub fn changes(&self, set: &[String]) -> Result<Vec<String>, Error> {
        const KEY: &str = "robot.geometry.axles";
        let mut changes = set.to_vec();
        if let Some(axles) = self.axles {
            let is_set = |change: &String| {
                change
                    .split('=')
                    .next()
                    .is_some_and(|key| key.trim() == KEY)
            };
            if set.iter().any(is_set) {
                return Err(Error::input(format!(
                    "--axles {axles}: --set {KEY} is given too; leave one out"
                )));
            }
            changes.push(format!("{KEY}={axles}"));
        }
        Ok(changes)
    }
}

/// Scenario of an experiment.
#[derive(Clone, Debug, Default, Args)]
pub struct ScenarioArgs {
    /// Option that selects the world.
    #[command(flatten)]
    pub choice: WorldChoice,
    /// Option that sets the number of axles.
    #[command(flatten)]
    pub axles: AxlesArg,
    /// Read the scenario from this TOML file; missing keys keep their defaults, see `cfmmr config`
    #[arg(long, value_name = "FILE")]
    pub scenario: Option<PathBuf>,
    /// Change one key of the scenario, for example --set plant.friction=0.5; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

impl ScenarioArgs {
    /// Loads the scenario; an error suggests what to type.
    pub fn load(&self) -> Result<Scenario, Error> {
        let file = self.scenario.as_deref();
        let changes = self.axles.changes(&self.set)?;
        Scenario::load(self.choice.world.as_deref(), file, &changes).map_err(|error| {
            let known = toml_file::known_keys(&Scenario::default()).unwrap_or_default();
            spelling::on_scenario(error, file, &known)
        })
    }

    /// True if any option was given.
    pub fn is_given(&self) -> bool {
        let changed = !self.set.is_empty() || self.axles.axles.is_some();
        self.choice.world.is_some() || self.scenario.is_some() || changed
    }

    /// Keys set by `--set` and by the scenario file.
    pub fn given(&self) -> Result<GivenKeys, Error> {
        let (file, _) = toml_file::read(self.scenario.as_deref())?;
        GivenKeys::new(&self.axles.changes(&self.set)?, &file)
    }
}

/// Destination of the result as JSON.
#[derive(Clone, Debug, Default, Args)]
pub struct JsonArgs {
    /// Write the result as JSON to FILE; with `-` to standard output, and the table to standard error
    #[arg(id = "json", long = "json", value_name = "FILE")]
    file: Option<PathBuf>,
}

impl JsonArgs {
    /// The destination; an error names a file that cannot be written.
    pub fn open(&self) -> Result<Json, Error> {
        Json::to(self.file.clone())
    }
}

/// Arguments every experiment takes.
#[derive(Clone, Debug, Args)]
pub struct Common {
    /// Options that select and change the scenario.
    #[command(flatten)]
    pub scenario: ScenarioArgs,
    /// Options that set seed, threads and output.
    #[command(flatten)]
    pub run: RunArgs,
}

impl Common {
    /// Scenario, threads and output of a command, with parts of the user.
    pub fn context(&self, name: &str, own: &Own) -> Result<Context, Error> {
        let mut scenario = self.scenario.load()?;
        scenario.own = own.clone();
        own.check_axles(scenario.robot.topology())?;
        self.run.context(name, scenario, self.scenario.given()?)
    }
}

/// Seed, threads and output of an experiment.
#[derive(Clone, Debug, Args)]
pub struct RunArgs {
    /// Use this seed for all random draws; equal seeds give identical output
    #[arg(long, default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    pub seed: u64,
    /// Write pictures, tables and logs to this folder [default: out/COMMAND]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Destination of the result as JSON.
    #[command(flatten)]
    pub json: JsonArgs,
    /// Use N threads; the number does not change the result [default: one per core]
    #[arg(long, value_name = "N", value_parser = whole::<u16>(1..=1024))]
    pub threads: Option<u16>,
}

impl RunArgs {
    /// Context (scenario, seed, threads, output) of the command `name`.
    pub fn context(
        &self,
        name: &str,
        scenario: Scenario,
        given: GivenKeys,
    ) -> Result<Context, Error> {
        let inputs = Inputs {
            scenario,
            given,
            seed: self.seed,
            threads: self.threads,
            out: self.out.clone(),
            json: self.json.open()?,
        };
        Context::new(name, inputs)
    }
}

/// Recording, dashboard and server of a run.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
pub struct LogArgs {
    /// Record the inputs and outputs of the boards in this MCAP file (docs/logs.md); of several trials, record
    /// the plotted trial
    #[arg(long, value_name = "FILE")]
    pub log: Option<PathBuf>,
    /// Write the run as CSV: epochs to FILE.csv, or epochs, ticks and bus frames to folder DIR
    #[arg(long, value_name = "DIR|FILE")]
    pub csv: Option<PathBuf>,
    /// Show the run on the terminal in real time; q ends the run
    #[arg(long)]
    pub dashboard: bool,
    /// Serve the run to Foxglove by websocket in real time; the run starts when a viewer connects; ADDR is
    /// ADDRESS:PORT or a port [default: 127.0.0.1:8765] (docs/live.md)
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = "127.0.0.1:8765", value_parser = recording::address)]
    pub live: Option<SocketAddr>,
    /// Let web pages of this origin (scheme and host) connect to --live; may be repeated [default: pages of this
    /// machine only]
    #[arg(long, value_name = "ORIGIN", requires = "live")]
    pub live_origin: Vec<String>,
}

impl LogArgs {
    /// Files, viewers and dashboard of the run.
    pub fn outputs(&self) -> Outputs {
        Outputs {
            destinations: Destinations {
                log: self.log.clone(),
                csv: self.csv.clone(),
                live: self.live,
                live_origin: self.live_origin.clone(),
            },
            dashboard: self.dashboard,
        }
    }
}

/// Options that select where the boards run: in-process, virtual or real.
#[derive(Clone, Debug, Args)]
pub struct BoardArgs {
    /// Run on boards in-process, virtual (images on virtual boards, built if needed), or real at
    /// serial:front=PORT,rear=PORT,beam=PORT; a board without a port runs in this program (hil) or is reached over
    /// the bus
    #[arg(long, value_name = "PLACE", default_value = "in-process", value_parser = BoardPlace::parse)]
    pub on: BoardPlace,
    /// Set the baud rate of the serial ports [default: 921600]
    #[arg(long, value_parser = whole::<u32>(9_600..=12_000_000))]
    pub baud: Option<u32>,
}

impl BoardArgs {
    /// Baud rate of the serial ports.
    pub fn baud(&self) -> u32 {
        self.baud.unwrap_or(BAUD)
    }

    /// Refuses `--baud` if no board has a serial port.
    pub fn check(&self) -> Result<(), Error> {
        match self.baud {
            Some(baud) if !self.on.has_ports() => Err(Error::input(format!(
                "--baud {baud}: only with --on serial"
            ))),
            _ => Ok(()),
        }
    }
}

/// Options that select the robot's sensors.
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
    /// Applies the options to the sensors of the scenario.
    pub fn apply(&self, scenario: &mut Scenario) {
        scenario.mission.rps &= !self.no_rps;
        scenario.world.sensors.gyro.fitted |= self.imu;
        scenario.world.sensors.accelerometer.fitted |= self.imu;
    }
}

/// Options that set the duration of a run and the failures of boards during the run.
#[derive(Clone, Debug, Default, Args)]
#[command(next_help_heading = "Boards")]
pub struct PlanArgs {
    /// Run in real time: no tick begins early
    #[arg(long)]
    pub real_time: bool,
    /// Run for at least this time, s
    #[arg(long, value_name = "S", value_parser = number)]
    pub duration: Option<f64>,
    /// End the run at this time, s
    #[arg(long, value_name = "S", value_parser = number)]
    pub stop_after: Option<f64>,
    /// Switch a board off at this time, s, for example front@8.0; may be repeated
    #[arg(long, value_name = "BOARD@S")]
    pub kill: Vec<String>,
    /// Restart a lost board after this time, s
    #[arg(long, value_name = "S", value_parser = number)]
    pub restart_after: Option<f64>,
}

impl PlanArgs {
    /// Plan of a run of `robot`; without `--duration` the run lasts at least `least_s`, s.
    pub fn plan(&self, robot: Topology, least_s: f64) -> Result<Plan, Error> {
        let micros =
            |name: &str, value: f64| seconds(name, value, 0.0).map(|s| (s * 1e6) as Micros);
        let failures = self.kill.iter().map(|text| failure(robot, text));
        let restart_after = self
            .restart_after
            .map(|value| seconds("--restart-after", value, 0.001).map(|s| (s * 1e3) as u32));
        let most = self.stop_after.map(|value| micros("--stop-after", value));
        Ok(Plan {
            span: Span {
                least: micros("--duration", self.duration.unwrap_or(least_s))?,
                most: most.transpose()?,
            },
            real_time: self.real_time,
            failures: failures.collect::<Result<_, _>>()?,
            restart_after: restart_after.transpose()?,
        })
    }
}

fn seconds(name: &str, value: f64, least: f64) -> Result<f64, Error> {
    if value >= least && value <= 36_000.0 {
        Ok(value)
    } else {
        Err(Error::input(format!(
            "{name} {value}: must be a number from {least} to 36000"
        )))
    }
}

/// Parses `BOARD@S`, a board of `robot` and the time of its failure, s.
fn failure(robot: Topology, text: &str) -> Result<Failure, Error> {
    let parts = text
        .split_once('@')
        .and_then(|(board, time)| Some((board_named(robot, board)?, time.parse::<f64>().ok()?)));
    let Some((role, time)) = parts else {
        return Err(Error::input(format!(
            "--kill {text}: must be {}, then @ and a time in seconds",
            board_names(robot)
        )));
    };
    let at = (seconds("--kill", time, 0.0)? * 1e3).round() as u32;
    Ok(Failure {
        role,
        at,
        mode: FailureMode::Off,
    })
}

/// Options that select the firmware images of virtual boards.
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
    /// Opens the images. An image that neither an option nor the environment names is built.
    pub fn open(&self) -> Result<Images, Error> {
        Images::open(self.axle_image.as_deref(), self.beam_image.as_deref())
    }

    /// Names of the options; true if the option is given.
    pub fn given(&self) -> [(&'static str, bool); 2] {
        [
            ("--axle-image", self.axle_image.is_some()),
            ("--beam-image", self.beam_image.is_some()),
        ]
    }
}

/// Options of the robot in `posture`, `follow`, `track` and `drive`.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Boards")]
pub struct RobotArgs {
    /// Options that select where the boards run.
    #[command(flatten)]
    pub boards: BoardArgs,
    /// Options of duration and board failures.
    #[command(flatten)]
    pub plan: PlanArgs,
    /// Options that select the images of virtual boards.
    #[command(flatten)]
    pub images: ImageArgs,
    /// Print the processor time of the virtual boards by function and interrupt
    #[arg(long)]
    pub profile: bool,
}

impl RobotArgs {
    /// Location and settings of the boards. Virtual boards use `threads` threads; `None`: the default number.
    fn site(&self, threads: Option<u16>) -> Site {
        Site {
            place: self.boards.on.clone(),
            baud: self.boards.baud(),
            images: [
                self.images.axle_image.clone(),
                self.images.beam_image.clone(),
            ],
            profile: self.profile,
            threads: threads.map_or_else(Options::threads, usize::from),
        }
    }

    /// Refuses options that have no effect on the selected boards, for example `--world` with a real robot.
    pub fn check(&self, sensors: &SensorArgs, choice: &WorldChoice) -> Result<(), Error> {
        self.boards.check()?;
        match self.boards.on {
            BoardPlace::InProcess => {
                let plan = &self.plan;
                let given = [
                    ("--duration", plan.duration.is_some()),
                    ("--stop-after", plan.stop_after.is_some()),
                ];
                refuse(&given, "only with --on virtual or --on serial")?;
                self.refuse_of_virtual_boards()
            }
            BoardPlace::Virtual => Ok(()),
            BoardPlace::Serial(_) => {
                let given = [
                    ("--imu", sensors.imu),
                    ("--no-rps", sensors.no_rps),
                    ("--world", choice.world.is_some()),
                ];
                let why =
                    "no effect with --on serial: sensors and world are those of the real robot";
                refuse(&given, why)?;
                self.refuse_of_virtual_boards()
            }
        }
    }

    /// Drives the mission on the selected boards and publishes the result.
    pub fn run(
        &self,
        context: &Context,
        mission: &Mission,
        log: &LogArgs,
        threads: Option<u16>,
    ) -> Result<(), Error> {
        let run = Run {
            context,
            mission,
            plan: self.plan.plan(context.scenario.robot.topology(), 0.0)?,
            outputs: &log.outputs(),
        };
        run.at(&self.site(threads))
    }

    fn refuse_of_virtual_boards(&self) -> Result<(), Error> {
        let plan = &self.plan;
        refuse(&self.images.given(), ONLY_VIRTUAL)?;
        let given = [
            ("--real-time", plan.real_time),
            ("--kill", !plan.kill.is_empty()),
            ("--restart-after", plan.restart_after.is_some()),
            ("--profile", self.profile),
        ];
        refuse(&given, ONLY_VIRTUAL)
    }
}

/// Reason for refusing an option of virtual boards.
pub const ONLY_VIRTUAL: &str = "only with --on virtual";

/// Fails with the reason `why` if one of the options is given.
pub fn refuse(options: &[(&str, bool)], why: &str) -> Result<(), Error> {
    match options.iter().find(|(_, given)| *given) {
        Some((option, _)) => Err(Error::input(format!("{option}: {why}"))),
        None => Ok(()),
    }
}

/// Parses a posture `X,Y,PHI`: m, m, and a heading in rad, or in degrees with the suffix `deg` or `°`.
pub fn parse_posture(text: &str) -> Result<[f64; 3], Error> {
    let parts: Vec<&str> = text.split(',').map(str::trim).collect();
    let [x, y, phi] = parts[..] else {
        return Err(Error::input(format!(
            "--from {text}: must be three numbers X,Y,PHI (m, m, rad), found {}: for example \
             --from -1.5,0.2,90deg",
            parts.len()
        )));
    };
    posture([x, y, phi], 50.0).map_err(|error| {
        Error::input(format!(
            "--from: {error}, for example --from -1.5,0.2,90deg"
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use core_algos::topology::Role;

    #[test]
    fn posture_is_parsed_in_radians_and_degrees() {
        let parse_posture = |text| parse_posture(text).map_err(|error| error.to_string());
        assert_eq!(parse_posture("-1, 2 ,0.5"), Ok([-1.0, 2.0, 0.5]));
        let half_turn = parse_posture("0,0,180deg").unwrap()[2];
        assert!((half_turn - std::f64::consts::PI).abs() < 1e-15);
        assert_eq!(parse_posture("0,0,90°"), parse_posture("0,0,90 deg"));
        for bad in ["1,2", "1,2,3,4", "a,0,0", "nan,0,0", "0,inf,0", "0,0,7", ""] {
            assert!(parse_posture(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn failure_needs_a_board_and_a_time() {
        let found = |axles, text| {
            let found = failure(Topology::new(axles).unwrap(), text)?;
            Ok::<_, Error>((found.role, found.at))
        };
        assert_eq!(found(2, "front@8.0").unwrap(), (Role::LEAD, 8000));
        assert_eq!(found(2, "rear@1").unwrap(), (Role::axle(1), 1000));
        assert_eq!(found(4, "rear@1").unwrap(), (Role::axle(3), 1000));
        assert_eq!(found(3, "axle-2@1").unwrap(), (Role::axle(1), 1000));
        assert_eq!(found(3, "beam-2@1").unwrap(), (Role::beam(1), 1000));
        let why = found(3, "beam@1").unwrap_err().to_string();
        assert!(
            why.contains("front, axle-2, rear, beam-1 or beam-2"),
            "{why}"
        );
        for bad in [
            "front", "middle@1", "rear@", "rear@nan", "beam@-1", "beam@1e9", "axle-2@1", "beam-1@1",
        ] {
            assert_eq!(found(2, bad).unwrap_err().exit_code(), 2, "{bad}");
        }
    }
}
