//! Eight `f32` numbers, portable: the oracle of the types in [`super::x86`], and the implementation
//! on NEON.

use super::wide::{FAR, unit};
use super::{F64x8, Scalar, SimdFloat, Tabulated, WIDTH, operators_with_f64};
use crate::packed::{Packed, PackedAdjoint, PackedSingle};
use crate::pairs::{Lines, Reading, Surroundings};
use crate::vector::Vector;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// Smallest denominator in `f32`: far below every number that a pair law computes, and with an
/// inverse far from overflow.
pub(super) const SMALLEST_SINGLE: f64 = 1e-30;

/// [`WIDTH`] numbers in `f32`, as [`F64x8`] are in `f64`.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(32))]
pub struct F32x8(pub(super) [f32; WIDTH]);

/// The same expression in every lane.
macro_rules! in_every_lane {
    (|$lane:ident| $value:expr) => {{
        let mut lanes = [0.0_f32; WIDTH];
        for ($lane, lane) in lanes.iter_mut().enumerate() {
            *lane = $value;
        }
        F32x8(lanes)
    }};
}

impl Scalar for F32x8 {
    #[inline(always)]
    fn of(x: f64) -> Self {
        Self([x as f32; WIDTH])
    }
    #[inline(always)]
    fn smallest(x: f64) -> Self {
        Self::of(x.max(SMALLEST_SINGLE))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        in_every_lane!(|l| self.0[l].sqrt())
    }
    #[inline(always)]
    fn exp(self) -> Self {
        in_every_lane!(|l| self.0[l].exp())
    }
    #[inline(always)]
    fn ln(self) -> Self {
        in_every_lane!(|l| self.0[l].ln())
    }
    #[inline(always)]
    fn tanh(self) -> Self {
        in_every_lane!(|l| self.0[l].tanh())
    }
    #[inline(always)]
    fn powf(self, y: Self) -> Self {
        in_every_lane!(|l| self.0[l].powf(y.0[l]))
    }
    #[inline(always)]
    fn select_less(a: Self, b: Self, yes: Self, no: Self) -> Self {
        in_every_lane!(|l| if a.0[l] < b.0[l] { yes.0[l] } else { no.0[l] })
    }
    #[inline(always)]
    fn tabulated<F: Tabulated, const N: usize>(self, table: &F, order: usize) -> [Self; N] {
        let found = table.at_eight::<N>(&self.widen(), order);
        let mut narrow = [self; N];
        for (narrow, wide) in narrow.iter_mut().zip(found) {
            *narrow = Self::narrow(wide);
        }
        narrow
    }
}

macro_rules! lane_by_lane {
    ($($operator:ident $method:ident $symbol:tt;)*) => {$(
        impl $operator for F32x8 {
            type Output = Self;
            #[inline(always)]
            fn $method(self, b: Self) -> Self {
                in_every_lane!(|l| self.0[l] $symbol b.0[l])
            }
        }
    )*};
}

lane_by_lane! {
    Add add +;
    Sub sub -;
    Mul mul *;
    Div div /;
}

impl Neg for F32x8 {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        in_every_lane!(|l| -self.0[l])
    }
}

impl AddAssign for F32x8 {
    #[inline(always)]
    fn add_assign(&mut self, b: Self) {
        *self = *self + b;
    }
}

impl SubAssign for F32x8 {
    #[inline(always)]
    fn sub_assign(&mut self, b: Self) {
        *self = *self - b;
    }
}

operators_with_f64!([] F32x8);

impl SimdFloat for F32x8 {
    type Double = F64x8;
    type Line = PackedSingle;

    #[inline(always)]
    fn load(memory: &F64x8) -> Self {
        Self::narrow(*memory)
    }
    #[inline(always)]
    fn store(self) -> F64x8 {
        self.widen()
    }
    #[inline(always)]
    fn widen(self) -> F64x8 {
        F64x8::new(self.0.map(f64::from))
    }
    #[inline(always)]
    fn narrow(wide: F64x8) -> Self {
        let doubles = wide.to_array();
        in_every_lane!(|l| doubles[l] as f32)
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
        let mut separation = Vector::zero();
        for axis in 0..D {
            let steps = |l: usize| here.position[axis].wrapping_sub(others[l].position[axis]);
            separation[axis] = in_every_lane!(|l| steps(l) as f32) * Self::of(unit(space, axis));
        }
        let density = in_every_lane!(|l| others[l].density);
        separation[0] = Self::select_less(density, Self::of(0.0), Self::of(FAR), separation[0]);
        separation
    }
    #[inline(always)]
    fn read<const D: usize>(
        here: &PackedSingle,
        others: [&PackedSingle; WIDTH],
        space: Surroundings,
    ) -> Reading<Self, D> {
        let mut velocity = Vector::zero();
        for axis in 0..D {
            velocity[axis] = in_every_lane!(|l| here.velocity[axis] - others[l].velocity[axis]);
        }
        Reading {
            separation: Self::separation(here, others, space),
            velocity,
            rho_i: here.density.into(),
            density: in_every_lane!(|l| others[l].density.abs()),
            p_over_rho2_i: here.p_over_rho2.into(),
            p_over_rho2: in_every_lane!(|l| others[l].p_over_rho2),
        }
    }
    #[inline(always)]
    fn fields(lines: [&Packed; WIDTH]) -> [F64x8; 8] {
        F64x8::fields(lines)
    }
    #[inline(always)]
    fn adjoints(others: [&PackedAdjoint; WIDTH]) -> [F64x8; 4] {
        F64x8::adjoints(others)
    }

    #[inline(always)]
    fn abs(self) -> Self {
        in_every_lane!(|l| self.0[l].abs())
    }
    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        in_every_lane!(|l| self.0[l].copysign(sign.0[l]))
    }
    #[inline(always)]
    fn power_of_two(shifted: Self) -> Self {
        Self::narrow(F64x8::power_of_two(shifted.widen()))
    }
}
