//! Neighbour search: Verlet lists with a skin, built from cells, and a brute-force search as their
//! oracle.
//!
//! ```
//! use whirls::neighbours::Neighbours;
//! use whirls::space::{Axis, Space};
//! use whirls::vector::Vector;
//!
//! // A channel: periodic along x, open along y.
//! let space = Space::new([4.0, 1.0], [Axis::Periodic, Axis::Open]);
//! let positions = [Vector([0.1, 0.5]), Vector([3.9, 0.6]), Vector([2.0, 0.5])];
//! let mut neighbours = Neighbours::<2>::new(space, 0.3, 0.05);
//! neighbours.update(positions.len(), |row| positions[row]);
//! assert_eq!(neighbours.listed(), [(0, 1), (1, 0)]);
//! ```
//!
//! How it works, in the order in which a rebuild goes:
//!
//! 1. **Fixed point** ([`fixed_point`]). Positions become whole numbers, in steps of one length along
//!    all axes, 2³² to the side of a periodic cube: differences wrap around as the cube does. In a
//!    rectangular box the period of an axis is added to the cells beyond its boundary; an open axis
//!    is embedded in a period that is too long for any image to be met.
//! 2. **Cells** ([`cells`]). Space is divided into cells at least `2h + skin` wide, and particles are
//!    sorted by them, stably, so that one cell's particles are consecutive *slots*. [`order`] leads
//!    from slots to the rows of the World and back.
//! 3. **Lists** (`build.rs`). The candidates of a cell, all particles in the 3ᵈ cells around, are
//!    gathered once for all its particles as 16-bit coordinates relative to the cell, sixteen at a
//!    time. Their distances are compared as integers, the same on every instruction set; only those
//!    too close to the limit to tell are compared again in `f64`.
//! 4. **Chunks** ([`chunk`]). Lists of 256 consecutive slots are stored together, padded to whole
//!    eights for the lanes of the pair loops, as 16-bit distances from a base where these suffice. A
//!    flag says which particles may meet a neighbour across the boundary before the next rebuild:
//!    only those need the nearest image.
//! 5. **Displacements** (`displacement.rs`). Lists stay valid until two neighbours may have approached
//!    each other by the skin. Displacements are bounded cell by cell and compared with those of the
//!    cells around, so that a wind that carries all particles costs no rebuild.
//! 6. **Active pairs** ([`near`]). The summation of densities notes which listed neighbours are
//!    within the support; all later loops of the step run over these.
//!
//! The cost is linear in `N`. Lists hold directed pairs in a fixed order, so that every sum has the
//! same bits for any number of threads. The skin does not change results: pairs between `2h` and
//! `2h + skin` contribute exact zeros.

#[doc(hidden)]
pub mod cells;
#[doc(hidden)]
pub mod chunk;
pub mod fixed_point;
#[doc(hidden)]
pub mod list_builder;
#[doc(hidden)]
pub mod near;
pub mod order;

mod build;
mod displacement;

