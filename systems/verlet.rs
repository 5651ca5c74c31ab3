//! The step in time, appendix A.4: kicks and drifts, with their tangents.

use super::neighbours::Neighbours;
use super::particles::{
    Acceleration, AccelerationAdjoint, AccelerationSensitivity, BlockOf, Cloud, Position,
    PositionAdjoint, PositionSensitivity, SensitivityBlock, SensitivityCloud, Velocity,
    VelocityAdjoint, VelocitySensitivity, whole_column,
};
use crate::cells::FEWEST;
use crate::packed::PackedSensitivity;
use crate::pairs::CHUNK;
use crate::scalar::{Lanes, Pass, Wide, dispatch};
use crate::space::PeriodicBox;
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Which velocity the forces see, and how often they are evaluated.
///
/// | step | order | forces per step | |
/// |---|---|---|---|
/// | `kick-drift-kick` | 2 | 1 | default |
/// | `paper` | 1 with viscosity or forcing | 2 | reproduces the published data |
/// | `one-force` | 1 | 1 | only to be priced |
/// | `two-force` | 2 | 2 | only as a check |
///
/// The orders are asserted in `tests/convergence.rs`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Step {
    /// `v½ = v + dt/2 F`; `r' = r + dt v½`; `F' = F(r', v½ + dt/2 F)`; `v' = v½ + dt/2 F'`, and `F'`
    /// is the next step's `F`: it belongs to the state.
    #[default]
    KickDriftKick,
    /// `F = F(r, v)`; `v½ = v + dt/2 F`; `r' = r + dt v½`; `v' = v½ + dt/2 F(r', v½)`.
    Paper,
    /// The paper's step with `F(r', v½)` carried as the next step's `F`.
    OneForce,
    /// Kick-drift-kick with `F` evaluated anew at `(r', v')`.
    TwoForce,
}

impl Step {
    /// All steps.
    pub const ALL: [Self; 4] = [Self::KickDriftKick, Self::Paper, Self::OneForce, Self::TwoForce];

    /// Its name in scenes.
    pub fn name(self) -> &'static str {
        match self {
            Self::KickDriftKick => "kick-drift-kick",
            Self::Paper => "paper",
            Self::OneForce => "one-force",
            Self::TwoForce => "two-force",
        }
    }

    /// Whether each step begins with a force evaluation of its own.
    pub fn refreshes(self) -> bool {
        matches!(self, Self::Paper | Self::TwoForce)
    }

    /// Whether the force after the drift sees the velocity predicted to the end of the step.
    pub fn predicts(self) -> bool {
        matches!(self, Self::KickDriftKick | Self::TwoForce)
    }
}

/// How a World advances.
#[derive(Resource, Clone, Copy, Debug)]
pub struct Integrator {
    /// Kind of step.
    pub step: Step,
    /// Time step.
    pub dt: f64,
    /// The box that positions are wrapped into.
    pub space: PeriodicBox,
}

/// Where a World is in time.
#[derive(Resource, Clone, Copy, Debug, Default)]
pub struct Clock {
    /// Steps completed.
    pub step: u64,
    /// Step whose positions the forces see: `step` before the drift, `step + 1` after it.
    pub evaluated: u64,
    /// Time at step zero.
    pub start: f64,
}

impl Clock {
    /// Time at a step, without the drift of repeated addition.
    pub fn time_at(&self, step: u64, dt: f64) -> f64 {
        self.start + step as f64 * dt
    }
}

/// System: half a kick, `v += dt/2 F`.
pub fn kick<const D: usize>(
    mut particles: Query<(&mut Velocity<D>, &Acceleration<D>)>,
    integrator: Res<Integrator>,
) {
    let half = 0.5 * integrator.dt;
    for (mut velocities, accelerations) in particles.contiguous_iter_mut().into_iter().flatten() {
        let rows = velocities.par_iter_mut().zip(accelerations).with_min_len(FEWEST);
        rows.for_each(|(v, a)| v.0 += a.0 * half);
    }
}

/// System: the drift, `r += dt v`, back into the box.
pub fn drift<const D: usize>(
    mut particles: Query<(&mut Position<D>, &Velocity<D>)>,
    integrator: Res<Integrator>,
    mut clock: ResMut<Clock>,
) {
    for (mut positions, velocities) in particles.contiguous_iter_mut().into_iter().flatten() {
        let rows = positions.par_iter_mut().zip(velocities).with_min_len(FEWEST);
        rows.for_each(|(r, v)| r.0 = integrator.space.wrap(r.0 + v.0 * integrator.dt));
    }
    clock.evaluated = clock.step + 1;
}

