//! The field loss with its derivatives by the parameters: each node sees all sensitivities in its reach.

use super::field::{CHUNK, Points, field_value, sum_lanes};
use super::mesh::Mesh;
use super::{Panel, SquareSum};
use crate::kernel::Kernel;
use crate::packed::{Packed, PackedSensitivity, PackedSingle};
use crate::pairs::{Chunk, pick};
use crate::scalar::{Lanes, Pass, Scalar, WIDTH, Wide, dispatch};
use crate::vector::Vector;
use rayon::prelude::*;

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
        let (mut sum, mut panel) = (SquareSum::new(blocks.len()), Panel::default());
        let mut columns = vec![Lanes::ZERO; blocks.len() * D];
        let mut near = Chunk::default();
        for (k, expected) in truth.iter().enumerate() {
            let (x, room) = (mesh.node(first + k), (&mut columns[..], &mut near));
            let difference = search.velocity_tangent::<W>(x, blocks, room) - *expected;
            for axis in 0..D {
                let columns = |b: usize| columns[b * D + axis];
                panel.add::<W>((weight, difference[axis]), columns, &mut sum);
            }
        }
        panel.finish::<W>(&mut sum);
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
    let mut sum = SquareSum::new(blocks.len());
    if blocks.is_empty() {
        sum.value = field_value(mesh, points, (truth, weight));
        return sum;
    }
    let weight = weight / (mesh.len() * D) as f64;
    let search = &Search::new(points);
    let part = |(chunk, truth): (usize, &[Vector<f64, D>])| {
        let first = chunk * CHUNK;
        dispatch(LossPass { search, mesh, blocks, first, truth, weight })
    };
    let parts: Vec<SquareSum> = truth.par_chunks(CHUNK).enumerate().map(part).collect();
    parts.iter().for_each(|part| sum.merge(part));
    sum
}
