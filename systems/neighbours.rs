//! The neighbour lists of a World: [`crate::neighbours`] as a term.

use super::particles::{ParticleId, Particles, Position};
use super::term::{Stage, Term};
use super::{Needs, Occasion, Phase};
pub use crate::neighbours::{CHUNK, Chunk, Neighbours, brute_force};
use crate::vector::Vector;
use bevy_ecs::prelude::*;

/// Term: the neighbour lists.
#[derive(Clone, Copy, Debug)]
#[doc(hidden)]
pub struct NeighbourSearch;

impl<const D: usize> Term<D> for NeighbourSearch {
    fn name(&self) -> String {
        "neighbours".to_owned()
    }

    fn stages(&self, occasion: Occasion, _: &Needs) -> Vec<Stage> {
        let stage = || Stage::constant(Phase::Neighbours, find_neighbours::<D>);
        if occasion.has_densities() { vec![stage()] } else { Vec::new() }
    }
}

/// System: brings the neighbour lists, and the order of slots, up to date.
#[doc(hidden)]
pub fn find_neighbours<const D: usize>(
    positions: Query<(&ParticleId, &Position<D>)>,
    particles: Res<Particles>,
    mut neighbours: ResMut<Neighbours<D>>,
) {
    let tables = positions.contiguous_iter().into_iter().flatten();
    let positions = particles.gather(tables, Position(Vector::zero()));
    neighbours.update(positions.len(), |row| positions[row].0);
}
