//! Eight neighbours at once: lists of neighbours, and how every pair loop reads them.

use crate::packed::{Packed, PackedAdjoint, PackedSingle};
use crate::scalar::{Pass, Precision, Scalar, WIDTH, Wide, dispatch};
use crate::space::PeriodicBox;
use crate::vector::Vector;

/// Particles per parallel task: fixed, so that no result depends on the number of threads.
pub const CHUNK: usize = 256;

/// Lines of so many bytes in all are in the cache when they are needed.
const FITS_CACHE: usize = 4 << 20;

/// Whose neighbours' lines are asked for while a particle meets its own: so many slots ahead.
pub const AHEAD: usize = 4;

/// The neighbours of [`CHUNK`] consecutive slots.
#[derive(Clone, Debug, Default)]
pub struct Chunk {
    /// First slot of the chunk.
    pub first: usize,
    /// Where each slot's neighbours start in `index`; one more at the end.
    start: Vec<u32>,
    /// Slots, filled up to whole lanes with the slot of nobody, `N`.
    index: Vec<u32>,
    /// How much of `index` is filled, while lists are built.
    filled: usize,
    /// Of each slot, whether some neighbour may be across the seam of the box.
    seam: Vec<bool>,
}

/// The box around a particle.
#[derive(Clone, Copy, Debug)]
pub struct Surroundings {
    /// The box.
    pub space: PeriodicBox,
    /// Whether differences to its neighbours need the nearest image.
    pub seam: bool,
}

impl Chunk {
    /// Number of slots.
    pub fn len(&self) -> usize {
        self.start.len().saturating_sub(1)
    }

    /// Whether the chunk has no slots.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        4 * (self.index.capacity() + self.start.capacity()) + self.seam.capacity()
    }

    /// The neighbours of the chunk's `k`-th slot, eight at a time.
    #[inline(always)]
    pub fn neighbours(&self, k: usize) -> &[[u32; WIDTH]] {
        self.index[self.start[k] as usize..self.start[k + 1] as usize].as_chunks().0
    }

    /// Forgets all lists.
    pub fn clear(&mut self) {
        self.start.clear();
        self.start.push(0);
        self.seam.clear();
        self.filled = 0;
    }

    /// Begins the list of a slot, of at most so many candidates: where it goes.
    #[inline(always)]
    pub fn open(&mut self, candidates: usize) -> &mut [u32] {
        self.make_room(self.filled + candidates + 4 * WIDTH);
        &mut self.index[self.filled..]
    }

    /// Adds the slots that were written to the front of what [`Self::open`] returned.
    #[inline(always)]
    pub fn fill(&mut self, slots: usize) {
        self.filled += slots;
    }

    /// How many slots all lists together have room for.
    pub fn room(&self) -> usize {
        self.index.len()
    }

    /// Makes room for so many slots in all lists, and for the lists of [`CHUNK`] slots.
    #[inline(always)]
    pub fn make_room(&mut self, slots: usize) {
        if self.index.len() < slots {
            self.index.resize(slots, 0);
            self.start.reserve((CHUNK + 1).saturating_sub(self.start.len()));
            self.seam.reserve(CHUNK.saturating_sub(self.seam.len()));
        }
    }

    /// The box around the chunk's `k`-th slot.
    #[inline(always)]
    pub fn around(&self, k: usize, space: PeriodicBox) -> Surroundings {
        Surroundings { space, seam: self.seam[k] }
    }

    /// Ends the list of a slot, with the slot of nobody, `nobody`, up to whole lanes; `seam` says whether
    /// a neighbour may be across the seam of the box, while the list is used.
    #[inline(always)]
    pub fn close(&mut self, nobody: usize, seam: bool) {
        self.seam.push(seam);
        let whole = self.filled.next_multiple_of(WIDTH);
        self.index[self.filled..whole].fill(nobody as u32);
        self.filled = whole;
        self.start.push(whole as u32);
    }

    /// Becomes the lists of `all` without those that are not in the masks of their eights.
    pub fn sift(&mut self, all: &Self, masks: &[u8], nobody: usize) {
        self.first = all.first;
        self.start.clone_from(&all.start);
        self.seam.clone_from(&all.seam);
        self.index.resize(all.index.len() + WIDTH, 0);
        dispatch(Sift { all, masks, nobody, near: self });
    }

    /// Ends all lists.
    pub fn finish(&mut self) {
        self.index.truncate(self.filled);
    }

    /// Number of eights in all lists.
    pub fn batches(&self) -> usize {
        self.index.len() / WIDTH
    }

    /// Makes masks for [`Self::batches`] eights.
    pub fn make_masks(&self, masks: &mut Vec<u8>) {
        masks.clear();
        masks.reserve_exact(self.batches());
        masks.resize(self.batches(), 0);
    }

    /// Most masks that there have been, or room for more.
    pub fn most_masks(&self) -> usize {
        self.index.capacity() / WIDTH
    }

    /// Place of the `k`-th slot's first eight among [`Self::batches`].
    #[inline(always)]
    pub fn first_batch(&self, k: usize) -> usize {
        self.start[k] as usize / WIDTH
    }

    /// The slot at a place in the lists.
    #[inline(always)]
    pub fn slot(&self, place: usize) -> usize {
        self.index[place] as usize
    }

    /// The slots at all places in the lists.
    pub fn slots(&self) -> &[u32] {
        &self.index
    }

    /// Becomes a copy of other lists. A first copy has just the room it needs; one that must grow takes a
    /// sixteenth more, so that it seldom does.
    pub fn copy_from(&mut self, other: &Self) {
        self.first = other.first;
        self.filled = other.filled;
        copy(&mut self.start, &other.start);
        copy(&mut self.seam, &other.seam);
        copy(&mut self.index, &other.index[..other.filled]);
    }

    /// Asks for the lines of the neighbours of the chunk's `k`-th slot, if it has one, where all lines do
    /// not fit the cache.
    #[inline(always)]
    pub fn fetch_ahead<W: Wide>(&self, k: usize, lines: &[W::Line]) {
        if size_of_val(lines) <= FITS_CACHE || k >= self.len() {
            return;
        }
        for &slot in self.neighbours(k).as_flattened() {
            if let Some(line) = lines.get(slot as usize) {
                W::fetch(line);
            }
        }
    }

    /// Appends the slots from `first` on that are in a mask of sixteen; within what [`Self::open`] has
    /// made room for.
    #[inline(always)]
    pub fn append_mask<W: Wide>(&mut self, mask: u16, first: usize) {
        if let Some(kept) = self.index[self.filled..].first_chunk_mut() {
            W::compress(mask, first as u32, kept);
        }
        self.filled += mask.count_ones() as usize;
    }
}

