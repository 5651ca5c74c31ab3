//! The adjoint of a run of steps: all parameters at the price of one way back.
//!
//! The way back needs every force evaluation. With [`Storage::All`] they are kept; with
//! [`Storage::Checkpoints`] only a few snapshots are, and the steps between them are run again, split
//! by binomial coefficients (Griewank & Walther 2000, `revolve`), which needs the fewest repetitions.
//! Both run the same operations on the same numbers and give the same bits.

use crate::error::Result;
use crate::flow::{Flow, Snapshot, State};
use crate::systems::loss::LossSum;
use serde::{Deserialize, Serialize};

/// What is kept on the way forward.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Storage {
    /// Every force evaluation (default): fastest, memory grows with the number of steps.
    #[default]
    All,
    /// At most this many snapshots and one step: repeated steps instead of memory.
    Checkpoints(usize),
}

/// A loss with its gradient by all physical parameters.
#[derive(Clone, Debug)]
pub struct AdjointGradient {
    /// The loss, part by part.
    pub loss: LossSum,
    /// `∂L/∂(c, α, β, γ, θ)` and by the network's weights; see [`crate::models::Parameter::index`].
    pub gradient: Vec<f64>,
    /// Steps run forward in all, repetitions included.
    pub steps_run: u64,
    /// Most bytes held by tape and snapshots.
    pub bytes: usize,
}

/// Runs `flow` (built with [`Flow::with_adjoint`]) from `state` over `steps` steps, and back.
///
/// # Errors
/// [`crate::Error::Diverged`] from the way forward.
pub fn adjoint_gradient<const D: usize>(
    flow: &mut Flow<D>,
    state: &State<D>,
    steps: u64,
    storage: Storage,
) -> Result<AdjointGradient> {
    flow.reset(state);
    flow.clear_adjoint();
    let mut run = Run { flow, steps_run: 0, bytes: 0, particles: state.positions.len() };
    let loss = match storage {
        Storage::All => run.with_everything(steps)?,
        Storage::Checkpoints(snapshots) => run.with_checkpoints(steps, snapshots.max(1))?,
    };
    let Run { flow, steps_run, bytes, .. } = run;
    flow.keep_evaluations(false);
    Ok(AdjointGradient { loss, gradient: flow.adjoint_gradient(), steps_run, bytes })
}

struct Run<'a, const D: usize> {
    flow: &'a mut Flow<D>,
    steps_run: u64,
    bytes: usize,
    particles: usize,
}

impl<const D: usize> Run<'_, D> {
    fn with_everything(&mut self, steps: u64) -> Result<LossSum> {
        self.flow.keep_evaluations(true);
        self.flow.start()?;
        self.flow.advance_by(steps)?;
        self.steps_run = steps;
        self.bytes = self.flow.tape_bytes();
        (0..steps).for_each(|_| self.flow.retreat());
        self.flow.back_to_start();
        Ok(self.flow.loss())
    }

    fn with_checkpoints(&mut self, steps: u64, snapshots: usize) -> Result<LossSum> {
        // The first evaluation stays on the tape: its adjoint comes last.
        self.flow.keep_evaluations(true);
        self.flow.start()?;
        self.flow.keep_evaluations(false);
        let first = self.flow.snapshot();
        self.flow.advance_by(steps)?;
        self.steps_run += steps;
        let loss = self.flow.loss();
        self.flow.restore(&first);
        self.reverse(&first, steps, snapshots)?;
        self.flow.back_to_start();
        self.flow.set_loss(loss.clone());
        Ok(loss)
    }

    /// Runs the adjoint of `steps` steps from a snapshot that the flow now stands at, with room for
    /// `snapshots` snapshots, that one included.
    fn reverse(&mut self, from: &Snapshot<D>, steps: u64, snapshots: usize) -> Result<()> {
        let held = (snapshots.max(1)) * Snapshot::<D>::BYTES * self.particles;
        if steps == 0 {
            return Ok(());
        }
        if steps == 1 {
            self.flow.keep_evaluations(true);
            self.flow.step()?;
            self.flow.keep_evaluations(false);
            self.steps_run += 1;
            self.bytes = self.bytes.max(self.flow.tape_bytes() + held);
            self.flow.retreat();
            return Ok(());
        }
        let ahead = if snapshots > 1 { split(steps, snapshots) } else { steps - 1 };
        self.flow.advance_by(ahead)?;
        self.steps_run += ahead;
        let middle = self.flow.snapshot();
        self.reverse(&middle, steps - ahead, snapshots.saturating_sub(1))?;
        self.flow.restore(from);
        self.reverse(from, ahead, snapshots)
    }
}

/// Most steps that `snapshots` snapshots can reverse if no step is repeated more than `repeats` times:
/// `(snapshots + repeats)! / (snapshots! repeats!)`.
fn reach(snapshots: u64, repeats: u64) -> u64 {
    (1..=repeats).fold(1_u64, |reach, k| reach.saturating_mul(snapshots + k) / k)
}

/// How far ahead the next snapshot of an optimal plan stands.
fn split(steps: u64, snapshots: usize) -> u64 {
    let snapshots = snapshots as u64;
    let repeats = (1..).find(|&r| reach(snapshots, r) >= steps).unwrap_or(1);
    // The part behind the new snapshot has one snapshot less and as many repeats.
    let behind = reach(snapshots - 1, repeats).min(steps - 1);
    (steps - behind).max(1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_reach_of_snapshots_is_a_binomial_coefficient() {
        assert_eq!((reach(3, 2), reach(1, 5), reach(5, 1), reach(4, 0)), (10, 6, 6, 1));
    }

    #[test]
    fn a_split_leaves_both_parts_within_reach() {
        for steps in 2..200 {
            for snapshots in 2..8 {
                let ahead = split(steps, snapshots);
                assert!(ahead >= 1 && ahead < steps);
            }
        }
    }
}
