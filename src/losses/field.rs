//! The field loss `L_f`: the smoothed velocity field on a mesh, against the truth's.

use super::mesh::{Mesh, Nearby};
use super::{SquareSum, StateAdjoint};
use crate::cells::Cells;
use crate::kernel::{Kernel, Smoothing};
use crate::packed::{Packed, PackedSensitivity, PackedSingle};
use crate::pairs::{Chunk, pick};
use crate::scalar::{Lanes, Pass, Scalar, WIDTH, Wide, dispatch};
use crate::space::PeriodicBox;
use crate::vector::Vector;
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
    /// Particles with their volumes `m/ρ` in place of the stress, and nobody, without a volume.
    lines: Vec<Packed>,
    /// Fixed-point coordinates in cell order, with two [`WIDTH`] more behind them.
    columns: [Vec<i32>; D],
    /// Squares of distances up to which particles may be in reach, see [`PackedSingle::limits`].
    limits: [f32; 2],
}

/// Eight particles as a place sees them.
struct Seen<W, const D: usize> {
    /// `x − rⱼ`.
    apart: Vector<W, D>,
    /// `vⱼ`.
    velocity: Vector<W, D>,
    /// `1/ρⱼ`.
    inverse_density: W,
    /// `(m/ρⱼ) W`.
    weight: W,
    /// `(m/ρⱼ) G`.
    pull: W,
}

impl<'a, K: Kernel, const D: usize> Search<'a, K, D> {
    fn new(points: &'a Points<'a, K, D>) -> Self {
        let column = |axis: usize| {
            let place = |p: &Packed| PackedSingle::fixed_point(p.position[axis], points.space);
            points.packed.iter().map(place).chain([0; 2 * WIDTH]).collect()
        };
        let lines = points.packed.iter().map(|p| Packed { stress: points.mass / p.density, ..*p });
        let lines = lines.chain([Packed::NOBODY]).collect();
        let limits = PackedSingle::limits(points.smoothing.support(), points.space);
        Self { points, lines, columns: std::array::from_fn(column), limits }
    }

