//! Lists of neighbours as they are written, one slot after another.

use crate::chunk::{CHUNK, Entry};
use crate::scalar::{WIDTH, Wide};

/// The neighbours of some consecutive slots, as they are written.
#[derive(Clone, Debug, Default)]
pub struct Lists<E> {
    /// First of the slots.
    pub first: usize,
    /// Where each slot's neighbours start in `index`; one more at the end.
    start: Vec<u32>,
    /// Neighbours, filled up to whole eights.
    index: Vec<E>,
    /// How much of `index` is filled.
    filled: usize,
    /// Of each slot, whether some neighbour may be across the seam of the box.
    seam: Vec<bool>,
}

/// Neighbours by their slots, as they are written.
pub type Draft = Lists<u32>;

impl<E> Lists<E> {
    /// Number of slots.
    pub fn len(&self) -> usize {
        self.start.len().saturating_sub(1)
    }

    /// Whether there are no slots.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The neighbours of the `k`-th slot, eight at a time.
    #[inline(always)]
    pub fn neighbours(&self, k: usize) -> &[[E; WIDTH]] {
        self.index[self.start[k] as usize..self.start[k + 1] as usize].as_chunks().0
    }

    /// Where each slot's neighbours start; one more at the end.
    #[inline(always)]
    pub(crate) fn starts(&self) -> impl ExactSizeIterator<Item = u32> {
        self.start.iter().copied()
    }

    /// Of each slot, whether some neighbour may be across the seam of the box.
    #[inline(always)]
    pub(crate) fn seam(&self) -> &[bool] {
        &self.seam
    }

    /// The neighbours of all slots.
    #[inline(always)]
    pub(crate) fn eights(&self) -> &[[E; WIDTH]] {
        self.index[..self.filled].as_chunks().0
    }

    /// Forgets all lists; the next are those of slots from `first` on.
    pub fn begin(&mut self, first: usize) {
        self.clear();
        self.first = first;
    }

    /// Forgets all lists.
    pub fn clear(&mut self) {
        self.start.clear();
        self.start.push(0);
        self.seam.clear();
        self.filled = 0;
    }

    /// Adds the neighbours that were written to the front of what [`Self::open`] returned.
    #[inline(always)]
    pub fn fill(&mut self, neighbours: usize) {
        self.filled += neighbours;
    }

    /// How many neighbours all lists together have room for.
    pub fn room(&self) -> usize {
        self.index.len()
    }
}

impl<E: Entry> Lists<E> {
    /// Begins the list of a slot, of at most so many candidates: where it goes.
    #[inline(always)]
    pub fn open(&mut self, candidates: usize) -> &mut [E] {
        self.make_room(self.filled + candidates + 4 * WIDTH);
        &mut self.index[self.filled..]
    }

    /// Makes room for so many neighbours in all lists, and for the lists of [`CHUNK`] slots.
    #[inline(always)]
    pub fn make_room(&mut self, neighbours: usize) {
        if self.index.len() < neighbours {
            self.index.resize(neighbours, E::default());
            self.start.reserve((CHUNK + 1).saturating_sub(self.start.len()));
            self.seam.reserve(CHUNK.saturating_sub(self.seam.len()));
        }
    }

    /// Ends the list of a slot, with nobody, who is so far from the base, up to whole eights; `seam` says
    /// whether a neighbour may be across the seam of the box, while the list is used.
    #[inline(always)]
    pub fn close(&mut self, nobody: usize, seam: bool) {
        self.seam.push(seam);
        // A whole register at once: there is room behind the last.
        if let Some(rest) = self.index[self.filled..].first_chunk_mut::<WIDTH>() {
            *rest = [E::at(nobody); WIDTH];
        }
        self.filled = self.filled.next_multiple_of(WIDTH);
        self.start.push(self.filled as u32);
    }
}

impl Draft {
    /// Ends all lists.
    pub fn finish(&mut self) {
        self.index.truncate(self.filled);
    }

    /// Appends the slots from `first` on that are in a mask of sixteen; within what [`Self::open`] has
    /// made room for.
    #[inline(always)]
    pub fn append_mask<W: Wide>(&mut self, mask: u16, first: usize) {
        if let Some(kept) = self.index[self.filled..].first_chunk_mut() {
            W::compress(mask, first as u32, kept);
        }
        self.filled += mask.count_ones() as usize;
    }
}
