//! The built-in search.

use crate::arrays::{Frames, frames};
use crate::away::{Progress, away};
use crate::scene::Scene;
use numpy::{PyArray1, PyArray2, PyArrayMethods, PyReadonlyArray2};
use pyo3::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use whirls::flow::State;
use whirls::learn::{Learner, Outcome};
use whirls::run::{Given, Lesson};
use whirls::truth::{Truth, summed_densities};
use whirls::vector::Vector;
use whirls::{Error, Result};

/// The history of a search, column by column.
#[derive(Default)]
struct History {
    columns: BTreeMap<&'static str, Vec<f64>>,
    parameters: Vec<Vec<f64>>,
    notes: Vec<Option<String>>,
}

/// What a search returns to Python.
#[pyclass(frozen, get_all, module = "whirls._whirls")]
pub(crate) struct Learned {
    /// Values of all learned parameters, in order, with their names.
    parameters: Vec<(String, f64)>,
    /// True values, where they are known.
    known: Option<Vec<f64>>,
    loss: f64,
    initial_loss: f64,
    iterations: usize,
    gradient: &'static str,
    /// What is known about the parameters, as JSON.
    knowledge: String,
    /// Lines that say so.
    lines: Vec<String>,
    warnings: Vec<String>,
    columns: BTreeMap<&'static str, Py<PyArray1<f64>>>,
    trail: Vec<Py<PyArray1<f64>>>,
    /// Estimated positions and velocities of the first frame, where they are estimated.
    first_frame: Option<[Py<PyArray2<f64>>; 2]>,
    notes: Vec<Option<String>>,
}

/// What to learn from.
enum Source<const D: usize> {
    /// A flow that is run for it.
    Scene,
    /// A recording, and whether it is taken even where it does not fit.
    File(PathBuf, bool),
    /// Frames, with densities where they are given.
    Frames { states: Vec<State<D>>, densities: Option<Vec<Vec<f64>>> },
}

/// Arrays `(F, N, d)`, `(F, N, d)`, `(F, N)`.
type Observed<'py> = (Frames<'py>, Frames<'py>, Option<PyReadonlyArray2<'py, f64>>);

impl<const D: usize> Source<D> {
    fn new(file: Option<(PathBuf, bool)>, observed: Option<Observed<'_>>) -> PyResult<Self> {
        if let Some((path, force)) = file {
            return Ok(Self::File(path, force));
        }
        let Some((r, v, rho)) = observed else { return Ok(Self::Scene) };
        let rows = frames::<D>(&r)?.into_iter().zip(frames::<D>(&v)?);
        let state = |(positions, velocities)| State { time: 0.0, positions, velocities };
        let densities = match &rho {
            None => None,
            Some(rho) => {
                let each = rho.as_array().shape()[1].max(1);
                Some(rho.as_slice()?.chunks(each).map(<[f64]>::to_vec).collect())
            }
        };
        Ok(Self::Frames { states: rows.map(state).collect(), densities })
    }

    fn lesson(self, scene: &whirls::Scene) -> Result<Lesson<D>> {
        match self {
            Self::Scene => Lesson::new(scene, None),
            Self::File(path, force) => {
                Lesson::new(scene, Some(Given { path: Path::new(&path), force }))
            }
            Self::Frames { states, densities } => observed(scene, states, densities),
        }
    }
}

/// The lesson of given frames, the first of which is the start.
fn observed<const D: usize>(
    scene: &whirls::Scene,
    mut states: Vec<State<D>>,
    densities: Option<Vec<Vec<f64>>>,
) -> Result<Lesson<D>> {
    let learn = scene.learning()?.clone();
    let count = states.first().map_or(0, |state| state.positions.len());
    if states.len() <= learn.frames || count != scene.particles() {
        return Err(Error::input(
            "the truth",
            format!(
                "at least {} frames, the start and learn.frames = {} after it, of {} particles",
                learn.frames + 1,
                learn.frames,
                scene.particles()
            ),
            format!("{} frames of {count} particles", states.len()),
            "give more frames, or set learn.frames and fluid.particles_per_side",
        ));
    }
    for (k, state) in states.iter_mut().enumerate() {
        state.time = k as f64 * scene.observed_interval();
    }
    let space = scene.space();
    let kernel = (scene.fluid.kernel, scene.fluid.smoothing_length);
    let sum = |state: &State<D>| summed_densities(kernel, space, &state.positions);
    let densities = densities.unwrap_or_else(|| states.iter().map(sum).collect());
    let truth = Truth { states, densities, fields: Vec::new(), is_recorded: true };
    Ok(Lesson::of_truth(learn, truth))
}

