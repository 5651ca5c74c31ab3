//! The adjoint of a run of steps: the gradient by all parameters from one backward sweep.
//!
//! The backward sweep needs every force evaluation. [`Storage::All`] keeps them all.
//! [`Storage::Checkpoints`] and [`Storage::Bytes`] keep only a few snapshots and repeat the steps
//! between them, split by binomial coefficients (Griewank & Walther 2000, `revolve`), which
//! minimises the repetitions. All three perform the same operations on the same numbers and give
//! the same bits.

use super::SHORTEN;
use crate::error::{Error, Result};
use crate::flow::{Flow, Snapshot, State, in_pool};
use crate::interrupt;
use crate::systems::loss::LossSum;
use crate::systems::neighbours::Neighbours;
use crate::systems::tape::FrameAdjoint;
use crate::systems::verlet::Integrator;
use crate::vector::Vector;
use serde::{Deserialize, Serialize};

/// What is kept during the forward sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Storage {
    /// Every force evaluation (default): the fastest; memory grows with the number of steps.
    #[default]
    All,
    /// At most this number of snapshots, and one step: steps are repeated to save memory.
    Checkpoints(usize),
    /// The number of snapshots that fit into this memory, in bytes, beside one step.
    Bytes(usize),
}

/// A loss with its gradient by all parameters.
#[derive(Clone, Debug)]
pub struct AdjointGradient {
    /// The loss, part by part.
    pub loss: LossSum,
    /// `∂L/∂` of every parameter of the flow, in the order of [`Flow::parameters`].
    pub gradient: Vec<f64>,
    /// Forward steps in total, including repetitions.
    pub steps_run: u64,
    /// Largest memory of tape and snapshots, in bytes.
    pub bytes: usize,
}

/// Runs `flow` (built with [`Flow::with_adjoint`]) from `state` over `steps` steps, and backwards.
///
/// # Errors
/// [`Error::Diverged`] from the forward sweep, and [`Error::Input`] where [`Storage::Bytes`] has no
/// room for one snapshot and one step.
pub fn adjoint_gradient<const D: usize>(
    flow: &mut Flow<D>,
    state: &State<D>,
    steps: u64,
    storage: Storage,
) -> Result<AdjointGradient> {
    sweep(flow, state, (steps, storage), None)
}

/// Which steps' derivatives are kept, and where.
type Kept<'a, const D: usize> = (&'a (dyn Fn(u64) -> bool + Sync), &'a mut Vec<StepAdjoint<D>>);

fn sweep<const D: usize>(
    flow: &mut Flow<D>,
    state: &State<D>,
    (steps, storage): (u64, Storage),
    kept: Option<Kept<'_, D>>,
) -> Result<AdjointGradient> {
    flow.reset(state);
    flow.clear_adjoint();
    let particles = state.positions.len();
    let mut run = Run::new(flow, particles, &[]);
    run.kept = kept;
    // The whole run stays in the pool: steps are short, and waking a thread for each would cost a
    // thirtieth of the time.
    let loss = in_pool(|| match storage {
        Storage::All => run.with_everything(steps),
        Storage::Checkpoints(snapshots) => run.with_checkpoints(steps, |_| Ok(snapshots.max(1))),
        Storage::Bytes(budget) => {
            let snapshot = Snapshot::<D>::BYTES * particles;
            run.with_checkpoints(steps, |tape| snapshots_within(budget, tape, snapshot))
        }
    })?;
    let Run { flow, steps_run, bytes, .. } = run;
    flow.keep_evaluations(false);
    Ok(AdjointGradient { loss, gradient: flow.adjoint_gradient(), steps_run, bytes })
}

/// The derivatives of a loss by the state of one step, `∂L/∂(r, v)`: those of the frames after it.
#[derive(Clone, Debug, PartialEq)]
pub struct StepAdjoint<const D: usize> {
    /// The step.
    pub step: u64,
    /// `∂L/∂r`, particle `k` in row `k`.
    pub positions: Vec<Vector<f64, D>>,
    /// `∂L/∂v`.
    pub velocities: Vec<Vector<f64, D>>,
}