    /// The slots of every particle in reach of the place `x`, with nobody's up to whole lanes.
    #[inline(always)]
    fn find<'b, W: Wide>(&self, x: Vector<f64, D>, near: &'b mut Chunk) -> &'b [[u32; WIDTH]] {
        let Points { cells, space, .. } = self.points;
        let mut here = [0; D];
        for axis in 0..D {
            here[axis] = PackedSingle::fixed_point(x[axis], *space);
        }
        near.clear();
        let around = cells.around(cells.coordinates(x));
        near.open(around.candidates());
        for range in around.ranges() {
            let end = range.to as usize;
            for first in (range.from as usize..end).step_by(2 * WIDTH) {
                let inside = u16::MAX >> (2 * WIDTH - (end - first).min(2 * WIDTH));
                // Whoever is a hair too far has no weight.
                let [_, maybe] = W::near(&self.columns, here, first, self.limits);
                near.append_mask::<W>(maybe & inside, first);
            }
        }
        near.close(self.points.packed.len(), true);
        near.neighbours(0)
    }

    /// Eight particles from the place `x`.
    #[inline(always)]
    fn see<W: Wide>(&self, here: Vector<f64, D>, slots: &[u32; WIDTH]) -> Seen<W::Double, D> {
        let [x, y, z, u, v, w, density, volume] = W::fields(pick(&self.lines, slots));
        let (mut apart, mut velocity) = (Vector::zero(), Vector::zero());
        for (axis, (place, speed)) in [(x, u), (y, v), (z, w)].into_iter().enumerate().take(D) {
            apart[axis] = W::Double::of(here[axis]) - place;
            velocity[axis] = speed;
        }
        let apart = self.points.space.minimum_image(apart);
        let (r, smoothing) = (apart.norm_squared().sqrt(), self.points.smoothing);
        Seen {
            apart,
            velocity,
            inverse_density: W::Double::of(1.0) / density,
            weight: volume * smoothing.value(r),
            pull: volume * smoothing.gradient(r),
        }
    }

    /// `V(x) = Σⱼ (m/ρⱼ) vⱼ W(|x − rⱼ|; h)`, Eq. (13).
    #[inline(always)]
    fn velocity<W: Wide>(&self, x: Vector<f64, D>, near: &mut Chunk) -> Vector<f64, D> {
        let mut sum = Vector::<W::Double, D>::zero();
        for slots in self.find::<W>(x, near) {
            let seen = self.see::<W>(x, slots);
            sum += seen.velocity * seen.weight;
        }
        sum_lanes(&sum)
    }

    /// `V(x)`, and into `columns[b·D + axis]` its derivative by the parameters of block `b`:
    /// `δV = Σⱼ (m/ρⱼ) [δvⱼ W − vⱼ (G (x − rⱼ)·δrⱼ + W δρⱼ/ρⱼ)]`.
    #[inline(always)]
    fn velocity_tangent<W: Wide>(
        &self,
        x: Vector<f64, D>,
        blocks: &[&[PackedSensitivity<D>]],
        (columns, near): (&mut [Lanes], &mut Chunk),
    ) -> Vector<f64, D> {
        let mut sum = Vector::<W::Double, D>::zero();
        columns.fill(Lanes::ZERO);
        // A loop: the closure of a visitor is not inlined into vectorised functions.
        for slots in self.find::<W>(x, near) {
            let seen = self.see::<W>(x, slots);
            sum += seen.velocity * seen.weight;
            let factors = Factors::new(&seen);
            for (b, block) in blocks.iter().enumerate() {
                let column = &mut columns[b * D..(b + 1) * D];
                add_columns::<W::Double, D>(&factors, (block, slots), column);
            }
        }
        sum_lanes(&sum)
    }
}

/// The sum over the lanes of every component.
#[inline(always)]
fn sum_lanes<W: Wide, const D: usize>(vector: &Vector<W, D>) -> Vector<f64, D> {
    let mut sum = Vector::zero();
    for axis in 0..D {
        sum[axis] = vector[axis].sum();
    }
    sum
}

/// What the derivative by one of eight particles is made of, in memory.
struct Factors<const D: usize> {
    weight: Lanes,
    velocity: [Lanes; D],
    /// `(m/ρⱼ) W/ρⱼ`.
    by_density: Lanes,
    /// `(m/ρⱼ) G (x − rⱼ)`.
    by_position: [Lanes; D],
}

impl<const D: usize> Factors<D> {
    #[inline(always)]
    fn new<W: Wide>(seen: &Seen<W, D>) -> Self {
        let mut factors = Self {
            weight: seen.weight.store(),
            velocity: [Lanes::ZERO; D],
            by_density: (seen.weight * seen.inverse_density).store(),
            by_position: [Lanes::ZERO; D],
        };
        for axis in 0..D {
            factors.velocity[axis] = seen.velocity[axis].store();
            factors.by_position[axis] = (seen.apart[axis] * seen.pull).store();
        }
        factors
    }
}

/// Adds what eight particles give to the derivatives by one block of parameters.
#[inline(always)]
fn add_columns<W: Wide, const D: usize>(
    factors: &Factors<D>,
    (block, slots): (&[PackedSensitivity<D>], &[u32; WIDTH]),
    columns: &mut [Lanes],
) {
    let mut sums = Vector::<W, D>::zero();
    for axis in 0..D {
        sums[axis] = W::load(&columns[axis]);
    }
    for (lane, &slot) in slots.iter().enumerate() {
        // Nobody comes last.
        let Some(change) = block.get(slot as usize) else { break };
        let mut fade = W::load(&change.density) * factors.by_density.lane(lane);
        for axis in 0..D {
            fade += W::load(&change.position[axis]) * factors.by_position[axis].lane(lane);
        }
        for axis in 0..D {
            let moved = W::load(&change.velocity[axis]) * factors.weight.lane(lane);
            sums[axis] += moved - fade * factors.velocity[axis].lane(lane);
        }
    }
    for axis in 0..D {
        columns[axis] = sums[axis].store();
    }
}

