//! Builds a World from a scene: terms, resources, particles, sensitivity blocks.

use super::{Differentiation, State};
use crate::error::{Error, Result};
use crate::models::Model;
use crate::parameters::Parameters;
use crate::scalar::{F64x8, WIDTH};
use crate::scene::Scene;
use crate::sensitivity::Coupling;
use crate::systems::acceleration::{Laws, PairForces, PairTerm};
use crate::systems::density::DensitySummation;
use crate::systems::forcing;
use crate::systems::loss::{LossTerm, Losses};
use crate::systems::neighbours::{NeighbourSearch, Neighbours};
use crate::systems::packing::Packing;
use crate::systems::particles::{
    Acceleration, AccelerationAdjoint, AccelerationSensitivity, Accelerations, AdjointCloud,
    BlockOf, Densities, Density, LaneDerivatives, PairInputs, ParticleId, Particles, Position,
    PositionAdjoint, PositionSensitivity, SensitivityBlock, SensitivityCloud, Velocity,
    VelocityAdjoint, VelocitySensitivity,
};
use crate::systems::tape::Tape;
use crate::systems::term::Term;
use crate::systems::verlet::{Clock, Integrator, KickAndDrift};
use crate::systems::watch::{Failure, Watch};
use crate::vector::Vector;
use bevy_ecs::prelude::*;

pub(super) fn no_change<const D: usize>() -> Vector<F64x8, D> {
    Vector([F64x8::ZERO; D])
}

/// The pair laws of a scene: its model, and the added laws.
pub(super) fn laws_of<const D: usize>(scene: &Scene, model: Box<dyn Model<D>>) -> Laws<D> {
    let laminar = scene.fluid.viscosity.map(|viscosity| viscosity.law(model.medium().clone()));
    let added = laminar.into_iter().chain(scene.added_models(model.medium()));
    let added = added.map(|(name, model)| PairTerm::new(name, model)).collect();
    Laws { model: PairTerm::new(model.name().to_owned(), model), added }
}

/// The terms of a scene with these laws and losses, in the order in which those of one phase run.
pub(super) fn terms_of<const D: usize>(
    scene: &Scene,
    laws: &Laws<D>,
    losses: Option<&Losses<D>>,
) -> Result<Vec<Box<dyn Term<D>>>> {
    let mut terms: Vec<Box<dyn Term<D>>> = vec![
        Box::new(NeighbourSearch),
        Box::new(Packing),
        Box::new(KickAndDrift),
        Box::new(DensitySummation),
    ];
    for (number, law) in laws.all().enumerate() {
        let (name, specs) = (law.name.clone(), law.specs());
        terms.push(Box::new(PairForces { law: number, name, specs }));
    }
    terms.extend(forcing::terms(scene));
    terms.extend(scene.added_terms()?);
    let losses = losses.into_iter().flat_map(|losses| &losses.0).enumerate();
    terms.extend(losses.map(|(number, loss)| {
        let term: Box<dyn Term<D>> = Box::new(LossTerm { number, name: loss.name() });
        term
    }));
    terms.push(Box::new(Watch));
    Ok(terms)
}

/// All parameters of some terms, and the places of each term's own.
///
/// # Errors
/// [`Error::Input`] where two terms have one name, or disagree on a parameter.
pub(super) fn parameters_of<const D: usize>(
    terms: &[Box<dyn Term<D>>],
) -> Result<(Parameters, Vec<Vec<usize>>)> {
    let names: Vec<String> = terms.iter().map(|term| term.name()).collect();
    let twice = (0..names.len()).find(|&k| names[..k].contains(&names[k]));
    if let Some(twice) = twice {
        let remedy = "give one of the two another name";
        return Err(Error::input("the terms", "a name for each", &names[twice], remedy));
    }
    let specs: Vec<_> = terms.iter().map(|term| term.parameters()).collect();
    Parameters::merged(&specs)
}