/// System: the step is complete.
pub fn tick(mut clock: ResMut<Clock>) {
    clock.step += 1;
    clock.evaluated = clock.step;
}

/// System: the tangent of [`kick`].
pub fn kick_tangent<const D: usize>(
    mut blocks: Query<(&mut VelocitySensitivity<D>, &AccelerationSensitivity<D>)>,
    integrator: Res<Integrator>,
) {
    let factor = 0.5 * integrator.dt;
    for (mut velocities, accelerations) in blocks.contiguous_iter_mut().into_iter().flatten() {
        let rows = velocities.par_iter_mut().zip(accelerations).with_min_len(FEWEST);
        rows.for_each(|(v, a)| dispatch(Add { to: &mut v.0, rate: &a.0, factor }));
    }
}

/// System: the tangent of [`drift`].
pub fn drift_tangent<const D: usize>(
    mut blocks: Query<(&mut PositionSensitivity<D>, &VelocitySensitivity<D>)>,
    integrator: Res<Integrator>,
) {
    let factor = integrator.dt;
    for (mut positions, velocities) in blocks.contiguous_iter_mut().into_iter().flatten() {
        let rows = positions.par_iter_mut().zip(velocities).with_min_len(FEWEST);
        rows.for_each(|(r, v)| dispatch(Add { to: &mut r.0, rate: &v.0, factor }));
    }
}

/// Adds a rate times a factor.
struct Add<'a, const D: usize> {
    to: &'a mut Vector<Lanes, D>,
    rate: &'a Vector<Lanes, D>,
    factor: f64,
}

impl<const D: usize> Pass for Add<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(self) {
        for axis in 0..D {
            let rate = W::Double::load(&self.rate[axis]) * self.factor;
            self.to[axis] = (W::Double::load(&self.to[axis]) + rate).store();
        }
    }
}

/// System: packs `δr` and the `δv` of the velocity that the next force evaluation sees; where particles have
/// not `MOVED` since the last time, `δv` alone.
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
    let rows = &neighbours.cells.row_of_slot[..];
    let half = 0.5 * integrator.dt;
    sensitivities.blocks.par_iter_mut().enumerate().for_each(|(block, cloud)| {
        // Block by block, as they were spawned.
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

/// What one block is packed from.
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

impl<const D: usize> Pass for Pack<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(self) {
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
    cloud: Res<Cloud<D>>,
    sensitivities: Res<SensitivityCloud<D>>,
) {
    let (slots, blocks) = (&cloud.slot_of_row[..], &sensitivities.blocks[..]);
    for (of, mut a) in rows.contiguous_iter_mut().into_iter().flatten() {
        let chunks = a.par_chunks_mut(CHUNK).zip(of.par_chunks(CHUNK));
        chunks.for_each(|(a, of)| dispatch(Write { of, slots, blocks, a }));
    }
}

/// Writes some rows' `δF`.
struct Write<'a, const D: usize> {
    of: &'a [BlockOf],
    slots: &'a [u32],
    blocks: &'a [SensitivityBlock<D>],
    a: &'a mut [AccelerationSensitivity<D>],
}

impl<const D: usize> Pass for Write<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(self) {
        for (a, of) in self.a.iter_mut().zip(self.of) {
            let slot = self.slots[of.particle as usize] as usize;
            let found = &self.blocks[of.block as usize].acceleration[slot];
            for axis in 0..D {
                a.0[axis] = W::Double::load(&found[axis]).store();
            }
        }
    }
}

/// System: the pullback of [`kick`]: `∂L/∂F += dt/2 ∂L/∂v`.
pub fn kick_pullback<const D: usize>(
    mut particles: Query<(&mut AccelerationAdjoint<D>, &VelocityAdjoint<D>)>,
    integrator: Res<Integrator>,
) {
    let half = 0.5 * integrator.dt;
    for (accelerations, velocities) in particles.contiguous_iter_mut().into_iter().flatten() {
        for (a, v) in accelerations.into_iter().zip(velocities) {
            a.0 += v.0 * half;
        }
    }
}

/// System: the pullback of [`drift`]: `∂L/∂v += dt ∂L/∂r`.
pub fn drift_pullback<const D: usize>(
    mut particles: Query<(&mut VelocityAdjoint<D>, &PositionAdjoint<D>)>,
    integrator: Res<Integrator>,
) {
    for (velocities, positions) in particles.contiguous_iter_mut().into_iter().flatten() {
        for (v, r) in velocities.into_iter().zip(positions) {
            v.0 += r.0 * integrator.dt;
        }
    }
}

/// System: the pullback of [`tick`].
pub fn tick_pullback(mut clock: ResMut<Clock>) {
    clock.step = clock.step.saturating_sub(1);
}
