//! Packing: particles are gathered into arrays in cell order before a force evaluation, and forces are written back
//! after it; with the tangents and pullbacks of both.

use super::loss::Observations;
use super::near::Pairs;
use super::neighbours::Neighbours;
use super::particles::{
    Acceleration, AccelerationAdjoint, AccelerationSensitivity, Accelerations, AdjointCloud,
    BlockOf, Densities, PairInputs, ParticleId, Particles, Position, PositionAdjoint,
    PositionSensitivity, SensitivityBlock, SensitivityCloud, Velocity, VelocityAdjoint,
    VelocitySensitivity,
};
use super::tape::{Tape, record_evaluation};
use super::term::{Stage, Systems, Term};
use super::verlet::{Clock, Integrator};
use super::{Needs, Occasion, Phase};
use crate::neighbours::cells::MIN_PARALLEL_LEN;
use crate::packed::{PackedAdjoint, PackedSensitivity};
use crate::pairs::CHUNK;
use crate::scalar::{SimdFloat, SimdTask, dispatch};
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use rayon::prelude::*;
use std::borrow::Cow;

/// Term: packs the inputs of a force evaluation and writes its forces back.
#[derive(Clone, Copy, Debug)]
pub struct Packing;

impl<const D: usize> Term<D> for Packing {
    fn name(&self) -> String {
        "packing".to_owned()
    }

    fn stages(&self, occasion: Occasion, needs: &Needs) -> Vec<Stage> {
        let visible = match (occasion, needs.step.predicts()) {
            (Occasion::Reevaluate, _) => visible::<false, false, D>(),
            (Occasion::Step, true) => visible::<true, true, D>(),
            (Occasion::Start | Occasion::Step | Occasion::Restore, _) => {
                visible::<false, true, D>()
            }
        };
        if !occasion.has_forces() {
            return vec![visible];
        }
        let write: Systems = match needs.adjoint {
            true => (write_acceleration::<D>, record_evaluation::<D>).chain(),
            false => write_acceleration::<D>.into_configs(),
        };
        let back = Stage::new(Phase::Unpack, write)
            .tangent(write_acceleration_tangent::<D>)
            .pullback(rewind_evaluation::<D>);
        vec![visible, back]
    }
}

/// Packs velocities, predicted to the end of the step if `PREDICTED`, and positions if particles
/// have `MOVED`.
fn visible<const PREDICTED: bool, const MOVED: bool, const D: usize>() -> Stage {
    Stage::new(Phase::Pack, pack_velocities::<PREDICTED, MOVED, D>)
        .tangent(pack_sensitivities::<PREDICTED, MOVED, D>)
        .pullback(unpack_adjoint::<PREDICTED, D>)
}

/// Packs the velocities at the end of a step for the losses, where `observed` says so. The pullback
/// is part of the losses' own.
pub(super) fn observed<const D: usize>(
    observed: fn(Res<Clock>, Option<Res<Observations<D>>>) -> bool,
) -> Stage {
    Stage::constant(Phase::Loss, pack_velocities::<false, false, D>.run_if(observed))
        .tangent(pack_sensitivities::<false, false, D>.run_if(observed))
}

/// System: packs the velocity that the next force evaluation uses and, if particles have `MOVED`
/// since the last packing, their positions.
pub fn pack_velocities<const PREDICTED: bool, const MOVED: bool, const D: usize>(
    rows: Query<(&ParticleId, &Position<D>, &Velocity<D>, &Acceleration<D>)>,
    (particles, integrator): (Res<Particles>, Res<Integrator>),
    neighbours: Res<Neighbours<D>>,
    mut inputs: ResMut<PairInputs>,
) {
    let half_step = if PREDICTED { 0.5 * integrator.dt } else { 0.0 };
    let columns = || rows.contiguous_iter().into_iter().flatten();
    let zero = Vector::zero();
    let positions = particles.gather(columns().map(|(id, r, ..)| (id, r)), Position(zero));
    let velocities = particles.gather(columns().map(|(id, _, v, _)| (id, v)), Velocity(zero));
    let accelerations = particles.gather(columns().map(|(id, .., a)| (id, a)), Acceleration(zero));
    let rows = neighbours.order().rows();
    inputs.resize(rows.len());
    let lines = inputs.packed[..rows.len()].par_iter_mut().zip(rows).with_min_len(MIN_PARALLEL_LEN);
    lines.for_each(|(line, &row)| {
        let v = velocities[row as usize].0;
        let seen = if PREDICTED { v + accelerations[row as usize].0 * half_step } else { v };
        line.velocity = seen.to_3d();
        if MOVED {
            line.position = positions[row as usize].0.to_3d();
        }
    });
    inputs.round(neighbours.embedded);
}

