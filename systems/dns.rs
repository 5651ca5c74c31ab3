//! The World of a direct numerical simulation: a velocity field as a resource, tracers as entities, and the order of one
//! stage of a Runge–Kutta step.
//!
//! The mathematics stands in [`crate::dns`]; [`crate::dns::Solver`] runs these schedules. Tracers have the components
//! of every particle ([`Position`], [`Velocity`], [`Acceleration`], [`ParticleId`]) and a [`TracerStage`].

use super::particles::{Acceleration, ParticleId, Position, Velocity};
use crate::dns::{SpectralField, Splines};
use crate::space::Space;
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use bevy_ecs::schedule::{LogLevel, ScheduleBuildSettings, ScheduleLabel, SingleThreadedExecutor};
use rayon::prelude::*;

/// The order of one stage of a Runge–Kutta step.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum StagePhase {
    /// Velocities at the nodes, and their products `uᵢuⱼ`.
    Products,
    /// The force at the time of the stage.
    Force,
    /// The velocity of each tracer where the stage evaluates it.
    Interpolate,
    /// `û` of the next stage, or of the next step: advection, projection, viscosity and force.
    Advance,
    /// Tracers go to where the next stage evaluates their velocity, or the next step begins.
    Move,
    /// The stage is complete.
    Tick,
}

/// The schedules of a solver.
#[derive(ScheduleLabel, Clone, Debug, PartialEq, Eq, Hash)]
pub enum DnsSchedule {
    /// One stage of a step.
    Stage,
    /// Velocity and acceleration of each tracer where it is.
    Observe,
}

/// The velocity field.
#[derive(Resource, Debug)]
pub struct Field<const D: usize>(pub SpectralField<D>);

/// The field as tracers see it.
#[derive(Resource, Debug)]
pub struct Interpolant<const D: usize>(pub Splines<D>);

/// A tracer within a step: `dx/dt = u(x, t)` by the stages of the field's own scheme.
#[derive(Component, Clone, Copy, Debug)]
pub struct TracerStage<const D: usize> {
    /// Where the stage evaluates the velocity.
    pub position: Vector<f64, D>,
    /// The velocity there.
    pub velocity: Vector<f64, D>,
    /// `Σ share u dt` of the step so far.
    pub moved: Vector<f64, D>,
}

/// Tracers of a parallel task.
const CHUNK: usize = 64;

/// System: [`StagePhase::Products`].
pub fn evaluate_products<const D: usize>(mut field: ResMut<Field<D>>) {
    field.0.evaluate();
}

/// System: [`StagePhase::Force`].
pub fn evaluate_force<const D: usize>(mut field: ResMut<Field<D>>) {
    field.0.prepare_force();
}

/// System: [`StagePhase::Interpolate`].
pub fn interpolate_velocity<const D: usize>(
    mut field: ResMut<Field<D>>,
    mut interpolant: ResMut<Interpolant<D>>,
    mut tracers: Query<&mut TracerStage<D>, With<ParticleId>>,
) {
    field.0.interpolate(&mut interpolant.0);
    let splines = &interpolant.0;
    for mut column in tracers.contiguous_iter_mut().into_iter().flatten() {
        let chunks = column.par_chunks_mut(CHUNK).flatten_iter();
        chunks.for_each(|tracer| tracer.velocity = splines.at(tracer.position));
    }
}

/// System: [`StagePhase::Advance`].
pub fn advance_field<const D: usize>(mut field: ResMut<Field<D>>) {
    field.0.advance();
}

/// System: [`StagePhase::Move`].
pub fn move_tracers<const D: usize>(
    field: Res<Field<D>>,
    mut tracers: Query<(&mut Position<D>, &mut TracerStage<D>), With<ParticleId>>,
) {
    let (stage, dt, last) = (field.0.stage(), field.0.dt(), field.0.is_last_stage());
    let space = Space::cube(field.0.settings().length);
    for (mut positions, mut stages) in tracers.contiguous_iter_mut().into_iter().flatten() {
        for (position, tracer) in positions.iter_mut().zip(stages.iter_mut()) {
            tracer.moved += tracer.velocity * (dt * stage.share);
            tracer.position = position.0 + tracer.velocity * (dt * stage.next);
            if last {
                position.0 = space.wrap(position.0 + tracer.moved);
                (tracer.position, tracer.moved) = (position.0, Vector::zero());
            }
        }
    }
}

