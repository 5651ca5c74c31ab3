//! The listed neighbours within the support, eight at a time.

use crate::neighbours::chunk::{CHUNK, Chunk, Eight, Entry, fetch};
use crate::pairs::Surroundings;
use crate::scalar::{SimdFloat, SimdTask, WIDTH, dispatch};
use crate::space::Space;

/// The neighbours within `2h` of [`CHUNK`] consecutive slots. All loops over pairs run over these,
/// except that of the density.
///
/// The lists of a [`Chunk`] reach a skin farther. The density summation knows which neighbours are
/// within the support: it writes a mask of nonzero weights for each eight.
#[derive(Clone, Debug, Default)]
pub struct Near {
    /// First slot.
    pub first: usize,
    /// Index of each slot's first eight, and the total at the end.
    start: Vec<u32>,
    /// Slots of neighbours; elements past the last list are unused.
    slots: Vec<[u32; WIDTH]>,
    /// For each slot, whether some neighbour may be across the periodic boundary.
    seam: Vec<bool>,
}

impl Near {
    /// Number of slots.
    pub fn len(&self) -> usize {
        self.start.len().saturating_sub(1)
    }

    /// Whether there are no slots.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        4 * (WIDTH * self.slots.capacity() + self.start.capacity()) + self.seam.capacity()
    }

    /// Number of eights in all.
    pub fn batches(&self) -> usize {
        self.start.last().map_or(0, |&end| end as usize)
    }

    /// The range of the `k`-th slot's eights among [`Self::batches`].
    #[inline(always)]
    pub fn range(&self, k: usize) -> std::ops::Range<usize> {
        self.start[k] as usize..self.start[k + 1] as usize
    }

    /// The neighbours of the `k`-th slot, eight at a time, padded to whole eights with the
    /// sentinel.
    #[inline(always)]
    pub fn neighbours(&self, k: usize) -> impl ExactSizeIterator<Item = Eight<'_, u32>> {
        self.slots[self.range(k)].iter().map(Eight::from)
    }

    /// The box, as pairs of the `k`-th slot need it.
    #[inline(always)]
    pub fn around(&self, k: usize, space: Space) -> Surroundings {
        Surroundings { space, seam: self.seam[k] }
    }

    /// The slot at one of the `WIDTH` times [`Self::batches`] places.
    #[inline(always)]
    pub fn slot(&self, place: usize) -> usize {
        self.slots[place / WIDTH][place % WIDTH] as usize
    }

    /// The slots at all places.
    pub fn slots(&self) -> impl DoubleEndedIterator<Item = usize> {
        self.slots[..self.batches()].as_flattened().iter().map(|&slot| slot as usize)
    }

    /// Prefetches the lines of the neighbours of the `k`-th slot, if there is one, where the lines
    /// do not fit the cache.
    #[inline(always)]
    pub fn fetch_ahead<W: SimdFloat>(&self, k: usize, lines: &[W::Line]) {
        if k < self.len() {
            fetch::<W, u32>(self.neighbours(k), lines);
        }
    }

    /// Makes room for this many eights.
    pub fn make_room(&mut self, eights: usize) {
        // Each write is a whole register and may reach past the last neighbour.
        if self.slots.len() <= eights {
            self.slots.resize(eights + 1, [0; WIDTH]);
        }
        self.start.reserve((CHUNK + 1).saturating_sub(self.start.len()));
        self.seam.reserve(CHUNK.saturating_sub(self.seam.len()));
    }

    /// Copies the neighbours of a chunk's lists that are in the masks; `sentinel` is the index of the
    /// sentinel, one past the last particle.
    pub fn find(&mut self, lists: &Chunk, masks: &[u8], sentinel: usize) {
        self.make_room(lists.batches());
        self.first = lists.first;
        self.seam.clear();
        self.seam.extend_from_slice(lists.seam());
        self.start.clear();
        self.start.push(0);
        dispatch(Sift { lists, masks, sentinel: [sentinel as u32; WIDTH], near: self });
    }
}

/// Copies the neighbours of a chunk's lists that are in masks.
struct Sift<'a> {
    lists: &'a Chunk,
    masks: &'a [u8],
    sentinel: [u32; WIDTH],
    near: &'a mut Near,
}

impl SimdTask for Sift<'_> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        if self.lists.is_short() { self.sweep::<W, u16>() } else { self.sweep::<W, u32>() }
    }
}

impl Sift<'_> {
    #[inline(always)]
    fn sweep<W: SimdFloat, E: Entry>(self) {
        let Self { lists, masks, sentinel, near: Near { start, slots, .. } } = self;
        let slots = slots.as_flattened_mut();
        let mut filled = 0;
        for k in 0..lists.len() {
            for (eight, &mask) in lists.neighbours::<E>(k).zip(&masks[lists.range(k)]) {
                if let Some(kept) = slots[filled..].first_chunk_mut() {
                    W::keep_slots(mask, &eight.slots(), kept);
                }
                filled += mask.count_ones() as usize;
            }
            slots[filled..filled + WIDTH].copy_from_slice(&sentinel);
            filled = filled.next_multiple_of(WIDTH);
            start.push((filled / WIDTH) as u32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::neighbours::list_builder::ListBuilder;

    #[test]
    fn who_is_near_is_who_is_in_the_masks_of_short_and_of_whole_lists() {
        let million = 1_000_000;
        for (first, far) in [(400_000, 400_500), (0, 999_990)] {
            let lists = [0, 1, 8, 21].map(|count| {
                let all = (0..count).map(|k| if k % 2 == 0 { first + 3 * k } else { far - k });
                all.collect::<Vec<u32>>()
            });
            let (mut list_builder, mut chunk) = (ListBuilder::default(), Chunk::default());
            list_builder.clear();
            list_builder.first = first as usize;
            for (k, list) in lists.iter().enumerate() {
                list_builder.open(list.len())[..list.len()].copy_from_slice(list);
                list_builder.fill(list.len());
                list_builder.close(first as usize, k == 2);
            }
            chunk.copy_from(&list_builder, million as usize);
            assert_eq!(chunk.is_short(), first > 0);
            let masks = [0b1, 0b1010_0110, 0b1111_0001, 0, 0b1_0110];
            let mut near = Near::default();
            // Content of an earlier chunk, to be overwritten.
            near.find(&chunk, &[0xff; 5], 7);
            near.find(&chunk, &masks, million as usize);
            assert_eq!((near.len(), near.first), (4, first as usize));
            for (k, list) in lists.iter().enumerate() {
                let place = chunk.range(k).start;
                let in_mask =
                    |&(n, _): &(usize, &u32)| masks[place + n / WIDTH] >> (n % WIDTH) & 1 == 1;
                let kept: Vec<u32> =
                    list.iter().enumerate().filter(in_mask).map(|(_, &slot)| slot).collect();
                let found: Vec<u32> = near.neighbours(k).flat_map(|eight| eight.slots()).collect();
                let (some, sentinel) = found.split_at(kept.len());
                assert_eq!(some, kept, "{k} from {first}");
                assert!(sentinel.len() < WIDTH && sentinel.iter().all(|&slot| slot == million));
                assert_eq!(near.around(k, Space::cube(1.0)).seam, k == 2);
            }
        }
    }
}
