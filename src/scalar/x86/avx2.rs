//! The `f64` type of AVX2.
#![allow(unsafe_code, reason = "instructions of a set that only `dispatch` has looked for")]
// SAFETY: see the parent module.

use super::*;
use crate::scalar::x86::singles::Doubles;

/// Eight `f64` in two registers of AVX2.
#[derive(Clone, Copy, Debug)]
pub(in crate::scalar) struct F64x8Avx2(pub(super) [__m256d; 2]);

arithmetic!([] F64x8Avx2);

on_registers! { [] F64x8Avx2, Self;
    plus _mm256_add_pd;
    minus _mm256_sub_pd;
    times _mm256_mul_pd;
    over _mm256_div_pd;
    xor _mm256_xor_pd;
    and _mm256_and_pd;
    or _mm256_or_pd;
    and_not _mm256_andnot_pd;
    smaller _mm256_min_pd;
    larger _mm256_max_pd;
}

impl Scalar for F64x8Avx2 {
    const TABLES: bool = false;

    #[inline(always)]
    fn of(x: f64) -> Self {
        Self([unsafe { _mm256_set1_pd(x) }; 2])
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        let [a, b] = self.0;
        Self(unsafe { [_mm256_sqrt_pd(a), _mm256_sqrt_pd(b)] })
    }
    #[inline(always)]
    fn select_less(a: Self, b: Self, yes: Self, no: Self) -> Self {
        let mut chosen = yes.0;
        for (k, chosen) in chosen.iter_mut().enumerate() {
            *chosen = unsafe {
                let less = _mm256_cmp_pd::<_CMP_LT_OQ>(a.0[k], b.0[k]);
                _mm256_blendv_pd(no.0[k], *chosen, less)
            };
        }
        Self(chosen)
    }
    through_memory!(exp, ln, tanh);
}

impl F64x8Avx2 {
    /// As [`F64x8Avx512::transpose_halves`].
    #[inline(always)]
    fn transpose_halves(rows: [*const f64; WIDTH]) -> [Self; 4] {
        let [a, b, c, d] = unsafe { four_columns(&rows, 0, 0) };
        let [e, f, g, h] = unsafe { four_columns(&rows, 4, 0) };
        [Self([a, e]), Self([b, f]), Self([c, g]), Self([d, h])]
    }

    /// As [`F64x8Avx512::transpose`].
    #[inline(always)]
    fn transpose(lines: [&Packed; WIDTH]) -> [Self; 8] {
        let rows = lines.map_each(half_of_packed);
        let mut fields = [Self::of(0.0); 8];
        for half in 0..2 {
            let low = unsafe { four_columns(&rows, 0, 4 * half) };
            let high = unsafe { four_columns(&rows, 4, 4 * half) };
            for k in 0..4 {
                fields[4 * half + k] = Self([low[k], high[k]]);
            }
        }
        fields
    }
}

/// Four numbers, starting at `offset`, of four rows, starting at `first`, transposed.
#[inline(always)]
unsafe fn four_columns(rows: &[*const f64; WIDTH], first: usize, offset: usize) -> [__m256d; 4] {
    unsafe {
        let row = |k: usize| _mm256_loadu_pd(rows[first + k].add(offset));
        let (a, b, c, d) = (row(0), row(1), row(2), row(3));
        let (even, odd) = (_mm256_unpacklo_pd(a, b), _mm256_unpackhi_pd(a, b));
        let (even2, odd2) = (_mm256_unpacklo_pd(c, d), _mm256_unpackhi_pd(c, d));
        [
            _mm256_permute2f128_pd::<0x20>(even, even2),
            _mm256_permute2f128_pd::<0x20>(odd, odd2),
            _mm256_permute2f128_pd::<0x31>(even, even2),
            _mm256_permute2f128_pd::<0x31>(odd, odd2),
        ]
    }
}

/// Compresses the elements in a mask to the front.
#[inline(always)]
unsafe fn front_of(mask: u8, numbers: __m256i) -> __m256i {
    unsafe {
        let lanes = &LANES_OF[usize::from(mask)];
        let lanes = _mm256_cvtepu8_epi32(_mm_loadl_epi64(lanes.as_ptr().cast()));
        _mm256_permutevar8x32_epi32(numbers, lanes)
    }
}

/// Which of eight unsigned words are less than a limit.
#[inline(always)]
unsafe fn less(words: __m256i, limit: u32) -> u8 {
    unsafe {
        // With the highest bit flipped, unsigned words compare as signed words do.
        let words = _mm256_xor_si256(words, _mm256_set1_epi32(i32::MIN));
        let limit = _mm256_set1_epi32(limit as i32 ^ i32::MIN);
        _mm256_movemask_ps(_mm256_castsi256_ps(_mm256_cmpgt_epi32(limit, words))) as u8
    }
}

