//! The components of a particle, and the packed arrays of all particles that pair loops run over.
//!
//! Position, velocity and acceleration are glam's `DVec2` or `DVec3` in place: they have its fields,
//! methods and operators.
//!
//! ```
//! use bevy_ecs::prelude::*;
//! use glam::DVec3;
//! use whirls::systems::Phase;
//! use whirls::systems::particles::{Position, Velocity};
//!
//! fn swirl(mut particles: Query<(&Position<3>, &mut Velocity<3>)>) {
//!     for (position, mut velocity) in &mut particles {
//!         **velocity += 1e-3 * DVec3::Z.cross(**position);
//!         velocity.z *= 0.99;
//!     }
//! }
//!
//! let scene = whirls::Scene::shipped("inverse-3d")?;
//! let mut flow = whirls::Flow::<3>::new(&scene)?;
//! flow.schedule_mut().add_systems(swirl.after(Phase::SecondKick).before(Phase::Loss));
//! flow.step()?;
//! # Ok::<(), whirls::Error>(())
//! ```

use super::acceleration::{Laws, TransposedLists};
use super::density_tangent::DensityJacobian;
use super::near::Pairs;
use super::neighbours::Neighbours;
use crate::models::{ForceJacobian, Model, PairShare, Scratch};
use crate::neighbours::cells::MIN_PARALLEL_LEN;
use crate::neighbours::near::Near;
use crate::packed::{Packed, PackedAdjoint, PackedSensitivity, PackedSingle};
use crate::pairs::{CHUNK, Lines};
use crate::pool::Pool;
use crate::scalar::{F64x8, Precision};
use crate::sensitivity::Coupling;
use crate::space::Space;
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use std::borrow::Cow;
use std::ops::{Deref, DerefMut};

/// Number of the particle in its flow, `0..N`. Recordings, truths and packed arrays identify
/// particles by it.
///
/// An entity without it is no particle of the fluid, whatever other components it has: no system
/// moves it, and no force acts on it. A particle keeps its number. A flow is refused if its
/// number of particles has changed since its start.
#[derive(Component, Clone, Copy, Debug, PartialEq, Eq)]
pub struct ParticleId(pub u32);

/// Position `r`, inside the box.
#[derive(Component, Clone, Copy, Debug)]
pub struct Position<const D: usize>(pub Vector<f64, D>);

/// Velocity `v`.
#[derive(Component, Clone, Copy, Debug)]
pub struct Velocity<const D: usize>(pub Vector<f64, D>);

/// Acceleration `F` of the last force evaluation. The kick-drift-kick step carries it to the next
/// step, so that it belongs to the state.
#[derive(Component, Clone, Copy, Debug, Default)]
pub struct Acceleration<const D: usize>(pub Vector<f64, D>);

/// A component as glam's vector of its dimension, in place.
macro_rules! as_glam {
    ($($component:ident),*) => { $(
        as_glam!($component<2>, DVec2);
        as_glam!($component<3>, DVec3);
    )* };
    ($component:ident<$dimension:literal>, $vector:ident) => {
        impl Deref for $component<$dimension> {
            type Target = $vector;

            #[inline]
            fn deref(&self) -> &$vector {
                bytemuck::cast_ref(&self.0.0)
            }
        }

        impl DerefMut for $component<$dimension> {
            #[inline]
            fn deref_mut(&mut self) -> &mut $vector {
                bytemuck::cast_mut(&mut self.0.0)
            }
        }

        impl From<$vector> for $component<$dimension> {
            #[inline]
            fn from(vector: $vector) -> Self {
                Self(vector.into())
            }
        }
    };
}

as_glam!(Position, Velocity, Acceleration);

/// Density `ρ` at the particle's position.
#[derive(Component, Clone, Copy, Debug, Default)]
pub struct Density(pub f64);

/// Which particle a sensitivity block belongs to, and which eight parameters it holds.
///
/// Blocks are entities of their own, spawned block by block, so that their columns lie block-major
/// in memory and a scene that learns `p` parameters has `⌈p/8⌉` of them per particle.
#[derive(Component, Clone, Copy, Debug)]
#[doc(hidden)]
pub struct BlockOf {
    /// [`ParticleId`] of the particle.
    pub particle: u32,
    /// Parameters `8·block .. 8·block + 8`.
    pub block: u32,
}

/// `∂r/∂θ`, one lane per learned parameter.
#[derive(Component, Clone, Copy, Debug)]
pub struct PositionSensitivity<const D: usize>(pub Vector<F64x8, D>);

