//! Fixed-point coordinates, in which neighbour searches compare positions.

use crate::packed::{PackedSingle, nearest};
use crate::space::Space;
use crate::vector::Vector;

/// Positions as whole numbers, in steps of the same length along all axes.
///
/// In a periodic cube of side `L` a step is `L·2⁻³²`, and a difference of two 32-bit coordinates
/// wraps around as the cube does: it is that of the nearest images. In any other space the longest
/// axis has `2³⁰` steps, and a search adds the period of an axis to the cells beyond its boundary.
///
/// An open axis is embedded in a period that exceeds the extent of the particles by so much that
/// none of them can meet an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FixedPoint<const D: usize> {
    /// Position of coordinate zero.
    origin: [f64; D],
    /// Length of `2³²` steps.
    span: f64,
    /// The period of each axis in steps; 0 stands for `2³²`.
    period: [u32; D],
    /// Whether positions along the axis are brought back into one period.
    wraps: [bool; D],
    /// The space, with the embedding's length along open axes.
    space: Space,
}

impl<const D: usize> Default for FixedPoint<D> {
    fn default() -> Self {
        Self::new(Space::cube(1.0), 0.0, std::iter::empty())
    }
}

impl<const D: usize> FixedPoint<D> {
    /// Coordinates in a space. `positions` are read only where an axis is open; no two particles
    /// meet through its boundary as long as none moves `margin` or more.
    pub fn new(space: Space, margin: f64, positions: impl Iterator<Item = Vector<f64, D>>) -> Self {
        if space.is_periodic_cube::<D>() {
            let span = space.side(0);
            return Self { origin: [0.0; D], span, period: [0; D], wraps: [false; D], space };
        }
        let wraps: [bool; D] = std::array::from_fn(|axis| space.is_periodic(axis));
        let (mut origin, mut sides) = ([0.0; D], space.sides::<D>());
        if wraps.contains(&false) {
            let [least, most] = extent(positions);
            for axis in (0..D).filter(|&axis| !wraps[axis]) {
                // Without a particle at a finite position any embedding will do.
                if least[axis].is_finite() && most[axis].is_finite() {
                    origin[axis] = least[axis] - margin;
                    sides[axis] = most[axis] - least[axis] + 2.0 * margin;
                }
            }
        }
        let space = space.with_sides(sides);
        let span = 4.0 * space.longest::<D>();
        let period = sides.map(|side| (side * (PackedSingle::STEPS / span)).round() as u32);
        Self { origin, span, period, wraps, space }
    }

    /// The space, with the embedding's length along open axes.
    #[inline(always)]
    pub fn space(&self) -> Space {
        self.space
    }

    /// Steps per unit of length.
    #[inline(always)]
    pub fn steps_per_length(&self) -> f64 {
        PackedSingle::STEPS / self.span
    }

    /// Coordinates of a position.
    #[inline(always)]
    pub fn of(&self, position: Vector<f64, D>) -> [i32; D] {
        let mut place = [0; D];
        for (axis, place) in place.iter_mut().enumerate() {
            *place = nearest((position[axis] - self.origin[axis]) * self.steps_per_length());
            // A position just below the boundary is rounded to the boundary.
            if self.wraps[axis] && *place as u32 >= self.period[axis] {
                *place = place.wrapping_sub(self.period[axis] as i32);
            }
        }
        place
    }

    /// The change of a position between two places, at most half a period along periodic axes.
    #[inline(always)]
    pub(crate) fn moved(&self, now: [i32; D], before: [i32; D]) -> [i32; D] {
        let mut moved = [0; D];
        for axis in 0..D {
            moved[axis] = now[axis].wrapping_sub(before[axis]);
            if self.wraps[axis] {
                let (period, half) = (self.period[axis] as i32, (self.period[axis] / 2) as i32);
                if moved[axis] > half {
                    moved[axis] -= period;
                } else if moved[axis] < -half {
                    moved[axis] += period;
                }
            }
        }
        moved
    }