/// The rest of [`SimdFloat::sum`], after the upper four lanes have been added to the lower four.
#[inline(always)]
pub(super) unsafe fn sum_of_four(four: __m256d) -> f64 {
    unsafe {
        let (low, high) = (_mm256_castpd256_pd128(four), _mm256_extractf128_pd::<1>(four));
        let two = _mm_add_pd(low, high);
        _mm_cvtsd_f64(_mm_add_sd(two, _mm_unpackhi_pd(two, two)))
    }
}

impl SimdFloat for F64x8Avx2 {
    wide_doubles!();

    #[inline(always)]
    fn load(memory: &F64x8) -> Self {
        let memory: *const f64 = std::ptr::from_ref(memory).cast();
        Self(unsafe { [_mm256_loadu_pd(memory), _mm256_loadu_pd(memory.add(4))] })
    }
    #[inline(always)]
    fn store(self) -> F64x8 {
        let mut lanes = F64x8::ZERO;
        let memory: *mut f64 = std::ptr::from_mut(&mut lanes).cast();
        unsafe {
            _mm256_storeu_pd(memory, self.0[0]);
            _mm256_storeu_pd(memory.add(4), self.0[1]);
        }
        lanes
    }
    #[inline(always)]
    fn power_of_two(shifted: Self) -> Self {
        unsafe {
            let bias = _mm256_set1_epi64x(1023 << 52);
            let power = |x: __m256d| {
                let exponent = _mm256_slli_epi64::<52>(_mm256_castpd_si256(x));
                _mm256_castsi256_pd(_mm256_add_epi64(exponent, bias))
            };
            Self([power(shifted.0[0]), power(shifted.0[1])])
        }
    }
    #[inline(always)]
    fn near<C: AsRef<[i32]>, const D: usize>(
        columns: &[C; D],
        here: [i32; D],
        first: usize,
        limits: [f32; 2],
    ) -> [u16; 2] {
        let mut masks = [0; 2];
        for half in 0..2 {
            unsafe {
                let mut square = _mm256_setzero_ps();
                for (column, here) in columns.iter().zip(here) {
                    let from = first + half * WIDTH;
                    let there =
                        _mm256_loadu_si256(column.as_ref()[from..from + WIDTH].as_ptr().cast());
                    let apart = _mm256_sub_epi32(_mm256_set1_epi32(here), there);
                    let apart = _mm256_cvtepi32_ps(apart);
                    square = _mm256_add_ps(square, _mm256_mul_ps(apart, apart));
                }
                for (mask, limit) in masks.iter_mut().zip(limits) {
                    let less = _mm256_cmp_ps::<_CMP_LT_OQ>(square, _mm256_set1_ps(limit));
                    *mask |= (_mm256_movemask_ps(less) as u16) << (half * WIDTH);
                }
            }
        }
        masks
    }
    #[inline(always)]
    fn gather<C: AsRef<[i32]>, const D: usize>(
        columns: &[C; D],
        window: &Window<D>,
        (first, inside): (usize, u16),
        tag: u16,
        [xy, zt]: [&mut [u32; 2 * WIDTH]; 2],
    ) -> u16 {
        /// The high half of every word.
        const UPPER: i32 = 0xaa;
        let (mut found, mut next) = (0, 0);
        for eight in 0..2 {
            unsafe {
                let zero = _mm256_setzero_si256();
                let (mut places, mut half) = ([zero; 4], [0; 4]);
                for (axis, (column, middle)) in columns.iter().zip(window.middle).enumerate() {
                    let from = first + eight * WIDTH;
                    let there =
                        _mm256_loadu_si256(column.as_ref()[from..from + WIDTH].as_ptr().cast());
                    let apart = _mm256_sub_epi32(there, _mm256_set1_epi32(middle));
                    places[axis] = _mm256_sra_epi32(apart, _mm_cvtsi32_si128(window.shift as i32));
                    half[axis] = i32::from(window.half[axis]);
                }
                let y = _mm256_slli_epi32::<16>(places[1]);
                let words = [
                    _mm256_blend_epi16::<UPPER>(places[0], y),
                    _mm256_blend_epi16::<UPPER>(places[2], zero),
                ];
                let mut square = zero;
                for (word, half) in words.iter().zip([half[0] | half[1] << 16, half[2]]).take(D - 1)
                {
                    let outside =
                        _mm256_subs_epu16(_mm256_abs_epi16(*word), _mm256_set1_epi32(half));
                    square = _mm256_add_epi32(square, _mm256_madd_epi16(outside, outside));
                }
                let mask = (inside >> (eight * WIDTH)) as u8 & less(square, window.limit);
                let tags = _mm256_add_epi32(
                    _mm256_set1_epi32(i32::from(tag) + (eight * WIDTH) as i32),
                    _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7),
                );
                let tagged = _mm256_or_si256(words[1], _mm256_slli_epi32::<16>(tags));
                // The second eight overwrite the unused elements of the first.
                for (word, kept) in [words[0], tagged].into_iter().zip([&mut *xy, &mut *zt]) {
                    let to = kept[next..next + WIDTH].as_mut_ptr();
                    _mm256_storeu_si256(to.cast(), front_of(mask, word));
                }
                next += mask.count_ones() as usize;
                found |= u16::from(mask) << (eight * WIDTH);
            }
        }
        found
    }
    #[inline(always)]
    fn within([xy, zt]: [&[u32; 2 * WIDTH]; 2], here: [u32; 2], limits: [u32; 2]) -> [u16; 2] {
        let mut masks = [0; 2];
        for half in 0..2 {
            unsafe {
                let [xy_here, z_here] = here.map(|word| _mm256_set1_epi32(word as i32));
                let eight = |words: &[u32; 2 * WIDTH]| {
                    _mm256_loadu_si256(words[half * WIDTH..].as_ptr().cast())
                };
                let xy = _mm256_sub_epi16(xy_here, eight(xy));
                let zt = _mm256_sub_epi16(z_here, eight(zt));
                // The high half of `zt` is a difference of tags; multiplied by zero.
                let z = _mm256_and_si256(zt, _mm256_set1_epi32(0xffff));
                let square = _mm256_add_epi32(_mm256_madd_epi16(xy, xy), _mm256_madd_epi16(zt, z));
                for (mask, limit) in masks.iter_mut().zip(limits) {
                    *mask |= u16::from(less(square, limit)) << (half * WIDTH);
                }
            }
        }
        masks
    }
    #[inline(always)]
    fn sum(self) -> f64 {
        unsafe { sum_of_four(_mm256_add_pd(self.0[0], self.0[1])) }
    }
    #[inline(always)]
    fn nonzero(self) -> u8 {
        let mut mask = 0;
        for half in 0..2 {
            unsafe {
                let apart = _mm256_cmp_pd::<_CMP_NEQ_UQ>(_mm256_setzero_pd(), self.0[half]);
                mask |= (_mm256_movemask_pd(apart) as u8) << (4 * half);
            }
        }
        mask
    }
    #[inline(always)]
    fn keep_slots(mask: u8, slots: &[u32; WIDTH], kept: &mut [u32; WIDTH]) {
        unsafe {
            let front = front_of(mask, _mm256_loadu_si256(slots.as_ptr().cast()));
            _mm256_storeu_si256(kept.as_mut_ptr().cast(), front);
        }
    }
    #[inline(always)]
    fn keep_tags(mask: u16, words: &[u32; 2 * WIDTH], kept: &mut [u16; 2 * WIDTH]) {
        let [low, high] = mask.to_le_bytes();
        let middle = low.count_ones() as usize;
        // The second eight overwrite the unused elements of the first.
        for (mask, from, to) in [(low, 0, 0), (high, WIDTH, middle)] {
            let (from, to) = (&words[from..from + WIDTH], &mut kept[to..to + WIDTH]);
            unsafe {
                let front = front_of(mask, _mm256_loadu_si256(from.as_ptr().cast()));
                let tags = _mm256_srli_epi32::<16>(front);
                let (first, last) =
                    (_mm256_castsi256_si128(tags), _mm256_extracti128_si256::<1>(tags));
                _mm_storeu_si128(to.as_mut_ptr().cast(), _mm_packus_epi32(first, last));
            }
        }
    }
}

impl Doubles for F64x8Avx2 {
    #[inline(always)]
    fn of_singles(singles: __m256) -> Self {
        Self(unsafe {
            let low = _mm256_cvtps_pd(_mm256_castps256_ps128(singles));
            [low, _mm256_cvtps_pd(_mm256_extractf128_ps::<1>(singles))]
        })
    }
    #[inline(always)]
    fn to_singles(self) -> __m256 {
        unsafe {
            let low = _mm256_castps128_ps256(_mm256_cvtpd_ps(self.0[0]));
            _mm256_insertf128_ps::<1>(low, _mm256_cvtpd_ps(self.0[1]))
        }
    }
}