/// As [`adjoint_gradient`], with the derivatives by the state of every step that `keeps` names, the last first. A force
/// that the step carries stays as it is, except at step 0, where it follows from the state.
///
/// # Errors
/// As [`adjoint_gradient`].
pub fn adjoint_by_step<const D: usize>(
    flow: &mut Flow<D>,
    state: &State<D>,
    (steps, keeps): (u64, &(dyn Fn(u64) -> bool + Sync)),
    storage: Storage,
) -> Result<Vec<StepAdjoint<D>>> {
    let mut kept = Vec::new();
    sweep(flow, state, (steps, storage), Some((keeps, &mut kept)))?;
    Ok(kept)
}

/// Number of snapshots that fit into a budget beside the tape of one step; all in bytes.
pub(super) fn snapshots_within(budget: usize, tape: usize, snapshot: usize) -> Result<usize> {
    if budget < tape + snapshot {
        return Err(Error::input(
            "learn.storage",
            format!("at least {} bytes, for one snapshot and one step", tape + snapshot),
            format!("{budget} bytes"),
            "give it more, or learn from fewer particles",
        ));
    }
    Ok((budget - tape) / snapshot)
}

/// A backward sweep, with the forward steps that it repeats.
pub(super) struct Run<'a, const D: usize> {
    flow: &'a mut Flow<D>,
    steps_run: u64,
    /// Largest memory of tape and snapshots, in bytes.
    pub(super) bytes: usize,
    particles: usize,
    /// Number of snapshots held.
    held: usize,
    /// Cotangents of frames that are given from outside, in order of step.
    given: &'a [FrameAdjoint<D>],
    /// Whether a derivative that is not finite ends the sweep with the step at which it first occurred.
    pub(super) watches: bool,
    kept: Option<Kept<'a, D>>,
}

impl<'a, const D: usize> Run<'a, D> {
    /// A sweep over a flow of `particles` particles, to which cotangents are given at frames.
    pub(super) fn new(
        flow: &'a mut Flow<D>,
        particles: usize,
        given: &'a [FrameAdjoint<D>],
    ) -> Self {
        Self { flow, steps_run: 0, bytes: 0, particles, held: 0, given, watches: false, kept: None }
    }

    /// The adjoint of the step just completed, with the cotangent of its frame.
    fn retreat(&mut self) -> Result<()> {
        interrupt::check()?;
        let step = self.flow.steps();
        self.give(step);
        self.flow.retreat();
        // The derivatives by the first state are not whole before the adjoint of the start.
        if step > 1 {
            self.keep(step - 1);
        }
        match self.watches {
            true => self.must_be_finite(step),
            false => Ok(()),
        }
    }

    /// Keeps the derivatives by the state of a step, if they are asked for.
    fn keep(&mut self, step: u64) {
        let Some((keeps, kept)) = &mut self.kept else { return };
        if keeps(step) {
            let (positions, velocities) = self.flow.state_adjoint();
            kept.push(StepAdjoint { step, positions, velocities });
        }
    }

    fn give(&mut self, step: u64) {
        if let Ok(found) = self.given.binary_search_by_key(&step, |frame| frame.step) {
            self.flow.give_cotangent(&self.given[found]);
        }
    }

    fn must_be_finite(&mut self, step: u64) -> Result<()> {
        let (positions, velocities) = self.flow.state_adjoint();
        let lost = |(r, v): (&Vector<f64, D>, &Vector<f64, D>)| !(r.is_finite() && v.is_finite());
        let Some(particle) = positions.iter().zip(&velocities).position(lost) else {
            return Ok(());
        };
        Err(Error::Diverged {
            step,
            time: self.flow.time(),
            quantity: format!(
                "the adjoint of particle {particle}, on the way back through this step,"
            ),
            found: "is not finite".to_owned(),
            remedy: SHORTEN.to_owned(),
        })
    }

    /// Runs the adjoint of `steps` steps that are on the tape, and of the start.
    pub(super) fn all_on_tape(&mut self, steps: u64) -> Result<()> {
        (0..steps).try_for_each(|_| self.retreat())?;
        self.give(0);
        self.flow.back_to_start();
        self.keep(0);
        Ok(())
    }

    /// Runs the adjoint of `steps` steps from the snapshot `first`, with room for `snapshots`, and of the start, the
    /// evaluation of which is on the tape.
    pub(super) fn by_snapshots(
        &mut self,
        first: &Snapshot<D>,
        (steps, snapshots): (u64, usize),
    ) -> Result<()> {
        self.held = 1;
        self.flow.restore(first);
        self.reverse(first, steps, snapshots)?;
        self.give(0);
        self.flow.back_to_start();
        self.keep(0);
        Ok(())
    }

