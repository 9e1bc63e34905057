//! Errors, input files, spelling suggestions and TOML text.

#[path = "../../../host-sim/src/base/error.rs"]
pub mod error;
#[path = "../../../host-sim/src/base/input.rs"]
pub mod input;
#[path = "../../../host-sim/src/base/spelling.rs"]
pub mod spelling;
#[path = "../../../host-sim/src/base/toml_file.rs"]
pub mod toml_file;
