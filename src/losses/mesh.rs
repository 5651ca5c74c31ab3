//! The mesh of the field loss, and its nodes near a place.

use crate::scalar::WIDTH;
use crate::space::PeriodicBox;
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

    /// Finds the nodes whose coordinates are each within `reach` of a place.
    #[inline(always)]
    pub(super) fn around(&self, place: Vector<f64, D>, reach: f64, near: &mut Nearby<D>) {
        let n = self.per_axis;
        let (spacing, space) = (self.length / n as f64, PeriodicBox { length: self.length });
        let mut stride = 1;
        for (&x, near) in place.0.iter().zip(&mut near.along) {
            let (first, last) = (((x - reach) / spacing).ceil(), ((x + reach) / spacing).floor());
            let count = ((last - first).max(-1.0) + 1.0).min(n as f64) as usize;
            let mut along = first.rem_euclid(n as f64) as usize % n;
            near.clear();
            for _ in 0..count {
                let Vector([apart]) = space.minimum_image(Vector([self.coordinate(along) - x]));
                near.push((stride * along, apart));
                along = if along + 1 == n { 0 } else { along + 1 };
            }
            stride *= n;
        }
        near.combine(reach);
    }

    /// Coordinate of the nodes of one number along an axis.
    #[inline(always)]
    fn coordinate(&self, along: usize) -> f64 {
        along as f64 * self.length / self.per_axis as f64
    }

    /// Position of a node; the first axis runs fastest.
    pub fn node(&self, mut index: usize) -> Vector<f64, D> {
        Vector(std::array::from_fn(|_| {
            let along = index % self.per_axis;
            index /= self.per_axis;
            self.coordinate(along)
        }))
    }
}

/// The nodes near a place.
pub(super) struct Nearby<const D: usize> {
    /// Axis by axis, what each number adds to that of a node, and how far it is along the axis.
    along: [Vec<(usize, f64)>; D],
    /// Nodes, filled up to whole lanes with the first of all, far away.
    pub(super) nodes: Vec<usize>,
    /// How far they are, axis by axis.
    pub(super) apart: [Vec<f64>; D],
}

impl<const D: usize> Nearby<D> {
    /// No nodes.
    pub(super) fn new() -> Self {
        let (along, apart) = (std::array::from_fn(|_| vec![]), std::array::from_fn(|_| vec![]));
        Self { along, nodes: Vec::new(), apart }
    }

    /// Every node from its numbers along the axes, the first axis fastest; `far` fills up.
    #[inline(always)]
    fn combine(&mut self, far: f64) {
        let Self { along, nodes, apart } = self;
        nodes.clear();
        apart.iter_mut().for_each(Vec::clear);
        let mut choice = [0; D];
        for _ in 0..along.iter().map(Vec::len).product() {
            let mut node = 0;
            for axis in 0..D {
                let (share, distance) = along[axis][choice[axis]];
                node += share;
                apart[axis].push(distance);
            }
            nodes.push(node);
            for (choice, along) in choice.iter_mut().zip(&*along) {
                *choice += 1;
                if *choice < along.len() {
                    break;
                }
                *choice = 0;
            }
        }
        let whole = nodes.len().next_multiple_of(WIDTH);
        nodes.resize(whole, 0);
        apart.iter_mut().for_each(|apart| apart.resize(whole, far));
    }
}
