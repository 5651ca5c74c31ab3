//! The listed neighbours within the support, found chunk by chunk in the loops over pairs.

use super::acceleration::PairTerm;
use super::neighbours::Neighbours;
use crate::models::Scratch;
use crate::neighbours::near::Near;
use crate::pairs::{Chunk, Lines, Neighbourhood};
use crate::space::Space;

/// All pairs of an evaluation: the particles, their neighbour lists, and the masks of the
/// neighbours within the support.
///
/// The lists of neighbours within the support are written for one chunk of particles and
/// overwritten by the next: they stay in the cache, and are never held for the whole flow. An
/// adjoint reads them twice and does hold them all.
#[derive(Clone, Copy, Debug)]
pub struct Pairs<'a> {
    lines: Lines<'a>,
    chunks: &'a [Chunk],
    masks: &'a [Vec<u8>],
    space: Space,
}

impl<'a> Pairs<'a> {
    /// The pairs of these particles, with the masks written by the density summation.
    pub(super) fn new<const D: usize>(
        lines: Lines<'a>,
        neighbours: &'a Neighbours<D>,
        masks: &'a [Vec<u8>],
    ) -> Self {
        Self { lines, chunks: &neighbours.chunks, masks, space: neighbours.embedded }
    }

    /// Number of chunks.
    pub fn chunks(&self) -> usize {
        self.chunks.len()
    }

    /// Largest capacity of a chunk's lists, in eights.
    pub(super) fn fullest(&self) -> usize {
        self.chunks.iter().map(Chunk::most_masks).max().unwrap_or_default()
    }

    /// Finds the neighbours within the support of a chunk's particles.
    pub(super) fn find(&self, chunk: usize, near: &mut Near) {
        near.find(&self.chunks[chunk], &self.masks[chunk], self.lines.sentinel());
    }

    /// A chunk of particles, with access to all particles.
    pub(super) fn neighbourhood<'b>(&self, near: &'b Near) -> Neighbourhood<'b>
    where
        'a: 'b,
    {
        Neighbourhood { lines: self.lines, near, space: self.space }
    }

    /// Calls `work` with a chunk of particles and a scratch buffer for a law.
    pub(super) fn meet<T, const D: usize>(
        &self,
        chunk: usize,
        law: &PairTerm<D>,
        work: impl FnOnce(Neighbourhood<'_>, &mut Scratch) -> T,
    ) -> T {
        law.scratch_pool.enter(&*law.model, |scratch| {
            let mut near = std::mem::take(&mut scratch.near);
            self.find(chunk, &mut near);
            let result = work(self.neighbourhood(&near), scratch);
            scratch.near = near;
            result
        })
    }
}
