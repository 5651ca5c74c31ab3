//! The pair forces, Eqs. (2) to (7), with their tangent and their pullback.

use super::near::Pairs;
use super::neighbours::Neighbours;
use super::particles::{Acceleration, AdjointCloud, Cloud, Rooms, SensitivityCloud, side_by_side};
use crate::cells::FEWEST;
use crate::models::{Kept, Model, PairShare, Passed, Room, Slopes};
use crate::near::Near;
use crate::packed::PackedAdjoint;
use crate::pairs::{AT_ONCE, CHUNK, Hood};
use crate::scalar::{Lanes, WIDTH};
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use rayon::prelude::*;

/// The model that moves the particles of a World.
#[derive(Resource, Debug)]
pub struct Law<const D: usize>(pub Box<dyn Model<D>>);

/// Chunks whose pairs are held linearised at once: more spare a block's sensitivities from being fetched by
/// two windows, fewer keep the pairs in the cache.
pub(super) const WINDOW: usize = 4;

/// Accelerations of all particles by the model's own force, in cell order.
pub fn model_accelerations<const D: usize>(
    pairs: Pairs<'_>,
    (model, rooms): (&dyn Model<D>, &Rooms),
    acceleration: &mut [Vector<f64, D>],
) {
    rooms.make_room(model.network(), pairs.fullest());
    let chunks = acceleration.par_chunks_mut(CHUNK).enumerate();
    chunks.with_max_len(AT_ONCE).for_each(|(chunk, out)| {
        pairs.meet(chunk, (rooms, model.network()), |hood, room| {
            model.accelerations(hood, room, out);
        });
    });
}

/// System: the force of all pairs.
pub fn accelerate<const D: usize>(
    neighbours: Res<Neighbours<D>>,
    (law, rooms): (Res<Law<D>>, Res<Rooms>),
    mut cloud: ResMut<Cloud<D>>,
) {
    let mut acceleration = std::mem::take(&mut cloud.acceleration);
    model_accelerations(cloud.pairs(&neighbours), (&*law.0, &rooms), &mut acceleration);
    cloud.acceleration = acceleration;
}

/// System: writes the accelerations back to the particles.
pub fn write_acceleration<const D: usize>(
    mut accelerations: Query<&mut Acceleration<D>>,
    cloud: Res<Cloud<D>>,
) {
    let mut slots = &cloud.slot_of_row[..];
    for mut column in accelerations.contiguous_iter_mut().into_iter().flatten() {
        let own = slots.split_off(..column.len()).unwrap_or_default();
        let rows = column.par_iter_mut().zip(own).with_min_len(FEWEST);
        rows.for_each(|(acceleration, &slot)| {
            acceleration.0 = cloud.acceleration[slot as usize];
        });
    }
}

/// System: the tangent of [`accelerate`] for every block of parameters: the direct share of a
/// network's weights, which one pass finds for all blocks, and what comes through the state.
///
/// Pairs are linearised once, a few chunks at a time, and then serve one block after another, so that a
/// block's sensitivities are fetched once: while the block before it is at work.
pub fn accelerate_tangent<const D: usize>(
    neighbours: Res<Neighbours<D>>,
    (law, rooms): (Res<Law<D>>, Res<Rooms>),
    cloud: Res<Cloud<D>>,
    mut sensitivities: ResMut<SensitivityCloud<D>>,
) {
    let (model, rooms, pairs) = (&*law.0, &*rooms, cloud.pairs(&neighbours));
    let SensitivityCloud { blocks, coupling, stress_slopes, slopes, .. } = &mut *sensitivities;
    let coupling = *coupling;
    let (mut packed, mut directions, mut weights) = (Vec::new(), Vec::new(), Vec::new());
    let mut changes = Vec::new();
    for block in blocks {
        packed.push(&block.packed[..]);
        directions.push(&block.directions);
        weights.push(&block.weights[..]);
        changes.push(&mut block.acceleration[..]);
    }
    let network = model.network().filter(|_| model.has_force_network());
    if network.is_some() {
        let columns = changes.iter_mut().map(|column| &mut **column).collect();
        side_by_side(columns).into_par_iter().enumerate().for_each(|(chunk, columns)| {
            pairs.meet(chunk, (rooms, network), |hood, room| {
                start_with_shares(model, (hood, room), columns, &weights);
            });
        });
    }
    slopes.resize_with(pairs.chunks().min(WINDOW), Slopes::default);
    for window in (0..pairs.chunks()).step_by(WINDOW) {
        let chunks = window..(window + WINDOW).min(pairs.chunks());
        chunks.clone().into_par_iter().zip(&mut *slopes).for_each(|(chunk, slopes)| {
            let kept = Kept { coupling, stress_slopes };
            pairs.meet(chunk, (rooms, model.network()), |hood, room| {
                model.slopes(hood, kept, room, slopes);
            });
        });
        changes.par_iter_mut().enumerate().for_each(|(block, changes)| {
            let packed = [packed[block], packed.get(block + 1).copied().unwrap_or_default()];
            let columns = changes[window * CHUNK..].par_chunks_mut(CHUNK);
            let chunks = columns.zip(&*slopes).zip(chunks.clone());
            chunks.for_each(|((out, slopes), chunk)| {
                if network.is_none() {
                    out.fill(Vector([Lanes::ZERO; D]));
                }
                slopes.add_tangents(chunk * CHUNK, packed, directions[block], out);
            });
        });
    }
}

