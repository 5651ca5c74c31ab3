//! The `f64` and `f32` types of SSE2, which every x86-64 machine has.
#![allow(unsafe_code, reason = "instructions of a set that only `dispatch` has looked for")]
// SAFETY: see the parent module.

use super::*;

/// Eight `f64` in four registers of SSE2.
#[derive(Clone, Copy, Debug)]
pub(in crate::scalar) struct F64x8Sse2(pub(super) [__m128d; 4]);

/// Eight `f32` in two registers of SSE2.
#[derive(Clone, Copy, Debug)]
pub(in crate::scalar) struct F32x8Sse2(pub(super) [__m128; 2]);

arithmetic!([] F64x8Sse2);
arithmetic!([] F32x8Sse2);

on_registers! { [] F64x8Sse2, Self;
    plus _mm_add_pd;
    minus _mm_sub_pd;
    times _mm_mul_pd;
    over _mm_div_pd;
    xor _mm_xor_pd;
    and _mm_and_pd;
    or _mm_or_pd;
    and_not _mm_andnot_pd;
    smaller _mm_min_pd;
    larger _mm_max_pd;
    less _mm_cmplt_pd;
}

on_registers! { [] F32x8Sse2, Self;
    plus _mm_add_ps;
    minus _mm_sub_ps;
    times _mm_mul_ps;
    over _mm_div_ps;
    xor _mm_xor_ps;
    and _mm_and_ps;
    or _mm_or_ps;
    and_not _mm_andnot_ps;
    smaller _mm_min_ps;
    larger _mm_max_ps;
    less _mm_cmplt_ps;
}

impl Scalar for F64x8Sse2 {
    #[inline(always)]
    fn of(x: f64) -> Self {
        Self([unsafe { _mm_set1_pd(x) }; 4])
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        let [a, b, c, d] = self.0;
        Self(unsafe { [_mm_sqrt_pd(a), _mm_sqrt_pd(b), _mm_sqrt_pd(c), _mm_sqrt_pd(d)] })
    }
    #[inline(always)]
    fn select_less(a: Self, b: Self, yes: Self, no: Self) -> Self {
        let less = a.less(b);
        less.and(yes).or(less.and_not(no))
    }
    through_memory!(exp, ln, tanh);
}

impl Scalar for F32x8Sse2 {
    #[inline(always)]
    fn of(x: f64) -> Self {
        Self([unsafe { _mm_set1_ps(x as f32) }; 2])
    }
    #[inline(always)]
    fn smallest(x: f64) -> Self {
        Self::of(x.max(SMALLEST_SINGLE))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        let [a, b] = self.0;
        Self(unsafe { [_mm_sqrt_ps(a), _mm_sqrt_ps(b)] })
    }
    #[inline(always)]
    fn select_less(a: Self, b: Self, yes: Self, no: Self) -> Self {
        let less = a.less(b);
        less.and(yes).or(less.and_not(no))
    }
    through_memory!(exp, ln, tanh);
}

impl F64x8Sse2 {
    /// As [`F64x8Avx512::transpose_halves`].
    #[inline(always)]
    fn transpose_halves(rows: [*const f64; WIDTH]) -> [Self; 4] {
        unsafe { two_by_two(&rows) }
    }

    /// As [`F64x8Avx512::transpose`].
    #[inline(always)]
    fn transpose(lines: [&Packed; WIDTH]) -> [Self; 8] {
        unsafe { two_by_two(&lines.map_each(half_of_packed)) }
    }
}

/// The first `F` numbers of eight rows, as columns.
#[inline(always)]
unsafe fn two_by_two<const F: usize>(rows: &[*const f64; WIDTH]) -> [F64x8Sse2; F] {
    let mut fields = [F64x8Sse2::of(0.0); F];
    for k in 0..WIDTH / 2 {
        for f in (0..F).step_by(2) {
            unsafe {
                let (a, b) =
                    (_mm_loadu_pd(rows[2 * k].add(f)), _mm_loadu_pd(rows[2 * k + 1].add(f)));
                fields[f].0[k] = _mm_unpacklo_pd(a, b);
                fields[f + 1].0[k] = _mm_unpackhi_pd(a, b);
            }
        }
    }
    fields
}

impl SimdFloat for F64x8Sse2 {
    wide_doubles!();

