//! Scenes.

use crate::arrays::array;
use crate::away::away;
use crate::errors::raised;
use numpy::PyArray2;
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::{PyBool, PyDict};
use toml::{Table, Value};
use whirls::Flow;
use whirls::flow::State;
use whirls::scene::SHIPPED;
use whirls::trade::calibrate_step;

/// A checked scene.
#[pyclass(frozen, module = "whirls._whirls")]
pub(crate) struct Scene(pub(crate) whirls::Scene);

/// Names of the scenes that are compiled in.
#[pyfunction]
pub(crate) fn shipped() -> Vec<&'static str> {
    SHIPPED.iter().map(|scene| scene.name).collect()
}

/// A Python value as a value of TOML.
fn value(any: &Bound<'_, PyAny>) -> PyResult<Value> {
    if any.is_instance_of::<PyBool>() {
        return Ok(Value::Boolean(any.extract()?));
    }
    if let Ok(whole) = any.extract::<i64>() {
        return Ok(Value::Integer(whole));
    }
    if let Ok(number) = any.extract::<f64>() {
        return Ok(Value::Float(number));
    }
    if let Ok(text) = any.extract::<String>() {
        return Ok(Value::String(text));
    }
    if let Ok(dict) = any.cast::<PyDict>() {
        let row = |(key, own): (Bound<'_, PyAny>, Bound<'_, PyAny>)| {
            Ok((key.extract::<String>()?, value(&own)?))
        };
        return Ok(Value::Table(dict.iter().map(row).collect::<PyResult<Table>>()?));
    }
    for method in ["tolist", "__fspath__"] {
        if any.hasattr(method)? {
            return value(&any.call_method0(method)?);
        }
    }
    match any.try_iter() {
        Ok(items) => {
            items.map(|item| value(&item?)).collect::<PyResult<Vec<_>>>().map(Value::Array)
        }
        Err(_) => Err(PyTypeError::new_err(format!(
            "a value of a scene: expected a number, a text, a truth value, a list or a dict, found {}",
            any.get_type().name()?
        ))),
    }
}

/// `key=value` for every entry of a dict, as `--set` of the commands takes it.
fn assignments(overrides: &Bound<'_, PyDict>) -> PyResult<Vec<String>> {
    let entry = |(key, own): (Bound<'_, PyAny>, Bound<'_, PyAny>)| {
        Ok(format!("{}={}", key.extract::<String>()?, value(&own)?))
    };
    overrides.iter().map(entry).collect()
}

/// Lets the step be chosen where the scene asks for an accuracy.
fn settled(scene: whirls::Scene) -> whirls::Result<whirls::Scene> {
    if !scene.is_unsettled() {
        return Ok(scene);
    }
    let choice = match scene.dimension {
        2 => calibrate_step(&scene, |scene| Ok(Flow::<2>::new(scene)?.state()))?,
        _ => calibrate_step(&scene, |scene| Ok(Flow::<3>::new(scene)?.state()))?,
    };
    Ok(choice.scene)
}

#[pymethods]
impl Scene {
    /// From the name of a shipped scene, a path or, where `origin` names it in errors, a text.
    #[new]
    #[pyo3(signature = (source, overrides, origin=None))]
    fn new(
        py: Python<'_>,
        source: &str,
        overrides: &Bound<'_, PyDict>,
        origin: Option<&str>,
    ) -> PyResult<Self> {
        let overrides = assignments(overrides)?;
        let scene = match origin {
            Some(origin) => whirls::Scene::parse(source, origin, &overrides),
            None => whirls::Scene::open(source, &overrides),
        };
        let scene = raised(py, scene)?;
        Ok(Self(away(py, None, |_| settled(scene))?))
    }

    fn toml(&self) -> String {
        self.0.to_toml()
    }

    fn name(&self) -> &str {
        &self.0.name
    }

    fn about(&self) -> &str {
        &self.0.about
    }

    fn model(&self) -> &'static str {
        self.0.model().kind()
    }

    fn seed(&self) -> u64 {
        self.0.seed
    }

    fn steps(&self) -> u64 {
        self.0.time.steps
    }

    fn observed_every(&self) -> u64 {
        self.0.observed_every()
    }

    /// `(dimension, particles)`.
    fn shape(&self) -> (usize, usize) {
        (self.0.dimension, self.0.particles())
    }

    /// `(smoothing length, time step, mass)`.
    fn units(&self) -> (f64, f64, f64) {
        (self.0.fluid.smoothing_length, self.0.dt(), self.0.mass())
    }

    /// Length of each axis, and whether it is periodic.
    fn axes(&self) -> Vec<(f64, bool)> {
        let space = self.0.space();
        (0..self.0.dimension).map(|axis| (space.side(axis), space.is_periodic(axis))).collect()
    }

    /// Parameters of the truth by name.
    fn parameters(&self) -> Vec<(String, f64)> {
        let parameters = self.0.parameters();
        parameters.specs().iter().map(|spec| (spec.name.to_string(), spec.value)).collect()
    }

    /// Names of what the scene learns, without weights; none where it learns nothing.
    fn learned(&self) -> Option<Vec<String>> {
        let learn = self.0.learn.as_ref()?;
        Some(learn.parameters.iter().map(ToString::to_string).collect())
    }

    /// The storage of the adjoint: `("all" | "checkpoints" | "bytes", number)`.
    fn storage(&self) -> (&'static str, usize) {
        use whirls::sensitivity::Storage;
        match self.0.learn.as_ref().map(|learn| learn.storage).unwrap_or_default() {
            Storage::All => ("all", 0),
            Storage::Checkpoints(count) => ("checkpoints", count),
            Storage::Bytes(bytes) => ("bytes", bytes),
        }
    }

    /// Weights of the model's network, drawn from a seed; empty without a network.
    fn weights(&self, py: Python<'_>, seed: u64) -> PyResult<Vec<f64>> {
        let scene = &self.0;
        away(py, None, |_| match scene.dimension {
            2 => weights::<2>(scene, seed),
            _ => weights::<3>(scene, seed),
        })
    }

    /// Initial positions and velocities, after the scene's spin-up.
    #[expect(clippy::type_complexity, reason = "two arrays")]
    fn initial_state<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>)> {
        match self.0.dimension {
            2 => initial::<2>(py, &self.0),
            _ => initial::<3>(py, &self.0),
        }
    }
}

fn weights<const D: usize>(scene: &whirls::Scene, seed: u64) -> whirls::Result<Vec<f64>> {
    let flow = Flow::<D>::build(scene, &State::initial(scene), None, None)?;
    Ok(flow.draw_weights(seed))
}

/// The state from which flows of a scene start.
pub(crate) fn start_of<const D: usize>(scene: &whirls::Scene) -> whirls::Result<State<D>> {
    match scene.spin_up {
        None => Ok(State::initial(scene)),
        Some(_) => Ok(Flow::<D>::new(scene)?.state()),
    }
}

#[expect(clippy::type_complexity, reason = "two arrays")]
fn initial<'py, const D: usize>(
    py: Python<'py>,
    scene: &whirls::Scene,
) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>)> {
    let state = away(py, None, |_| start_of::<D>(scene))?;
    Ok((array(py, &state.positions)?, array(py, &state.velocities)?))
}
