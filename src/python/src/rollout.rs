//! Rollouts with their derivatives.

use crate::arrays::{Film, FilmArrays, Frames, Rows, array, frames, stacked, state, vectors};
use crate::away::away;
use crate::scene::{Scene, start_of};
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::sync::{Mutex, MutexGuard, PoisonError};
use whirls::flow::{Direction, FrameTangent, State};
use whirls::parameters::Parameter;
use whirls::sensitivity::{RecordedRollout, RolloutPlan, Storage};
use whirls::systems::tape::FrameAdjoint;

/// A rollout of two or three dimensions.
enum Any {
    Two(Mutex<RecordedRollout<2>>),
    Three(Mutex<RecordedRollout<3>>),
}

/// A rollout that was run. Its lock is never waited for with the interpreter held, since the work that holds it may
/// wait for the interpreter.
#[pyclass(frozen, module = "whirls._whirls")]
pub(crate) struct Rollout(Any);

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Positions and velocities, where they are given.
type Start<'py> = Option<(Rows<'py>, Rows<'py>)>;

/// Values of named parameters.
type Named = Vec<(String, f64)>;

/// `∂L/∂θ (P,)`, `∂L/∂r₀ (N, d)`, `∂L/∂v₀ (N, d)`.
type Gradients<'py> =
    (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>);

/// `δr (F, N, d)`, `δv (F, N, d)`, `δρ (F, N)`.
type Tangents<'py> =
    (Bound<'py, PyArray3<f64>>, Bound<'py, PyArray3<f64>>, Bound<'py, PyArray2<f64>>);

fn parameters(named: Named) -> Vec<(Parameter, f64)> {
    named.into_iter().map(|(name, value)| (Parameter::from(name), value)).collect()
}

fn storage((kind, number): (String, usize)) -> PyResult<Storage> {
    match kind.as_str() {
        "all" => Ok(Storage::All),
        "checkpoints" => Ok(Storage::Checkpoints(number)),
        "bytes" => Ok(Storage::Bytes(number)),
        other => Err(PyValueError::new_err(format!("storage: {other}"))),
    }
}

/// Calls a generic function of the rollout's dimension.
macro_rules! in_dimension {
    ($any:expr, $rollout:ident => $call:expr) => {
        match $any {
            Any::Two($rollout) => $call,
            Any::Three($rollout) => $call,
        }
    };
}

fn run<const D: usize>(
    (py, scene): (Python<'_>, &whirls::Scene),
    (start, named): (Start<'_>, Named),
    plan: RolloutPlan,
) -> PyResult<RecordedRollout<D>> {
    let given: Option<State<D>> = start.map(|(r, v)| state(0.0, (&r, &v))).transpose()?;
    let values = parameters(named);
    away(py, None, |_| {
        let start = given.map_or_else(|| start_of(scene), Ok)?;
        RecordedRollout::run(scene, (&start, &values), plan)
    })
}

fn film<const D: usize>(rollout: &Mutex<RecordedRollout<D>>) -> (Film, (usize, usize)) {
    let rollout = lock(rollout);
    let mut film = Film::default();
    for frame in rollout.frames() {
        film.push(frame);
    }
    (film, (rollout.frames()[0].densities.len(), D))
}

fn vjp<'py, const D: usize>(
    py: Python<'py>,
    rollout: &Mutex<RecordedRollout<D>>,
    (r, v, rho): (&Frames<'_>, &Frames<'_>, &PyReadonlyArray2<'_, f64>),
) -> PyResult<Gradients<'py>> {
    let (positions, velocities) = (frames::<D>(r)?, frames::<D>(v)?);
    let each = rho.as_array().shape()[1].max(1);
    let densities: Vec<Vec<f64>> = rho.as_slice()?.chunks(each).map(<[f64]>::to_vec).collect();
    let found = away(py, None, |_| {
        let mut rollout = lock(rollout);
        let columns = positions.into_iter().zip(velocities).zip(densities).enumerate();
        let given = columns.map(|(frame, ((position, velocity), density))| {
            let zero = rollout.zero_cotangent(frame);
            FrameAdjoint { position, velocity, density, ..zero }
        });
        let given: Vec<_> = given.collect();
        rollout.vjp(&given)
    })?;
    let parameters = PyArray1::from_vec(py, found.parameters);
    Ok((parameters, array(py, &found.positions)?, array(py, &found.velocities)?))
}

/// A direction: changes of parameters, and of the start, `(N, d)`.
type Along<'py> = (Named, Rows<'py>, Rows<'py>);

fn jvp<'py, const D: usize>(
    py: Python<'py>,
    rollout: &Mutex<RecordedRollout<D>>,
    along: Vec<Along<'_>>,
) -> PyResult<Vec<Tangents<'py>>> {
    let direction = |(named, r, v): Along<'_>| {
        let (positions, velocities) = (vectors(&r)?, vectors(&v)?);
        Ok(Direction::<D> { parameters: parameters(named), positions, velocities })
    };
    let directions: Vec<_> = along.into_iter().map(direction).collect::<PyResult<_>>()?;
    let found = away(py, None, |_| lock(rollout).jvp(&directions))?;
    found.into_iter().map(|frames| tangents(py, &frames)).collect()
}

