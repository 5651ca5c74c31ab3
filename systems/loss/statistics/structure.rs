//! Longitudinal structure function of the smoothed field, `S₂(r) = ⟨(δu∥)²⟩`, at distances of one node, two, … up to half
//! the shortest side: see [`crate::statistics::structure_functions`].

use super::{Seen, StateAdjoint, Statistic, TrueState, fields};
use crate::losses::Mesh;
use crate::statistics::structure_functions;
use crate::vector::Vector;

/// `S₂` by distance.
#[derive(Clone, Copy, Debug)]
pub struct StructureFunction;

fn second<const D: usize>(mesh: &Mesh<D>, field: &[Vector<f64, D>]) -> Vec<f64> {
    structure_functions(mesh, field).into_iter().map(|found| found.second).collect()
}

impl<const D: usize> Statistic<D> for StructureFunction {
    fn name(&self) -> &'static str {
        "structure"
    }

    fn needs_field(&self) -> bool {
        true
    }

    fn of_truth(&self, truth: &TrueState<'_, D>) -> Vec<f64> {
        second(truth.mesh, truth.field)
    }

    fn values(&self, seen: &Seen<'_, D>) -> Vec<f64> {
        second(&seen.observations.mesh, &fields::predicted(seen))
    }

    /// `∂S₂/∂u_a(x)` is `2/n` times the difference across `r`, added at one end and subtracted at the other.
    fn pull_back(&self, seen: &Seen<'_, D>, cotangents: &[f64]) -> StateAdjoint<D> {
        let (mesh, field) = (&seen.observations.mesh, fields::predicted(seen));
        let mut nodes = vec![Vector::zero(); field.len()];
        for (k, cotangent) in cotangents.iter().enumerate() {
            if *cotangent != 0.0 {
                add_slope(mesh, &field, (k + 1, *cotangent), &mut nodes);
            }
        }
        fields::pull_back(seen, &nodes)
    }
}

fn add_slope<const D: usize>(
    mesh: &Mesh<D>,
    field: &[Vector<f64, D>],
    (apart, cotangent): (usize, f64),
    nodes: &mut [Vector<f64, D>],
) {
    let pairs = |axis: usize| {
        let (n, stride) = (mesh.per_axis[axis], mesh.stride(axis));
        let is_periodic = mesh.space.is_periodic(axis);
        (0..field.len()).filter_map(move |here| {
            let along = here / stride % n;
            let there = here - along * stride + (along + apart) % n * stride;
            (is_periodic || along + apart < n).then_some((here, there))
        })
    };
    let count: usize = (0..D).map(|axis| pairs(axis).count()).sum();
    let share = 2.0 * cotangent / count as f64;
    for axis in 0..D {
        for (here, there) in pairs(axis) {
            let slope = share * (field[there][axis] - field[here][axis]);
            nodes[there][axis] += slope;
            nodes[here][axis] -= slope;
        }
    }
}
