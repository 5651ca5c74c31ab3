//! The field loss `L_f`: the smoothed velocity field on a mesh, compared with the truth's.
//!
//! Equation numbers are those of Woodward et al., arXiv:2110.13311: see `docs/equations.md`.

use super::StateAdjoint;
use super::lattice::{Meet, PaddedGrid, load_at, store_at};
use super::mesh::Mesh;
use crate::kernel::{Kernel, Smoothing};
use crate::neighbours::cells::{Cells, counting_sort};
use crate::packed::Packed;
use crate::scalar::{SimdFloat, SimdTask, dispatch_doubles_by_kernel};
use crate::space::Space;
use crate::vector::Vector;
use rayon::prelude::*;
use std::ops::Range;

/// Nodes per parallel task. It is fixed, so that sums have the same bits for any number of threads.
pub(super) const CHUNK: usize = 256;

/// Grid planes per particle-to-grid task, minimum. A task also writes the planes that its last
/// particles reach, and these are added to the planes of other tasks: thin tasks repeat that work.
const FEWEST_PLANES: usize = 8;

/// Nodes per particle-to-grid task, minimum.
const FEWEST_NODES: usize = 1024;

/// The particles of which a field is evaluated.
#[derive(Clone, Copy, Debug)]
pub struct Points<'a, K, const D: usize> {
    /// Positions, velocities and densities, in the order of `cells`.
    pub packed: &'a [Packed],
    /// Cells wide enough for the support plus the displacements since they were sorted.
    pub cells: &'a Cells<D>,
    /// The box.
    pub space: Space,
    /// The kernel.
    pub smoothing: &'a Smoothing<K, D>,
    /// Mass of a particle.
    pub mass: f64,
}

/// Sums every component over its lanes.
#[inline(always)]
pub(super) fn sum_lanes<W: SimdFloat, const D: usize>(vector: &Vector<W, D>) -> Vector<f64, D> {
    let mut sum = Vector::zero();
    for axis in 0..D {
        sum[axis] = vector[axis].sum();
    }
    sum
}

/// Particles sorted by the first plane of nodes that they reach; in slot order within a plane.
struct Bins {
    /// Index in `slots` of each plane's first particle, and the total at the end.
    start: Vec<u32>,
    slots: Vec<u32>,
}

impl Bins {
    fn new<const D: usize>(lattice: &PaddedGrid<D>, packed: &[Packed]) -> Self {
        let plane = |p: &Packed| lattice.first(p.position[D - 1]) as u32;
        let mut planes: Vec<u32> = packed.par_iter().with_min_len(CHUNK).map(plane).collect();
        let (mut start, mut slots) = (Vec::new(), Vec::new());
        counting_sort(&mut planes, lattice.per_axis[D - 1], &mut start, &mut slots);
        Self { start, slots }
    }

    /// The slots of particles that reach this plane first.
    #[inline(always)]
    fn of(&self, plane: usize) -> &[u32] {
        &self.slots[self.start[plane] as usize..self.start[plane + 1] as usize]
    }
}

/// One particle-to-grid task: the particles that reach one of `planes` first.
struct Givers<'a, K, const D: usize> {
    points: &'a Points<'a, K, D>,
    lattice: PaddedGrid<D>,
    bins: &'a Bins,
    /// Their first planes.
    planes: Range<usize>,
}

impl<K: Kernel, const D: usize> Givers<'_, K, D> {
    /// Deposits the particles on padded planes, counted from the first of `planes` and continued
    /// across the periodic boundary.
    fn find(&self) -> [Vec<f64>; D] {
        let Self { lattice, planes, .. } = self;
        let numbers = lattice.planes(planes.len()) * lattice.numbers_per_plane();
        let mut columns = [(); D].map(|()| vec![0.0; numbers]);
        for plane in planes.clone() {
            let pass = GivePass {
                points: self.points,
                lattice,
                slots: self.bins.of(plane),
                plane: planes.start,
                columns: &mut columns,
            };
            let is_table = self.points.smoothing.is_table();
            dispatch_doubles_by_kernel(is_table, pass);
        }
        columns
    }
}

/// Adds the padded rows of a plane to its nodes.
fn fold<const D: usize>(rows: [&[f64]; D], lattice: &PaddedGrid<D>, nodes: &mut [Vector<f64, D>]) {
    let PaddedGrid { per_axis, width, .. } = *lattice;
    for (number, nodes) in nodes.chunks_exact_mut(per_axis[0]).enumerate() {
        for axis in 0..D {
            let mut row = &rows[axis][number * width..][..width];
            while !row.is_empty() {
                let (now, beyond) = row.split_at(per_axis[0].min(row.len()));
                nodes.iter_mut().zip(now).for_each(|(node, x)| node[axis] += x);
                row = beyond;
            }
        }
    }
}

/// Particle-to-grid: `V += (m/ρⱼ) vⱼ W` at the nodes in reach.
struct GivePass<'a, K, const D: usize> {
    points: &'a Points<'a, K, D>,
    lattice: &'a PaddedGrid<D>,
    /// Slots of the particles.
    slots: &'a [u32],
    /// Index of the first plane.
    plane: usize,
    columns: &'a mut [Vec<f64>; D],
}

