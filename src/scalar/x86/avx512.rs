//! The `f64` type of AVX-512.
#![allow(unsafe_code, reason = "instructions of a set that only `dispatch` has looked for")]
// SAFETY: see the parent module.

use super::avx2::sum_of_four;
use super::*;
use crate::scalar::x86::singles::Doubles;

/// Eight `f64` in one register of AVX-512.
#[derive(Clone, Copy, Debug)]
pub(in crate::scalar) struct F64x8Avx512(pub(super) [__m512d; 1]);

arithmetic!([] F64x8Avx512);

on_registers! { [] F64x8Avx512, Self;
    plus _mm512_add_pd;
    minus _mm512_sub_pd;
    times _mm512_mul_pd;
    over _mm512_div_pd;
    xor _mm512_xor_pd;
    and _mm512_and_pd;
    or _mm512_or_pd;
    and_not _mm512_andnot_pd;
    smaller _mm512_min_pd;
    larger _mm512_max_pd;
}

impl Scalar for F64x8Avx512 {
    const TABLES: bool = false;

    #[inline(always)]
    fn of(x: f64) -> Self {
        Self([unsafe { _mm512_set1_pd(x) }])
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self([unsafe { _mm512_sqrt_pd(self.0[0]) }])
    }
    #[inline(always)]
    fn select_less(a: Self, b: Self, yes: Self, no: Self) -> Self {
        Self([unsafe {
            let less = _mm512_cmp_pd_mask::<_CMP_LT_OQ>(a.0[0], b.0[0]);
            _mm512_mask_blend_pd(less, no.0[0], yes.0[0])
        }])
    }
    through_memory!(exp, ln, tanh);
}

impl F64x8Avx512 {
    /// Four numbers of each of eight rows, as four columns.
    #[inline(always)]
    fn transpose_halves(rows: [*const f64; WIDTH]) -> [Self; 4] {
        unsafe {
            let row = |k: usize| _mm256_loadu_pd(rows[k]);
            let two =
                |a: __m256d, b: __m256d| _mm512_insertf64x4::<1>(_mm512_castpd256_pd512(a), b);
            let (a, b) = (two(row(0), row(2)), two(row(1), row(3)));
            let (c, d) = (two(row(4), row(6)), two(row(5), row(7)));
            let (even, odd) = (_mm512_unpacklo_pd(a, b), _mm512_unpackhi_pd(a, b));
            let (even2, odd2) = (_mm512_unpacklo_pd(c, d), _mm512_unpackhi_pd(c, d));
            [
                Self([_mm512_shuffle_f64x2::<0x88>(even, even2)]),
                Self([_mm512_shuffle_f64x2::<0x88>(odd, odd2)]),
                Self([_mm512_shuffle_f64x2::<0xdd>(even, even2)]),
                Self([_mm512_shuffle_f64x2::<0xdd>(odd, odd2)]),
            ]
        }
    }

    /// The eight numbers of eight lines, as eight columns.
    #[inline(always)]
    fn transpose(lines: [&Packed; WIDTH]) -> [Self; 8] {
        unsafe {
            let row = |k: usize| _mm512_loadu_pd(half_of_packed(lines[k]));
            let pair = |k: usize| {
                let (a, b) = (row(k), row(k + 1));
                (_mm512_unpacklo_pd(a, b), _mm512_unpackhi_pd(a, b))
            };
            let ((a, a1), (b, b1), (c, c1), (d, d1)) = (pair(0), pair(2), pair(4), pair(6));
            let (even, odd) = (columns(a, b, c, d), columns(a1, b1, c1, d1));
            let mut fields = [Self([a]); 8];
            for k in 0..4 {
                fields[2 * k] = Self([even[k]]);
                fields[2 * k + 1] = Self([odd[k]]);
            }
            fields
        }
    }
}

