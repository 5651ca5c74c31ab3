//! Dual numbers: a value with its gradient in `P` directions (forward-mode differentiation).

use super::{Scalar, Tabulated, operators_with_f64};
use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// `value + Σₚ gradientₚ εₚ` with `εₚ εₛ = 0`. Any law over [`Scalar`], evaluated at a dual number,
/// gives its value and its exact gradient, at the cost of about `1 + P` values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dual<T, const P: usize> {
    /// The value.
    pub value: T,
    /// The derivative in each of the `P` directions.
    pub gradient: [T; P],
}

impl<T: Scalar, const P: usize> Dual<T, P> {
    /// The `index`-th independent variable; `zeros` is an array of zeros.
    #[inline(always)]
    pub fn variable(value: T, index: usize, zeros: [T; P]) -> Self {
        let mut gradient = zeros;
        gradient[index] = T::of(1.0);
        Self { value, gradient }
    }

    /// The chain rule for a function of one argument: `f(x)`, with `slope = f'(x)`.
    #[inline(always)]
    fn chain(self, value: T, slope: T) -> Self {
        Self { value, gradient: self.gradient.map(|g| slope * g) }
    }

    /// The chain rule for a function of two arguments with the slopes `by_a` and `by_b`.
    #[inline(always)]
    fn chain2(a: Self, b: Self, value: T, (by_a, by_b): (T, T)) -> Self {
        let gradient = std::array::from_fn(|p| by_a * a.gradient[p] + by_b * b.gradient[p]);
        Self { value, gradient }
    }
}

impl<T: Scalar, const P: usize> Scalar for Dual<T, P> {
    const TABLES: bool = T::TABLES;

    #[inline(always)]
    fn of(x: f64) -> Self {
        Self { value: T::of(x), gradient: [T::of(0.0); P] }
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.chain(root, T::of(0.5) / root)
    }
    #[inline(always)]
    fn exp(self) -> Self {
        let value = self.value.exp();
        self.chain(value, value)
    }
    #[inline(always)]
    fn ln(self) -> Self {
        self.chain(self.value.ln(), T::of(1.0) / self.value)
    }
    #[inline(always)]
    fn tanh(self) -> Self {
        let value = self.value.tanh();
        self.chain(value, T::of(1.0) - value * value)
    }
    #[inline(always)]
    fn powf(self, y: Self) -> Self {
        let value = self.value.powf(y.value);
        let by_base = y.value * self.value.powf(y.value - 1.0);
        Self::chain2(self, y, value, (by_base, value * self.value.ln()))
    }
    #[inline(always)]
    fn select_less(a: Self, b: Self, yes: Self, no: Self) -> Self {
        let pick = |yes: T, no: T| T::select_less(a.value, b.value, yes, no);
        Self {
            value: pick(yes.value, no.value),
            gradient: std::array::from_fn(|p| pick(yes.gradient[p], no.gradient[p])),
        }
    }
    #[inline(always)]
    fn tabulated<F: Tabulated, const N: usize>(self, table: &F, order: usize) -> [Self; N] {
        let values = self.value.tabulated::<F, N>(table, order);
        let slopes = self.value.tabulated::<F, N>(table, order + 1);
        let mut found = [self; N];
        for (found, (value, slope)) in found.iter_mut().zip(values.into_iter().zip(slopes)) {
            *found = self.chain(value, slope);
        }
        found
    }
}

impl<T: Scalar, const P: usize> Neg for Dual<T, P> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        Self { value: -self.value, gradient: self.gradient.map(|g| -g) }
    }
}

impl<T: Scalar, const P: usize> Add for Dual<T, P> {
    type Output = Self;
    #[inline(always)]
    fn add(self, b: Self) -> Self {
        let gradient = std::array::from_fn(|p| self.gradient[p] + b.gradient[p]);
        Self { value: self.value + b.value, gradient }
    }
}

impl<T: Scalar, const P: usize> Sub for Dual<T, P> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, b: Self) -> Self {
        let gradient = std::array::from_fn(|p| self.gradient[p] - b.gradient[p]);
        Self { value: self.value - b.value, gradient }
    }
}

impl<T: Scalar, const P: usize> Mul for Dual<T, P> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, b: Self) -> Self {
        Self::chain2(self, b, self.value * b.value, (b.value, self.value))
    }
}

impl<T: Scalar, const P: usize> Div for Dual<T, P> {
    type Output = Self;
    #[inline(always)]
    fn div(self, b: Self) -> Self {
        let value = self.value / b.value;
        let by_a = T::of(1.0) / b.value;
        Self::chain2(self, b, value, (by_a, -(value * by_a)))
    }
}

impl<T: Scalar, const P: usize> AddAssign for Dual<T, P> {
    #[inline(always)]
    fn add_assign(&mut self, b: Self) {
        *self = *self + b;
    }
}

impl<T: Scalar, const P: usize> SubAssign for Dual<T, P> {
    #[inline(always)]
    fn sub_assign(&mut self, b: Self) {
        *self = *self - b;
    }
}

operators_with_f64!([T: Scalar, const P: usize] Dual<T, P>);