/// Everything that a search found.
struct Found {
    names: Vec<String>,
    known: Option<Vec<f64>>,
    outcome: Outcome,
    gradient: &'static str,
    history: History,
    warnings: Vec<String>,
    /// Number of particles, positions and velocities of the estimated first frame, row by row.
    first_frame: Option<(usize, [Vec<f64>; 2])>,
}

fn search<const D: usize>(
    scene: &whirls::Scene,
    (source, guess): (Source<D>, Vec<(String, f64)>),
    progress: &Progress,
) -> Result<Found> {
    let lesson = source.lesson(scene)?;
    let mut learner = Learner::of_truths(scene, &lesson.truths())?;
    let names: Vec<String> = learner.columns().iter().map(ToString::to_string).collect();
    let mut start = learner.guess(scene.seed);
    for (name, value) in guess {
        let place = names.iter().position(|own| *own == name);
        let place = place.ok_or_else(|| {
            let expected = format!("one of {}", names.join(", "));
            Error::input("the guess", expected, &name, "name what the scene learns")
        })?;
        start[place] = value;
    }
    let mut history = History::default();
    let outcome = learner.run(start, &mut |iteration| {
        let evaluation = iteration.evaluation;
        let norm = evaluation.gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
        let row = [
            ("iteration", iteration.index as f64),
            ("window", iteration.window as f64),
            ("loss", evaluation.loss),
            ("trajectory", evaluation.trajectory),
            ("field", evaluation.field),
            ("kl", evaluation.kl),
            ("gradient_norm", norm),
            ("rate", iteration.rate),
        ];
        for (name, number) in row {
            history.columns.entry(name).or_default().push(number);
        }
        history.parameters.push(evaluation.parameters.clone());
        history.notes.push(iteration.note.clone());
        progress.tick_with(format!("loss {:.3e}", evaluation.loss));
        Ok(())
    })?;
    let gradient = learner.gradient().name();
    let first_frame = learner.first_frames().first().map(|state| {
        let flat = |rows: &[Vector<f64, D>]| rows.iter().flat_map(|row| row.0).collect();
        (state.positions.len(), [flat(&state.positions), flat(&state.velocities)])
    });
    let (known, warnings) = (lesson.known, lesson.warnings);
    Ok(Found { names, known, outcome, gradient, history, warnings, first_frame })
}

/// Searches for the parameters that a scene learns.
#[pyfunction]
pub(crate) fn learn(
    py: Python<'_>,
    scene: &Scene,
    truth: (Option<(PathBuf, bool)>, Option<Observed<'_>>),
    guess: Vec<(String, f64)>,
    bar: Option<&Bound<'_, PyAny>>,
) -> PyResult<Learned> {
    let (scene, (file, observed)) = (&scene.0, truth);
    let found = match scene.dimension {
        2 => {
            let source = Source::<2>::new(file, observed)?;
            away(py, bar, |progress| search(scene, (source, guess), progress))?
        }
        _ => {
            let source = Source::<3>::new(file, observed)?;
            away(py, bar, |progress| search(scene, (source, guess), progress))?
        }
    };
    learned(py, found)
}

fn learned(py: Python<'_>, found: Found) -> PyResult<Learned> {
    let Found { names, known, outcome, gradient, history, warnings, first_frame } = found;
    let array = |values: Vec<f64>| PyArray1::from_vec(py, values).unbind();
    let trail = (0..names.len()).map(|k| history.parameters.iter().map(|row| row[k]).collect());
    let trail = trail.map(array).collect();
    let knowledge = serde_json::to_string(&outcome.knowledge)
        .map_err(|error| pyo3::exceptions::PyRuntimeError::new_err(error.to_string()))?;
    let rows = |(count, [r, v]): (usize, [Vec<f64>; 2])| -> PyResult<[Py<PyArray2<f64>>; 2]> {
        let shape = [count, r.len() / count.max(1)];
        let array = |flat| -> PyResult<Py<PyArray2<f64>>> {
            Ok(PyArray1::from_vec(py, flat).reshape(shape)?.unbind())
        };
        Ok([array(r)?, array(v)?])
    };
    let first_frame = first_frame.map(rows).transpose()?;
    Ok(Learned {
        parameters: names.into_iter().zip(outcome.evaluation.parameters).collect(),
        known,
        loss: outcome.evaluation.loss,
        initial_loss: outcome.initial_loss,
        iterations: outcome.iterations,
        gradient,
        knowledge,
        lines: outcome.knowledge.lines(),
        warnings,
        columns: history.columns.into_iter().map(|(name, c)| (name, array(c))).collect(),
        trail,
        first_frame,
        notes: history.notes,
    })
}
