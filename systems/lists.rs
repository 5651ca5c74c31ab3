//! The lists of one chunk of particles: who of the cells around is in reach.

use crate::cells::Cells;
use crate::chunk::FEW;
use crate::packed::PackedSingle;
use crate::pairs::{CHUNK, Chunk, Draft};
use crate::scalar::{Pass, WIDTH, Wide};
use crate::space::PeriodicBox;
use crate::vector::Vector;

/// What a thread needs while it builds the lists of a chunk, used again for the next.
#[derive(Clone, Debug)]
pub(super) struct Workbench<const D: usize> {
    /// Fixed-point coordinates of everyone who may be near somebody of one cell, with two [`WIDTH`] more.
    columns: [Vec<i32>; D],
    /// Their slots.
    slots: Vec<u32>,
    /// How many they are.
    count: usize,
    /// The lists, before they are copied to where they stay.
    pub(super) lists: Draft,
}

impl<const D: usize> Default for Workbench<D> {
    fn default() -> Self {
        Self {
            columns: std::array::from_fn(|_| Vec::new()),
            slots: Vec::new(),
            count: 0,
            lists: Draft::default(),
        }
    }
}

impl<const D: usize> Workbench<D> {
    /// Nobody, with room for so many.
    #[inline(always)]
    fn clear(&mut self, candidates: usize) {
        self.count = 0;
        let room = candidates + 4 * WIDTH;
        if self.slots.len() < room {
            self.slots.resize(room, 0);
            self.columns.iter_mut().for_each(|column| column.resize(room, 0));
        }
    }

    /// Gives all of them the room of the largest: which thread meets the fullest cells is up to the
    /// scheduler, and whoever meets them next shall find room.
    pub(super) fn level(benches: &mut [Self]) {
        let candidates = benches.iter().map(|bench| bench.slots.len()).max().unwrap_or_default();
        let listed = benches.iter().map(|bench| bench.lists.room()).max().unwrap_or_default();
        for bench in benches {
            bench.clear(candidates.saturating_sub(4 * WIDTH));
            bench.lists.make_room(listed);
        }
    }
}

/// What the lists of one chunk are built from.
pub(super) struct ListPass<'a, const D: usize> {
    /// The first slot.
    pub(super) first: usize,
    /// Fixed-point coordinates in cell order, axis by axis, with two [`WIDTH`] more behind them.
    pub(super) columns: &'a [Vec<i32>; D],
    /// Positions by row.
    pub(super) position: &'a (dyn Fn(usize) -> Vector<f64, D> + Sync),
    pub(super) cells: &'a Cells<D>,
    pub(super) space: PeriodicBox,
    /// How far the lists reach, and how far particles may be carried while they are used.
    pub(super) reach: (f64, f64),
}

impl<const D: usize> Pass for (ListPass<'_, D>, &mut Workbench<D>, &mut Chunk) {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(self) {
        let (pass, bench, chunk) = self;
        let count = pass.columns[0].len() - 2 * WIDTH;
        let limits = PackedSingle::limits(pass.reach.0, pass.space);
        let end = (pass.first + CHUNK).min(count);
        bench.lists.clear();
        bench.lists.first = pass.first;
        let mut slot = pass.first;
        while slot < end {
            // Particles of one cell follow each other, and look into the same cells.
            let cell = pass.cells.coordinates_of(pass.place(slot));
            let until = pass.cells.slots(cell).end.min(end);
            pass.gather::<W>(cell, slot..until, limits[1], bench);
            let nobody = pass.nobody_near(cell, count);
            while slot < until {
                pass.list::<W>(slot, limits, bench);
                bench.lists.close(nobody, pass.is_near_seam(slot));
                slot += 1;
            }
        }
        chunk.copy_from(&bench.lists, count);
    }
}

/// Columns as slices.
#[inline(always)]
fn slices<const D: usize>(columns: &[Vec<i32>; D]) -> [&[i32]; D] {
    let mut slices = [&[][..]; D];
    for (slice, column) in slices.iter_mut().zip(columns) {
        *slice = column;
    }
    slices
}

