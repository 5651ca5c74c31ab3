//! Builds the neighbour lists of one chunk of particles from the cells around it.
//!
//! The candidates near a cell are gathered once for all its particles, as two 32-bit words each:
//! 16-bit coordinates and the slot. Distances are compared as integers, with the same result on
//! every instruction set. Pairs closer to the limit than the quantisation error are compared again
//! in `f64`.

use super::cells::Cells;
use super::chunk::FEW;
use crate::pairs::{CHUNK, Chunk, Entry, ListBuilder, Lists};
use crate::scalar::{SimdFloat, SimdTask, WIDTH, Window};
use crate::space::Space;
use crate::vector::Vector;

/// Sixteen words.
type Words = [u32; 2 * WIDTH];

/// The candidates near one cell: every particle that may be in reach of one of the cell's
/// particles.
#[derive(Clone, Debug, Default)]
struct Candidates {
    /// Coordinates and slot of each candidate as [`Window::words`], with the slot counted from the
    /// chunk's base in the high half of the second word.
    words: [Vec<Words>; 2],
    /// Slots of the candidates, filled only where they do not fit 16 bits from the base.
    slots: Vec<u32>,
    /// Number of candidates.
    count: usize,
    /// Index of the candidate that is the first slot to write a list for; the other slots of the
    /// cell follow it.
    own: usize,
}

impl Candidates {
    /// Removes all candidates, and makes room for this many.
    #[inline(always)]
    fn clear(&mut self, candidates: usize) {
        self.count = 0;
        // Each write is sixteen words wide and may reach past the last candidate.
        let scratch = candidates.div_ceil(2 * WIDTH) + 1;
        if self.slots.len() < 2 * WIDTH * scratch {
            self.slots.resize(2 * WIDTH * scratch, 0);
            self.words.iter_mut().for_each(|words| words.resize(scratch, [0; 2 * WIDTH]));
        }
    }
}

/// A thread's scratch buffer for building lists, reused from chunk to chunk.
#[derive(Clone, Debug, Default)]
pub(super) struct ListScratch {
    candidates: Candidates,
    /// The lists with 16-bit entries, before they are copied to their chunk.
    short: Lists<u16>,
    /// The lists with 32-bit entries, used where 16 bits are too few.
    whole: ListBuilder,
}

impl ListScratch {
    /// Grows every thread's buffers to the size of the largest, so that no later build allocates,
    /// whichever thread the scheduler gives the fullest cells to.
    pub(super) fn level(benches: &mut [Self]) {
        let most =
            |scratch: fn(&Self) -> usize| benches.iter().map(scratch).max().unwrap_or_default();
        let candidates = most(|bench| bench.candidates.slots.len());
        let listed = most(|bench| bench.short.scratch());
        let whole = most(|bench| bench.whole.scratch());
        for bench in benches {
            bench.candidates.clear(candidates.saturating_sub(2 * WIDTH));
            bench.short.make_room(listed);
            bench.whole.make_room(whole);
        }
    }
}

/// The type of a list entry while it is written.
trait Written: Entry {
    /// Whether the candidates' slots are needed, because they do not fit the words.
    const BY_SLOT: bool;

    /// Of sixteen candidates starting at index `first`, writes those in the mask to the front of
    /// `kept`.
    fn keep<W: SimdFloat>(mask: u16, words: &Words, first: usize, kept: &mut [Self]);

    /// Turns what [`Self::keep`] wrote into list entries.
    fn finish(written: &mut [Self], candidates: &Candidates);

    /// The slot of the candidate with index `number`.
    fn slot(candidates: &Candidates, number: usize, base: usize) -> usize;
}

impl Written for u16 {
    const BY_SLOT: bool = false;

    #[inline(always)]
    fn keep<W: SimdFloat>(mask: u16, words: &Words, _: usize, kept: &mut [Self]) {
        if let Some(kept) = kept.first_chunk_mut() {
            W::keep_tags(mask, words, kept);
        }
    }

    #[inline(always)]
    fn finish(_: &mut [Self], _: &Candidates) {}

    fn slot(candidates: &Candidates, number: usize, base: usize) -> usize {
        base + (candidates.words[1].as_flattened()[number] >> 16) as usize
    }
}

impl Written for u32 {
    const BY_SLOT: bool = true;

    #[inline(always)]
    fn keep<W: SimdFloat>(mask: u16, _: &Words, first: usize, kept: &mut [Self]) {
        if let Some(kept) = kept.first_chunk_mut() {
            W::compress(mask, first as u32, kept);
        }
    }

    #[inline(always)]
    fn finish(written: &mut [Self], candidates: &Candidates) {
        for number in written {
            *number = candidates.slots[*number as usize];
        }
    }

    fn slot(candidates: &Candidates, number: usize, _: usize) -> usize {
        candidates.slots[number] as usize
    }
}

