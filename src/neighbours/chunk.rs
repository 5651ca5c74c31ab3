//! Neighbour lists in groups of eight, as they are stored; [`super::list_builder`] builds them.

use crate::neighbours::list_builder::{ListBuilder, Lists};
use crate::pairs::{Surroundings, pick};
use crate::scalar::{SimdFloat, WIDTH};
use crate::space::Space;

/// Particles per chunk, the unit of parallel work. It is fixed, so that no result depends on the
/// number of threads.
pub const CHUNK: usize = 256;

/// Chunks per parallel task, maximum. Smaller tasks limit how long other threads wait for one that
/// the operating system has suspended.
pub const MAX_BLOCKS_PER_TASK: usize = 4;

/// Size of all particle lines, in bytes, up to which they fit the cache and prefetching is skipped.
const FITS_CACHE: usize = 4 << 20;

/// Prefetch distance in slots: while slot `k` is processed, the lines of the neighbours of slot
/// `k + AHEAD` are prefetched.
pub const AHEAD: usize = 4;

/// The neighbour lists of [`CHUNK`] consecutive slots.
///
/// Cells that touch are close in the order of slots, so that 16 bits per neighbour are enough: its
/// distance in slots from the chunk's `base`. Where they are not enough, as at the periodic
/// boundary of a box of more than 65535 particles, a chunk stores 32-bit slots.
#[derive(Clone, Debug, Default)]
pub struct Chunk {
    /// First slot of the chunk.
    pub first: usize,
    /// The slot from which entries are counted.
    base: usize,
    /// Index of each slot's first eight, and the total at the end.
    start: Vec<u32>,
    /// Distances of neighbours from the base.
    short: Vec<[u16; WIDTH]>,
    /// Slots of neighbours, used in place of `short`.
    whole: Vec<[u32; WIDTH]>,
    /// For each slot, whether some neighbour may be across the periodic boundary.
    seam: Vec<bool>,
}

/// The type in which a neighbour is stored.
pub trait Entry: Copy + Default + 'static {
    /// The entries of a chunk.
    fn of(chunk: &Chunk) -> &[[Self; WIDTH]];

    /// The distance from the chunk's base, in slots.
    fn distance(self) -> usize;

    /// The entry at this distance from the chunk's base.
    fn at(distance: usize) -> Self;
}

impl Entry for u16 {
    #[inline(always)]
    fn of(chunk: &Chunk) -> &[[Self; WIDTH]] {
        &chunk.short
    }

    #[inline(always)]
    fn distance(self) -> usize {
        usize::from(self)
    }

    #[inline(always)]
    fn at(distance: usize) -> Self {
        distance as Self
    }
}

impl Entry for u32 {
    #[inline(always)]
    fn of(chunk: &Chunk) -> &[[Self; WIDTH]] {
        &chunk.whole
    }

    #[inline(always)]
    fn distance(self) -> usize {
        self as usize
    }

    #[inline(always)]
    fn at(distance: usize) -> Self {
        distance as Self
    }
}

/// Eight neighbours.
#[derive(Clone, Copy, Debug)]
pub struct Eight<'a, E> {
    /// The slot that entries are counted from.
    pub(crate) base: usize,
    pub(crate) entries: &'a [E; WIDTH],
}

impl<'a, E> From<&'a [E; WIDTH]> for Eight<'a, E> {
    /// Eight neighbours given by their slots.
    #[inline(always)]
    fn from(entries: &'a [E; WIDTH]) -> Self {
        Self { base: 0, entries }
    }
}

impl<E: Entry> Eight<'_, E> {
    /// The slot of one neighbour.
    #[inline(always)]
    pub fn slot(&self, lane: usize) -> usize {
        self.base + self.entries[lane].distance()
    }

    /// Number of neighbours that are not the sentinel, which comes last.
    #[inline(always)]
    pub(crate) fn count(&self, sentinel: usize) -> usize {
        (0..WIDTH).filter(|&lane| self.slot(lane) != sentinel).count()
    }

    /// Their slots.
    #[inline(always)]
    pub fn slots(&self) -> [u32; WIDTH] {
        let mut slots = [0; WIDTH];
        for (lane, slot) in slots.iter_mut().enumerate() {
            *slot = self.slot(lane) as u32;
        }
        slots
    }
}

/// Number of particles, maximum, that 16-bit entries of every chunk can tell apart, together with
/// the sentinel.
pub const FEW: usize = u16::MAX as usize;

impl Chunk {
    /// Number of slots.
    pub fn len(&self) -> usize {
        self.start.len().saturating_sub(1)
    }

