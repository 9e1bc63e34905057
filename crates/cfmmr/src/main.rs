//! Command line of `cfmmr`.

use host_sim::scenario::own::Own;
use std::process::ExitCode;

fn main() -> ExitCode {
    cfmmr::main_with(Own::default())
}