impl<K: Kernel, const D: usize> SimdTask for GivePass<'_, K, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Self { points, lattice, slots, plane, columns } = self;
        for &slot in slots {
            let particle = &points.packed[slot as usize];
            let volume = points.mass / particle.density;
            let mut given = Vector::<W, D>::zero();
            for axis in 0..D {
                given[axis] = W::of(particle.velocity[axis] * volume);
            }
            let mut giver = Giver { smoothing: points.smoothing, given, columns: &mut *columns };
            lattice.around(Vector::from_3d(particle.position), plane, &mut giver);
        }
    }
}

/// One particle of a particle-to-grid transfer.
struct Giver<'a, W, K, const D: usize> {
    smoothing: &'a Smoothing<K, D>,
    /// `(m/ρⱼ) vⱼ`.
    given: Vector<W, D>,
    columns: &'a mut [Vec<f64>; D],
}

impl<W: SimdFloat, K: Kernel, const D: usize> Meet<W, D> for Giver<'_, W, K, D> {
    #[inline(always)]
    fn meet(&mut self, places: [usize; 2], _: &Vector<W, D>, square: W) {
        let weight = self.smoothing.value(square.sqrt());
        for axis in 0..D {
            let column = &mut self.columns[axis];
            let sum = load_at::<W>(column, places) + weight * self.given[axis];
            store_at(column, places, sum);
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
    let lattice = PaddedGrid::new(mesh, points.smoothing.support());
    let bins = &Bins::new(&lattice, points.packed);
    let n = mesh.per_axis[D - 1];
    let plane = mesh.len() / n;
    let planes = FEWEST_PLANES.max(FEWEST_NODES.div_ceil(plane)).min(n);
    let tasks = (0..n.div_ceil(planes)).into_par_iter();
    let givers = tasks.map(|task| {
        let planes = task * planes..n.min((task + 1) * planes);
        Givers { points, lattice, bins, planes }
    });
    let given: Vec<_> = givers.map(|givers| givers.find()).collect();
    let numbers = lattice.numbers_per_plane();
    nodes.par_chunks_mut(plane).enumerate().for_each(|(plane, nodes)| {
        for (task, columns) in given.iter().enumerate() {
            let mut first = (plane + n - task * planes) % n * numbers;
            while first < columns[0].len() {
                fold(
                    columns.each_ref().map(|column| &column[first..first + numbers]),
                    &lattice,
                    nodes,
                );
                first += n * numbers;
            }
        }
    });
    nodes
}

/// Only the value of [`super::field_loss`].
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

/// The value of [`super::field_loss`], and its derivative by each particle's position (at fixed
/// density), velocity and density, by a grid-to-particle transfer.
pub fn field_adjoint<K: Kernel, const D: usize>(
    mesh: &Mesh<D>,
    points: &Points<'_, K, D>,
    (truth, weight): (&[Vector<f64, D>], f64),
) -> StateAdjoint<D> {
    let weight = weight / (mesh.len() * D) as f64;
    let mut nodes = field(mesh, points);
    let mut value = 0.0;
    for (node, expected) in nodes.iter_mut().zip(truth) {
        let difference = *node - *expected;
        value += weight * difference.norm_squared();
        *node = difference * (2.0 * weight);
    }
    StateAdjoint { value, ..pull_back_nodes(mesh, points, &nodes) }
}

/// The derivative by each particle's position (at fixed density), velocity and density, from `λ = ∂L/∂V` at the nodes.
pub(crate) fn pull_back_nodes<K: Kernel, const D: usize>(
    mesh: &Mesh<D>,
    points: &Points<'_, K, D>,
    nodes: &[Vector<f64, D>],
) -> StateAdjoint<D> {
    let mut adjoint = StateAdjoint::zero(points.packed.len());
    if mesh.is_empty() {
        return adjoint;
    }
    let lattice = PaddedGrid::new(mesh, points.smoothing.support());
    let nodes = &unfold(nodes, &lattice);
    let columns =
        adjoint.position.par_chunks_mut(CHUNK).zip(adjoint.velocity.par_chunks_mut(CHUNK));
    let columns = columns.zip(adjoint.density.par_chunks_mut(CHUNK));
    let chunks = columns.zip(points.packed.par_chunks(CHUNK));
    chunks.for_each(|(((position, velocity), density), particles)| {
        let into = (position, velocity, density);
        let pass = TakePass { points, lattice: &lattice, nodes, particles, into };
        let is_table = points.smoothing.is_table();
        dispatch_doubles_by_kernel(is_table, pass);
    });
    adjoint
}

/// The values at all nodes, axis by axis, as padded rows and planes: each row, and the sequence of
/// planes, is continued periodically past its end.
fn unfold<const D: usize>(nodes: &[Vector<f64, D>], lattice: &PaddedGrid<D>) -> [Vec<f64>; D] {
    let numbers = lattice.planes(lattice.per_axis[D - 1]) * lattice.numbers_per_plane();
    let again = lattice.width - lattice.per_axis[0];
    let mut columns = [(); D].map(|()| Vec::with_capacity(numbers));
    for (axis, column) in columns.iter_mut().enumerate() {
        for row in nodes.chunks_exact(lattice.per_axis[0]) {
            column.extend(row.iter().map(|node| node[axis]));
            column.extend(row.iter().cycle().take(again).map(|node| node[axis]));
        }
        column.extend_from_within(..numbers - column.len());
    }
    columns
}

/// Grid-to-particle: from `λ = ∂L/∂V` at the nodes, with `s = λ·vⱼ` and `x − rⱼ` from particle to
/// node, `∂L/∂vⱼ = (m/ρⱼ) Σ λ W`, `∂L/∂rⱼ = −(m/ρⱼ) Σ s G (x − rⱼ)`, `∂L/∂ρⱼ = −(m/ρⱼ²) Σ s W`.
struct TakePass<'a, K, const D: usize> {
    points: &'a Points<'a, K, D>,
    lattice: &'a PaddedGrid<D>,
    nodes: &'a [Vec<f64>; D],
    /// The particles.
    particles: &'a [Packed],
    into: (&'a mut [Vector<f64, D>], &'a mut [Vector<f64, D>], &'a mut [f64]),
}

impl<K: Kernel, const D: usize> SimdTask for TakePass<'_, K, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Self { points, lattice, nodes, particles, into } = self;
        for (k, particle) in particles.iter().enumerate() {
            let zero = Vector::zero();
            let mut own = zero;
            for axis in 0..D {
                own[axis] = W::of(particle.velocity[axis]);
            }
            let sums = TakenSums { position: zero, velocity: zero, density: W::of(0.0) };
            let mut taker = Taker { smoothing: points.smoothing, nodes, own, sums };
            lattice.around(Vector::from_3d(particle.position), 0, &mut taker);
            let (sums, volume) = (taker.sums, points.mass / particle.density);
            into.0[k] = sum_lanes(&sums.position) * volume;
            into.1[k] = sum_lanes(&sums.velocity) * volume;
            into.2[k] = sums.density.sum() * volume / particle.density;
        }
    }
}