/// System: [`StagePhase::Tick`].
pub fn end_stage<const D: usize>(mut field: ResMut<Field<D>>) {
    field.0.tick();
}

/// System: the velocity of each tracer where it is.
pub fn observe_velocity<const D: usize>(
    mut field: ResMut<Field<D>>,
    mut interpolant: ResMut<Interpolant<D>>,
    mut tracers: Query<(&Position<D>, &mut Velocity<D>), With<ParticleId>>,
) {
    field.0.interpolate(&mut interpolant.0);
    let splines = &interpolant.0;
    for (positions, mut velocities) in tracers.contiguous_iter_mut().into_iter().flatten() {
        let rows = velocities.par_iter_mut().zip(positions).with_min_len(CHUNK);
        rows.for_each(|(velocity, position)| velocity.0 = splines.at(position.0));
    }
}

/// System: the acceleration of each tracer, `Du/Dt = −∇p + ν∇²u + f`.
pub fn observe_acceleration<const D: usize>(
    mut field: ResMut<Field<D>>,
    mut interpolant: ResMut<Interpolant<D>>,
    mut tracers: Query<(&Position<D>, &mut Acceleration<D>), With<ParticleId>>,
) {
    let acceleration = field.0.acceleration();
    field.0.interpolate_any(&acceleration, &mut interpolant.0);
    let splines = &interpolant.0;
    for (positions, mut accelerations) in tracers.contiguous_iter_mut().into_iter().flatten() {
        let rows = accelerations.par_iter_mut().zip(positions).with_min_len(CHUNK);
        rows.for_each(|(acceleration, position)| acceleration.0 = splines.at(position.0));
    }
}

/// An empty schedule, in which two systems that touch the same data without an order between them are an error.
fn empty(label: DnsSchedule) -> Schedule {
    let mut schedule = Schedule::new(label);
    schedule.set_executor(SingleThreadedExecutor::new());
    schedule.set_build_settings(ScheduleBuildSettings {
        ambiguity_detection: LogLevel::Error,
        ..ScheduleBuildSettings::new()
    });
    schedule
}

/// The schedule of one stage.
pub(crate) fn stepping<const D: usize>() -> Schedule {
    use StagePhase::{Advance, Force, Interpolate, Move, Products, Tick};
    let mut schedule = empty(DnsSchedule::Stage);
    schedule.configure_sets((Products, Force, Interpolate, Advance, Move, Tick).chain());
    let with_tracers = || resource_exists::<Interpolant<D>>;
    schedule.add_systems((
        evaluate_products::<D>.in_set(Products),
        evaluate_force::<D>.in_set(Force),
        interpolate_velocity::<D>.in_set(Interpolate).run_if(with_tracers()),
        advance_field::<D>.in_set(Advance),
        move_tracers::<D>.in_set(Move).run_if(with_tracers()),
        end_stage::<D>.in_set(Tick),
    ));
    schedule
}

/// The schedule of an observation.
pub(crate) fn observing<const D: usize>() -> Schedule {
    let mut schedule = empty(DnsSchedule::Observe);
    let both = (observe_velocity::<D>, observe_acceleration::<D>).chain();
    schedule.add_systems(both.run_if(resource_exists::<Interpolant<D>>));
    schedule
}

/// Names of the systems of one stage, in order.
pub const SYSTEMS_OF_A_STAGE: [&str; 6] = [
    "evaluate_products",
    "evaluate_force",
    "interpolate_velocity",
    "advance_field",
    "move_tracers",
    "end_stage",
];
