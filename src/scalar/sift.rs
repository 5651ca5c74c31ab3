//! Portable forms of the operations of [`SimdFloat`](super::Wide) in neighbour searches: which of
//! sixteen places are near, and the compression of masked elements.

use super::WIDTH;

/// The set bits of each 8-bit mask, in ascending order.
pub(super) const LANES_OF: [[u8; WIDTH]; 256] = {
    let mut table = [[0; WIDTH]; 256];
    let mut mask = 0;
    while mask < 256 {
        let (mut lane, mut count) = (0, 0);
        while lane < WIDTH {
            if mask >> lane & 1 == 1 {
                table[mask][count] = lane as u8;
                count += 1;
            }
            lane += 1;
        }
        mask += 1;
    }
    table
};

/// Half of [`SimdFloat::compress`], by a table.
#[inline(always)]
fn compress_by_table(mask: u8, first: u32, kept: &mut [u32; WIDTH]) {
    for (kept, &lane) in kept.iter_mut().zip(&LANES_OF[usize::from(mask)]) {
        *kept = first + u32::from(lane);
    }
}

/// [`SimdFloat::near`] place by place.
#[inline(always)]
pub(super) fn near_by_loop<C: AsRef<[i32]>, const D: usize>(
    columns: &[C; D],
    here: [i32; D],
    first: usize,
    limits: [f32; 2],
) -> [u16; 2] {
    let mut masks = [0; 2];
    for place in 0..2 * WIDTH {
        let mut square = 0.0;
        for (column, here) in columns.iter().zip(here) {
            let apart = here.wrapping_sub(column.as_ref()[first + place]) as f32;
            square += apart * apart;
        }
        for (mask, limit) in masks.iter_mut().zip(limits) {
            *mask |= u16::from(square < limit) << place;
        }
    }
    masks
}

/// The neighbourhood of a cell, in which places are stored with 16 bits along each axis. A
/// coordinate is counted from the middle, in steps of `2^shift` fixed-point steps. Two cell widths
/// are at most 2¹⁵ steps.
///
/// A box less than four cells wide is exactly 2¹⁶ steps wide, so that differences wrap around as
/// the box does.
#[derive(Clone, Copy, Debug)]
pub struct Window<const D: usize> {
    /// The middle, in fixed-point steps.
    pub middle: [i32; D],
    /// Base-2 logarithm of a window step in fixed-point steps.
    pub shift: u32,
    /// Half the width of a box around the middle along each axis, in steps.
    pub half: [u16; D],
    /// Squared distance from that box, in steps, from which on a place is out of reach.
    pub limit: u32,
}

impl<const D: usize> Window<D> {
    /// A place of fixed-point coordinates as two words: x in the low and y in the high half of the
    /// first, z in the low half of the second.
    #[inline(always)]
    pub fn words(&self, place: [i32; D]) -> [u32; 2] {
        let mut halves = [0; 4];
        for (axis, half) in halves.iter_mut().enumerate().take(D) {
            *half = u32::from((place[axis].wrapping_sub(self.middle[axis]) >> self.shift) as u16);
        }
        [halves[0] | halves[1] << 16, halves[2]]
    }
}

/// The low and the high half of a word, as signed numbers.
#[inline(always)]
fn halves(word: u32) -> [i16; 2] {
    [word as u16 as i16, (word >> 16) as u16 as i16]
}

/// `a² + b²`, modulo 2³².
#[inline(always)]
fn sum_of_squares(halves: [i16; 2]) -> u32 {
    let [a, b] = halves.map(|half| u32::from(half.unsigned_abs()));
    a * a + b * b
}

/// [`SimdFloat::gather`] place by place.
#[inline(always)]
pub(super) fn gather_by_loop<C: AsRef<[i32]>, const D: usize>(
    columns: &[C; D],
    window: &Window<D>,
    (first, inside): (usize, u16),
    tag: u16,
    kept: [&mut [u32; 2 * WIDTH]; 2],
) -> u16 {
    let half = |axis: usize| window.half.get(axis).copied().unwrap_or(0);
    let box_around = [[half(0), half(1)], [half(2), 0]];
    let [xy, zt] = kept;
    let (mut mask, mut next) = (0, 0);
    for place in 0..2 * WIDTH {
        let mut there = [0; D];
        for (there, column) in there.iter_mut().zip(columns) {
            *there = column.as_ref()[first + place];
        }
        let words = window.words(there);
        let mut square = 0_u32;
        for (word, half) in words.into_iter().zip(box_around) {
            let [low, high] = halves(word);
            let outside = [
                low.unsigned_abs().saturating_sub(half[0]) as i16,
                high.unsigned_abs().saturating_sub(half[1]) as i16,
            ];
            square = square.wrapping_add(sum_of_squares(outside));
        }
        // Never past the end: `next` is at most `place`.
        xy[next] = words[0];
        zt[next] = words[1] | u32::from(tag.wrapping_add(place as u16)) << 16;
        let near = square < window.limit && inside >> place & 1 == 1;
        mask |= u16::from(near) << place;
        next += usize::from(near);
    }
    mask
}

/// [`SimdFloat::within`] place by place.
#[inline(always)]
pub(super) fn within_by_loop(
    [xy, zt]: [&[u32; 2 * WIDTH]; 2],
    here: [u32; 2],
    limits: [u32; 2],
) -> [u16; 2] {
    let mut masks = [0; 2];
    let [[x, y], [z, _]] = here.map(halves);
    for (place, (xy, zt)) in xy.iter().zip(zt).enumerate() {
        let ([x_there, y_there], [z_there, _]) = (halves(*xy), halves(*zt));
        let apart = [x.wrapping_sub(x_there), y.wrapping_sub(y_there)];
        let square =
            sum_of_squares(apart).wrapping_add(sum_of_squares([z.wrapping_sub(z_there), 0]));
        for (mask, limit) in masks.iter_mut().zip(limits) {
            *mask |= u16::from(square < limit) << place;
        }
    }
    masks
}

