//! The tape: what the adjoint must know of each force evaluation, kept on the way forward and taken
//! back, last first, on the way backward.

use super::neighbours::{Chunk, Neighbours};
use super::particles::{AdjointCloud, Cloud, Identity, PositionAdjoint, VelocityAdjoint};
use super::verlet::Clock;
use crate::losses::StateAdjoint;
use crate::packed::Packed;
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use std::sync::Arc;

/// One force evaluation: the cloud as the pairs saw it, and who saw whom.
#[derive(Clone, Debug, Default)]
pub struct Evaluation {
    packed: Vec<Packed>,
    slot_of_row: Vec<u32>,
    chunks: Arc<Vec<Chunk>>,
    /// Who in them is near; see [`Cloud::masks`].
    masks: Vec<Vec<u8>>,
    /// Step whose positions these are.
    step: u64,
}

impl Evaluation {
    /// Bytes held, lists apart.
    fn bytes(&self) -> usize {
        let masks: usize = self.masks.iter().map(Vec::len).sum();
        64 * self.packed.len() + 4 * self.slot_of_row.len() + masks
    }
}

/// How the loss of one observed frame depends on its state.
#[derive(Clone, Debug, Default)]
pub struct FrameAdjoint<const D: usize> {
    /// The observed step.
    pub step: u64,
    /// `∂L/∂r` by row.
    pub position: Vec<Vector<f64, D>>,
    /// `∂L/∂v` by row.
    pub velocity: Vec<Vector<f64, D>>,
    /// `∂L/∂ρ` by row, through the densities of the step's last evaluation, which are those that the loss
    /// saw.
    pub density: Vec<f64>,
    /// `∂L/∂` of parameters that the loss depends on directly: place in the flat vector, and derivative.
    pub parameters: Vec<(usize, f64)>,
}

impl<const D: usize> FrameAdjoint<D> {
    /// Bytes held per particle.
    pub const BYTES: usize = 8 * (2 * D + 1);

    fn bytes(&self) -> usize {
        Self::BYTES * self.position.len()
    }

    /// From the order of slots.
    fn fill(&mut self, step: u64, adjoint: &StateAdjoint<D>, slot_of_row: &[u32]) {
        fn by_row<T: Copy>(into: &mut Vec<T>, column: &[T], slot_of_row: &[u32]) {
            into.clear();
            into.extend(slot_of_row.iter().map(|&slot| column[slot as usize]));
        }
        self.step = step;
        by_row(&mut self.position, &adjoint.position, slot_of_row);
        by_row(&mut self.velocity, &adjoint.velocity, slot_of_row);
        by_row(&mut self.density, &adjoint.density, slot_of_row);
        self.parameters.clone_from(&adjoint.parameters);
    }

    /// Adds another loss of the same frame, from the order of slots.
    fn add(&mut self, adjoint: &StateAdjoint<D>, slot_of_row: &[u32]) {
        let vectors = self.position.iter_mut().zip(&mut self.velocity).zip(&mut self.density);
        for (((r, v), rho), &slot) in vectors.zip(slot_of_row) {
            *r += adjoint.position[slot as usize];
            *v += adjoint.velocity[slot as usize];
            *rho += adjoint.density[slot as usize];
        }
        self.parameters.extend_from_slice(&adjoint.parameters);
    }
}

/// What was kept on the way forward.
#[derive(Resource, Clone, Debug, Default)]
pub struct Tape<const D: usize> {
    evaluations: Vec<Evaluation>,
    frames: Vec<FrameAdjoint<D>>,
    /// Memory of what was taken back, to be used again.
    spare: (Vec<Evaluation>, Vec<FrameAdjoint<D>>),
    /// Whether evaluations are kept; off where only the state at the end is wanted.
    pub running: bool,
}

impl<const D: usize> Tape<D> {
    /// Forgets everything.
    pub fn clear(&mut self) {
        while let Some(evaluation) = self.evaluations.pop() {
            self.discard(evaluation);
        }
        self.spare.1.append(&mut self.frames);
    }

    /// Keeps how a loss depends on an observed frame, from the order of slots; several losses of one frame add up.
    pub fn push_frame(&mut self, step: u64, adjoint: &StateAdjoint<D>, slot_of_row: &[u32]) {
        if let Some(frame) = self.frames.last_mut().filter(|frame| frame.step == step) {
            return frame.add(adjoint, slot_of_row);
        }
        let mut frame = self.spare.1.pop().unwrap_or_default();
        frame.fill(step, adjoint, slot_of_row);
        self.frames.push(frame);
    }