    /// Coordinates of the image of a position that is nearest to a place.
    pub(crate) fn image_near(&self, position: Vector<f64, D>, near: [i32; D]) -> [i32; D] {
        let moved = self.moved(self.of(position), near);
        std::array::from_fn(|axis| near[axis].wrapping_add(moved[axis]))
    }

    /// The place of which the image in cells shifted by whole periods is looked for, see
    /// [`crate::neighbours::cells::Range::image`].
    #[inline(always)]
    pub(crate) fn seen_from(&self, mut place: [i32; D], image: [i8; 3]) -> [i32; D] {
        for axis in 0..D {
            let shift = i32::from(image[axis]).wrapping_mul(self.period[axis] as i32);
            place[axis] = place[axis].wrapping_sub(shift);
        }
        place
    }

    /// Steps in a period of an axis.
    pub(crate) fn steps(&self, axis: usize) -> u64 {
        match self.period[axis] {
            0 => 1 << 32,
            steps => steps.into(),
        }
    }

    /// Whether differences of coordinates along an axis wrap around by themselves.
    #[inline(always)]
    pub(crate) fn is_modular(&self, axis: usize) -> bool {
        self.period[axis] == 0
    }

    /// Whether a coordinate is within `margin` steps of the boundary of an axis.
    #[inline(always)]
    pub(crate) fn is_near_seam(&self, x: i32, axis: usize, margin: u32) -> bool {
        let x = x as u32;
        x <= margin || x >= self.period[axis].wrapping_sub(margin)
    }

    /// Squared distances, in steps: below the first a pair is certainly within `reach`, from the
    /// second on certainly not. The relative error of such a square is 4e-7 in `f32`, the
    /// quantisation error of a distance `1e-9` spans.
    pub fn limits(&self, reach: f64) -> [f32; 2] {
        let steps = reach * self.steps_per_length();
        let doubt = 1e-6 + 1e-8 * self.span / reach;
        [(steps * steps * (1.0 - doubt)) as f32, (steps * steps * (1.0 + doubt)) as f32]
    }
}

/// The smallest and largest coordinate of finite positions, axis by axis.
fn extent<const D: usize>(positions: impl Iterator<Item = Vector<f64, D>>) -> [[f64; D]; 2] {
    let (mut least, mut most) = ([f64::INFINITY; D], [f64::NEG_INFINITY; D]);
    for position in positions {
        for axis in 0..D {
            // A coordinate that is NaN changes neither.
            least[axis] = least[axis].min(position[axis]);
            most[axis] = most[axis].max(position[axis]);
        }
    }
    [least, most]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::Axis;

    #[test]
    fn a_cube_uses_all_bits_and_an_open_axis_is_embedded_with_its_margin() {
        let cube = FixedPoint::<2>::new(Space::cube(2.0), 0.1, std::iter::empty());
        assert_eq!(cube.of(Vector([1.0, 0.5])), [i32::MIN, 1 << 30]);
        let space = Space::new([2.0, 1.0], [Axis::Open, Axis::Periodic]);
        let places = [Vector([-3.0, 0.25]), Vector([5.0, 0.999_999_999_999])];
        let open = FixedPoint::<2>::new(space, 1.0, places.into_iter());
        assert_eq!(Vector(open.space().sides()), Vector([10.0, 1.0]));
        let [first, last] = places.map(|place| open.of(place));
        // The second position is rounded to the boundary, which is coordinate zero.
        assert_eq!(last[1], 0);
        // Each coordinate is rounded by itself.
        let steps = (8.0 * open.steps_per_length()).round() as i32;
        assert!((open.moved(last, first)[0] - steps).abs() <= 1);
        assert_eq!(open.moved([0, 1], [0, open.steps(1) as i32 - 1]), [0, 2]);
        assert!(open.is_near_seam(1, 1, 2) && open.is_near_seam(-1, 1, 2));
    }
}
