//! The tape: what the adjoint needs of each force evaluation, recorded forwards and taken back in
//! reverse order.

use super::neighbours::{Chunk, Neighbours};
use super::particles::{
    AdjointCloud, Densities, EvaluatedPairs, PairInputs, ParticleId, PositionAdjoint,
    VelocityAdjoint,
};
use super::verlet::Clock;
use crate::losses::StateAdjoint;
use crate::packed::Packed;
use crate::space::Space;
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use std::sync::Arc;

/// One force evaluation: the packed particles and their neighbour lists.
#[derive(Clone, Debug, Default)]
pub struct Evaluation {
    packed: Vec<Packed>,
    slot_of_row: Vec<u32>,
    chunks: Arc<Vec<Chunk>>,
    /// The box of these lists.
    embedded: Option<Space>,
    /// Masks of the neighbours within the support; see [`Densities::masks`].
    masks: Vec<Vec<u8>>,
    /// The step of these positions.
    step: u64,
}

impl Evaluation {
    /// Bytes held, without the lists.
    fn bytes(&self) -> usize {
        let masks: usize = self.masks.iter().map(Vec::len).sum();
        64 * self.packed.len() + 4 * self.slot_of_row.len() + masks
    }
}

/// The derivatives of the loss of one observed frame by its state.
#[derive(Clone, Debug, Default)]
pub struct FrameAdjoint<const D: usize> {
    /// The observed step.
    pub step: u64,
    /// `∂L/∂r` by row.
    pub position: Vec<Vector<f64, D>>,
    /// `∂L/∂v` by row.
    pub velocity: Vec<Vector<f64, D>>,
    /// `∂L/∂ρ` by row, where ρ are the densities of the step's last evaluation, which the loss
    /// uses.
    pub density: Vec<f64>,
    /// `(place in the flat vector, ∂L/∂parameter)` of parameters that the loss depends on directly.
    pub parameters: Vec<(usize, f64)>,
}

impl<const D: usize> FrameAdjoint<D> {
    /// Bytes held per particle.
    pub const BYTES: usize = 8 * (2 * D + 1);

    fn bytes(&self) -> usize {
        Self::BYTES * self.position.len()
    }

    /// Fills it from columns in the order of slots.
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

    /// Adds another loss of the same frame, from columns in the order of slots.
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

/// The force evaluations and observed frames recorded forwards.
#[derive(Resource, Clone, Debug, Default)]
pub struct Tape<const D: usize> {
    evaluations: Vec<Evaluation>,
    frames: Vec<FrameAdjoint<D>>,
    /// Memory of evaluations and frames taken back, to be reused.
    spare: (Vec<Evaluation>, Vec<FrameAdjoint<D>>),
    /// Whether evaluations are recorded; off where only the state at the end is wanted.
    pub running: bool,
}

impl<const D: usize> Tape<D> {
    /// Removes everything.
    pub fn clear(&mut self) {
        while let Some(evaluation) = self.evaluations.pop() {
            self.discard(evaluation);
        }
        self.spare.1.append(&mut self.frames);
    }

    /// Records the derivatives of a loss of an observed frame, in the order of slots; several
    /// losses of one frame are added.
    pub fn push_frame(&mut self, step: u64, adjoint: &StateAdjoint<D>, slot_of_row: &[u32]) {
        if let Some(frame) = self.frames.last_mut().filter(|frame| frame.step == step) {
            return frame.add(adjoint, slot_of_row);
        }
        let mut frame = self.spare.1.pop().unwrap_or_default();
        frame.fill(step, adjoint, slot_of_row);
        self.frames.push(frame);
    }

    /// Records the derivatives of a loss of a frame, particle `k` in row `k`.
    pub(crate) fn push_cotangent(&mut self, frame: &FrameAdjoint<D>) {
        let mut kept = self.spare.1.pop().unwrap_or_default();
        kept.clone_from(frame);
        self.frames.push(kept);
    }

