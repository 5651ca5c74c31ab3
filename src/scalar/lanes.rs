//! Eight `f64` evaluated lane by lane: the portable SIMD type.

use super::wide::{reading_of, separation_of};
use super::{Scalar, SimdFloat, Tabulated, operators_with_f64};
use crate::packed::{Packed, PackedAdjoint};
use crate::pairs::{Lines, Reading, Surroundings};
use crate::vector::Vector;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// Number of lanes of [`F64x8`]: one AVX-512 register of `f64`, two of AVX2, four of NEON.
pub const WIDTH: usize = 8;

/// [`WIDTH`] numbers in `f64`, evaluated lane by lane: the layout in memory, the portable
/// implementation of [`SimdFloat`], and the oracle of the others.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C, align(64))]
pub struct F64x8([f64; WIDTH]);

impl F64x8 {
    /// Zero in every lane.
    pub const ZERO: Self = Self([0.0; WIDTH]);

    /// From eight numbers.
    #[inline(always)]
    pub const fn new(lanes: [f64; WIDTH]) -> Self {
        Self(lanes)
    }

    /// One in lane `lane`, zero elsewhere.
    #[inline(always)]
    pub const fn unit(lane: usize) -> Self {
        let mut lanes = [0.0; WIDTH];
        lanes[lane] = 1.0;
        Self(lanes)
    }

    /// The eight numbers.
    #[inline(always)]
    pub const fn to_array(self) -> [f64; WIDTH] {
        self.0
    }

    /// The number in one lane.
    #[inline(always)]
    pub const fn lane(&self, lane: usize) -> f64 {
        self.0[lane]
    }

    /// Replaces the number in one lane.
    #[inline(always)]
    pub const fn set_lane(&mut self, lane: usize, x: f64) {
        self.0[lane] = x;
    }

    /// The sum over the lanes, always paired in the same order.
    #[inline(always)]
    pub fn sum(self) -> f64 {
        let [a, b, c, d, e, f, g, h] = self.0;
        ((a + e) + (c + g)) + ((b + f) + (d + h))
    }

    #[inline(always)]
    fn map(self, f: impl Fn(f64) -> f64) -> Self {
        let mut lanes = self.0;
        for x in &mut lanes {
            *x = f(*x);
        }
        Self(lanes)
    }

    #[inline(always)]
    fn zip(self, other: Self, f: impl Fn(f64, f64) -> f64) -> Self {
        let mut lanes = self.0;
        for (x, y) in lanes.iter_mut().zip(other.0) {
            *x = f(*x, y);
        }
        Self(lanes)
    }
}

/// The same expression in every lane, written out. A loop per operation would have to be recognised
/// and unrolled by the compiler thousands of times, which is half of its work.
macro_rules! in_every_lane {
    (|$lane:ident| $value:expr) => {{
        macro_rules! at {
            ($number:literal) => {{
                const $lane: usize = $number;
                $value
            }};
        }
        F64x8([at!(0), at!(1), at!(2), at!(3), at!(4), at!(5), at!(6), at!(7)])
    }};
}

impl Scalar for F64x8 {
    #[inline(always)]
    fn of(x: f64) -> Self {
        Self([x; WIDTH])
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        in_every_lane!(|L| self.0[L].sqrt())
    }
    #[inline(always)]
    fn exp(self) -> Self {
        self.map(f64::exp)
    }
    #[inline(always)]
    fn ln(self) -> Self {
        self.map(f64::ln)
    }
    #[inline(always)]
    fn tanh(self) -> Self {
        self.map(f64::tanh)
    }
    #[inline(always)]
    fn powf(self, y: Self) -> Self {
        self.zip(y, f64::powf)
    }
    #[inline(always)]
    fn select_less(a: Self, b: Self, yes: Self, no: Self) -> Self {
        in_every_lane!(|L| if a.0[L] < b.0[L] { yes.0[L] } else { no.0[L] })
    }
    #[inline(always)]
    fn tabulated<F: Tabulated, const N: usize>(self, table: &F, order: usize) -> [Self; N] {
        table.at_eight(&self, order)
    }
}

impl Neg for F64x8 {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        in_every_lane!(|L| -self.0[L])
    }
}

impl Add for F64x8 {
    type Output = Self;
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        in_every_lane!(|L| self.0[L] + b.0[L])
    }
}

impl Sub for F64x8 {
    type Output = Self;
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        in_every_lane!(|L| self.0[L] - b.0[L])
    }
}

impl Mul for F64x8 {
    type Output = Self;
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        in_every_lane!(|L| self.0[L] * b.0[L])
    }
}

impl Div for F64x8 {
    type Output = Self;
    #[inline(always)]
    fn div(self, b: Self) -> Self {
        in_every_lane!(|L| self.0[L] / b.0[L])
    }
}

impl AddAssign for F64x8 {
    #[inline(always)]
    fn add_assign(&mut self, b: Self) {
        *self = *self + b;
    }
}

impl SubAssign for F64x8 {
    #[inline(always)]
    fn sub_assign(&mut self, b: Self) {
        *self = *self - b;
    }
}

operators_with_f64!([] F64x8);

/// One number from each of eight particles.
#[inline(always)]
fn each<P>(others: [&P; WIDTH], field: impl Fn(&P) -> f64) -> F64x8 {
    in_every_lane!(|L| field(others[L]))
}

impl SimdFloat for F64x8 {
    type Double = Self;
    type Line = Packed;

    #[inline(always)]
    fn load(memory: &F64x8) -> Self {
        *memory
    }
    #[inline(always)]
    fn store(self) -> F64x8 {
        self
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
        let place = |axis: usize| each(others, |p| p.position[axis]);
        separation_of(here, [place(0), place(1), place(2)], space)
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
        let place = |axis: usize| each(lines, |p| p.position[axis]);
        let speed = |axis: usize| each(lines, |p| p.velocity[axis]);
        let (density, p_over_rho2) = (each(lines, |p| p.density), each(lines, |p| p.p_over_rho2));
        let [x, y, z] = [place(0), place(1), place(2)];
        let [u, v, w] = [speed(0), speed(1), speed(2)];
        [x, y, z, u, v, w, density, p_over_rho2]
    }
    #[inline(always)]
    fn adjoints(others: [&PackedAdjoint; WIDTH]) -> [Self; 4] {
        let force = |axis: usize| each(others, |a| a.force[axis]);
        [force(0), force(1), force(2), each(others, |a| a.density)]
    }

    #[inline(always)]
    fn abs(self) -> Self {
        in_every_lane!(|L| self.0[L].abs())
    }
    #[inline(always)]
    fn copysign(self, sign: Self) -> Self {
        in_every_lane!(|L| self.0[L].copysign(sign.0[L]))
    }
    #[inline(always)]
    fn power_of_two(shifted: Self) -> Self {
        in_every_lane!(|L| f64::from_bits((shifted.0[L].to_bits() << 52).wrapping_add(1023 << 52)))
    }
}