/// All rows of a column of sensitivity blocks, in the order in which the blocks were spawned. Only
/// the flow spawns blocks, so that the order is known.
fn whole_column<'a, T: Clone>(mut parts: impl Iterator<Item = &'a [T]>) -> Cow<'a, [T]> {
    let first = parts.next().unwrap_or_default();
    let Some(second) = parts.next() else { return Cow::Borrowed(first) };
    let mut whole = [first, second].concat();
    parts.for_each(|part| whole.extend_from_slice(part));
    Cow::Owned(whole)
}

/// System: packs `δv` of the velocity that the next force evaluation uses and, if particles have
/// `MOVED` since the last packing, `δr`.
pub fn pack_sensitivities<const PREDICTED: bool, const MOVED: bool, const D: usize>(
    rows: Query<(
        &BlockOf,
        &PositionSensitivity<D>,
        &VelocitySensitivity<D>,
        &AccelerationSensitivity<D>,
    )>,
    integrator: Res<Integrator>,
    neighbours: Res<Neighbours<D>>,
    mut sensitivities: ResMut<SensitivityCloud<D>>,
) {
    let columns = || rows.contiguous_iter().into_iter().flatten();
    let positions = whole_column(columns().map(|(_, r, ..)| r));
    let velocities = whole_column(columns().map(|(_, _, v, _)| v));
    let accelerations = whole_column(columns().map(|(.., a)| a));
    let rows = neighbours.order().rows();
    let half = 0.5 * integrator.dt;
    sensitivities.blocks.par_iter_mut().enumerate().for_each(|(block, cloud)| {
        // Blocks are stored in the order in which they were spawned.
        let own = block * rows.len()..(block + 1) * rows.len();
        let columns = Columns {
            positions: MOVED.then_some(&positions[own.clone()]),
            velocities: &velocities[own.clone()],
            accelerations: PREDICTED.then_some(&accelerations[own]),
            half,
        };
        let chunks = cloud.packed.par_chunks_mut(CHUNK).zip(rows.par_chunks(CHUNK));
        chunks.for_each(|(lines, rows)| dispatch(Pack { columns, rows, lines }));
    });
}

/// The columns that one block is packed from.
#[derive(Clone, Copy)]
struct Columns<'a, const D: usize> {
    positions: Option<&'a [PositionSensitivity<D>]>,
    velocities: &'a [VelocitySensitivity<D>],
    accelerations: Option<&'a [AccelerationSensitivity<D>]>,
    half: f64,
}

/// Packs some slots of one block.
struct Pack<'a, const D: usize> {
    columns: Columns<'a, D>,
    rows: &'a [u32],
    lines: &'a mut [PackedSensitivity<D>],
}

impl<const D: usize> SimdTask for Pack<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Self { columns: Columns { positions, velocities, accelerations, half }, rows, lines } =
            self;
        for (line, &row) in lines.iter_mut().zip(rows) {
            let row = row as usize;
            if let Some(positions) = positions {
                for axis in 0..D {
                    line.position[axis] = W::Double::load(&positions[row].0[axis]).store();
                }
            }
            for axis in 0..D {
                let mut seen = W::Double::load(&velocities[row].0[axis]);
                if let Some(accelerations) = accelerations {
                    seen += W::Double::load(&accelerations[row].0[axis]) * half;
                }
                line.velocity[axis] = seen.store();
            }
        }
    }
}

/// System: writes `δF` back to the blocks.
pub fn write_acceleration_tangent<const D: usize>(
    mut rows: Query<(&BlockOf, &mut AccelerationSensitivity<D>)>,
    neighbours: Res<Neighbours<D>>,
    sensitivities: Res<SensitivityCloud<D>>,
) {
    let (slots, blocks) = (neighbours.order().slots(), &sensitivities.blocks[..]);
    for (of, mut a) in rows.contiguous_iter_mut().into_iter().flatten() {
        let chunks = a.par_chunks_mut(CHUNK).zip(of.par_chunks(CHUNK));
        chunks.for_each(|(a, of)| dispatch(Write { of, slots, blocks, a }));
    }
}

