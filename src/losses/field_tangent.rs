//! The field loss with its derivatives by the parameters: each node sees all sensitivities in its reach.

use super::SquareSum;
use super::field::{CHUNK, Points, field_value, sum_lanes};
use super::mesh::Mesh;
use crate::kernel::Kernel;
use crate::packed::{Packed, PackedSensitivity, PackedSingle};
use crate::pairs::{Draft, Eight, pick};
use crate::scalar::{Lanes, Pass, Scalar, WIDTH, Wide, dispatch_doubles_by_kernel, transposed};
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
    fn find<'b, W: Wide>(&self, x: Vector<f64, D>, near: &'b mut Draft) -> &'b [[u32; WIDTH]] {
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
            pull: volume * smoothing.gradient(r),
        }
    }

    /// `V(x)`, and into `givers` what its derivative is made of.
    #[inline(always)]
    fn velocity<W: Wide>(
        &self,
        x: Vector<f64, D>,
        near: &mut Draft,
        givers: &mut Givers,
    ) -> Vector<f64, D> {
        let mut sum = Vector::<W::Double, D>::zero();
        // A loop: the closure of a visitor is not inlined into vectorised functions.
        for slots in self.find::<W>(x, near) {
            let seen = self.see::<W>(x, slots);
            sum += seen.velocity * seen.weight;
            givers.push(&seen, slots, self.points.packed.len());
        }
        givers.start.push(givers.filled);
        sum_lanes(&sum)
    }
}

/// Whoever gives to the velocity at some nodes, with what the derivative by it is made of:
/// `δV = Σⱼ (m/ρⱼ) [δvⱼ W − vⱼ (G (x − rⱼ)·δrⱼ + W δρⱼ/ρⱼ)]`.
#[derive(Default)]
struct Givers {
    /// Where those of each node start; one more at the end.
    start: Vec<usize>,
    slots: Vec<u32>,
    /// `(m/ρⱼ) G (x − rⱼ)`, `vⱼ`, `(m/ρⱼ) W/ρⱼ` and `(m/ρⱼ) W`, lane after lane.
    rows: Vec<Lanes>,
    /// How many there are; what lies behind is anything.
    filled: usize,
}

impl Givers {
    #[inline(always)]
    fn clear(&mut self) {
        self.start.clear();
        self.start.push(0);
        self.filled = 0;
    }

    /// Appends those of eight particles that have a weight; nobody has none.
    #[inline(always)]
    fn push<W: Wide<Double = W>, const D: usize>(
        &mut self,
        seen: &Seen<W, D>,
        slots: &[u32; WIDTH],
        nobody: usize,
    ) {
        let mut columns = [Lanes::ZERO; WIDTH];
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
            self.rows.resize(2 * end, Lanes::ZERO);
        }
        let (Some(others), Some(found)) = (
            self.slots[self.filled..].first_chunk_mut::<WIDTH>(),
            self.rows[self.filled..].first_chunk_mut::<WIDTH>(),
        ) else {
            return;
        };
        // Without a branch that nobody can predict: those without a weight are overwritten.
        let mut count = 0;
        for (lane, &slot) in slots.iter().enumerate() {
            // No more than the lanes before it.
            let place = count % WIDTH;
            (others[place], found[place]) = (slot, rows[lane].store());
            count += usize::from(sizes.lane(lane) != 0.0 && slot as usize != nobody);
        }
        self.filled += count;
    }

    /// The derivatives of the velocity at every node by one block of parameters: component after component,
    /// each time `blocks` further in `columns`. The sensitivities of the `next` block are asked for.
    #[inline(always)]
    fn differentiate<W: Wide, const D: usize>(
        &self,
        [block, next]: [&[PackedSensitivity<D>]; 2],
        columns: &mut [Lanes],
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

/// Nodes whose givers are held at once: they, and one block's sensitivities of everyone near, stay in the
/// cache.
const NODES: usize = 64;

/// A parameter that the field depends on at a fixed state: of the kernel.
#[derive(Clone, Copy, Debug)]
pub struct DirectParameter<'a, const D: usize> {
    /// `∂V/∂p` by node.
    pub field: &'a [Vector<f64, D>],
    /// `∂p/∂(the eight learned parameters)` of each block.
    pub directions: &'a [Lanes],
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

impl<K: Kernel, const D: usize> Pass for LossPass<'_, K, D> {
    type Output = SquareSum;

    #[inline(always)]
    fn run<W: Wide>(self) -> SquareSum {
        let Self { search, mesh, blocks, direct, first, truth, weight } = self;
        let count = blocks.len();
        let mut sum = SquareSum::new(count);
        let mut columns = vec![Lanes::ZERO; NODES * D * count];
        let (mut near, mut givers, mut residuals) =
            (Draft::default(), Givers::default(), Vec::new());
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
/// `truth` is `V̂` on the same mesh, `weight` the loss's weight over the number of frames. The
/// gradient runs through position, velocity and density of every particle in reach, and through the parameters that
/// the field depends on by itself.
///
/// It counts as many independent residuals as the smoothed field has independent values, `D Lᴰ ∫W²`, where the mesh
/// has more nodes: errors of neighbouring nodes are those of the same particles.
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
    // Neighbouring nodes smooth over the same particles: of a fine mesh not every node counts.
    let independent = points.smoothing.square_integral() * points.space.length.powi(D as i32);
    sum.count = D as f64 * independent.min(mesh.len() as f64);
    sum.size = weight * truth.iter().map(|v| v.norm_squared()).sum::<f64>();
    let search = &Search::new(points);
    let part = |(chunk, truth): (usize, &[Vector<f64, D>])| {
        let first = chunk * CHUNK;
        let pass = LossPass { search, mesh, blocks, direct, first, truth, weight };
        dispatch_doubles_by_kernel(points.smoothing.is_table(), pass)
    };
    let parts: Vec<SquareSum> = truth.par_chunks(CHUNK).enumerate().map(part).collect();
    parts.iter().for_each(|part| sum.merge(part));
    sum
}
