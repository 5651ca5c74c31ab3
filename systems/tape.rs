//! The tape: what the adjoint must know of each force evaluation, kept on the way forward and taken
//! back, last first, on the way backward.

use super::neighbours::{Chunk, Neighbours};
use super::particles::{
    AccelerationAdjoint, AdjointCloud, Cloud, PositionAdjoint, VelocityAdjoint,
};
use super::verlet::{Clock, Integrator};
use crate::packed::{Packed, PackedAdjoint};
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use std::sync::Arc;

/// One force evaluation: the cloud as the pairs saw it, and who saw whom.
#[derive(Clone, Debug)]
pub struct Evaluation {
    packed: Vec<Packed>,
    slot_of_row: Vec<u32>,
    chunks: Arc<Vec<Chunk>>,
    /// Step whose positions these are.
    step: u64,
}

/// How the loss of one observed frame depends on its state.
#[derive(Clone, Debug)]
pub struct FrameAdjoint<const D: usize> {
    /// The observed step.
    pub step: u64,
    /// `∂L/∂r` by row.
    pub position: Vec<Vector<f64, D>>,
    /// `∂L/∂v` by row.
    pub velocity: Vec<Vector<f64, D>>,
}

/// What was kept on the way forward.
#[derive(Resource, Clone, Debug, Default)]
pub struct Tape<const D: usize> {
    evaluations: Vec<Evaluation>,
    frames: Vec<FrameAdjoint<D>>,
    /// Whether evaluations are kept; off where only the state at the end is wanted.
    pub running: bool,
}

impl<const D: usize> Tape<D> {
    /// Forgets everything.
    pub fn clear(&mut self) {
        self.evaluations.clear();
        self.frames.clear();
    }

    /// Keeps how the loss depends on an observed frame.
    pub fn push_frame(&mut self, frame: FrameAdjoint<D>) {
        self.frames.push(frame);
    }

    /// Number of force evaluations kept.
    pub fn len(&self) -> usize {
        self.evaluations.len()
    }

    /// Whether no force evaluation is kept.
    pub fn is_empty(&self) -> bool {
        self.evaluations.is_empty()
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let evaluation = |e: &Evaluation| 64 * e.packed.len() + 4 * e.slot_of_row.len();
        let lists: usize = self
            .distinct_lists()
            .map(|chunks| chunks.iter().map(Chunk::bytes).sum::<usize>())
            .sum();
        let frames: usize = self.frames.iter().map(|f| 16 * D * f.position.len()).sum();
        self.evaluations.iter().map(evaluation).sum::<usize>() + lists + frames
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
    mut tape: ResMut<Tape<D>>,
) {
    if tape.running {
        tape.evaluations.push(Evaluation {
            packed: cloud.packed.clone(),
            slot_of_row: cloud.slot_of_row.clone(),
            chunks: Arc::clone(&neighbours.chunks),
            step: clock.evaluated,
        });
    }
}

/// System: brings the cloud back to the last evaluation on the tape, and packs `∂L/∂F` for it.
pub fn rewind_evaluation<const D: usize>(
    mut tape: ResMut<Tape<D>>,
    (mut neighbours, mut cloud): (ResMut<Neighbours<D>>, ResMut<Cloud<D>>),
    (mut clock, mut adjoint): (ResMut<Clock>, ResMut<AdjointCloud<D>>),
    mut rows: Query<&mut AccelerationAdjoint<D>>,
) {
    let Some(evaluation) = tape.evaluations.pop() else { return };
    let count = evaluation.slot_of_row.len();
    cloud.packed = evaluation.packed;
    cloud.slot_of_row = evaluation.slot_of_row;
    neighbours.chunks = evaluation.chunks;
    cloud.round(neighbours.space);
    clock.evaluated = evaluation.step;
    adjoint.packed.clear();
    adjoint.packed.resize(count + 1, PackedAdjoint::ZERO);
    let AdjointCloud { position, velocity, .. } = &mut *adjoint;
    for column in [position, velocity] {
        column.clear();
        column.resize(count, Vector::zero());
    }
    adjoint.scalars.resize(count, (0.0, 0.0));
    let mut slots = cloud.slot_of_row.iter();
    for column in rows.contiguous_iter_mut().into_iter().flatten() {
        for (a, &slot) in column.into_iter().zip(&mut slots) {
            adjoint.packed[slot as usize].force = a.0.to_3d();
            a.0 = Vector::zero();
        }
    }
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
    mut tape: ResMut<Tape<D>>,
) {
    let Some(frame) = tape.frames.pop_if(|frame| frame.step == clock.step) else { return };
    let mut frame = frame.position.into_iter().zip(frame.velocity);
    for (positions, velocities) in rows.contiguous_iter_mut().into_iter().flatten() {
        for ((r, v), (by_r, by_v)) in positions.into_iter().zip(velocities).zip(&mut frame) {
            r.0 += by_r;
            v.0 += by_v;
        }
    }
}
