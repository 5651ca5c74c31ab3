//! The field loss `L_f`: the smoothed velocity field on a mesh, against the truth's.

use super::mesh::{Mesh, Nearby};
use super::{SquareSum, StateAdjoint};
use crate::cells::Cells;
use crate::kernel::{Kernel, Smoothing};
use crate::packed::{Packed, PackedSensitivity};
use crate::pairs::{Chunk, gather};
use crate::scalar::{Lanes, Scalar, WIDTH};
use crate::space::PeriodicBox;
use crate::vector::Vector;
use pulp::{Arch, NullaryFnOnce};
use rayon::prelude::*;

/// Nodes per parallel task: fixed, so that sums have the same bits for any number of threads.
const CHUNK: usize = 256;

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

/// Points with their coordinates as columns, to be searched eight at a time.
struct Search<'a, K, const D: usize> {
    points: &'a Points<'a, K, D>,
    /// Coordinates in cell order, with [`WIDTH`] of nobody's behind them.
    columns: [Vec<f64>; D],
    /// Volumes `m/ρ`, likewise.
    volumes: Vec<f64>,
}

impl<'a, K: Kernel, const D: usize> Search<'a, K, D> {
    fn new(points: &'a Points<'a, K, D>) -> Self {
        let column = |axis: usize| {
            let nobody = [Packed::NOBODY.position[axis]; WIDTH];
            points.packed.iter().map(|p| p.position[axis]).chain(nobody).collect()
        };
        let volumes = points.packed.iter().map(|p| points.mass / p.density);
        let volumes = volumes.chain([0.0; WIDTH]).collect();
        Self { points, columns: std::array::from_fn(column), volumes }
    }

    /// The slots of every particle in reach of the place `x`, with nobody's up to whole lanes.
    #[inline(always)]
    fn find<'b>(&self, x: Vector<f64, D>, near: &'b mut Chunk) -> &'b [[u32; WIDTH]] {
        let Points { cells, space, smoothing, .. } = self.points;
        let reach2 = smoothing.support() * smoothing.support();
        near.clear();
        for &(from, to) in cells.around(cells.coordinates(x)).ranges() {
            for first in (from as usize..to as usize).step_by(WIDTH) {
                let mut apart = Vector::<Lanes, D>::zero();
                for axis in 0..D {
                    let mut there = [0.0; WIDTH];
                    there.copy_from_slice(&self.columns[axis][first..first + WIDTH]);
                    apart[axis] = Lanes::of(x[axis]) - Lanes::new(there);
                }
                let r2 = space.minimum_image(apart).norm_squared();
                // No particle is left out.
                near.append(r2, (usize::MAX, first, to as usize), reach2);
            }
        }
        near.close(self.points.packed.len());
        near.neighbours(0)
    }

    /// `(x − r, |x − r|)` of eight particles from the place `x`.
    #[inline(always)]
    fn apart(&self, x: Vector<f64, D>, slots: &[u32; WIDTH]) -> (Vector<Lanes, D>, Lanes) {
        let mut apart = Vector::<Lanes, D>::zero();
        for axis in 0..D {
            apart[axis] = Lanes::of(x[axis]) - gather(&self.columns[axis], slots, |x| *x);
        }
        let apart = self.points.space.minimum_image(apart);
        (apart, apart.norm_squared().sqrt())
    }

    /// `V(x) = Σⱼ (m/ρⱼ) vⱼ W(|x − rⱼ|; h)`, Eq. (13).
    #[inline(always)]
    fn velocity(&self, x: Vector<f64, D>, near: &mut Chunk) -> Vector<f64, D> {
        let Points { packed, smoothing, .. } = self.points;
        let mut sum = Vector::zero();
        for slots in self.find(x, near) {
            let (_, r) = self.apart(x, slots);
            let weights = gather(&self.volumes, slots, |volume| *volume) * smoothing.value(r);
            for (lane, &slot) in slots.iter().enumerate() {
                // Nobody comes last.
                let Some(p) = packed.get(slot as usize) else { break };
                sum += Vector::from_3d(p.velocity) * weights.lane(lane);
            }
        }
        sum
    }

    /// `V(x)`, and into `columns[b·D + axis]` its derivative by the parameters of block `b`:
    /// `δV = Σⱼ (m/ρⱼ) [δvⱼ W − vⱼ (G (x − rⱼ)·δrⱼ + W δρⱼ/ρⱼ)]`.
    #[inline(always)]
    fn velocity_tangent(
        &self,
        x: Vector<f64, D>,
        blocks: &[&[PackedSensitivity<D>]],
        (columns, near): (&mut [Lanes], &mut Chunk),
    ) -> Vector<f64, D> {
        let Points { packed, smoothing, .. } = self.points;
        let mut sum = Vector::zero();
        columns.fill(Lanes::ZERO);
        // A loop: the closure of a visitor is not inlined into vectorised functions.
        for slots in self.find(x, near) {
            let (apart, r) = self.apart(x, slots);
            let volume = gather(&self.volumes, slots, |volume| *volume);
            let (weights, pulls) = (volume * smoothing.value(r), volume * smoothing.gradient(r));
            for (lane, &slot) in slots.iter().enumerate() {
                let Some(p) = packed.get(slot as usize) else { break };
                let (weight, pull) = (weights.lane(lane), pulls.lane(lane));
                sum += Vector::from_3d(p.velocity) * weight;
                for (b, block) in blocks.iter().enumerate() {
                    let change = &block[slot as usize];
                    let mut fade = change.density * (weight / p.density);
                    for axis in 0..D {
                        fade += change.position[axis] * (pull * apart[axis].lane(lane));
                    }
                    for axis in 0..D {
                        columns[b * D + axis] +=
                            change.velocity[axis] * weight - fade * p.velocity[axis];
                    }
                }
            }
        }
        sum
    }
}