/// The field at consecutive nodes.
struct FieldPass<'a, K, const D: usize> {
    search: &'a Search<'a, K, D>,
    mesh: &'a Mesh<D>,
    first: usize,
    values: &'a mut [Vector<f64, D>],
}

impl<K: Kernel, const D: usize> Pass for FieldPass<'_, K, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(self) {
        let mut near = Chunk::default();
        for (k, value) in self.values.iter_mut().enumerate() {
            *value = self.search.velocity::<W>(self.mesh.node(self.first + k), &mut near);
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
        dispatch(FieldPass { search, mesh, first: chunk * CHUNK, values });
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

impl<K: Kernel, const D: usize> Pass for LossPass<'_, K, D> {
    type Output = SquareSum;

    #[inline(always)]
    fn run<W: Wide>(self) -> SquareSum {
        let Self { search, mesh, blocks, first, truth, weight } = self;
        let mut sum = SquareSum::new(blocks.len());
        let mut columns = vec![Lanes::ZERO; blocks.len() * D];
        let mut near = Chunk::default();
        for (k, expected) in truth.iter().enumerate() {
            let (x, room) = (mesh.node(first + k), (&mut columns[..], &mut near));
            let difference = search.velocity_tangent::<W>(x, blocks, room) - *expected;
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
        dispatch(LossPass { search, mesh, blocks, first, truth, weight })
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
        dispatch(GatherPass { points, mesh, nodes: &nodes, particles, into });
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

impl<K: Kernel, const D: usize> Pass for GatherPass<'_, K, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(self) {
        let Self { points, mesh, nodes, particles, into: (position, velocity, density) } = self;
        let mut near = Nearby::new();
        for (k, particle) in particles.iter().enumerate() {
            let taken = Self::gather::<W>((points, mesh, nodes), particle, &mut near);
            (position[k], velocity[k], density[k]) = taken;
        }
    }
}

impl<K: Kernel, const D: usize> GatherPass<'_, K, D> {
    /// What one particle takes.
    #[inline(always)]
    fn gather<W: Wide>(
        (points, mesh, nodes): (&Points<'_, K, D>, &Mesh<D>, &[Vector<f64, D>]),
        particle: &Packed,
        near: &mut Nearby<D>,
    ) -> (Vector<f64, D>, Vector<f64, D>, f64) {
        let mut position = Vector::<W, D>::zero();
        let (mut velocity, mut density) = (position, W::of(0.0));
        let Points { smoothing, mass, .. } = points;
        let volume = mass / particle.density;
        mesh.around(Vector::from_3d(particle.position), smoothing.support(), near);
        for (number, eight) in near.nodes.as_chunks::<WIDTH>().0.iter().enumerate() {
            let (mut apart, mut cotangent) = (Vector::<W, D>::zero(), Vector::<W, D>::zero());
            let mut along = W::of(0.0);
            for axis in 0..D {
                apart[axis] = W::load(&Lanes::new(near.apart[axis].as_chunks().0[number]));
                let mut there = Lanes::ZERO;
                for (lane, &node) in eight.iter().enumerate() {
                    there.set_lane(lane, nodes[node][axis]);
                }
                cotangent[axis] = W::load(&there);
                along += cotangent[axis] * particle.velocity[axis];
            }
            // Zero for nodes out of reach.
            let distance = apart.norm_squared().sqrt();
            let weight = smoothing.value(distance) * volume;
            velocity += cotangent * weight;
            position -= apart * (smoothing.gradient(distance) * volume * along);
            density -= weight * along;
        }
        (sum_lanes(&position), sum_lanes(&velocity), density.sum() / particle.density)
    }
}
