//! The pair forces, Eqs. (2) to (7), with their tangent and their pullback.
//!
//! Equation numbers are those of Woodward et al., arXiv:2110.13311: see `docs/equations.md`.

use super::near::Pairs;
use super::particles::{
    Accelerations, AdjointCloud, EvaluatedPairs, PairInputs, ScratchPool, SensitivityCloud,
    pairs_of, side_by_side,
};
use super::term::{Contribution, ContributionKind, Stage, Term};
use super::{Needs, Occasion, Phase};
use crate::models::{
    ForceJacobian, ForceOutput, Model, PairShare, PullbackOutput, Scratch, TangentOptions,
};
use crate::neighbours::near::Near;
use crate::packed::PackedAdjoint;
use crate::pairs::{CHUNK, MAX_BLOCKS_PER_TASK, Neighbourhood};
use crate::parameters::ParameterSpec;
use crate::scalar::{F64x8, WIDTH};
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use rayon::prelude::*;

/// A pair law, with the places of its parameters in the flat vector.
#[derive(Debug)]
#[doc(hidden)]
pub struct PairTerm<const D: usize> {
    /// Its name.
    pub name: String,
    /// The law.
    pub model: Box<dyn Model<D>>,
    /// Places of its parameters: scalars, then the weights of its network.
    pub places: Vec<usize>,
    /// Scratch buffers in which threads evaluate it.
    pub scratch_pool: ScratchPool,
}

impl<const D: usize> PairTerm<D> {
    /// A law with parameters that have no places in the flat vector yet.
    pub fn new(name: impl Into<String>, model: Box<dyn Model<D>>) -> Self {
        Self { name: name.into(), model, places: Vec::new(), scratch_pool: ScratchPool::default() }
    }

    /// Places of its scalar parameters.
    pub fn scalars(&self) -> &[usize] {
        &self.places[..self.model.scalars().min(self.places.len())]
    }

    /// Places of the weights of its network.
    pub fn weights(&self) -> &[usize] {
        &self.places[self.model.scalars().min(self.places.len())..]
    }

    /// Its parameters: scalars, then weights.
    pub fn specs(&self) -> Vec<ParameterSpec> {
        let mut specs = self.model.specs();
        let weights = self.model.network().map_or(&[][..], |network| &network.weights);
        specs.extend(weights.iter().enumerate().map(|(place, &value)| {
            let name = crate::parameters::Parameter::weight(place);
            ParameterSpec::weight(name, value)
        }));
        specs
    }

    /// Sets the values of its parameters.
    fn set(&mut self, values: &[f64]) {
        let (scalars, weights) = values.split_at(self.model.scalars().min(values.len()));
        self.model.set_scalars(scalars);
        if let Some(network) = self.model.network_mut() {
            network.weights.iter_mut().zip(weights).for_each(|(own, value)| *own = *value);
        }
    }
}

/// The pair laws of a World: the model that a scene learns, which also defines the densities, and
/// the laws added to it.
#[derive(Resource, Debug)]
#[doc(hidden)]
pub struct Laws<const D: usize> {
    /// The model.
    pub model: PairTerm<D>,
    /// Laws that add their forces to the model's.
    pub added: Vec<PairTerm<D>>,
}

impl<const D: usize> Laws<D> {
    /// The model that moves the particles.
    pub fn model(&self) -> &dyn Model<D> {
        &*self.model.model
    }

    /// All of them, the model first.
    pub fn all(&self) -> impl Iterator<Item = &PairTerm<D>> {
        std::iter::once(&self.model).chain(&self.added)
    }

    /// All of them, mutable.
    pub fn all_mut(&mut self) -> impl Iterator<Item = &mut PairTerm<D>> {
        std::iter::once(&mut self.model).chain(&mut self.added)
    }
}

/// Term: the forces of a pair law. The term of the first law, the model, runs the systems of all
/// laws.
#[derive(Clone, Debug)]
#[doc(hidden)]
pub struct PairForces {
    /// Number of the law in [`Laws::all`].
    pub law: usize,
    /// Its name.
    pub name: String,
    /// Its parameters: scalars, then weights.
    pub specs: Vec<ParameterSpec>,
}

