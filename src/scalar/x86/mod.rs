//! Vectors of eight numbers in registers of AVX-512, AVX2 and SSE2, one file each.
//!
//! A plain array would give the same results, but more slowly: the compiler vectorises it two lanes
//! at a time. These types name their instructions.
#![allow(unsafe_code, reason = "instructions of a set that only `dispatch` has looked for")]
// SAFETY, for every block of this file: the types are private to this crate, and only
// `wide::dispatch_in` names them, inside of `pulp`'s `vectorize` of an instruction set that was found on
// this machine. Pointers come from references to whole values of the size that is read, and unaligned
// instructions are used wherever a type does not promise its alignment.

use super::sift::{LANES_OF, Window};
use super::singles::SMALLEST_SINGLE;
use super::wide::{FAR, reading_of, separation_of, unit};
use super::{F64x8, Scalar, SimdFloat, Tabulated, WIDTH, operators_with_f64};
use crate::packed::{Packed, PackedAdjoint, PackedSingle};
use crate::pairs::{Lines, Reading, Surroundings};
use crate::vector::Vector;
use std::arch::x86_64::*;
use std::marker::PhantomData;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

mod avx2;
mod avx512;
mod singles;
mod sse2;

pub(super) use avx2::F64x8Avx2;
pub(super) use avx512::F64x8Avx512;
pub(super) use sse2::{F32x8Sse2, F64x8Sse2};

/// The `f32` type on a machine with AVX-512.
pub(super) type F32x8On512 = singles::F32x8Avx2<F64x8Avx512>;

/// The `f32` type on a machine with AVX2.
pub(super) type F32x8On256 = singles::F32x8Avx2<F64x8Avx2>;

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

use arithmetic;

/// Methods of two operands, by one instruction on each register.
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

use on_registers;

/// Functions that pair loops do not use go through memory, lane by lane.
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
        #[inline(always)]
        fn tabulated<F: Tabulated, const N: usize>(self, table: &F, order: usize) -> [Self; N] {
            let found = table.at_eight::<N>(&self.store(), order);
            let mut here = [self; N];
            for (here, found) in here.iter_mut().zip(&found) {
                *here = Self::load(found);
            }
            here
        }
        /// As the portable one: `self < other`, and `other` where either is NaN.
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

use through_memory;

/// The common part of all implementations in `f64`.
macro_rules! wide_doubles {
    () => {
        type Double = Self;
        type Line = Packed;

        #[inline(always)]
        fn fetch(line: &Packed) {
            fetch_line(line);
        }
        #[inline(always)]
        fn fetch_columns(columns: &[F64x8]) {
            columns.iter().for_each(fetch_line);
        }

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

use wide_doubles;

/// The common part of both implementations in `f32`, with the `f64` type `$doubles`.
macro_rules! wide_singles {
    ($doubles:ty) => {
        type Double = $doubles;
        type Line = PackedSingle;

        #[inline(always)]
        fn fetch(line: &PackedSingle) {
            fetch_line(line);
        }

        #[inline(always)]
        fn load(memory: &F64x8) -> Self {
            Self::of_doubles(<$doubles>::load(memory))
        }
        #[inline(always)]
        fn store(self) -> F64x8 {
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
            let mut separation = Vector::zero();
            for (axis, there) in [x, y, z].into_iter().enumerate().take(D) {
                separation[axis] =
                    Self::steps(here.position[axis], there) * Self::of(unit(space, axis));
            }
            let sentinel = Self::of(FAR);
            separation[0] = Self::select_less(density, Self::of(0.0), sentinel, separation[0]);
            separation
        }
        #[inline(always)]
        fn read<const D: usize>(
            here: &PackedSingle,
            others: [&PackedSingle; WIDTH],
            space: Surroundings,
        ) -> Reading<Self, D> {
            let [.., density] = Self::columns(others, 0);
            let [u, v, w, p_over_rho2] = Self::columns(others, 4);
            let mut velocity = Vector::zero();
            for (axis, there) in [u, v, w].into_iter().enumerate().take(D) {
                velocity[axis] = Self::of(f64::from(here.velocity[axis])) - there;
            }
            Reading {
                separation: Self::separation(here, others, space),
                velocity,
                rho_i: here.density.into(),
                density: density.abs(),
                p_over_rho2_i: here.p_over_rho2.into(),
                p_over_rho2,
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
    };
}

use wide_singles;

/// Eight pointers from eight references. It is a loop because the closure of an array's own `map`
/// is not inlined into vectorised functions.
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

/// Prefetches the cache line in which a particle's line begins.
#[inline(always)]
fn fetch_line<L>(line: &L) {
    unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::from_ref(line).cast()) };
}

/// The first four numbers of a line: position and the first component of the velocity.
#[inline(always)]
fn half_of_packed(line: &Packed) -> *const f64 {
    std::ptr::from_ref(line).cast()
}

/// All four numbers of an adjoint.
#[inline(always)]
fn whole_of_adjoint(adjoint: &PackedAdjoint) -> *const f64 {
    std::ptr::from_ref(adjoint).cast()
}