/// [`SimdFloat::keep_tags`] place by place.
#[inline(always)]
pub(super) fn keep_tags_by_loop(mask: u16, words: &[u32; 2 * WIDTH], kept: &mut [u16; 2 * WIDTH]) {
    let mut next = 0;
    for (place, &word) in words.iter().enumerate() {
        // Never past the end: `next` is at most `place`.
        kept[next] = (word >> 16) as u16;
        next += usize::from(mask >> place & 1);
    }
}

/// [`SimdFloat::keep_slots`] by a table.
#[inline(always)]
pub(super) fn keep_slots_by_table(mask: u8, slots: &[u32; WIDTH], kept: &mut [u32; WIDTH]) {
    for (kept, &lane) in kept.iter_mut().zip(&LANES_OF[usize::from(mask)]) {
        *kept = slots[usize::from(lane)];
    }
}

/// [`SimdFloat::compress`] by a table.
#[inline(always)]
pub(super) fn compress_in_two(mask: u16, first: u32, kept: &mut [u32; 2 * WIDTH]) {
    let [low, high] = mask.to_le_bytes();
    let mut half = [0; WIDTH];
    compress_by_table(low, first, &mut half);
    kept[..WIDTH].copy_from_slice(&half);
    compress_by_table(high, first + WIDTH as u32, &mut half);
    let place = low.count_ones() as usize;
    kept[place..place + WIDTH].copy_from_slice(&half);
}

#[cfg(test)]
mod tests {
    use super::Window;
    use crate::scalar::{F64x8, Precision, SimdFloat, SimdTask, WIDTH, on_every_instruction_set};

    /// All operations on sixteen places, applied to a few columns of them.
    #[derive(Clone)]
    struct Sift<'a> {
        columns: &'a [Vec<i32>; 3],
        slots: &'a [u32; 2 * WIDTH],
    }

    impl SimdTask for Sift<'_> {
        type Output = (Vec<u16>, Vec<u32>, Vec<u32>);

        #[inline(always)]
        fn run<W: SimdFloat>(self) -> Self::Output {
            let Self { columns, slots } = self;
            let (mut masks, mut places, mut numbers) = (Vec::new(), Vec::new(), Vec::new());
            for first in 0..2 * WIDTH {
                let here = [columns[0][first], columns[1][first], columns[2][first]];
                let [near, maybe] = W::near(columns, here, first, [1e18, 2e18]);
                let window = Window {
                    middle: here,
                    shift: 16,
                    half: [5000, 3000, 7000],
                    limit: 20_000 * 20_000,
                };
                let (inside, tag) = (0xfeff, 65_530 + first as u16 % 5);
                let (mut xy, mut zt) = ([0; 2 * WIDTH], [0; 2 * WIDTH]);
                let mask = W::gather(columns, &window, (first, inside), tag, [&mut xy, &mut zt]);
                let count = mask.count_ones() as usize;
                places.extend([xy, zt].iter().flat_map(|words| &words[..count]));
                // Arbitrary words in the unspecified elements.
                for (place, word) in xy.iter_mut().chain(&mut zt).enumerate() {
                    if place % (2 * WIDTH) >= count {
                        *word = (place as u32 + 1).wrapping_mul(0x9e37_79b9);
                    }
                }
                let here = window.words(here.map(|x| x.wrapping_add(1 << 28)));
                let limits = [20_000 * 20_000, 3 << 29];
                let within = W::within([&xy, &zt], here, limits);
                let mut tags = [0; 2 * WIDTH];
                W::keep_tags(within[1], &zt, &mut tags);
                numbers
                    .extend(tags[..within[1].count_ones() as usize].iter().copied().map(u32::from));
                masks.extend([near, maybe, mask, within[0], within[1]]);
                let mut all = [0; 2 * WIDTH];
                W::compress(maybe, first as u32, &mut all);
                if let Some(eight) = slots.first_chunk() {
                    let mut some = [0; WIDTH];
                    W::keep_slots(mask as u8, eight, &mut some);
                    numbers.extend(&some[..(mask as u8).count_ones() as usize]);
                }
                let mut lanes = F64x8::ZERO;
                (0..WIDTH).for_each(|l| lanes.set_lane(l, f64::from(columns[0][first + l] >> 30)));
                lanes.set_lane(first % WIDTH, f64::NAN);
                masks.push(u16::from(W::load(&lanes).nonzero()));
                numbers.extend(&all[..maybe.count_ones() as usize]);
            }
            (masks, places, numbers)
        }
    }

    #[test]
    fn places_are_sifted_alike_by_every_instruction_set() {
        let place = |axis: u32, k: u32| (k + 1).wrapping_mul(2_654_435_761 + 97 * axis) as i32;
        let column = |axis| (0..4 * WIDTH as u32).map(|k| place(axis, k)).collect();
        let columns = &[column(0), column(1), column(2)];
        let slots = &std::array::from_fn(|k| 1000 + 3 * k as u32);
        for precision in Precision::ALL {
            let all = on_every_instruction_set(precision, &Sift { columns, slots });
            let (_, (masks, ..)) = &all[0];
            assert!(masks.iter().any(|mask| (1..15).contains(&mask.count_ones())), "{masks:?}");
            for (name, found) in &all[1..] {
                assert_eq!(*found, all[0].1, "{name}, {}", precision.name());
            }
        }
    }
}
