//! Source lines of the firmware that ran, of one run or of many.
//!
//! ```no_run
//! use host_sim::run::virtual_robot::VirtualRobot;
//! use host_sim::run::virtual_robot::tools::coverage;
//! use virtual_board::probe::coverage::Coverage;
//!
//! # fn runs() -> Vec<VirtualRobot> { Vec::new() }
//! let mut sum = Coverage::default();
//! for mut robot in runs() {
//!     coverage::add(&mut robot, &mut sum);
//! }
//! std::fs::write("firmware.info", sum.lcov()).unwrap();
//! ```

use crate::base::error::Error;
use crate::run::virtual_robot::VirtualRobot;
use crate::targets::images::Images;
use core_algos::topology::Role;
use std::path::Path;
use virtual_board::image::Image;
use virtual_board::probe::coverage::Coverage;

/// Packages whose lines are counted.
const PACKAGES: [&str; 3] = [
    "firmware-axle/",
    "firmware-beam/",
    "crates/firmware-common/",
];

/// Adds what the boards of a robot have run since power on. Lines that did not run count too, so that
/// a robot without [`Instruments::profile`](super::Instruments::profile) adds no line that ran.
pub fn add(robot: &mut VirtualRobot, sum: &mut Coverage) {
    let images = robot.images.clone();
    for (&role, board) in robot.roles.iter().zip(robot.network.boards()) {
        let image = images.of(role);
        sum.merge(&of_firmware(&Coverage::of_board(image, board)));
    }
}

/// An error if the images do not tell of any line of the firmware.
pub fn check(images: &Images) -> Result<(), Error> {
    let any = |image: &Image| of_firmware(&Coverage::of(image, [])).total().lines > 0;
    if Role::ALL.into_iter().any(|role| any(images.of(role))) {
        return Ok(());
    }
    Err(Error::input(format!(
        "--coverage: no image has source lines of {} below {}: must be images built here, with debug \
         information",
        PACKAGES
            .map(|package| package.trim_end_matches('/'))
            .join(", "),
        root().display()
    )))
}

/// The repository.
fn root() -> &'static Path {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    package.parent().unwrap_or(package)
}

/// The firmware's lines, with paths from the repository on.
fn of_firmware(coverage: &Coverage) -> Coverage {
    let mut coverage = coverage.below(&root().to_string_lossy());
    coverage.retain(|file| PACKAGES.iter().any(|package| file.starts_with(package)));
    coverage
}
