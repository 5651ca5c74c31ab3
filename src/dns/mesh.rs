//! Between wave vectors and the nodes of the mesh, through the caches slab by slab.
//!
//! A field is transformed along its last axis first, line by line; a slab then gathers its share of all
//! lines and does the other axes, whose data (some hundred KiB) stay in the second cache, and sixteen rows at
//! a time what is asked of the nodes, in the first cache. Nodal values never pass through memory unless they
//! are asked for. Only wave vectors that are kept are transformed: lines that are zero are left out.

use super::complex::{Complex, ComplexF64x8};
use super::fft::{Buffers, Fft};
use super::layout::{Layout, ROWS};
use super::pool::Pool;
use super::rows::{self, tile};
use crate::error::{Error, Result};
use crate::scalar::{F64x8, SimdFloat, SimdTask, WIDTH, dispatch};
use rayon::prelude::*;

/// What is done at the nodes of sixteen rows.
pub(super) trait Nodes: Sync {
    /// What each slab gives or gets besides.
    type Side: Send;
    /// Fields that are there as modes before.
    const IN: usize;
    /// Fields that are there as modes after.
    const OUT: usize;

    /// From `values[..IN]` to `results[..OUT]`, see [`rows::to_nodes`] for their order; `place` is the slab and
    /// the first row within it.
    fn at<V: SimdFloat<Double = V>>(
        &self,
        place: [usize; 2],
        nodes: NodeRows<'_>,
        side: &mut Self::Side,
    );
}

/// Sixteen rows of each field.
pub(super) struct NodeRows<'a> {
    pub(super) values: &'a [Vec<ComplexF64x8>],
    pub(super) results: &'a mut [Vec<ComplexF64x8>],
}

/// A factor of each wave vector that is a product over axes, and even.
#[derive(Clone, Debug)]
pub(super) struct AxisFactors(pub(super) Vec<f64>);

/// Plans, and memory that lasts from pass to pass.
#[derive(Debug)]
pub(super) struct Mesh<const D: usize> {
    pub(super) layout: Layout<D>,
    fft: Fft,
    /// After the last axis: all nodes of field `c` of line `l` at `(l IN + c) pitch`.
    spread: Vec<ComplexF64x8>,
    /// After the slabs: of each slab all lines of each field, [`Layout::depth`] nodes each.
    gathered: Vec<ComplexF64x8>,
    pool: Pool<Scratch>,
}

/// Working memory of one task.
#[derive(Debug)]
struct Scratch {
    buffers: Buffers,
    /// Modes along x and nodes along y, before and after: all y of field `c` of block `b` at `(c blocks + b) n`.
    before: Vec<ComplexF64x8>,
    after: Vec<ComplexF64x8>,
    values: Vec<Vec<ComplexF64x8>>,
    results: Vec<Vec<ComplexF64x8>>,
}

/// Most fields that go through a slab: products of velocities in three dimensions.
const MOST: usize = 5;

impl<const D: usize> Mesh<D> {
    /// The plans of a mesh.
    ///
    /// # Errors
    /// [`Error::Input`] where the number of nodes is odd, below 8 or has a prime factor above 5.
    pub(super) fn new(layout: Layout<D>) -> Result<Self> {
        let nodes = layout.nodes;
        let refused = || {
            let expected = "an even number of nodes from 8 on without prime factors above 5";
            Error::input("dns.nodes", expected, nodes, "choose 32, 48, 64, 80, 96 or 128")
        };
        let fits = nodes >= 8 && nodes.is_multiple_of(2);
        let fft = Fft::new(nodes).filter(|_| fits).ok_or_else(refused)?;
        let spread = vec![ComplexF64x8::ZERO; layout.lines() * D * pitch(nodes)];
        let most = if D == 3 { MOST } else { 2 };
        let gathered =
            vec![ComplexF64x8::ZERO; layout.slabs() * most * layout.lines() * layout.depth()];
        let pool = Pool::new(|| Scratch::new(&layout));
        Ok(Self { layout, fft, spread, gathered, pool })
    }

    /// The last axis, wave vectors to nodes; `fields` is how many of them a line has.
    pub(super) fn spread(
        &mut self,
        modes: &[ComplexF64x8],
        fields: usize,
        factors: Option<&AxisFactors>,
    ) {
        let Self { layout, fft, spread, pool, .. } = self;
        let lines = spread.par_chunks_mut(fields * pitch(layout.nodes));
        let lines = lines.zip(modes.par_chunks(fields * layout.along)).enumerate();
        lines.for_each(|(line, (into, modes))| {
            pool.with(
                || Scratch::new(layout),
                |scratch| {
                    let buffers = &mut scratch.buffers;
                    dispatch(Spread { layout, fft, line, modes, factors, into, buffers });
                },
            );
        });
    }

