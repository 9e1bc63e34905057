//! Single algorithms of the boards.
use pyo3::prelude::*;

/// Adds the classes and functions to the module.
pub fn add(_module: &Bound<'_, PyModule>) -> PyResult<()> {
    Ok(())
}
