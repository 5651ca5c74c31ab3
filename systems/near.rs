//! Who of the listed neighbours is near, chunk by chunk, as the loops over pairs come to it.

use super::acceleration::PairTerm;
use super::neighbours::Neighbours;
use crate::models::Room;
use crate::near::Near;
use crate::pairs::{Chunk, Hood, Lines};
use crate::space::PeriodicBox;

/// All pairs of an evaluation: the particles, their lists, and who in these is near.
///
/// Lists of who is near are written for one chunk of particles and forgotten behind it: they stay in the
/// cache, and no flow holds them all. An adjoint, which comes back to them twice, does.
#[derive(Clone, Copy, Debug)]
pub struct Pairs<'a> {
    lines: Lines<'a>,
    chunks: &'a [Chunk],
    masks: &'a [Vec<u8>],
    space: PeriodicBox,
}

impl<'a> Pairs<'a> {
    /// Particles, and the masks that their densities left for the lists.
    pub(super) fn new<const D: usize>(
        lines: Lines<'a>,
        neighbours: &'a Neighbours<D>,
        masks: &'a [Vec<u8>],
    ) -> Self {
        Self { lines, chunks: &neighbours.chunks, masks, space: neighbours.space }
    }

    /// How many chunks there are.
    pub fn chunks(&self) -> usize {
        self.chunks.len()
    }

    /// Most eights of a chunk that there have been, or room for more.
    pub(super) fn fullest(&self) -> usize {
        self.chunks.iter().map(Chunk::most_masks).max().unwrap_or_default()
    }

    /// Finds who is near the particles of a chunk.
    pub(super) fn find(&self, chunk: usize, near: &mut Near) {
        near.find(&self.chunks[chunk], &self.masks[chunk], self.lines.nobody());
    }

    /// A chunk of particles among all.
    pub(super) fn hood<'b>(&self, near: &'b Near) -> Hood<'b>
    where
        'a: 'b,
    {
        Hood { lines: self.lines, near, space: self.space }
    }

    /// Calls `work` with a chunk of particles and a room for a law.
    pub(super) fn meet<T, const D: usize>(
        &self,
        chunk: usize,
        law: &PairTerm<D>,
        work: impl FnOnce(Hood<'_>, &mut Room) -> T,
    ) -> T {
        law.rooms.enter(&*law.model, |room| {
            let mut near = std::mem::take(&mut room.near);
            self.find(chunk, &mut near);
            let result = work(self.hood(&near), room);
            room.near = near;
            result
        })
    }
}
