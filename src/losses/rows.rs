//! The nodes that particles touch, as rows of a mesh: no search, no list, whole registers.
//!
//! A mesh is regular, so the nodes within reach of a particle are a block, and each row of that block lies
//! consecutively in memory, at distances that are known. [`Rows`] finds the squares of all distances of a few
//! particles, packed without gaps, so that roots and kernels are evaluated in full registers; then whoever
//! gives to the nodes or takes from them walks the rows.

use super::Mesh;
use crate::kernel::{Kernel, Smoothing};
use crate::network::COUNT;
use crate::packed::Packed;
use crate::scalar::{Lanes, Pass, WIDTH, Wide, dispatch};
use crate::vector::Vector;
use std::ops::Range;

/// Squares that are found before their kernels are: enough that the first have reached memory when the
/// registers that they lie across are read.
const GROUP: usize = 512;

/// Ones in the first lanes, as many as the number says.
const MASKS: [Lanes; WIDTH + 1] = {
    let mut masks = [Lanes::ZERO; WIDTH + 1];
    let mut count = 0;
    while count <= WIDTH {
        let mut lane = 0;
        while lane < count {
            masks[count].set_lane(lane, 1.0);
            lane += 1;
        }
        count += 1;
    }
    masks
};

/// A mesh as particles of one reach touch it. Its rows carry their beginning again behind their end, so
/// that no row of nodes is cut at the seam of the box.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lattice<const D: usize> {
    /// Nodes along each axis.
    pub(super) per_axis: usize,
    /// Numbers in a row.
    pub(super) width: usize,
    /// Most nodes within reach along an axis.
    pub(super) most: usize,
    spacing: f64,
    inverse_spacing: f64,
    /// How far particles reach.
    reach: f64,
    /// The same along an axis: not farther than half the box, to the nearest image.
    along: f64,
}

/// The block of nodes around a place, axis by axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Block<const D: usize> {
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

    /// Rows in a plane, the nodes of one number along the last axis.
    pub(super) fn rows_per_plane(&self) -> usize {
        self.per_axis.pow(D as u32 - 2)
    }

    /// Number of the first node within reach along an axis.
    #[inline(always)]
    pub(super) fn first(&self, x: f64) -> usize {
        self.number(((x - self.along) * self.inverse_spacing).ceil())
    }

    /// The nodes whose coordinates are each within reach of a place.
    #[inline(always)]
    pub(super) fn block(&self, place: Vector<f64, D>) -> Block<D> {
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
}

/// Up to [`WIDTH`] consecutive nodes near a particle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row<const D: usize> {
    /// Place of the first among the numbers of a lattice.
    node: u32,
    /// Place of the first among the squares.
    entry: u32,
    count: u32,
    /// The first node less the particle's place.
    pub(super) apart: [f64; D],
}

impl<const D: usize> Row<D> {
    /// Place of the first node among the numbers of a lattice.
    #[inline(always)]
    pub(super) fn node(&self) -> usize {
        self.node as usize
    }
}

/// The rows of a few particles.
#[derive(Clone, Debug)]
pub(super) struct Rows<const D: usize> {
    lattice: Lattice<D>,
    rows: Vec<Row<D>>,
    /// Particles, and where the rows of each end.
    ends: Vec<(u32, u32)>,
    /// Squares of distances, without gaps; then `W`.
    squares: Vec<f64>,
    filled: usize,
    /// `G` where it is asked for.
    pulls: Vec<f64>,
}

impl<const D: usize> Rows<D> {
    pub(super) fn new(lattice: Lattice<D>) -> Self {
        let room = (GROUP + lattice.most.pow(D as u32) + WIDTH).next_multiple_of(WIDTH);
        let (squares, pulls) = (vec![0.0; room], vec![0.0; room]);
        Self { lattice, rows: Vec::new(), ends: Vec::new(), squares, filled: 0, pulls }
    }

    /// Adds the rows of particles that lie within some planes, whose nodes are numbered from the first on,
    /// as long as there is room; how many there was room for.
    pub(super) fn add(&mut self, packed: &[Packed], slots: &[u32], planes: &Range<usize>) -> usize {
        dispatch(FindPass { rows: self, packed, slots, planes: planes.clone() })
    }

    /// Whether there is no room for another particle.
    pub(super) fn is_full(&self) -> bool {
        self.filled >= GROUP
    }

    /// Forgets all rows.
    pub(super) fn clear(&mut self) {
        self.rows.clear();
        self.ends.clear();
        self.filled = 0;
    }

    /// `W` in place of the squares.
    pub(super) fn find_weights<K: Kernel>(&mut self, smoothing: &Smoothing<K, D>) {
        let Self { squares, filled, .. } = self;
        let whole = filled.next_multiple_of(WIDTH);
        dispatch(WeightPass { smoothing, squares: &mut squares[..whole], pulls: &mut [] });
    }

    /// The same, and `G`.
    pub(super) fn find_weights_and_pulls<K: Kernel>(&mut self, smoothing: &Smoothing<K, D>) {
        let Self { squares, filled, pulls, .. } = self;
        let whole = filled.next_multiple_of(WIDTH);
        let (squares, pulls) = (&mut squares[..whole], &mut pulls[..whole]);
        dispatch(WeightPass { smoothing, squares, pulls });
    }

    /// How many particles there are.
    #[inline(always)]
    pub(super) fn len(&self) -> usize {
        self.ends.len()
    }

