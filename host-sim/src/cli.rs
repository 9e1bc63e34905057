//! Command line: arguments and their help.

mod numbers;

use crate::recording::LogArgs;
use clap::{Arg, Args, CommandFactory, FromArgMatches, Parser, Subcommand, ValueEnum};
use core_algos::fusion::tandem::Mode;
use core_algos::topology::Role;
use numbers::{number, whole};
use std::path::PathBuf;

/// Control and sensing of a two-axle compliant-framed mobile robot: the boards' own code against a
/// simulated robot.
///
/// Without a subcommand, `cfmmr` runs `cfmmr posture`: the robot drives from
/// (-1.342 m, -1.342 m, 0°) to the origin with and without its relative position sensor.
#[derive(Debug, Parser)]
#[command(name = "cfmmr", version, args_conflicts_with_subcommands = true)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Option<Command>,
    /// Arguments of `posture` when no subcommand is given.
    #[command(flatten)]
    pub posture: PostureArgs,
}

impl Cli {
    /// The command line of this process; the process ends if it is wrong or asks for help.
    pub fn read() -> Self {
        let cli = Self::from_arg_matches(&command().get_matches());
        cli.unwrap_or_else(|error| error.exit())
    }
}

/// The command with what is said once for the arguments of all subcommands: a negative number is a
/// value, so that it is refused with the range that is allowed.
pub fn command() -> clap::Command {
    let value = |argument: Arg| match argument.get_action().takes_values() {
        true => argument.allow_negative_numbers(true),
        false => argument,
    };
    Cli::command()
        .mut_args(value)
        .mut_subcommands(move |subcommand| subcommand.mut_args(value))
}

/// The subcommands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Posture regulation to the origin: paired trials with and without the relative position
    /// sensor, table, paths and errors over time
    Posture(PostureArgs),
    /// Path following on a line, a circle, a figure eight or waypoints from a CSV file
    Follow(FollowArgs),
    /// Trajectory tracking: the same paths with a time law
    Track(FollowArgs),
    /// Hardware in the loop: the experiments with the boards' images in an emulator, or with real
    /// boards on serial ports
    Hil(HilArgs),
    /// Put a log through the nodes again: whether every bit is the same, or how well other
    /// parameters would have estimated
    Replay(ReplayArgs),
    /// Posture regulation from random starts: success share, map and paths
    Sweep(SweepArgs),
    /// A Monte Carlo study over variations of a scenario, in any number of parts: run, status, merge
    Campaign(CampaignArgs),
    /// Consistency of the fused axle estimates (normalised estimation error squared)
    Consistency(ConsistencyArgs),
    /// Run one on-board algorithm on cases from standard input, one JSON object a line
    Eval(EvalArgs),
    /// Print the table of the parameters a board keeps in its flash
    Parameters,
    /// List, read, change and save the parameters of boards
    Params(ParamsArgs),
    /// Calibrate wheels, strain gauges or gyros, and save what was found
    Calibrate(CalibrateArgs),
    /// Print the table of conditions, their codes, and the operating states
    Codes,
    /// Print the table of what a log holds
    Topics,
    /// Print the table of what host and board say to each other on the serial link
    Serial,
    /// Print the scenario with all defaults as TOML
    Config(ConfigArgs),
    /// Print a world, each figure with its reason: the true robot and its surroundings, as distributions
    World(WorldArgs),
    /// Print the description of the bus (DBC), or its load
    Dbc(DbcArgs),
    /// Put faults into the simulated robot and see how it ends
    Faults(FaultsArgs),
    /// Drive for hours and see whether the estimator's health drifts or memory grows
    Soak(SoakArgs),
    /// Measure the real-time factor of the plant alone
    PlantBench(PlantBenchArgs),
    /// Measure the real-time factor of the whole closed loop
    LoopBench(LoopBenchArgs),
    /// Check toolchain, emulator, probe and serial ports, and say what to do about what is missing
    Doctor(DoctorArgs),
    /// Print the completions of a shell, for example for `source <(cfmmr completions bash)`
    Completions(CompletionsArgs),
}

/// The world that an experiment is in.
#[derive(Clone, Debug, Default, Args)]
pub struct WorldChoice {
    /// World that the robot drives in: one that `cfmmr world` lists, or a TOML file [default: that of the
    /// scenario, or careful]
    #[arg(long, value_name = "NAME|FILE")]
    pub world: Option<String>,
}

