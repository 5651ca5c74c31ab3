//! Who may touch whom: a cell list with a skin, and brute force beside it as the oracle.
//!
//! Space is cut into cells of at least `2h + skin`; each particle's list holds everyone within that
//! radius, and stays valid until some particle has moved half a skin. Cost is linear in `N`, and the
//! lists hold directed pairs in a fixed order, so that every sum has the same bits for any number of
//! threads. The skin buys speed only: pairs between `2h` and `2h + skin` contribute exact zeros.

use super::particles::{Acceleration, Cloud, Position, Velocity};
use super::verlet::Integrator;
use crate::cells::{Around, Cells};
use crate::packed::{Packed, PackedSingle};
pub use crate::pairs::{CHUNK, Chunk};
use crate::scalar::{Pass, WIDTH, Wide, dispatch};
use crate::space::PeriodicBox;
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use rayon::prelude::*;
use std::sync::Arc;

/// Fewer particles than this are not worth another thread.
const FEWEST: usize = 4096;

/// What the lists of one chunk are built from.
struct ListPass<'a, const D: usize> {
    chunk: &'a mut Chunk,
    /// Fixed-point coordinates in cell order, axis by axis, with two [`WIDTH`] more behind them.
    columns: &'a [Vec<i32>; D],
    packed: &'a [Packed],
    cells: &'a Cells<D>,
    space: PeriodicBox,
    /// How far the lists reach, and how much of it is skin.
    reach: (f64, f64),
}

impl<const D: usize> Pass for ListPass<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(self) {
        let Self { packed, cells, columns, .. } = self;
        let count = packed.len() - 1;
        let limits = PackedSingle::limits(self.reach.0, self.space);
        self.chunk.clear();
        let (mut around, mut cell) = (Around::NONE, None);
        for slot in self.chunk.first..(self.chunk.first + CHUNK).min(count) {
            // Particles of one cell follow each other.
            let coordinates = cells.coordinates(Vector::from_3d(packed[slot].position));
            if cell != Some(coordinates) {
                (around, cell) = (cells.around(coordinates), Some(coordinates));
            }
            let mut here = [0; D];
            for (here, column) in here.iter_mut().zip(columns) {
                *here = column[slot];
            }
            self.chunk.open(around.candidates());
            for range in around.ranges() {
                let end = range.to as usize;
                for first in (range.from as usize..end).step_by(2 * WIDTH) {
                    let inside = u16::MAX >> (2 * WIDTH - (end - first).min(2 * WIDTH));
                    let [mut near, maybe] = W::near(columns, here, first, limits);
                    if near != maybe {
                        near |= self.look_closer(slot, first, maybe & inside & !near);
                    }
                    let own = slot.wrapping_sub(first);
                    let own = if own < 2 * WIDTH { 1 << own } else { 0 };
                    self.chunk.append_mask::<W>(near & inside & !own, first);
                }
            }
            self.chunk.close(count, self.is_near_seam(slot));
        }
        self.chunk.finish();
    }
}

impl<const D: usize> ListPass<'_, D> {
    /// Which of the slots in a mask, from `first` on, are in reach, in doubles.
    #[cold]
    fn look_closer(&self, slot: usize, first: usize, mask: u16) -> u16 {
        let place = |slot: usize| Vector::<f64, D>::from_3d(self.packed[slot].position);
        let near = |bit: &usize| {
            // Outside of the mask there may be nobody.
            mask >> bit & 1 == 1 && {
                let apart = self.space.minimum_image(place(slot) - place(first + bit));
                apart.norm_squared() < self.reach.0 * self.reach.0
            }
        };
        (0..2 * WIDTH).filter(near).fold(0, |found, bit| found | 1 << bit)
    }

    /// Whether, before the lists are built anew, the particle or a neighbour of it may cross the seam of
    /// the box.
    #[inline(always)]
    fn is_near_seam(&self, slot: usize) -> bool {
        let (reach, skin) = self.reach;
        let margin = reach + skin;
        let mut near = false;
        for axis in 0..D {
            let x = self.packed[slot].position[axis];
            near |= x < margin || x > self.space.length - margin;
        }
        near
    }
}

