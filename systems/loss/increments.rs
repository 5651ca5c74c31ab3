//! The statistical loss as a term: velocity increments compared with the truth's.

use super::{FrameLoss, LossPart, Seen, packed};
use crate::losses::{
    GradientSum, IncrementDensities, StateAdjoint, statistical_adjoint, statistical_loss,
};
use crate::scene::Times;
use crate::systems::particles::SensitivityBlock;

/// [`statistical_loss`].
#[derive(Clone, Copy, Debug)]
pub struct StatisticalLoss;

/// The true densities of increments and their weight, where this frame counts.
fn truth<'a, const D: usize>(seen: &Seen<'a, D>) -> Option<(&'a IncrementDensities<D>, f64)> {
    let counts = seen.is_last || seen.observations.times == Times::All;
    let increments = seen.frame.increments.as_ref().filter(|_| counts)?;
    Some((increments, seen.observations.kl))
}

impl<const D: usize> FrameLoss<D> for StatisticalLoss {
    fn name(&self) -> &'static str {
        "kl"
    }

    fn empty(&self, blocks: usize) -> LossPart {
        LossPart::Gradient(GradientSum::new(blocks))
    }

    fn accumulate(&self, seen: &Seen<'_, D>, blocks: &[SensitivityBlock<D>], sum: &mut LossPart) {
        let (LossPart::Gradient(sum), Some(truth)) = (sum, truth(seen)) else { return };
        let particles = (seen.inputs.particles(), seen.neighbours.order().slots());
        sum.add_sum(&statistical_loss(
            particles,
            &packed(blocks),
            &seen.observations.first.velocities,
            truth,
        ));
    }

    fn adjoint(&self, seen: &Seen<'_, D>) -> Option<StateAdjoint<D>> {
        let particles = (seen.inputs.particles(), seen.neighbours.order().slots());
        Some(statistical_adjoint(particles, &seen.observations.first.velocities, truth(seen)?))
    }
}