/// Arguments every experiment takes.
#[derive(Clone, Debug, Args)]
pub struct Common {
    /// The world.
    #[command(flatten)]
    pub choice: WorldChoice,
    /// Scenario file in TOML; what it leaves out keeps its default (see `cfmmr config`)
    #[arg(long, value_name = "FILE")]
    pub scenario: Option<PathBuf>,
    /// Change one entry of the scenario, for example --set plant.friction=0.5; may be
    /// repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Seed of all random draws; the same seed gives the same bytes
    #[arg(long, default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    pub seed: u64,
    /// Directory for pictures, tables and logs [default: out/COMMAND]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Also write the result as JSON to this file
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
    /// Number of threads; the result does not depend on it [default: one per core]
    #[arg(long, value_name = "N", value_parser = whole::<u16>(1..=1024))]
    pub threads: Option<u16>,
}

/// Which fusion runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum RowSelection {
    /// Without sensor, covariance intersection, with error correction, joint filter; each also
    /// with inertial sensors.
    All,
    /// Only without the relative position sensor and with it (joint filter), no inertial sensors.
    Pair,
}

/// Arguments of `posture`.
#[derive(Clone, Debug, Args)]
pub struct PostureArgs {
    /// Arguments every experiment takes.
    #[command(flatten)]
    pub common: Common,
    /// Where the run is recorded.
    #[command(flatten)]
    pub log: LogArgs,
    /// Number of paired trials in each row
    #[arg(long, default_value_t = 50, value_parser = whole::<u32>(1..=1_000_000), conflicts_with_all = ["dashboard", "live"])]
    pub trials: u32,
    /// Start posture of the robot's midpoint: metres, metres, heading in radians or with `deg`
    #[arg(long, value_name = "X,Y,PHI", allow_hyphen_values = true)]
    pub from: Option<String>,
    /// Rows of the table
    #[arg(long, value_enum, default_value_t = RowSelection::All, conflicts_with_all = ["dashboard", "live"])]
    pub rows: RowSelection,
}

/// Arguments of `follow` and `track`.
#[derive(Clone, Debug, Args)]
pub struct FollowArgs {
    /// Arguments every experiment takes.
    #[command(flatten)]
    pub common: Common,
    /// Where the run is recorded.
    #[command(flatten)]
    pub log: LogArgs,
    /// line, circle, figure-eight, or a CSV file of waypoints (columns x,y in metres)
    #[arg(long, default_value = "figure-eight", value_name = "PATH")]
    pub path: String,
    /// Largest speed along the path, m/s; tracking leaves at least a tenth of the robot's speed
    /// limit for catching up [default: that of the scenario, 0.2]
    #[arg(long, value_name = "M/S", value_parser = number)]
    pub speed: Option<f64>,
    /// Size of a built-in path: length of the line, radius of the circle, half width of the
    /// figure eight, m [default: 3, 1, 1.5]
    #[arg(long, value_name = "M", value_parser = number)]
    pub size: Option<f64>,
    /// Laps of a closed path
    #[arg(long, default_value_t = 1, value_parser = whole::<u32>(1..=10_000))]
    pub laps: u32,
    /// Start posture of the robot's midpoint, as in `posture` [default: on the path's first point
    /// and along it]
    #[arg(long, value_name = "X,Y,PHI", allow_hyphen_values = true)]
    pub from: Option<String>,
    /// Run without the relative position sensor
    #[arg(long)]
    pub no_rps: bool,
    /// Run with gyroscopes and accelerometers
    #[arg(long)]
    pub imu: bool,
}

/// How frames reach an emulated board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LinkKind {
    /// Named pipes through semihosting: fast
    Pipe,
    /// The board's serial port
    Uart,
}

/// Where boards are: emulated, on serial ports, or in this process.
#[derive(Clone, Debug, Args)]
pub struct BoardArgs {
    /// Run the images of the boards in QEMU; they are built if needed
    #[arg(long, conflicts_with_all = ["front", "rear", "beam"])]
    pub emulated: bool,
    /// How frames reach emulated boards
    #[arg(long, value_enum, default_value_t = LinkKind::Pipe, requires = "emulated")]
    pub link: LinkKind,
    /// The emulator
    #[arg(long, value_name = "PROGRAM", default_value = "qemu-system-arm")]
    pub qemu: String,
    /// Serial port of the front board; a board that is not given runs in this process
    #[arg(long, value_name = "PORT")]
    pub front: Option<PathBuf>,
    /// Serial port of the rear board
    #[arg(long, value_name = "PORT")]
    pub rear: Option<PathBuf>,
    /// Serial port of the beam board
    #[arg(long, value_name = "PORT")]
    pub beam: Option<PathBuf>,
    /// Rate of the serial ports
    #[arg(long, default_value_t = 921_600, value_parser = whole::<u32>(9_600..=12_000_000))]
    pub baud: u32,
}

