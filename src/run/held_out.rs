//! Lessons that taught nothing: what a learned law does in them.

use super::lesson::Window;
use crate::error::{Error, Result};
use crate::flow::{Flow, State};
use crate::interrupt;
use crate::losses::{IncrementDensities, Mesh};
use crate::parameters::Parameter;
use crate::scene::Scene;
use crate::truth::{field_mesh, summed_densities, velocity_field};
use crate::vector::Vector;
use serde::{Deserialize, Serialize};
use std::fmt::{self, Display, Formatter};

/// A learned law in a lesson that is held out. Errors of the field are relative, `⟨|V − V̂|²⟩/⟨|V̂|²⟩` over the nodes of
/// the field loss. A column has one entry for each frame after the first state, fewer where the flow diverged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct HeldOut {
    /// The truth: a seed, a scene or a recording.
    pub of: String,
    /// Time of the first state.
    pub start: f64,
    /// Times of the frames, from the first state on.
    pub times: Vec<f64>,
    /// Errors of the field.
    pub field: Vec<f64>,
    /// Errors of the field if every particle keeps its first velocity.
    pub ballistic: Vec<f64>,
    /// Divergence of the distribution of velocity increments from the truth's, summed over components.
    pub kl: Vec<f64>,
    /// The reason and the step, where the flow diverged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub diverged: Option<String>,
}

/// Relative error of the field up to which a law is said to follow the truth.
const FOLLOWS: f64 = 0.1;

impl HeldOut {
    /// Error of the field in the last frame; none where the flow diverged before it.
    pub fn last_field(&self) -> Option<f64> {
        self.field.last().copied().filter(|_| self.diverged.is_none())
    }

    /// The time at which errors pass a tenth, linear between frames; none if they never do.
    pub fn follows_until(&self, errors: &[f64]) -> Option<f64> {
        let k = errors.iter().position(|error| *error > FOLLOWS)?;
        let before = k.checked_sub(1);
        let (time, error) = before.map_or((0.0, 0.0), |k| (self.times[k], errors[k]));
        Some(time + (self.times[k] - time) * (FOLLOWS - error) / (errors[k] - error))
    }
}

impl Display for HeldOut {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let end = self.times.last().copied().unwrap_or_default();
        write!(f, "held out, {} from t = {:.3}: ", self.of, self.start)?;
        match (self.last_field(), &self.diverged) {
            (Some(field), _) => write!(f, "relative field error {field:.4} after {end:.3}")?,
            (None, Some(reason)) => write!(f, "{reason}")?,
            (None, None) => write!(f, "no frame")?,
        }
        let ballistic = self.ballistic.last().copied().unwrap_or(f64::NAN);
        write!(f, ", ballistic {ballistic:.4}")
    }
}

/// A learned law: the scene that it moves in, and its parameters.
#[derive(Clone, Copy)]
pub(super) struct Learned<'a> {
    pub(super) scene: &'a Scene,
    pub(super) columns: &'a [Parameter],
    pub(super) values: &'a [f64],
}

/// Runs a learned law in windows, and compares it with their truth in the field of the kernel of `metric`, at the start of
/// its search; `after` is called after each window.
///
/// # Errors
/// [`Error::Input`] where a truth holds a number that is not finite, [`Error::Interrupted`].
pub(super) fn judge<const D: usize>(
    learned: Learned<'_>,
    metric: &Scene,
    windows: &[Window<D>],
    after: &mut dyn FnMut(),
) -> Result<Vec<HeldOut>> {
    let learn = metric.learning()?;
    let one = |window: &Window<D>| {
        interrupt::check()?;
        let frames = window.truth.states.len() - 1;
        let seen = Comparison {
            metric,
            mesh: field_mesh(metric, learn),
            nodes: learn.increments.nodes,
            window,
        };
        let held = seen.judge(learned, frames);
        after();
        held
    };
    windows.iter().map(one).collect()
}

