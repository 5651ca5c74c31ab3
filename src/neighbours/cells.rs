//! A cell list: finds the particles near a place, at a cost linear in the number of particles.

use super::fixed_point::FixedPoint;
use super::order::Order;
use crate::space::Space;
use crate::vector::Vector;
use rayon::prelude::*;

/// Particles per parallel task, minimum, in a pass that only copies numbers: fewer take some
/// microseconds, and are not worth another thread.
pub(crate) const MIN_PARALLEL_LEN: usize = 1024;

/// A cell list: particles sorted by the cell they are in.
///
/// A particle's cell follows from its fixed-point coordinates ([`FixedPoint`]), without its
/// position in `f64`.
#[derive(Clone, Debug)]
pub struct Cells<const D: usize> {
    /// Cells along each axis.
    per_axis: [usize; D],
    /// The coordinates.
    fixed_point: FixedPoint<D>,
    /// The cell of coordinate `x` is `x · factor / 2^shift`, rounded down.
    factor: [u64; D],
    shift: u32,
    /// First slot of each cell, and the number of slots at the end.
    start: Vec<u32>,
    /// Rows and slots.
    pub(super) order: Order,
}

impl<const D: usize> Default for Cells<D> {
    fn default() -> Self {
        Self {
            per_axis: [0; D],
            fixed_point: FixedPoint::default(),
            factor: [0; D],
            shift: 0,
            start: Vec::new(),
            order: Order::default(),
        }
    }
}

impl<const D: usize> Cells<D> {
    /// Sorts particles into cells at least `reach` wide. The sort is stable.
    pub fn sort(&mut self, positions: &[Vector<f64, D>], space: Space, reach: f64) {
        let fixed_point = FixedPoint::new(space, reach, positions.iter().copied());
        self.sort_by(positions.len(), |row| positions[row], fixed_point, reach);
    }

    /// As [`Self::sort`], of `count` particles.
    pub fn sort_by(
        &mut self,
        count: usize,
        position: impl Fn(usize) -> Vector<f64, D> + Sync,
        fixed_point: FixedPoint<D>,
        reach: f64,
    ) {
        self.fixed_point = fixed_point;
        self.divide(reach, count);
        let mut order = std::mem::take(&mut self.order);
        let mut start = std::mem::take(&mut self.start);
        order.sort((count, self.count()), &mut start, |keys| {
            let keys = keys.par_iter_mut().with_min_len(MIN_PARALLEL_LEN).enumerate();
            keys.for_each(|(row, key)| *key = self.index(self.coordinates(position(row))) as u32);
        });
        (self.order, self.start) = (order, start);
    }

    /// Rows and slots.
    #[inline(always)]
    pub fn order(&self) -> &Order {
        &self.order
    }

    /// Divides space into cells at least `reach` wide, for this many particles.
    fn divide(&mut self, reach: f64, particles: usize) {
        let (fixed_point, space) = (self.fixed_point, self.fixed_point.space());
        // Rounded coordinates may be some steps farther apart than the particles.
        let width = reach + 4.0 / fixed_point.steps_per_length();
        // More cells than this along an axis would make more cells than particles, and only cost
        // memory.
        let most = |axis: usize| {
            let per_side = (particles as f64).powf(1.0 / D as f64);
            if space.is_periodic_cube::<D>() {
                return per_side;
            }
            space.side(axis) * per_side / space.volume::<D>().powf(1.0 / D as f64)
        };
        self.per_axis = std::array::from_fn(|axis| {
            (space.side(axis) / width).floor().clamp(1.0, most(axis).ceil().max(1.0)) as usize
        });
        // No product of a factor and a coordinate in the period overflows.
        let cells = self.per_axis.iter().max().map_or(0, |most| most.ilog2());
        self.shift = if fixed_point.is_modular(0) { 32 } else { 60 - cells };
        self.factor = std::array::from_fn(|axis| {
            ((self.per_axis[axis] as u128) << self.shift) as u64 / fixed_point.steps(axis)
        });
    }

    /// The fixed-point coordinates.
    #[inline(always)]
    pub fn fixed_point(&self) -> &FixedPoint<D> {
        &self.fixed_point
    }

    /// Cell coordinates of a position. Where it is outside of an open axis' cells, those of a cell
    /// at the boundary.
    #[inline(always)]
    pub fn coordinates(&self, position: Vector<f64, D>) -> [usize; D] {
        self.coordinates_of(self.fixed_point.of(position))
    }

