//! The nodes of a mesh in reach of a particle, in whole registers, without a search or a list.
//!
//! A mesh is regular, so that the nodes in reach of a particle form a block at known distances.
//! Each row of the block is contiguous in memory and short: a register holds four nodes of each of
//! two rows, or eight of one. Kernels are evaluated on the fly, and nothing is stored.

use super::Mesh;
use crate::scalar::{F64x8, SimdFloat, WIDTH};
use crate::vector::Vector;

/// Number of nodes that are contiguous in memory, minimum: half of a register.
pub(super) const HALF: usize = WIDTH / 2;

/// Square of a distance at which every kernel is zero, in squared reaches.
const FAR: f64 = 16.0;

/// Lanes with the value `below` in the first `count` of each `width` lanes, and `from` in the
/// others.
const fn lanes_of(count: usize, (below, from): (f64, f64), width: usize) -> F64x8 {
    let (mut lanes, mut lane) = (F64x8::ZERO, 0);
    while lane < WIDTH {
        lanes.set_lane(lane, if lane % width < count { below } else { from });
        lane += 1;
    }
    lanes
}

/// `far_beyond(width)[n]`: offsets of squared distances that disable all lanes but the first `n` of
/// each row of `width` lanes, by adding [`FAR`] to the others.
const fn far_beyond(width: usize) -> [F64x8; WIDTH + 1] {
    let mut far = [F64x8::ZERO; WIDTH + 1];
    let mut count = 0;
    while count <= WIDTH {
        far[count] = lanes_of(count, (0.0, FAR), width);
        count += 1;
    }
    far
}

/// The arrangement of a register's lanes on the mesh.
struct Layout {
    /// Each lane's offset along its row, in nodes.
    along: F64x8,
    /// Each lane's offset across rows.
    across: F64x8,
    /// See [`far_beyond`].
    far: [F64x8; WIDTH + 1],
    /// Number of rows.
    rows: usize,
}

/// Eight nodes of a row.
const ONE_ROW: Layout = Layout {
    along: F64x8::new([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]),
    across: F64x8::ZERO,
    far: far_beyond(WIDTH),
    rows: 1,
};

/// Four nodes of two rows each.
const TWO_ROWS: Layout = Layout {
    along: F64x8::new([0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0]),
    across: lanes_of(HALF, (0.0, 1.0), WIDTH),
    far: far_beyond(HALF),
    rows: 2,
};

/// The operation of a particle on the nodes in its reach.
pub(super) trait Meet<W: SimdFloat, const D: usize> {
    /// Processes eight nodes. `places` are the indices of their first and second [`HALF`] in the
    /// columns of a lattice, `apart` their positions minus the particle's, and `square` the squared
    /// distances, beyond every kernel in lanes without a node.
    fn meet(&mut self, places: [usize; 2], apart: &Vector<W, D>, square: W);
}

/// A periodically padded mesh, for particles of one reach. Each row is continued past its end, and
/// so are the planes beyond the periodic boundary, so that every block of nodes is contiguous.
#[derive(Clone, Copy, Debug)]
pub(super) struct PaddedGrid<const D: usize> {
    /// Nodes along each axis.
    pub(super) per_axis: usize,
    /// Length of a padded row.
    pub(super) width: usize,
    /// Nodes in reach of a particle along an axis, maximum.
    most: usize,
    spacing: f64,
    inverse_spacing: f64,
    /// Reach of a particle.
    reach: f64,
    /// The reach along an axis: at most half the box, because of the nearest image.
    along: f64,
}

/// The block of nodes in reach of a place, axis by axis.
#[derive(Clone, Copy, Debug)]
struct Block<const D: usize> {
    /// Index of the first node.
    first: [usize; D],
    /// Number of nodes.
    count: [usize; D],
    /// Position of the first node minus the place.
    apart: Vector<f64, D>,
}

impl<const D: usize> PaddedGrid<D> {
    pub(super) fn new(mesh: &Mesh<D>, reach: f64) -> Self {
        let (per_axis, spacing) = (mesh.per_axis, mesh.length / mesh.per_axis as f64);
        let (along, inverse_spacing) = (reach.min(0.5 * mesh.length), 1.0 / spacing);
        let most = ((2.0 * along * inverse_spacing) as usize + 2).min(per_axis);
        let width = per_axis + most.next_multiple_of(WIDTH);
        Self { per_axis, width, most, spacing, inverse_spacing, reach, along }
    }

    /// Numbers in a plane of padded rows, that is, at one index along the last axis.
    pub(super) fn numbers_per_plane(&self) -> usize {
        self.per_axis.pow(D as u32 - 2) * self.width
    }

    /// Number of planes in reach of particles with `firsts` consecutive first planes, plus one.
    pub(super) fn planes(&self, firsts: usize) -> usize {
        firsts + self.most
    }