/// The neighbour list of a World.
#[derive(Resource, Clone, Debug)]
pub struct Neighbours<const D: usize> {
    /// The box.
    pub space: PeriodicBox,
    /// Radius of the kernel, `2h`.
    pub support: f64,
    /// How much farther the lists reach.
    pub skin: f64,
    /// Cells of the last rebuild.
    pub cells: Cells<D>,
    /// Lists, [`CHUNK`] slots each; shared with the tape of an adjoint.
    pub chunks: Arc<Vec<Chunk>>,
    /// How often the lists were rebuilt.
    pub rebuilds: u64,
    /// Positions by row at the last rebuild.
    reference: Vec<Vector<f64, D>>,
    positions: Vec<Vector<f64, D>>,
    /// Fixed-point coordinates in cell order at the last rebuild.
    columns: [Vec<i32>; D],
}

impl<const D: usize> Neighbours<D> {
    /// An empty list; the first use builds it.
    pub fn new(space: PeriodicBox, support: f64, skin: f64) -> Self {
        Self {
            space,
            support,
            skin,
            cells: Cells::default(),
            chunks: Arc::default(),
            rebuilds: 0,
            reference: Vec::new(),
            positions: Vec::new(),
            columns: std::array::from_fn(|_| Vec::new()),
        }
    }

    /// Directed pairs closer than the support.
    pub fn pairs(&self, cloud: &Cloud<D>) -> u64 {
        let within = |chunk: &Chunk, k: usize| {
            let here = Vector::<f64, D>::from_3d(cloud.packed[chunk.first + k].position);
            let near = |&&j: &&u32| {
                let there = Vector::from_3d(cloud.packed[j as usize].position);
                let apart = self.space.minimum_image(here - there);
                apart.norm_squared() < self.support * self.support
            };
            chunk.neighbours(k).as_flattened().iter().filter(near).count() as u64
        };
        self.chunks
            .iter()
            .map(|chunk| (0..chunk.len()).map(|k| within(chunk, k)).sum::<u64>())
            .sum()
    }

    /// Bytes held by the lists.
    pub fn bytes(&self) -> usize {
        let vectors = self.reference.capacity() + self.positions.capacity();
        let per_row = 8 * D * vectors + 4 * D * self.columns[0].capacity();
        self.chunks.iter().map(Chunk::bytes).sum::<usize>() + per_row + self.cells.bytes()
    }

    /// Forgets the lists, so that the next step builds them anew.
    pub fn invalidate(&mut self) {
        self.reference.clear();
    }

    /// Positions by row at the last rebuild: what the lists, and the order of every sum, follow from.
    pub fn reference(&self) -> &[Vector<f64, D>] {
        &self.reference
    }

    /// Builds the lists as they were built from `reference`.
    pub fn restore(&mut self, reference: &[Vector<f64, D>], cloud: &mut Cloud<D>) {
        self.positions.clear();
        self.positions.extend_from_slice(reference);
        self.reference.clear();
        self.update(cloud);
    }

    fn is_stale(&self) -> bool {
        let limit = 0.25 * self.skin * self.skin;
        let moved = |(&now, &then): (&Vector<f64, D>, &Vector<f64, D>)| {
            let moved = self.space.minimum_image(now - then).norm_squared();
            moved.is_nan() || moved >= limit
        };
        let rows = self.positions.par_iter().zip(&self.reference).with_min_len(FEWEST);
        self.reference.len() != self.positions.len() || rows.any(moved)
    }

