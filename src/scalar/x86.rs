//! Eight numbers in registers of AVX-512 and of AVX2.
//!
//! A plain array would do for the meaning, but not for the speed: left to itself the compiler runs it
//! two lanes at a time. These types say which instruction they mean.
#![allow(unsafe_code, reason = "instructions of a set that only `dispatch` has looked for")]
// SAFETY, for every block of this file: the types are private to this crate, and only
// `wide::dispatch_in` names them, inside of `pulp`'s `vectorize` of an instruction set that was found on
// this machine. Pointers come from references to whole values of the size that is read, and unaligned
// instructions are used wherever a type does not promise its alignment.

use super::singles::SMALLEST_SINGLE;
use super::wide::{
    FAR, compress_by_table, compress_twice_by_table, near_by_loop, reading_of, separation_of, unit,
};
use super::{Lanes, Scalar, WIDTH, Wide, operators_with_f64};
use crate::packed::{Packed, PackedAdjoint, PackedSingle};
use crate::pairs::{Lines, Reading, Surroundings};
use crate::vector::Vector;
use std::arch::x86_64::*;
use std::marker::PhantomData;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// Eight doubles in one register of AVX-512.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lanes512([__m512d; 1]);

/// Eight doubles in two registers of AVX2.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lanes256([__m256d; 2]);

/// Eight doubles in four registers of SSE2, which every machine has.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lanes128([__m128d; 4]);

/// Eight singles in one register of AVX2, beside doubles of type `W`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Singles256<W>([__m256; 1], PhantomData<W>);

/// Eight singles in two registers of SSE2.
#[derive(Clone, Copy, Debug)]
pub(super) struct Singles128([__m128; 2]);

/// Singles on a machine with AVX-512.
pub(super) type SinglesOn512 = Singles256<Lanes512>;

/// Singles on a machine with AVX2.
pub(super) type SinglesOn256 = Singles256<Lanes256>;

/// The operators of a number, from its methods of two operands.
macro_rules! arithmetic {
    ([$($generics:tt)*] $number:ty) => {
        arithmetic!(@one [$($generics)*] $number, Add add plus);
        arithmetic!(@one [$($generics)*] $number, Sub sub minus);
        arithmetic!(@one [$($generics)*] $number, Mul mul times);
        arithmetic!(@one [$($generics)*] $number, Div div over);

        impl<$($generics)*> Neg for $number {
            type Output = Self;
            #[inline(always)]
            fn neg(self) -> Self {
                self.xor(Self::of(-0.0))
            }
        }

        impl<$($generics)*> AddAssign for $number {
            #[inline(always)]
            fn add_assign(&mut self, b: Self) {
                *self = *self + b;
            }
        }

        impl<$($generics)*> SubAssign for $number {
            #[inline(always)]
            fn sub_assign(&mut self, b: Self) {
                *self = *self - b;
            }
        }

        operators_with_f64!([$($generics)*] $number);
    };
    (@one [$($generics:tt)*] $number:ty, $operator:ident $method:ident $instruction:ident) => {
        impl<$($generics)*> $operator for $number {
            type Output = Self;
            #[inline(always)]
            fn $method(self, b: Self) -> Self {
                self.$instruction(b)
            }
        }
    };
}

arithmetic!([] Lanes512);
arithmetic!([] Lanes256);
arithmetic!([] Lanes128);
arithmetic!([W: Doubles] Singles256<W>);
arithmetic!([] Singles128);

/// Instructions of two operands, on each register of two numbers.
macro_rules! on_registers {
    ([$($generics:tt)*] $number:ty, $new:expr; $($method:ident $instruction:ident;)*) => {
        impl<$($generics)*> $number {$(
            #[inline(always)]
            fn $method(self, b: Self) -> Self {
                let mut registers = self.0;
                for (a, b) in registers.iter_mut().zip(b.0) {
                    *a = unsafe { $instruction(*a, b) };
                }
                $new(registers)
            }
        )*}
    };
}

