//! Kernels evaluated by their formula.
//!
//! Equation numbers are those of Woodward et al., arXiv:2110.13311: see `docs/equations.md`.

use super::Kernel;
use crate::scalar::Scalar;
use std::f64::consts::PI;

/// Lower bound of `q` in a singular second derivative; below it, the factors `r²` have underflowed
/// to zero.
const SMALLEST_Q: f64 = 1e-100;

/// The cubic B-spline, `w = ¼(2−q)₊³ − (1−q)₊³` (Monaghan 1992; Eq. (12)).
#[derive(Clone, Copy, Debug, Default)]
pub struct CubicSpline;

impl Kernel for CubicSpline {
    fn normalisation(&self, dimension: usize) -> f64 {
        if dimension == 2 { 10.0 / (7.0 * PI) } else { 1.0 / PI }
    }

    #[inline(always)]
    fn value<T: Scalar>(&self, q: T) -> T {
        let outer = (T::of(2.0) - q).max(T::of(0.0));
        let inner = q * q * (q * 0.75 - 1.5) + 1.0;
        T::select_less(q, T::of(1.0), inner, outer * outer * outer * 0.25)
    }

    #[inline(always)]
    fn dw_over_r<T: Scalar>(&self, q: T) -> T {
        let outer = (T::of(2.0) - q).max(T::of(0.0));
        let beyond = outer * outer * -0.75 / q.max(T::of(1.0));
        T::select_less(q, T::of(1.0), q * 2.25 - 3.0, beyond)
    }

    #[inline(always)]
    fn d_dw_over_r<T: Scalar>(&self, q: T) -> T {
        let outer = (T::of(2.0) - q).max(T::of(0.0));
        let inside = |yes: T, no: T| T::select_less(q, T::of(1.0), yes, no);
        let under = inside(q.max(T::smallest(SMALLEST_Q)), q * q * q);
        inside(T::of(2.25), outer * (q + 2.0) * 0.75) / under
    }

    #[inline(always)]
    fn dw_derivatives<T: Scalar>(&self, q: T) -> [T; 2] {
        let outer = (T::of(2.0) - q).max(T::of(0.0));
        let inside = |yes: T, no: T| T::select_less(q, T::of(1.0), yes, no);
        // One division for both.
        let inverse = T::of(1.0) / q.max(T::smallest(SMALLEST_Q));
        let dw_over_r = inside(q * 2.25 - 3.0, outer * outer * inverse * -0.75);
        let beyond = outer * (q + 2.0) * 0.75 * (inverse * inverse);
        [dw_over_r, inside(T::of(2.25), beyond) * inverse]
    }
}

/// Wendland's C² function, `w = (1−q/2)₊⁴ (1+2q)`: no pairing instability (Dehnen & Aly 2012).
#[derive(Clone, Copy, Debug, Default)]
pub struct WendlandC2;

impl Kernel for WendlandC2 {
    fn normalisation(&self, dimension: usize) -> f64 {
        if dimension == 2 { 7.0 / (4.0 * PI) } else { 21.0 / (16.0 * PI) }
    }

    #[inline(always)]
    fn value<T: Scalar>(&self, q: T) -> T {
        let u = (q * -0.5 + 1.0).max(T::of(0.0));
        let u2 = u * u;
        u2 * u2 * (q * 2.0 + 1.0)
    }

    #[inline(always)]
    fn dw_over_r<T: Scalar>(&self, q: T) -> T {
        let u = (q * -0.5 + 1.0).max(T::of(0.0));
        u * u * u * -5.0
    }

    #[inline(always)]
    fn d_dw_over_r<T: Scalar>(&self, q: T) -> T {
        let u = (q * -0.5 + 1.0).max(T::of(0.0));
        u * u * 7.5 / q.max(T::smallest(SMALLEST_Q))
    }

    #[inline(always)]
    fn dw_derivatives<T: Scalar>(&self, q: T) -> [T; 2] {
        [self.dw_over_r(q), self.d_dw_over_r(q)]
    }
}

/// Wendland's C⁴ function, `w = (1−q/2)₊⁶ (1 + 3q + 35/12 q²)` (Dehnen & Aly 2012).
#[derive(Clone, Copy, Debug, Default)]
pub struct WendlandC4;

impl Kernel for WendlandC4 {
    fn normalisation(&self, dimension: usize) -> f64 {
        if dimension == 2 { 9.0 / (4.0 * PI) } else { 495.0 / (256.0 * PI) }
    }

    #[inline(always)]
    fn value<T: Scalar>(&self, q: T) -> T {
        let u = (q * -0.5 + 1.0).max(T::of(0.0));
        let u3 = u * u * u;
        u3 * u3 * (q * (q * (35.0 / 12.0) + 3.0) + 1.0)
    }

    #[inline(always)]
    fn dw_over_r<T: Scalar>(&self, q: T) -> T {
        let u = (q * -0.5 + 1.0).max(T::of(0.0));
        let u2 = u * u;
        u2 * u2 * u * (q * 2.5 + 1.0) * (-14.0 / 3.0)
    }

    #[inline(always)]
    fn d_dw_over_r<T: Scalar>(&self, q: T) -> T {
        let u = (q * -0.5 + 1.0).max(T::of(0.0));
        let u2 = u * u;
        u2 * u2 * 35.0
    }

    #[inline(always)]
    fn dw_derivatives<T: Scalar>(&self, q: T) -> [T; 2] {
        [self.dw_over_r(q), self.d_dw_over_r(q)]
    }
}
