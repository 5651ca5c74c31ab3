//! A cell list: finds the particles near a place, at a cost linear in the number of particles.

use crate::packed::PackedSingle;
use crate::space::PeriodicBox;
use crate::vector::Vector;
use rayon::prelude::*;

/// Particles per parallel task, minimum, in a pass that only copies numbers: fewer take some
/// microseconds, and are not worth another thread.
pub(crate) const MIN_PARALLEL_LEN: usize = 1024;

/// A cell list: particles sorted by the cell they are in.
///
/// A particle's cell follows from its fixed-point coordinates ([`PackedSingle`]), without its
/// position in `f64`.
#[derive(Clone, Debug, Default)]
pub struct Cells<const D: usize> {
    /// Cells along each axis.
    per_axis: usize,
    /// Side of the box.
    length: f64,
    /// First slot of each cell, and the number of slots at the end.
    start: Vec<u32>,
    /// Row of each slot.
    pub row_of_slot: Vec<u32>,
}

impl<const D: usize> Cells<D> {
    /// Sorts particles into cells at least `reach` wide. The sort is stable.
    pub fn sort(&mut self, positions: &[Vector<f64, D>], space: PeriodicBox, reach: f64) {
        let mut slots = vec![0; positions.len()];
        self.sort_by(|row| positions[row], space, reach, &mut slots);
    }

    /// As [`Self::sort`], of `slots.len()` particles. Writes the slot of each row into `slots`.
    pub fn sort_by(
        &mut self,
        position: impl Fn(usize) -> Vector<f64, D> + Sync,
        space: PeriodicBox,
        reach: f64,
        slots: &mut [u32],
    ) {
        // More cells along an axis than this would make more cells than particles, and only cost
        // memory.
        let most = (slots.len() as f64).powf(1.0 / D as f64).ceil().max(1.0);
        // Rounded coordinates may be some steps farther apart than the particles.
        let width = reach + 4.0 * space.length / PackedSingle::STEPS;
        self.per_axis = (space.length / width).floor().clamp(1.0, most) as usize;
        self.length = space.length;
        let cells = slots.par_iter_mut().with_min_len(MIN_PARALLEL_LEN).enumerate();
        cells.for_each(|(row, cell)| *cell = self.index(self.coordinates(position(row))) as u32);
        let cells = self.per_axis.pow(D as u32);
        counting_sort(slots, cells, &mut self.start, &mut self.row_of_slot);
    }

    /// Cell coordinates of a position inside the box.
    #[inline(always)]
    pub fn coordinates(&self, position: Vector<f64, D>) -> [usize; D] {
        let space = PeriodicBox { length: self.length };
        self.coordinates_of(position.0.map(|x| PackedSingle::fixed_point(x, space)))
    }

    /// Cell coordinates of fixed-point coordinates.
    #[inline(always)]
    pub fn coordinates_of(&self, place: [i32; D]) -> [usize; D] {
        let mut coordinates = [0; D];
        for (coordinate, x) in coordinates.iter_mut().zip(place) {
            *coordinate = ((x as u32 as u64 * self.per_axis as u64) >> 32) as usize;
        }
        coordinates
    }

    /// The centre of a cell, in fixed-point steps.
    #[inline(always)]
    pub fn middle(&self, coordinates: [usize; D]) -> [i32; D] {
        let width = PackedSingle::STEPS / self.per_axis as f64;
        let mut middle = [0; D];
        for (middle, c) in middle.iter_mut().zip(coordinates) {
            *middle = ((c as f64 + 0.5) * width) as u32 as i32;
        }
        middle
    }

    /// Right shift that maps 32-bit coordinates near a cell to 16 bits. After it, two cell widths
    /// span at most 2¹⁵; a box less than four cells wide spans 2¹⁶.
    pub fn window_shift(&self) -> u32 {
        18_u32.saturating_sub(self.per_axis.max(4).ilog2())
    }

    /// Slots of the cell at `coordinates`.
    #[inline(always)]
    pub fn slots(&self, coordinates: [usize; D]) -> std::ops::Range<usize> {
        self.range(self.index(coordinates))
    }

    #[inline(always)]
    fn index(&self, coordinates: [usize; D]) -> usize {
        coordinates.iter().rev().fold(0, |index, &c| index * self.per_axis + c)
    }

    /// The first slot of the cell half a box away along the first axis, if that cell is not empty
    /// and at least `least` cells away from the cell at `coordinates`.
    pub fn far_from(&self, coordinates: [usize; D], least: usize) -> Option<usize> {
        let mut opposite = coordinates;
        opposite[0] = (coordinates[0] + self.per_axis / 2) % self.per_axis;
        let slots = self.slots(opposite);
        (self.per_axis / 2 >= least && !slots.is_empty()).then_some(slots.start)
    }

    /// Number of cells.
    pub fn count(&self) -> usize {
        self.per_axis.pow(D as u32)
    }

    /// Slots of the cell with index `cell`.
    #[inline(always)]
    pub fn range(&self, cell: usize) -> std::ops::Range<usize> {
        self.start[cell] as usize..self.start[cell + 1] as usize
    }