/// Copies the lists of a chunk as far as they are in masks.
struct Sift<'a> {
    all: &'a Chunk,
    masks: &'a [u8],
    nobody: usize,
    near: &'a mut Chunk,
}

impl Pass for Sift<'_> {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(self) {
        let Self { all, masks, nobody, near: Chunk { start, index, .. } } = self;
        let (nobody, mut filled) = ([nobody as u32; WIDTH], 0);
        for (k, end) in start.iter_mut().skip(1).enumerate() {
            let first = all.first_batch(k);
            for (slots, &mask) in all.neighbours(k).iter().zip(&masks[first..]) {
                if let Some(kept) = index[filled..].first_chunk_mut() {
                    W::keep_slots(mask, slots, kept);
                }
                filled += mask.count_ones() as usize;
            }
            index[filled..filled + WIDTH].copy_from_slice(&nobody);
            filled = filled.next_multiple_of(WIDTH);
            *end = filled as u32;
        }
    }
}

/// Replaces the content of a vector, with a sixteenth of room where it must grow.
fn copy<T: Copy>(into: &mut Vec<T>, from: &[T]) {
    into.clear();
    if into.capacity() < from.len() {
        let more = if into.capacity() == 0 { 0 } else { from.len() / 16 };
        into.reserve_exact(from.len() + more);
    }
    into.extend_from_slice(from);
}

/// All particles in cell order, as their pairs see them, nobody behind the last.
#[derive(Clone, Copy, Debug)]
pub struct Lines<'a> {
    /// In doubles.
    pub double: &'a [Packed],
    /// In singles; empty in double precision.
    pub single: &'a [PackedSingle],
    /// Which of the two pairs read.
    pub precision: Precision,
}

/// One chunk of particles with all that they can touch: what a pair loop runs over.
#[derive(Clone, Copy, Debug)]
pub struct Hood<'a> {
    /// All particles.
    pub lines: Lines<'a>,
    /// The chunk.
    pub chunk: &'a Chunk,
    /// The box.
    pub space: PeriodicBox,
}

