//! Arrays of Python as vectors of the engine, and back.

use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray2, PyReadonlyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use whirls::flow::State;
use whirls::sensitivity::Frame;
use whirls::vector::Vector;

/// An array of positions or velocities, `(N, d)`.
pub(crate) type Rows<'py> = PyReadonlyArray2<'py, f64>;

/// An array of the same of several frames, `(frames, N, d)`.
pub(crate) type Frames<'py> = PyReadonlyArray3<'py, f64>;

fn split<const D: usize>(numbers: &[f64]) -> Vec<Vector<f64, D>> {
    numbers.as_chunks::<D>().0.iter().map(|row| Vector(*row)).collect()
}

fn must_have<const D: usize>(found: usize) -> PyResult<()> {
    match found == D {
        true => Ok(()),
        false => Err(PyValueError::new_err(format!("expected {D} columns, found {found}"))),
    }
}

/// The rows of a C-contiguous array.
pub(crate) fn vectors<const D: usize>(array: &Rows<'_>) -> PyResult<Vec<Vector<f64, D>>> {
    must_have::<D>(array.as_array().shape()[1])?;
    Ok(split(array.as_slice()?))
}

/// The rows of every frame of a C-contiguous array.
pub(crate) fn frames<const D: usize>(array: &Frames<'_>) -> PyResult<Vec<Vec<Vector<f64, D>>>> {
    let view = array.as_array();
    must_have::<D>(view.shape()[2])?;
    let each = view.shape()[1] * D;
    Ok(array.as_slice()?.chunks(each.max(1)).map(split).collect())
}

/// A state from two arrays.
pub(crate) fn state<const D: usize>(
    time: f64,
    (positions, velocities): (&Rows<'_>, &Rows<'_>),
) -> PyResult<State<D>> {
    Ok(State { time, positions: vectors(positions)?, velocities: vectors(velocities)? })
}

/// Vectors as an array `(N, d)`.
pub(crate) fn array<'py, const D: usize>(
    py: Python<'py>,
    rows: &[Vector<f64, D>],
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let flat: Vec<f64> = rows.iter().flat_map(|row| row.0).collect();
    PyArray1::from_vec(py, flat).reshape([rows.len(), D])
}

/// Frames of `count` rows of `width` numbers as an array `(frames, count, width)`.
pub(crate) fn stacked(
    py: Python<'_>,
    flat: Vec<f64>,
    (count, width): (usize, usize),
) -> PyResult<Bound<'_, PyArray3<f64>>> {
    let frames = flat.len() / (count * width).max(1);
    PyArray1::from_vec(py, flat).reshape([frames, count, width])
}

/// Columns of frames: time, step, positions, velocities, densities.
#[derive(Default)]
pub(crate) struct Film {
    pub(crate) times: Vec<f64>,
    pub(crate) steps: Vec<u64>,
    pub(crate) positions: Vec<f64>,
    pub(crate) velocities: Vec<f64>,
    pub(crate) densities: Vec<f64>,
}

/// The arrays of a [`Film`]: `t (F,)`, `step (F,)`, `r (F, N, d)`, `v (F, N, d)`, `ρ (F, N)`.
pub(crate) type FilmArrays<'py> = (
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<u64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray2<f64>>,
);

impl Film {
    /// Adds a frame.
    pub(crate) fn push<const D: usize>(&mut self, frame: &Frame<D>) {
        let Frame { step, state, densities } = frame;
        self.times.push(state.time);
        self.steps.push(*step);
        self.positions.extend(state.positions.iter().flat_map(|r| r.0));
        self.velocities.extend(state.velocities.iter().flat_map(|v| v.0));
        self.densities.extend_from_slice(densities);
    }

    /// As arrays, for `count` particles in `dimension` dimensions.
    pub(crate) fn into_arrays(
        self,
        py: Python<'_>,
        (count, dimension): (usize, usize),
    ) -> PyResult<FilmArrays<'_>> {
        let frames = self.times.len();
        let known = self.densities.len() == frames * count;
        let densities = if known { self.densities } else { vec![f64::NAN; frames * count] };
        Ok((
            PyArray1::from_vec(py, self.times),
            PyArray1::from_vec(py, self.steps),
            PyArray1::from_vec(py, self.positions).reshape([frames, count, dimension])?,
            PyArray1::from_vec(py, self.velocities).reshape([frames, count, dimension])?,
            PyArray1::from_vec(py, densities).reshape([frames, count])?,
        ))
    }
}
