//! The field loss `L_f`: the smoothed velocity field on a mesh, against the truth's.

use super::{SquareSum, StateAdjoint};
use crate::cells::Cells;
use crate::kernel::{Kernel, Smoothing};
use crate::packed::{Packed, PackedSensitivity};
use crate::scalar::Lanes;
use crate::space::PeriodicBox;
use crate::vector::Vector;
use rayon::prelude::*;

/// Nodes per parallel task: fixed, so that sums have the same bits for any number of threads.
const CHUNK: usize = 256;

/// A periodic mesh of `per_axisᴰ` nodes, the first at the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mesh<const D: usize> {
    /// Nodes along each axis.
    pub per_axis: usize,
    /// Side of the box.
    pub length: f64,
}

impl<const D: usize> Mesh<D> {
    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.per_axis.pow(D as u32)
    }

    /// Whether there is no node.
    pub fn is_empty(&self) -> bool {
        self.per_axis == 0
    }

    /// Calls `visit` with every node whose coordinates are each within `reach` of a place, once.
    fn around(&self, place: Vector<f64, D>, reach: f64, mut visit: impl FnMut(usize)) {
        let n = self.per_axis;
        let spacing = self.length / n as f64;
        let first = place.map(|x| ((x - reach) / spacing).ceil());
        let count: [usize; D] = std::array::from_fn(|axis| {
            let last = ((place[axis] + reach) / spacing).floor();
            ((last - first[axis]).max(-1.0) + 1.0).min(n as f64) as usize
        });
        let first = first.map(|x| x.rem_euclid(n as f64) as usize % n);
        for mut index in 0..count.iter().product() {
            let (mut node, mut stride) = (0, 1);
            for axis in 0..D {
                node += stride * ((first[axis] + index % count[axis]) % n);
                index /= count[axis];
                stride *= n;
            }
            visit(node);
        }
    }

    /// Position of a node; the first axis runs fastest.
    pub fn node(&self, mut index: usize) -> Vector<f64, D> {
        Vector(std::array::from_fn(|_| {
            let along = index % self.per_axis;
            index /= self.per_axis;
            along as f64 * self.length / self.per_axis as f64
        }))
    }
}

/// Particles as a field sees them.
#[derive(Clone, Copy, Debug)]
pub struct Points<'a, K, const D: usize> {
    /// Positions, velocities and densities, in the order of `cells`.
    pub packed: &'a [Packed],
    /// Cells wide enough for the support, and for what particles moved since they were sorted.
    pub cells: &'a Cells<D>,
    /// The box.
    pub space: PeriodicBox,
    /// The kernel.
    pub smoothing: &'a Smoothing<K, D>,
    /// Mass of a particle.
    pub mass: f64,
}

impl<K: Kernel, const D: usize> Points<'_, K, D> {
    /// Calls `visit(slot, x − r, |x − r|)` for every particle in reach of the place `x`.
    #[inline(always)]
    fn around(&self, x: Vector<f64, D>, mut visit: impl FnMut(usize, Vector<f64, D>, f64)) {
        let reach2 = self.smoothing.support() * self.smoothing.support();
        for &(from, to) in self.cells.around(self.cells.coordinates(x)).ranges() {
            for slot in from as usize..to as usize {
                let r = Vector::<f64, D>::from_3d(self.packed[slot].position);
                let apart = self.space.minimum_image(x - r);
                let r2 = apart.norm_squared();
                if r2 < reach2 {
                    visit(slot, apart, r2.sqrt());
                }
            }
        }
    }

    /// `V(x) = Σⱼ (m/ρⱼ) vⱼ W(|x − rⱼ|; h)`, Eq. (13).
    fn velocity(&self, x: Vector<f64, D>) -> Vector<f64, D> {
        let mut sum = Vector::zero();
        self.around(x, |slot, _, r| {
            let p = &self.packed[slot];
            let weight = self.mass / p.density * self.smoothing.value(r);
            sum += Vector::from_3d(p.velocity) * weight;
        });
        sum
    }

    /// `V(x)`, and into `columns[b·D + axis]` its derivative by the parameters of block `b`:
    /// `δV = Σⱼ (m/ρⱼ) [δvⱼ W − vⱼ (G (x − rⱼ)·δrⱼ + W δρⱼ/ρⱼ)]`.
    fn velocity_tangent(
        &self,
        x: Vector<f64, D>,
        blocks: &[&[PackedSensitivity<D>]],
        columns: &mut [Lanes],
    ) -> Vector<f64, D> {
        let mut sum = Vector::zero();
        columns.fill(Lanes::ZERO);
        self.around(x, |slot, apart, r| {
            let p = &self.packed[slot];
            let volume = self.mass / p.density;
            let weight = volume * self.smoothing.value(r);
            let pull = volume * self.smoothing.gradient(r);
            sum += Vector::from_3d(p.velocity) * weight;
            for (b, block) in blocks.iter().enumerate() {
                let change = &block[slot];
                let mut fade = change.density * (weight / p.density);
                for axis in 0..D {
                    fade += change.position[axis] * (pull * apart[axis]);
                }
                for axis in 0..D {
                    columns[b * D + axis] +=
                        change.velocity[axis] * weight - fade * p.velocity[axis];
                }
            }
        });
        sum
    }
}