on_registers! { [] Lanes512, Self;
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

on_registers! { [] Lanes256, Self;
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

on_registers! { [] Lanes128, Self;
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

on_registers! { [] Singles128, Self;
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

on_registers! { [W] Singles256<W>, Self::of_registers;
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

impl<W> Singles256<W> {
    #[inline(always)]
    const fn new(x: __m256) -> Self {
        Self([x], PhantomData)
    }

    #[inline(always)]
    const fn of_registers(registers: [__m256; 1]) -> Self {
        Self(registers, PhantomData)
    }
}

/// What laws do not do in their loops goes through memory, lane by lane.
macro_rules! through_memory {
    ($($method:ident),*) => {
        $(#[inline(always)]
        fn $method(self) -> Self {
            Self::load(&self.store().$method())
        })*
        #[inline(always)]
        fn powf(self, y: Self) -> Self {
            Self::load(&self.store().powf(y.store()))
        }
        /// As the plain one: `self < other`, and the other where one is not a number.
        #[inline(always)]
        fn min(self, other: Self) -> Self {
            self.smaller(other)
        }
        #[inline(always)]
        fn max(self, other: Self) -> Self {
            self.larger(other)
        }
    };
}

impl Scalar for Lanes512 {
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

impl Scalar for Lanes256 {
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

impl Scalar for Lanes128 {
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

impl Scalar for Singles128 {
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

impl<W: Doubles> Scalar for Singles256<W> {
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

/// What an implementation in doubles has in common with the others.
macro_rules! wide_doubles {
    () => {
        type Double = Self;
        type Line = Packed;

        #[inline(always)]
        fn widen(self) -> Self {
            self
        }
        #[inline(always)]
        fn narrow(wide: Self) -> Self {
            wide
        }
        #[inline(always)]
        fn lines<'a>(lines: Lines<'a>) -> &'a [Packed] {
            lines.double
        }
        #[inline(always)]
        fn separation<const D: usize>(
            here: &Packed,
            others: [&Packed; WIDTH],
            space: Surroundings,
        ) -> Vector<Self, D> {
            let [x, y, z, _] = Self::transpose_halves(others.map_each(half_of_packed));
            separation_of(here, [x, y, z], space)
        }
        #[inline(always)]
        fn read<const D: usize>(
            here: &Packed,
            others: [&Packed; WIDTH],
            space: Surroundings,
        ) -> Reading<Self, D> {
            reading_of(here, Self::fields(others), space)
        }
        #[inline(always)]
        fn fields(lines: [&Packed; WIDTH]) -> [Self; 8] {
            Self::transpose(lines)
        }
        #[inline(always)]
        fn adjoints(others: [&PackedAdjoint; WIDTH]) -> [Self; 4] {
            Self::transpose_halves(others.map_each(whole_of_adjoint))
        }
        #[inline(always)]
        fn abs(self) -> Self {
            Self::of(-0.0).and_not(self)
        }
        #[inline(always)]
        fn copysign(self, sign: Self) -> Self {
            self.abs().or(sign.and(Self::of(-0.0)))
        }
    };
}

/// Eight pointers from eight references: a loop, since the closure of an array's own `map` is not
/// inlined into vectorised functions.
trait MapEach<P> {
    fn map_each(self, to: impl Fn(&P) -> *const f64) -> [*const f64; WIDTH];
}

impl<P> MapEach<P> for [&P; WIDTH] {
    #[inline(always)]
    fn map_each(self, to: impl Fn(&P) -> *const f64) -> [*const f64; WIDTH] {
        let mut pointers = [std::ptr::null(); WIDTH];
        for (pointer, p) in pointers.iter_mut().zip(self) {
            *pointer = to(p);
        }
        pointers
    }
}

/// The first four numbers of a line: position and one velocity.
#[inline(always)]
fn half_of_packed(line: &Packed) -> *const f64 {
    std::ptr::from_ref(line).cast()
}

/// All four numbers of an adjoint.
#[inline(always)]
fn whole_of_adjoint(adjoint: &PackedAdjoint) -> *const f64 {
    std::ptr::from_ref(adjoint).cast()
}

impl Lanes512 {
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

/// Four registers of four pairs of numbers, transposed.
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

impl Wide for Lanes512 {
    wide_doubles!();

    #[inline(always)]
    fn load(memory: &Lanes) -> Self {
        Self([unsafe { _mm512_loadu_pd(std::ptr::from_ref(memory).cast()) }])
    }
    #[inline(always)]
    fn store(self) -> Lanes {
        let mut lanes = Lanes::ZERO;
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
    fn near<const D: usize>(
        columns: &[Vec<i32>; D],
        here: [i32; D],
        first: usize,
        limits: [f32; 2],
    ) -> [u16; 2] {
        unsafe {
            let mut square = _mm512_setzero_ps();
            for (column, here) in columns.iter().zip(here) {
                let there = _mm512_loadu_si512(column[first..first + 2 * WIDTH].as_ptr().cast());
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
    fn compress_twice(mask: u16, first: u32, kept: &mut [u32; 2 * WIDTH]) {
        unsafe {
            let count = _mm512_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15);
            let numbers = _mm512_add_epi32(_mm512_set1_epi32(first as i32), count);
            let front = _mm512_maskz_compress_epi32(mask, numbers);
            // Most are few, and half a register seldom lies across two cache lines.
            if mask.count_ones() <= 8 {
                let half = _mm512_castsi512_si256(front);
                _mm256_storeu_si256(kept.as_mut_ptr().cast(), half);
            } else {
                _mm512_storeu_si512(kept.as_mut_ptr().cast(), front);
            }
        }
    }
    #[inline(always)]
    fn less_than(self, limit: f64) -> u8 {
        unsafe { _mm512_cmp_pd_mask::<_CMP_LT_OQ>(self.0[0], _mm512_set1_pd(limit)) }
    }
    #[inline(always)]
    fn compress(mask: u8, first: u32, kept: &mut [u32; WIDTH]) {
        unsafe {
            let count = _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7);
            let numbers = _mm256_add_epi32(_mm256_set1_epi32(first as i32), count);
            let front = _mm256_maskz_compress_epi32(mask, numbers);
            _mm256_storeu_si256(kept.as_mut_ptr().cast(), front);
        }
    }
}

impl Lanes256 {
    /// As [`Lanes512::transpose_halves`].
    #[inline(always)]
    fn transpose_halves(rows: [*const f64; WIDTH]) -> [Self; 4] {
        let [a, b, c, d] = unsafe { four_columns(&rows, 0, 0) };
        let [e, f, g, h] = unsafe { four_columns(&rows, 4, 0) };
        [Self([a, e]), Self([b, f]), Self([c, g]), Self([d, h])]
    }

    /// As [`Lanes512::transpose`].
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

/// Four numbers, from the `offset`-th on, of four rows, from the `first` on, transposed.
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

impl Wide for Lanes256 {
    wide_doubles!();

    #[inline(always)]
    fn load(memory: &Lanes) -> Self {
        let memory: *const f64 = std::ptr::from_ref(memory).cast();
        Self(unsafe { [_mm256_loadu_pd(memory), _mm256_loadu_pd(memory.add(4))] })
    }
    #[inline(always)]
    fn store(self) -> Lanes {
        let mut lanes = Lanes::ZERO;
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
    fn near<const D: usize>(
        columns: &[Vec<i32>; D],
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
                    let there = _mm256_loadu_si256(column[from..from + WIDTH].as_ptr().cast());
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
    fn compress_twice(mask: u16, first: u32, kept: &mut [u32; 2 * WIDTH]) {
        compress_twice_by_table(mask, first, kept);
    }
    #[inline(always)]
    fn less_than(self, limit: f64) -> u8 {
        unsafe {
            let limit = _mm256_set1_pd(limit);
            let low = _mm256_movemask_pd(_mm256_cmp_pd::<_CMP_LT_OQ>(self.0[0], limit));
            let high = _mm256_movemask_pd(_mm256_cmp_pd::<_CMP_LT_OQ>(self.0[1], limit));
            (low | high << 4) as u8
        }
    }
    #[inline(always)]
    fn compress(mask: u8, first: u32, kept: &mut [u32; WIDTH]) {
        compress_by_table(mask, first, kept);
    }
}

impl Lanes128 {
    /// As [`Lanes512::transpose_halves`].
    #[inline(always)]
    fn transpose_halves(rows: [*const f64; WIDTH]) -> [Self; 4] {
        unsafe { two_by_two(&rows) }
    }

    /// As [`Lanes512::transpose`].
    #[inline(always)]
    fn transpose(lines: [&Packed; WIDTH]) -> [Self; 8] {
        unsafe { two_by_two(&lines.map_each(half_of_packed)) }
    }
}

/// The first `F` numbers of eight rows, as columns.
#[inline(always)]
unsafe fn two_by_two<const F: usize>(rows: &[*const f64; WIDTH]) -> [Lanes128; F] {
    let mut fields = [Lanes128::of(0.0); F];
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

impl Wide for Lanes128 {
    wide_doubles!();

    #[inline(always)]
    fn load(memory: &Lanes) -> Self {
        let memory: *const f64 = std::ptr::from_ref(memory).cast();
        let mut lanes = Self::of(0.0);
        for (k, register) in lanes.0.iter_mut().enumerate() {
            *register = unsafe { _mm_loadu_pd(memory.add(2 * k)) };
        }
        lanes
    }
    #[inline(always)]
    fn store(self) -> Lanes {
        let mut lanes = Lanes::ZERO;
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
    #[inline(always)]
    fn near<const D: usize>(
        columns: &[Vec<i32>; D],
        here: [i32; D],
        first: usize,
        limits: [f32; 2],
    ) -> [u16; 2] {
        near_by_loop(columns, here, first, limits)
    }
    #[inline(always)]
    fn compress_twice(mask: u16, first: u32, kept: &mut [u32; 2 * WIDTH]) {
        compress_twice_by_table(mask, first, kept);
    }
    #[inline(always)]
    fn less_than(self, limit: f64) -> u8 {
        let mut mask = 0;
        for (k, register) in self.less(Self::of(limit)).0.into_iter().enumerate() {
            mask |= unsafe { _mm_movemask_pd(register) } << (2 * k);
        }
        mask as u8
    }
    #[inline(always)]
    fn compress(mask: u8, first: u32, kept: &mut [u32; WIDTH]) {
        compress_by_table(mask, first, kept);
    }
}

/// Doubles beside which there are singles.
pub(super) trait Doubles: Wide<Double = Self> {
    fn of_singles(singles: __m256) -> Self;
    fn to_singles(self) -> __m256;
}

impl Doubles for Lanes512 {
    #[inline(always)]
    fn of_singles(singles: __m256) -> Self {
        Self([unsafe { _mm512_cvtps_pd(singles) }])
    }
    #[inline(always)]
    fn to_singles(self) -> __m256 {
        unsafe { _mm512_cvtpd_ps(self.0[0]) }
    }
}

impl Doubles for Lanes256 {
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

/// Four numbers of eight rows as four columns, from rows `k` and `k + 4` in the halves of register `k`.
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

/// Four numbers, from the `offset`-th on, of eight lines.
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

/// Four numbers, from the `offset`-th on, of eight lines, in registers of SSE2.
#[inline(always)]
unsafe fn single_quarters(others: [&PackedSingle; WIDTH], offset: usize) -> [Singles128; 4] {
    let mut fields = [Singles128::of(0.0); 4];
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

impl Singles128 {
    /// Four numbers, from the `offset`-th on, of eight lines.
    #[inline(always)]
    fn columns(others: [&PackedSingle; WIDTH], offset: usize) -> [Self; 4] {
        unsafe { single_quarters(others, offset) }
    }

    /// Differences of fixed-point numbers, whose bits are those of `there`, in steps.
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
    fn to_doubles(self) -> Lanes128 {
        let [a, b] = self.0;
        Lanes128(unsafe {
            let high = |x: __m128| _mm_cvtps_pd(_mm_movehl_ps(x, x));
            [_mm_cvtps_pd(a), high(a), _mm_cvtps_pd(b), high(b)]
        })
    }

    #[inline(always)]
    fn of_doubles(wide: Lanes128) -> Self {
        let [a, b, c, d] = wide.0;
        Self(unsafe {
            let two = |x: __m128d, y: __m128d| _mm_movelh_ps(_mm_cvtpd_ps(x), _mm_cvtpd_ps(y));
            [two(a, b), two(c, d)]
        })
    }
}

impl<W: Doubles> Singles256<W> {
    /// As [`Singles128::columns`].
    #[inline(always)]
    fn columns(others: [&PackedSingle; WIDTH], offset: usize) -> [Self; 4] {
        let [a, b, c, d] = unsafe { single_halves(others, offset) };
        [Self::new(a), Self::new(b), Self::new(c), Self::new(d)]
    }

    /// As [`Singles128::steps`].
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

/// What an implementation in singles, beside doubles of type `$doubles`, has in common with the other.
macro_rules! wide_singles {
    ($doubles:ty) => {
        type Double = $doubles;
        type Line = PackedSingle;

        #[inline(always)]
        fn load(memory: &Lanes) -> Self {
            Self::of_doubles(<$doubles>::load(memory))
        }
        #[inline(always)]
        fn store(self) -> Lanes {
            self.to_doubles().store()
        }
        #[inline(always)]
        fn widen(self) -> $doubles {
            self.to_doubles()
        }
        #[inline(always)]
        fn narrow(wide: $doubles) -> Self {
            Self::of_doubles(wide)
        }
        #[inline(always)]
        fn lines<'a>(lines: Lines<'a>) -> &'a [PackedSingle] {
            lines.single
        }
        #[inline(always)]
        fn separation<const D: usize>(
            here: &PackedSingle,
            others: [&PackedSingle; WIDTH],
            space: Surroundings,
        ) -> Vector<Self, D> {
            let [x, y, z, density] = Self::columns(others, 0);
            let unit = Self::of(unit(space));
            let mut separation = Vector::zero();
            for (axis, there) in [x, y, z].into_iter().enumerate().take(D) {
                separation[axis] = Self::steps(here.position[axis], there) * unit;
            }
            let nobody = Self::of(FAR);
            separation[0] = Self::select_less(density, Self::of(0.0), nobody, separation[0]);
            separation
        }
        #[inline(always)]
        fn read<const D: usize>(
            here: &PackedSingle,
            others: [&PackedSingle; WIDTH],
            space: Surroundings,
        ) -> Reading<Self, D> {
            let [.., density] = Self::columns(others, 0);
            let [u, v, w, stress] = Self::columns(others, 4);
            let mut velocity = Vector::zero();
            for (axis, there) in [u, v, w].into_iter().enumerate().take(D) {
                velocity[axis] = Self::of(f64::from(here.velocity[axis])) - there;
            }
            Reading {
                separation: Self::separation(here, others, space),
                velocity,
                rho_i: here.density.into(),
                density: density.abs(),
                stress_i: here.stress.into(),
                stress,
            }
        }
        #[inline(always)]
        fn fields(lines: [&Packed; WIDTH]) -> [$doubles; 8] {
            <$doubles>::fields(lines)
        }
        #[inline(always)]
        fn adjoints(others: [&PackedAdjoint; WIDTH]) -> [$doubles; 4] {
            <$doubles>::adjoints(others)
        }
        #[inline(always)]
        fn abs(self) -> Self {
            Self::of(-0.0).and_not(self)
        }
        #[inline(always)]
        fn copysign(self, sign: Self) -> Self {
            self.abs().or(sign.and(Self::of(-0.0)))
        }
        #[inline(always)]
        fn power_of_two(shifted: Self) -> Self {
            Self::narrow(<$doubles>::power_of_two(shifted.widen()))
        }
        #[inline(always)]
        fn near<const D: usize>(
            columns: &[Vec<i32>; D],
            here: [i32; D],
            first: usize,
            limits: [f32; 2],
        ) -> [u16; 2] {
            <$doubles>::near(columns, here, first, limits)
        }
        #[inline(always)]
        fn compress_twice(mask: u16, first: u32, kept: &mut [u32; 2 * WIDTH]) {
            <$doubles>::compress_twice(mask, first, kept);
        }
        #[inline(always)]
        fn less_than(self, limit: f64) -> u8 {
            self.widen().less_than(limit)
        }
        #[inline(always)]
        fn compress(mask: u8, first: u32, kept: &mut [u32; WIDTH]) {
            <$doubles>::compress(mask, first, kept);
        }
    };
}

impl<W: Doubles> Wide for Singles256<W> {
    wide_singles!(W);
}

impl Wide for Singles128 {
    wide_singles!(Lanes128);
}