    /// Whether the chunk has no slots.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let lists = 2 * self.short.capacity() + 4 * self.whole.capacity();
        WIDTH * lists + 4 * self.start.capacity() + self.seam.capacity()
    }

    /// Whether neighbours are stored as [`u16`], and not as [`u32`].
    #[inline(always)]
    pub fn is_short(&self) -> bool {
        self.whole.is_empty()
    }

    /// The neighbours of the chunk's `k`-th slot, eight at a time. Lists are padded to whole eights
    /// with the sentinel or with a particle out of reach; `E` is the type in which the chunk stores
    /// them.
    #[inline(always)]
    pub fn neighbours<E: Entry>(&self, k: usize) -> impl ExactSizeIterator<Item = Eight<'_, E>> {
        E::of(self)[self.range(k)].iter().map(|entries| Eight { base: self.base, entries })
    }

    /// The box, as pairs of the chunk's `k`-th slot need it.
    #[inline(always)]
    pub fn around(&self, k: usize, space: Space) -> Surroundings {
        Surroundings { space, seam: self.seam[k] }
    }

    /// Number of eights in all lists.
    pub fn batches(&self) -> usize {
        self.short.len() + self.whole.len()
    }

    /// Resizes `masks` to [`Self::batches`] zeros.
    pub fn make_masks(&self, masks: &mut Vec<u8>) {
        masks.clear();
        masks.reserve_exact(self.most_masks());
        masks.resize(self.batches(), 0);
    }

    /// Capacity of the lists, in eights.
    pub fn most_masks(&self) -> usize {
        self.short.capacity().max(self.whole.capacity())
    }

    /// The range of the `k`-th slot's eights among [`Self::batches`].
    #[inline(always)]
    pub fn range(&self, k: usize) -> std::ops::Range<usize> {
        self.start[k] as usize..self.start[k + 1] as usize
    }

    /// The slot at a place in the lists.
    #[inline(always)]
    fn slot(&self, place: usize) -> usize {
        let (batch, lane) = (place / WIDTH, place % WIDTH);
        match self.short.get(batch) {
            Some(near) => self.base + near[lane].distance(),
            None => self.whole[batch][lane].distance(),
        }
    }

    /// The slots of the chunk's `k`-th slot's neighbours.
    pub fn slots_of(&self, k: usize) -> impl ExactSizeIterator<Item = usize> {
        let batches = self.range(k);
        (WIDTH * batches.start..WIDTH * batches.end).map(|place| self.slot(place))
    }

    /// Prefetches the lines of the neighbours of the chunk's `k`-th slot, if there is one, where
    /// the lines do not fit the cache.
    #[inline(always)]
    pub fn fetch_ahead<W: SimdFloat, E: Entry>(&self, k: usize, lines: &[W::Line]) {
        if k < self.len() {
            fetch::<W, E>(self.neighbours(k), lines);
        }
    }

    /// The slot from which the neighbours of slots from `first` on are counted, in a flow of
    /// `particles` particles. The chunk lies in the middle of the 16-bit range.
    #[inline(always)]
    pub fn base_of(first: usize, particles: usize) -> usize {
        let middle = (first + CHUNK / 2).saturating_sub(FEW.div_ceil(2));
        middle.min(particles.saturating_sub(FEW))
    }

    /// Becomes a copy of lists of a flow of `particles` particles. The first copy reserves exactly
    /// what it needs; a later one that must grow reserves a sixteenth more, so that it seldom does.
    #[inline(always)]
    pub fn copy_from(&mut self, list_builder: &ListBuilder, particles: usize) {
        self.copy_slots(list_builder);
        let base = Self::base_of(list_builder.first, particles);
        let eights = list_builder.eights();
        // Slots before the base wrap to the largest numbers.
        let from_base = eights.as_flattened().iter().map(|slot| slot.wrapping_sub(base as u32));
        if particles > FEW && from_base.fold(0, u32::max) as usize > FEW {
            self.base = 0;
            self.short.clear();
            copy(&mut self.whole, eights);
            return;
        }
        self.base = base;
        self.whole.clear();
        let short = |eight: &[u32; WIDTH]| {
            let mut short = [0; WIDTH];
            for (short, slot) in short.iter_mut().zip(eight) {
                *short = slot.wrapping_sub(base as u32) as u16;
            }
            short
        };
        renew(&mut self.short, eights.iter().map(short));
    }

    /// As [`Self::copy_from`], for lists that are already counted from [`Self::base_of`].
    #[inline(always)]
    pub fn copy_short(&mut self, lists: &Lists<u16>, particles: usize) {
        self.copy_slots(lists);
        self.base = Self::base_of(lists.first, particles);
        self.whole.clear();
        copy(&mut self.short, lists.eights());
    }

    /// Copies everything except the neighbours.
    #[inline(always)]
    fn copy_slots<E>(&mut self, lists: &Lists<E>) {
        self.first = lists.first;
        copy(&mut self.seam, lists.seam());
        renew(&mut self.start, lists.starts().map(|start| start / WIDTH as u32));
    }

    /// For each slot, whether some neighbour may be across the periodic boundary.
    pub(crate) fn seam(&self) -> &[bool] {
        &self.seam
    }
}

