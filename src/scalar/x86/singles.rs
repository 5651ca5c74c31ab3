//! The `f32` types of AVX2, with the `f64` type of AVX-512 or of AVX2.
#![allow(unsafe_code, reason = "instructions of a set that only `dispatch` has looked for")]
// SAFETY: see the parent module.

use super::*;

/// Eight `f32` in one register of AVX2, with the `f64` type `W`.
#[derive(Clone, Copy, Debug)]
pub(in crate::scalar) struct F32x8Avx2<W>(pub(super) [__m256; 1], PhantomData<W>);

arithmetic!([W: Doubles] F32x8Avx2<W>);

on_registers! { [W] F32x8Avx2<W>, Self::of_registers;
    plus _mm256_add_ps;
    minus _mm256_sub_ps;
    times _mm256_mul_ps;
    over _mm256_div_ps;
    xor _mm256_xor_ps;
    and _mm256_and_ps;
    or _mm256_or_ps;
    and_not _mm256_andnot_ps;
    smaller _mm256_min_ps;
    larger _mm256_max_ps;
}

impl<W> F32x8Avx2<W> {
    #[inline(always)]
    const fn new(x: __m256) -> Self {
        Self([x], PhantomData)
    }

    #[inline(always)]
    const fn of_registers(registers: [__m256; 1]) -> Self {
        Self(registers, PhantomData)
    }
}

/// An `f64` type that converts from and to `f32`.
pub(in crate::scalar) trait Doubles: SimdFloat<Double = Self> {
    fn of_singles(singles: __m256) -> Self;
    fn to_singles(self) -> __m256;
}

impl<W: Doubles> Scalar for F32x8Avx2<W> {
    const TABLES: bool = false;

    #[inline(always)]
    fn of(x: f64) -> Self {
        Self::new(unsafe { _mm256_set1_ps(x as f32) })
    }
    #[inline(always)]
    fn smallest(x: f64) -> Self {
        Self::of(x.max(SMALLEST_SINGLE))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Self::new(unsafe { _mm256_sqrt_ps(self.0[0]) })
    }
    #[inline(always)]
    fn select_less(a: Self, b: Self, yes: Self, no: Self) -> Self {
        Self::new(unsafe {
            let less = _mm256_cmp_ps::<_CMP_LT_OQ>(a.0[0], b.0[0]);
            _mm256_blendv_ps(no.0[0], yes.0[0], less)
        })
    }
    through_memory!(exp, ln, tanh);
}

/// Four numbers of eight rows as four columns; register `k` holds rows `k` and `k + 4` in its
/// halves.
#[inline(always)]
unsafe fn single_columns([a, b, c, d]: [__m256; 4]) -> [__m256; 4] {
    unsafe {
        let (even, odd) = (_mm256_unpacklo_ps(a, b), _mm256_unpackhi_ps(a, b));
        let (even2, odd2) = (_mm256_unpacklo_ps(c, d), _mm256_unpackhi_ps(c, d));
        let [e, o] = [_mm256_castps_pd(even), _mm256_castps_pd(odd)];
        let [e2, o2] = [_mm256_castps_pd(even2), _mm256_castps_pd(odd2)];
        [
            _mm256_castpd_ps(_mm256_unpacklo_pd(e, e2)),
            _mm256_castpd_ps(_mm256_unpackhi_pd(e, e2)),
            _mm256_castpd_ps(_mm256_unpacklo_pd(o, o2)),
            _mm256_castpd_ps(_mm256_unpackhi_pd(o, o2)),
        ]
    }
}

/// Four numbers, starting at `offset`, of eight lines.
#[inline(always)]
unsafe fn single_halves(others: [&PackedSingle; WIDTH], offset: usize) -> [__m256; 4] {
    unsafe {
        let row = |k: usize| {
            let line: *const f32 = std::ptr::from_ref(others[k]).cast();
            _mm_loadu_ps(line.add(offset))
        };
        let two = |k: usize| _mm256_insertf128_ps::<1>(_mm256_castps128_ps256(row(k)), row(k + 4));
        single_columns([two(0), two(1), two(2), two(3)])
    }
}

impl<W: Doubles> F32x8Avx2<W> {
    /// As [`F32x8Sse2::columns`].
    #[inline(always)]
    fn columns(others: [&PackedSingle; WIDTH], offset: usize) -> [Self; 4] {
        let [a, b, c, d] = unsafe { single_halves(others, offset) };
        [Self::new(a), Self::new(b), Self::new(c), Self::new(d)]
    }

    /// As [`F32x8Sse2::steps`].
    #[inline(always)]
    fn steps(here: i32, there: Self) -> Self {
        Self::new(unsafe {
            let there = _mm256_castps_si256(there.0[0]);
            _mm256_cvtepi32_ps(_mm256_sub_epi32(_mm256_set1_epi32(here), there))
        })
    }

    #[inline(always)]
    fn to_doubles(self) -> W {
        W::of_singles(self.0[0])
    }

    #[inline(always)]
    fn of_doubles(wide: W) -> Self {
        Self::new(wide.to_singles())
    }
}

impl<W: Doubles> SimdFloat for F32x8Avx2<W> {
    wide_singles!(W);

    #[inline(always)]
    fn nonzero(self) -> u8 {
        unsafe {
            let apart = _mm256_cmp_ps::<_CMP_NEQ_UQ>(_mm256_setzero_ps(), self.0[0]);
            _mm256_movemask_ps(apart) as u8
        }
    }
}
