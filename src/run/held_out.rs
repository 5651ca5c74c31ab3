//! Lessons that taught nothing: what a learned law does in them.

use super::Lesson;
use super::lesson::Window;
use crate::error::{Error, Result};
use crate::evaluation::observations;
use crate::flow::{Flow, State};
use crate::interrupt;
use crate::parameters::Parameter;
use crate::scene::Scene;
use crate::systems::loss::Observations;
use crate::truth::{summed_densities, velocity_field};
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

    /// The time up to which errors stay below a tenth, linear between frames: all of it if they never pass.
    pub fn follows(&self, errors: &[f64]) -> f64 {
        let before =
            |k: usize| if k == 0 { (0.0, 0.0) } else { (self.times[k - 1], errors[k - 1]) };
        match errors.iter().position(|error| *error > FOLLOWS) {
            Some(k) => {
                let (time, error) = before(k);
                time + (self.times[k] - time) * (FOLLOWS - error) / (errors[k] - error)
            }
            None => errors.len().checked_sub(1).map_or(0.0, |last| self.times[last]),
        }
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

/// Runs a learned law in every lesson that is held out; `after` is called after each.
///
/// # Errors
/// [`Error::Input`] where a truth holds a number that is not finite, [`Error::Interrupted`].
pub(super) fn judge<const D: usize>(
    scene: &Scene,
    lesson: &Lesson<D>,
    learned: (&[Parameter], &[f64]),
    after: &mut dyn FnMut(),
) -> Result<Vec<HeldOut>> {
    let one = |window: &Window<D>| {
        interrupt::check()?;
        let seen = observations(scene, (&lesson.learn, true), &window.truth)?;
        let held = judge_one(scene, window, (&seen, learned));
        after();
        held
    };
    lesson.held_out.iter().map(one).collect()
}

fn judge_one<const D: usize>(
    scene: &Scene,
    window: &Window<D>,
    (seen, (columns, values)): (&Observations<D>, (&[Parameter], &[f64])),
) -> Result<HeldOut> {
    let first = &window.truth.states[0];
    let mut held = HeldOut {
        of: window.of.clone(),
        start: first.time,
        times: seen.frames.iter().map(|frame| frame.step as f64 * scene.dt()).collect(),
        field: Vec::new(),
        ballistic: ballistic(scene, first, seen),
        kl: Vec::new(),
        diverged: None,
    };
    let mut flow = Flow::<D>::build(scene, first, None, Some(seen.clone()))?;
    flow.set_learned(columns, values)?;
    match follow(&mut flow, seen, &mut held) {
        Err(error @ Error::Diverged { .. }) => held.diverged = Some(error.to_string()),
        other => other?,
    }
    Ok(held)
}

/// Runs a flow over the frames and keeps its errors.
fn follow<const D: usize>(
    flow: &mut Flow<D>,
    seen: &Observations<D>,
    held: &mut HeldOut,
) -> Result<()> {
    flow.start()?;
    let mut before = [0.0; 2];
    for frame in seen.frames.iter() {
        while flow.steps() < frame.step {
            flow.step()?;
        }
        let loss = flow.loss();
        // The field loss is a mean over frames, nodes and components.
        let now = [loss.value_of("field") * seen.frames.len() as f64, loss.value_of("kl")];
        held.field.push((now[0] - before[0]) / power(&frame.field));
        held.kl.push(now[1] - before[1]);
        before = now;
    }
    Ok(())
}

/// `⟨|V̂|²⟩/D`.
fn power<const D: usize>(field: &[Vector<f64, D>]) -> f64 {
    field.iter().map(|v| v.norm_squared()).sum::<f64>() / (D * field.len()) as f64
}

/// Errors of particles that keep their first velocity, frame by frame.
fn ballistic<const D: usize>(scene: &Scene, first: &State<D>, seen: &Observations<D>) -> Vec<f64> {
    let space = scene.space();
    let kernel = (scene.fluid.kernel, scene.fluid.smoothing_length);
    let error = |frame: &crate::systems::loss::Observation<D>| {
        let time = frame.step as f64 * scene.dt();
        let moved = first.positions.iter().zip(&first.velocities);
        let state = State {
            time: first.time + time,
            positions: moved.map(|(&r, &v)| space.wrap(r + v * time)).collect(),
            velocities: first.velocities.clone(),
        };
        let densities = summed_densities(kernel, space, &state.positions);
        let field = velocity_field(scene, &seen.mesh, &state, &densities);
        let apart = field.iter().zip(&frame.field).map(|(&v, &truth)| (v - truth).norm_squared());
        apart.sum::<f64>() / frame.field.iter().map(|v| v.norm_squared()).sum::<f64>()
    };
    seen.frames.iter().map(error).collect()
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
        near(held.follows(&[0.05, 0.15, 0.2]), 1.5);
        near(held.follows(&[0.2, 0.3, 0.4]), 0.5);
        near(held.follows(&[0.01, 0.02, 0.03]), 3.0);
        near(held.follows(&[0.01, 0.02]), 2.0);
        near(held.follows(&[]), 0.0);
    }
}