fn tangents<'py, const D: usize>(
    py: Python<'py>,
    frames: &[FrameTangent<D>],
) -> PyResult<Tangents<'py>> {
    let count = frames.first().map_or(0, |frame| frame.densities.len());
    let (mut positions, mut velocities, mut densities) = (Vec::new(), Vec::new(), Vec::new());
    for tangent in frames {
        positions.extend(tangent.positions.iter().flat_map(|r| r.0));
        velocities.extend(tangent.velocities.iter().flat_map(|v| v.0));
        densities.extend_from_slice(&tangent.densities);
    }
    Ok((
        stacked(py, positions, (count, D))?,
        stacked(py, velocities, (count, D))?,
        PyArray1::from_vec(py, densities).reshape([frames.len(), count])?,
    ))
}

#[pymethods]
impl Rollout {
    #[new]
    fn new(
        py: Python<'_>,
        scene: &Scene,
        plan: (u64, u64, (String, usize)),
        start: Start<'_>,
        named: Named,
    ) -> PyResult<Self> {
        let (steps, every, kept) = plan;
        let plan = RolloutPlan { steps, every, storage: storage(kept)? };
        let scene = &scene.0;
        let any = match scene.dimension {
            2 => Any::Two(Mutex::new(run((py, scene), (start, named), plan)?)),
            _ => Any::Three(Mutex::new(run((py, scene), (start, named), plan)?)),
        };
        Ok(Self(any))
    }

    /// The frames.
    fn frames<'py>(&self, py: Python<'py>) -> PyResult<FilmArrays<'py>> {
        let (film, shape) = py.detach(|| in_dimension!(&self.0, rollout => film(rollout)));
        film.into_arrays(py, shape)
    }

    /// All parameters in the order of gradients, and the number of those that are not weights.
    fn parameters(&self, py: Python<'_>) -> (Named, usize) {
        let all = || in_dimension!(&self.0, rollout => lock(rollout).parameters().clone());
        let all = py.detach(all);
        let named = all.specs().iter().map(|spec| (spec.name.to_string(), spec.value));
        (named.collect(), all.scalars())
    }

    /// Largest memory of tape and snapshots, in bytes.
    fn bytes(&self, py: Python<'_>) -> usize {
        py.detach(|| in_dimension!(&self.0, rollout => lock(rollout).bytes()))
    }

    fn vjp<'py>(
        &self,
        py: Python<'py>,
        r: Frames<'_>,
        v: Frames<'_>,
        rho: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Gradients<'py>> {
        in_dimension!(&self.0, rollout => vjp(py, rollout, (&r, &v, &rho)))
    }

    /// The derivatives along several directions, by one run.
    fn jvp<'py>(&self, py: Python<'py>, along: Vec<Along<'_>>) -> PyResult<Vec<Tangents<'py>>> {
        in_dimension!(&self.0, rollout => jvp(py, rollout, along))
    }
}
