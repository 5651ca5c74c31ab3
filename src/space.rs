//! Space: a length and a kind for each axis. The only place that implements periodicity.

use crate::scalar::Scalar;
use crate::vector::Vector;
use serde::{Deserialize, Serialize};

/// How space continues beyond the side of an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Axis {
    /// Position `x + L` is position `x`.
    #[default]
    Periodic,
    /// Space has no end, and no particle an image. The side is only where the flow starts, and
    /// where its fields are compared.
    Open,
}

/// A rectangular box `[0, L_x) × [0, L_y) × …`, each axis of its own length and kind.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Space {
    /// Length of each axis. Axes beyond the dimension have that of the first.
    sides: [f64; 3],
    /// The period of each axis; infinite where it is open.
    periods: [f64; 3],
}

impl Space {
    /// A fully periodic box of equal sides.
    pub const fn cube(side: f64) -> Self {
        Self { sides: [side; 3], periods: [side; 3] }
    }

    /// A box of these sides and axes.
    pub fn new<const D: usize>(sides: [f64; D], axes: [Axis; D]) -> Self {
        let mut space = Self::cube(sides[0]);
        for axis in 0..D {
            space.sides[axis] = sides[axis];
            space.periods[axis] = match axes[axis] {
                Axis::Periodic => sides[axis],
                Axis::Open => f64::INFINITY,
            };
        }
        space
    }

    /// The same axes with these sides.
    pub(crate) fn with_sides<const D: usize>(self, sides: [f64; D]) -> Self {
        let axes = std::array::from_fn(|axis| self.axis(axis));
        Self::new(sides, axes)
    }

    /// Length of an axis.
    #[inline(always)]
    pub fn side(&self, axis: usize) -> f64 {
        self.sides[axis]
    }

    /// Lengths of all axes.
    pub fn sides<const D: usize>(&self) -> [f64; D] {
        std::array::from_fn(|axis| self.sides[axis])
    }

    /// Kind of an axis.
    pub fn axis(&self, axis: usize) -> Axis {
        if self.periods[axis].is_finite() { Axis::Periodic } else { Axis::Open }
    }

    /// Whether an axis is periodic.
    #[inline(always)]
    pub fn is_periodic(&self, axis: usize) -> bool {
        self.periods[axis].is_finite()
    }

    /// Whether all axes are periodic and of one length.
    pub fn is_periodic_cube<const D: usize>(&self) -> bool {
        (0..D).all(|axis| self.periods[axis].to_bits() == self.sides[0].to_bits())
    }

    /// The length of the longest axis.
    pub fn longest<const D: usize>(&self) -> f64 {
        self.sides[..D].iter().copied().fold(0.0, f64::max)
    }

    /// The length of the shortest axis.
    pub fn shortest<const D: usize>(&self) -> f64 {
        self.sides[..D].iter().copied().fold(f64::INFINITY, f64::min)
    }

    /// The shortest period; infinite where all axes are open.
    pub fn shortest_period<const D: usize>(&self) -> f64 {
        self.periods[..D].iter().copied().fold(f64::INFINITY, f64::min)
    }

    /// The product of all lengths: the volume, in 2D the area, that the fluid fills at its start.
    pub fn volume<const D: usize>(&self) -> f64 {
        if self.sides[..D].iter().all(|side| side.to_bits() == self.sides[0].to_bits()) {
            return self.sides[0].powi(D as i32);
        }
        self.sides[..D].iter().product()
    }

    /// Distance of particles that fill the box, `(V/N)^(1/d)`.
    pub fn spacing<const D: usize>(&self, particles: usize) -> f64 {
        if self.is_periodic_cube::<D>() {
            return self.sides[0] / (particles as f64).powf(1.0 / D as f64);
        }
        (self.volume::<D>() / particles as f64).powf(1.0 / D as f64)
    }

    /// The shortest of all periodic images of a difference of two positions in the box.
    ///
    /// Exact for components in `(−L, L)`. It is branch-free, so that it works on lanes and dual
    /// numbers (its derivative is the identity).
    #[inline(always)]
    pub fn minimum_image<T: Scalar, const D: usize>(
        &self,
        mut difference: Vector<T, D>,
    ) -> Vector<T, D> {
        for (x, &period) in difference.0.iter_mut().zip(&self.periods) {
            let length = T::of(period);
            let half = T::of(0.5 * period);
            // Along an open axis no component is beyond half of an infinite period.
            let below = T::select_less(half, *x, *x - length, *x);
            *x = T::select_less(below, -half, below + length, below);
        }
        difference
    }

    /// The image of a position inside the box, along the periodic axes.
    #[inline(always)]
    pub fn wrap<const D: usize>(&self, mut position: Vector<f64, D>) -> Vector<f64, D> {
        for (x, &period) in position.0.iter_mut().zip(&self.periods) {
            if (0.0..period).contains(x) || !period.is_finite() {
                continue;
            }
            let inside = *x - period * (*x / period).floor();
            // A tiny negative `x` rounds up to `L`, which is the same place as 0; NaN stays NaN.
            *x = if inside >= period { 0.0 } else { inside };
        }
        position
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOX: Space = Space::cube(2.0);

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

    #[test]
    fn an_open_axis_has_no_images_and_each_axis_its_own_length() {
        let space = Space::new([2.0, 3.0, 4.0], [Axis::Periodic, Axis::Open, Axis::Periodic]);
        let image = space.minimum_image(Vector([1.5, 2.9, 3.0]));
        assert_eq!(image, Vector([-0.5, 2.9, -1.0]));
        assert_eq!(space.wrap(Vector([2.5, -7.0, 4.5])), Vector([0.5, -7.0, 0.5]));
        let volumes = [space.volume::<3>(), space.volume::<2>()];
        assert_eq!(Vector(volumes), Vector([24.0, 6.0]));
        assert!(!space.is_periodic_cube::<2>() && BOX.is_periodic_cube::<3>());
    }
}