/// The smoothed velocity field on a mesh, node by node.
pub fn field<K: Kernel, const D: usize>(
    mesh: &Mesh<D>,
    points: &Points<'_, K, D>,
) -> Vec<Vector<f64, D>> {
    let nodes = (0..mesh.len()).into_par_iter().with_min_len(CHUNK);
    nodes.map(|node| points.velocity(mesh.node(node))).collect()
}

/// One frame's share of `L_f`, the mean over nodes, components and frames of `(V − V̂)²`.
///
/// `truth` is `V̂` on the same mesh, `weight` the loss's weight over the number of frames. The
/// gradient runs through position, velocity and density of every particle in reach.
pub fn field_loss<K: Kernel, const D: usize>(
    mesh: &Mesh<D>,
    points: &Points<'_, K, D>,
    blocks: &[&[PackedSensitivity<D>]],
    (truth, weight): (&[Vector<f64, D>], f64),
) -> SquareSum {
    let weight = weight / (mesh.len() * D) as f64;
    let part = |(chunk, truth): (usize, &[Vector<f64, D>])| {
        let mut sum = SquareSum::new(blocks.len());
        let mut columns = vec![Lanes::ZERO; blocks.len() * D];
        for (k, expected) in truth.iter().enumerate() {
            let x = mesh.node(chunk * CHUNK + k);
            let difference = points.velocity_tangent(x, blocks, &mut columns) - *expected;
            for axis in 0..D {
                sum.add(weight, difference[axis], |b| columns[b * D + axis]);
            }
        }
        sum
    };
    let parts: Vec<SquareSum> = truth.par_chunks(CHUNK).enumerate().map(part).collect();
    let mut sum = SquareSum::new(blocks.len());
    parts.iter().for_each(|part| sum.merge(part));
    sum
}

/// The value of [`field_loss`], and its derivative by each particle's position (at fixed density),
/// velocity and density: each particle gathers from the nodes in its reach.
pub fn field_adjoint<K: Kernel, const D: usize>(
    mesh: &Mesh<D>,
    points: &Points<'_, K, D>,
    (truth, weight): (&[Vector<f64, D>], f64),
) -> StateAdjoint<D> {
    let weight = weight / (mesh.len() * D) as f64;
    let mut nodes = field(mesh, points);
    let mut adjoint = StateAdjoint::zero(points.packed.len());
    for (node, expected) in nodes.iter_mut().zip(truth) {
        let difference = *node - *expected;
        adjoint.value += weight * difference.norm_squared();
        *node = difference * (2.0 * weight);
    }
    let columns = adjoint.position.par_iter_mut().zip(&mut adjoint.velocity);
    let columns = columns.zip(&mut adjoint.density).zip(points.packed).with_min_len(CHUNK);
    columns.for_each(|(((position, velocity), density), particle)| {
        (*position, *velocity, *density) = points.gather(mesh, &nodes, particle);
    });
    adjoint
}

impl<K: Kernel, const D: usize> Points<'_, K, D> {
    /// What one particle takes from `∂L/∂V` on the nodes: `∂L/∂r`, `∂L/∂v`, `∂L/∂ρ`.
    fn gather(
        &self,
        mesh: &Mesh<D>,
        nodes: &[Vector<f64, D>],
        particle: &Packed,
    ) -> (Vector<f64, D>, Vector<f64, D>, f64) {
        let (mut position, mut velocity, mut density) = (Vector::zero(), Vector::zero(), 0.0);
        let r = Vector::<f64, D>::from_3d(particle.position);
        let v = Vector::<f64, D>::from_3d(particle.velocity);
        let volume = self.mass / particle.density;
        mesh.around(r, self.smoothing.support(), |node| {
            let apart = self.space.minimum_image(mesh.node(node) - r);
            let distance = apart.norm();
            if distance < self.smoothing.support() {
                let weight = volume * self.smoothing.value(distance);
                let along = v.dot(nodes[node]);
                velocity += nodes[node] * weight;
                position -= apart * (volume * self.smoothing.gradient(distance) * along);
                density -= weight * along / particle.density;
            }
        });
        (position, velocity, density)
    }
}