    /// Cell coordinates of fixed-point coordinates.
    #[inline(always)]
    pub fn coordinates_of(&self, place: [i32; D]) -> [usize; D] {
        let mut coordinates = [0; D];
        for axis in 0..D {
            // Out of the embedding of an open axis any cell will do: no particle is near.
            let cell = u64::from(place[axis] as u32).wrapping_mul(self.factor[axis]) >> self.shift;
            coordinates[axis] = (cell as usize).min(self.per_axis[axis] - 1);
        }
        coordinates
    }

    /// The centre of a cell, in fixed-point steps.
    #[inline(always)]
    pub fn middle(&self, coordinates: [usize; D]) -> [i32; D] {
        let mut middle = [0; D];
        for axis in 0..D {
            let width = self.fixed_point.steps(axis) as f64 / self.per_axis[axis] as f64;
            middle[axis] = ((coordinates[axis] as f64 + 0.5) * width) as u32 as i32;
        }
        middle
    }

    /// Right shift that maps 32-bit coordinates near a cell to 16 bits. After it, two cell widths
    /// span at most 2¹⁵; a periodic cube less than four cells wide spans 2¹⁶.
    pub fn window_shift(&self) -> u32 {
        let of_axis = |axis: usize| {
            let cells = self.per_axis[axis] as u64;
            let cells = if self.fixed_point.is_modular(axis) { cells.max(4) } else { cells };
            let two = 2 * self.fixed_point.steps(axis) / cells;
            (two - 1).checked_ilog2().map_or(0, |bits| bits + 1).saturating_sub(15)
        };
        (0..D).map(of_axis).max().unwrap_or(0)
    }

    /// Slots of the cell at `coordinates`.
    #[inline(always)]
    pub fn slots(&self, coordinates: [usize; D]) -> std::ops::Range<usize> {
        self.range(self.index(coordinates))
    }

    #[inline(always)]
    fn index(&self, coordinates: [usize; D]) -> usize {
        let axes = coordinates.iter().zip(&self.per_axis).rev();
        axes.fold(0, |index, (&c, &n)| index * n + c)
    }

    /// The first slot of the cell half a box away along the first axis, if that cell is not empty
    /// and at least `least` cells away from the cell at `coordinates`.
    pub fn far_from(&self, coordinates: [usize; D], least: usize) -> Option<usize> {
        let mut opposite = coordinates;
        opposite[0] = (coordinates[0] + self.per_axis[0] / 2) % self.per_axis[0];
        let slots = self.slots(opposite);
        (self.per_axis[0] / 2 >= least && !slots.is_empty()).then_some(slots.start)
    }

    /// Number of cells.
    pub fn count(&self) -> usize {
        self.per_axis.iter().product()
    }

    /// Slots of the cell with index `cell`.
    #[inline(always)]
    pub fn range(&self, cell: usize) -> std::ops::Range<usize> {
        self.start[cell] as usize..self.start[cell + 1] as usize
    }

