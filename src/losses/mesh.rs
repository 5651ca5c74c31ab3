//! The mesh of the field loss.

use crate::space::Space;
use crate::vector::Vector;

/// A mesh of nodes over a box, the first at the origin: periodic along periodic axes, and as long
/// as the side of the box along open ones.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mesh<const D: usize> {
    /// Nodes along each axis.
    pub per_axis: [usize; D],
    /// The box.
    pub space: Space,
}

impl<const D: usize> Mesh<D> {
    /// A mesh with this many nodes along the first axis, and as many along the others as their
    /// lengths have of the same spacing, rounded.
    pub fn over(space: Space, along_first: usize) -> Self {
        let share = |axis: usize| space.side(axis) / space.side(0);
        let count = |axis: usize| (along_first as f64 * share(axis)).round() as usize;
        let per_axis = std::array::from_fn(|axis| count(axis).max(usize::from(along_first > 0)));
        Self { per_axis, space }
    }

    /// A mesh with about as many nodes as there are particles.
    pub fn of_particles(space: Space, particles: usize) -> Self {
        let per_side = (particles as f64).powf(1.0 / D as f64);
        if space.is_periodic_cube::<D>() {
            return Self::over(space, per_side.round() as usize);
        }
        let mean_side = space.volume::<D>().powf(1.0 / D as f64);
        Self::over(space, (per_side * space.side(0) / mean_side).round() as usize)
    }

    /// A mesh of a periodic cube.
    pub fn cube(length: f64, per_axis: usize) -> Self {
        Self { per_axis: [per_axis; D], space: Space::cube(length) }
    }

    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.per_axis.iter().product()
    }

    /// Whether there is no node.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Distance of nodes along an axis.
    pub fn spacing(&self, axis: usize) -> f64 {
        self.space.side(axis) / self.per_axis[axis] as f64
    }

    /// Number of nodes between neighbours along an axis, in the order of nodes.
    pub fn stride(&self, axis: usize) -> usize {
        self.per_axis[..axis].iter().product()
    }

    /// Coordinate of the nodes with an index along an axis.
    #[inline(always)]
    fn coordinate(&self, along: usize, axis: usize) -> f64 {
        along as f64 * self.space.side(axis) / self.per_axis[axis] as f64
    }

    /// Position of a node; the first axis varies fastest.
    pub fn node(&self, mut index: usize) -> Vector<f64, D> {
        Vector(std::array::from_fn(|axis| {
            let along = index % self.per_axis[axis];
            index /= self.per_axis[axis];
            self.coordinate(along, axis)
        }))
    }
}