impl<const D: usize> Term<D> for PairForces {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn parameters(&self) -> Vec<ParameterSpec> {
        self.specs.clone()
    }

    fn set_parameters(&self, values: &[f64], world: &mut World) {
        if let Some(law) = world.resource_mut::<Laws<D>>().all_mut().nth(self.law) {
            law.set(values);
        }
    }

    fn stages(&self, occasion: Occasion, _: &Needs) -> Vec<Stage> {
        if self.law > 0 || !occasion.has_forces() {
            return Vec::new();
        }
        let stage = Stage::new(Phase::Force, accelerate::<D>);
        vec![stage.tangent(accelerate_tangent::<D>).pullback(accelerate_pullback::<D>)]
    }

    fn contributions(&self, world: &World) -> Vec<Contribution<D>> {
        let laws = world.resource::<Laws<D>>();
        let Some(law) = laws.all().nth(self.law) else { return Vec::new() };
        let pairs = pairs_of::<D>(world);
        let mut accelerations = vec![Vector::zero(); world.resource::<PairInputs>().len()];
        let names = law.model.part_names().iter().enumerate();
        names
            .map(|(part, name)| {
                let chunks = accelerations.par_chunks_mut(CHUNK).enumerate();
                chunks.for_each(|(chunk, out)| {
                    pairs.meet(chunk, law, |neighbourhood, scratch| {
                        law.model.part(part, neighbourhood, scratch, out)
                    });
                });
                let name = format!("{}: {name}", self.name);
                let kind = match (self.law, part) {
                    (0, 0) => ContributionKind::Pressure,
                    _ => ContributionKind::Viscosity,
                };
                Contribution::of(name, kind, law.model.mass(), &accelerations)
            })
            .collect()
    }
}

/// Chunks per window of linearised pairs. A larger number loads each block's sensitivities less
/// often, because fewer particles belong to two windows; a smaller one keeps the linearised pairs in
/// the cache.
pub(super) const WINDOW: usize = 4;

/// System: the force of all pairs, law by law.
#[doc(hidden)]
pub fn accelerate<const D: usize>(
    evaluated: EvaluatedPairs<'_, D>,
    laws: Res<Laws<D>>,
    mut sum: ResMut<Accelerations<D>>,
) {
    let pairs = evaluated.pairs();
    sum.0.resize(evaluated.len(), Vector::zero());
    for (number, law) in laws.all().enumerate() {
        law.scratch_pool.make_room(&*law.model, pairs.fullest());
        let chunks = sum.0.par_chunks_mut(CHUNK).enumerate();
        chunks.with_max_len(MAX_BLOCKS_PER_TASK).for_each(|(chunk, accelerations)| {
            pairs.meet(chunk, law, |neighbourhood, scratch| {
                let out = ForceOutput { accelerations, add: number > 0 };
                law.model.accelerations(neighbourhood, scratch, out);
            });
        });
    }
}

/// System: the tangent of [`accelerate`] for every block of parameters. It is the sum of two parts:
/// the direct derivative by a network's weights, found in one pass for all blocks, and the
/// derivative through the state.
///
/// Pairs are linearised once, a few chunks at a time, and then applied to one block after another.
/// A block's sensitivities are prefetched while the block before it is computed.
#[doc(hidden)]
pub fn accelerate_tangent<const D: usize>(
    evaluated: EvaluatedPairs<'_, D>,
    laws: Res<Laws<D>>,
    mut sensitivities: ResMut<SensitivityCloud<D>>,
) {
    let pairs = evaluated.pairs();
    for (number, law) in laws.all().enumerate() {
        add_tangent(number, law, pairs, &mut sensitivities);
    }
}