    /// Index of the first node in reach along an axis.
    #[inline(always)]
    pub(super) fn first(&self, x: f64) -> usize {
        self.number(((x - self.along) * self.inverse_spacing).ceil())
    }

    /// The nodes with each coordinate in reach of a place.
    #[inline(always)]
    fn block(&self, place: Vector<f64, D>) -> Block<D> {
        let mut block = Block { first: [0; D], count: [0; D], apart: Vector::zero() };
        for axis in 0..D {
            let x = place[axis];
            let first = ((x - self.along) * self.inverse_spacing).ceil();
            let last = ((x + self.along) * self.inverse_spacing).floor();
            // A position that is NaN has an empty block.
            block.count[axis] = ((last - first + 1.0) as usize).min(self.most);
            block.apart[axis] = first * self.spacing - x;
            block.first[axis] = self.number(first);
        }
        block
    }

    /// The index of a node, brought back across the periodic boundary.
    #[inline(always)]
    fn number(&self, counted: f64) -> usize {
        let (n, counted) = (self.per_axis as i64, counted as i64);
        if (0..n).contains(&counted) { counted as usize } else { counted.rem_euclid(n) as usize }
    }

    /// Processes all nodes in reach of a place; planes are counted from `plane`.
    #[inline(always)]
    pub(super) fn around<W: SimdFloat>(
        &self,
        place: Vector<f64, D>,
        plane: usize,
        particle: &mut impl Meet<W, D>,
    ) {
        let block = self.block(place);
        let narrow = block.count[0] <= HALF && self.per_axis > 1;
        let layout = if narrow { &TWO_ROWS } else { &ONE_ROW };
        let mut along = 0;
        while along < block.count[0] {
            let mut line = 0;
            while line < block.count[1] {
                self.meet_rows::<W>((&block, layout), (along, line), plane, particle);
                line += layout.rows;
            }
            along += WIDTH;
        }
    }

    /// Processes, for each plane of a block, the register at `along` nodes along the rows and
    /// `line` rows across.
    #[inline(always)]
    fn meet_rows<W: SimdFloat>(
        &self,
        (block, layout): (&Block<D>, &Layout),
        (along, line): (usize, usize),
        plane: usize,
        particle: &mut impl Meet<W, D>,
    ) {
        let Self { per_axis, width, spacing, reach, .. } = *self;
        let (far, across) = (reach * reach, W::load(&layout.across));
        let count = (block.count[0] - along).min(WIDTH);
        let mut apart = Vector::<W, D>::zero();
        apart[0] = (W::load(&layout.along) + along as f64) * spacing + block.apart[0];
        apart[1] = (across + line as f64) * spacing + block.apart[1];
        // The second row may lie outside of the block.
        let none = if line + layout.rows > block.count[1] { FAR * far } else { 0.0 };
        let flat = apart[0] * apart[0] + W::load(&layout.far[count]) * far;
        let flat = flat + apart[1] * apart[1] + across * none;
        let start = block.first[0] + along;
        if D == 2 {
            let place = (block.first[1] - plane + line) * width + start;
            let beside = if layout.rows == 2 { width } else { HALF };
            particle.meet([place, place + beside], &apart, flat);
            return;
        }
        let first = block.first[D - 1] - plane;
        let row = wrap(block.first[1] + line, per_axis);
        let mut place = (first * per_axis + row) * width + start;
        let mut beside = place + HALF;
        if layout.rows == 2 {
            let row = wrap(block.first[1] + line + 1, per_axis);
            beside = (first * per_axis + row) * width + start;
        }
        for plane in 0..block.count[D - 1] {
            apart[D - 1] = W::of(block.apart[D - 1] + plane as f64 * spacing);
            particle.meet([place, beside], &apart, flat + apart[D - 1] * apart[D - 1]);
            place += per_axis * width;
            beside += per_axis * width;
        }
    }
}

/// Brings the index of a node back into the mesh; it may be at most one period too large.
#[inline(always)]
fn wrap(number: usize, per_axis: usize) -> usize {
    if number >= per_axis { number - per_axis } else { number }
}

/// Loads the numbers of eight nodes.
#[inline(always)]
pub(super) fn load_at<W: SimdFloat>(column: &[f64], [first, second]: [usize; 2]) -> W {
    let mut lanes = [0.0; WIDTH];
    lanes[..HALF].copy_from_slice(&column[first..first + HALF]);
    lanes[HALF..].copy_from_slice(&column[second..second + HALF]);
    W::load(&F64x8::new(lanes))
}

/// Stores them.
#[inline(always)]
pub(super) fn store_at<W: SimdFloat>(column: &mut [f64], [first, second]: [usize; 2], numbers: W) {
    let lanes = numbers.store().to_array();
    column[first..first + HALF].copy_from_slice(&lanes[..HALF]);
    column[second..second + HALF].copy_from_slice(&lanes[HALF..]);
}
