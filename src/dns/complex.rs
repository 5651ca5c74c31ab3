//! Eight complex numbers at once, in memory and in registers.

use crate::scalar::{F64x8, SimdFloat};

/// Eight complex numbers in memory: real parts, then imaginary parts.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[repr(C)]
pub(super) struct ComplexF64x8 {
    /// Real parts.
    pub(super) re: F64x8,
    /// Imaginary parts.
    pub(super) im: F64x8,
}

impl ComplexF64x8 {
    /// Zero.
    pub(super) const ZERO: Self = Self { re: F64x8::ZERO, im: F64x8::ZERO };

    /// Real and imaginary part of one number.
    pub(super) fn lane(&self, lane: usize) -> [f64; 2] {
        [self.re.lane(lane), self.im.lane(lane)]
    }

    /// Replaces one number.
    pub(super) fn set_lane(&mut self, lane: usize, [re, im]: [f64; 2]) {
        self.re.set_lane(lane, re);
        self.im.set_lane(lane, im);
    }
}

/// The same in registers.
#[derive(Clone, Copy)]
pub(super) struct Complex<V> {
    pub(super) re: V,
    pub(super) im: V,
}

impl<V: SimdFloat> Complex<V> {
    #[inline(always)]
    pub(super) fn load(memory: &ComplexF64x8) -> Self {
        Self { re: V::load(&memory.re), im: V::load(&memory.im) }
    }

    #[inline(always)]
    pub(super) fn store(self) -> ComplexF64x8 {
        ComplexF64x8 { re: self.re.store(), im: self.im.store() }
    }

    #[inline(always)]
    pub(super) fn zero() -> Self {
        Self { re: V::of(0.0), im: V::of(0.0) }
    }

    #[inline(always)]
    pub(super) fn plus(self, other: Self) -> Self {
        Self { re: self.re + other.re, im: self.im + other.im }
    }

    #[inline(always)]
    pub(super) fn minus(self, other: Self) -> Self {
        Self { re: self.re - other.re, im: self.im - other.im }
    }

    /// Times a real number.
    #[inline(always)]
    pub(super) fn scaled(self, factor: V) -> Self {
        Self { re: self.re * factor, im: self.im * factor }
    }

    /// Times one complex number `[re, im]`, or its conjugate where `INVERSE`.
    #[inline(always)]
    pub(super) fn times<const INVERSE: bool>(self, [re, im]: [f64; 2]) -> Self {
        let (re, im) = (V::of(re), V::of(if INVERSE { -im } else { im }));
        Self { re: self.re * re - self.im * im, im: self.re * im + self.im * re }
    }

    /// Times `−i`, or `i` where `INVERSE`.
    #[inline(always)]
    pub(super) fn turned<const INVERSE: bool>(self) -> Self {
        if INVERSE {
            Self { re: -self.im, im: self.re }
        } else {
            Self { re: self.im, im: -self.re }
        }
    }
}
