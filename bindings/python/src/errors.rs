//! Exceptions: an argument or a key that is refused, and a run that failed.

use host_sim::base::error::{Error, Refusal};
use pyo3::create_exception;
use pyo3::exceptions::{PyException, PyKeyboardInterrupt, PyValueError};
use pyo3::prelude::*;

create_exception!(
    cfmmr,
    InputError,
    PyValueError,
    "An argument or a key of a scenario was refused.\n\n\
     Attributes: field, value and allowed (str), or None where the text does not concern one value."
);
create_exception!(
    cfmmr,
    RunError,
    PyException,
    "A run could not continue, for example because the configuration of a board was refused at its start."
);

/// Adds the exceptions to the module.
pub fn add(module: &Bound<'_, PyModule>) -> PyResult<()> {
    let py = module.py();
    let input = py.get_type::<InputError>();
    for attribute in ["field", "value", "allowed"] {
        input.setattr(attribute, py.None())?;
    }
    module.add("InputError", input)?;
    module.add("RunError", py.get_type::<RunError>())
}

/// Exception for a refused value.
pub fn refused(
    field: impl Into<String>,
    value: impl ToString,
    allowed: impl Into<String>,
) -> PyErr {
    let refusal = Refusal {
        field: field.into(),
        value: value.to_string(),
        allowed: allowed.into(),
    };
    of(&refusal.into())
}

/// Exception for an error of the simulator.
pub fn of(error: &Error) -> PyErr {
    let text = error.to_string();
    match error {
        Error::Interrupted(_) => PyKeyboardInterrupt::new_err(text),
        Error::Failure(_) | Error::NoAnswer(_) => RunError::new_err(text),
        Error::Input(_) | Error::Parameter(_) => Python::attach(|py| {
            let exception = InputError::new_err(text);
            if let Some(refusal) = error.refusal() {
                let value = exception.value(py);
                // An exception of this package takes attributes.
                let _ = value.setattr("field", refusal.field);
                let _ = value.setattr("value", refusal.value);
                let _ = value.setattr("allowed", refusal.allowed);
            }
            exception
        }),
    }
}