use crate::packed::Packed;
use crate::pairs::MAX_BLOCKS_PER_TASK;
pub use crate::pairs::{CHUNK, Chunk};
use crate::pool::Pool;
use crate::scalar::{WIDTH, dispatch};
use crate::space::Space;
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use build::{ListPass, ListScratch};
use cells::{Cells, MIN_PARALLEL_LEN};
use displacement::Displacements;
use fixed_point::FixedPoint;
use order::Order;
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
    pub(crate) embedded: Space,
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
    displacements: Displacements,
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
            displacements: Displacements::default(),
            benches: Pool::default(),
        }
    }

    /// The same list, which keeps the positions that it is built from.
    pub fn with_reference(self) -> Self {
        Self { reference: Some(Vec::new()), ..self }
    }

    /// Rows and slots of the last rebuild.
    pub fn order(&self) -> &Order {
        self.cells.order()
    }

    /// The listed pairs of rows `(i, j)`, in ascending order: all pairs within support and skin at
    /// the last rebuild. For up to 65 535 particles; lists of more may be padded with a particle out
    /// of reach.
    pub fn listed(&self) -> Vec<(usize, usize)> {
        let order = self.order();
        let mut pairs = Vec::new();
        for chunk in self.chunks.iter() {
            for k in 0..chunk.len() {
                let own = order.row(chunk.first + k);
                // The sentinel pads a list.
                let slots = chunk.slots_of(k).filter(|&slot| slot < order.len());
                pairs.extend(slots.map(|slot| (own, order.row(slot))));
            }
        }
        pairs.sort_unstable();
        pairs
    }

    /// Number of directed pairs closer than the support, of particles in the order of slots.
    pub fn pairs(&self, particles: &[Packed]) -> u64 {
        let within = |chunk: &Chunk, k: usize| {
            let here = Vector::<f64, D>::from_3d(particles[chunk.first + k].position);
            // The sentinel is no particle.
            let near = |&j: &usize| {
                particles.get(j).is_some_and(|there| {
                    let there = Vector::from_3d(there.position);
                    let apart = self.space.minimum_image(here - there);
                    apart.norm_squared() < self.support * self.support
                })
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
        lists + reference + places + self.cells.bytes() + self.displacements.bytes()
    }

    /// Bounds of displacements, in bytes.
    pub fn bytes_of_bounds(&self) -> usize {
        self.displacements.bytes()
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

    /// Builds the lists as they were built from `reference`.
    pub fn restore(&mut self, reference: &[Vector<f64, D>]) {
        self.build(reference.len(), |row| reference[row]);
    }

    /// Puts back the lists of an earlier evaluation: its slots, by exchange, and its box. The next
    /// update rebuilds everything.
    pub(crate) fn rewind(
        &mut self,
        chunks: Arc<Vec<Chunk>>,
        slot_of_row: &mut Vec<u32>,
        embedded: Space,
    ) {
        self.cells.order.exchange(slot_of_row);
        (self.chunks, self.embedded, self.valid) = (chunks, embedded, false);
    }

    /// Brings the lists up to date with the positions of `count` particles, given by row, inside the
    /// box along its periodic axes. The lists are rebuilt if two neighbours may have moved a skin
    /// apart since the last rebuild.
    pub fn update(&mut self, count: usize, position: impl Fn(usize) -> Vector<f64, D> + Sync) {
        if !(self.valid && self.order().len() == count && self.still_hold(&position)) {
            self.build(count, position);
        }
    }

    /// Whether the lists hold all pairs within the support at these positions.
    fn still_hold(&mut self, position: impl Fn(usize) -> Vector<f64, D> + Sync) -> bool {
        let farthest = self.displacements.bound((&self.cells, &self.columns), position);
        // If no particle has moved half a skin, no two particles have moved a skin apart.
        let steps = self.cells.fixed_point().steps_per_length();
        // Each rounded coordinate has an error of half a step.
        farthest < (0.5 * self.skin * steps - 4.0).max(0.0).powi(2)
            || !self.displacements.tears(&self.cells, (self.skin, self.carried()))
    }

    /// Largest displacement of a particle between two rebuilds.
    fn carried(&self) -> f64 {
        CARRIED * self.support
    }

    /// Sorts the particles by positions, given by row, and builds the lists from them.
    fn build(&mut self, count: usize, position: impl Fn(usize) -> Vector<f64, D> + Sync) {
        self.rebuilds += 1;
        self.valid = true;
        if let Some(reference) = &mut self.reference {
            reference.clear();
            reference.extend((0..count).map(&position));
        }
        let reach = (self.support + self.skin, self.carried());
        let margin = reach.0 + reach.1;
        let fixed_point = FixedPoint::new(self.space, margin, (0..count).map(&position));
        self.embedded = fixed_point.space();
        self.cells.sort_by(count, &position, fixed_point, reach.0);
        self.displacements.resize(self.cells.count());
        let (cells, space) = (&self.cells, self.space);
        self.columns.iter_mut().for_each(|column| column.resize(count + 2 * WIDTH, 0));
        let columns = self.columns.each_mut().map(|column| &mut column[..count]);
        fix(columns, cells.order().rows(), &|row| fixed_point.of(position(row)));
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
