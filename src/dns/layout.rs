//! Which wave vectors are kept, and where.

use crate::scalar::{F64x8, WIDTH};
use serde::{Deserialize, Serialize};

/// Rows of the mesh that are transformed together along x: two real rows as one complex one, eight times.
pub(super) const ROWS: usize = 2 * WIDTH;

/// Which wave vectors a mesh keeps; with either, no product of two of them falls back on one of them (2/3 rule).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Truncation {
    /// All with `|nᵢ| < nodes/3` along each axis (default): nearly twice as many as in the sphere of three dimensions
    /// at the same price. Other programs mostly do this.
    #[default]
    Cube,
    /// Those with `|n| < nodes/3`: the same in every direction.
    Sphere,
}

/// The wave vectors `n` that a mesh keeps, and their order in memory.
///
/// Real fields have `û(−n)` conjugate to `û(n)`: only `n_x >= 0` is kept, eight in a
/// block of memory. A *line* is all blocks of eight that differ by the last axis alone (z, or y in two
/// dimensions), a *slab* what is transformed along the other axes in one go: a plane of nodes, or
/// sixteen rows of it in two dimensions.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout<const D: usize> {
    /// Nodes along each axis.
    pub nodes: usize,
    /// Side `L` of the box.
    pub length: f64,
    /// Largest component of a wave vector.
    pub largest: usize,
    /// `|n|²` from which on wave vectors are left out.
    pub(super) limit: f64,
    /// Components along any axis but the first, `2 largest + 1`.
    pub(super) along: usize,
    /// Blocks of eight along x.
    pub(super) blocks: usize,
    /// Components along y of three dimensions; 1 in two.
    pub(super) middles: usize,
}

/// Where one wave vector is kept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Slot {
    pub(super) line: usize,
    pub(super) outer: usize,
    pub(super) lane: usize,
}

impl<const D: usize> Layout<D> {
    /// The layout of a mesh.
    pub fn new(nodes: usize, length: f64, truncation: Truncation) -> Self {
        let largest = nodes.saturating_sub(1) / 3;
        let along = 2 * largest + 1;
        let blocks = (largest + 1).div_ceil(WIDTH);
        let middles = if D == 3 { along } else { 1 };
        let limit = match truncation {
            Truncation::Cube => f64::INFINITY,
            Truncation::Sphere => (nodes * nodes) as f64 / 9.0,
        };
        Self { nodes, length, largest, limit, along, blocks, middles }
    }

    /// `2π/L`.
    pub fn wave_number(&self) -> f64 {
        std::f64::consts::TAU / self.length
    }

    /// Number of nodes.
    pub fn node_count(&self) -> usize {
        self.nodes.pow(D as u32)
    }

    /// Memory of a solver and its tracers' splines in bytes: three fields of coefficients, two of half-transformed data,
    /// and the coefficients of the splines.
    pub fn bytes(&self) -> f64 {
        let fields = if D == 3 { 5 } else { 2 };
        let modes = 3 * D * self.eights() + D * self.lines() * (self.nodes + 1);
        let gathered = self.slabs() * fields * self.lines() * self.depth();
        (128 * (modes + gathered)) as f64 + (8 * D * self.node_count()) as f64
    }

    pub(super) fn lines(&self) -> usize {
        self.middles * self.blocks
    }

    /// Blocks of eight of one component of one field.
    pub(super) fn eights(&self) -> usize {
        self.lines() * self.along
    }

    pub(super) fn slabs(&self) -> usize {
        if D == 3 { self.nodes } else { self.groups() }
    }

    /// Groups of [`ROWS`] rows in a plane.
    pub(super) fn groups(&self) -> usize {
        self.nodes.div_ceil(ROWS)
    }

    /// Nodes along the last axis in a slab.
    pub(super) fn depth(&self) -> usize {
        if D == 3 { 1 } else { ROWS }
    }

    /// Nodes in a slab that is whole.
    pub(super) fn slab_nodes(&self) -> usize {
        if D == 3 { self.nodes * self.nodes } else { ROWS * self.nodes }
    }

