//! The field loss with its derivatives by the parameters: each node sums the sensitivities of the
//! particles in its reach.

use super::SquareSum;
use super::field::{CHUNK, Points, field_value, sum_lanes};
use super::mesh::Mesh;
use crate::kernel::Kernel;
use crate::packed::{Packed, PackedSensitivity};
use crate::pairs::{Eight, ListBuilder, pick};
use crate::reduce::in_order;
use crate::scalar::{
    F64x8, Scalar, SimdFloat, SimdTask, WIDTH, dispatch_doubles_by_kernel, transposed,
};
use crate::vector::Vector;
use rayon::prelude::*;

/// Particles with their coordinates as columns, for the neighbour search.
struct Search<'a, K, const D: usize> {
    points: &'a Points<'a, K, D>,
    /// Particles with their volumes `m/ρ` in the field `p_over_rho2`, and at the end the sentinel with
    /// zero volume.
    lines: Vec<Packed>,
    /// Fixed-point coordinates in cell order, padded by two [`WIDTH`].
    columns: [Vec<i32>; D],
    /// Squared distances up to which particles may be in reach, see [`crate::neighbours::fixed_point::FixedPoint::limits`].
    limits: [f32; 2],
}

/// Eight particles near a node at `x`.
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
        let place = |slot: usize| Vector::from_3d(points.packed[slot].position);
        let mut columns = [(); D].map(|()| Vec::with_capacity(points.packed.len() + 2 * WIDTH));
        for place in points.cells.places(&place) {
            columns.iter_mut().zip(place).for_each(|(column, x)| column.push(x));
        }
        columns.iter_mut().for_each(|column| column.extend([0; 2 * WIDTH]));
        let lines =
            points.packed.iter().map(|p| Packed { p_over_rho2: points.mass / p.density, ..*p });
        let lines = lines.chain([Packed::SENTINEL]).collect();
        let limits = points.cells.fixed_point().limits(points.smoothing.support());
        Self { points, lines, columns, limits }
    }

    /// The slots of all particles in reach of the place `x`, padded with the sentinel to whole
    /// eights.
    #[inline(always)]
    fn find<'b, W: SimdFloat>(
        &self,
        x: Vector<f64, D>,
        near: &'b mut ListBuilder,
    ) -> &'b [[u32; WIDTH]] {
        let cells = self.points.cells;
        let place = cells.fixed_point().of(x);
        near.clear();
        let around = cells.around(cells.coordinates(x));
        near.open(around.candidates());
        for range in around.ranges() {
            let end = range.to as usize;
            let here = cells.fixed_point().seen_from(place, range.image);
            for first in (range.from as usize..end).step_by(2 * WIDTH) {
                let inside = u16::MAX >> (2 * WIDTH - (end - first).min(2 * WIDTH));
                // A particle just out of reach has zero weight.
                let [_, maybe] = W::near(&self.columns, here, first, self.limits);
                near.append_mask::<W>(maybe & inside, first);
            }
        }
        near.close(self.points.packed.len(), true);
        near.neighbours(0)
    }

    /// Eight particles near the place `x`.
    #[inline(always)]
    fn see<W: SimdFloat>(&self, here: Vector<f64, D>, slots: &[u32; WIDTH]) -> Seen<W::Double, D> {
        let [x, y, z, u, v, w, density, volume] = W::fields(pick(&self.lines, Eight::from(slots)));
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
            pull: volume * smoothing.dw_over_r(r),
        }
    }

    /// `V(x)`. Adds the coefficients of its derivative to `givers`.
    #[inline(always)]
    fn velocity<W: SimdFloat>(
        &self,
        x: Vector<f64, D>,
        near: &mut ListBuilder,
        givers: &mut Givers,
    ) -> Vector<f64, D> {
        let mut sum = Vector::<W::Double, D>::zero();
        // A loop, because closures are not inlined into vectorised functions.
        for slots in self.find::<W>(x, near) {
            let seen = self.see::<W>(x, slots);
            sum += seen.velocity * seen.weight;
            givers.push(&seen, slots, self.points.packed.len());
        }
        givers.start.push(givers.filled);
        sum_lanes(&sum)
    }
}

