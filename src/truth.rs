//! Truths: the observed flows that a model learns from.
//!
//! Equation numbers are those of Woodward et al., arXiv:2110.13311: see `docs/equations.md`.

mod dns;
mod windows;

pub use windows::Windows;

use crate::error::{Error, Result};
use crate::flow::{Flow, State};
use crate::kernel::{KernelChoice, Smoothing};
use crate::losses::{IncrementDensities, Mesh, Points, field, sampling_floor};
use crate::neighbours::cells::Cells;
use crate::packed::Packed;
use crate::scene::{Learn, Scene, Times};
use crate::space::Space;
use crate::systems::loss::statistics::{TrueState, statistics};
use crate::systems::loss::{Observation, Observations};
use crate::vector::Vector;
use rayon::prelude::*;
use std::sync::Arc;

/// A true flow: states a scene's [`Scene::observed_every`] steps apart, with densities.
#[derive(Clone, Debug, Default)]
pub struct Truth<const D: usize> {
    /// States; a prediction starts from the first.
    pub states: Vec<State<D>>,
    /// Densities of each state, particle `k` in row `k`.
    pub densities: Vec<Vec<f64>>,
    /// Whether the states come from a recording, which fixes their times, and not from a flow that
    /// was run for this purpose.
    pub is_recorded: bool,
    /// The smoothed velocity field of each state at the nodes of the field loss, where it is known without particles;
    /// empty where it is estimated from them.
    pub fields: Vec<Vec<Vector<f64, D>>>,
}

impl<const D: usize> Truth<D> {
    /// Runs the scene's own law for `after` steps, then records `frames + 1` states at the scene's
    /// observation interval.
    ///
    /// # Errors
    /// [`crate::Error::Diverged`] from the flow.
    pub fn generate(scene: &Scene, (after, frames): (u64, usize)) -> Result<Self> {
        Windows::one(after, frames).only(|windows| Self::windows_of_law(scene, windows))
    }

    /// Runs the scene's own law from a state, and records `frames + 1` states.
    ///
    /// # Errors
    /// [`crate::Error::Diverged`] from the flow.
    pub fn from_state(scene: &Scene, state: &State<D>, frames: usize) -> Result<Self> {
        Self::kept(&mut Flow::from_state(scene, state)?, (frames, scene.observed_every()))
    }

    fn kept(flow: &mut Flow<D>, (frames, every): (usize, u64)) -> Result<Self> {
        flow.start()?;
        let mut truth = Self::default();
        truth.keep(flow);
        for _ in 0..frames {
            (0..every).try_for_each(|_| flow.step())?;
            truth.keep(flow);
        }
        Ok(truth)
    }

    /// The lowest and the highest density of any particle in any state.
    pub fn densities_seen(&self) -> (f64, f64) {
        let all = self.densities.iter().flatten();
        all.fold((f64::INFINITY, 0.0), |(low, high), &rho| (rho.min(low), rho.max(high)))
    }

    /// Records the current state of a flow.
    pub fn keep(&mut self, flow: &mut Flow<D>) {
        self.states.push(flow.state());
        self.densities.push(flow.densities());
    }

    /// `δu = u(τ) − u(0)` of every particle, where `τ` is `frame` frames after the first state.
    pub fn increments(&self, frame: usize) -> Vec<Vector<f64, D>> {
        let pairs = self.states[frame].velocities.iter().zip(&self.states[0].velocities);
        pairs.map(|(&v, &start)| v - start).collect()
    }

    /// Refuses numbers that are not finite, and names the frame, counted from the first state, and
    /// the particle.
    fn must_be_finite(&self) -> Result<()> {
        for (frame, (state, densities)) in self.states.iter().zip(&self.densities).enumerate() {
            let quantities = [
                ("position", state.positions.iter().position(|r| !r.is_finite())),
                ("velocity", state.velocities.iter().position(|v| !v.is_finite())),
                ("density", densities.iter().position(|rho| !rho.is_finite())),
            ];
            let lost = quantities.iter().find_map(|(name, row)| row.map(|row| (name, row)));
            if let Some((name, row)) = lost {
                return Err(Error::input(
                    "the truth",
                    "finite positions, velocities and densities",
                    format!("a {name} of particle {row} in frame {frame} that is none"),
                    "correct the data, or learn from other frames (learn.after, learn.frames)",
                ));
            }
        }
        Ok(())
    }

    /// Refuses states with different numbers of particles.
    fn must_be_whole(&self) -> Result<()> {
        let count = self.states.first().map_or(0, |state| state.positions.len());
        for (k, (state, densities)) in self.states.iter().zip(&self.densities).enumerate() {
            let found = [state.positions.len(), state.velocities.len(), densities.len()];
            if found.iter().any(|found| *found != count) {
                let expected =
                    format!("{count} positions, velocities and densities, as in state 0");
                let remedy = "keep the same particles in every state";
                return Err(Error::input(
                    format!("the truth, state {k}"),
                    expected,
                    format!("{found:?}"),
                    remedy,
                ));
            }
        }
        Ok(())
    }

