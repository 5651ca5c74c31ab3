//! Neighbour search: a cell list with a skin, and a brute-force search as its oracle.
//!
//! Space is divided into cells at least `2h + skin` wide. Each particle's list holds all particles
//! within that radius, and stays valid until two neighbours have moved a skin apart
//! (`systems/movement.rs`). The cost is linear in `N`. The lists hold directed pairs in a fixed
//! order, so that every sum has the same bits for any number of threads. The skin does not change
//! results: pairs between `2h` and `2h + skin` contribute exact zeros.

use super::lists::{ListPass, ListScratch};
use super::movement::Movement;
use super::particles::{Cloud, ParticleId, Particles, Pool, Position};
use super::term::{Stage, Term};
use super::{Needs, Occasion, Phase};
use crate::cells::{Cells, MIN_PARALLEL_LEN};
use crate::fixed_point::FixedPoint;
use crate::pairs::MAX_BLOCKS_PER_TASK;
pub use crate::pairs::{CHUNK, Chunk};
use crate::scalar::{WIDTH, dispatch};
use crate::space::Space;
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use rayon::prelude::*;
use std::sync::Arc;

/// Largest displacement of a particle between two rebuilds of the lists, in supports. Which
/// particles may cross the periodic boundary until the next rebuild is decided at the rebuild.
const CARRIED: f64 = 0.25;

/// The neighbour list of a World.
#[derive(Resource, Debug)]
pub struct Neighbours<const D: usize> {
    /// The box.
    pub space: Space,
    /// The box of the lists in use, with the length of the embedding along open axes: see
    /// [`FixedPoint`].
    pub(super) embedded: Space,
    /// Radius of the kernel, `2h`.
    pub support: f64,
    /// How much farther than the support the lists reach.
    pub skin: f64,
    /// Cells of the last rebuild.
    pub cells: Cells<D>,
    /// The lists, [`CHUNK`] slots each; shared with the tape of an adjoint.
    pub chunks: Arc<Vec<Chunk>>,
    /// Number of rebuilds.
    pub rebuilds: u64,
    /// Whether the lists may be used.
    valid: bool,
    /// Positions by row at the last rebuild, if they are requested.
    reference: Option<Vec<Vector<f64, D>>>,
    /// Fixed-point coordinates in cell order at the last rebuild, padded by two [`WIDTH`].
    columns: [Vec<i32>; D],
    /// Bounds of the displacements since the last rebuild.
    movement: Movement,
    benches: Pool<ListScratch>,
}

impl<const D: usize> Neighbours<D> {
    /// An empty list; the first use builds it. In a box that is no periodic cube the skin is at most
    /// such that the lists reach half the shortest period.
    pub fn new(space: Space, support: f64, skin: f64) -> Self {
        let skin = match space.is_periodic_cube::<D>() {
            true => skin,
            false => skin.min((0.5 * space.shortest_period::<D>() - support).max(0.0)),
        };
        Self {
            space,
            embedded: space,
            support,
            skin,
            cells: Cells::default(),
            chunks: Arc::default(),
            rebuilds: 0,
            valid: false,
            reference: None,
            columns: std::array::from_fn(|_| Vec::new()),
            movement: Movement::default(),
            benches: Pool::default(),
        }
    }

    /// The same list, which keeps the positions that it is built from.
    pub fn with_reference(self) -> Self {
        Self { reference: Some(Vec::new()), ..self }
    }

    /// Number of directed pairs closer than the support.
    pub fn pairs(&self, cloud: &Cloud<D>) -> u64 {
        let within = |chunk: &Chunk, k: usize| {
            let here = Vector::<f64, D>::from_3d(cloud.packed[chunk.first + k].position);
            let near = |&j: &usize| {
                let there = Vector::from_3d(cloud.packed[j].position);
                let apart = self.space.minimum_image(here - there);
                apart.norm_squared() < self.support * self.support
            };
            chunk.slots_of(k).filter(near).count() as u64
        };
        self.chunks
            .iter()
            .map(|chunk| (0..chunk.len()).map(|k| within(chunk, k)).sum::<u64>())
            .sum()
    }

    /// Bytes held by the lists.
    pub fn bytes(&self) -> usize {
        let reference = self.reference.as_ref().map_or(0, |reference| 8 * D * reference.capacity());
        let places: usize = self.columns.iter().map(|column| 4 * column.capacity()).sum();
        let lists: usize = self.chunks.iter().map(Chunk::bytes).sum();
        lists + reference + places + self.cells.bytes() + self.movement.bytes()
    }

    /// Bounds of displacements, in bytes.
    pub fn bytes_of_bounds(&self) -> usize {
        self.movement.bytes()
    }

    /// Discards the lists, so that the next step rebuilds them.
    pub fn invalidate(&mut self) {
        self.valid = false;
    }

    /// Positions by row at the last rebuild, from which the lists and the order of every sum
    /// follow; empty where they are not kept.
    pub fn reference(&self) -> &[Vector<f64, D>] {
        self.reference.as_deref().unwrap_or_default()
    }

    /// Builds the lists as they were built from `reference`. The caller must bring the positions in
    /// the cloud up to date.
    pub fn restore(&mut self, reference: &[Vector<f64, D>], cloud: &mut Cloud<D>) {
        self.build(reference.len(), |row| reference[row], cloud);
    }

