//! What statistics of the velocity field on the mesh have in common.

use super::super::field::{by_kernel, points};
use super::{Seen, StateAdjoint};
use crate::losses::{field, pull_back_nodes};
use crate::vector::Vector;

/// The smoothed velocity of the prediction at the nodes of the mesh.
pub(super) fn predicted<const D: usize>(seen: &Seen<'_, D>) -> Vec<Vector<f64, D>> {
    field(&seen.observations.mesh, &points(seen, &seen.medium.smoothing))
}

/// The derivative by the state of every particle, and by the parameters of the kernel, from `λ = ∂f/∂V` at the nodes.
pub(super) fn pull_back<const D: usize>(
    seen: &Seen<'_, D>,
    nodes: &[Vector<f64, D>],
) -> StateAdjoint<D> {
    let mesh = &seen.observations.mesh;
    let mut adjoint = pull_back_nodes(mesh, &points(seen, &seen.medium.smoothing), nodes);
    for (place, by) in by_kernel(seen) {
        let slope = nodes.iter().zip(&by).map(|(&node, &by)| node.dot(by)).sum();
        adjoint.parameters.push((place, slope));
    }
    adjoint
}
