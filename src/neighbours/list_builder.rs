//! Neighbour lists while they are written, one slot after another.

use crate::neighbours::chunk::{CHUNK, Entry};
use crate::scalar::{SimdFloat, WIDTH};

/// The neighbour lists of consecutive slots, while they are written.
#[derive(Clone, Debug, Default)]
pub struct Lists<E> {
    /// The first slot.
    pub first: usize,
    /// Index of each slot's first neighbour in `index`, and the total at the end.
    start: Vec<u32>,
    /// Neighbours, padded to whole eights.
    index: Vec<E>,
    /// Number of elements of `index` in use.
    filled: usize,
    /// For each slot, whether some neighbour may be across the periodic boundary.
    seam: Vec<bool>,
}

/// Neighbour lists of 32-bit slots.
pub type ListBuilder = Lists<u32>;

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

    /// Index of each slot's first neighbour, and the total at the end.
    #[inline(always)]
    pub(crate) fn starts(&self) -> impl ExactSizeIterator<Item = u32> {
        self.start.iter().copied()
    }

    /// For each slot, whether some neighbour may be across the periodic boundary.
    #[inline(always)]
    pub(crate) fn seam(&self) -> &[bool] {
        &self.seam
    }

    /// The neighbours of all slots.
    #[inline(always)]
    pub(crate) fn eights(&self) -> &[[E; WIDTH]] {
        self.index[..self.filled].as_chunks().0
    }

    /// Removes all lists; the next list is that of slot `first`.
    pub fn begin(&mut self, first: usize) {
        self.clear();
        self.first = first;
    }

    /// Removes all lists.
    pub fn clear(&mut self) {
        self.start.clear();
        self.start.push(0);
        self.seam.clear();
        self.filled = 0;
    }

    /// Adds this many neighbours, already written to the front of what [`Self::open`] returned.
    #[inline(always)]
    pub fn fill(&mut self, neighbours: usize) {
        self.filled += neighbours;
    }

    /// Capacity of all lists together, in neighbours.
    pub fn scratch(&self) -> usize {
        self.index.len()
    }
}

impl<E: Entry> Lists<E> {
    /// Begins the list of a slot of at most `candidates` neighbours, and returns where to write it.
    #[inline(always)]
    pub fn open(&mut self, candidates: usize) -> &mut [E] {
        self.make_room(self.filled + candidates + 4 * WIDTH);
        &mut self.index[self.filled..]
    }

    /// Makes room for `neighbours` neighbours in all lists, and for the lists of [`CHUNK`] slots.
    #[inline(always)]
    pub fn make_room(&mut self, neighbours: usize) {
        if self.index.len() < neighbours {
            self.index.resize(neighbours, E::default());
            self.start.reserve((CHUNK + 1).saturating_sub(self.start.len()));
            self.seam.reserve(CHUNK.saturating_sub(self.seam.len()));
        }
    }

    /// Ends the list of a slot, and pads it to whole eights with `sentinel`, the sentinel's distance
    /// from the base. `seam` says whether a neighbour may be across the periodic boundary while the
    /// list is used.
    #[inline(always)]
    pub fn close(&mut self, sentinel: usize, seam: bool) {
        self.seam.push(seam);
        // One write of a whole register: there is room for it after the last neighbour.
        if let Some(rest) = self.index[self.filled..].first_chunk_mut::<WIDTH>() {
            *rest = [E::at(sentinel); WIDTH];
        }
        self.filled = self.filled.next_multiple_of(WIDTH);
        self.start.push(self.filled as u32);
    }
}

impl ListBuilder {
    /// Ends all lists, and drops the unused elements.
    pub fn finish(&mut self) {
        self.index.truncate(self.filled);
    }

    /// Appends the slots from `first` on that are set in a mask of sixteen; [`Self::open`]
    /// must have made room for them.
    #[inline(always)]
    pub fn append_mask<W: SimdFloat>(&mut self, mask: u16, first: usize) {
        if let Some(kept) = self.index[self.filled..].first_chunk_mut() {
            W::compress(mask, first as u32, kept);
        }
        self.filled += mask.count_ones() as usize;
    }
}
