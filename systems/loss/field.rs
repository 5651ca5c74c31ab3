//! The field loss as a term: the smoothed velocity on a mesh against the truth's.

use super::{FrameLoss, LossPart, Seen};
use crate::kernel::AnyKernel;
use crate::losses::{Points, SquareSum, StateAdjoint, field_adjoint, field_loss, field_value};
use crate::packed::PackedSensitivity;

/// [`field_loss`].
#[derive(Clone, Copy, Debug)]
pub struct FieldLoss;

fn points<'a, const D: usize>(seen: &Seen<'a, D>) -> Points<'a, AnyKernel, D> {
    Points {
        packed: seen.cloud.particles(),
        cells: &seen.neighbours.cells,
        space: seen.neighbours.space,
        smoothing: &seen.medium.smoothing,
        mass: seen.medium.mass,
    }
}

/// Weight of a frame: the loss is a mean over those of the window.
fn weight<const D: usize>(seen: &Seen<'_, D>) -> f64 {
    seen.observations.field / seen.observations.window as f64
}

impl<const D: usize> FrameLoss<D> for FieldLoss {
    fn name(&self) -> &'static str {
        "field"
    }

    fn empty(&self, blocks: usize) -> LossPart {
        LossPart::Squares(SquareSum::new(blocks))
    }

    fn accumulate(
        &self,
        seen: &Seen<'_, D>,
        blocks: &[&[PackedSensitivity<D>]],
        sum: &mut LossPart,
    ) {
        let LossPart::Squares(sum) = sum else { return };
        let truth = (&seen.frame.field[..], weight(seen));
        sum.merge(&field_loss(&seen.observations.mesh, &points(seen), blocks, truth));
    }

    fn adjoint(&self, seen: &Seen<'_, D>) -> Option<StateAdjoint<D>> {
        let truth = (&seen.frame.field[..], weight(seen));
        Some(field_adjoint(&seen.observations.mesh, &points(seen), truth))
    }

    fn value(&self, seen: &Seen<'_, D>) -> f64 {
        let truth = (&seen.frame.field[..], weight(seen));
        field_value(&seen.observations.mesh, &points(seen), truth)
    }
}