/// The inputs from which the lists of one chunk are built.
pub(super) struct ListPass<'a, const D: usize> {
    /// The first slot.
    pub(super) first: usize,
    /// Fixed-point coordinates in cell order, axis by axis, padded by two [`WIDTH`].
    pub(super) columns: &'a [Vec<i32>; D],
    /// Positions by row.
    pub(super) position: &'a (dyn Fn(usize) -> Vector<f64, D> + Sync),
    pub(super) cells: &'a Cells<D>,
    pub(super) space: Space,
    /// The reach of the lists, and the largest displacement of a particle while they are used.
    pub(super) reach: (f64, f64),
}

/// The limits on distances, in steps of a [`Window`].
struct Steps {
    /// Base-2 logarithm of a window step in fixed-point steps.
    shift: u32,
    /// Squared distances: below the first a pair is certainly within reach, from the second on
    /// certainly not.
    limits: [u32; 2],
    /// Distance from the periodic boundary, in fixed-point steps, beyond which neither a particle
    /// nor its neighbours can cross the boundary while the lists are used.
    margin: u32,
}

impl<const D: usize> SimdTask for (ListPass<'_, D>, &mut ListScratch, &mut Chunk) {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let (pass, bench, chunk) = self;
        let (steps, count) = (pass.steps(), pass.count());
        if pass.write::<W, u16>(&steps, &mut bench.candidates, &mut bench.short) {
            chunk.copy_short(&bench.short, count);
        } else {
            pass.write::<W, u32>(&steps, &mut bench.candidates, &mut bench.whole);
            chunk.copy_from(&bench.whole, count);
        }
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
    /// Number of particles.
    #[inline(always)]
    fn count(&self) -> usize {
        self.columns[0].len() - 2 * WIDTH
    }

    /// Fixed-point coordinates of a slot.
    #[inline(always)]
    fn place(&self, slot: usize) -> [i32; D] {
        let mut place = [0; D];
        for (place, column) in place.iter_mut().zip(self.columns) {
            *place = column[slot];
        }
        place
    }

    /// The limits on distances, in window steps.
    fn steps(&self) -> Steps {
        let (reach, carried) = self.reach;
        let fixed_point = self.cells.fixed_point().steps_per_length();
        let shift = self.cells.window_shift();
        let step = f64::from(1_u32 << shift);
        // Coordinates are truncated to window steps and were rounded to fixed point before, as
        // periods may be. The error of a difference is below one window step plus two fixed-point
        // steps along each axis.
        let doubt = (D as f64).sqrt() * (1.0 + 2.0 / step) + 1e-3;
        let r = reach * fixed_point / step;
        let least = (r - doubt).max(0.0);
        // A conversion to `u32` saturates at `u32::MAX`, above which no squared distance lies.
        Steps {
            shift,
            limits: [(least * least) as u32, ((r + doubt) * (r + doubt)).ceil() as u32],
            margin: ((reach + carried) * fixed_point + 4.0) as u32,
        }
    }

    /// Writes the lists of the chunk. Returns false where a candidate is too far from the base for
    /// an entry.
    #[inline(always)]
    fn write<W: SimdFloat, E: Written>(
        &self,
        steps: &Steps,
        candidates: &mut Candidates,
        lists: &mut Lists<E>,
    ) -> bool {
        let count = self.count();
        let base = if E::BY_SLOT { 0 } else { Chunk::base_of(self.first, count) };
        let end = (self.first + CHUNK).min(count);
        lists.begin(self.first);
        let mut slot = self.first;
        while slot < end {
            // Particles of one cell are consecutive and share their candidates.
            let cell = self.cells.coordinates_of(self.place(slot));
            let until = self.cells.slots(cell).end.min(end);
            let sentinel = self.none_near(cell, count).wrapping_sub(base);
            let window = self.window(cell, slot..until, steps);
            if !self.gather::<W, E>((cell, slot), &window, base, candidates)
                || (!E::BY_SLOT && sentinel > FEW)
            {
                return false;
            }
            for (number, slot) in (candidates.own..).zip(slot..until) {
                self.list::<W, E>(slot, (&window, number, base), steps.limits, (candidates, lists));
                lists.close(sentinel, self.is_near_seam(slot, steps.margin));
            }
            slot = until;
        }
        true
    }

    /// The window around the smallest box that holds some slots of one cell.
    #[inline(always)]
    fn window(&self, cell: [usize; D], slots: std::ops::Range<usize>, steps: &Steps) -> Window<D> {
        let mut middle = self.cells.middle(cell);
        let (mut least, mut most) = ([i32::MAX; D], [i32::MIN; D]);
        for slot in slots {
            for axis in 0..D {
                let from_middle = self.columns[axis][slot].wrapping_sub(middle[axis]);
                least[axis] = least[axis].min(from_middle);
                most[axis] = most[axis].max(from_middle);
            }
        }
        let mut half = [0; D];
        for axis in 0..D {
            // A cell is not wider than the box, and half the box is the largest `i32`.
            let width = most[axis].wrapping_sub(least[axis]) as u32;
            middle[axis] = middle[axis].wrapping_add(least[axis]).wrapping_add((width / 2) as i32);
            half[axis] = ((width / 2 + 1) >> steps.shift) as u16 + 1;
        }
        Window { middle, shift: steps.shift, half, limit: steps.limits[1] }
    }

    /// Gathers, from the cells around, all candidates that may be in reach of a particle in the box
    /// of a window; `own` is the first slot in that box. Returns false where a candidate is too far
    /// from the base for an entry.
    #[inline(always)]
    fn gather<W: SimdFloat, E: Written>(
        &self,
        (cell, own): ([usize; D], usize),
        window: &Window<D>,
        base: usize,
        candidates: &mut Candidates,
    ) -> bool {
        let around = self.cells.around(cell);
        candidates.clear(around.candidates());
        // Separate slices: the buffers written do not alias the columns read.
        let columns = slices(self.columns);
        let [xy, zt] = candidates.words.each_mut().map(|words| words.as_flattened_mut());
        let slots = &mut candidates.slots[..];
        let mut count = 0;
        for range in around.ranges() {
            let (from, end) = (range.from as usize, range.to as usize);
            // Positions of an image are compared with the window shifted the other way.
            let middle = self.cells.fixed_point().seen_from(window.middle, range.image);
            let window = &Window { middle, ..*window };
            let own = if range.image == [0; 3] { own } else { usize::MAX };
            if !E::BY_SLOT && (from < base || end > base + FEW + 1) {
                return false;
            }
            for first in (from..end).step_by(2 * WIDTH) {
                let inside = u16::MAX >> (2 * WIDTH - (end - first).min(2 * WIDTH));
                let (xy, zt) = (xy[count..].first_chunk_mut(), zt[count..].first_chunk_mut());
                let (Some(xy), Some(zt)) = (xy, zt) else { return false };
                let tag = first.wrapping_sub(base) as u16;
                let mask = W::gather(&columns, window, (first, inside), tag, [xy, zt]);
                if E::BY_SLOT
                    && let Some(slots) = slots[count..].first_chunk_mut()
                {
                    W::compress(mask, first as u32, slots);
                }
                if (first..end.min(first + 2 * WIDTH)).contains(&own) {
                    let before = mask & !(u16::MAX << (own - first));
                    candidates.own = count + before.count_ones() as usize;
                }
                count += mask.count_ones() as usize;
            }
        }
        candidates.count = count;
        true
    }

    /// Writes the list of one slot from the candidates near its cell.
    #[inline(always)]
    fn list<W: SimdFloat, E: Written>(
        &self,
        slot: usize,
        (window, own, base): (&Window<D>, usize, usize),
        limits: [u32; 2],
        (candidates, lists): (&Candidates, &mut Lists<E>),
    ) {
        let here = window.words(self.place(slot));
        let index = lists.open(candidates.count);
        let mut filled = 0;
        let [xy, zt] = candidates.words.each_ref().map(|words| &words[..]);
        for (number, (xy, zt)) in xy.iter().zip(zt).enumerate() {
            let first = 2 * WIDTH * number;
            if first >= candidates.count {
                break;
            }
            let mut inside = u16::MAX >> (2 * WIDTH - (candidates.count - first).min(2 * WIDTH));
            // A particle is not its own neighbour.
            if own / (2 * WIDTH) == number {
                inside &= !(1 << (own % (2 * WIDTH)));
            }
            let [mut near, maybe] = W::within([xy, zt], here, limits);
            if near != maybe {
                let doubtful = maybe & inside & !near;
                near |=
                    self.look_closer(slot, doubtful, |bit| E::slot(candidates, first + bit, base));
            }
            near &= inside;
            E::keep::<W>(near, zt, first, &mut index[filled..]);
            filled += near.count_ones() as usize;
        }
        E::finish(&mut index[..filled], candidates);
        lists.fill(filled);
    }

    /// Which of the sixteen candidates in a mask are in reach, in `f64`.
    #[cold]
    fn look_closer(&self, slot: usize, mask: u16, other: impl Fn(usize) -> usize) -> u16 {
        let near = |bit: &usize| {
            // Bits outside of the mask may belong to no particle.
            mask >> bit & 1 == 1 && {
                let order = self.cells.order();
                let [here, there] =
                    [slot, other(*bit)].map(|slot| (self.position)(order.row(slot)));
                let apart = self.space.minimum_image(here - there);
                apart.norm_squared() < self.reach.0 * self.reach.0
            }
        };
        (0..2 * WIDTH).filter(near).fold(0, |found, bit| found | 1 << bit)
    }

    /// The index that pads the lists of a cell. It is the sentinel; where that is too far for a
    /// 16-bit entry, it is a particle half a box away along the first axis, if there is one.
    #[inline(always)]
    fn none_near(&self, cell: [usize; D], count: usize) -> usize {
        // At least two whole cells lie between the two, each wider than the reach.
        if count <= FEW { count } else { self.cells.far_from(cell, 3).unwrap_or(count) }
    }

    /// Whether the particle or one of its neighbours may cross the periodic boundary before the
    /// lists are rebuilt.
    #[inline(always)]
    fn is_near_seam(&self, slot: usize, margin: u32) -> bool {
        let mut near = false;
        for (axis, x) in self.place(slot).into_iter().enumerate() {
            near |= self.cells.fixed_point().is_near_seam(x, axis, margin);
        }
        near
    }
}