    /// The component of a wave vector at a place along an axis: 0, 1, …, −2, −1.
    #[inline(always)]
    pub(super) fn number(&self, place: usize) -> i32 {
        if place <= self.largest { place as i32 } else { place as i32 - self.along as i32 }
    }

    /// The place of a component.
    fn place(&self, number: i32) -> usize {
        if number >= 0 { number as usize } else { (number + self.along as i32) as usize }
    }

    /// The place of a component among all that the mesh tells apart.
    #[inline(always)]
    pub(super) fn on_mesh(&self, place: usize) -> usize {
        if place <= self.largest { place } else { place + self.nodes - self.along }
    }

    /// Components along x of one block.
    #[inline(always)]
    pub(super) fn along_x(&self, block: usize) -> F64x8 {
        let mut all = [0.0; WIDTH];
        for (lane, n) in all.iter_mut().enumerate() {
            *n = (block * WIDTH + lane) as f64;
        }
        F64x8::new(all)
    }

    /// Block and component along y (0 in two dimensions) of a line.
    #[inline(always)]
    pub(super) fn of_line(&self, line: usize) -> (usize, f64) {
        (line % self.blocks, f64::from(self.number(line / self.blocks)))
    }

    /// The wave vector of a slot.
    pub(super) fn vector(&self, slot: Slot) -> [i32; 3] {
        let x = (slot.line % self.blocks * WIDTH + slot.lane) as i32;
        let (middle, outer) = (self.number(slot.line / self.blocks), self.number(slot.outer));
        if D == 3 { [x, middle, outer] } else { [x, outer, 0] }
    }

    /// Whether a wave vector is kept.
    pub(super) fn keeps(&self, n: [i32; 3]) -> bool {
        let square: f64 = n.iter().map(|&n| f64::from(n) * f64::from(n)).sum();
        n.iter().all(|n| n.unsigned_abs() as usize <= self.largest) && square < self.limit
    }

    /// Where a wave vector with `n_x >= 0` is kept.
    pub(super) fn slot(&self, [x, y, z]: [i32; 3]) -> Slot {
        let (middle, outer) = if D == 3 { (y, z) } else { (0, y) };
        let x = x as usize;
        let line = self.place(middle) * self.blocks + x / WIDTH;
        Slot { line, outer: self.place(outer), lane: x % WIDTH }
    }

    /// All slots of wave vectors that are kept, in the order of memory.
    pub(super) fn slots(&self) -> impl Iterator<Item = (Slot, [i32; 3])> + '_ {
        let outers = (0..self.lines()).flat_map(|line| (0..self.along).map(move |o| (line, o)));
        let all =
            outers.flat_map(|(line, outer)| (0..WIDTH).map(move |lane| Slot { line, outer, lane }));
        all.map(|slot| (slot, self.vector(slot))).filter(|&(_, n)| self.keeps(n))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn every_vector_has_its_slot<const D: usize>() {
        let both = [Truncation::Cube, Truncation::Sphere];
        for (nodes, truncation) in [12, 16, 30].into_iter().flat_map(|n| both.map(|t| (n, t))) {
            let layout = Layout::<D>::new(nodes, 1.0, truncation);
            let mut count = 0;
            for (slot, n) in layout.slots() {
                assert_eq!(layout.slot(n), slot);
                count += if n[0] == 0 { 1 } else { 2 };
            }
            let reach = nodes as i32;
            let deep = if D == 3 { reach } else { 0 };
            let columns = (-deep..=deep).flat_map(|z| (-reach..=reach).map(move |y| (y, z)));
            let all = columns.flat_map(|(y, z)| (-reach..=reach).map(move |x| [x, y, z]));
            assert_eq!(all.filter(|&n| layout.keeps(n)).count(), count);
        }
    }

    #[test]
    fn every_wave_vector_that_is_kept_has_one_slot() {
        every_vector_has_its_slot::<2>();
        every_vector_has_its_slot::<3>();
    }
}
