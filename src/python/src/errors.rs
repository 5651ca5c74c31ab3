//! The engine's errors as Python exceptions, in the same words.

use pyo3::exceptions::PyKeyboardInterrupt;
use pyo3::prelude::*;
use pyo3::types::PyString;
use whirls::Error;

/// The exception for an error: a class of `whirls._errors`, with the parts of the message as attributes.
pub(crate) fn exception(py: Python<'_>, error: &Error) -> PyErr {
    let text = error.to_string();
    if let Error::Interrupted { .. } = error {
        return PyKeyboardInterrupt::new_err(text);
    }
    build(py, error, &text).unwrap_or_else(|failed| failed)
}

fn build(py: Python<'_>, error: &Error, text: &str) -> PyResult<PyErr> {
    let classes = py.import("whirls._errors")?;
    let make = |class: &str| classes.getattr(class)?.call1((text,));
    let set = |made: &Bound<'_, PyAny>, parts: &[(&str, &String)]| {
        parts.iter().try_for_each(|(name, part)| made.setattr(*name, PyString::new(py, part)))
    };
    let made = match error {
        Error::Input { place, expected, found, remedy } => {
            let made = make("InputError")?;
            let parts = [("expected", expected), ("found", found), ("remedy", remedy)];
            set(&made, &parts)?;
            made.setattr("place", place)?;
            made
        }
        Error::Diverged { step, time, quantity, found, remedy } => {
            let made = make("DivergedError")?;
            set(&made, &[("quantity", quantity), ("found", found), ("remedy", remedy)])?;
            made.setattr("step", step)?;
            made.setattr("time", time)?;
            made
        }
        Error::File { path, .. } => {
            let made = make("FileError")?;
            made.setattr("path", path.display().to_string())?;
            made
        }
        Error::Interrupted { .. } => make("Error")?,
    };
    Ok(PyErr::from_value(made))
}

/// As a Python result.
pub(crate) fn raised<T>(py: Python<'_>, result: whirls::Result<T>) -> PyResult<T> {
    result.map_err(|error| exception(py, &error))
}