/// The particles that contribute to the velocity at some nodes, with the coefficients of its
/// derivative: `δV = Σⱼ (m/ρⱼ) [δvⱼ W − vⱼ (G (x − rⱼ)·δrⱼ + W δρⱼ/ρⱼ)]`.
#[derive(Default)]
struct Givers {
    /// Index of each node's first particle, and the total at the end.
    start: Vec<usize>,
    slots: Vec<u32>,
    /// `(m/ρⱼ) G (x − rⱼ)`, `vⱼ`, `(m/ρⱼ) W/ρⱼ` and `(m/ρⱼ) W`, lane after lane.
    rows: Vec<F64x8>,
    /// Number of elements in use.
    filled: usize,
}

impl Givers {
    #[inline(always)]
    fn clear(&mut self) {
        self.start.clear();
        self.start.push(0);
        self.filled = 0;
    }

    /// Appends those of eight particles that have a nonzero weight; the sentinel has none.
    #[inline(always)]
    fn push<W: SimdFloat<Double = W>, const D: usize>(
        &mut self,
        seen: &Seen<W, D>,
        slots: &[u32; WIDTH],
        sentinel: usize,
    ) {
        let mut columns = [F64x8::ZERO; WIDTH];
        for axis in 0..D {
            columns[axis] = (seen.apart[axis] * seen.pull).store();
            columns[D + axis] = seen.velocity[axis].store();
        }
        columns[2 * D] = (seen.weight * seen.inverse_density).store();
        columns[2 * D + 1] = seen.weight.store();
        let (rows, sizes) =
            (transposed::<W>(&columns), (seen.weight.abs() + seen.pull.abs()).store());
        let end = self.filled + WIDTH;
        if self.slots.len() < end {
            self.slots.resize(2 * end, 0);
            self.rows.resize(2 * end, F64x8::ZERO);
        }
        let (Some(others), Some(found)) = (
            self.slots[self.filled..].first_chunk_mut::<WIDTH>(),
            self.rows[self.filled..].first_chunk_mut::<WIDTH>(),
        ) else {
            return;
        };
        // Without an unpredictable branch: an element of zero weight is overwritten by the next.
        let mut count = 0;
        for (lane, &slot) in slots.iter().enumerate() {
            // Never more than the current lane, so that no unread element is lost.
            let place = count % WIDTH;
            (others[place], found[place]) = (slot, rows[lane].store());
            count += usize::from(sizes.lane(lane) != 0.0 && slot as usize != sentinel);
        }
        self.filled += count;
    }

    /// The derivatives of the velocity at every node by one block of parameters. Consecutive
    /// components are `blocks` elements apart in `columns`. Prefetches the sensitivities of the
    /// `next` block.
    #[inline(always)]
    fn differentiate<W: SimdFloat, const D: usize>(
        &self,
        [block, next]: [&[PackedSensitivity<D>]; 2],
        columns: &mut [F64x8],
        blocks: usize,
    ) {
        for (node, range) in self.start.windows(2).enumerate() {
            let mut sums = Vector::<W, D>::zero();
            let range = range[0]..range[1];
            for (&slot, row) in self.slots[range.clone()].iter().zip(&self.rows[range]) {
                if let Some(next) = next.get(slot as usize) {
                    next.fetch::<W>();
                }
                let change = &block[slot as usize];
                let mut fade = W::load(&change.density) * row.lane(2 * D);
                for axis in 0..D {
                    fade += W::load(&change.position[axis]) * row.lane(axis);
                }
                for axis in 0..D {
                    let moved = W::load(&change.velocity[axis]) * row.lane(2 * D + 1);
                    sums[axis] += moved - fade * row.lane(D + axis);
                }
            }
            for axis in 0..D {
                columns[(node * D + axis) * blocks] = sums[axis].store();
            }
        }
    }
}

/// Nodes linearised at a time: few enough that their coefficients, and one block's sensitivities of
/// all particles in reach, stay in the cache.
const NODES: usize = 64;