/// The field at consecutive nodes.
struct FieldPass<'a, K, const D: usize> {
    search: &'a Search<'a, K, D>,
    mesh: &'a Mesh<D>,
    first: usize,
    values: &'a mut [Vector<f64, D>],
}

impl<K: Kernel, const D: usize> NullaryFnOnce for FieldPass<'_, K, D> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let mut near = Chunk::default();
        for (k, value) in self.values.iter_mut().enumerate() {
            *value = self.search.velocity(self.mesh.node(self.first + k), &mut near);
        }
    }
}

/// The smoothed velocity field on a mesh, node by node.
pub fn field<K: Kernel, const D: usize>(
    mesh: &Mesh<D>,
    points: &Points<'_, K, D>,
) -> Vec<Vector<f64, D>> {
    let search = &Search::new(points);
    let mut nodes = vec![Vector::zero(); mesh.len()];
    nodes.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, values)| {
        Arch::new().dispatch(FieldPass { search, mesh, first: chunk * CHUNK, values });
    });
    nodes
}

/// The loss at consecutive nodes, with its derivatives by the parameters.
struct LossPass<'a, K, const D: usize> {
    search: &'a Search<'a, K, D>,
    mesh: &'a Mesh<D>,
    blocks: &'a [&'a [PackedSensitivity<D>]],
    first: usize,
    truth: &'a [Vector<f64, D>],
    weight: f64,
}

impl<K: Kernel, const D: usize> NullaryFnOnce for LossPass<'_, K, D> {
    type Output = SquareSum;

    #[inline(always)]
    fn call(self) -> SquareSum {
        let Self { search, mesh, blocks, first, truth, weight } = self;
        let mut sum = SquareSum::new(blocks.len());
        let mut columns = vec![Lanes::ZERO; blocks.len() * D];
        let mut near = Chunk::default();
        for (k, expected) in truth.iter().enumerate() {
            let (x, room) = (mesh.node(first + k), (&mut columns[..], &mut near));
            let difference = search.velocity_tangent(x, blocks, room) - *expected;
            for axis in 0..D {
                sum.add(weight, difference[axis], |b| columns[b * D + axis]);
            }
        }
        sum
    }
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
    let search = &Search::new(points);
    let part = |(chunk, truth): (usize, &[Vector<f64, D>])| {
        let first = chunk * CHUNK;
        Arch::new().dispatch(LossPass { search, mesh, blocks, first, truth, weight })
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
    let columns =
        adjoint.position.par_chunks_mut(CHUNK).zip(adjoint.velocity.par_chunks_mut(CHUNK));
    let columns = columns.zip(adjoint.density.par_chunks_mut(CHUNK));
    let chunks = columns.zip(points.packed.par_chunks(CHUNK));
    chunks.for_each(|(((position, velocity), density), particles)| {
        let into = (position, velocity, density);
        Arch::new().dispatch(GatherPass { points, mesh, nodes: &nodes, particles, into });
    });
    adjoint
}

/// What particles take from `∂L/∂V` on the nodes: `∂L/∂r`, `∂L/∂v`, `∂L/∂ρ`.
struct GatherPass<'a, K, const D: usize> {
    points: &'a Points<'a, K, D>,
    mesh: &'a Mesh<D>,
    nodes: &'a [Vector<f64, D>],
    particles: &'a [Packed],
    into: (&'a mut [Vector<f64, D>], &'a mut [Vector<f64, D>], &'a mut [f64]),
}

impl<K: Kernel, const D: usize> NullaryFnOnce for GatherPass<'_, K, D> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { points, mesh, nodes, particles, into: (position, velocity, density) } = self;
        let mut near = Nearby::new();
        for (k, particle) in particles.iter().enumerate() {
            let taken = Self::gather((points, mesh, nodes), particle, &mut near);
            (position[k], velocity[k], density[k]) = taken;
        }
    }
}

impl<K: Kernel, const D: usize> GatherPass<'_, K, D> {
    /// What one particle takes.
    #[inline(always)]
    fn gather(
        (points, mesh, nodes): (&Points<'_, K, D>, &Mesh<D>, &[Vector<f64, D>]),
        particle: &Packed,
        near: &mut Nearby<D>,
    ) -> (Vector<f64, D>, Vector<f64, D>, f64) {
        let (mut position, mut velocity, mut density) = (Vector::zero(), Vector::zero(), 0.0);
        let Points { smoothing, mass, .. } = points;
        let v = Vector::<f64, D>::from_3d(particle.velocity);
        let volume = mass / particle.density;
        mesh.around(Vector::from_3d(particle.position), smoothing.support(), near);
        for (number, eight) in near.nodes.as_chunks::<WIDTH>().0.iter().enumerate() {
            let mut apart = Vector::<Lanes, D>::zero();
            for axis in 0..D {
                apart[axis] = Lanes::new(near.apart[axis].as_chunks().0[number]);
            }
            let distance = apart.norm_squared().sqrt();
            let weights = smoothing.value(distance) * volume;
            let pulls = smoothing.gradient(distance) * volume;
            for (lane, &node) in eight.iter().enumerate() {
                if distance.lane(lane) < smoothing.support() {
                    let (cotangent, weight) = (nodes[node], weights.lane(lane));
                    let along = v.dot(cotangent);
                    velocity += cotangent * weight;
                    position -= apart.map(|apart| apart.lane(lane)) * (pulls.lane(lane) * along);
                    density -= weight * along / particle.density;
                }
            }
        }
        (position, velocity, density)
    }
}
