//! Tabulated kernels.

use super::shape::normalisation_of;
use super::spline::{INTERVALS, Spline};
use super::{Kernel, LearnableShape};
use crate::scalar::{Dual, Scalar};

/// A normalised kernel with a learnable shape at given parameters, as a spline `P` of
/// `u = (r/2h)²`.
///
/// `W = h⁻ᵈ P(u)`, `W'(r)/r = h⁻ᵈ P'(u)/(2h²)`, `G'(r)/r = h⁻ᵈ P''(u)/(4h⁴)`: the derivatives are
/// exactly those of the spline, and nothing is divided by `r`. Derivatives by the parameters are
/// splines through the derivatives at the knots; because a spline is a linear function of its
/// values, they are exact derivatives of the spline, too. The spline is normalised: it integrates
/// to one.
///
/// Error against the formula, at the default parameters (`tests/kernel_tables.rs`): for `W_ab`
/// `1.1e-5 W(0)` next to the centre, where it has no fourth derivative, and `3.3e-8 W(0)` from
/// `0.3 h` on; for `W₂` `3.7e-8 W(0)`. It costs a call and eight lookups for eight pairs.
#[derive(Clone)]
pub struct KernelTable {
    name: &'static str,
    at: [f64; 2],
    dimension: usize,
    value: Spline,
    by: [Spline; 2],
}

impl KernelTable {
    /// The table of a shape at given parameters in `dimension` 2 or 3.
    pub fn of<S: LearnableShape>(at: [f64; 2], dimension: usize) -> Self {
        let variable = |p: usize| Dual::variable(at[p], p, [0.0; 2]);
        let parameters = [variable(0), variable(1)];
        let knot = |k: usize| {
            let q = (k as f64 / INTERVALS as f64).sqrt();
            S::shape(Dual::of(q), &parameters)
        };
        let mut knots: Vec<Dual<f64, 2>> = (0..=INTERVALS).map(knot).collect();
        let moment = |[value, by_a, by_b]: &[Spline; 3]| {
            let [value, by_a, by_b] = [value, by_a, by_b].map(|s| s.moment(dimension as i32 - 1));
            Dual { value, gradient: [by_a, by_b] }
        };
        let scale = normalisation_of(moment(&splines(&knots)), dimension);
        knots.iter_mut().for_each(|knot| *knot = *knot * scale);
        let [value, by_a, by_b] = splines(&knots);
        Self { name: S::NAME, at, dimension, value, by: [by_a, by_b] }
    }

    /// Name of the shape in scenes.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// The values of its parameters.
    pub fn at(&self) -> [f64; 2] {
        self.at
    }

    /// Dimension of the space in which it is normalised.
    pub fn dimension(&self) -> usize {
        self.dimension
    }
}

/// The splines through the values at the knots, and through their derivatives by the two
/// parameters.
fn splines(knots: &[Dual<f64, 2>]) -> [Spline; 3] {
    let by = |p: usize| Spline::through(|k| knots[k].gradient[p]);
    [Spline::through(|k| knots[k].value), by(0), by(1)]
}

impl std::fmt::Debug for KernelTable {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { name, at, dimension, .. } = self;
        write!(f, "KernelTable({name}, {at:?}, {dimension}D)")
    }
}

/// `u = (r/2h)²`.
#[inline(always)]
fn argument<T: Scalar>(q: T) -> T {
    q * q * 0.25
}

impl Kernel for KernelTable {
    fn is_table(&self) -> bool {
        true
    }

    /// One: the table is normalised.
    fn normalisation(&self, dimension: usize) -> f64 {
        debug_assert_eq!(dimension, self.dimension, "a table is of one dimension");
        1.0
    }

    #[inline(always)]
    fn value<T: Scalar>(&self, q: T) -> T {
        let [value] = argument(q).tabulated(&self.value, 0);
        value
    }

    #[inline(always)]
    fn dw_over_r<T: Scalar>(&self, q: T) -> T {
        let [slope] = argument(q).tabulated(&self.value, 1);
        slope * 0.5
    }

    #[inline(always)]
    fn d_dw_over_r<T: Scalar>(&self, q: T) -> T {
        let [bend] = argument(q).tabulated(&self.value, 2);
        bend * 0.25
    }

    #[inline(always)]
    fn dw_derivatives<T: Scalar>(&self, q: T) -> [T; 2] {
        let [slope, bend] = argument(q).tabulated(&self.value, 1);
        [slope * 0.5, bend * 0.25]
    }

    #[inline(always)]
    fn parameters(&self) -> usize {
        2
    }

    #[inline(always)]
    fn value_by<T: Scalar>(&self, parameter: usize, q: T) -> T {
        let Some(by) = self.by.get(parameter) else { return T::of(0.0) };
        let [value] = argument(q).tabulated(by, 0);
        value
    }

    #[inline(always)]
    fn dw_over_r_by<T: Scalar>(&self, parameter: usize, q: T) -> T {
        let Some(by) = self.by.get(parameter) else { return T::of(0.0) };
        let [slope] = argument(q).tabulated(by, 1);
        slope * 0.5
    }
}