    /// Rebuilds the lists from positions, given row by row, if two neighbours may have moved a skin
    /// apart since the last rebuild.
    fn update(&mut self, positions: &[Position<D>], cloud: &mut Cloud<D>) {
        if self.valid && cloud.len() == positions.len() && self.still_hold(positions) {
            return;
        }
        self.build(positions.len(), |row| positions[row].0, cloud);
    }

    /// Whether the lists hold all pairs within the support at these positions.
    fn still_hold(&mut self, positions: &[Position<D>]) -> bool {
        let farthest = self.movement.bound((&self.cells, &self.columns), positions);
        // If no particle has moved half a skin, no two particles have moved a skin apart.
        let steps = self.cells.fixed_point().steps_per_length();
        // Each rounded coordinate has an error of half a step.
        farthest < (0.5 * self.skin * steps - 4.0).max(0.0).powi(2)
            || !self.movement.tears(&self.cells, (self.skin, self.carried()))
    }

    /// Largest displacement of a particle between two rebuilds.
    fn carried(&self) -> f64 {
        CARRIED * self.support
    }

    /// Sorts the cloud by positions, given by row, and builds the lists from them.
    fn build(
        &mut self,
        count: usize,
        position: impl Fn(usize) -> Vector<f64, D> + Sync,
        cloud: &mut Cloud<D>,
    ) {
        self.rebuilds += 1;
        self.valid = true;
        if let Some(reference) = &mut self.reference {
            reference.clear();
            reference.extend((0..count).map(&position));
        }
        cloud.resize(count);
        let reach = (self.support + self.skin, self.carried());
        let margin = reach.0 + reach.1;
        let fixed_point = FixedPoint::new(self.space, margin, (0..count).map(&position));
        self.embedded = fixed_point.space();
        self.cells.sort_by(&position, fixed_point, reach.0, &mut cloud.slot_of_row);
        self.movement.resize(self.cells.count());
        let (cells, space) = (&self.cells, self.space);
        self.columns.iter_mut().for_each(|column| column.resize(count + 2 * WIDTH, 0));
        let columns = self.columns.each_mut().map(|column| &mut column[..count]);
        fix(columns, &cells.row_of_slot, &|row| fixed_point.of(position(row)));
        // Lists that the tape still needs stay there; otherwise their memory is reused.
        let mut chunks = Arc::get_mut(&mut self.chunks).map(std::mem::take).unwrap_or_default();
        chunks.resize(count.div_ceil(CHUNK), Chunk::default());
        let (columns, benches, position) = (&self.columns, &self.benches, &position);
        let tasks = chunks.par_iter_mut().enumerate().with_max_len(MAX_BLOCKS_PER_TASK);
        tasks.for_each(|(number, chunk)| {
            let first = number * CHUNK;
            let pass = ListPass { first, columns, position, cells, space, reach };
            benches.lend(ListScratch::default, |bench| {
                dispatch((pass, bench, chunk));
            });
        });
        ListScratch::level(self.benches.rest());
        match Arc::get_mut(&mut self.chunks) {
            Some(own) => *own = chunks,
            None => self.chunks = Arc::new(chunks),
        }
    }
}

/// Fills columns with fixed-point coordinates, given by row, in the order of the slots.
fn fix<const D: usize>(
    mut columns: [&mut [i32]; D],
    row_of_slot: &[u32],
    place: &(impl Fn(usize) -> [i32; D] + Sync),
) {
    if row_of_slot.len() < 2 * MIN_PARALLEL_LEN {
        for (slot, &row) in row_of_slot.iter().enumerate() {
            for (column, x) in columns.iter_mut().zip(place(row as usize)) {
                column[slot] = x;
            }
        }
        return;
    }
    let middle = row_of_slot.len() / 2;
    let (rows, last_rows) = row_of_slot.split_at(middle);
    let mut last: [&mut [i32]; D] = std::array::from_fn(|_| Default::default());
    for (column, last) in columns.iter_mut().zip(&mut last) {
        (*column, *last) = std::mem::take(column).split_at_mut(middle);
    }
    rayon::join(|| fix(columns, rows, place), || fix(last, last_rows, place));
}

/// Every directed pair closer than `radius`, as `(i, j)` in ascending order, found by comparing all
/// pairs: the oracle of the cell list.
pub fn brute_force<const D: usize>(
    positions: &[Vector<f64, D>],
    space: Space,
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

/// Term: the neighbour lists.
#[derive(Clone, Copy, Debug)]
pub struct NeighbourSearch;

impl<const D: usize> Term<D> for NeighbourSearch {
    fn name(&self) -> String {
        "neighbours".to_owned()
    }

    fn stages(&self, occasion: Occasion, _: &Needs) -> Vec<Stage> {
        let stage = || Stage::constant(Phase::Neighbours, find_neighbours::<D>);
        if occasion.has_densities() { vec![stage()] } else { Vec::new() }
    }
}

/// System: brings the neighbour lists, and the order of the cloud, up to date.
pub fn find_neighbours<const D: usize>(
    positions: Query<(&ParticleId, &Position<D>)>,
    particles: Res<Particles>,
    mut neighbours: ResMut<Neighbours<D>>,
    mut cloud: ResMut<Cloud<D>>,
) {
    let tables = positions.contiguous_iter().into_iter().flatten();
    let positions = particles.gather(tables, Position(Vector::zero()));
    neighbours.update(&positions, &mut cloud);
}
