//! Kernels with a learnable shape.

use super::KernelTable;
use super::quadrature::RULE;
use crate::scalar::Scalar;
use std::f64::consts::PI;

/// A parameter of a shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShapeParameter {
    /// Its name in scenes.
    pub name: &'static str,
    /// Its default value.
    pub start: f64,
    /// The smallest and the largest value allowed.
    pub range: [f64; 2],
}

/// A kernel with a shape of two learnable parameters. Each is implemented in a file of its own, and
/// listed in `kernel/mod.rs`.
pub trait LearnableShape: 'static {
    /// Name in scenes.
    const NAME: &'static str;
    /// The parameters, in the order in which [`LearnableShape::shape`] takes them.
    const PARAMETERS: [ShapeParameter; 2];

    /// The kernel up to its normalisation, at `q' = r/2h` in `[0, 1]`; zero at `q' = 1`. With dual
    /// numbers as parameters, its derivatives must be finite at both ends.
    fn shape<T: Scalar>(q: T, parameters: &[T; 2]) -> T;
}

/// `W hᵈ` divided by the shape, for which `W` integrates to one, by Gauss–Legendre quadrature: `σ`
/// of the formula. With dual numbers as parameters it is differentiated. A table is normalised by
/// its own integral instead.
pub fn normalisation<S: LearnableShape, T: Scalar>(parameters: &[T; 2], dimension: usize) -> T {
    let mut integral = T::of(0.0);
    for &[q, weight] in RULE.iter() {
        let power = q.powi(dimension as i32 - 1);
        integral += S::shape(T::of(q), parameters) * (weight * power);
    }
    normalisation_of(integral, dimension)
}

/// `1/(S 2ᵈ I)` for `I = ∫₀¹ q'ᵈ⁻¹ shape dq'`, with the surface `S` of the unit sphere.
pub(super) fn normalisation_of<T: Scalar>(integral: T, dimension: usize) -> T {
    let surface = if dimension == 2 { 2.0 * PI * 4.0 } else { 4.0 * PI * 8.0 };
    T::of(1.0) / (integral * surface)
}

/// A [`LearnableShape`] as a value.
#[derive(Clone, Copy)]
pub struct ShapeKind {
    /// Name in scenes.
    pub name: &'static str,
    /// The parameters.
    pub parameters: [ShapeParameter; 2],
    table: fn([f64; 2], usize) -> KernelTable,
}

impl ShapeKind {
    /// The learnable shape of type `S`.
    pub const fn of<S: LearnableShape>() -> Self {
        Self { name: S::NAME, parameters: S::PARAMETERS, table: KernelTable::of::<S> }
    }

    /// The table of this shape at given parameters in `dimension` 2 or 3.
    pub fn table(&self, parameters: [f64; 2], dimension: usize) -> KernelTable {
        (self.table)(parameters, dimension)
    }
}

impl std::fmt::Debug for ShapeKind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.name)
    }
}

impl PartialEq for ShapeKind {
    /// Names are unique.
    fn eq(&self, other: &Self) -> bool {
        self.name == other.name
    }
}
