//! Who may touch whom: a cell list with a skin, and brute force beside it as the oracle.
//!
//! Space is cut into cells of at least `2h + skin`; each particle's list holds everyone within that
//! radius, and stays valid until some particle has moved half a skin. Cost is linear in `N`, and the
//! lists hold directed pairs in a fixed order, so that every sum has the same bits for any number of
//! threads. The skin buys speed only: pairs between `2h` and `2h + skin` contribute exact zeros.

use super::particles::{Acceleration, Cloud, Position, Velocity};
use super::verlet::Integrator;
use crate::cells::{Around, Cells};
use crate::packed::Packed;
pub use crate::pairs::{CHUNK, Chunk};
use crate::scalar::{Lanes, Pass, WIDTH, Wide, dispatch};
use crate::space::PeriodicBox;
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use rayon::prelude::*;
use std::sync::Arc;

/// What the lists of one chunk are built from.
struct ListPass<'a, const D: usize> {
    chunk: &'a mut Chunk,
    /// Coordinates in cell order, axis by axis, with [`WIDTH`] of nobody's behind them.
    columns: &'a [Vec<f64>; D],
    cells: &'a Cells<D>,
    space: PeriodicBox,
    reach2: f64,
}

impl<const D: usize> Pass for ListPass<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(self) {
        let Self { chunk, columns, cells, space, reach2 } = self;
        let count = columns[0].len() - WIDTH;
        chunk.clear();
        let (mut around, mut cell) = (Around::NONE, None);
        for slot in chunk.first..(chunk.first + CHUNK).min(count) {
            let mut here = Vector::<f64, D>::zero();
            for axis in 0..D {
                here[axis] = columns[axis][slot];
            }
            // Particles of one cell follow each other.
            let coordinates = cells.coordinates(here);
            if cell != Some(coordinates) {
                (around, cell) = (cells.around(coordinates), Some(coordinates));
            }
            chunk.open(around.candidates());
            for range in around.ranges() {
                let end = range.to as usize;
                for first in (range.from as usize..end).step_by(WIDTH) {
                    let apart = apart::<W::Double, D>(columns, here, first);
                    let r2 = if range.seam {
                        space.minimum_image(apart).norm_squared()
                    } else {
                        apart.norm_squared()
                    };
                    chunk.append(r2, (slot, first, end), reach2);
                }
            }
            chunk.close(count);
        }
        chunk.finish();
    }
}

/// Differences of a place and the eight from slot `first` on, without images.
#[inline(always)]
pub(crate) fn apart<W: Wide, const D: usize>(
    columns: &[Vec<f64>; D],
    here: Vector<f64, D>,
    first: usize,
) -> Vector<W, D> {
    let mut apart = Vector::zero();
    for axis in 0..D {
        let mut there = [0.0; WIDTH];
        there.copy_from_slice(&columns[axis][first..first + WIDTH]);
        apart[axis] = W::of(here[axis]) - W::load(&Lanes::new(there));
    }
    apart
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
    /// Coordinates in cell order at the last rebuild.
    columns: [Vec<f64>; D],
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
        let per_row = 8
            * D
            * (self.reference.capacity() + self.positions.capacity() + self.columns[0].capacity());
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
        self.reference.len() != self.positions.len()
            || self.positions.iter().zip(&self.reference).any(|(&now, &then)| {
                let moved = self.space.minimum_image(now - then).norm_squared();
                moved.is_nan() || moved >= limit
            })
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
        let reach = self.support + self.skin;
        for (axis, column) in self.columns.iter_mut().enumerate() {
            column.clear();
            column.extend(cloud.particles().iter().map(|p| p.position[axis]));
            column.extend([Packed::NOBODY.position[axis]; WIDTH]);
        }
        // Lists that the tape still needs stay there; otherwise their memory is used again.
        let mut chunks = Arc::try_unwrap(std::mem::take(&mut self.chunks)).unwrap_or_default();
        chunks.resize(cloud.len().div_ceil(CHUNK), Chunk::default());
        let (columns, cells, space) = (&self.columns, &self.cells, self.space);
        chunks.par_iter_mut().enumerate().for_each(|(number, chunk)| {
            chunk.first = number * CHUNK;
            let reach2 = reach * reach;
            dispatch(ListPass { chunk, columns, cells, space, reach2 });
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