/// `∂v/∂θ`.
#[derive(Component, Clone, Copy, Debug)]
pub struct VelocitySensitivity<const D: usize>(pub Vector<F64x8, D>);

/// `∂F/∂θ` of the last force evaluation.
#[derive(Component, Clone, Copy, Debug)]
pub struct AccelerationSensitivity<const D: usize>(pub Vector<F64x8, D>);

/// `∂L/∂r` of the loss of later steps, carried backwards through the steps.
#[derive(Component, Clone, Copy, Debug, Default)]
pub struct PositionAdjoint<const D: usize>(pub Vector<f64, D>);

/// `∂L/∂v`.
#[derive(Component, Clone, Copy, Debug, Default)]
pub struct VelocityAdjoint<const D: usize>(pub Vector<f64, D>);

/// `∂L/∂F` of the force that is carried between steps.
#[derive(Component, Clone, Copy, Debug, Default)]
pub struct AccelerationAdjoint<const D: usize>(pub Vector<f64, D>);

/// Number of particles of a World.
#[derive(Resource, Clone, Copy, Debug, PartialEq, Eq)]
pub struct Particles(pub usize);

/// One table of particles: their numbers, and one component of each.
type Table<'a, T> = (&'a [ParticleId], &'a [T]);

impl Particles {
    /// A component of all particles, particle `k` in row `k`. It is borrowed where the World stores
    /// it in that order, and gathered by [`ParticleId`] where a user's components have moved
    /// particles to other tables.
    pub(super) fn gather<'a, T: Copy>(
        self,
        mut tables: impl Iterator<Item = Table<'a, T>>,
        nothing: T,
    ) -> Cow<'a, [T]> {
        let (ids, first) = tables.next().unwrap_or_default();
        let second = tables.next();
        if second.is_none() && self.are_in_order(ids) {
            return Cow::Borrowed(first);
        }
        let mut all = vec![nothing; self.0];
        for (ids, values) in [(ids, first)].into_iter().chain(second).chain(tables) {
            for (id, value) in ids.iter().zip(values) {
                if let Some(row) = all.get_mut(id.0 as usize) {
                    *row = *value;
                }
            }
        }
        Cow::Owned(all)
    }

    /// Whether these are all particles, particle `k` in row `k`.
    pub(crate) fn are_in_order(self, ids: &[ParticleId]) -> bool {
        ids.len() == self.0 && (0..).zip(ids).all(|(row, id)| id.0 == row)
    }
}

/// Splits columns of equal length into chunks, and groups the parts chunk by chunk.
pub(super) fn side_by_side<T>(columns: Vec<&mut [T]>) -> Vec<Vec<&mut [T]>> {
    let mut chunks: Vec<Vec<&mut [T]>> = Vec::new();
    for column in columns {
        for (number, part) in column.chunks_mut(CHUNK).enumerate() {
            if number == chunks.len() {
                chunks.push(Vec::new());
            }
            chunks[number].push(part);
        }
    }
    chunks
}

/// The adjoint variables of one force evaluation, in cell order; absent where no adjoint is run.
#[derive(Resource, Clone, Debug, Default)]
#[doc(hidden)]
pub struct AdjointCloud<const D: usize> {
    /// `∂L/∂F` and `∂L/∂ρ` per slot, and a zero element at the end for the sentinel.
    pub packed: Vec<PackedAdjoint>,
    /// `∂L/∂r` through this evaluation, per slot.
    pub position: Vec<Vector<f64, D>>,
    /// `∂L/∂v` through this evaluation, per slot.
    pub velocity: Vec<Vector<f64, D>>,
    /// `(∂L/∂A, ∂L/∂ρ)`, by row, from later uses of an earlier evaluation's densities: the loss at
    /// the end of a step, and the forces that begin the next. The pullback of that evaluation takes
    /// them.
    pub carried: Vec<(f64, f64)>,
    /// `(∂L/∂A, ∂L/∂ρ)` per slot: from `carried`, and through the forces.
    pub scalars: Vec<(f64, f64)>,
    /// Neighbours within the support, chunk by chunk.
    pub near: Vec<Near>,
    /// The step of the positions in `near`, if it may be used.
    pub sifted: Option<u64>,
    /// Shares that the pullback writes for neighbours, chunk by chunk; empty where pair forces are
    /// opposite.
    pub shares: Vec<Vec<PairShare<D>>>,
    /// Where each particle finds the shares written for it.
    pub senders: TransposedLists,
    /// `∂L/∂` of every parameter of the flat vector, summed over the evaluations so far.
    pub parameters: Vec<f64>,
    /// The same for one evaluation, chunk by chunk.
    pub sums: Vec<f64>,
}

