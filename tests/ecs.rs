//! A World can be used as such: a user's components, entities and systems do not change the bits of
//! the fluid, or are refused by name.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use crate::common;

use bevy_ecs::prelude::*;
use common::{in_2d_and_3d, shaken};
use whirls::flow::State;
use whirls::learn::{Evaluation, Learner};
use whirls::scene::{Scene, Weights};
use whirls::sensitivity::{Gradient, Storage};
use whirls::systems::particles::{ParticleId, Position, Velocity};
use whirls::systems::verlet::Step;
use whirls::truth::Truth;
use whirls::vector::Vector;
use whirls::{Error, Flow};

in_2d_and_3d!(
    a_component_added_to_some_particles_changes_no_bit,
    an_entity_with_a_position_that_is_no_particle_changes_no_bit,
    a_component_inserted_in_mid_run_changes_no_bit,
    a_despawned_particle_is_refused_by_name,
    a_particle_that_is_there_twice_is_refused_by_name,
);

/// A user's marker.
#[derive(Component)]
struct Marked;

/// A user's number.
#[derive(Component)]
struct Colour(#[expect(dead_code, reason = "it only has to be there")] u8);

const FRAMES: usize = 3;

/// A small rough flow that is compared with a truth by every loss.
fn scene<const D: usize>(step: Step) -> Scene {
    let mut scene = common::scene::<D>(if D == 2 { 12 } else { 7 });
    scene.forcing = common::FORCINGS[1].1.clone();
    scene.time.step = step;
    let mut learn = Scene::shipped("inverse-3d").unwrap().learn.unwrap();
    learn.loss = Weights { trajectory: 1.0, field: 1.0, kl: 1.0 };
    (learn.after, learn.frames, learn.windows) = (0, FRAMES, Vec::new());
    scene.learn = Some(learn);
    scene
}

fn learner<const D: usize>(scene: &Scene, gradient: Gradient, storage: Storage) -> Learner<D> {
    let mut scene = scene.clone();
    let truth = Truth::<D>::from_state(&scene, &shaken(&scene), FRAMES).unwrap();
    let learn = scene.learn.as_mut().unwrap();
    (learn.gradient, learn.storage) = (gradient, storage);
    Learner::of_truth(&scene, &truth).unwrap()
}

/// The bits of a state, particle by particle.
fn bits<const D: usize>(state: &State<D>) -> Vec<u64> {
    let all = state.positions.iter().chain(&state.velocities);
    all.flat_map(|x| x.0.map(f64::to_bits)).collect()
}

/// All bits of an evaluation.
fn found(evaluation: &Evaluation) -> Vec<u64> {
    let e = evaluation;
    let all = [e.loss, e.trajectory, e.field, e.kl].into_iter();
    all.chain(e.gradient.clone()).chain(e.normal.clone()).map(f64::to_bits).collect()
}

/// Flows, losses and gradients with a World that `change` modifies, before the first step or
/// between two, have the same bits as without.
fn same_bits<const D: usize>(change: impl Fn(&mut World), after: usize) {
    for step in [Step::KickDriftKick, Step::Paper] {
        let scene = scene::<D>(step);
        let start = shaken::<D>(&scene);
        let [mut plain, mut changed] =
            [(); 2].map(|()| Flow::<D>::from_state(&scene, &start).unwrap());
        for k in 0..8 {
            if k == after {
                change(changed.world_mut());
            }
            plain.step().unwrap();
            changed.step().unwrap();
            assert!(bits(&plain.state()) == bits(&changed.state()), "{step:?}, step {k}");
            assert_eq!(plain.densities(), changed.densities(), "{step:?}, step {k}");
            assert_eq!(plain.accelerations(), changed.accelerations(), "{step:?}, step {k}");
        }
        assert_eq!(plain.momentum_rates(), changed.momentum_rates(), "{step:?}");
        let at = [8.0, 0.7, 2.6, 5.2];
        for (gradient, storage) in [
            (Gradient::Forward, Storage::All),
            (Gradient::Adjoint, Storage::All),
            (Gradient::Adjoint, Storage::Checkpoints(1)),
        ] {
            let [mut plain, mut changed] =
                [(); 2].map(|()| learner::<D>(&scene, gradient, storage));
            if after > 0 {
                // An evaluation before: the change applies to a flow that has run.
                changed.evaluate(&at, FRAMES).unwrap();
            }
            change(changed.flow_mut().world_mut());
            let [plain, changed] =
                [&mut plain, &mut changed].map(|l| found(&l.evaluate(&at, FRAMES).unwrap()));
            assert!(plain == changed, "{step:?}, {gradient:?}, {storage:?}");
        }
    }
}

/// Marks every third particle, and colours one.
fn mark(world: &mut World) {
    let mut particles = world.query::<(Entity, &ParticleId)>();
    let all: Vec<(Entity, u32)> = particles.iter(world).map(|(e, id)| (e, id.0)).collect();
    for (entity, id) in all {
        if id % 3 == 1 {
            world.entity_mut(entity).insert(Marked);
        }
        if id == 17 {
            world.entity_mut(entity).insert(Colour(3));
        }
    }
}

fn a_component_added_to_some_particles_changes_no_bit<const D: usize>() {
    same_bits::<D>(mark, 0);
}

fn a_component_inserted_in_mid_run_changes_no_bit<const D: usize>() {
    same_bits::<D>(mark, 4);
}

fn an_entity_with_a_position_that_is_no_particle_changes_no_bit<const D: usize>() {
    let here = Vector([0.5; D]);
    let spawn = move |world: &mut World| {
        world.spawn(Position(here));
        world.spawn((Position(here), Velocity(Vector([1.0; D]))));
        world.spawn((Position(here), Marked));
    };
    same_bits::<D>(spawn, 0);
    same_bits::<D>(spawn, 3);
    // A probe does not move.
    let scene = scene::<D>(Step::KickDriftKick);
    let mut flow = Flow::<D>::from_state(&scene, &shaken(&scene)).unwrap();
    let probe = flow.world_mut().spawn((Position(here), Velocity(Vector([1.0; D])))).id();
    (0..3).for_each(|_| flow.step().unwrap());
    assert_eq!(flow.world().get::<Position<D>>(probe).unwrap().0, here);
}

fn entity<const D: usize>(flow: &mut Flow<D>, particle: u32) -> Entity {
    let world = flow.world_mut();
    let mut particles = world.query::<(Entity, &ParticleId)>();
    particles.iter(world).find(|(_, id)| id.0 == particle).unwrap().0
}

fn refused(result: Result<(), Error>, expected: &str) {
    let error = result.unwrap_err();
    assert_eq!(error.exit_code(), 2, "{error}");
    assert!(error.to_string().contains(expected), "{error}");
}

fn a_despawned_particle_is_refused_by_name<const D: usize>() {
    let scene = scene::<D>(Step::KickDriftKick);
    for (particle, before) in [(0, 0), (17, 2), (scene.particles() as u32 - 1, 3)] {
        let mut flow = Flow::<D>::from_state(&scene, &shaken(&scene)).unwrap();
        (0..before).for_each(|_| flow.step().unwrap());
        let gone = entity(&mut flow, particle);
        flow.world_mut().despawn(gone);
        refused(flow.step(), &format!("no entity with ParticleId({particle}): it was despawned"));
        // Queries that are still possible do not panic.
        let _ = (flow.state(), flow.densities(), flow.accelerations());
    }
    for gradient in [Gradient::Forward, Gradient::Adjoint] {
        let mut learner = learner::<D>(&scene, gradient, Storage::All);
        let gone = entity(learner.flow_mut(), 5);
        learner.flow_mut().world_mut().despawn(gone);
        let result = learner.evaluate(&[8.0, 0.7, 2.6, 5.2], FRAMES).map(|_| ());
        refused(result, "no entity with ParticleId(5)");
    }
    // A system of the step that removes one.
    let mut flow = Flow::<D>::from_state(&scene, &shaken(&scene)).unwrap();
    let take = |particles: Query<(Entity, &ParticleId)>, mut commands: Commands| {
        for (entity, _) in particles.iter().filter(|(_, id)| id.0 == 3) {
            commands.entity(entity).despawn();
        }
    };
    use whirls::systems::Phase;
    flow.schedule_mut().add_systems(take.after(Phase::FirstKick).before(Phase::Drift));
    refused(flow.step(), "no entity with ParticleId(3)");
}

fn a_particle_that_is_there_twice_is_refused_by_name<const D: usize>() {
    let scene = scene::<D>(Step::KickDriftKick);
    for (id, expected) in [(4, "2 entities with ParticleId(4)"), (100_000, "ParticleId(100000)")] {
        let mut flow = Flow::<D>::from_state(&scene, &shaken(&scene)).unwrap();
        flow.step().unwrap();
        flow.world_mut().spawn((ParticleId(id), Position(Vector([0.1; D]))));
        refused(flow.step(), expected);
        let _ = (flow.state(), flow.densities(), flow.accelerations());
    }
}