/// `δF` of a chunk of particles, block by block, as far as it comes from each block's weights directly: eight
/// particles at a time, whose derivatives by all weights stay in the cache meanwhile.
fn start_with_shares<const D: usize>(
    model: &dyn Model<D>,
    (hood, room): (Hood<'_>, &mut Room),
    mut blocks: Vec<&mut [Vector<Lanes, D>]>,
    weights: &[&[(usize, usize)]],
) {
    let count = model.network().map_or(0, |network| network.weights.len());
    let mut shares = std::mem::take(&mut room.shares);
    for first in (0..hood.near.len()).step_by(WIDTH) {
        let particles = first..(first + WIDTH).min(hood.near.len());
        shares.resize(particles.len() * D * count, 0.0);
        model.weight_shares(hood, first, room, &mut shares);
        for (out, weights) in blocks.iter_mut().zip(weights) {
            let rows = out[particles.clone()].iter_mut().zip(shares.chunks_exact(D * count));
            for (a, shares) in rows {
                *a = Vector([Lanes::ZERO; D]);
                for &(lane, weight) in *weights {
                    for axis in 0..D {
                        a[axis].set_lane(lane, shares[axis * count + weight]);
                    }
                }
            }
        }
    }
    room.shares = shares;
}

/// System: the pullback of [`accelerate`].
pub fn accelerate_pullback<const D: usize>(
    neighbours: Res<Neighbours<D>>,
    (law, rooms): (Res<Law<D>>, Res<Rooms>),
    cloud: Res<Cloud<D>>,
    mut adjoint: ResMut<AdjointCloud<D>>,
) {
    let (model, rooms, pairs) = (&*law.0, &*rooms, cloud.pairs(&neighbours));
    let one_way = model.passes_to_neighbours();
    let count = adjoint.parameters.len();
    adjoint.sum_parameters(count, |adjoint, sums| {
        let AdjointCloud { packed: lines, position, velocity, scalars, shares, near, .. } = adjoint;
        shares.resize_with(near.len(), Vec::new);
        let forces: &[PackedAdjoint] = lines;
        let places = position.par_chunks_mut(CHUNK).zip(velocity.par_chunks_mut(CHUNK));
        let places = places.zip(scalars.par_chunks_mut(CHUNK)).zip(shares);
        let places = places.zip(sums.par_chunks_mut(count));
        near.par_iter().zip(places).for_each(|(near, (place, sums))| {
            let (((position, velocity), scalars), neighbours) = place;
            let places = if one_way { WIDTH * near.batches() } else { 0 };
            neighbours.resize(places, PairShare::ZERO);
            let into = Passed { position, velocity, scalars, neighbours };
            rooms.enter(model.network(), |room| {
                room.clear();
                model.pull_back(pairs.hood(near), forces, room, into);
                room.write_sums(sums);
            });
        });
    });
    if one_way {
        let AdjointCloud { senders, near, .. } = &mut *adjoint;
        senders.find(near, cloud.len());
        fetch_shares(&mut adjoint);
    }
}

/// Each particle takes what its neighbours' forces have left for it.
fn fetch_shares<const D: usize>(adjoint: &mut AdjointCloud<D>) {
    let AdjointCloud { position, velocity, scalars, shares, senders, .. } = adjoint;
    let rows = position.par_iter_mut().zip(velocity).zip(scalars).enumerate();
    rows.with_min_len(CHUNK).for_each(|(slot, ((position, velocity), scalars))| {
        for &[chunk, place] in senders.of(slot) {
            let share = &shares[chunk as usize][place as usize];
            *position += share.position;
            *velocity += share.velocity;
            scalars.0 += share.stress;
            scalars.1 += share.density;
        }
    });
}

/// Who has each particle near, and where in its lists: the lists transposed, so that nobody searches.
#[derive(Clone, Debug, Default)]
pub struct Senders {
    /// Whether what follows belongs to the lists as they are.
    known: bool,
    /// Where each slot's senders start; one more at the end.
    start: Vec<u32>,
    /// Chunk and place in its lists, in the order of the senders' slots.
    places: Vec<[u32; 2]>,
}

impl Senders {
    /// The lists have changed.
    pub(super) fn forget(&mut self) {
        self.known = false;
    }

    /// Those of some lists of so many particles; nothing to do where they are known.
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
            // Nobody, behind the last, is counted behind the end.
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
                // Filling from the back turns each end into a start.
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