/// A parameter on which the field depends directly, at a fixed state: one of the kernel's.
#[derive(Clone, Copy, Debug)]
pub struct DirectParameter<'a, const D: usize> {
    /// `∂V/∂p` by node.
    pub field: &'a [Vector<f64, D>],
    /// `∂p/∂(the eight learned parameters)` of each block.
    pub directions: &'a [F64x8],
}

/// The loss at consecutive nodes, with its derivatives by the parameters.
struct LossPass<'a, K, const D: usize> {
    search: &'a Search<'a, K, D>,
    mesh: &'a Mesh<D>,
    blocks: &'a [&'a [PackedSensitivity<D>]],
    direct: &'a [DirectParameter<'a, D>],
    first: usize,
    truth: &'a [Vector<f64, D>],
    weight: f64,
}

impl<K: Kernel, const D: usize> SimdTask for LossPass<'_, K, D> {
    type Output = SquareSum;

    #[inline(always)]
    fn run<W: SimdFloat>(self) -> SquareSum {
        let Self { search, mesh, blocks, direct, first, truth, weight } = self;
        let count = blocks.len();
        let mut sum = SquareSum::new(count);
        let mut columns = vec![F64x8::ZERO; NODES * D * count];
        let (mut near, mut givers, mut residuals) =
            (ListBuilder::default(), Givers::default(), Vec::new());
        for (group, truth) in truth.chunks(NODES).enumerate() {
            givers.clear();
            residuals.clear();
            for (k, expected) in truth.iter().enumerate() {
                let x = mesh.node(first + group * NODES + k);
                let difference = search.velocity::<W>(x, &mut near, &mut givers) - *expected;
                residuals.extend_from_slice(&difference.0);
            }
            for (b, block) in blocks.iter().enumerate() {
                let next = blocks.get(b + 1).copied().unwrap_or_default();
                givers.differentiate::<W::Double, D>([block, next], &mut columns[b..], count);
                for parameter in direct {
                    let nodes = parameter.field[first + group * NODES..].iter().take(truth.len());
                    for (k, by) in nodes.flat_map(|node| node.0).enumerate() {
                        columns[k * count + b] += parameter.directions[b] * by;
                    }
                }
            }
            sum.add_rows::<W>(weight, &residuals, &columns);
        }
        sum
    }
}

/// One frame's share of `L_f`, the mean over nodes, components and frames of `(V − V̂)²`.
///
/// `truth` is `V̂` on the same mesh, `weight` the loss's weight divided by the number of frames.
/// The gradient includes the position, velocity and density of every particle in reach, and the
/// parameters on which the field depends directly.
///
/// The number of independent residuals is the number of nodes, but at most the number of
/// independent values of the smoothed field, `D Lᴰ ∫W²`: on a fine mesh, errors of neighbouring
/// nodes come from the same particles.
pub fn field_loss<K: Kernel, const D: usize>(
    mesh: &Mesh<D>,
    points: &Points<'_, K, D>,
    (blocks, direct): (&[&[PackedSensitivity<D>]], &[DirectParameter<'_, D>]),
    (truth, weight): (&[Vector<f64, D>], f64),
) -> SquareSum {
    let mut sum = SquareSum::new(blocks.len());
    if blocks.is_empty() {
        sum.value = field_value(mesh, points, (truth, weight));
        return sum;
    }
    let weight = weight / (mesh.len() * D) as f64;
    // Neighbouring nodes average over the same particles: on a fine mesh not every node is
    // independent.
    let independent = points.smoothing.square_integral() * points.space.volume::<D>();
    sum.count = D as f64 * independent.min(mesh.len() as f64);
    sum.size = weight * truth.iter().map(|v| v.norm_squared()).sum::<f64>();
    let search = &Search::new(points);
    let part = |(chunk, truth): (usize, &[Vector<f64, D>])| {
        let first = chunk * CHUNK;
        let pass = LossPass { search, mesh, blocks, direct, first, truth, weight };
        dispatch_doubles_by_kernel(points.smoothing.is_table(), pass)
    };
    in_order(sum, truth.par_chunks(CHUNK).enumerate().map(part))
}