    /// The observations for a prediction from the first state: the later states, their fields if
    /// the scene has a field loss, and the densities of their increments if it has a statistical
    /// one.
    ///
    /// # Errors
    /// [`crate::Error::Input`] where a number is not finite; it names the frame and the particle.
    pub fn observations(&self, scene: &Scene, learn: &Learn) -> Result<Observations<D>> {
        self.must_be_whole()?;
        self.must_be_finite()?;
        let space = scene.space();
        let mesh = field_mesh(scene, learn);
        let states = self.states.iter().zip(&self.densities).skip(1).take(learn.frames);
        let statistics = statistics::<D>(&learn.statistics);
        let needs_field = learn.loss.field > 0.0
            || statistics.iter().any(|(_, statistic)| statistic.needs_field());
        let observation = |(k, (state, densities)): (usize, (&State<D>, &Vec<f64>))| {
            let increments =
                || IncrementDensities::new(&self.increments(k + 1), learn.increments.nodes);
            let field = match self.fields.get(k + 1) {
                _ if !needs_field => Vec::new(),
                Some(field) => field.clone(),
                None => velocity_field(scene, &mesh, state, densities),
            };
            let seen = TrueState { first: &self.states[0], state, field: &field, mesh: &mesh };
            let values = statistics.iter().map(|(_, statistic)| statistic.of_truth(&seen));
            Ok(Observation {
                statistics: values.collect(),
                step: (k as u64 + 1) * learn.every,
                positions: state.positions.iter().map(|&r| space.wrap(r)).collect(),
                velocities: state.velocities.clone(),
                field,
                increments: (learn.loss.kl > 0.0).then(increments).transpose()?,
            })
        };
        let frames = states.enumerate().map(observation).collect::<Result<Vec<_>>>()?;
        Ok(Observations {
            window: frames.len(),
            frames: Arc::new(frames),
            trajectory: learn.loss.trajectory,
            field: learn.loss.field,
            mesh,
            kl: learn.statistical_weight(learn.every as f64 * scene.dt()),
            times: learn.increments.times,
            statistics: learn.weights_of_statistics(learn.every as f64 * scene.dt()),
            first: Arc::new(match learn.statistics.dispersion > 0.0 {
                true => self.states[0].clone(),
                false => State { positions: Vec::new(), ..self.states[0].clone() },
            }),
        })
    }
}

/// The mesh of the field loss.
pub(crate) fn field_mesh<const D: usize>(scene: &Scene, learn: &Learn) -> Mesh<D> {
    match learn.mesh {
        Some(along_first) => Mesh::over(scene.space(), along_first),
        None => Mesh::of_particles(scene.space(), scene.particles()),
    }
}

/// The statistical loss of one realisation of a truth against another: the mean of
/// [`sampling_floor`] over all ordered pairs, summed over components and the frames that count, and
/// weighted as in the loss. A perfect model with other random numbers has this loss; a smaller loss
/// says nothing more about the distribution.
///
/// # Errors
/// [`crate::Error::Input`] for fewer than two realisations or a velocity that is not finite.
pub fn statistical_floor<const D: usize>(
    realisations: &[&Truth<D>],
    scene: &Scene,
    learn: &Learn,
) -> Result<f64> {
    let first = match learn.increments.times {
        Times::Last => learn.frames,
        Times::All => 1,
    };
    let mut sum = 0.0;
    for frame in first..=learn.frames {
        let increments: Vec<_> = realisations.iter().map(|truth| truth.increments(frame)).collect();
        for axis in 0..D {
            let one = |all: &Vec<Vector<f64, D>>| all.iter().map(|du| du[axis]).collect();
            let components: Vec<Vec<f64>> = increments.iter().map(one).collect();
            let components: Vec<&[f64]> = components.iter().map(Vec::as_slice).collect();
            sum += sampling_floor(&components, learn.increments.nodes)?;
        }
    }
    Ok(learn.statistical_weight(learn.every as f64 * scene.dt()) * sum)
}

/// Densities `ρᵢ = Σⱼ m W(rᵢⱼ, h)` of particles at any positions, each of mass `m = V/N`.
pub fn summed_densities<const D: usize>(
    (kernel, h): (KernelChoice, f64),
    space: Space,
    positions: &[Vector<f64, D>],
) -> Vec<f64> {
    let smoothing = Smoothing::<_, D>::of(kernel.in_dimension(D), h);
    let positions: Vec<_> = positions.iter().map(|&r| space.wrap(r)).collect();
    let mut cells = Cells::default();
    cells.sort(&positions, space, smoothing.support());
    let mass = space.volume::<D>() / positions.len() as f64;
    let density = |&here: &Vector<f64, D>| {
        let mut sum = 0.0;
        for range in cells.around(cells.coordinates(here)).ranges() {
            for &row in &cells.order().rows()[range.from as usize..range.to as usize] {
                let apart = space.minimum_image(here - positions[row as usize]).norm();
                sum += smoothing.value(apart);
            }
        }
        mass * sum
    };
    positions.par_iter().map(density).collect()
}

/// The smoothed velocity field of a state on a mesh, Eq. (13).
pub fn velocity_field<const D: usize>(
    scene: &Scene,
    mesh: &Mesh<D>,
    state: &State<D>,
    densities: &[f64],
) -> Vec<Vector<f64, D>> {
    let kernel = scene.fluid.kernel.in_dimension(D);
    let smoothing = Smoothing::<_, D>::of(kernel, scene.fluid.smoothing_length);
    let space = scene.space();
    let mut cells = Cells::default();
    let positions: Vec<_> = state.positions.iter().map(|&r| space.wrap(r)).collect();
    cells.sort(&positions, space, smoothing.support());
    let line = |&row: &u32| Packed {
        position: positions[row as usize].to_3d(),
        velocity: state.velocities[row as usize].to_3d(),
        density: densities[row as usize],
        p_over_rho2: 0.0,
    };
    let packed: Vec<Packed> = cells.order().rows().iter().map(line).collect();
    let mass = space.volume::<D>() / packed.len() as f64;
    let points = Points { packed: &packed, cells: &cells, space, smoothing: &smoothing, mass };
    field(mesh, &points)
}
