//! Commands of the host.

#[path = "../../../host-sim/src/targets/host_command.rs"]
pub mod host_command;