    /// Builds the lists if some particle has moved half a skin since they were built, and puts the
    /// positions of `self.positions` into the cloud.
    fn update(&mut self, cloud: &mut Cloud<D>) {
        let stale = self.is_stale();
        if stale {
            self.reference.clone_from(&self.positions);
            cloud.resize(self.positions.len());
            self.cells.sort(&self.positions, self.space, self.support + self.skin);
            for (slot, &row) in self.cells.row_of_slot.iter().enumerate() {
                cloud.slot_of_row[row as usize] = slot as u32;
            }
        }
        for (&position, &slot) in self.positions.iter().zip(&cloud.slot_of_row) {
            cloud.packed[slot as usize].position = position.to_3d();
        }
        if stale {
            self.build(cloud);
        }
    }

    fn build(&mut self, cloud: &Cloud<D>) {
        self.rebuilds += 1;
        let reach = (self.support + self.skin, self.skin);
        for (axis, column) in self.columns.iter_mut().enumerate() {
            column.clear();
            column.reserve_exact(cloud.len() + 2 * WIDTH);
            column.resize(cloud.len() + 2 * WIDTH, 0);
            let rows = column.par_iter_mut().zip(cloud.particles()).with_min_len(FEWEST);
            rows.for_each(|(x, p)| *x = PackedSingle::fixed_point(p.position[axis], self.space));
        }
        // Lists that the tape still needs stay there; otherwise their memory is used again.
        let mut chunks = Arc::try_unwrap(std::mem::take(&mut self.chunks)).unwrap_or_default();
        chunks.resize(cloud.len().div_ceil(CHUNK), Chunk::default());
        let (columns, cells, space) = (&self.columns, &self.cells, self.space);
        let packed = &cloud.packed[..];
        chunks.par_iter_mut().enumerate().for_each(|(number, chunk)| {
            chunk.first = number * CHUNK;
            dispatch(ListPass { chunk, columns, packed, cells, space, reach });
        });
        self.chunks = Arc::new(chunks);
    }
}

/// Every directed pair closer than `radius`, as `(i, j)` in ascending order, by comparing all with
/// all: the oracle of the cell list.
pub fn brute_force<const D: usize>(
    positions: &[Vector<f64, D>],
    space: PeriodicBox,
    radius: f64,
) -> Vec<(usize, usize)> {
    let near = |i: usize, j: usize| {
        space.minimum_image(positions[i] - positions[j]).norm_squared() < radius * radius
    };
    let all = 0..positions.len();
    all.clone()
        .flat_map(|i| all.clone().filter(move |&j| i != j && near(i, j)).map(move |j| (i, j)))
        .collect()
}

/// System: brings the neighbour lists and the packed positions up to date.
pub fn find_neighbours<const D: usize>(
    positions: Query<&Position<D>>,
    mut neighbours: ResMut<Neighbours<D>>,
    mut cloud: ResMut<Cloud<D>>,
) {
    let neighbours = &mut *neighbours;
    neighbours.positions.clear();
    for column in positions.contiguous_iter().into_iter().flatten() {
        neighbours.positions.extend(column.iter().map(|r| r.0));
    }
    neighbours.update(&mut cloud);
}

/// System: packs the velocity that the next force evaluation sees.
pub fn pack_velocities<const PREDICTED: bool, const D: usize>(
    particles: Query<(&Velocity<D>, &Acceleration<D>)>,
    integrator: Res<Integrator>,
    mut cloud: ResMut<Cloud<D>>,
) {
    let Cloud { packed, slot_of_row, .. } = &mut *cloud;
    let half_step = if PREDICTED { 0.5 * integrator.dt } else { 0.0 };
    let mut slots = slot_of_row.iter();
    for (velocities, accelerations) in particles.contiguous_iter().into_iter().flatten() {
        for ((v, a), &slot) in velocities.iter().zip(accelerations).zip(&mut slots) {
            let seen = if PREDICTED { v.0 + a.0 * half_step } else { v.0 };
            packed[slot as usize].velocity = seen.to_3d();
        }
    }
    cloud.round(integrator.space);
}