/// Arguments of `hil`.
#[derive(Clone, Debug, Args)]
pub struct HilArgs {
    /// Arguments every experiment takes.
    #[command(flatten)]
    pub common: Common,
    /// Where the run is recorded.
    #[command(flatten)]
    pub log: LogArgs,
    /// Where the boards are.
    #[command(flatten)]
    pub boards: BoardArgs,
    /// Run the images that users flash on virtual STM32F405 boards; they are built if needed
    #[arg(long = "virtual")]
    pub on_virtual: bool,
    /// Image (ELF) of both axles' boards instead
    #[arg(long, value_name = "ELF", requires = "on_virtual")]
    pub axle_image: Option<PathBuf>,
    /// Image of the front board instead
    #[arg(long, value_name = "ELF", requires = "on_virtual")]
    pub front_image: Option<PathBuf>,
    /// Image of the rear board instead
    #[arg(long, value_name = "ELF", requires = "on_virtual")]
    pub rear_image: Option<PathBuf>,
    /// Image of the beam board instead
    #[arg(long, value_name = "ELF", requires = "on_virtual")]
    pub beam_image: Option<PathBuf>,
    /// Have a virtual board wait for gdb at a port of this machine when its power comes on, for example
    /// front@3333; may be repeated
    #[arg(long, value_name = "BOARD@PORT", requires = "on_virtual")]
    pub gdb: Vec<String>,
    /// Write pins, interrupts and bus of virtual boards to this file (Value Change Dump, 5 MB a
    /// simulated second and more)
    #[arg(long, value_name = "FILE", requires = "on_virtual")]
    pub vcd: Option<PathBuf>,
    /// Tell where the time of virtual boards went, by function and by interrupt
    #[arg(long, requires = "on_virtual")]
    pub profile: bool,
    /// Write which source lines of the firmware virtual boards ran to this file (lcov)
    #[arg(long, value_name = "FILE", requires = "on_virtual")]
    pub coverage: Option<PathBuf>,
    /// Run with the parameters that the boards keep in their flash, laid over those of the scenario
    #[arg(long)]
    pub stored: bool,
    /// Directory of files with the flash of emulated boards
    #[arg(long, value_name = "DIR", requires = "emulated")]
    pub flash: Option<PathBuf>,
    /// Keep pace with the clock: no tick begins before its time
    #[arg(long)]
    pub real_time: bool,
    /// Run the same in process and compare every bit
    #[arg(long)]
    pub compare: bool,
    /// Probability that a frame is lost on the bus between boards [default: that of the scenario, 0]
    #[arg(long, value_name = "P", value_parser = number)]
    pub link_loss: Option<f64>,
    /// Time from sending to receiving on the bus, ms [default: that of the scenario, 2]
    #[arg(long, value_name = "MS")]
    pub link_delay: Option<u32>,
    /// Run without the relative position sensor; there is no beam board then
    #[arg(long)]
    pub no_rps: bool,
    /// Run with gyroscopes and accelerometers
    #[arg(long)]
    pub imu: bool,
    /// Start posture of the robot's midpoint, as in `posture`
    #[arg(long, value_name = "X,Y,PHI", allow_hyphen_values = true)]
    pub from: Option<String>,
    /// Follow a path instead, as `follow --path`
    #[arg(long, value_name = "PATH", conflicts_with = "track")]
    pub follow: Option<String>,
    /// Track a trajectory instead, as `track --path`
    #[arg(long, value_name = "PATH")]
    pub track: Option<String>,
    /// Largest speed along a path, m/s
    #[arg(long, value_name = "M/S", value_parser = number)]
    pub speed: Option<f64>,
    /// Size of a built-in path, m
    #[arg(long, value_name = "M", value_parser = number)]
    pub size: Option<f64>,
    /// Laps of a closed path
    #[arg(long, default_value_t = 1, value_parser = whole::<u32>(1..=10_000))]
    pub laps: u32,
    /// Watch a robot that is done at least until this time, s
    #[arg(long, value_name = "S", default_value_t = 20.0, value_parser = number)]
    pub duration: f64,
    /// End at this time, done or not, s
    #[arg(long, value_name = "S", value_parser = number)]
    pub stop_after: Option<f64>,
    /// Switch a board off in the middle of the run, for example front@8.0 (s); may be repeated
    #[arg(long, value_name = "BOARD@S")]
    pub kill: Vec<String>,
    /// Switch a board that was lost on again after this time, s
    #[arg(long, value_name = "S", value_parser = number)]
    pub restart_after: Option<f64>,
}