    fn with_everything(&mut self, steps: u64) -> Result<LossSum> {
        self.flow.keep_evaluations(true);
        self.flow.start()?;
        self.flow.advance_by(steps)?;
        self.steps_run = steps;
        self.bytes = self.flow.tape_bytes();
        self.all_on_tape(steps)?;
        Ok(self.flow.loss())
    }

    /// Keeps as many snapshots as `room` returns for the size of the tape, in bytes.
    fn with_checkpoints(
        &mut self,
        steps: u64,
        room: impl FnOnce(usize) -> Result<usize>,
    ) -> Result<LossSum> {
        // The first evaluation stays on the tape, because its adjoint comes last.
        self.flow.keep_evaluations(true);
        self.flow.start()?;
        self.flow.keep_evaluations(false);
        let (tape, lists) = (self.flow.tape_bytes(), self.lists());
        let first = self.flow.snapshot();
        self.flow.advance_by(steps)?;
        self.steps_run += steps;
        let loss = self.flow.loss();
        let snapshots = room(tape + self.step_bytes(&lists))?;
        self.by_snapshots(&first, (steps, snapshots))?;
        self.flow.set_loss(loss.clone());
        Ok(loss)
    }

    /// Bytes of the current neighbour lists and of their masks, chunk by chunk.
    pub(super) fn lists(&self) -> Vec<usize> {
        let neighbours = self.flow.world().resource::<Neighbours<D>>();
        neighbours.chunks.iter().map(|chunk| chunk.bytes() + chunk.most_masks()).collect()
    }

    /// Largest memory that one step adds to the tape, after a forward sweep that began with
    /// `lists`. A chunk's list never shrinks during the sweep, so that its size at the end is the
    /// largest.
    pub(super) fn step_bytes(&self, lists: &[usize]) -> usize {
        let most = self.lists().into_iter().zip(lists).map(|(end, &start)| end.max(start));
        let lists: usize = most.sum();
        let evaluation = 64 * (self.particles + 1) + 4 * self.particles + lists;
        let refreshes = self.flow.world().resource::<Integrator>().step.refreshes();
        let frame = FrameAdjoint::<D>::BYTES * self.particles;
        evaluation * if refreshes { 2 } else { 1 } + frame
    }

    /// Runs the adjoint of `steps` steps, starting from the flow's current state, which is the
    /// snapshot `from`. There is room for `snapshots` snapshots, including this one.
    fn reverse(&mut self, from: &Snapshot<D>, steps: u64, snapshots: usize) -> Result<()> {
        match steps {
            0 => return Ok(()),
            1 => return self.reverse_one(),
            _ => {}
        }
        let ahead = if snapshots > 1 { split(steps, snapshots) } else { steps - 1 };
        self.flow.advance_by(ahead)?;
        self.steps_run += ahead;
        if steps - ahead == 1 {
            self.reverse_one()?;
        } else {
            let middle = self.flow.snapshot();
            self.held += 1;
            self.reverse(&middle, steps - ahead, snapshots - 1)?;
            self.held -= 1;
        }
        self.flow.restore(from);
        self.reverse(from, ahead, snapshots)
    }

    /// Runs the adjoint of the next step.
    fn reverse_one(&mut self) -> Result<()> {
        self.flow.keep_evaluations(true);
        self.flow.step()?;
        self.flow.keep_evaluations(false);
        self.steps_run += 1;
        let snapshots = self.held * Snapshot::<D>::BYTES * self.particles;
        self.bytes = self.bytes.max(self.flow.tape_bytes() + snapshots);
        self.retreat()
    }
}

/// Number of steps, maximum, that `snapshots` snapshots can reverse if no step is repeated more
/// than `repeats` times: `(snapshots + repeats)! / (snapshots! repeats!)`.
fn reach(snapshots: u64, repeats: u64) -> u64 {
    (1..=repeats).fold(1_u64, |reach, k| reach.saturating_mul(snapshots + k) / k)
}

/// Number of steps to the next snapshot of an optimal schedule.
fn split(steps: u64, snapshots: usize) -> u64 {
    let snapshots = snapshots as u64;
    let repeats = (1..).find(|&r| reach(snapshots, r) >= steps).unwrap_or(1);
    // The part after the new snapshot has one snapshot less and the same number of repeats.
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