/// One particle of a grid-to-particle transfer.
struct Taker<'a, W, K, const D: usize> {
    smoothing: &'a Smoothing<K, D>,
    nodes: &'a [Vec<f64>; D],
    /// `vⱼ`.
    own: Vector<W, D>,
    sums: TakenSums<W, D>,
}

/// Its sums, without the factor `m/ρⱼ`.
struct TakenSums<W, const D: usize> {
    position: Vector<W, D>,
    velocity: Vector<W, D>,
    density: W,
}

impl<W: SimdFloat, K: Kernel, const D: usize> Meet<W, D> for Taker<'_, W, K, D> {
    #[inline(always)]
    fn meet(&mut self, places: [usize; 2], apart: &Vector<W, D>, square: W) {
        let r = square.sqrt();
        let weight = self.smoothing.value(r);
        let mut cotangent = Vector::<W, D>::zero();
        for axis in 0..D {
            cotangent[axis] = load_at(&self.nodes[axis], places);
        }
        let along = cotangent.dot(self.own);
        self.sums.position -= *apart * (self.smoothing.dw_over_r(r) * along);
        self.sums.velocity += cotangent * weight;
        self.sums.density -= weight * along;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernel::CubicSpline;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Particles at random positions in the box, with fields at `n` nodes along an axis, and a
    /// kernel of support `reach`.
    fn check<const D: usize>(particles: usize, (n, reach): (usize, f64)) {
        let (length, mut random) = (2.0, ChaCha8Rng::seed_from_u64(n as u64));
        let mut number = |_| random.random_range(0.0..length);
        let line = |_| Packed {
            position: Vector::<f64, D>(std::array::from_fn(&mut number)).to_3d(),
            velocity: Vector::<f64, D>(std::array::from_fn(&mut number)).to_3d(),
            density: 0.5 + number(0),
            p_over_rho2: 0.0,
        };
        let mut packed: Vec<Packed> = (0..particles).map(line).collect();
        packed[0].position = [0.0; 3];
        let (space, cells) = (Space::cube(length), Cells::default());
        let smoothing = &Smoothing::<CubicSpline, D>::new(0.5 * reach);
        let points = Points { packed: &packed, cells: &cells, space, smoothing, mass: 0.3 };
        let mesh = Mesh::cube(length, n);
        let truth: Vec<_> = (0..mesh.len()).map(|k| mesh.node(k) * 0.7).collect();
        let (plain, found) = (plainly(&mesh, &points), field(&mesh, &points));
        for (plain, found) in plain.iter().zip(&found) {
            assert!((*plain - *found).norm() < 1e-12 * (1.0 + plain.norm()), "{plain:?} {found:?}");
        }
        let adjoint = field_adjoint(&mesh, &points, (&truth, 1.0));
        assert_eq!(adjoint.value.to_bits(), field_value(&mesh, &points, (&truth, 1.0)).to_bits());
        // Central differences by every coordinate of one particle.
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