impl<const D: usize> ListPass<'_, D> {
    /// Fixed-point coordinates of a slot.
    #[inline(always)]
    fn place(&self, slot: usize) -> [i32; D] {
        let mut place = [0; D];
        for (place, column) in place.iter_mut().zip(self.columns) {
            *place = column[slot];
        }
        place
    }

    /// The smallest box that holds some slots of one cell: its middle and half its width.
    #[inline(always)]
    fn hull(&self, cell: [usize; D], slots: std::ops::Range<usize>) -> ([i32; D], [f32; D]) {
        let (mut middle, mut half) = (self.cells.middle(cell), [0.0; D]);
        for axis in 0..D {
            let (mut least, mut most) = (i32::MAX, i32::MIN);
            for &x in &self.columns[axis][slots.clone()] {
                let from_middle = x.wrapping_sub(middle[axis]);
                least = least.min(from_middle);
                most = most.max(from_middle);
            }
            // Cells are not wider than the box, and half of that is the largest number here.
            let width = most.wrapping_sub(least) as u32;
            middle[axis] = middle[axis].wrapping_add(least).wrapping_add((width / 2) as i32);
            half[axis] = (width / 2 + 1) as f32;
        }
        (middle, half)
    }

    /// Finds everyone within a distance of some slots of a cell; `limit` is on its square, in fixed-point
    /// steps.
    #[inline(always)]
    fn gather<W: Wide>(
        &self,
        cell: [usize; D],
        slots: std::ops::Range<usize>,
        limit: f32,
        bench: &mut Workbench<D>,
    ) {
        let (around, hull) = (self.cells.around(cell), self.hull(cell, slots));
        // Singles know the distance from the box to a few parts in ten million.
        let limit = limit * (1.0 + 1e-5);
        bench.clear(around.candidates());
        // What the loop writes to does not hold what it reads from.
        let columns = slices(self.columns);
        let slots = &mut bench.slots[..];
        let mut places = bench.columns.each_mut();
        let mut count = 0;
        for range in around.ranges() {
            let end = range.to as usize;
            for first in (range.from as usize..end).step_by(2 * WIDTH) {
                let inside = u16::MAX >> (2 * WIDTH - (end - first).min(2 * WIDTH));
                let mask = W::near_box(&columns, hull, first, limit) & inside;
                for (column, places) in columns.iter().zip(&mut places) {
                    let all = column[first..].first_chunk();
                    if let (Some(all), Some(kept)) = (all, places[count..].first_chunk_mut()) {
                        W::keep(mask, all, kept);
                    }
                }
                if let Some(slots) = slots[count..].first_chunk_mut() {
                    W::compress(mask, first as u32, slots);
                }
                count += mask.count_ones() as usize;
            }
        }
        bench.count = count;
    }

    /// The list of one slot from the candidates of its cell.
    #[inline(always)]
    fn list<W: Wide>(&self, slot: usize, limits: [f32; 2], bench: &mut Workbench<D>) {
        let here = self.place(slot);
        let Workbench { columns, slots, count, lists } = bench;
        let (columns, slots, count) = (slices(columns), &slots[..], *count);
        let index = lists.open(count);
        let mut filled = 0;
        for first in (0..count).step_by(2 * WIDTH) {
            let inside = u16::MAX >> (2 * WIDTH - (count - first).min(2 * WIDTH));
            let [mut near, maybe] = W::near(&columns, here, first, limits);
            let Some(others) = slots[first..].first_chunk() else { break };
            if near != maybe {
                near |= self.look_closer(slot, others, maybe & inside & !near);
            }
            if let Some(kept) = index[filled..].first_chunk_mut() {
                filled += W::keep_others(near & inside, others, slot as u32, kept);
            }
        }
        lists.fill(filled);
    }

    /// Which of sixteen slots that are in a mask are in reach, in doubles.
    #[cold]
    fn look_closer(&self, slot: usize, others: &[u32; 2 * WIDTH], mask: u16) -> u16 {
        let near = |bit: &usize| {
            // Outside of the mask there may be nobody.
            mask >> bit & 1 == 1 && {
                let rows = &self.cells.row_of_slot;
                let [here, there] =
                    [slot, others[*bit] as usize].map(|slot| (self.position)(rows[slot] as usize));
                let apart = self.space.minimum_image(here - there);
                apart.norm_squared() < self.reach.0 * self.reach.0
            }
        };
        (0..2 * WIDTH).filter(near).fold(0, |found, bit| found | 1 << bit)
    }

    /// Who fills up the lists of a cell: nobody, or, where he is too far away to be counted in two bytes,
    /// somebody half a box away along the first axis.
    #[inline(always)]
    fn nobody_near(&self, cell: [usize; D], count: usize) -> usize {
        // Two whole cells lie between them, each wider than the reach.
        if count <= FEW { count } else { self.cells.far_from(cell, 3).unwrap_or(count) }
    }

    /// Whether, before the lists are built anew, the particle or a neighbour of it may cross the seam of
    /// the box.
    #[inline(always)]
    fn is_near_seam(&self, slot: usize) -> bool {
        let (reach, carried) = self.reach;
        let margin = (reach + carried) * (PackedSingle::STEPS / self.space.length) + 4.0;
        let mut near = false;
        for x in self.place(slot) {
            let x = f64::from(x as u32);
            near |= x < margin || x > PackedSingle::STEPS - margin;
        }
        near
    }
}