    #[inline(always)]
    fn nonzero(self) -> u8 {
        let mut mask = 0;
        for pair in 0..4 {
            unsafe {
                let apart = _mm_cmpneq_pd(_mm_setzero_pd(), self.0[pair]);
                mask |= (_mm_movemask_pd(apart) as u8) << (2 * pair);
            }
        }
        mask
    }

    #[inline(always)]
    fn load(memory: &F64x8) -> Self {
        let memory: *const f64 = std::ptr::from_ref(memory).cast();
        let mut lanes = Self::of(0.0);
        for (k, register) in lanes.0.iter_mut().enumerate() {
            *register = unsafe { _mm_loadu_pd(memory.add(2 * k)) };
        }
        lanes
    }
    #[inline(always)]
    fn store(self) -> F64x8 {
        let mut lanes = F64x8::ZERO;
        let memory: *mut f64 = std::ptr::from_mut(&mut lanes).cast();
        for (k, register) in self.0.into_iter().enumerate() {
            unsafe { _mm_storeu_pd(memory.add(2 * k), register) };
        }
        lanes
    }
    #[inline(always)]
    fn power_of_two(shifted: Self) -> Self {
        let mut power = shifted;
        for register in &mut power.0 {
            *register = unsafe {
                let exponent = _mm_slli_epi64::<52>(_mm_castpd_si128(*register));
                _mm_castsi128_pd(_mm_add_epi64(exponent, _mm_set1_epi64x(1023 << 52)))
            };
        }
        power
    }
}

/// Four numbers, starting at `offset`, of eight lines, in registers of SSE2.
#[inline(always)]
unsafe fn single_quarters(others: [&PackedSingle; WIDTH], offset: usize) -> [F32x8Sse2; 4] {
    let mut fields = [F32x8Sse2::of(0.0); 4];
    for half in 0..2 {
        unsafe {
            let row = |k: usize| {
                let line: *const f32 = std::ptr::from_ref(others[4 * half + k]).cast();
                _mm_loadu_ps(line.add(offset))
            };
            let (a, b, c, d) = (row(0), row(1), row(2), row(3));
            let (even, odd) = (_mm_unpacklo_ps(a, b), _mm_unpackhi_ps(a, b));
            let (even2, odd2) = (_mm_unpacklo_ps(c, d), _mm_unpackhi_ps(c, d));
            fields[0].0[half] = _mm_movelh_ps(even, even2);
            fields[1].0[half] = _mm_movehl_ps(even2, even);
            fields[2].0[half] = _mm_movelh_ps(odd, odd2);
            fields[3].0[half] = _mm_movehl_ps(odd2, odd);
        }
    }
    fields
}

impl F32x8Sse2 {
    /// Four numbers, starting at `offset`, of eight lines.
    #[inline(always)]
    fn columns(others: [&PackedSingle; WIDTH], offset: usize) -> [Self; 4] {
        unsafe { single_quarters(others, offset) }
    }

    /// Differences of fixed-point numbers, in steps; `there` holds its integers as bits.
    #[inline(always)]
    fn steps(here: i32, there: Self) -> Self {
        let mut steps = there;
        for register in &mut steps.0 {
            *register = unsafe {
                let apart = _mm_sub_epi32(_mm_set1_epi32(here), _mm_castps_si128(*register));
                _mm_cvtepi32_ps(apart)
            };
        }
        steps
    }

    #[inline(always)]
    fn to_doubles(self) -> F64x8Sse2 {
        let [a, b] = self.0;
        F64x8Sse2(unsafe {
            let high = |x: __m128| _mm_cvtps_pd(_mm_movehl_ps(x, x));
            [_mm_cvtps_pd(a), high(a), _mm_cvtps_pd(b), high(b)]
        })
    }

    #[inline(always)]
    fn of_doubles(wide: F64x8Sse2) -> Self {
        let [a, b, c, d] = wide.0;
        Self(unsafe {
            let two = |x: __m128d, y: __m128d| _mm_movelh_ps(_mm_cvtpd_ps(x), _mm_cvtpd_ps(y));
            [two(a, b), two(c, d)]
        })
    }
}

impl SimdFloat for F32x8Sse2 {
    wide_singles!(F64x8Sse2);

    #[inline(always)]
    fn nonzero(self) -> u8 {
        let mut mask = 0;
        for half in 0..2 {
            unsafe {
                let apart = _mm_cmpneq_ps(_mm_setzero_ps(), self.0[half]);
                mask |= (_mm_movemask_ps(apart) as u8) << (4 * half);
            }
        }
        mask
    }
}
