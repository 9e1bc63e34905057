//! Images of the boards, built from this workspace.

use crate::base::error::Error;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The boards' target.
pub const TARGET: &str = "thumbv7em-none-eabihf";

/// Profile of Cargo.toml that they are built with.
const PROFILE: &str = "image";

/// Builds a package's image if it is not up to date, with this feature, and gives the ELF file's bytes.
/// All variants have one path, so a lock keeps other runs from building theirs in between.
pub fn build(package: &str, feature: Option<&str>) -> Result<Vec<u8>, Error> {
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let target = std::env::var_os("CARGO_TARGET_DIR").map(PathBuf::from);
    let target = target.unwrap_or_else(|| workspace.join("target"));
    let lock = target.join("images.lock");
    let held = File::create(&lock).and_then(|file| file.lock().map(|()| file));
    let _held = held.map_err(|error| Error::Failure(format!("{}: {error}", lock.display())))?;
    let status = Command::new(&cargo)
        .args(["build", "--quiet", "--locked", "--profile", PROFILE])
        .args(["--target", TARGET, "--package", package])
        .args(
            feature
                .into_iter()
                .flat_map(|feature| ["--features", feature]),
        )
        .current_dir(&workspace)
        .stdin(Stdio::null())
        .status()
        .map_err(|error| Error::Failure(format!("cargo: {error}")))?;
    if !status.success() {
        return Err(Error::Failure(format!(
            "{package} cannot be built for the board ({status}); the Rust target {TARGET} is needed: \
             rustup target add {TARGET}"
        )));
    }
    let built = target.join(TARGET).join(PROFILE).join(package);
    fs::read(&built).map_err(|error| Error::Failure(format!("{}: {error}", built.display())))
}