/// The tangent of one law's forces. The first law overwrites the sum, every other law adds to it.
fn add_tangent<const D: usize>(
    number: usize,
    law: &PairTerm<D>,
    pairs: Pairs<'_>,
    sensitivities: &mut SensitivityCloud<D>,
) {
    let model = &*law.model;
    let SensitivityCloud { blocks, coupling, p_over_rho2_slopes, slopes, .. } = sensitivities;
    let coupling = *coupling;
    let (mut packed, mut directions, mut weights) = (Vec::new(), Vec::new(), Vec::new());
    let mut changes = Vec::new();
    for block in blocks {
        packed.push(&block.packed[..]);
        directions.push(&block.directions[number][..]);
        weights.push(&block.weights[number][..]);
        changes.push(&mut block.acceleration[..]);
    }
    let direct = directions.iter().any(|of| of.iter().any(|d| *d != F64x8::ZERO));
    let has_network = model.network().is_some() && model.has_force_network();
    if has_network {
        let columns = changes.iter_mut().map(|column| &mut **column).collect();
        side_by_side(columns).into_par_iter().enumerate().for_each(|(chunk, columns)| {
            pairs.meet(chunk, law, |neighbourhood, scratch| {
                add_shares(law, (neighbourhood, scratch), (columns, number > 0), &weights);
            });
        });
    }
    slopes.resize_with(pairs.chunks().min(WINDOW), ForceJacobian::default);
    for window in (0..pairs.chunks()).step_by(WINDOW) {
        let chunks = window..(window + WINDOW).min(pairs.chunks());
        chunks.clone().into_par_iter().zip(&mut *slopes).for_each(|(chunk, slopes)| {
            let kept = TangentOptions { coupling, direct, p_over_rho2_slopes };
            pairs.meet(chunk, law, |neighbourhood, scratch| {
                model.slopes(neighbourhood, kept, scratch, slopes)
            });
        });
        changes.par_iter_mut().enumerate().for_each(|(block, changes)| {
            let packed = [packed[block], packed.get(block + 1).copied().unwrap_or_default()];
            let columns = changes[window * CHUNK..].par_chunks_mut(CHUNK);
            let chunks = columns.zip(&*slopes).zip(chunks.clone());
            chunks.for_each(|((out, slopes), chunk)| {
                if !has_network && number == 0 {
                    out.fill(Vector([F64x8::ZERO; D]));
                }
                slopes.add_tangents(chunk * CHUNK, packed, directions[block], out);
            });
        });
    }
}

