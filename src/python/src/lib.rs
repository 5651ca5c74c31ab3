//! whirls for Python: the extension module `whirls._whirls`, which the Python files of the package wrap.
//!
//! Everything here takes and returns numpy arrays of `f64` and plain values; checks of shapes for a reader's eyes,
//! defaults and documentation are in Python.

mod arrays;
mod away;
mod errors;
mod flow;
mod recording;
mod rollout;
mod scene;
mod search;

/// Version of the package.
#[pyo3::pyfunction]
fn version() -> &'static str {
    env!("CARGO_PKG_VERSION")
}

#[pyo3::pymodule]
mod _whirls {
    #[pymodule_export]
    use super::version;
    #[pymodule_export]
    use crate::flow::Flow;
    #[pymodule_export]
    use crate::recording::Recording;
    #[pymodule_export]
    use crate::rollout::Rollout;
    #[pymodule_export]
    use crate::scene::{Scene, shipped};
    #[pymodule_export]
    use crate::search::learn;
}