/// Arguments of `replay`.
#[derive(Clone, Debug, Args)]
pub struct ReplayArgs {
    /// The log, as `--log` writes it
    #[arg(value_name = "LOG")]
    pub file: PathBuf,
    /// Estimate again with the parameters in this file (the robot part of a scenario) in place of the
    /// recorded ones
    #[arg(long, value_name = "FILE")]
    pub with: Option<PathBuf>,
    /// Also write the result as JSON to this file
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Model a sweep runs on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SweepModel {
    /// Kinematics of the midpoint with steering dynamics and a perfect estimate.
    Kinematic,
    /// Full plant, sensors, bus and estimation.
    Plant,
}

/// Arguments of `sweep`.
#[derive(Clone, Debug, Args)]
pub struct SweepArgs {
    /// Arguments every experiment takes.
    #[command(flatten)]
    pub common: Common,
    /// Number of random starts (within 2 m of the goal in x and y, any heading)
    #[arg(long, default_value_t = 1000, value_parser = whole::<u32>(1..=10_000_000))]
    pub starts: u32,
    /// What the robot is simulated with
    #[arg(long, value_enum, default_value_t = SweepModel::Plant)]
    pub model: SweepModel,
    /// Largest curvature of the midpoint's path, 0.5 to 5 1/m [default: that of the scenario, 3.08]
    #[arg(long, value_name = "1/M", value_parser = number)]
    pub kappa_max: Option<f64>,
}

/// Arguments of `consistency`.
#[derive(Clone, Debug, Args)]
pub struct ConsistencyArgs {
    /// Arguments every experiment takes.
    #[command(flatten)]
    pub common: Common,
    /// Number of runs
    #[arg(long, default_value_t = 200, value_parser = whole::<u32>(2..=1_000_000))]
    pub trials: u32,
    /// Only these fusions, separated by commas [default: all]
    #[arg(long, value_enum, value_delimiter = ',', value_name = "LIST")]
    pub fusion: Vec<Fusion>,
}

/// Fusions that `consistency` compares.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Fusion {
    /// Odometry alone, without the relative position sensor
    Odometry,
    /// Covariance intersection
    Ci,
    /// Covariance intersection and internal posture error correction
    #[value(name = "ci+ipec")]
    CiIpec,
    /// Joint filter of both axles
    Joint,
}

impl From<Fusion> for Mode {
    fn from(fusion: Fusion) -> Self {
        match fusion {
            Fusion::Odometry => Self::Odometry,
            Fusion::Ci => Self::Intersection,
            Fusion::CiIpec => Self::IntersectionIpec,
            Fusion::Joint => Self::Joint,
        }
    }
}

/// Algorithms that `eval` runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Algorithm {
    /// Relative position sensor: strains to end posture and covariance
    Rps,
    /// Covariance intersection of two postures
    Ci,
    /// Seven-state axle filter
    Ekf,
    /// Internal posture error correction
    Ipec,
    /// Curvature-based law before limits
    Kinematic,
    /// Midpoint motion to axle velocities
    Cascade,
    /// Messages of the bus to bytes and back
    Bus,
    /// The plant's beam (f64)
    Frame,
}

/// Arguments of `eval`.
#[derive(Clone, Debug, Args)]
pub struct EvalArgs {
    /// The algorithm
    #[arg(value_enum)]
    pub name: Algorithm,
}

/// Arguments of `config`.
#[derive(Clone, Debug, Args)]
pub struct ConfigArgs {
    /// The world.
    #[command(flatten)]
    pub choice: WorldChoice,
    /// Read this scenario first, so that the print shows it completed with defaults
    #[arg(long, value_name = "FILE")]
    pub scenario: Option<PathBuf>,
    /// Change one entry, KEY=VALUE; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub set: Vec<String>,
}

