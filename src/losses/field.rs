//! The field loss `L_f`: the smoothed velocity field on a mesh, against the truth's.

use super::StateAdjoint;
use super::mesh::Mesh;
use super::rows::{Lattice, Rows, load_at, store_at};
use crate::cells::{Cells, counting_sort};
use crate::kernel::{Kernel, Smoothing};
use crate::packed::Packed;
use crate::scalar::{Pass, Wide, dispatch};
use crate::space::PeriodicBox;
use crate::vector::Vector;
use rayon::prelude::*;
use std::ops::Range;

/// Nodes per parallel task: fixed, so that sums have the same bits for any number of threads.
pub(super) const CHUNK: usize = 256;

/// Fewest planes of nodes that a task finds the field on: a particle is seen by all tasks that it reaches.
const FEWEST_PLANES: usize = 8;

/// Fewest nodes of such a task.
const FEWEST_NODES: usize = 1024;

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

/// The sum over the lanes of every component.
#[inline(always)]
pub(super) fn sum_lanes<W: Wide, const D: usize>(vector: &Vector<W, D>) -> Vector<f64, D> {
    let mut sum = Vector::zero();
    for axis in 0..D {
        sum[axis] = vector[axis].sum();
    }
    sum
}

/// Particles by the first plane of nodes that they touch, in slot order.
struct Bins {
    /// Where each plane's particles start in `slots`; one more at the end.
    start: Vec<u32>,
    slots: Vec<u32>,
}

impl Bins {
    fn new<const D: usize>(lattice: &Lattice<D>, packed: &[Packed]) -> Self {
        let plane = |p: &Packed| lattice.first(p.position[D - 1]) as u32;
        let mut planes: Vec<u32> = packed.par_iter().with_min_len(CHUNK).map(plane).collect();
        let (mut start, mut slots) = (Vec::new(), Vec::new());
        counting_sort(&mut planes, lattice.per_axis, &mut start, &mut slots);
        Self { start, slots }
    }

    /// The particles whose first plane this is.
    #[inline(always)]
    fn of(&self, plane: usize) -> &[u32] {
        &self.slots[self.start[plane] as usize..self.start[plane + 1] as usize]
    }
}

/// Consecutive planes of nodes, to which particles give their velocities.
struct Planes<'a, K, const D: usize> {
    points: &'a Points<'a, K, D>,
    lattice: Lattice<D>,
    bins: &'a Bins,
    planes: Range<usize>,
}

impl<K: Kernel, const D: usize> Planes<'_, K, D> {
    /// The field at their nodes.
    fn find(&self, values: &mut [Vector<f64, D>]) {
        let Self { lattice, planes, .. } = self;
        let n = lattice.per_axis;
        let numbers = planes.len() * lattice.rows_per_plane() * lattice.width;
        let mut columns = [(); D].map(|()| vec![0.0; numbers]);
        let mut rows = Rows::new(*lattice);
        // From the first plane on of which particles reach these.
        let from = planes.start + n - (lattice.most - 1);
        for number in 0..(planes.len() + lattice.most - 1).min(n) {
            let mut slots = self.bins.of((from + number) % n);
            while !slots.is_empty() {
                let added = rows.add(self.points.packed, slots, planes);
                slots = &slots[added..];
                if rows.is_full() {
                    self.give(&mut rows, &mut columns);
                }
            }
        }
        self.give(&mut rows, &mut columns);
        for (axis, column) in columns.iter().enumerate() {
            fold(column, lattice, |node, x| values[node][axis] += x);
        }
    }

    /// What the particles of all rows give, and no row is left.
    fn give(&self, rows: &mut Rows<D>, columns: &mut [Vec<f64>; D]) {
        rows.find_weights(self.points.smoothing);
        dispatch(GivePass { points: self.points, rows, columns });
        rows.clear();
    }
}

/// Brings the numbers of whole rows to their nodes.
#[inline(always)]
fn fold<const D: usize>(column: &[f64], lattice: &Lattice<D>, mut add: impl FnMut(usize, f64)) {
    for (row, numbers) in column.chunks_exact(lattice.width).enumerate() {
        let mut along = 0;
        for &x in numbers {
            add(row * lattice.per_axis + along, x);
            along = if along + 1 == lattice.per_axis { 0 } else { along + 1 };
        }
    }
}

/// `V += (m/ρⱼ) vⱼ W` at the nodes of some rows.
struct GivePass<'a, K, const D: usize> {
    points: &'a Points<'a, K, D>,
    rows: &'a Rows<D>,
    columns: &'a mut [Vec<f64>; D],
}

impl<K: Kernel, const D: usize> Pass for GivePass<'_, K, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(self) {
        let Self { points, rows, columns } = self;
        for k in 0..rows.len() {
            let (slot, own) = rows.of(k);
            let particle = &points.packed[slot];
            let volume = points.mass / particle.density;
            let mut given = Vector::<W, D>::zero();
            for axis in 0..D {
                given[axis] = W::of(particle.velocity[axis] * volume);
            }
            for row in own {
                let weight = rows.weights::<W>(row);
                for axis in 0..D {
                    let sum = load_at::<W>(&columns[axis], row.node()) + weight * given[axis];
                    store_at(&mut columns[axis], row.node(), sum);
                }
            }
        }
    }
}

