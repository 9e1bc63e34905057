//! Tests that may run in parallel, in one program: less to build, and all cores busy.

#![allow(
    clippy::disallowed_methods,
    reason = "a test compares with another implementation"
)]

mod axles;
mod calibration;
mod command_line;
mod consistency;
#[path = "docs/main.rs"]
mod docs;
mod drive;
mod ends;
mod faults;
mod first_steps;
mod follow;
mod hil;
mod imports;
mod keys;
mod params;
mod posture;
#[path = "shared/program.rs"]
mod program;
mod random_faults;
mod soak;
mod starts;
mod supervision;
mod terminal;
mod versions;
mod virtual_boards;
mod virtual_faults;
mod virtual_tools;
