//! Command line of `cfmmr`.

use host_sim::cli::{Cli, Command};
use host_sim::commands;
use host_sim::driving::Manner;
use std::process::ExitCode;

fn main() -> ExitCode {
    let cli = Cli::read();
    let result = match &cli.command {
        None => commands::posture::run(&cli.posture),
        Some(Command::Posture(args)) => commands::posture::run(args),
        Some(Command::Follow(args)) => commands::follow::run(args, Manner::Follow),
        Some(Command::Track(args)) => commands::follow::run(args, Manner::Track),
        Some(Command::Hil(args)) if args.on_virtual => commands::hil_virtual::run(args),
        Some(Command::Hil(args)) => commands::hil::run(args),
        Some(Command::Replay(args)) => commands::replay::run(args),
        Some(Command::Consistency(args)) => commands::consistency::run(args),
        Some(Command::Sweep(args)) => commands::sweep::run(args),
        Some(Command::Eval(args)) => commands::eval::run(args),
        Some(Command::Calibrate(args)) => commands::calibrate::run(args),
        Some(Command::Params(args)) => commands::params::run(args),
        Some(Command::Parameters) => commands::parameters::run(),
        Some(Command::Codes) => commands::codes::run(),
        Some(Command::Dbc(args)) => commands::dbc::run(args),
        Some(Command::Topics) => commands::topics::run(),
        Some(Command::Serial) => commands::serial::run(),
        Some(Command::Config(args)) => commands::config::run(args),
        Some(Command::World(args)) => commands::world::run(args),
        Some(Command::PlantBench(args)) => commands::plant_bench::command(args),
        Some(Command::Faults(args)) if args.emulated => commands::faults_emulated::run(args),
        Some(Command::Faults(args)) if args.virtual_boards => commands::faults_virtual::run(args),
        Some(Command::Faults(args)) => commands::faults::run(args),
        Some(Command::LoopBench(args)) => commands::loop_bench::run(args),
        Some(Command::Soak(args)) => commands::soak::run(args),
        Some(Command::Campaign(args)) => commands::campaign::run(args),
        Some(Command::Doctor(args)) => commands::doctor::run(args),
        Some(Command::Completions(args)) => commands::completions::run(args),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("cfmmr: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}
