//! The mesh of the field loss.

use crate::vector::Vector;

/// A periodic mesh of `per_axisᴰ` nodes, the first at the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mesh<const D: usize> {
    /// Nodes along each axis.
    pub per_axis: usize,
    /// Side of the box.
    pub length: f64,
}

impl<const D: usize> Mesh<D> {
    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.per_axis.pow(D as u32)
    }

    /// Whether there is no node.
    pub fn is_empty(&self) -> bool {
        self.per_axis == 0
    }

    /// Coordinate of the nodes with an index along an axis.
    #[inline(always)]
    fn coordinate(&self, along: usize) -> f64 {
        along as f64 * self.length / self.per_axis as f64
    }

    /// Position of a node; the first axis varies fastest.
    pub fn node(&self, mut index: usize) -> Vector<f64, D> {
        Vector(std::array::from_fn(|_| {
            let along = index % self.per_axis;
            index /= self.per_axis;
            self.coordinate(along)
        }))
    }
}
