//! Eight neighbours at once: lists of neighbours, and how every pair loop reads them.

use crate::packed::Packed;
use crate::scalar::{Lanes, Scalar, WIDTH};
use crate::space::PeriodicBox;
use crate::vector::Vector;

/// Particles per parallel task: fixed, so that no result depends on the number of threads.
pub const CHUNK: usize = 256;

/// The neighbours of [`CHUNK`] consecutive slots.
#[derive(Clone, Debug, Default)]
pub struct Chunk {
    /// First slot of the chunk.
    pub first: usize,
    /// Where each slot's neighbours start in `index`; one more at the end.
    start: Vec<u32>,
    /// Slots, filled up to whole lanes with the slot of nobody, `N`.
    index: Vec<u32>,
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
        4 * (self.index.capacity() + self.start.capacity())
    }

    /// The neighbours of the chunk's `k`-th slot, eight at a time.
    #[inline(always)]
    pub fn neighbours(&self, k: usize) -> &[[u32; WIDTH]] {
        self.index[self.start[k] as usize..self.start[k + 1] as usize].as_chunks().0
    }

    /// Forgets all lists.
    pub fn clear(&mut self) {
        self.start.clear();
        self.index.clear();
        self.start.push(0);
    }

    /// Ends the list of a slot, with the slot of nobody, `nobody`, up to whole lanes.
    pub fn close(&mut self, nobody: usize) {
        self.index.resize(self.index.len().next_multiple_of(WIDTH), nobody as u32);
        self.start.push(self.index.len() as u32);
    }

    /// Number of eights in all lists.
    pub fn batches(&self) -> usize {
        self.index.len() / WIDTH
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

    /// The place in the lists at which the chunk's `k`-th slot has the slot `other`.
    #[inline(always)]
    pub fn place_of(&self, k: usize, other: usize) -> Option<usize> {
        let list = &self.index[self.start[k] as usize..self.start[k + 1] as usize];
        let found = list.iter().position(|&slot| slot == other as u32)?;
        Some(self.start[k] as usize + found)
    }

    /// Appends those of the eight slots from `first` on, below `end`, that are in reach.
    #[inline(always)]
    pub fn append(&mut self, r2: Lanes, (slot, first, end): (usize, usize, usize), reach2: f64) {
        let length = self.index.len();
        self.index.resize(length + WIDTH, 0);
        let room = &mut self.index[length..];
        let mut kept = 0;
        // Without a branch: every candidate is written, only a neighbour moves the place on.
        for (lane, r2) in r2.to_array().into_iter().enumerate() {
            let other = first + lane;
            room[kept] = other as u32;
            kept += usize::from(r2 < reach2 && other < end && other != slot);
        }
        self.index.truncate(length + kept);
    }
}

/// One chunk of particles with all that they can touch: what a pair loop runs over.
#[derive(Clone, Copy, Debug)]
pub struct Hood<'a> {
    /// All particles in cell order, nobody behind the last.
    pub packed: &'a [Packed],
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

/// One particle against eight neighbours.
#[derive(Clone, Copy, Debug)]
pub struct Batch<const D: usize> {
    /// `rᵢⱼ`, minimum image.
    pub separation: Vector<Lanes, D>,
    /// `vᵢⱼ`.
    pub velocity: Vector<Lanes, D>,
    /// What a central pair law sees.
    pub pair: Pair<Lanes>,
    /// `Aᵢ`.
    pub stress_i: Lanes,
    /// `Aⱼ`.
    pub stress_j: Lanes,
}

/// One number of each of eight particles.
#[inline(always)]
pub fn gather<P>(packed: &[P], slots: &[u32; WIDTH], field: impl Fn(&P) -> f64) -> Lanes {
    let mut lanes = [0.0; WIDTH];
    for (lane, &slot) in lanes.iter_mut().zip(slots) {
        *lane = field(&packed[slot as usize]);
    }
    Lanes::new(lanes)
}

/// `rᵢⱼ` of particle `here` and eight others.
#[inline(always)]
pub fn separation<const D: usize>(
    packed: &[Packed],
    here: &Packed,
    slots: &[u32; WIDTH],
    space: PeriodicBox,
) -> Vector<Lanes, D> {
    let mut r = Vector::zero();
    for axis in 0..D {
        r[axis] = Lanes::of(here.position[axis]) - gather(packed, slots, |p| p.position[axis]);
    }
    space.minimum_image(r)
}

impl<const D: usize> Batch<D> {
    /// `rᵢⱼ/r`, zero where the particles meet.
    #[inline(always)]
    pub fn direction(&self) -> Vector<Lanes, D> {
        self.separation * (Lanes::of(1.0) / self.pair.r2.sqrt().max(Lanes::of(SMALLEST_DISTANCE)))
    }

    /// Particle `here` against the particles in `slots`.
    #[inline(always)]
    pub fn read(
        packed: &[Packed],
        here: &Packed,
        slots: &[u32; WIDTH],
        space: PeriodicBox,
    ) -> Self {
        let separation = separation(packed, here, slots, space);
        let mut velocity = Vector::zero();
        for axis in 0..D {
            let there = gather(packed, slots, |p| p.velocity[axis]);
            velocity[axis] = Lanes::of(here.velocity[axis]) - there;
        }
        Self {
            separation,
            velocity,
            pair: Pair {
                r2: separation.norm_squared(),
                approach: velocity.dot(separation),
                rho_i: Lanes::of(here.density),
                rho_j: gather(packed, slots, |p| p.density),
            },
            stress_i: Lanes::of(here.stress),
            stress_j: gather(packed, slots, |p| p.stress),
        }
    }
}