/// The smoothed velocity field on a mesh, node by node: `V(x) = Σⱼ (m/ρⱼ) vⱼ W(|x − rⱼ|; h)`, Eq. (13).
pub fn field<K: Kernel, const D: usize>(
    mesh: &Mesh<D>,
    points: &Points<'_, K, D>,
) -> Vec<Vector<f64, D>> {
    let mut nodes = vec![Vector::zero(); mesh.len()];
    if mesh.is_empty() {
        return nodes;
    }
    let lattice = Lattice::new(mesh, points.smoothing.support());
    let bins = &Bins::new(&lattice, points.packed);
    let plane = mesh.len() / mesh.per_axis;
    let planes = FEWEST_PLANES.max(FEWEST_NODES.div_ceil(plane)).min(mesh.per_axis);
    nodes.par_chunks_mut(planes * plane).enumerate().for_each(|(task, values)| {
        let first = task * planes;
        let planes = first..first + values.len() / plane;
        Planes { points, lattice, bins, planes }.find(values);
    });
    nodes
}

/// The value of [`super::field_loss`] alone.
pub fn field_value<K: Kernel, const D: usize>(
    mesh: &Mesh<D>,
    points: &Points<'_, K, D>,
    (truth, weight): (&[Vector<f64, D>], f64),
) -> f64 {
    let weight = weight / (mesh.len() * D) as f64;
    let nodes = field(mesh, points);
    let squares = nodes.iter().zip(truth).map(|(&v, &expected)| (v - expected).norm_squared());
    squares.fold(0.0, |sum, square| sum + weight * square)
}

/// The value of [`super::field_loss`], and its derivative by each particle's position (at fixed density),
/// velocity and density: each particle takes from the nodes in its reach.
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
    if mesh.is_empty() {
        return adjoint;
    }
    let lattice = Lattice::new(mesh, points.smoothing.support());
    let nodes = &unfold(&nodes, &lattice);
    let columns =
        adjoint.position.par_chunks_mut(CHUNK).zip(adjoint.velocity.par_chunks_mut(CHUNK));
    let columns = columns.zip(adjoint.density.par_chunks_mut(CHUNK));
    let chunks = columns.zip(points.packed.par_chunks(CHUNK));
    chunks.enumerate().for_each(|(number, (((position, velocity), density), particles))| {
        let mut rows = Rows::new(lattice);
        let first = number * CHUNK;
        let slots: [u32; CHUNK] = std::array::from_fn(|k| (first + k) as u32);
        let mut slots = &slots[..particles.len()];
        while !slots.is_empty() {
            let added = rows.add(points.packed, slots, &(0..mesh.per_axis));
            slots = &slots[added..];
            rows.find_weights_and_pulls(points.smoothing);
            let into = (&mut *position, &mut *velocity, &mut *density);
            dispatch(TakePass { points, nodes, rows: &rows, first, into });
            rows.clear();
        }
    });
    adjoint
}

/// The numbers of all nodes in rows that carry their beginning again behind their end, axis by axis.
fn unfold<const D: usize>(nodes: &[Vector<f64, D>], lattice: &Lattice<D>) -> [Vec<f64>; D] {
    let rows = nodes.len() / lattice.per_axis;
    let mut columns = [(); D].map(|()| Vec::with_capacity(rows * lattice.width));
    for (axis, column) in columns.iter_mut().enumerate() {
        for row in nodes.chunks_exact(lattice.per_axis) {
            column.extend(row.iter().map(|node| node[axis]));
            let again = lattice.width - lattice.per_axis;
            column.extend(row.iter().cycle().take(again).map(|node| node[axis]));
        }
    }
    columns
}

/// What particles take from `λ = ∂L/∂V` on the nodes, with `s = λ·vⱼ` and `x − rⱼ` from particle to node:
/// `∂L/∂vⱼ = (m/ρⱼ) Σ λ W`, `∂L/∂rⱼ = −(m/ρⱼ) Σ s G (x − rⱼ)`, `∂L/∂ρⱼ = −(m/ρⱼ²) Σ s W`.
struct TakePass<'a, K, const D: usize> {
    points: &'a Points<'a, K, D>,
    nodes: &'a [Vec<f64>; D],
    rows: &'a Rows<D>,
    /// Slot of the first of all that take.
    first: usize,
    into: (&'a mut [Vector<f64, D>], &'a mut [Vector<f64, D>], &'a mut [f64]),
}

impl<K: Kernel, const D: usize> Pass for TakePass<'_, K, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(mut self) {
        for k in 0..self.rows.len() {
            self.take::<W>(k);
        }
    }
}

