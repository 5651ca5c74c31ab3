//! The pair forces, Eqs. (2) to (7), with their tangent and their pullback.

use super::neighbours::Neighbours;
use super::particles::{
    Acceleration, AdjointCloud, Cloud, Rooms, SensitivityBlock, SensitivityCloud, side_by_side,
};
use crate::cells::FEWEST;
use crate::models::{Columns, Model, PairShare, Passed};
use crate::packed::PackedAdjoint;
use crate::pairs::{CHUNK, Chunk, Hood, Lines};
use crate::scalar::{Lanes, WIDTH};
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use rayon::prelude::*;
use std::sync::{Arc, Weak};

/// The model that moves the particles of a World.
#[derive(Resource, Debug)]
pub struct Law<const D: usize>(pub Box<dyn Model<D>>);

/// Accelerations of all particles by the model's own force, in cell order.
pub fn model_accelerations<const D: usize>(
    neighbours: &Neighbours<D>,
    (model, rooms): (&dyn Model<D>, &Rooms),
    lines: Lines<'_>,
    acceleration: &mut [Vector<f64, D>],
) {
    let space = neighbours.space;
    let chunks = neighbours.chunks.par_iter().zip(acceleration.par_chunks_mut(CHUNK));
    chunks.for_each(|(chunk, out)| {
        let hood = Hood { lines, chunk, space };
        rooms.enter(model.network(), |room| model.accelerations(hood, room, out));
    });
}

/// System: the force of all pairs.
pub fn accelerate<const D: usize>(
    neighbours: Res<Neighbours<D>>,
    (law, rooms): (Res<Law<D>>, Res<Rooms>),
    mut cloud: ResMut<Cloud<D>>,
) {
    let (lines, acceleration) = cloud.lines_and_acceleration();
    model_accelerations(&neighbours, (&*law.0, &rooms), lines, acceleration);
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
pub fn accelerate_tangent<const D: usize>(
    neighbours: Res<Neighbours<D>>,
    (law, rooms): (Res<Law<D>>, Res<Rooms>),
    cloud: Res<Cloud<D>>,
    mut sensitivities: ResMut<SensitivityCloud<D>>,
) {
    let (model, rooms, space) = (&*law.0, &*rooms, neighbours.space);
    let SensitivityCloud { blocks, coupling, stress_slopes, weight_shares } = &mut *sensitivities;
    let lines = cloud.lines();
    let network = model.network().filter(|_| model.has_force_network());
    let count = network.map_or(0, |network| network.weights.len());
    weight_shares.resize(cloud.len() * D * count, 0.0);
    let shares = weight_shares.par_chunks_mut((CHUNK * D * count).max(1));
    neighbours.chunks.par_iter().zip(shares).for_each(|(chunk, shares)| {
        let hood = Hood { lines, chunk, space };
        rooms.enter(model.network(), |room| model.weight_shares(hood, room, shares));
    });
    let (mut out, mut columns) = (Vec::new(), Vec::new());
    for block in blocks {
        start_with_shares(block, weight_shares, count);
        out.push(&mut block.acceleration[..]);
        columns.push(Columns {
            sensitivities: &block.packed,
            directions: &block.directions,
            coupling: *coupling,
            stress_slopes,
        });
    }
    let chunks = neighbours.chunks.par_iter().zip(side_by_side(out));
    chunks.for_each(|(chunk, mut out)| {
        let hood = Hood { lines, chunk, space };
        rooms.enter(model.network(), |room| model.tangents(hood, &columns, room, &mut out));
    });
}

/// `δF` of a block as far as it comes from its weights directly.
fn start_with_shares<const D: usize>(
    block: &mut SensitivityBlock<D>,
    shares: &[f64],
    count: usize,
) {
    block.acceleration.fill(Vector([Lanes::ZERO; D]));
    if count == 0 {
        return;
    }
    let SensitivityBlock { acceleration, weights, .. } = block;
    let rows = acceleration.par_iter_mut().zip(shares.par_chunks_exact(D * count));
    rows.with_min_len(CHUNK).for_each(|(a, shares)| {
        for &(lane, weight) in &*weights {
            for axis in 0..D {
                a[axis].set_lane(lane, shares[axis * count + weight]);
            }
        }
    });
}

/// System: the pullback of [`accelerate`].
pub fn accelerate_pullback<const D: usize>(
    neighbours: Res<Neighbours<D>>,
    (law, rooms): (Res<Law<D>>, Res<Rooms>),
    cloud: Res<Cloud<D>>,
    mut adjoint: ResMut<AdjointCloud<D>>,
) {
    let (model, rooms, space) = (&*law.0, &*rooms, neighbours.space);
    let one_way = model.passes_to_neighbours();
    let count = adjoint.parameters.len();
    adjoint.sum_parameters(count, |adjoint, sums| {
        let AdjointCloud { packed: lines, position, velocity, scalars, shares, .. } = adjoint;
        shares.resize_with(neighbours.chunks.len(), Vec::new);
        let forces: &[PackedAdjoint] = lines;
        let places = position.par_chunks_mut(CHUNK).zip(velocity.par_chunks_mut(CHUNK));
        let places = places.zip(scalars.par_chunks_mut(CHUNK)).zip(shares);
        let places = places.zip(sums.par_chunks_mut(count));
        neighbours.chunks.par_iter().zip(places).for_each(|(chunk, (place, sums))| {
            let (((position, velocity), scalars), neighbours) = place;
            let places = if one_way { WIDTH * chunk.batches() } else { 0 };
            neighbours.resize(places, PairShare::ZERO);
            let into = Passed { position, velocity, scalars, neighbours };
            rooms.enter(model.network(), |room| {
                room.clear();
                model.pull_back(Hood { lines: cloud.lines(), chunk, space }, forces, room, into);
                room.write_sums(sums);
            });
        });
    });
    if one_way {
        adjoint.senders.find(&neighbours.chunks, cloud.len());
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

/// Who has each particle in a list, and where: the lists transposed, so that nobody searches.
#[derive(Clone, Debug, Default)]
pub struct Senders {
    /// The lists that these belong to; they may be gone.
    lists: Weak<Vec<Chunk>>,
    /// Where each slot's senders start; one more at the end.
    start: Vec<u32>,
    /// Chunk and place in its lists, in the order of the senders' slots.
    places: Vec<[u32; 2]>,
}

impl Senders {
    /// Those of some lists of so many particles; nothing to do where they are known.
    fn find(&mut self, lists: &Arc<Vec<Chunk>>, particles: usize) {
        if !std::ptr::eq(self.lists.as_ptr(), Arc::as_ptr(lists)) {
            self.lists = Arc::downgrade(lists);
            self.transpose(lists, particles);
        }
    }

    /// Counting sort of all places by the slot that they hold.
    fn transpose(&mut self, lists: &[Chunk], particles: usize) {
        self.start.clear();
        self.start.resize(particles + 2, 0);
        for &other in lists.iter().flat_map(Chunk::slots) {
            // Nobody, behind the last, is counted behind the end.
            self.start[other as usize + 1] += 1;
        }
        for slot in 0..particles {
            self.start[slot + 1] += self.start[slot];
        }
        self.start.truncate(particles + 1);
        self.places.resize(self.start[particles] as usize, [0; 2]);
        for (number, chunk) in lists.iter().enumerate().rev() {
            for (place, &other) in chunk.slots().iter().enumerate().rev() {
                // Filling from the back turns each end into a start.
                let Some(end) = self.start[1..].get_mut(other as usize) else { continue };
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
