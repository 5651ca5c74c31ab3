//! The trajectory loss as a term: every particle compared with the same particle of the truth.

use super::{FrameLoss, LossPart, Seen, packed};
use crate::losses::{StateAdjoint, trajectory_adjoint, trajectory_loss};
use crate::systems::particles::SensitivityBlock;
use crate::vector::Vector;

/// [`trajectory_loss`].
#[derive(Clone, Copy, Debug)]
pub struct TrajectoryLoss;

/// `(r̂, v̂)` of the particle in a slot.
fn truth<const D: usize>(seen: &Seen<'_, D>) -> impl Fn(usize) -> (Vector<f64, D>, Vector<f64, D>) {
    let (frame, rows) = (seen.frame, seen.neighbours.order().rows());
    |slot| {
        let row = rows[slot] as usize;
        (frame.positions[row], frame.velocities[row])
    }
}

impl<const D: usize> FrameLoss<D> for TrajectoryLoss {
    fn name(&self) -> &'static str {
        "trajectory"
    }

    fn empty(&self, blocks: usize) -> LossPart {
        LossPart::squares(["positions", "velocities"], blocks)
    }

    fn accumulate(&self, seen: &Seen<'_, D>, blocks: &[SensitivityBlock<D>], sum: &mut LossPart) {
        let weight = (seen.neighbours.space, seen.observations.trajectory);
        let found = trajectory_loss(seen.inputs.particles(), &packed(blocks), truth(seen), weight);
        sum.merge(&found);
    }

    fn adjoint(&self, seen: &Seen<'_, D>) -> Option<StateAdjoint<D>> {
        let weight = (seen.neighbours.space, seen.observations.trajectory);
        Some(trajectory_adjoint(seen.inputs.particles(), truth(seen), weight))
    }
}