    /// Keeps a force evaluation.
    fn push(&mut self, cloud: &Cloud<D>, chunks: &Arc<Vec<Chunk>>, step: u64) {
        let mut evaluation = self.spare.0.pop().unwrap_or_default();
        evaluation.packed.clone_from(&cloud.packed);
        evaluation.slot_of_row.clone_from(&cloud.slot_of_row);
        evaluation.masks.clone_from(&cloud.masks);
        (evaluation.chunks, evaluation.step) = (Arc::clone(chunks), step);
        self.evaluations.push(evaluation);
    }

    /// Brings a cloud back to the last evaluation, and says to which step its positions belong.
    pub(super) fn rewind(
        &mut self,
        cloud: &mut Cloud<D>,
        neighbours: &mut Neighbours<D>,
    ) -> Option<u64> {
        let mut evaluation = self.evaluations.pop()?;
        let step = evaluation.step;
        std::mem::swap(&mut cloud.packed, &mut evaluation.packed);
        std::mem::swap(&mut cloud.slot_of_row, &mut evaluation.slot_of_row);
        std::mem::swap(&mut cloud.masks, &mut evaluation.masks);
        neighbours.chunks = std::mem::take(&mut evaluation.chunks);
        // They are older than the cells: the next step forwards builds both anew.
        neighbours.invalidate();
        cloud.round(neighbours.space);
        self.discard(evaluation);
        Some(step)
    }

    /// Leaves the memory of an evaluation for the next.
    fn discard(&mut self, mut evaluation: Evaluation) {
        evaluation.chunks = Arc::default();
        self.spare.0.push(evaluation);
    }

    /// Number of force evaluations kept.
    pub fn len(&self) -> usize {
        self.evaluations.len()
    }

    /// Whether no force evaluation is kept.
    pub fn is_empty(&self) -> bool {
        self.evaluations.is_empty()
    }

    /// Bytes of what is kept.
    pub fn bytes(&self) -> usize {
        let lists: usize = self
            .distinct_lists()
            .map(|chunks| chunks.iter().map(Chunk::bytes).sum::<usize>())
            .sum();
        let evaluations = self.evaluations.iter().map(Evaluation::bytes).sum::<usize>();
        evaluations + lists + self.frames.iter().map(FrameAdjoint::bytes).sum::<usize>()
    }

    /// Bytes of what is left to be used again.
    pub fn spare_bytes(&self) -> usize {
        let (evaluations, frames) = &self.spare;
        let evaluations = evaluations.iter().map(Evaluation::bytes).sum::<usize>();
        evaluations + frames.iter().map(FrameAdjoint::bytes).sum::<usize>()
    }

    /// Lists shared by successive evaluations count once.
    fn distinct_lists(&self) -> impl Iterator<Item = &Arc<Vec<Chunk>>> {
        let mut last: Option<&Arc<Vec<Chunk>>> = None;
        self.evaluations.iter().map(|e| &e.chunks).filter(move |chunks| {
            let new = last.is_none_or(|last| !Arc::ptr_eq(last, chunks));
            last = Some(chunks);
            new
        })
    }
}

/// System: keeps the force evaluation just made.
pub fn record_evaluation<const D: usize>(
    neighbours: Res<Neighbours<D>>,
    (clock, cloud): (Res<Clock>, Res<Cloud<D>>),
    mut adjoint: ResMut<AdjointCloud<D>>,
    mut tape: ResMut<Tape<D>>,
) {
    // Who was near on the way back is not who is near now.
    adjoint.sifted = None;
    if tape.running {
        tape.push(&cloud, &neighbours.chunks, clock.evaluated);
    }
}

/// System: adds the loss of the step just come back to.
pub fn add_loss<const D: usize>(
    mut rows: Query<(&Identity, &mut PositionAdjoint<D>, &mut VelocityAdjoint<D>)>,
    clock: Res<Clock>,
    (mut tape, mut adjoint): (ResMut<Tape<D>>, ResMut<AdjointCloud<D>>),
) {
    let Some(frame) = tape.frames.pop_if(|frame| frame.step == clock.step) else { return };
    for (ids, positions, velocities) in rows.contiguous_iter_mut().into_iter().flatten() {
        for ((r, v), id) in positions.into_iter().zip(velocities).zip(ids) {
            let row = id.0 as usize;
            if let (Some(&by_r), Some(&by_v)) = (frame.position.get(row), frame.velocity.get(row)) {
                r.0 += by_r;
                v.0 += by_v;
            }
        }
    }
    for &(place, by) in &frame.parameters {
        adjoint.parameters[place] += by;
    }
    // The loss of a step saw the densities of its last evaluation.
    adjoint.carried.resize(frame.density.len(), (0.0, 0.0));
    adjoint.carried.iter_mut().zip(&frame.density).for_each(|(share, by)| share.1 += by);
    tape.spare.1.push(frame);
}