    /// Ranges of slots that together hold the cell at `coordinates` and all cells that touch it.
    /// Each cell comes once, also where the box is one or two cells wide. Neighbouring cells along
    /// the first axis form one range.
    #[inline(always)]
    pub fn around(&self, coordinates: [usize; D]) -> Around {
        let mut around = Around::NONE;
        let (rows, count) = self.rows(coordinates);
        let (along, behind_seam) = along_row(self.per_axis, coordinates[0]);
        for row in &rows[..count] {
            around.push(self.start[row + along.start], self.start[row + along.end]);
            if !behind_seam.is_empty() {
                around.push(self.start[row + behind_seam.start], self.start[row + behind_seam.end]);
            }
        }
        around
    }

    /// Calls `see` once with the index of each cell that touches the cell with index `cell`, itself
    /// included.
    #[inline(always)]
    pub fn for_each_around(&self, cell: usize, mut see: impl FnMut(usize)) {
        let (mut coordinates, mut rest) = ([0; D], cell);
        for coordinate in &mut coordinates {
            *coordinate = rest % self.per_axis;
            rest /= self.per_axis;
        }
        let (rows, count) = self.rows(coordinates);
        let (along, behind_seam) = along_row(self.per_axis, coordinates[0]);
        for row in &rows[..count] {
            for x in along.clone().chain(behind_seam.clone()) {
                see(row + x);
            }
        }
    }

    /// The index of the first cell of each row along the first axis that touches the cell at
    /// `coordinates`, and the number of rows. A row is the cell's own, the next or the last along
    /// each other axis.
    #[inline(always)]
    fn rows(&self, coordinates: [usize; D]) -> ([usize; MOST_ROWS], usize) {
        let n = self.per_axis;
        let (mut rows, mut count, mut stride) = ([0; MOST_ROWS], 1, n);
        for along in coordinates.into_iter().skip(1) {
            let next = if along + 1 < n { along + 1 } else { 0 };
            let last = if along > 0 { along - 1 } else { n - 1 };
            // In a box of one or two cells the next and the last row are the same row, or the own
            // one.
            let steps = [along, next, last];
            let different = n.min(3);
            for step in (0..different).rev() {
                for row in 0..count {
                    rows[step * count + row] = rows[row] + steps[step] * stride;
                }
            }
            count *= different;
            stride *= n;
        }
        (rows, count)
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        4 * (self.start.capacity() + self.row_of_slot.capacity())
    }
}

/// The range of cells next to cell `x` in a row of `n` and, where it crosses the periodic boundary,
/// the range on the other side.
#[inline(always)]
fn along_row(n: usize, x: usize) -> (std::ops::Range<usize>, std::ops::Range<usize>) {
    if n <= 3 {
        return (0..n, 0..0);
    }
    let behind_seam = if x == 0 {
        n - 1..n
    } else if x + 1 == n {
        0..1
    } else {
        0..0
    };
    (x.saturating_sub(1)..(x + 2).min(n), behind_seam)
}

/// Counting sort of items by their keys, `0..count`; stable. Afterwards `start` holds the first
/// place of each key, and the number of items at the end; `item_of_place` the item at each place;
/// and `keys` the place of each item.
pub(crate) fn counting_sort(
    keys: &mut [u32],
    count: usize,
    start: &mut Vec<u32>,
    item_of_place: &mut Vec<u32>,
) {
    start.clear();
    start.resize(count + 1, 0);
    for &key in &*keys {
        start[key as usize + 1] += 1;
    }
    for key in 1..start.len() {
        start[key] += start[key - 1];
    }
    item_of_place.resize(keys.len(), 0);
    for (item, key) in keys.iter_mut().enumerate().rev() {
        // Filling from the end turns each end into a start, and keeps the order of equal keys.
        let place = &mut start[*key as usize + 1];
        *place -= 1;
        item_of_place[*place as usize] = item as u32;
        *key = *place;
    }
    start.remove(0);
    start.push(keys.len() as u32);
}

/// Number of rows of cells around a cell, maximum: 3 × 3 in 3D.
const MOST_ROWS: usize = 9;

/// Number of ranges of slots around a cell, maximum: the periodic boundary can cut each row in two.
const MOST_RANGES: usize = 2 * MOST_ROWS;

/// A range of slots.
#[derive(Clone, Copy, Debug, Default)]
pub struct Range {
    /// The first.
    pub from: u32,
    /// One past the last.
    pub to: u32,
}

impl Range {
    /// Number of slots.
    pub fn len(&self) -> usize {
        (self.to - self.from) as usize
    }

    /// Whether it holds no slot.
    pub fn is_empty(&self) -> bool {
        self.from == self.to
    }
}

/// The ranges that [`Cells::around`] finds.
#[derive(Clone, Copy, Debug)]
pub struct Around {
    ranges: [Range; MOST_RANGES],
    count: usize,
}

impl Around {
    /// No range.
    pub const NONE: Self = Self { ranges: [Range { from: 0, to: 0 }; MOST_RANGES], count: 0 };

    #[inline(always)]
    fn push(&mut self, from: u32, to: u32) {
        self.ranges[self.count] = Range { from, to };
        self.count += 1;
    }

    /// The ranges of slots.
    #[inline(always)]
    pub fn ranges(&self) -> &[Range] {
        &self.ranges[..self.count]
    }

    /// Number of slots in all ranges.
    #[inline(always)]
    pub fn candidates(&self) -> usize {
        self.ranges().iter().map(Range::len).sum()
    }
}