impl<const D: usize> AdjointCloud<D> {
    /// Finds the neighbours within the support of all particles.
    pub(super) fn sift(&mut self, pairs: Pairs<'_>) {
        self.near.resize_with(pairs.chunks(), Near::default);
        self.near.par_iter_mut().enumerate().for_each(|(chunk, near)| pairs.find(chunk, near));
        self.senders.forget();
    }

    /// Calls `write` to fill one row of sums for each chunk of particles, then adds all rows to the
    /// parameters at `places`. `write` gets the array of rows and the width of a row.
    pub(super) fn sum_parameters(
        &mut self,
        places: &[usize],
        write: impl FnOnce(&mut Self, &mut [f64], usize),
    ) {
        // A row has at least one element, so that rows and chunks can be zipped.
        let width = places.len().max(1);
        let mut sums = std::mem::take(&mut self.sums);
        sums.resize(width * self.position.len().div_ceil(CHUNK), 0.0);
        write(self, &mut sums, width);
        for sum in sums.chunks_exact(width) {
            places.iter().zip(sum).for_each(|(&place, sum)| self.parameters[place] += sum);
        }
        self.sums = sums;
    }
}

/// What the pair loops read: all particles in cell order, as contiguous arrays.
///
/// A *slot* is an index in cell order, a *row* an index in the World's columns;
/// [`crate::neighbours::order::Order`] leads from one to the other.
#[derive(Resource, Debug, Default)]
pub struct PairInputs {
    /// One line per slot, and [`Packed::SENTINEL`] at the end.
    pub packed: Vec<Packed>,
    /// The same in `f32`; used in mixed precision.
    pub singles: Vec<PackedSingle>,
    /// The precision in which pairs are evaluated.
    pub precision: Precision,
}

impl PairInputs {
    /// Number of particles.
    pub fn len(&self) -> usize {
        self.packed.len().saturating_sub(1)
    }

    /// Whether there is no particle.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Makes room for `count` particles.
    pub(super) fn resize(&mut self, count: usize) {
        if self.packed.len() != count + 1 {
            self.packed.clear();
            self.packed.resize(count + 1, Packed::SENTINEL);
        }
    }

    /// Rounds the lines to `f32` in mixed precision; does nothing in double precision.
    pub(super) fn round(&mut self, space: Space) {
        if self.precision == Precision::Mixed {
            let particles = &self.packed[..self.packed.len().saturating_sub(1)];
            self.singles.resize(particles.len() + 1, PackedSingle::SENTINEL);
            self.singles[particles.len()] = PackedSingle::SENTINEL;
            let lines = self.singles.par_iter_mut().zip(particles).with_min_len(MIN_PARALLEL_LEN);
            lines.for_each(|(single, line)| *single = PackedSingle::new(line, space));
        }
    }

    /// The lines that pair loops read.
    pub fn lines(&self) -> Lines<'_> {
        Lines { double: &self.packed, single: &self.singles, precision: self.precision }
    }

    /// The particles, without the sentinel at the end.
    pub fn particles(&self) -> &[Packed] {
        &self.packed[..self.len()]
    }
}

/// What the summation of densities writes, in cell order.
#[derive(Resource, Debug, Default)]
pub struct Densities {
    /// `ρ` per slot.
    pub by_slot: Vec<f64>,
    /// Which listed neighbours have a nonzero weight in the density, chunk by chunk: one mask for
    /// each eight in the lists.
    pub masks: Vec<Vec<u8>>,
}

/// What the forces write: `F` per slot, the sum over all forces.
#[derive(Resource, Debug, Default)]
pub struct Accelerations<const D: usize>(pub Vec<Vector<f64, D>>);

/// All pairs of the last summation of densities, as an argument of a system.
#[derive(bevy_ecs::system::SystemParam)]
#[doc(hidden)]
pub struct EvaluatedPairs<'w, const D: usize> {
    /// The lists.
    pub neighbours: Res<'w, Neighbours<D>>,
    /// The particles.
    pub inputs: Res<'w, PairInputs>,
    /// Which of the listed pairs are within the support.
    pub densities: Res<'w, Densities>,
}

impl<const D: usize> EvaluatedPairs<'_, D> {
    /// The pairs.
    pub fn pairs(&self) -> Pairs<'_> {
        Pairs::new(self.inputs.lines(), &self.neighbours, &self.densities.masks)
    }

    /// Number of particles.
    pub fn len(&self) -> usize {
        self.inputs.len()
    }

    /// Whether there is no particle.
    pub fn is_empty(&self) -> bool {
        self.inputs.is_empty()
    }
}