/// Arguments of `world`.
#[derive(Clone, Debug, Args)]
pub struct WorldArgs {
    /// Name of a world, or a TOML file; without it the names are listed
    pub name: Option<String>,
    /// Print it as JSON
    #[arg(long, requires = "name")]
    pub json: bool,
    /// Print its file, to begin one of one's own with
    #[arg(long, requires = "name", conflicts_with = "json")]
    pub toml: bool,
}

/// Arguments of `dbc`.
#[derive(Clone, Debug, Args)]
pub struct DbcArgs {
    /// Write the description to this file instead of printing it
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Print the worst-case load of the bus instead, message by message
    #[arg(long, conflicts_with = "out")]
    pub load: bool,
}

/// Arguments of `plant-bench`.
#[derive(Clone, Debug, Args)]
pub struct PlantBenchArgs {
    /// Simulated time of one run, s
    #[arg(long, default_value_t = 20.0, value_name = "S", value_parser = number)]
    pub duration: f64,
    /// Number of runs of each drive; the median is reported
    #[arg(long, default_value_t = 7, value_parser = whole::<u32>(1..=1000))]
    pub repeats: u32,
    /// Also compare with an explicit reference at 20 µs over this time, s; it runs at about real
    /// time
    #[arg(long, default_value_t = 0.0, value_name = "S", value_parser = number)]
    pub accuracy: f64,
    /// Also write the result as JSON to this file
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Arguments of `faults`.
#[derive(Clone, Debug, Args)]
pub struct FaultsArgs {
    /// The world.
    #[command(flatten)]
    pub choice: WorldChoice,
    /// Number of seeds
    #[arg(long, default_value_t = 2, value_parser = whole::<u32>(1..=1000))]
    pub seeds: u32,
    /// Only faults with this in their name; may be repeated
    #[arg(long, value_name = "TEXT")]
    pub only: Vec<String>,
    /// On boards in QEMU instead, with one seed and at one time, each run compared with the same run
    /// in process
    #[arg(long, conflicts_with = "seeds", group = "boards")]
    pub emulated: bool,
    /// QEMU for --emulated, 9.0 or newer
    #[arg(long, value_name = "PROGRAM", default_value = "qemu-system-arm")]
    pub qemu: String,
    /// Faults of the boards themselves instead, on virtual boards that run the images that users flash
    #[arg(long = "virtual", group = "boards")]
    pub virtual_boards: bool,
    /// With --virtual: each fault once, at one time with one seed, and only some of the instants at
    /// which power can fail
    #[arg(long, requires = "virtual_boards", conflicts_with = "seeds")]
    pub quick: bool,
    /// With --virtual: number of threads; the result does not depend on it [default: one per core]
    #[arg(long, value_name = "N", requires = "virtual_boards", value_parser = whole::<u16>(1..=1024))]
    pub threads: Option<u16>,
    /// With --virtual: write which source lines of the firmware ran to this file (lcov)
    #[arg(long, value_name = "FILE", requires = "virtual_boards")]
    pub coverage: Option<PathBuf>,
    /// With --virtual: another image of the axle boards
    #[arg(long, value_name = "ELF", requires = "virtual_boards")]
    pub axle_image: Option<PathBuf>,
    /// With --virtual: another image of the beam board
    #[arg(long, value_name = "ELF", requires = "virtual_boards")]
    pub beam_image: Option<PathBuf>,
    /// With --emulated or --virtual: fail if a row is not as in the committed table, or, with --quick,
    /// if a run ends in a way that its row of the table does not have
    #[arg(long, requires = "boards")]
    pub check: bool,
    /// Also write the result as JSON to this file
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Arguments of `soak`.
#[derive(Clone, Debug, Args)]
pub struct SoakArgs {
    /// The world.
    #[command(flatten)]
    pub choice: WorldChoice,
    /// Axle ticks (ms)
    #[arg(long, default_value_t = 10_000_000, value_parser = whole::<u64>(10_000..=4_000_000_000))]
    pub ticks: u64,
    /// Seed of all random draws
    #[arg(long, default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    pub seed: u64,
    /// Also write the result as JSON to this file
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Arguments of `doctor`.
#[derive(Clone, Debug, Args)]
pub struct DoctorArgs {
    /// The emulator
    #[arg(long, value_name = "PROGRAM", default_value = "qemu-system-arm")]
    pub qemu: String,
    /// Also write the result as JSON to this file
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Arguments of `completions`.
#[derive(Clone, Debug, Args)]
pub struct CompletionsArgs {
    /// The shell
    #[arg(value_enum)]
    pub shell: clap_complete::Shell,
}

/// Arguments of `loop-bench`.
#[derive(Clone, Debug, Args)]
pub struct LoopBenchArgs {
    /// The world.
    #[command(flatten)]
    pub choice: WorldChoice,
    /// Number of runs; the median is reported
    #[arg(long, default_value_t = 7, value_parser = whole::<u32>(1..=1000))]
    pub repeats: u32,
    /// Also write the result as JSON to this file
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
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
    let number = |name: &str, text: &str, limit: f64, unit: &str| match text.parse::<f64>() {
        Ok(value) if value.abs() <= limit => Ok(value),
        _ => Err(format!(
            "--from: {name} = {text}: must be a number from -{limit:.5} to {limit:.5} {unit}, for \
             example --from -1.5,0.2,90deg"
        )),
    };
    let degrees = phi.strip_suffix("deg").or_else(|| phi.strip_suffix('°'));
    let phi = match degrees {
        Some(text) => number("PHI", text.trim(), 360.0, "degrees")?.to_radians(),
        None => number(
            "PHI",
            phi,
            std::f64::consts::TAU,
            "rad (degrees end in deg)",
        )?,
    };
    Ok([number("X", x, 50.0, "m")?, number("Y", y, 50.0, "m")?, phi])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn command_line_is_well_formed() {
        command().debug_assert();
    }

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

