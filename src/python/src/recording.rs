//! Recordings, read back.

use crate::arrays::{Film, FilmArrays};
use crate::away::away;
use crate::errors::raised;
use numpy::PyArray1;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::collections::BTreeMap;
use std::path::PathBuf;
use whirls::recording::{self, TrainStep};

/// An open recording.
#[pyclass(frozen, module = "whirls._whirls")]
pub(crate) struct Recording(recording::Recording);

fn flow(name: &str) -> PyResult<recording::Flow> {
    match name {
        "truth" => Ok(recording::Flow::Truth),
        "learned" => Ok(recording::Flow::Learned),
        other => Err(PyValueError::new_err(format!(
            "the flow of a recording: expected 'truth' or 'learned', found {other:?}"
        ))),
    }
}

fn film(
    recording: &recording::Recording,
    (flow, frames): (recording::Flow, Vec<usize>),
) -> whirls::Result<(Film, usize)> {
    let dimension = recording.run().dimension;
    let (mut film, mut count) = (Film::default(), 0);
    for k in frames {
        let frame = recording.frame(flow, k)?;
        count = frame.positions.len();
        film.times.push(frame.time);
        film.steps.push(frame.step);
        film.positions.extend(frame.positions.iter().flat_map(|r| &r[..dimension]));
        film.velocities.extend(frame.velocities.iter().flat_map(|v| &v[..dimension]));
        film.densities.extend(frame.densities);
    }
    Ok((film, count))
}

#[pymethods]
impl Recording {
    #[new]
    fn new(py: Python<'_>, path: PathBuf) -> PyResult<Self> {
        Ok(Self(away(py, None, |_| recording::Recording::open(&path))?))
    }

    fn frame_count(&self, name: &str) -> PyResult<usize> {
        Ok(self.0.frame_count(flow(name)?))
    }

    /// Frames of a flow, in the given order.
    fn frames<'py>(
        &self,
        py: Python<'py>,
        name: &str,
        frames: Vec<usize>,
    ) -> PyResult<FilmArrays<'py>> {
        let flow = flow(name)?;
        let (film, count) = away(py, None, |_| film(&self.0, (flow, frames)))?;
        film.into_arrays(py, (count, self.0.run().dimension))
    }

    /// Iterations of a training: columns by name, and the names of the parameters with a column of each.
    #[expect(clippy::type_complexity, reason = "two tables of columns")]
    fn iterations<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(
        BTreeMap<&'static str, Bound<'py, PyArray1<f64>>>,
        Vec<(String, Bound<'py, PyArray1<f64>>)>,
    )> {
        let steps = raised(py, self.0.train_steps())?;
        let column = |of: fn(&TrainStep) -> f64| {
            PyArray1::from_vec(py, steps.iter().map(of).collect::<Vec<f64>>())
        };
        let columns = BTreeMap::from([
            ("iteration", column(|step| step.iteration as f64)),
            ("window", column(|step| step.window as f64)),
            ("loss", column(|step| step.loss)),
            ("trajectory", column(|step| step.loss_trajectory)),
            ("field", column(|step| step.loss_field)),
            ("kl", column(|step| step.loss_kl)),
            ("gradient_norm", column(|step| step.gradient_norm)),
            ("rate", column(|step| step.learning_rate_or_damping)),
        ]);
        let names = self.0.run().parameters.iter().enumerate();
        let own = names.map(|(k, name)| {
            let values = steps.iter().map(|s| s.parameters.get(k).copied().unwrap_or(f64::NAN));
            (name.clone(), PyArray1::from_vec(py, values.collect()))
        });
        Ok((columns, own.collect()))
    }

    fn is_truncated(&self) -> bool {
        self.0.is_truncated()
    }

    /// The scene's text, the metadata, and the number of messages of each topic.
    fn about(&self) -> (String, BTreeMap<String, String>, BTreeMap<String, u64>) {
        let run = self.0.run();
        (run.scene_toml.clone(), run.metadata.clone(), self.0.counts())
    }

    /// Lines of the log: time, level, text.
    fn logs(&self, py: Python<'_>) -> PyResult<Vec<(f64, String, String)>> {
        let lines = raised(py, self.0.logs())?;
        Ok(lines.into_iter().map(|l| (l.time, format!("{:?}", l.level), l.text)).collect())
    }
}