/// All pairs of a World's last summation of densities.
pub(super) fn pairs_of<const D: usize>(world: &World) -> Pairs<'_> {
    let neighbours = world.resource::<Neighbours<D>>();
    Pairs::new(
        world.resource::<PairInputs>().lines(),
        neighbours,
        &world.resource::<Densities>().masks,
    )
}

/// Derivatives by the eight lanes of a block: `(lane, place, ∂(what has that place)/∂lane)`.
#[doc(hidden)]
pub type LaneDerivatives = Vec<(usize, usize, f64)>;

/// One block of sensitivities of all particles, in cell order.
#[derive(Clone, Debug)]
#[doc(hidden)]
pub struct SensitivityBlock<const D: usize> {
    /// One entry per slot.
    pub packed: Vec<PackedSensitivity<D>>,
    /// `δρ` per slot, before it is copied into `packed`.
    pub density: Vec<F64x8>,
    /// `δF` per slot.
    pub acceleration: Vec<Vector<F64x8, D>>,
    /// Those of parameters, by their places in the flat vector: one where the lane is the parameter.
    pub columns: LaneDerivatives,
    /// Of each pair law, in order: `∂(its scalar parameters)/∂(the eight lanes)`.
    pub directions: Vec<Vec<F64x8>>,
    /// Of each pair law, in order: those of its weights, by their places in its network.
    pub weights: Vec<LaneDerivatives>,
}

impl<const D: usize> SensitivityBlock<D> {
    /// A block of `count` particles, all zero, whose lanes are these derivatives of the parameters.
    pub(crate) fn new(count: usize, columns: LaneDerivatives) -> Self {
        Self {
            packed: vec![PackedSensitivity::ZERO; count],
            density: vec![F64x8::ZERO; count],
            acceleration: vec![Vector([F64x8::ZERO; D]); count],
            columns,
            directions: Vec::new(),
            weights: Vec::new(),
        }
    }

    /// `∂(the parameter at a place of the flat vector)/∂(the eight lanes)`.
    pub fn direction(&self, place: usize) -> F64x8 {
        let mut direction = F64x8::ZERO;
        for &(lane, _, by) in self.columns.iter().filter(|(_, own, _)| *own == place) {
            direction.set_lane(lane, by);
        }
        direction
    }

    /// Takes [`Self::directions`] and [`Self::weights`] of every law from the columns.
    pub(crate) fn seed(&mut self, laws: &Laws<D>) {
        self.directions.clear();
        self.weights.clear();
        for law in laws.all() {
            let directions = law.scalars().iter().map(|&place| self.direction(place)).collect();
            self.directions.push(directions);
            let of_law = |&(lane, place, by): &(usize, usize, f64)| {
                let weight = law.weights().iter().position(|own| *own == place)?;
                Some((lane, weight, by))
            };
            self.weights.push(self.columns.iter().filter_map(of_law).collect());
        }
    }
}

/// The sensitivity blocks of a World that learns; absent where nothing is learned.
#[derive(Resource, Clone, Debug)]
#[doc(hidden)]
pub struct SensitivityCloud<const D: usize> {
    /// `⌈p/8⌉` blocks.
    pub blocks: Vec<SensitivityBlock<D>>,
    /// Which derivatives of the force are included.
    pub coupling: Coupling,
    /// `∂A/∂ρ` per slot.
    pub p_over_rho2_slopes: Vec<f64>,
    /// Coefficients of the density tangent, for the chunks of one window.
    pub pulls: Vec<DensityJacobian<D>>,
    /// The linearised pairs of the chunks of one window.
    pub slopes: Vec<ForceJacobian>,
}

/// The scratch buffers in which threads evaluate a model.
#[derive(Debug, Default)]
#[doc(hidden)]
pub struct ScratchPool(Pool<Scratch>);

impl ScratchPool {
    /// Calls `work` with a scratch buffer for this model.
    pub fn enter<T, const D: usize>(
        &self,
        model: &dyn Model<D>,
        work: impl FnOnce(&mut Scratch) -> T,
    ) -> T {
        self.0.lend(|| model.scratch(), work)
    }

    /// Gives every thread's scratch buffer room for this many eights of neighbours, so that no
    /// later step allocates, whichever thread the scheduler gives the fullest chunk to.
    pub(super) fn make_room<const D: usize>(&self, model: &dyn Model<D>, eights: usize) {
        let mut scratch_pool = self.0.for_all_threads(|| model.scratch());
        scratch_pool.iter_mut().for_each(|scratch| scratch.near.make_room(eights));
    }
}