    /// The other axes there, what is asked of the nodes, and back. `sides` has one entry for each slab.
    pub(super) fn slabs<N: Nodes>(
        &mut self,
        nodes: &N,
        sides: impl IndexedParallelIterator<Item = N::Side>,
    ) {
        let Self { layout, fft, spread, gathered, pool } = self;
        let size = (N::OUT * layout.lines() * layout.depth()).max(1);
        let slabs = gathered.par_chunks_mut(size).zip(sides).enumerate();
        slabs.for_each(|(slab, (into, mut side))| {
            let side = &mut side;
            let (layout, fft, spread) = (&*layout, &*fft, &spread[..]);
            pool.with(
                || Scratch::new(layout),
                |scratch| dispatch(Slab { layout, fft, spread, slab, nodes, into, side, scratch }),
            );
        });
    }

    /// The last axis back: all modes of one of `fields` fields of a line.
    #[inline(always)]
    pub(super) fn gather<V: SimdFloat<Double = V>>(
        &self,
        (line, field, fields): (usize, usize, usize),
        buffers: &mut Buffers,
        into: &mut [ComplexF64x8],
    ) {
        let layout = &self.layout;
        let depth = layout.depth();
        let slab = fields * layout.lines() * depth;
        let place = (field * layout.lines() + line) * depth;
        for (node, eight) in buffers.front.iter_mut().enumerate() {
            *eight = self.gathered[node / depth * slab + place + node % depth];
        }
        self.fft.run::<V, false>(buffers);
        for (outer, eight) in into.iter_mut().enumerate() {
            *eight = buffers.front[layout.on_mesh(outer)];
        }
    }
}

/// Blocks of eight numbers from line to line: a power of two would put all lines of a slab into the same corner of the cache.
fn pitch(nodes: usize) -> usize {
    nodes + 1
}

impl Scratch {
    fn new<const D: usize>(layout: &Layout<D>) -> Self {
        let (n, most) = (layout.nodes, if D == 3 { MOST } else { 2 });
        let plane = if D == 3 { layout.blocks * n } else { 0 };
        Self {
            buffers: Buffers::new(n),
            before: vec![ComplexF64x8::ZERO; D * plane],
            after: vec![ComplexF64x8::ZERO; most * plane],
            values: vec![vec![ComplexF64x8::ZERO; n]; D],
            results: vec![vec![ComplexF64x8::ZERO; n]; most],
        }
    }
}

/// [`Mesh::spread`] of one line.
struct Spread<'a, const D: usize> {
    layout: &'a Layout<D>,
    fft: &'a Fft,
    line: usize,
    modes: &'a [ComplexF64x8],
    factors: Option<&'a AxisFactors>,
    into: &'a mut [ComplexF64x8],
    buffers: &'a mut Buffers,
}

impl<const D: usize> SimdTask for Spread<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Self { layout, fft, line, modes, factors, into, buffers } = self;
        let n = layout.nodes;
        let fields = modes.chunks_exact(layout.along).zip(into.chunks_exact_mut(pitch(n)));
        for (modes, into) in fields {
            for eight in &mut buffers.front[layout.largest + 1..n - layout.largest] {
                *eight = ComplexF64x8::ZERO;
            }
            for (outer, eight) in modes.iter().enumerate() {
                let loaded = Complex::<W::Double>::load(eight);
                let factor =
                    factors.map(|factors| factors.factor::<W::Double, D>(layout, line, outer));
                let found = factor.map_or(loaded, |factor| loaded.scaled(factor));
                buffers.front[layout.on_mesh(outer)] = found.store();
            }
            fft.run::<W::Double, true>(buffers);
            into[..n].copy_from_slice(&buffers.front);
        }
    }
}

impl AxisFactors {
    /// The factors of one block of eight.
    #[inline(always)]
    pub(super) fn factor<V: SimdFloat, const D: usize>(
        &self,
        layout: &Layout<D>,
        line: usize,
        outer: usize,
    ) -> V {
        let block = line % layout.blocks;
        let mut along = [0.0; WIDTH];
        along.copy_from_slice(&self.0[block * WIDTH..][..WIDTH]);
        let at = |place: usize| self.0[layout.number(place).unsigned_abs() as usize];
        let middle = if D == 3 { at(line / layout.blocks) } else { 1.0 };
        V::load(&F64x8::new(along)) * V::of(middle * at(outer))
    }