    /// Records a force evaluation.
    fn push(&mut self, evaluated: &EvaluatedPairs<'_, D>, step: u64) {
        let EvaluatedPairs { neighbours, inputs, densities } = evaluated;
        let mut evaluation = self.spare.0.pop().unwrap_or_default();
        evaluation.packed.clone_from(&inputs.packed);
        evaluation.slot_of_row.clear();
        evaluation.slot_of_row.extend_from_slice(neighbours.order().slots());
        evaluation.masks.clone_from(&densities.masks);
        (evaluation.chunks, evaluation.step) = (Arc::clone(&neighbours.chunks), step);
        evaluation.embedded = Some(neighbours.embedded);
        self.evaluations.push(evaluation);
    }

    /// Restores the pairs of the last evaluation, and returns the step that its positions belong
    /// to.
    pub(super) fn rewind(
        &mut self,
        (inputs, densities): (&mut PairInputs, &mut Densities),
        neighbours: &mut Neighbours<D>,
    ) -> Option<u64> {
        let mut evaluation = self.evaluations.pop()?;
        let step = evaluation.step;
        std::mem::swap(&mut inputs.packed, &mut evaluation.packed);
        std::mem::swap(&mut densities.masks, &mut evaluation.masks);
        let embedded = evaluation.embedded.unwrap_or(neighbours.space);
        let chunks = std::mem::take(&mut evaluation.chunks);
        neighbours.rewind(chunks, &mut evaluation.slot_of_row, embedded);
        inputs.round(embedded);
        self.discard(evaluation);
        Some(step)
    }

    /// Keeps the memory of an evaluation for the next one.
    fn discard(&mut self, mut evaluation: Evaluation) {
        evaluation.chunks = Arc::default();
        self.spare.0.push(evaluation);
    }

    /// Number of force evaluations recorded.
    pub fn len(&self) -> usize {
        self.evaluations.len()
    }

    /// Whether no force evaluation is recorded.
    pub fn is_empty(&self) -> bool {
        self.evaluations.is_empty()
    }

    /// Bytes of what is recorded.
    pub fn bytes(&self) -> usize {
        let lists: usize = self
            .distinct_lists()
            .map(|chunks| chunks.iter().map(Chunk::bytes).sum::<usize>())
            .sum();
        let evaluations = self.evaluations.iter().map(Evaluation::bytes).sum::<usize>();
        evaluations + lists + self.frames.iter().map(FrameAdjoint::bytes).sum::<usize>()
    }

    /// Bytes of the memory kept for reuse.
    pub fn spare_bytes(&self) -> usize {
        let (evaluations, frames) = &self.spare;
        let evaluations = evaluations.iter().map(Evaluation::bytes).sum::<usize>();
        evaluations + frames.iter().map(FrameAdjoint::bytes).sum::<usize>()
    }

    /// The recorded lists; lists shared by successive evaluations come once.
    fn distinct_lists(&self) -> impl Iterator<Item = &Arc<Vec<Chunk>>> {
        let mut last: Option<&Arc<Vec<Chunk>>> = None;
        self.evaluations.iter().map(|e| &e.chunks).filter(move |chunks| {
            let new = last.is_none_or(|last| !Arc::ptr_eq(last, chunks));
            last = Some(chunks);
            new
        })
    }
}

/// System: records the force evaluation just made.
pub fn record_evaluation<const D: usize>(
    evaluated: EvaluatedPairs<'_, D>,
    clock: Res<Clock>,
    mut adjoint: ResMut<AdjointCloud<D>>,
    mut tape: ResMut<Tape<D>>,
) {
    // The neighbours found while running backwards are not those of this evaluation.
    adjoint.sifted = None;
    if tape.running {
        tape.push(&evaluated, clock.evaluated);
    }
}

/// System: adds the derivatives of the loss of the step just returned to.
pub fn add_loss<const D: usize>(
    mut rows: Query<(&ParticleId, &mut PositionAdjoint<D>, &mut VelocityAdjoint<D>)>,
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
    // The loss of a step uses the densities of its last evaluation.
    adjoint.carried.resize(frame.density.len(), (0.0, 0.0));
    adjoint.carried.iter_mut().zip(&frame.density).for_each(|(share, by)| share.1 += by);
    tape.spare.1.push(frame);
}
