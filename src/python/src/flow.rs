//! Flows, run forward.

use crate::arrays::{Film, FilmArrays, Rows, array, state};
use crate::away::{Progress, away};
use crate::scene::{Scene, start_of};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};
use whirls::flow::State;
use whirls::losses::Mesh;
use whirls::parameters::Parameter;
use whirls::recording;
use whirls::run::{Guard, begin_recording, run_info, run_recorded};
use whirls::scene::Record;
use whirls::sensitivity::Frame;
use whirls::statistics::{Conservation, conservation, energy_spectrum};
use whirls::truth::velocity_field;
use whirls::vector::Vector;

/// A flow of two or three dimensions.
enum Any {
    Two(Mutex<whirls::Flow<2>>),
    Three(Mutex<whirls::Flow<3>>),
}

/// A flow, started. Its lock is never waited for with the interpreter held, since the work that holds it may wait for
/// the interpreter.
#[pyclass(frozen, module = "whirls._whirls")]
pub(crate) struct Flow {
    any: Any,
    scene: whirls::Scene,
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Calls generic code for the flow's dimension, with the interpreter released.
macro_rules! of_flow {
    ($py:expr, $self:expr, $flow:ident => $work:expr) => {
        match &$self.any {
            Any::Two(mutex) => $py.detach(|| {
                let mut guard = lock(mutex);
                let $flow = &mut *guard;
                $work
            }),
            Any::Three(mutex) => $py.detach(|| {
                let mut guard = lock(mutex);
                let $flow = &mut *guard;
                $work
            }),
        }
    };
}

/// Where to start: time, and arrays.
type Start<'py> = Option<(f64, Rows<'py>, Rows<'py>)>;

/// What to run: whether it is the model that the scene learns, and values of named parameters.
type Law = (bool, Vec<(String, f64)>);

/// What to record: path, and whether any file may be replaced.
type Target = Option<(PathBuf, bool)>;

fn build<const D: usize>(
    (py, scene): (Python<'_>, &whirls::Scene),
    start: Start<'_>,
    (of_model, named): Law,
) -> PyResult<whirls::Flow<D>> {
    let given: Option<State<D>> = start.map(|(time, r, v)| state(time, (&r, &v))).transpose()?;
    let (names, values): (Vec<Parameter>, Vec<f64>) =
        named.into_iter().map(|(name, value)| (Parameter::from(name), value)).unzip();
    away(py, None, |_| {
        let start = given.map_or_else(|| start_of(scene), Ok)?;
        let mut flow = match of_model {
            true => whirls::Flow::build(scene, &start, None, None)?,
            false => whirls::Flow::from_state(scene, &start)?,
        };
        flow.set_learned(&names, &values)?;
        flow.start()?;
        Ok(flow)
    })
}

fn columns<const D: usize>(rows: &[Vector<f64, D>]) -> Vec<f64> {
    rows.iter().flat_map(|row| row.0).collect()
}

/// Runs steps, keeps frames, and records. The frames so far are kept where the run fails.
fn run<const D: usize>(
    (flow, scene): (&Mutex<whirls::Flow<D>>, &whirls::Scene),
    ((steps, every), target): ((u64, u64), Target),
    (film, progress): (&Mutex<Film>, &Progress),
) -> whirls::Result<()> {
    let mut flow = lock(flow);
    let record = Record { every, ..scene.record.clone() };
    let mut recorder = match &target {
        None => None,
        Some((path, overwrite)) => {
            let guard =
                Guard { command: "simulate", overwrite: Some(*overwrite), ..Guard::default() };
            let info = run_info(scene, "simulate");
            Some(begin_recording(guard.reserve(path)?, (&info, scene), flow.time())?)
        }
    };
    let first = flow.steps();
    let keep = |flow: &whirls::Flow<D>| {
        if every > 0 && (flow.steps() - first).is_multiple_of(every) {
            lock(film).push(&Frame::of(flow));
        }
    };
    keep(&flow);
    let outcome = run_recorded(
        &mut flow,
        (steps, &record),
        (recorder.as_mut(), recording::Flow::Truth),
        &mut |flow| {
            keep(flow);
            progress.tick();
        },
    );
    let concluded = recorder.map(|recorder| recorder.conclude(&outcome)).transpose();
    outcome?;
    concluded.map(|_| ())
}

#[pymethods]
impl Flow {
    #[new]
    fn new(py: Python<'_>, scene: &Scene, start: Start<'_>, law: Law) -> PyResult<Self> {
        let scene = scene.0.clone();
        let any = match scene.dimension {
            2 => Any::Two(Mutex::new(build((py, &scene), start, law)?)),
            _ => Any::Three(Mutex::new(build((py, &scene), start, law)?)),
        };
        Ok(Self { any, scene })
    }

    /// `(steps, time, time step, mass)`.
    fn clock(&self, py: Python<'_>) -> (u64, f64, f64, f64) {
        of_flow!(py, self, flow => (flow.steps(), flow.time(), flow.dt(), flow.mass()))
    }

    /// `(r, v, ρ)`.
    #[expect(clippy::type_complexity, reason = "three arrays")]
    fn state<'py>(
        &self,
        py: Python<'py>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>)>
    {
        match &self.any {
            Any::Two(flow) => state_of(py, flow),
            Any::Three(flow) => state_of(py, flow),
        }
    }

    /// Accelerations of the last force evaluation, flat.
    fn accelerations<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_vec(py, of_flow!(py, self, flow => columns(&flow.accelerations())))
    }

    fn neighbours_per_particle(&self, py: Python<'_>) -> f64 {
        of_flow!(py, self, flow => flow.neighbours_per_particle())
    }

    /// All parameters of the flow with their values.
    fn parameters(&self, py: Python<'_>) -> Vec<(String, f64)> {
        let all = of_flow!(py, self, flow => flow.parameters().clone());
        all.specs().iter().map(|spec| (spec.name.to_string(), spec.value)).collect()
    }

    /// Runs, and returns frames with the error that ended the run, if any.
    fn run<'py>(
        &self,
        py: Python<'py>,
        length: (u64, u64),
        target: Target,
        bar: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(FilmArrays<'py>, Option<PyErr>)> {
        let film = Mutex::new(Film::default());
        let outcome = away(py, bar, |progress| match &self.any {
            Any::Two(flow) => run((flow, &self.scene), (length, target), (&film, progress)),
            Any::Three(flow) => run((flow, &self.scene), (length, target), (&film, progress)),
        });
        let film = film.into_inner().unwrap_or_else(PoisonError::into_inner);
        let count = of_flow!(py, self, flow => flow.densities().len());
        Ok((film.into_arrays(py, (count, self.scene.dimension))?, outcome.err()))
    }

    /// `Σ m a` of each part of each term, and the scale of round-off.
    fn momentum_rates(&self, py: Python<'_>) -> (BTreeMap<String, Vec<f64>>, f64) {
        of_flow!(py, self, flow => {
            let rates = flow.momentum_rates();
            let parts = rates.contributions.iter();
            (parts.map(|part| (part.name.clone(), part.rate.0.to_vec())).collect(), rates.scale)
        })
    }

    /// Numbers by name, and the momentum.
    fn conservation(&self, py: Python<'_>) -> (BTreeMap<&'static str, f64>, Vec<f64>) {
        let found: Conservation = of_flow!(py, self, flow => conservation(flow));
        let numbers = [
            ("time", found.time),
            ("kinetic_energy", found.kinetic_energy),
            ("total_energy", found.total_energy),
            ("max_mach", found.max_mach),
            ("max_density_deviation", found.max_density_deviation),
            ("courant", found.courant),
        ];
        (numbers.into_iter().collect(), found.momentum)
    }

    /// `E(k)` of the smoothed velocity field on a mesh.
    fn spectrum(&self, py: Python<'_>, per_axis: Option<usize>) -> Vec<f64> {
        of_flow!(py, self, flow => spectrum(flow, &self.scene, per_axis))
    }
}

fn spectrum<const D: usize>(
    flow: &mut whirls::Flow<D>,
    scene: &whirls::Scene,
    per_axis: Option<usize>,
) -> Vec<f64> {
    let mesh = match per_axis {
        Some(along_first) => Mesh::<D>::over(scene.space(), along_first),
        None => Mesh::of_particles(scene.space(), scene.particles()),
    };
    let (state, densities) = (flow.state(), flow.densities());
    energy_spectrum(&mesh, &velocity_field(scene, &mesh, &state, &densities))
}

#[expect(clippy::type_complexity, reason = "three arrays")]
fn state_of<'py, const D: usize>(
    py: Python<'py>,
    flow: &Mutex<whirls::Flow<D>>,
) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>)> {
    let (state, densities) = py.detach(|| {
        let mut flow = lock(flow);
        (flow.state(), flow.densities())
    });
    let densities = PyArray1::from_vec(py, densities);
    Ok((array(py, &state.positions)?, array(py, &state.velocities)?, densities))
}