    /// From the factor along one axis at each component of a wave vector from 0 on.
    pub(super) fn new<const D: usize>(layout: &Layout<D>, along: impl Fn(usize) -> f64) -> Self {
        Self((0..layout.blocks * WIDTH).map(along).collect())
    }
}

/// [`Mesh::slabs`] of one slab.
struct Slab<'a, N: Nodes, const D: usize> {
    layout: &'a Layout<D>,
    fft: &'a Fft,
    spread: &'a [ComplexF64x8],
    slab: usize,
    nodes: &'a N,
    into: &'a mut [ComplexF64x8],
    side: &'a mut N::Side,
    scratch: &'a mut Scratch,
}

impl<N: Nodes, const D: usize> SimdTask for Slab<'_, N, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(mut self) {
        if D == 3 {
            self.before::<W::Double>();
            for group in 0..self.layout.groups() {
                self.group::<W::Double>(group);
            }
            self.after::<W::Double>();
        } else {
            self.group::<W::Double>(self.slab);
        }
    }
}

impl<N: Nodes, const D: usize> Slab<'_, N, D> {
    /// Wave vectors to nodes along y.
    #[inline(always)]
    fn before<V: SimdFloat<Double = V>>(&mut self) {
        let Self { layout, scratch, .. } = self;
        let (n, largest, blocks) = (layout.nodes, layout.largest, layout.blocks);
        let Scratch { buffers, before, .. } = &mut **scratch;
        for (column, into) in before.chunks_exact_mut(n).take(N::IN * blocks).enumerate() {
            let (field, block) = (column / blocks, column % blocks);
            for eight in &mut buffers.front[largest + 1..n - largest] {
                *eight = ComplexF64x8::ZERO;
            }
            for middle in 0..layout.along {
                let line = middle * blocks + block;
                let from = (line * N::IN + field) * pitch(n) + self.slab;
                buffers.front[layout.on_mesh(middle)] = self.spread[from];
            }
            self.fft.run::<V, true>(buffers);
            into.copy_from_slice(&buffers.front);
        }
    }

    /// Sixteen rows: to nodes, what is asked of them, back.
    #[inline(always)]
    fn group<V: SimdFloat<Double = V>>(&mut self, group: usize) {
        let Self { layout, fft, spread, slab, nodes, into, side, scratch } = self;
        let (n, blocks, largest) = (layout.nodes, layout.blocks, layout.largest);
        let Scratch { buffers, before, after, values, results } = &mut **scratch;
        let rows = (group, n);
        for (field, values) in values.iter_mut().enumerate().take(N::IN) {
            let source = if D == 3 {
                (&before[..], tile(field * blocks * n + group * ROWS, n, rows, blocks))
            } else {
                let stride = N::IN * pitch(n);
                (&spread[..], tile(field * pitch(n) + group * ROWS, stride, rows, blocks))
            };
            rows::to_nodes::<V>(fft, largest, source, buffers);
            std::mem::swap(values, &mut buffers.front);
        }
        let place = [*slab, if D == 3 { group * ROWS } else { 0 }];
        nodes.at::<V>(place, NodeRows { values, results: &mut results[..] }, side);
        let factor = 1.0 / layout.node_count() as f64;
        for (field, results) in results.iter_mut().enumerate().take(N::OUT) {
            std::mem::swap(results, &mut buffers.front);
            let into = if D == 3 {
                (&mut after[..], tile(field * blocks * n + group * ROWS, n, rows, blocks))
            } else {
                (&mut into[..], tile(field * blocks * ROWS, ROWS, rows, blocks))
            };
            rows::to_modes::<V>(fft, (largest, factor), buffers, into);
        }
    }

    /// Nodes to wave vectors along y.
    #[inline(always)]
    fn after<V: SimdFloat<Double = V>>(&mut self) {
        let Self { layout, scratch, into, .. } = self;
        let (n, blocks) = (layout.nodes, layout.blocks);
        let Scratch { buffers, after, .. } = &mut **scratch;
        for (column, from) in after.chunks_exact(n).take(N::OUT * blocks).enumerate() {
            let (field, block) = (column / blocks, column % blocks);
            buffers.front.copy_from_slice(from);
            self.fft.run::<V, false>(buffers);
            for middle in 0..layout.along {
                let line = middle * blocks + block;
                into[field * layout.lines() + line] = buffers.front[layout.on_mesh(middle)];
            }
        }
    }
}