pub(super) fn insert_motion<const D: usize>(world: &mut World, scene: &Scene) {
    let space = scene.space();
    let h = scene.fluid.smoothing_length;
    world.insert_resource(Integrator { step: scene.time.step, dt: scene.dt(), space });
    world.insert_resource(Clock::default());
    world.insert_resource(Neighbours::<D>::new(space, 2.0 * h, scene.time.skin * h));
    world.insert_resource(PairInputs { precision: scene.precision, ..PairInputs::default() });
    world.insert_resource(Densities::default());
    world.insert_resource(Accelerations::<D>::default());
    world.insert_resource(scene.limits);
    world.insert_resource(Failure::default());
}

/// Sets the places of the pair laws' parameters in the flat vector.
pub(super) fn place_laws<const D: usize>(
    laws: &mut Laws<D>,
    terms: &[Box<dyn Term<D>>],
    places: &[Vec<usize>],
) {
    for law in laws.all_mut() {
        let own = terms.iter().zip(places).find(|(term, _)| term.name() == law.name);
        let Some((_, own)) = own else { continue };
        law.places.clone_from(own);
    }
}

/// Spawns the particles, wrapped into the box, with the columns of an adjoint if one is run. All
/// components are spawned at once, because an entity that moves to another table leaves unused
/// memory in the old one.
pub(super) fn spawn_particles<const D: usize>(world: &mut World, state: &State<D>, adjoint: bool) {
    world.insert_resource(Particles(state.positions.len()));
    let rows = state.positions.iter().zip(&state.velocities).enumerate();
    let space = world.resource::<Integrator>().space;
    let particle = |(id, (&r, &v)): (usize, _)| {
        let moving = (Position(space.wrap(r)), Velocity(v), Acceleration::<D>::default());
        (ParticleId(id as u32), moving, Density::default())
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

/// The derivatives of the parameters by the lanes of every block, where each learned parameter is a lane.
///
/// # Errors
/// [`Error::Input`] for a parameter that no term has.
pub(super) fn lanes_of(
    differentiation: &Differentiation,
    parameters: &Parameters,
) -> Result<Vec<LaneDerivatives>> {
    let place = |name| parameters.place(name).ok_or_else(|| parameters.unknown(name));
    let places: Vec<usize> = differentiation.parameters.iter().map(place).collect::<Result<_>>()?;
    let block = |own: &[usize]| own.iter().enumerate().map(|(lane, &p)| (lane, p, 1.0)).collect();
    Ok(places.chunks(WIDTH).map(block).collect())
}

/// Spawns blocks of sensitivities, all zero, with the derivatives of the parameters by their lanes.
pub(super) fn spawn_sensitivities<const D: usize>(
    world: &mut World,
    count: usize,
    (coupling, lanes): (Coupling, Vec<LaneDerivatives>),
) {
    // All at once: a table that grows reserves twice its size.
    world.spawn_batch((0..lanes.len() * count).map(|row| {
        let zero = no_change::<D>();
        let of = BlockOf { particle: (row % count) as u32, block: (row / count) as u32 };
        let moving = (PositionSensitivity(zero), VelocitySensitivity(zero));
        (of, moving, AccelerationSensitivity(zero))
    }));
    let laws = world.resource::<Laws<D>>();
    let blocks = lanes.into_iter().map(|columns| {
        let mut block = SensitivityBlock::new(count, columns);
        block.seed(laws);
        block
    });
    let blocks = blocks.collect();
    world.insert_resource(SensitivityCloud::<D> {
        blocks,
        coupling,
        p_over_rho2_slopes: Vec::new(),
        pulls: Vec::new(),
        slopes: Vec::new(),
    });
}

pub(super) fn insert_adjoint<const D: usize>(world: &mut World, parameters: usize) {
    let adjoint = AdjointCloud::<D> { parameters: vec![0.0; parameters], ..Default::default() };
    world.insert_resource(adjoint);
    // Snapshots keep the positions from which lists were built.
    if let Some(neighbours) = world.remove_resource::<Neighbours<D>>() {
        world.insert_resource(neighbours.with_reference());
    }
    world.insert_resource(Tape::<D>::default());
}