    #[test]
    fn posture_is_the_default_command() {
        let cli = Cli::parse_from(["cfmmr", "--trials", "3", "--from", "-1,-1,0"]);
        assert!(cli.command.is_none());
        assert_eq!(cli.posture.trials, 3);
        assert_eq!(cli.posture.from.as_deref(), Some("-1,-1,0"));
    }
}

/// Arguments of `campaign`.
#[derive(Clone, Debug, Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct CampaignArgs {
    /// What to do with the parts' files
    #[command(subcommand)]
    pub action: Option<CampaignAction>,
    /// The study, a TOML file (docs/campaigns.md)
    #[arg(value_name = "FILE", required = true)]
    pub file: Option<PathBuf>,
    /// The world.
    #[command(flatten)]
    pub choice: WorldChoice,
    /// Part I of N, from 0 [default: that of a Slurm array's task or an indexed Kubernetes job; else
    /// all]
    #[arg(long, value_name = "I/N")]
    pub shard: Option<String>,
    /// Directory of the study's files [default: out/FILE]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Number of threads; the result does not depend on it [default: one per core]
    #[arg(long, value_name = "N", value_parser = whole::<u16>(1..=1024))]
    pub threads: Option<u16>,
}

/// What to do with the files of a campaign.
#[derive(Clone, Debug, Subcommand)]
pub enum CampaignAction {
    /// Put all runs into one Parquet file, with a table and pictures
    Merge(CampaignMerge),
    /// Tell which runs are there
    Status(CampaignStatus),
}

/// Arguments of `campaign merge`.
#[derive(Clone, Debug, Args)]
pub struct CampaignMerge {
    /// Directory of the study's files
    #[arg(value_name = "DIR")]
    pub directory: PathBuf,
    /// Directory for the result [default: DIR/merged]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Also write the result as JSON to this file
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Arguments of `campaign status`.
#[derive(Clone, Debug, Args)]
pub struct CampaignStatus {
    /// Directory of the study's files
    #[arg(value_name = "DIR")]
    pub directory: PathBuf,
    /// List the missing blocks and their runs
    #[arg(long)]
    pub missing: bool,
    /// Also write the result as JSON to this file
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}

/// Arguments of `params`.
#[derive(Clone, Debug, Args)]
pub struct ParamsArgs {
    /// What to do
    #[command(subcommand)]
    pub action: ParamsAction,
}

/// What to do with the parameters of boards.
#[derive(Clone, Debug, Subcommand)]
pub enum ParamsAction {
    /// Show all parameters with units and ranges
    List(ParamsTarget),
    /// Show some
    Get(ParamsGet),
    /// Give some another value, until the board is reset or they are saved
    Set(ParamsSet),
    /// Save in the flash what was set
    Save(ParamsTarget),
    /// Write those that differ from what the boards were built with to a file
    Export(ParamsExport),
    /// Set those of a file
    Import(ParamsImport),
}

/// Boards whose parameters are meant.
#[derive(Clone, Debug, Args)]
pub struct ParamsTarget {
    /// Where the boards are; with none of these, in this process with their flash in files.
    #[command(flatten)]
    pub boards: BoardArgs,
    /// Directory of files with the flash of boards that are emulated or in this process
    #[arg(long, value_name = "DIR", default_value = "out/flash")]
    pub flash: PathBuf,
    /// Only these boards, separated by commas [default: all that there are]
    #[arg(long, value_enum, value_delimiter = ',', value_name = "LIST")]
    pub board: Vec<BoardName>,
    /// Also write the result as JSON to this file
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
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

/// Arguments of `params get`.
#[derive(Clone, Debug, Args)]
pub struct ParamsGet {
    /// Names, as in `cfmmr parameters`
    #[arg(value_name = "NAME", required = true)]
    pub names: Vec<String>,
    /// Which boards.
    #[command(flatten)]
    pub target: ParamsTarget,
}

/// Arguments of `params set`.
#[derive(Clone, Debug, Args)]
pub struct ParamsSet {
    /// New values, for example robot.geometry.wheel_radius_m=0.0731
    #[arg(value_name = "NAME=VALUE", required = true)]
    pub values: Vec<String>,
    /// Save them in the flash
    #[arg(long)]
    pub save: bool,
    /// Which boards.
    #[command(flatten)]
    pub target: ParamsTarget,
}

/// Arguments of `params export`.
#[derive(Clone, Debug, Args)]
pub struct ParamsExport {
    /// File to write instead of printing
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// All parameters, not only those that differ
    #[arg(long)]
    pub all: bool,
    /// Which boards.
    #[command(flatten)]
    pub target: ParamsTarget,
}

/// Arguments of `params import`.
#[derive(Clone, Debug, Args)]
pub struct ParamsImport {
    /// The file, as `params export` and `calibrate` write it
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Save them in the flash
    #[arg(long)]
    pub save: bool,
    /// Which boards.
    #[command(flatten)]
    pub target: ParamsTarget,
}

/// What is calibrated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum CalibrateWhat {
    /// Radius, ratio and track of the wheels of each axle: a straight way, then squares both ways
    /// (UMBmark)
    Wheels,
    /// Zeros and gains of the strain gauges: strip held straight, then on formers
    Gauges,
    /// Scale and bias of the gyros: known turns, and rests
    Imu,
}

/// Arguments of `calibrate`.
#[derive(Clone, Debug, Args)]
pub struct CalibrateArgs {
    /// The world.
    #[command(flatten)]
    pub choice: WorldChoice,
    /// What to calibrate
    #[arg(value_enum)]
    pub what: CalibrateWhat,
    /// Where the boards are; with none of these, in this process with their flash in files.
    #[command(flatten)]
    pub boards: BoardArgs,
    /// Directory of files with the flash of boards that are emulated or in this process
    #[arg(long, value_name = "DIR", default_value = "out/flash")]
    pub flash: PathBuf,
    /// Scenario file in TOML, see `cfmmr config`
    #[arg(long, value_name = "FILE")]
    pub scenario: Option<PathBuf>,
    /// Change one entry of the scenario; may be repeated
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Seed of the robot's errors and of all noise
    #[arg(long, default_value_t = 1, value_parser = whole::<u64>(0..=u64::MAX))]
    pub seed: u64,
    /// The robots of several seeds, separated by commas: rms errors before and after; nothing is saved
    #[arg(
        long,
        value_name = "LIST",
        value_delimiter = ',',
        value_parser = whole::<u64>(0..=u64::MAX),
        conflicts_with_all = ["seed", "yes", "out", "emulated", "front", "rear", "beam"]
    )]
    pub seeds: Vec<u64>,
    /// Squares each way and at each speed
    #[arg(long, default_value_t = 6, value_parser = whole::<u32>(1..=100))]
    pub laps: u32,
    /// Save without asking
    #[arg(long)]
    pub yes: bool,
    /// Write what was found to this file, for `params import` and as a scenario
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Also write the result as JSON to this file
    #[arg(long, value_name = "FILE")]
    pub json: Option<PathBuf>,
}
