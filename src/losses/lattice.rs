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

/// A padded mesh, for particles of one reach. Each row is continued past its end, and so are the
/// planes beyond the periodic boundary, so that every block of nodes is contiguous. Along an open
/// axis a block ends where the mesh does.
#[derive(Clone, Copy, Debug)]
pub(super) struct PaddedGrid<const D: usize> {
    /// Nodes along each axis.
    pub(super) per_axis: [usize; D],
    /// Length of a padded row.
    pub(super) width: usize,
    /// Nodes in reach of a particle along each axis, maximum.
    most: [usize; D],
    spacing: [f64; D],
    inverse_spacing: [f64; D],
    /// Reach of a particle.
    reach: f64,
    /// The reach along each axis: at most half a period, because of the nearest image.
    along: [f64; D],
    is_periodic: [bool; D],
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
        let (mut along, mut most) = ([reach; D], [0; D]);
        let per_axis = mesh.per_axis;
        let spacing: [f64; D] = std::array::from_fn(|axis| mesh.spacing(axis));
        let inverse_spacing = spacing.map(|spacing| 1.0 / spacing);
        let is_periodic = std::array::from_fn(|axis| mesh.space.is_periodic(axis));
        for axis in 0..D {
            if is_periodic[axis] {
                along[axis] = reach.min(0.5 * mesh.space.side(axis));
            }
            let nodes = (2.0 * along[axis] * inverse_spacing[axis]) as usize + 2;
            most[axis] = nodes.min(per_axis[axis]);
        }
        let width = per_axis[0] + most[0].next_multiple_of(WIDTH);
        Self { per_axis, width, most, spacing, inverse_spacing, reach, along, is_periodic }
    }

    /// Numbers in a plane of padded rows, that is, at one index along the last axis.
    pub(super) fn numbers_per_plane(&self) -> usize {
        self.per_axis[1..D - 1].iter().product::<usize>() * self.width
    }

    /// Number of planes in reach of particles with `firsts` consecutive first planes, plus one.
    pub(super) fn planes(&self, firsts: usize) -> usize {
        firsts + self.most[D - 1]
    }

    /// Index of the first plane in reach of a particle at this coordinate along the last axis.
    #[inline(always)]
    pub(super) fn first(&self, x: f64) -> usize {
        let first = (x - self.along[D - 1]) * self.inverse_spacing[D - 1];
        self.number(first.ceil(), D - 1)
    }

    /// The nodes with each coordinate in reach of a place.
    #[inline(always)]
    fn block(&self, place: Vector<f64, D>) -> Block<D> {
        let mut block = Block { first: [0; D], count: [0; D], apart: Vector::zero() };
        for axis in 0..D {
            let x = place[axis];
            let (along, inverse) = (self.along[axis], self.inverse_spacing[axis]);
            let mut first = ((x - along) * inverse).ceil();
            let mut last = ((x + along) * inverse).floor();
            if !self.is_periodic[axis] {
                first = first.max(0.0);
                last = last.min((self.per_axis[axis] - 1) as f64);
            }
            // A position that is NaN has an empty block, and so has one beyond an open mesh.
            block.count[axis] = ((last - first + 1.0) as usize).min(self.most[axis]);
            block.apart[axis] = first * self.spacing[axis] - x;
            block.first[axis] = self.number(first, axis);
        }
        block
    }

    /// The index of a node, brought back across the periodic boundary, or to the end of an open
    /// mesh.
    #[inline(always)]
    fn number(&self, counted: f64, axis: usize) -> usize {
        let (n, counted) = (self.per_axis[axis] as i64, counted as i64);
        if (0..n).contains(&counted) {
            counted as usize
        } else if self.is_periodic[axis] {
            counted.rem_euclid(n) as usize
        } else {
            counted.clamp(0, n - 1) as usize
        }
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
        let narrow = block.count[0] <= HALF && self.per_axis[1] > 1;
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
        apart[0] = (W::load(&layout.along) + along as f64) * spacing[0] + block.apart[0];
        apart[1] = (across + line as f64) * spacing[1] + block.apart[1];
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
        let rows = per_axis[1];
        let row = wrap(block.first[1] + line, rows);
        let mut place = (first * rows + row) * width + start;
        let mut beside = place + HALF;
        if layout.rows == 2 {
            let row = wrap(block.first[1] + line + 1, rows);
            beside = (first * rows + row) * width + start;
        }
        for plane in 0..block.count[D - 1] {
            apart[D - 1] = W::of(block.apart[D - 1] + plane as f64 * spacing[D - 1]);
            particle.meet([place, beside], &apart, flat + apart[D - 1] * apart[D - 1]);
            place += rows * width;
            beside += rows * width;
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