impl<K: Kernel, const D: usize> TakePass<'_, K, D> {
    /// What the `k`-th particle of the rows takes.
    #[inline(always)]
    fn take<W: Wide>(&mut self, k: usize) {
        let rows = self.rows;
        let (slot, own) = rows.of(k);
        let particle = &self.points.packed[slot];
        let mut own_velocity = Vector::<W, D>::zero();
        for axis in 0..D {
            own_velocity[axis] = W::of(particle.velocity[axis]);
        }
        let mut position = Vector::<W, D>::zero();
        let (mut velocity, mut density) = (position, W::of(0.0));
        for row in own {
            let (weight, pull) = (rows.weights::<W>(row), rows.pulls::<W>(row));
            let mut cotangent = Vector::<W, D>::zero();
            for axis in 0..D {
                cotangent[axis] = load_at(&self.nodes[axis], row.node());
            }
            let along = cotangent.dot(own_velocity);
            let pull = pull * along;
            position[0] -= pull * rows.along::<W>(row);
            for axis in 1..D {
                position[axis] -= pull * row.apart[axis];
            }
            velocity += cotangent * weight;
            density -= weight * along;
        }
        let (volume, number) = (self.points.mass / particle.density, slot - self.first);
        self.into.0[number] = sum_lanes(&position) * volume;
        self.into.1[number] = sum_lanes(&velocity) * volume;
        self.into.2[number] = density.sum() * volume / particle.density;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::CubicSpline;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Particles anywhere in the box, with fields at `n` nodes along an axis, by a kernel of support `reach`.
    fn check<const D: usize>(particles: usize, (n, reach): (usize, f64)) {
        let (length, mut random) = (2.0, ChaCha8Rng::seed_from_u64(n as u64));
        let mut number = |_| random.random_range(0.0..length);
        let line = |_| Packed {
            position: Vector::<f64, D>(std::array::from_fn(&mut number)).to_3d(),
            velocity: Vector::<f64, D>(std::array::from_fn(&mut number)).to_3d(),
            density: 0.5 + number(0),
            stress: 0.0,
        };
        let mut packed: Vec<Packed> = (0..particles).map(line).collect();
        packed[0].position = [0.0; 3];
        let (space, cells) = (PeriodicBox { length }, Cells::default());
        let smoothing = &Smoothing::<CubicSpline, D>::new(0.5 * reach);
        let points = Points { packed: &packed, cells: &cells, space, smoothing, mass: 0.3 };
        let mesh = Mesh { per_axis: n, length };
        let truth: Vec<_> = (0..mesh.len()).map(|k| mesh.node(k) * 0.7).collect();
        let (plain, found) = (plainly(&mesh, &points), field(&mesh, &points));
        for (plain, found) in plain.iter().zip(&found) {
            assert!((*plain - *found).norm() < 1e-12 * (1.0 + plain.norm()), "{plain:?} {found:?}");
        }
        let adjoint = field_adjoint(&mesh, &points, (&truth, 1.0));
        assert_eq!(adjoint.value.to_bits(), field_value(&mesh, &points, (&truth, 1.0)).to_bits());
        // One step along every number of one particle, central differences.
        let (slot, step) = (particles / 2, 1e-6);
        let slope = |change: &dyn Fn(&mut Packed, f64)| {
            let [more, less] = [step, -step].map(|by| {
                let mut packed = packed.clone();
                change(&mut packed[slot], by);
                field_value(&mesh, &Points { packed: &packed, ..points }, (&truth, 1.0))
            });
            (more - less) / (2.0 * step)
        };
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-6 * (1.0 + a.abs()), "{a} {b}");
        for axis in 0..D {
            near(adjoint.position[slot][axis], slope(&|p, by| p.position[axis] += by));
            near(adjoint.velocity[slot][axis], slope(&|p, by| p.velocity[axis] += by));
        }
        near(adjoint.density[slot], slope(&|p, by| p.density += by));
    }

    /// The field by comparing all nodes with all particles.
    fn plainly<const D: usize>(
        mesh: &Mesh<D>,
        points: &Points<'_, CubicSpline, D>,
    ) -> Vec<Vector<f64, D>> {
        let at = |node: usize| {
            let mut sum = Vector::zero();
            for p in points.packed {
                let apart = mesh.node(node) - Vector::from_3d(p.position);
                let r = points.space.minimum_image(apart).norm();
                let volume = points.mass / p.density;
                sum += Vector::from_3d(p.velocity) * (volume * points.smoothing.value(r));
            }
            sum
        };
        (0..mesh.len()).map(at).collect()
    }

    #[test]
    fn the_field_is_the_sum_over_all_particles_and_its_adjoint_the_slope_of_the_loss() {
        for (n, reach) in [(1, 0.3), (2, 0.9), (5, 0.4), (16, 0.21), (16, 0.9), (21, 1.0)] {
            check::<2>(40, (n, reach));
            check::<3>(150, (n, reach));
        }
    }
}