/// A window, and how flows are compared with it.
struct Comparison<'a, const D: usize> {
    metric: &'a Scene,
    mesh: Mesh<D>,
    /// Nodes of the densities of increments.
    nodes: usize,
    window: &'a Window<D>,
}

impl<const D: usize> Comparison<'_, D> {
    fn judge(&self, learned: Learned<'_>, frames: usize) -> Result<HeldOut> {
        let truth = &self.window.truth;
        let first = &truth.states[0];
        let time = |k: usize| truth.states[k].time - first.time;
        let mut held = HeldOut {
            of: self.window.of.clone(),
            start: first.time,
            times: (1..=frames).map(time).collect(),
            field: Vec::new(),
            ballistic: (1..=frames)
                .map(|k| self.field_error(&ballistic(first, time(k)), k))
                .collect(),
            kl: Vec::new(),
            diverged: None,
        };
        let mut flow = Flow::<D>::build(learned.scene, first, None, None)?;
        flow.set_learned(learned.columns, learned.values)?;
        match self.follow(&mut flow, (learned.scene.observed_every(), frames), &mut held) {
            Err(error @ Error::Diverged { .. }) => held.diverged = Some(error.to_string()),
            other => other?,
        }
        Ok(held)
    }

    /// Runs a flow over the frames and keeps its errors.
    fn follow(
        &self,
        flow: &mut Flow<D>,
        (every, frames): (u64, usize),
        held: &mut HeldOut,
    ) -> Result<()> {
        let truth = &self.window.truth;
        flow.start()?;
        for k in 1..=frames {
            (0..every).try_for_each(|_| flow.step())?;
            let state = flow.state();
            held.field.push(self.field_error(&state, k));
            let pairs = state.velocities.iter().zip(&truth.states[0].velocities);
            let increments: Vec<_> = pairs.map(|(&now, &start)| now - start).collect();
            let density = IncrementDensities::new(&truth.increments(k), self.nodes)?;
            held.kl.push(density.loss(&increments)?.value);
        }
        Ok(())
    }

    /// `⟨|V − V̂|²⟩/⟨|V̂|²⟩` of a state in a frame.
    fn field_error(&self, state: &State<D>, frame: usize) -> f64 {
        let truth = &self.window.truth;
        let known = truth.fields.get(frame);
        let expected = known.cloned().unwrap_or_else(|| self.field(&truth.states[frame]));
        let field = self.field(state);
        let apart = field.iter().zip(&expected).map(|(&v, &truth)| (v - truth).norm_squared());
        apart.sum::<f64>() / expected.iter().map(|v| v.norm_squared()).sum::<f64>()
    }

    fn field(&self, state: &State<D>) -> Vec<Vector<f64, D>> {
        let fluid = &self.metric.fluid;
        let space = self.metric.space();
        let kernel = (fluid.kernel, fluid.smoothing_length);
        let densities = summed_densities(kernel, space, &state.positions);
        velocity_field(self.metric, &self.mesh, state, &densities)
    }
}

/// Particles that keep their first velocity.
fn ballistic<const D: usize>(first: &State<D>, time: f64) -> State<D> {
    let moved = first.positions.iter().zip(&first.velocities).map(|(&r, &v)| r + v * time);
    State {
        time: first.time + time,
        positions: moved.collect(),
        velocities: first.velocities.clone(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_law_follows_until_its_error_passes_a_tenth() {
        let held = HeldOut {
            of: String::new(),
            start: 0.0,
            times: vec![1.0, 2.0, 3.0],
            field: Vec::new(),
            ballistic: Vec::new(),
            kl: Vec::new(),
            diverged: None,
        };
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-15, "{a} {b}");
        near(held.follows_until(&[0.05, 0.15, 0.2]).unwrap_or(f64::NAN), 1.5);
        near(held.follows_until(&[0.2, 0.3, 0.4]).unwrap_or(f64::NAN), 0.5);
        assert_eq!(held.follows_until(&[0.01, 0.02, 0.03]), None);
        assert_eq!(held.follows_until(&[]), None);
    }
}
