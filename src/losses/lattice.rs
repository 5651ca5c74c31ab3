//! The nodes that particles touch: no search, no list, whole registers.
//!
//! A mesh is regular, so the nodes within reach of a particle are a block, whose distances are known. Each row of
//! the block lies consecutively in memory and is short: a register holds four nodes of two rows, or eight of
//! one. Kernels are evaluated where the nodes are met, and nothing is kept.

use super::Mesh;
use crate::scalar::{Lanes, WIDTH, Wide};
use crate::vector::Vector;

/// Nodes that lie together in memory: half of a register.
pub(super) const HALF: usize = WIDTH / 2;

/// A square of a distance at which every kernel has ended, in squares of the reach.
const FAR: f64 = 16.0;

/// Lanes by number.
const fn lanes_of(count: usize, (below, from): (f64, f64), width: usize) -> Lanes {
    let (mut lanes, mut lane) = (Lanes::ZERO, 0);
    while lane < WIDTH {
        lanes.set_lane(lane, if lane % width < count { below } else { from });
        lane += 1;
    }
    lanes
}

/// [`FAR`] in all lanes but the first of each row, as many as the number says, of rows of some width.
const fn far_beyond(width: usize) -> [Lanes; WIDTH + 1] {
    let mut far = [Lanes::ZERO; WIDTH + 1];
    let mut count = 0;
    while count <= WIDTH {
        far[count] = lanes_of(count, (0.0, FAR), width);
        count += 1;
    }
    far
}

/// How the lanes of a register lie on the mesh.
struct Layout {
    /// How many nodes along its row each is behind the first.
    along: Lanes,
    /// How many rows.
    across: Lanes,
    /// See [`far_beyond`].
    far: [Lanes; WIDTH + 1],
    /// Rows in all.
    rows: usize,
}

/// Eight nodes of a row.
const ONE_ROW: Layout = Layout {
    along: Lanes::new([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]),
    across: Lanes::ZERO,
    far: far_beyond(WIDTH),
    rows: 1,
};

/// Four nodes of two rows each.
const TWO_ROWS: Layout = Layout {
    along: Lanes::new([0.0, 1.0, 2.0, 3.0, 0.0, 1.0, 2.0, 3.0]),
    across: lanes_of(HALF, (0.0, 1.0), WIDTH),
    far: far_beyond(HALF),
    rows: 2,
};

/// What a particle does with the nodes that it touches.
pub(super) trait Meet<W: Wide, const D: usize> {
    /// Meets eight nodes: the places of their first and second [`HALF`] among the numbers of a lattice, their
    /// positions less the particle's, and the squares of their distances, beyond every kernel where a lane
    /// has no node.
    fn meet(&mut self, places: [usize; 2], apart: &Vector<W, D>, square: W);
}

/// A mesh as particles of one reach touch it. Its rows carry their beginning again behind their end, and
/// planes follow each other beyond the seam of the box, so that no block of nodes is cut there.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lattice<const D: usize> {
    /// Nodes along each axis.
    pub(super) per_axis: usize,
    /// Numbers in a row.
    pub(super) width: usize,
    /// Most nodes within reach along an axis.
    most: usize,
    spacing: f64,
    inverse_spacing: f64,
    /// How far particles reach.
    reach: f64,
    /// The same along an axis: not farther than half the box, to the nearest image.
    along: f64,
}

/// The block of nodes around a place, axis by axis.
#[derive(Clone, Copy, Debug)]
struct Block<const D: usize> {
    /// Number of the first node.
    first: [usize; D],
    /// How many there are from there on.
    count: [usize; D],
    /// How far the first is from the place.
    apart: Vector<f64, D>,
}

impl<const D: usize> Lattice<D> {
    pub(super) fn new(mesh: &Mesh<D>, reach: f64) -> Self {
        let (per_axis, spacing) = (mesh.per_axis, mesh.length / mesh.per_axis as f64);
        let (along, inverse_spacing) = (reach.min(0.5 * mesh.length), 1.0 / spacing);
        let most = ((2.0 * along * inverse_spacing) as usize + 2).min(per_axis);
        let width = per_axis + most.next_multiple_of(WIDTH);
        Self { per_axis, width, most, spacing, inverse_spacing, reach, along }
    }

    /// Numbers in the rows of a plane, the nodes of one number along the last axis.
    pub(super) fn numbers_per_plane(&self) -> usize {
        self.per_axis.pow(D as u32 - 2) * self.width
    }

    /// Planes that particles touch whose first is one of so many, and one more.
    pub(super) fn planes(&self, firsts: usize) -> usize {
        firsts + self.most
    }

    /// Number of the first node within reach along an axis.
    #[inline(always)]
    pub(super) fn first(&self, x: f64) -> usize {
        self.number(((x - self.along) * self.inverse_spacing).ceil())
    }

    /// The nodes whose coordinates are each within reach of a place.
    #[inline(always)]
    fn block(&self, place: Vector<f64, D>) -> Block<D> {
        let mut block = Block { first: [0; D], count: [0; D], apart: Vector::zero() };
        for axis in 0..D {
            let x = place[axis];
            let first = ((x - self.along) * self.inverse_spacing).ceil();
            let last = ((x + self.along) * self.inverse_spacing).floor();
            // Nothing around a place that is none.
            block.count[axis] = ((last - first + 1.0) as usize).min(self.most);
            block.apart[axis] = first * self.spacing - x;
            block.first[axis] = self.number(first);
        }
        block
    }

    /// The number of a node that is counted on beyond the seam of the box.
    #[inline(always)]
    fn number(&self, counted: f64) -> usize {
        let (n, counted) = (self.per_axis as i64, counted as i64);
        if (0..n).contains(&counted) { counted as usize } else { counted.rem_euclid(n) as usize }
    }

    /// Meets all nodes within reach of a place; planes are counted from `plane` on.
    #[inline(always)]
    pub(super) fn around<W: Wide>(
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

    /// Meets the nodes of a block, some nodes along the rows and some rows on, in one register for each plane.
    #[inline(always)]
    fn meet_rows<W: Wide>(
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
        // A second row may be none.
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

/// A number of a node brought back into the mesh, once around at most.
#[inline(always)]
fn wrap(number: usize, per_axis: usize) -> usize {
    if number >= per_axis { number - per_axis } else { number }
}

/// The numbers of eight nodes.
#[inline(always)]
pub(super) fn load_at<W: Wide>(column: &[f64], [first, second]: [usize; 2]) -> W {
    let mut lanes = [0.0; WIDTH];
    lanes[..HALF].copy_from_slice(&column[first..first + HALF]);
    lanes[HALF..].copy_from_slice(&column[second..second + HALF]);
    W::load(&Lanes::new(lanes))
}

/// Puts them back.
#[inline(always)]
pub(super) fn store_at<W: Wide>(column: &mut [f64], [first, second]: [usize; 2], numbers: W) {
    let lanes = numbers.store().to_array();
    column[first..first + HALF].copy_from_slice(&lanes[..HALF]);
    column[second..second + HALF].copy_from_slice(&lanes[HALF..]);
}