    /// Fixed-point coordinates of the particles in cell order, whose positions are given by slot. Each
    /// is that of the image which is nearest to the cell: a particle may have crossed the boundary
    /// since it was sorted.
    pub(crate) fn places<'a>(
        &'a self,
        position: &'a impl Fn(usize) -> Vector<f64, D>,
    ) -> impl Iterator<Item = [i32; D]> + 'a {
        (0..self.count()).flat_map(move |cell| {
            let middle = self.middle(self.coordinates_of_index(cell));
            self.range(cell).map(move |slot| self.fixed_point.image_near(position(slot), middle))
        })
    }

    /// Coordinates of the cell with index `cell`.
    #[inline(always)]
    fn coordinates_of_index(&self, cell: usize) -> [usize; D] {
        let (mut coordinates, mut rest) = ([0; D], cell);
        for (coordinate, n) in coordinates.iter_mut().zip(self.per_axis) {
            *coordinate = rest % n;
            rest /= n;
        }
        coordinates
    }

    /// Ranges of slots that together hold the cell at `coordinates` and all cells that touch it.
    /// Neighbouring cells along the first axis form one range.
    ///
    /// Each cell comes once, also where a periodic cube is one or two cells wide. In any other
    /// space it comes once for each of its images that touches the cell, see [`Range::image`]; no
    /// particle meets two images of another, since the reach is at most half a period.
    #[inline(always)]
    pub fn around(&self, coordinates: [usize; D]) -> Around {
        let mut around = Around::NONE;
        let (rows, count) = self.rows(coordinates);
        let (parts, segments) = self.along(coordinates[0]);
        for row in &rows[..count] {
            for part in &parts[..segments] {
                let mut image = row.image;
                image[0] = part.image;
                let [from, to] = [part.from, part.to].map(|x| self.start[row.first + x]);
                around.push(Range { from, to, image });
            }
        }
        around
    }

    /// Calls `see` with the index of each cell that touches the cell with index `cell`, itself
    /// included; with some of them more than once where the space is less than four cells wide.
    #[inline(always)]
    pub fn for_each_around(&self, cell: usize, mut see: impl FnMut(usize)) {
        let coordinates = self.coordinates_of_index(cell);
        let (rows, count) = self.rows(coordinates);
        let (parts, segments) = self.along(coordinates[0]);
        for row in &rows[..count] {
            for part in &parts[..segments] {
                (part.from..part.to).for_each(|x| see(row.first + x));
            }
        }
    }

    /// The rows along the first axis that touch the cell at `coordinates`, and their number. A row
    /// is the cell's own, the next or the last along each other axis.
    #[inline(always)]
    fn rows(&self, coordinates: [usize; D]) -> ([Row; MOST_ROWS], usize) {
        let (mut rows, mut count) = ([Row { first: 0, image: [0; 3] }; MOST_ROWS], 1);
        let mut stride = self.per_axis[0];
        for axis in 1..D {
            let (n, along) = (self.per_axis[axis], coordinates[axis]);
            let next = if along + 1 < n { (along + 1, 0) } else { (0, 1) };
            let last = if along > 0 { (along - 1, 0) } else { (n - 1, -1) };
            // In a cube of one or two cells the next and the last row are the same row, or the own
            // one.
            let steps = [(along, 0), next, last];
            let different = if self.fixed_point.is_modular(axis) { n.min(3) } else { 3 };
            for step in (0..different).rev() {
                for row in 0..count {
                    let mut image = rows[row].image;
                    image[axis] = steps[step].1;
                    let first = rows[row].first + steps[step].0 * stride;
                    rows[step * count + row] = Row { first, image };
                }
            }
            count *= different;
            stride *= n;
        }
        (rows, count)
    }

    /// The cells next to cell `x` in a row along the first axis, and where they cross the boundary,
    /// those on the other side.
    #[inline(always)]
    fn along(&self, x: usize) -> ([Part; 3], usize) {
        let (n, modular) = (self.per_axis[0], self.fixed_point.is_modular(0));
        let all = Part { from: 0, to: n, image: 0 };
        if modular && n <= 3 {
            return ([all; 3], 1);
        }
        let mut parts = [Part { from: x.saturating_sub(1), to: (x + 2).min(n), image: 0 }; 3];
        let mut count = 1;
        if x == 0 {
            parts[count] = Part { from: n - 1, to: n, image: -1 };
            count += 1;
        }
        if x + 1 == n {
            parts[count] = Part { from: 0, to: 1, image: 1 };
            count += 1;
        }
        (parts, count)
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        4 * self.start.capacity() + self.order.bytes()
    }
}

/// A row of cells along the first axis.
#[derive(Clone, Copy)]
struct Row {
    /// Index of its first cell.
    first: usize,
    /// The periods by which it is shifted, see [`Range::image`].
    image: [i8; 3],
}

/// Consecutive cells of a row.
#[derive(Clone, Copy)]
struct Part {
    from: usize,
    to: usize,
    /// The periods by which they are shifted along the first axis.
    image: i8,
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

/// Number of ranges of slots around a cell, maximum: the periodic boundary can cut each row in three.
const MOST_RANGES: usize = 3 * MOST_ROWS;

/// A range of slots.
#[derive(Clone, Copy, Debug, Default)]
pub struct Range {
    /// The first.
    pub from: u32,
    /// One past the last.
    pub to: u32,
    /// The periods to add to their positions along each axis, so that they are near the cell.
    pub image: [i8; 3],
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
    pub const NONE: Self =
        Self { ranges: [Range { from: 0, to: 0, image: [0; 3] }; MOST_RANGES], count: 0 };

    #[inline(always)]
    fn push(&mut self, range: Range) {
        self.ranges[self.count] = range;
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
