//! The Python package `cfmmr`: the robot's own code, with the same bits.
//!
//! | module | holds |
//! |---|---|
//! | `errors` | exceptions with field, value and allowed values |
//! | `arrays` | checks of arrays and numbers from Python |
//! | `scenario` | scenarios, their keys, drawn robots |
//! | `trial` | whole trials, on threads |
//! | `plant` | simulated plant, stepped from Python |
//! | `robot` | boards with sensors and bus, stepped from Python |
//! | `own` | controller and estimator of the user |
//! | `algorithms` | single algorithms of the boards |
//!
//! An object holds its state behind a lock, so threads take turns. The interpreter is free during every simulation.

mod algorithms;
mod arrays;
mod errors;
mod own;
mod physics;
mod plant;
mod robot;
mod scenario;
mod trial;

use pyo3::prelude::*;

#[pymodule]
fn _native(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add("__version__", env!("CARGO_PKG_VERSION"))?;
    errors::add(module)?;
    scenario::add(module)?;
    trial::add(module)?;
    plant::add(module)?;
    robot::add(module)?;
    own::add(module)?;
    algorithms::add(module)
}
