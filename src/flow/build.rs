//! From a scene to a World: resources, particles, sensitivity blocks.

use super::{Differentiation, State};
use crate::error::{Error, Result};
use crate::models::Parameter;
use crate::packed::PackedSensitivity;
use crate::scalar::{Lanes, WIDTH};
use crate::scene::{Forcing, Scene};
use crate::space::PeriodicBox;
use crate::systems::Stirring;
use crate::systems::forcing::{DeterministicForcing, StochasticForcing};
use crate::systems::neighbours::Neighbours;
use crate::systems::particles::{
    Acceleration, AccelerationAdjoint, AccelerationSensitivity, AdjointCloud, BlockOf, Cloud,
    Density, Identity, Position, PositionAdjoint, PositionSensitivity, Rooms, SensitivityBlock,
    SensitivityCloud, Velocity, VelocityAdjoint, VelocitySensitivity,
};
use crate::systems::tape::Tape;
use crate::systems::verlet::{Clock, Integrator};
use crate::systems::watch::Failure;
use crate::vector::Vector;
use bevy_ecs::prelude::*;

pub(super) fn no_change<const D: usize>() -> Vector<Lanes, D> {
    Vector([Lanes::ZERO; D])
}

/// Refuses a forcing that no system applies yet.
pub(super) fn must_have_systems(scene: &Scene) -> Result<()> {
    if matches!(scene.forcing, Forcing::OrnsteinUhlenbeck { .. }) {
        return Err(Error::input(
            format!("scene {}: forcing.kind", scene.name),
            "\"none\", \"deterministic\" or \"stochastic\"",
            "\"ornstein-uhlenbeck\", which no system applies yet",
            "choose one of these",
        ));
    }
    Ok(())
}

pub(super) fn insert_forcing(world: &mut World, scene: &Scene) -> Stirring {
    match scene.forcing {
        Forcing::None => Stirring::None,
        Forcing::Deterministic { power, .. } => {
            world.insert_resource(DeterministicForcing::new(power));
            Stirring::Deterministic
        }
        Forcing::Stochastic { interval, strength } => {
            world.insert_resource(StochasticForcing::new(scene.seed, interval, strength));
            Stirring::Stochastic
        }
        // Refused before a World is made, `must_have_systems`.
        Forcing::OrnsteinUhlenbeck { .. } => Stirring::None,
    }
}

pub(super) fn insert_motion<const D: usize>(world: &mut World, scene: &Scene) {
    let space = PeriodicBox { length: scene.fluid.box_length };
    let h = scene.fluid.smoothing_length;
    world.insert_resource(Integrator { step: scene.time.step, dt: scene.dt(), space });
    world.insert_resource(Clock::default());
    world.insert_resource(Neighbours::<D>::new(space, 2.0 * h, scene.time.skin * h));
    world.insert_resource(Cloud::<D> { precision: scene.precision, ..Cloud::default() });
    world.insert_resource(Rooms::default());
    world.insert_resource(scene.limits);
    world.insert_resource(Failure::default());
}

/// Particles, with the columns of an adjoint where one is run: all at once, since whoever moves to another
/// table leaves its memory behind.
pub(super) fn spawn_particles<const D: usize>(world: &mut World, state: &State<D>, adjoint: bool) {
    let rows = state.positions.iter().zip(&state.velocities).enumerate();
    let particle = |(id, (&r, &v)): (usize, _)| {
        let moving = (Position(r), Velocity(v), Acceleration::<D>::default());
        (Identity(id as u32), moving, Density::default())
    };
    if adjoint {
        let zeros = (
            PositionAdjoint::<D>::default(),
            VelocityAdjoint::<D>::default(),
            AccelerationAdjoint::<D>::default(),
        );
        world.spawn_batch(rows.map(|row| (particle(row), zeros)).collect::<Vec<_>>());
    } else {
        world.spawn_batch(rows.map(particle).collect::<Vec<_>>());
    }
    world.resource_mut::<Clock>().start = state.time;
}

pub(super) fn spawn_sensitivities<const D: usize>(
    world: &mut World,
    count: usize,
    differentiation: &Differentiation,
) {
    let blocks = differentiation.parameters.len().div_ceil(WIDTH);
    let mut cloud = SensitivityCloud::<D> {
        blocks: Vec::new(),
        coupling: differentiation.coupling,
        stress_slopes: Vec::new(),
        pulls: Vec::new(),
        slopes: Vec::new(),
    };
    // All at once: a table that grows keeps as much again in reserve.
    world.spawn_batch((0..blocks * count).map(|row| {
        let zero = no_change::<D>();
        let of = BlockOf { particle: (row % count) as u32, block: (row / count) as u32 };
        let moving = (PositionSensitivity(zero), VelocitySensitivity(zero));
        (of, moving, AccelerationSensitivity(zero))
    }));
    for block in 0..blocks {
        let mut directions = [Lanes::ZERO; Parameter::COUNT];
        let mut weights = Vec::new();
        let learned = differentiation.parameters.iter().skip(block * WIDTH).take(WIDTH);
        for (lane, &parameter) in learned.enumerate() {
            match parameter {
                Parameter::Weight(place) => weights.push((lane, place as usize)),
                physical => directions[physical.index()] = Lanes::unit(lane),
            }
        }
        cloud.blocks.push(SensitivityBlock {
            packed: vec![PackedSensitivity::ZERO; count],
            density: vec![Lanes::ZERO; count],
            acceleration: vec![no_change(); count],
            directions,
            weights,
        });
    }
    world.insert_resource(cloud);
}

pub(super) fn insert_adjoint<const D: usize>(world: &mut World, parameters: usize) {
    let adjoint = AdjointCloud::<D> { parameters: vec![0.0; parameters], ..Default::default() };
    world.insert_resource(adjoint);
    // Snapshots keep the positions that lists were built from.
    if let Some(neighbours) = world.remove_resource::<Neighbours<D>>() {
        world.insert_resource(neighbours.with_reference());
    }
    world.insert_resource(Tape::<D>::default());
}