/// The part of `δF` of a chunk of particles, block by block, that comes directly from each block's
/// weights. It takes eight particles at a time, so that their derivatives by all weights stay in
/// the cache.
fn add_shares<const D: usize>(
    law: &PairTerm<D>,
    (neighbourhood, scratch): (Neighbourhood<'_>, &mut Scratch),
    (mut blocks, add): (Vec<&mut [Vector<F64x8, D>]>, bool),
    weights: &[&[(usize, usize, f64)]],
) {
    let count = law.model.network().map_or(0, |network| network.weights.len());
    let mut shares = std::mem::take(&mut scratch.shares);
    for first in (0..neighbourhood.near.len()).step_by(WIDTH) {
        let particles = first..(first + WIDTH).min(neighbourhood.near.len());
        shares.resize(particles.len() * D * count, 0.0);
        law.model.weight_shares(neighbourhood, first, scratch, &mut shares);
        for (out, weights) in blocks.iter_mut().zip(weights) {
            let rows = out[particles.clone()].iter_mut().zip(shares.chunks_exact(D * count));
            for (a, shares) in rows {
                if !add {
                    *a = Vector([F64x8::ZERO; D]);
                }
                for &(lane, weight, by) in *weights {
                    for axis in 0..D {
                        let share = a[axis].lane(lane) + shares[axis * count + weight] * by;
                        a[axis].set_lane(lane, share);
                    }
                }
            }
        }
    }
    scratch.shares = shares;
}

/// System: the pullback of [`accelerate`].
#[doc(hidden)]
pub fn accelerate_pullback<const D: usize>(
    evaluated: EvaluatedPairs<'_, D>,
    laws: Res<Laws<D>>,
    mut adjoint: ResMut<AdjointCloud<D>>,
) {
    let pairs = evaluated.pairs();
    for law in laws.all() {
        pull_back(law, pairs, &mut adjoint);
        if law.model.passes_to_neighbours() {
            let AdjointCloud { senders, near, .. } = &mut *adjoint;
            senders.find(near, evaluated.len());
            fetch_shares(&mut adjoint);
        }
    }
}

/// The pullback of one law's forces, except for what [`fetch_shares`] adds.
fn pull_back<const D: usize>(law: &PairTerm<D>, pairs: Pairs<'_>, adjoint: &mut AdjointCloud<D>) {
    let one_way = law.model.passes_to_neighbours();
    adjoint.sum_parameters(&law.places, |adjoint, sums, width| {
        let AdjointCloud { packed: lines, position, velocity, scalars, shares, near, .. } = adjoint;
        shares.resize_with(near.len(), Vec::new);
        let forces: &[PackedAdjoint] = lines;
        let places = position.par_chunks_mut(CHUNK).zip(velocity.par_chunks_mut(CHUNK));
        let places = places.zip(scalars.par_chunks_mut(CHUNK)).zip(shares);
        let places = places.zip(sums.par_chunks_mut(width));
        near.par_iter().zip(places).for_each(|(near, (place, sums))| {
            let (((position, velocity), scalars), neighbours) = place;
            let places = if one_way { WIDTH * near.batches() } else { 0 };
            neighbours.resize(places, PairShare::ZERO);
            let into = PullbackOutput { position, velocity, scalars, neighbours };
            law.scratch_pool.enter(&*law.model, |scratch| {
                scratch.clear();
                law.model.pull_back(pairs.neighbourhood(near), forces, scratch, into);
                scratch.write_sums(sums);
            });
        });
    });
}

/// Adds to each particle the shares that the pullback of its neighbours' forces wrote for it.
fn fetch_shares<const D: usize>(adjoint: &mut AdjointCloud<D>) {
    let AdjointCloud { position, velocity, scalars, shares, senders, .. } = adjoint;
    let rows = position.par_iter_mut().zip(velocity).zip(scalars).enumerate();
    rows.with_min_len(CHUNK).for_each(|(slot, ((position, velocity), scalars))| {
        for &[chunk, place] in senders.of(slot) {
            let share = &shares[chunk as usize][place as usize];
            *position += share.position;
            *velocity += share.velocity;
            scalars.0 += share.p_over_rho2;
            scalars.1 += share.density;
        }
    });
}

/// The neighbour lists transposed: for each particle, the lists that contain it and its place in
/// them.
#[derive(Clone, Debug, Default)]
#[doc(hidden)]
pub struct TransposedLists {
    /// Whether `start` and `places` belong to the current lists.
    known: bool,
    /// Index in `places` of each slot's first entry, and the total at the end.
    start: Vec<u32>,
    /// Chunk and place in its lists, ordered by the slot of the listing particle.
    places: Vec<[u32; 2]>,
}

impl TransposedLists {
    /// Marks the transposed lists as outdated.
    pub(super) fn forget(&mut self) {
        self.known = false;
    }

    /// Transposes lists of `particles` particles, unless that has been done already.
    fn find(&mut self, lists: &[Near], particles: usize) {
        if !std::mem::replace(&mut self.known, true) {
            self.transpose(lists, particles);
        }
    }

    /// Counting sort of all places by the slot that they hold.
    fn transpose(&mut self, lists: &[Near], particles: usize) {
        self.start.clear();
        self.start.resize(particles + 2, 0);
        for other in lists.iter().flat_map(Near::slots) {
            // The sentinel has the index `particles`: it is counted in the last element, which is
            // dropped below.
            self.start[other + 1] += 1;
        }
        for slot in 0..particles {
            self.start[slot + 1] += self.start[slot];
        }
        self.start.truncate(particles + 1);
        self.places.resize(self.start[particles] as usize, [0; 2]);
        for (number, near) in lists.iter().enumerate().rev() {
            let places = (0..WIDTH * near.batches()).rev();
            for (place, other) in places.zip(near.slots().rev()) {
                // Filling from the end turns each end into a start.
                let Some(end) = self.start[1..].get_mut(other) else { continue };
                *end -= 1;
                self.places[*end as usize] = [number as u32, place as u32];
            }
        }
        self.start.remove(0);
        self.start.push(self.places.len() as u32);
    }

    fn of(&self, slot: usize) -> &[[u32; 2]] {
        &self.places[self.start[slot] as usize..self.start[slot + 1] as usize]
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        4 * self.start.capacity() + 8 * self.places.capacity()
    }
}