    /// The `k`-th particle, and its rows.
    #[inline(always)]
    pub(super) fn of(&self, k: usize) -> (usize, &[Row<D>]) {
        let first = if k == 0 { 0 } else { self.ends[k - 1].1 };
        let (particle, end) = self.ends[k];
        (particle as usize, &self.rows[first as usize..end as usize])
    }

    /// `W` of the nodes of a row, zero behind them.
    #[inline(always)]
    pub(super) fn weights<W: Wide>(&self, row: &Row<D>) -> W {
        load_at::<W>(&self.squares, row.entry as usize) * W::load(&MASKS[row.count as usize])
    }

    /// `G` of the nodes of a row, zero behind them.
    #[inline(always)]
    pub(super) fn pulls<W: Wide>(&self, row: &Row<D>) -> W {
        load_at::<W>(&self.pulls, row.entry as usize) * W::load(&MASKS[row.count as usize])
    }

    /// How far along the row its nodes are from the particle.
    #[inline(always)]
    pub(super) fn along<W: Wide>(&self, row: &Row<D>) -> W {
        W::load(&COUNT) * self.lattice.spacing + row.apart[0]
    }
}

// Each of these is a pass of its own, so that its few numbers stay in registers.

/// See [`Rows::add`].
struct FindPass<'a, const D: usize> {
    rows: &'a mut Rows<D>,
    packed: &'a [Packed],
    slots: &'a [u32],
    planes: Range<usize>,
}

impl<const D: usize> Pass for FindPass<'_, D> {
    type Output = usize;

    #[inline(always)]
    fn run<W: Wide>(self) -> usize {
        let Self { rows, packed, slots, planes } = self;
        let lattice = rows.lattice;
        for (number, &slot) in slots.iter().enumerate() {
            if rows.filled >= GROUP {
                return number;
            }
            let block = lattice.block(Vector::from_3d(packed[slot as usize].position));
            let mut along = 0;
            while along < block.count[0] {
                rows.add_rows::<W>(&block, along, &planes);
                along += WIDTH;
            }
            rows.ends.push((slot, rows.rows.len() as u32));
        }
        slots.len()
    }
}

impl<const D: usize> Rows<D> {
    /// Adds a block's rows from some node on, [`WIDTH`] nodes at most, unless they pass out of reach.
    #[inline(always)]
    fn add_rows<W: Wide>(&mut self, block: &Block<D>, along: usize, planes: &Range<usize>) {
        let Lattice { per_axis, width, spacing, reach, .. } = self.lattice;
        let count = (block.count[0] - along).min(WIDTH);
        let first = block.first[0] + along;
        let mut apart = block.apart.0;
        apart[0] += along as f64 * spacing;
        let x = W::load(&COUNT) * spacing + apart[0];
        let squares = x * x;
        let mut filled = self.filled;
        // In 2D a plane is one row.
        let lines = if D == 2 { 1 } else { block.count[1] };
        for plane in 0..block.count[D - 1] {
            let number = wrap(block.first[D - 1] + plane, per_axis);
            if !planes.contains(&number) {
                continue;
            }
            apart[D - 1] = block.apart[D - 1] + plane as f64 * spacing;
            let plane_square = apart[D - 1] * apart[D - 1];
            for line in 0..lines {
                let (mut row, mut square) = (number - planes.start, plane_square);
                if D > 2 {
                    row = row * per_axis + wrap(block.first[1] + line, per_axis);
                    apart[1] = block.apart[1] + line as f64 * spacing;
                    square += apart[1] * apart[1];
                }
                if square < reach * reach {
                    store_at(&mut self.squares, filled, squares + square);
                    let (node, entry) = ((row * width + first) as u32, filled as u32);
                    self.rows.push(Row { node, entry, count: count as u32, apart });
                    filled += count;
                }
            }
        }
        self.filled = filled;
    }
}

/// Kernels of squares of distances, and their gradients where there is room for them.
struct WeightPass<'a, K, const D: usize> {
    smoothing: &'a Smoothing<K, D>,
    squares: &'a mut [f64],
    pulls: &'a mut [f64],
}

impl<K: Kernel, const D: usize> Pass for WeightPass<'_, K, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(self) {
        let Self { smoothing, squares, pulls } = self;
        let mut place = 0;
        while place < squares.len() {
            let r = load_at::<W>(squares, place).sqrt();
            store_at(squares, place, smoothing.value(r));
            if !pulls.is_empty() {
                store_at(pulls, place, smoothing.gradient(r));
            }
            place += WIDTH;
        }
    }
}

/// A number of a node brought back into the mesh, once around at most.
#[inline(always)]
fn wrap(number: usize, per_axis: usize) -> usize {
    if number >= per_axis { number - per_axis } else { number }
}

/// Eight numbers from a place on.
#[inline(always)]
pub(super) fn load_at<W: Wide>(column: &[f64], place: usize) -> W {
    let mut lanes = [0.0; WIDTH];
    lanes.copy_from_slice(&column[place..place + WIDTH]);
    W::load(&Lanes::new(lanes))
}

/// Eight numbers to a place.
#[inline(always)]
pub(super) fn store_at<W: Wide>(column: &mut [f64], place: usize, numbers: W) {
    column[place..place + WIDTH].copy_from_slice(&numbers.store().to_array());
}
