//! How pair loops read one particle and eight neighbours at a time.

pub use crate::neighbours::chunk::{AHEAD, CHUNK, Chunk, Eight, Entry, MAX_BLOCKS_PER_TASK};
pub use crate::neighbours::list_builder::{ListBuilder, Lists};
use crate::neighbours::near::Near;
use crate::packed::{Packed, PackedAdjoint, PackedSingle};
use crate::scalar::{Precision, Scalar, SimdFloat, WIDTH};
use crate::space::Space;
use crate::vector::Vector;

/// The box, as the pairs of one particle need it.
#[derive(Clone, Copy, Debug)]
pub struct Surroundings {
    /// The box.
    pub space: Space,
    /// Whether differences to its neighbours need the nearest image.
    pub seam: bool,
}

/// All particles in cell order, with the sentinel at the end.
#[derive(Clone, Copy, Debug)]
pub struct Lines<'a> {
    /// In `f64`.
    pub double: &'a [Packed],
    /// In `f32`; empty in double precision.
    pub single: &'a [PackedSingle],
    /// Which of the two pair loops read.
    pub precision: Precision,
}

impl Lines<'_> {
    /// The index of the sentinel, one past the last particle.
    #[inline(always)]
    pub fn sentinel(&self) -> usize {
        self.double.len() - 1
    }
}

/// One chunk of particles with its neighbours: what a pair loop runs over.
#[derive(Clone, Copy, Debug)]
pub struct Neighbourhood<'a> {
    /// All particles.
    pub lines: Lines<'a>,
    /// The chunk, and its neighbours within the support.
    pub near: &'a Near,
    /// The box.
    pub space: Space,
}

/// The scalars that the law between two particles may depend on, for the directed pair `i ← j`.
#[derive(Clone, Copy, Debug)]
pub struct Pair<T> {
    /// `|rᵢⱼ|²`.
    pub r2: T,
    /// `vᵢⱼ·rᵢⱼ`, negative while the pair approaches.
    pub v_dot_r: T,
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

/// Distance below which a direction is zero: its numerator is smaller still.
const SMALLEST_DISTANCE: f64 = 1e-150;

/// The data read for one particle and eight neighbours.
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
    pub p_over_rho2_i: f64,
    /// `Aⱼ`.
    pub p_over_rho2: W,
}

/// One particle against eight neighbours.
#[derive(Clone, Copy, Debug)]
pub struct Batch<W, const D: usize> {
    /// `rᵢⱼ`, minimum image.
    pub separation: Vector<W, D>,
    /// `vᵢⱼ`.
    pub velocity: Vector<W, D>,
    /// The scalars of a central pair law.
    pub pair: Pair<W>,
    /// `Aᵢ`.
    pub p_over_rho2_i: W,
    /// `Aⱼ`.
    pub p_over_rho2_j: W,
}

/// References to eight of many particles.
#[inline(always)]
pub fn pick<'a, P>(all: &'a [P], others: Eight<'_, impl Entry>) -> [&'a P; WIDTH] {
    // Written out: the closure of an array's `map` is not inlined into vectorised functions.
    let near = &all[others.base..];
    let at = |lane: usize| &near[others.entries[lane].distance()];
    [at(0), at(1), at(2), at(3), at(4), at(5), at(6), at(7)]
}

/// `∂L/∂F` and `∂L/∂ρ` of eight particles.
#[inline(always)]
pub fn adjoints<W: SimdFloat>(
    adjoint: &[PackedAdjoint],
    others: Eight<'_, impl Entry>,
) -> [W::Double; 4] {
    W::adjoints(pick(adjoint, others))
}

/// `rᵢⱼ` of the particle in slot `here` and eight others.
#[inline(always)]
pub fn separation<W: SimdFloat, const D: usize>(
    lines: Lines<'_>,
    here: usize,
    others: Eight<'_, impl Entry>,
    space: Surroundings,
) -> Vector<W, D> {
    let lines = W::lines(lines);
    W::separation(&lines[here], pick(lines, others), space)
}

impl<W: SimdFloat, const D: usize> Batch<W, D> {
    /// `rᵢⱼ/r`; zero where the particles coincide.
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

    /// The particle in slot `here` against eight others.
    #[inline(always)]
    pub fn read(
        lines: Lines<'_>,
        here: usize,
        others: Eight<'_, impl Entry>,
        space: Surroundings,
    ) -> Self {
        let lines = W::lines(lines);
        let read = W::read::<D>(&lines[here], pick(lines, others), space);
        Self {
            separation: read.separation,
            velocity: read.velocity,
            pair: Pair {
                r2: read.separation.norm_squared(),
                v_dot_r: read.velocity.dot(read.separation),
                rho_i: W::of(read.rho_i),
                rho_j: read.density,
            },
            p_over_rho2_i: W::of(read.p_over_rho2_i),
            p_over_rho2_j: read.p_over_rho2,
        }
    }
}