/// Prefetches the lines of some particles, where the lines do not fit the cache.
#[inline(always)]
pub(crate) fn fetch<'a, W: SimdFloat, E: Entry>(
    eights: impl Iterator<Item = Eight<'a, E>>,
    lines: &[W::Line],
) {
    if size_of_val(lines) <= FITS_CACHE {
        return;
    }
    // Two loops: the compiler does not unroll one over flattened arrays, which costs more than it
    // saves.
    for others in eights {
        for line in pick(lines, others) {
            W::fetch(line);
        }
    }
}

/// Replaces the content of a vector.
#[inline(always)]
fn copy<T: Copy>(into: &mut Vec<T>, from: &[T]) {
    renew(into, from.iter().copied());
}

/// Replaces the content of a vector. Reserves a sixteenth more where it must grow.
#[inline(always)]
fn renew<T>(into: &mut Vec<T>, from: impl ExactSizeIterator<Item = T>) {
    into.clear();
    if into.capacity() < from.len() {
        let more = if into.capacity() == 0 { 0 } else { from.len() / 16 };
        into.reserve_exact(from.len() + more);
    }
    into.extend(from);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Lists of two slots from `first` on; the second lacks the first neighbour of the first.
    fn list_builder(first: usize, slots: &[u32], filler: usize) -> ListBuilder {
        let mut list_builder = ListBuilder::default();
        list_builder.clear();
        list_builder.first = first;
        for slots in [slots, &slots[1..]] {
            list_builder.open(slots.len())[..slots.len()].copy_from_slice(slots);
            list_builder.fill(slots.len());
            list_builder.close(filler, false);
        }
        list_builder
    }

    #[test]
    fn lists_are_kept_as_they_were_written_near_and_far() {
        let million = 1_000_000;
        let near: Vec<u32> = (480_000..480_011).chain(520_000..520_006).collect();
        let mut chunk = Chunk::default();
        for (first, particles, slots, filler, bytes) in [
            (256, 65_535, &[0, 17, 300, 65_534][..], 65_535, 2),
            (0, 65_536, &[0, 300, 65_535], 5, 2),
            (0, 65_536, &[0, 300, 65_535], 65_536, 4),
            (65_280, 65_536, &[1, 300, 65_535], 65_536, 2),
            (500_000, million, &near[..], 500_300, 2),
            (500_000, million, &near[..], million, 4),
            (999_744, million, &[934_465, 999_999], million, 2),
            (999_744, million, &[934_464, 999_999], million, 4),
            (0, million, &[3, 7, 500_000, 999_999], 5000, 4),
            (512, million, &[5], 5000, 2),
        ] {
            let list_builder = list_builder(first, slots, filler);
            chunk.copy_from(&list_builder, particles);
            let written: Vec<u32> =
                (0..2).flat_map(|k| list_builder.neighbours(k)).flatten().copied().collect();
            fn kept<E: Entry>(chunk: &Chunk) -> Vec<u32> {
                let of = |k| chunk.neighbours::<E>(k).flat_map(|eight| eight.slots());
                (0..2).flat_map(of).collect()
            }
            let kept = if chunk.is_short() { kept::<u16>(&chunk) } else { kept::<u32>(&chunk) };
            assert_eq!(kept, written, "{first} of {particles}: {slots:?}");
            let all = (0..2).flat_map(|k| chunk.slots_of(k));
            assert!(all.eq(written.iter().map(|&slot| slot as usize)), "{slots:?}");
            assert_eq!(chunk.is_short(), bytes == 2, "{first} of {particles}: {slots:?}, {filler}");
            assert_eq!(
                [chunk.range(0).len(), chunk.batches()],
                [list_builder.neighbours(0).len(), written.len() / WIDTH]
            );
        }
    }
}
