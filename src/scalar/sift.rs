//! Who of sixteen is near, and those alone in order: the plain forms of what [`Wide`](super::Wide) does while
//! neighbours are searched.

use super::WIDTH;

/// For every mask the lanes that are in it, in order.
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

/// Half of [`Wide::compress`], by table.
#[inline(always)]
fn compress_by_table(mask: u8, first: u32, kept: &mut [u32; WIDTH]) {
    for (kept, &lane) in kept.iter_mut().zip(&LANES_OF[usize::from(mask)]) {
        *kept = first + u32::from(lane);
    }
}

/// [`Wide::near`] place by place.
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

/// [`Wide::near_box`] place by place.
#[inline(always)]
pub(super) fn near_box_by_loop<C: AsRef<[i32]>, const D: usize>(
    columns: &[C; D],
    (middle, half): ([i32; D], [f32; D]),
    first: usize,
    limit: f32,
) -> u16 {
    let mut mask = 0;
    for place in 0..2 * WIDTH {
        let mut square = 0.0;
        for ((column, middle), half) in columns.iter().zip(middle).zip(half) {
            let apart = column.as_ref()[first + place].wrapping_sub(middle) as f32;
            let outside = (apart.abs() - half).max(0.0);
            square += outside * outside;
        }
        mask |= u16::from(square < limit) << place;
    }
    mask
}

/// [`Wide::keep`] place by place.
#[inline(always)]
pub(super) fn keep_by_loop(mask: u16, all: &[i32; 2 * WIDTH], kept: &mut [i32; 2 * WIDTH]) {
    let mut next = 0;
    for (place, &number) in all.iter().enumerate() {
        // Never behind the end: as many were kept as came before.
        kept[next] = number;
        next += usize::from(mask >> place & 1);
    }
}

/// [`Wide::keep_slots`] by table.
#[inline(always)]
pub(super) fn keep_slots_by_table(mask: u8, slots: &[u32; WIDTH], kept: &mut [u32; WIDTH]) {
    for (kept, &lane) in kept.iter_mut().zip(&LANES_OF[usize::from(mask)]) {
        *kept = slots[usize::from(lane)];
    }
}

/// [`Wide::keep_others`] place by place.
#[inline(always)]
pub(super) fn keep_others_by_loop(
    mask: u16,
    slots: &[u32; 2 * WIDTH],
    own: u32,
    kept: &mut [u32; 2 * WIDTH],
) -> usize {
    let mut next = 0;
    for (place, &slot) in slots.iter().enumerate() {
        // Never behind the end: as many were kept as came before.
        kept[next] = slot;
        next += usize::from(mask >> place & 1 == 1 && slot != own);
    }
    next
}

/// [`Wide::compress`] by table.
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
    use crate::scalar::{Lanes, Pass, Precision, WIDTH, Wide, on_every_instruction_set};

    /// Everything that sifts sixteen places, over a few columns of them.
    #[derive(Clone)]
    struct Sift<'a> {
        columns: &'a [Vec<i32>; 3],
        slots: &'a [u32; 2 * WIDTH],
    }

    impl Pass for Sift<'_> {
        type Output = (Vec<u16>, Vec<i32>, Vec<u32>);

        #[inline(always)]
        fn run<W: Wide>(self) -> Self::Output {
            let Self { columns, slots } = self;
            let (mut masks, mut places, mut numbers) = (Vec::new(), Vec::new(), Vec::new());
            for first in 0..2 * WIDTH {
                let here = [columns[0][first], columns[1][first], columns[2][first]];
                let [near, maybe] = W::near(columns, here, first, [1e18, 2e18]);
                let mask = W::near_box(columns, (here, [3e8, 2e8, 4e8]), first, 1.5e18);
                masks.extend([near, maybe, mask]);
                for column in columns {
                    let mut kept = [0; 2 * WIDTH];
                    if let Some(all) = column[first..].first_chunk() {
                        W::keep(mask, all, &mut kept);
                    }
                    places.extend(&kept[..mask.count_ones() as usize]);
                }
                let (mut others, mut all) = ([0; 2 * WIDTH], [0; 2 * WIDTH]);
                let found = W::keep_others(near, slots, slots[first], &mut others);
                W::compress(maybe, first as u32, &mut all);
                if let Some(eight) = slots.first_chunk() {
                    let mut some = [0; WIDTH];
                    W::keep_slots(mask as u8, eight, &mut some);
                    numbers.extend(&some[..(mask as u8).count_ones() as usize]);
                }
                let mut lanes = Lanes::ZERO;
                (0..WIDTH).for_each(|l| lanes.set_lane(l, f64::from(columns[0][first + l] >> 30)));
                lanes.set_lane(first % WIDTH, f64::NAN);
                masks.push(u16::from(W::load(&lanes).nonzero()));
                numbers.extend(&others[..found]);
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