/// Transposes four registers of four pairs of numbers.
#[inline(always)]
unsafe fn columns(a: __m512d, b: __m512d, c: __m512d, d: __m512d) -> [__m512d; 4] {
    unsafe {
        let (even, odd) = (_mm512_shuffle_f64x2::<0x88>(a, b), _mm512_shuffle_f64x2::<0xdd>(a, b));
        let (even2, odd2) =
            (_mm512_shuffle_f64x2::<0x88>(c, d), _mm512_shuffle_f64x2::<0xdd>(c, d));
        [
            _mm512_shuffle_f64x2::<0x88>(even, even2),
            _mm512_shuffle_f64x2::<0x88>(odd, odd2),
            _mm512_shuffle_f64x2::<0xdd>(even, even2),
            _mm512_shuffle_f64x2::<0xdd>(odd, odd2),
        ]
    }
}

/// Mask of the high halves of words.
const UPPER: u32 = 0xaaaa_aaaa;

impl SimdFloat for F64x8Avx512 {
    wide_doubles!();

    #[inline(always)]
    fn load(memory: &F64x8) -> Self {
        Self([unsafe { _mm512_loadu_pd(std::ptr::from_ref(memory).cast()) }])
    }
    #[inline(always)]
    fn store(self) -> F64x8 {
        let mut lanes = F64x8::ZERO;
        unsafe { _mm512_storeu_pd(std::ptr::from_mut(&mut lanes).cast(), self.0[0]) };
        lanes
    }
    #[inline(always)]
    fn power_of_two(shifted: Self) -> Self {
        Self([unsafe {
            let exponent = _mm512_slli_epi64::<52>(_mm512_castpd_si512(shifted.0[0]));
            _mm512_castsi512_pd(_mm512_add_epi64(exponent, _mm512_set1_epi64(1023 << 52)))
        }])
    }
    #[inline(always)]
    fn near<C: AsRef<[i32]>, const D: usize>(
        columns: &[C; D],
        here: [i32; D],
        first: usize,
        limits: [f32; 2],
    ) -> [u16; 2] {
        unsafe {
            let mut square = _mm512_setzero_ps();
            for (column, here) in columns.iter().zip(here) {
                let there =
                    _mm512_loadu_si512(column.as_ref()[first..first + 2 * WIDTH].as_ptr().cast());
                let apart = _mm512_sub_epi32(_mm512_set1_epi32(here), there);
                let apart = _mm512_cvtepi32_ps(apart);
                square = _mm512_add_ps(square, _mm512_mul_ps(apart, apart));
            }
            let mut masks = [0; 2];
            for (mask, limit) in masks.iter_mut().zip(limits) {
                *mask = _mm512_cmp_ps_mask::<_CMP_LT_OQ>(square, _mm512_set1_ps(limit));
            }
            masks
        }
    }
    #[inline(always)]
    fn gather<C: AsRef<[i32]>, const D: usize>(
        columns: &[C; D],
        window: &Window<D>,
        (first, inside): (usize, u16),
        tag: u16,
        [xy, zt]: [&mut [u32; 2 * WIDTH]; 2],
    ) -> u16 {
        unsafe {
            let zero = _mm512_setzero_si512();
            let mut places = [zero; 4];
            let mut half = [0; 4];
            for (axis, (column, middle)) in columns.iter().zip(window.middle).enumerate() {
                let there =
                    _mm512_loadu_si512(column.as_ref()[first..first + 2 * WIDTH].as_ptr().cast());
                let apart = _mm512_sub_epi32(there, _mm512_set1_epi32(middle));
                places[axis] = _mm512_sra_epi32(apart, _mm_cvtsi32_si128(window.shift as i32));
                half[axis] = i32::from(window.half[axis]);
            }
            let y = _mm512_slli_epi32::<16>(places[1]);
            let words = [
                _mm512_mask_blend_epi16(UPPER, places[0], y),
                _mm512_maskz_mov_epi16(!UPPER, places[2]),
            ];
            let mut square = zero;
            for (word, half) in words.iter().zip([half[0] | half[1] << 16, half[2]]).take(D - 1) {
                let outside = _mm512_subs_epu16(_mm512_abs_epi16(*word), _mm512_set1_epi32(half));
                square = _mm512_add_epi32(square, _mm512_madd_epi16(outside, outside));
            }
            let limit = _mm512_set1_epi32(window.limit as i32);
            let mask = inside & _mm512_cmplt_epu32_mask(square, limit);
            let count = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
            let tags = _mm512_add_epi32(_mm512_set1_epi32(i32::from(tag)), count);
            let tagged = _mm512_or_si512(words[1], _mm512_slli_epi32::<16>(tags));
            for (word, kept) in [words[0], tagged].into_iter().zip([xy, zt]) {
                let front = _mm512_maskz_compress_epi32(mask, word);
                _mm512_storeu_si512(kept.as_mut_ptr().cast(), front);
            }
            mask
        }
    }
    #[inline(always)]
    fn within([xy, zt]: [&[u32; 2 * WIDTH]; 2], here: [u32; 2], limits: [u32; 2]) -> [u16; 2] {
        unsafe {
            let [xy_here, z_here] = here.map(|word| _mm512_set1_epi32(word as i32));
            let xy = _mm512_sub_epi16(xy_here, _mm512_loadu_si512(xy.as_ptr().cast()));
            let zt = _mm512_loadu_si512(zt.as_ptr().cast());
            let z = _mm512_maskz_sub_epi16(!UPPER, z_here, zt);
            let square = _mm512_add_epi32(_mm512_madd_epi16(xy, xy), _mm512_madd_epi16(z, z));
            limits.map(|limit| _mm512_cmplt_epu32_mask(square, _mm512_set1_epi32(limit as i32)))
        }
    }
    #[inline(always)]
    fn sum(self) -> f64 {
        unsafe {
            let (low, high) =
                (_mm512_castpd512_pd256(self.0[0]), _mm512_extractf64x4_pd::<1>(self.0[0]));
            sum_of_four(_mm256_add_pd(low, high))
        }
    }
    #[inline(always)]
    fn nonzero(self) -> u8 {
        unsafe { _mm512_cmp_pd_mask::<_CMP_NEQ_UQ>(_mm512_setzero_pd(), self.0[0]) }
    }
    #[inline(always)]
    fn keep_slots(mask: u8, slots: &[u32; WIDTH], kept: &mut [u32; WIDTH]) {
        unsafe {
            let slots = _mm256_loadu_si256(slots.as_ptr().cast());
            let front = _mm256_maskz_compress_epi32(mask, slots);
            _mm256_storeu_si256(kept.as_mut_ptr().cast(), front);
        }
    }
    #[inline(always)]
    fn keep_tags(mask: u16, words: &[u32; 2 * WIDTH], kept: &mut [u16; 2 * WIDTH]) {
        unsafe {
            let front =
                _mm512_maskz_compress_epi32(mask, _mm512_loadu_si512(words.as_ptr().cast()));
            let tags = _mm512_cvtepi32_epi16(_mm512_srli_epi32::<16>(front));
            _mm256_storeu_si256(kept.as_mut_ptr().cast(), tags);
        }
    }
    #[inline(always)]
    fn compress(mask: u16, first: u32, kept: &mut [u32; 2 * WIDTH]) {
        unsafe {
            let count = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
            let numbers = _mm512_add_epi32(_mm512_set1_epi32(first as i32), count);
            let front = _mm512_maskz_compress_epi32(mask, numbers);
            // Most masks have few bits, and half a register seldom crosses a cache line.
            if mask.count_ones() <= 8 {
                let half = _mm512_castsi512_si256(front);
                _mm256_storeu_si256(kept.as_mut_ptr().cast(), half);
            } else {
                _mm512_storeu_si512(kept.as_mut_ptr().cast(), front);
            }
        }
    }
}

impl Doubles for F64x8Avx512 {
    #[inline(always)]
    fn of_singles(singles: __m256) -> Self {
        Self([unsafe { _mm512_cvtps_pd(singles) }])
    }
    #[inline(always)]
    fn to_singles(self) -> __m256 {
        unsafe { _mm512_cvtpd_ps(self.0[0]) }
    }
}