/// Writes `δF` of some rows.
struct Write<'a, const D: usize> {
    of: &'a [BlockOf],
    slots: &'a [u32],
    blocks: &'a [SensitivityBlock<D>],
    a: &'a mut [AccelerationSensitivity<D>],
}

impl<const D: usize> SimdTask for Write<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        for (a, of) in self.a.iter_mut().zip(self.of) {
            let slot = self.slots[of.particle as usize] as usize;
            let found = &self.blocks[of.block as usize].acceleration[slot];
            for axis in 0..D {
                a.0[axis] = W::Double::load(&found[axis]).store();
            }
        }
    }
}

/// System: writes the accelerations back to the particles.
pub fn write_acceleration<const D: usize>(
    mut rows: Query<(&ParticleId, &mut Acceleration<D>)>,
    neighbours: Res<Neighbours<D>>,
    accelerations: Res<Accelerations<D>>,
) {
    let order = neighbours.order();
    for (ids, mut column) in rows.contiguous_iter_mut().into_iter().flatten() {
        let rows = column.par_iter_mut().zip(ids).with_min_len(MIN_PARALLEL_LEN);
        rows.for_each(|(acceleration, id)| {
            if let Some(slot) = order.slot(id.0 as usize) {
                acceleration.0 = accelerations.0[slot];
            }
        });
    }
}

/// System: restores the pairs of the last evaluation on the tape, and packs `∂L/∂F` for it.
pub fn rewind_evaluation<const D: usize>(
    mut tape: ResMut<Tape<D>>,
    mut neighbours: ResMut<Neighbours<D>>,
    (mut inputs, mut densities): (ResMut<PairInputs>, ResMut<Densities>),
    (mut clock, mut adjoint): (ResMut<Clock>, ResMut<AdjointCloud<D>>),
    mut rows: Query<(&ParticleId, &mut AccelerationAdjoint<D>)>,
) {
    let restored = tape.rewind((&mut inputs, &mut densities), &mut neighbours);
    let Some(step) = restored else { return };
    clock.evaluated = step;
    // The forces that begin a step use the pairs of the evaluation that ended the step before.
    if adjoint.sifted != Some(step) {
        adjoint.sift(Pairs::new(inputs.lines(), &neighbours, &densities.masks));
        adjoint.sifted = Some(step);
    }
    let (count, order) = (inputs.len(), neighbours.order());
    adjoint.packed.clear();
    adjoint.packed.resize(count + 1, PackedAdjoint::ZERO);
    let AdjointCloud { position, velocity, .. } = &mut *adjoint;
    for column in [position, velocity] {
        column.clear();
        column.resize(count, Vector::zero());
    }
    for (ids, column) in rows.contiguous_iter_mut().into_iter().flatten() {
        for (a, id) in column.into_iter().zip(ids) {
            if let Some(slot) = order.slot(id.0 as usize) {
                adjoint.packed[slot].force = a.0.to_3d();
            }
            a.0 = Vector::zero();
        }
    }
    let AdjointCloud { scalars, carried, .. } = &mut *adjoint;
    scalars.clear();
    scalars.resize(count, (0.0, 0.0));
    for (&share, &slot) in carried.iter().zip(order.slots()) {
        scalars[slot as usize] = share;
    }
    carried.clear();
}

/// System: the pullback of packing: adds the derivatives that an evaluation passed back to the
/// particles. Where the force used a velocity predicted with the carried force, that force gets its
/// share.
pub fn unpack_adjoint<const PREDICTED: bool, const D: usize>(
    mut rows: Query<(
        &ParticleId,
        &mut PositionAdjoint<D>,
        &mut VelocityAdjoint<D>,
        &mut AccelerationAdjoint<D>,
    )>,
    (neighbours, adjoint): (Res<Neighbours<D>>, Res<AdjointCloud<D>>),
    integrator: Res<Integrator>,
) {
    for (ids, positions, velocities, accelerations) in
        rows.contiguous_iter_mut().into_iter().flatten()
    {
        let columns = positions.into_iter().zip(velocities).zip(accelerations);
        for (((r, v), a), id) in columns.zip(ids) {
            let Some(slot) = neighbours.order().slot(id.0 as usize) else { continue };
            let through = adjoint.velocity[slot];
            r.0 += adjoint.position[slot];
            v.0 += through;
            if PREDICTED {
                a.0 += through * (0.5 * integrator.dt);
            }
        }
    }
}
