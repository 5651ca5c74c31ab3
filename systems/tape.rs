//! The tape: what the adjoint must know of each force evaluation, kept on the way forward and taken
//! back, last first, on the way backward.

use super::neighbours::{Chunk, Neighbours};
use super::particles::{
    AccelerationAdjoint, AdjointCloud, Cloud, PositionAdjoint, VelocityAdjoint,
};
use super::verlet::{Clock, Integrator};
use crate::losses::StateAdjoint;
use crate::packed::{Packed, PackedAdjoint};
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

    /// Keeps how the loss depends on an observed frame, from the order of slots.
    pub fn push_frame(&mut self, step: u64, adjoint: &StateAdjoint<D>, slot_of_row: &[u32]) {
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

/// System: brings the cloud back to the last evaluation on the tape, and packs `∂L/∂F` for it.
pub fn rewind_evaluation<const D: usize>(
    mut tape: ResMut<Tape<D>>,
    (mut neighbours, mut cloud): (ResMut<Neighbours<D>>, ResMut<Cloud<D>>),
    (mut clock, mut adjoint): (ResMut<Clock>, ResMut<AdjointCloud<D>>),
    mut rows: Query<&mut AccelerationAdjoint<D>>,
) {
    let Some(mut evaluation) = tape.evaluations.pop() else { return };
    let count = evaluation.slot_of_row.len();
    std::mem::swap(&mut cloud.packed, &mut evaluation.packed);
    std::mem::swap(&mut cloud.slot_of_row, &mut evaluation.slot_of_row);
    std::mem::swap(&mut cloud.masks, &mut evaluation.masks);
    neighbours.chunks = std::mem::take(&mut evaluation.chunks);
    // They are older than the cells: whoever goes forward from here builds both anew.
    neighbours.invalidate();
    cloud.round(neighbours.space);
    clock.evaluated = evaluation.step;
    // The forces that begin a step see the pairs of those that ended the one before.
    if adjoint.sifted != Some(evaluation.step) {
        adjoint.sift(cloud.pairs(&neighbours));
        adjoint.sifted = Some(evaluation.step);
    }
    tape.discard(evaluation);
    adjoint.packed.clear();
    adjoint.packed.resize(count + 1, PackedAdjoint::ZERO);
    let AdjointCloud { position, velocity, .. } = &mut *adjoint;
    for column in [position, velocity] {
        column.clear();
        column.resize(count, Vector::zero());
    }
    let mut slots = cloud.slot_of_row.iter();
    for column in rows.contiguous_iter_mut().into_iter().flatten() {
        for (a, &slot) in column.into_iter().zip(&mut slots) {
            adjoint.packed[slot as usize].force = a.0.to_3d();
            a.0 = Vector::zero();
        }
    }
    let AdjointCloud { scalars, carried, .. } = &mut *adjoint;
    scalars.clear();
    scalars.resize(count, (0.0, 0.0));
    for (&share, &slot) in carried.iter().zip(&cloud.slot_of_row) {
        scalars[slot as usize] = share;
    }
    carried.clear();
}

/// System: the pullback of packing: what an evaluation passed back goes to the particles. Where the
/// force saw the velocity predicted with the carried force, that force has its share.
pub fn unpack_adjoint<const PREDICTED: bool, const D: usize>(
    mut rows: Query<(
        &mut PositionAdjoint<D>,
        &mut VelocityAdjoint<D>,
        &mut AccelerationAdjoint<D>,
    )>,
    (cloud, adjoint): (Res<Cloud<D>>, Res<AdjointCloud<D>>),
    integrator: Res<Integrator>,
) {
    let mut slots = cloud.slot_of_row.iter();
    for (positions, velocities, accelerations) in rows.contiguous_iter_mut().into_iter().flatten() {
        let columns = positions.into_iter().zip(velocities).zip(accelerations);
        for (((r, v), a), &slot) in columns.zip(&mut slots) {
            let through = adjoint.velocity[slot as usize];
            r.0 += adjoint.position[slot as usize];
            v.0 += through;
            if PREDICTED {
                a.0 += through * (0.5 * integrator.dt);
            }
        }
    }
}

/// System: adds the loss of the step just come back to.
pub fn add_loss<const D: usize>(
    mut rows: Query<(&mut PositionAdjoint<D>, &mut VelocityAdjoint<D>)>,
    clock: Res<Clock>,
    (mut tape, mut adjoint): (ResMut<Tape<D>>, ResMut<AdjointCloud<D>>),
) {
    let Some(frame) = tape.frames.pop_if(|frame| frame.step == clock.step) else { return };
    let mut shares = frame.position.iter().zip(&frame.velocity);
    for (positions, velocities) in rows.contiguous_iter_mut().into_iter().flatten() {
        for ((r, v), (&by_r, &by_v)) in positions.into_iter().zip(velocities).zip(&mut shares) {
            r.0 += by_r;
            v.0 += by_v;
        }
    }
    // The loss of a step saw the densities of its last evaluation.
    adjoint.carried.resize(frame.density.len(), (0.0, 0.0));
    adjoint.carried.iter_mut().zip(&frame.density).for_each(|(share, by)| share.1 += by);
    tape.spare.1.push(frame);
}