/// What the law between two particles may depend on, for directed pair `i ← j`.
#[derive(Clone, Copy, Debug)]
pub struct Pair<T> {
    /// `|rᵢⱼ|²`.
    pub r2: T,
    /// `vᵢⱼ·rᵢⱼ`, negative while the pair approaches.
    pub approach: T,
    /// `ρᵢ`.
    pub rho_i: T,
    /// `ρⱼ`.
    pub rho_j: T,
}

impl<T: Scalar> Pair<T> {
    /// `ρ̄ = (ρᵢ + ρⱼ)/2`.
    #[inline(always)]
    pub fn mean_density(&self) -> T {
        (self.rho_i + self.rho_j) * 0.5
    }
}

/// Below this a direction is none: its numerator is smaller still.
const SMALLEST_DISTANCE: f64 = 1e-150;

/// What is read of one particle and eight neighbours.
#[derive(Clone, Copy, Debug)]
pub struct Reading<W, const D: usize> {
    /// `rᵢⱼ`, minimum image.
    pub separation: Vector<W, D>,
    /// `vᵢⱼ`.
    pub velocity: Vector<W, D>,
    /// `ρᵢ`.
    pub rho_i: f64,
    /// `ρⱼ`.
    pub density: W,
    /// `Aᵢ`.
    pub stress_i: f64,
    /// `Aⱼ`.
    pub stress: W,
}

/// One particle against eight neighbours.
#[derive(Clone, Copy, Debug)]
pub struct Batch<W, const D: usize> {
    /// `rᵢⱼ`, minimum image.
    pub separation: Vector<W, D>,
    /// `vᵢⱼ`.
    pub velocity: Vector<W, D>,
    /// What a central pair law sees.
    pub pair: Pair<W>,
    /// `Aᵢ`.
    pub stress_i: W,
    /// `Aⱼ`.
    pub stress_j: W,
}

/// Eight of many.
#[inline(always)]
pub fn pick<'a, P>(all: &'a [P], slots: &[u32; WIDTH]) -> [&'a P; WIDTH] {
    // Written out: the closure of an array's `map` is not inlined into vectorised functions.
    let [a, b, c, d, e, f, g, h] = *slots;
    let at = |slot: u32| &all[slot as usize];
    [at(a), at(b), at(c), at(d), at(e), at(f), at(g), at(h)]
}

/// `∂L/∂F` and `∂L/∂ρ` of eight particles.
#[inline(always)]
pub fn adjoints<W: Wide>(adjoint: &[PackedAdjoint], slots: &[u32; WIDTH]) -> [W::Double; 4] {
    W::adjoints(pick(adjoint, slots))
}

/// `rᵢⱼ` of the particle in slot `here` and eight others.
#[inline(always)]
pub fn separation<W: Wide, const D: usize>(
    lines: Lines<'_>,
    here: usize,
    slots: &[u32; WIDTH],
    space: Surroundings,
) -> Vector<W, D> {
    let lines = W::lines(lines);
    W::separation(&lines[here], pick(lines, slots), space)
}

impl<W: Wide, const D: usize> Batch<W, D> {
    /// `rᵢⱼ/r`, zero where the particles meet.
    #[inline(always)]
    pub fn direction(&self) -> Vector<W, D> {
        self.separation * (W::of(1.0) / self.pair.r2.sqrt().max(W::smallest(SMALLEST_DISTANCE)))
    }

    /// `|rᵢⱼ|²` and `rᵢⱼ` of one of the pairs.
    #[inline(always)]
    pub fn lane(&self, lane: usize) -> (f64, Vector<f64, D>) {
        let mut separation = Vector::zero();
        for axis in 0..D {
            separation[axis] = self.separation[axis].store().lane(lane);
        }
        (self.pair.r2.store().lane(lane), separation)
    }

    /// The particle in slot `here` against the particles in `slots`.
    #[inline(always)]
    pub fn read(lines: Lines<'_>, here: usize, slots: &[u32; WIDTH], space: Surroundings) -> Self {
        let lines = W::lines(lines);
        let read = W::read::<D>(&lines[here], pick(lines, slots), space);
        Self {
            separation: read.separation,
            velocity: read.velocity,
            pair: Pair {
                r2: read.separation.norm_squared(),
                approach: read.velocity.dot(read.separation),
                rho_i: W::of(read.rho_i),
                rho_j: read.density,
            },
            stress_i: W::of(read.stress_i),
            stress_j: read.stress,
        }
    }
}
