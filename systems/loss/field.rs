//! The field loss as a term: the smoothed velocity on a mesh compared with the truth's.

use super::{FrameLoss, LossPart, Seen, packed};
use crate::kernel::{AnyKernel, Kernel, Smoothing};
use crate::losses::{
    DirectParameter, Points, StateAdjoint, field, field_adjoint, field_loss, field_value,
};
use crate::models::FluidConstants;
use crate::scalar::F64x8;
use crate::systems::particles::SensitivityBlock;
use crate::vector::Vector;

/// [`field_loss`], with the direct dependence of the field on the kernel's parameters.
#[derive(Clone, Copy, Debug)]
pub struct FieldLoss;

pub(super) fn points<'a, const D: usize>(
    seen: &Seen<'a, D>,
    smoothing: &'a Smoothing<AnyKernel, D>,
) -> Points<'a, AnyKernel, D> {
    Points {
        packed: seen.inputs.particles(),
        cells: &seen.neighbours.cells,
        space: seen.neighbours.space,
        smoothing,
        mass: seen.medium.mass,
    }
}

/// Weight of a frame: the loss is a mean over the frames of the window.
fn weight<const D: usize>(seen: &Seen<'_, D>) -> f64 {
    seen.observations.field / seen.observations.window as f64
}

/// `∂V/∂p` on the mesh for each parameter `p` of the kernel, with its place in the flat vector.
pub(super) fn by_kernel<const D: usize>(seen: &Seen<'_, D>) -> Vec<(usize, Vec<Vector<f64, D>>)> {
    let Smoothing { h, .. } = seen.medium.smoothing;
    let kernel = seen.medium.smoothing.kernel();
    let derivative = |parameter: usize| {
        let smoothing = Smoothing::of(kernel.derivative(parameter)?, h);
        let place = *seen.places.get(FluidConstants::COUNT + parameter)?;
        Some((place, field(&seen.observations.mesh, &points(seen, &smoothing))))
    };
    (0..kernel.parameters()).filter_map(derivative).collect()
}

impl<const D: usize> FrameLoss<D> for FieldLoss {
    fn name(&self) -> &'static str {
        "field"
    }

    fn empty(&self, blocks: usize) -> LossPart {
        LossPart::squares(["field"], blocks)
    }

    fn accumulate(&self, seen: &Seen<'_, D>, blocks: &[SensitivityBlock<D>], sum: &mut LossPart) {
        let truth = (&seen.frame.field[..], weight(seen));
        let fields = if blocks.is_empty() { Vec::new() } else { by_kernel(seen) };
        let directions: Vec<Vec<F64x8>> = fields
            .iter()
            .map(|(place, _)| blocks.iter().map(|block| block.direction(*place)).collect())
            .collect();
        let direct = fields.iter().zip(&directions);
        let direct: Vec<_> =
            direct.map(|((_, field), directions)| DirectParameter { field, directions }).collect();
        let points = points(seen, &seen.medium.smoothing);
        let blocks = packed(blocks);
        sum.merge(&[field_loss(&seen.observations.mesh, &points, (&blocks, &direct), truth)]);
    }

    fn adjoint(&self, seen: &Seen<'_, D>) -> Option<StateAdjoint<D>> {
        let (mesh, points) = (&seen.observations.mesh, points(seen, &seen.medium.smoothing));
        let truth = (&seen.frame.field[..], weight(seen));
        let mut adjoint = field_adjoint(mesh, &points, truth);
        let fields = by_kernel(seen);
        if !fields.is_empty() {
            let (now, each) = (field(mesh, &points), 2.0 * truth.1 / (mesh.len() * D) as f64);
            for (place, by) in fields {
                let nodes = now.iter().zip(truth.0).zip(&by);
                let sum: f64 = nodes.map(|((&v, &expected), &by)| (v - expected).dot(by)).sum();
                adjoint.parameters.push((place, each * sum));
            }
        }
        Some(adjoint)
    }

    fn value(&self, seen: &Seen<'_, D>) -> f64 {
        let truth = (&seen.frame.field[..], weight(seen));
        field_value(&seen.observations.mesh, &points(seen, &seen.medium.smoothing), truth)
    }
}
