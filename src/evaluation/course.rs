//! A flow followed from a true state, with its distance from the truth at every step.

use super::Candidate;
use crate::error::Result;
use crate::flow::{Flow, State};
use crate::scene::{Increments, Learn, Scene, StatisticWeights, Times, Weights};
use crate::systems::loss::Observations;
use crate::truth::Truth;
use crate::vector::Vector;

/// The three losses of single steps: entry `k` is step `k + 1`; NaN after a divergence.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Errors {
    /// `(1/N) Σᵢ (|rᵢ − r̂ᵢ|² + |vᵢ − v̂ᵢ|²)`.
    pub trajectory: Vec<f64>,
    /// Mean over nodes and components of `(V − V̂)²`.
    pub field: Vec<f64>,
    /// Divergence of the distributions of `u(τ) − u(0)`, summed over components.
    pub kl: Vec<f64>,
}

impl Errors {
    /// Mean of the field error over the first `steps`: the loss `L_f` of a training over that many
    /// steps.
    pub fn mean_field(&self, steps: usize) -> f64 {
        let first = &self.field[..steps.min(self.field.len())];
        first.iter().sum::<f64>() / first.len() as f64
    }
}

/// States of a flow at some of its steps, and its errors at every step. A step is one that the
/// scene observes.
#[derive(Clone, Debug, Default)]
pub struct Rollout<const D: usize> {
    /// Errors against the truth; empty for the truth itself.
    pub errors: Errors,
    /// States at the marks, until the flow diverged.
    pub states: Vec<State<D>>,
    /// Densities at the marks.
    pub densities: Vec<Vec<f64>>,
    /// Accelerations at the last mark; empty where they cannot be evaluated.
    pub accelerations: Vec<Vector<f64, D>>,
    /// The step at which the flow diverged.
    pub diverged: Option<u64>,
}

/// The number of steps of a flow, and the steps at which its state is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleTimes {
    /// Number of steps.
    pub steps: u64,
    /// Steps between two marks; the first mark is step zero.
    pub every: u64,
}

impl SampleTimes {
    /// The marked steps.
    pub fn marked(self) -> impl Iterator<Item = u64> {
        (0..=self.steps).step_by(self.every.max(1) as usize)
    }
}

/// The observations for trajectory and field loss at every step of a truth, and for the statistical
/// loss if requested.
///
/// # Errors
/// As [`Truth::observations`].
pub fn observations<const D: usize>(
    scene: &Scene,
    (learn, statistical): (&Learn, bool),
    truth: &Truth<D>,
) -> Result<Observations<D>> {
    let kl = f64::from(u8::from(statistical));
    let learn = Learn {
        frames: truth.states.len() - 1,
        loss: Weights { trajectory: 1.0, field: 1.0, kl },
        statistics: StatisticWeights::default(),
        increments: Increments { times: Times::All, ..learn.increments },
        ..learn.clone()
    };
    // Errors of single steps do not have the weight of an integral over time.
    Ok(Observations { kl, ..truth.observations(scene, &learn)? })
}

impl<const D: usize> Rollout<D> {
    /// The course of a truth.
    ///
    /// # Errors
    /// As [`Flow::from_state`].
    pub fn of_truth(scene: &Scene, truth: &Truth<D>, marks: SampleTimes) -> Result<Self> {
        let marked = || marks.marked().map(|step| step as usize);
        let states: Vec<State<D>> = marked().map(|k| truth.states[k].clone()).collect();
        let densities = marked().map(|k| truth.densities[k].clone()).collect();
        let accelerations = match states.last() {
            Some(last) => accelerations(Flow::from_state(scene, last)?),
            None => Vec::new(),
        };
        Ok(Self { states, densities, accelerations, ..Self::default() })
    }

    /// The course of a learned model, from the first state of a truth. A divergence ends it and is
    /// not an error.
    ///
    /// # Errors
    /// As [`Candidate::flow`].
    pub fn of_candidate(
        (scene, candidate): (&Scene, &Candidate),
        truth: &Truth<D>,
        observations: &Observations<D>,
        marks: SampleTimes,
        tick: &mut dyn FnMut(),
    ) -> Result<Self> {
        let mut flow = candidate.flow(scene, &truth.states[0], Some(observations.clone()))?;
        let mut course = Self::default();
        let mut before = [0.0; 3];
        let (every, mut failed) = (scene.observed_every(), flow.start().is_err());
        for step in 0..=marks.steps {
            if step > 0 {
                failed = failed || (0..every).any(|_| flow.step().is_err());
                course.errors.keep(&flow, observations.frames.len(), (&mut before, failed));
                tick();
            }
            if failed {
                course.diverged.get_or_insert(step);
            } else if step.is_multiple_of(marks.every.max(1)) {
                course.states.push(flow.state());
                course.densities.push(flow.densities());
            }
        }
        if let (None, Some(last)) = (course.diverged, course.states.last()) {
            course.accelerations = accelerations(candidate.flow(scene, last, None)?);
        }
        Ok(course)
    }
}

impl Errors {
    /// Records the increase of a flow's losses in its last step.
    fn keep<const D: usize>(
        &mut self,
        flow: &Flow<D>,
        frames: usize,
        (before, failed): (&mut [f64; 3], bool),
    ) {
        let loss = flow.loss();
        // The field loss is a mean over frames.
        let field = loss.value_of("field") * frames as f64;
        let now = [loss.value_of("trajectory"), field, loss.value_of("kl")];
        let grown = |k: usize| if failed { f64::NAN } else { now[k] - before[k] };
        self.trajectory.push(grown(0));
        self.field.push(grown(1));
        self.kl.push(grown(2));
        *before = now;
    }
}

/// Accelerations at the initial state of a flow; empty where the flow cannot start, as may happen
/// with recorded particles in another fluid.
fn accelerations<const D: usize>(mut flow: Flow<D>) -> Vec<Vector<f64, D>> {
    if flow.start().is_ok() { flow.accelerations() } else { Vec::new() }
}
