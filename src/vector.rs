//! Vectors of dimension `D` over any [`Scalar`]: the numbers of the pair loops, which are written once for both
//! dimensions, for lanes and for dual numbers. glam's `DVec2` and `DVec3` convert to and from them, and are what the
//! components of a particle show ([`crate::systems::particles`]).

use crate::scalar::Scalar;
use glam::{DVec2, DVec3};
use std::ops::{Add, AddAssign, Index, IndexMut, Mul, Neg, Sub, SubAssign};

/// A vector with `D` components.
///
/// ```
/// use whirls::vector::Vector;
/// let sum = Vector::from(glam::DVec3::X) + Vector([0.0, 2.0, 0.0]);
/// assert_eq!(glam::DVec3::from(sum), glam::dvec3(1.0, 2.0, 0.0));
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(transparent)]
pub struct Vector<T, const D: usize>(pub [T; D]);

impl<T: Scalar, const D: usize> Vector<T, D> {
    /// The zero vector.
    #[inline(always)]
    pub fn zero() -> Self {
        Self([T::of(0.0); D])
    }

    /// The scalar product `a · b`.
    #[inline(always)]
    pub fn dot(self, b: Self) -> T {
        let mut sum = self.0[0] * b.0[0];
        for axis in 1..D {
            sum += self.0[axis] * b.0[axis];
        }
        sum
    }

    /// `|a|²`.
    #[inline(always)]
    pub fn norm_squared(self) -> T {
        self.dot(self)
    }

    /// Applies `f` to every component.
    #[inline(always)]
    pub fn map<U>(self, f: impl Fn(T) -> U) -> Vector<U, D> {
        Vector(self.0.map(f))
    }
}

impl<const D: usize> Vector<f64, D> {
    /// `|a|`.
    pub fn norm(self) -> f64 {
        self.norm_squared().sqrt()
    }

    /// The same vector in three dimensions, with `z = 0` in 2D.
    pub fn to_3d(self) -> [f64; 3] {
        std::array::from_fn(|axis| if axis < D { self.0[axis] } else { 0.0 })
    }

    /// The first `D` of three components.
    pub fn from_3d(components: [f64; 3]) -> Self {
        Self(std::array::from_fn(|axis| components[axis]))
    }

    /// Whether every component is a finite number.
    pub fn is_finite(self) -> bool {
        self.0.iter().all(|x| x.is_finite())
    }
}

impl<T: Scalar, const D: usize> Default for Vector<T, D> {
    fn default() -> Self {
        Self::zero()
    }
}

impl<T: Scalar, const D: usize> Add for Vector<T, D> {
    type Output = Self;
    #[inline(always)]
    fn add(mut self, b: Self) -> Self {
        self += b;
        self
    }
}

impl<T: Scalar, const D: usize> Sub for Vector<T, D> {
    type Output = Self;
    #[inline(always)]
    fn sub(mut self, b: Self) -> Self {
        self -= b;
        self
    }
}

impl<T: Scalar, const D: usize> Neg for Vector<T, D> {
    type Output = Self;
    #[inline(always)]
    fn neg(mut self) -> Self {
        for x in &mut self.0 {
            *x = -*x;
        }
        self
    }
}

impl<T: Scalar, const D: usize> Mul<T> for Vector<T, D> {
    type Output = Self;
    #[inline(always)]
    fn mul(mut self, factor: T) -> Self {
        // A loop: the closure of an array's `map` is not inlined into vectorised functions.
        for x in &mut self.0 {
            *x = *x * factor;
        }
        self
    }
}

impl<T: Scalar, const D: usize> AddAssign for Vector<T, D> {
    #[inline(always)]
    fn add_assign(&mut self, b: Self) {
        for axis in 0..D {
            self.0[axis] += b.0[axis];
        }
    }
}

impl<T: Scalar, const D: usize> SubAssign for Vector<T, D> {
    #[inline(always)]
    fn sub_assign(&mut self, b: Self) {
        for axis in 0..D {
            self.0[axis] -= b.0[axis];
        }
    }
}

impl<T, const D: usize> Index<usize> for Vector<T, D> {
    type Output = T;
    #[inline(always)]
    fn index(&self, axis: usize) -> &T {
        &self.0[axis]
    }
}

impl<T, const D: usize> IndexMut<usize> for Vector<T, D> {
    #[inline(always)]
    fn index_mut(&mut self, axis: usize) -> &mut T {
        &mut self.0[axis]
    }
}

impl From<DVec2> for Vector<f64, 2> {
    fn from(v: DVec2) -> Self {
        Self(v.to_array())
    }
}

impl From<DVec3> for Vector<f64, 3> {
    fn from(v: DVec3) -> Self {
        Self(v.to_array())
    }
}

impl From<Vector<f64, 2>> for DVec2 {
    fn from(v: Vector<f64, 2>) -> Self {
        Self::from_array(v.0)
    }
}

impl From<Vector<f64, 3>> for DVec3 {
    fn from(v: Vector<f64, 3>) -> Self {
        Self::from_array(v.0)
    }
}
