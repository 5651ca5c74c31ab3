//! The periodic box `[0, L)ᵈ`: the only place that implements periodicity.

use crate::scalar::Scalar;
use crate::vector::Vector;

/// A fully periodic box of side `length`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PeriodicBox {
    /// Side `L`, equal along every axis.
    pub length: f64,
}

impl PeriodicBox {
    /// The shortest of all periodic images of a difference of two positions in the box.
    ///
    /// Exact for components in `(−L, L)`. It is branch-free, so that it works on lanes and dual
    /// numbers (its derivative is the identity).
    #[inline(always)]
    pub fn minimum_image<T: Scalar, const D: usize>(
        &self,
        mut difference: Vector<T, D>,
    ) -> Vector<T, D> {
        let length = T::of(self.length);
        let half = T::of(0.5 * self.length);
        for x in &mut difference.0 {
            let below = T::select_less(half, *x, *x - length, *x);
            *x = T::select_less(below, -half, below + length, below);
        }
        difference
    }

    /// The image of a position inside `[0, L)ᵈ`.
    #[inline(always)]
    pub fn wrap<const D: usize>(&self, position: Vector<f64, D>) -> Vector<f64, D> {
        position.map(|x| {
            if (0.0..self.length).contains(&x) {
                return x;
            }
            let inside = x - self.length * (x / self.length).floor();
            // A tiny negative `x` rounds up to `L`, which is the same place as 0; NaN stays NaN.
            if inside >= self.length { 0.0 } else { inside }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOX: PeriodicBox = PeriodicBox { length: 2.0 };

    #[test]
    fn no_image_is_farther_than_half_the_box_along_an_axis() {
        for x in [-1.99, -1.01, -1.0, -0.3, 0.0, 0.7, 1.0, 1.01, 1.99] {
            let image = BOX.minimum_image(Vector([x, -x])).0;
            assert!(image[0].abs() <= 1.0 && ((image[0] - x) / 2.0).fract().abs() < 1e-15);
        }
    }

    #[test]
    fn wrapped_positions_lie_inside_even_a_hair_below_zero() {
        for x in [-1e-300, -1e-17, -2.0, 2.0, 1e9, -1e9, 1.999_999_999_999_999_9] {
            let inside = BOX.wrap(Vector([x])).0[0];
            assert!((0.0..2.0).contains(&inside), "{x} became {inside}");
        }
    }
}
