//! The order of systems: complete, and without a system that does nothing.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use crate::common;

use bevy_ecs::prelude::*;
use common::{FORCINGS, shaken};
use whirls::flow::{Differentiation, State};
use whirls::parameters::Parameter;
use whirls::scene::{Forcing, SHIPPED, Shipped};
use whirls::sensitivity::Coupling;
use whirls::systems::Phase;
use whirls::systems::particles::{Position, Velocity};
use whirls::systems::verlet::{Clock, Step};
use whirls::truth::Truth;
use whirls::{Flow, Scene};

/// A shipped scene with few particles: the order of systems does not depend on their number.
fn small<const D: usize>(name: &str) -> Scene {
    let mut scene = Scene::shipped(name).unwrap();
    scene.dimension = D;
    scene.fluid.particles_per_side = 6;
    scene.fluid.smoothing_length = 1.0;
    scene
}

/// The flow of a scene, with sensitivities, observations, both or neither.
fn flow<const D: usize>(scene: &Scene, (differentiate, observe): (bool, bool)) -> Flow<D> {
    let state = shaken::<D>(scene);
    let parameters = vec![Parameter::C, Parameter::ALPHA];
    let by = Differentiation { parameters, coupling: Coupling::Full };
    let observations = observe.then(|| {
        let mut truth = Truth::default();
        let mut flow = common::started(scene, &state);
        for _ in 0..3 {
            truth.keep(&mut flow);
            flow.step().unwrap();
        }
        truth.observations(scene, &scene.learn.clone().unwrap()).unwrap()
    });
    Flow::build(scene, &state, differentiate.then_some(&by), observations).unwrap()
}

fn every_flow<const D: usize>(check: impl Fn(&str, &mut Flow<D>)) {
    for Shipped { name, .. } in SHIPPED {
        for step in Step::ALL {
            for (forcing_name, forcing) in FORCINGS {
                for parts in [(false, false), (true, false), (false, true), (true, true)] {
                    let mut scene = small::<D>(name);
                    (scene.time.step, scene.forcing) = (step, forcing.clone());
                    let about = format!("{D}D {name} {step:?}, forcing {forcing_name}, {parts:?}");
                    check(&about, &mut flow::<D>(&scene, parts));
                }
            }
        }
    }
}

#[test]
fn no_two_systems_of_any_scene_may_run_in_either_order() {
    every_flow::<2>(|about, flow| flow.check_order().unwrap_or_else(|e| panic!("{about}: {e}")));
    every_flow::<3>(|about, flow| flow.check_order().unwrap_or_else(|e| panic!("{about}: {e}")));
}

#[test]
fn every_flow_takes_a_step_after_its_order_was_checked() {
    every_flow::<2>(|about, flow| {
        flow.check_order().unwrap();
        flow.step().unwrap_or_else(|e| panic!("{about}: {e}"));
    });
}

#[test]
fn a_system_without_an_order_is_refused() {
    fn drag(mut velocities: Query<&mut Velocity<2>>) {
        velocities.iter_mut().for_each(|mut v| v.0 = v.0 * 0.5);
    }
    fn count(positions: Query<&Position<2>>, mut clock: ResMut<Clock>) {
        clock.start += positions.iter().count() as f64;
    }
    let new = || Flow::<2>::new(&small::<2>("inverse-2d")).unwrap();

    let mut ordered = new();
    ordered.schedule_mut().add_systems(drag.after(Phase::SecondKick).before(Phase::Loss));
    ordered.check_order().unwrap();

    let mut within = new();
    within.schedule_mut().add_systems(drag.in_set(Phase::SecondKick));
    let error = within.check_order().unwrap_err();
    assert!(error.contains("drag") || error.contains("Ambiguit"), "{error}");

    let mut without = new();
    without.schedule_mut().add_systems(drag);
    assert!(without.check_order().is_err());
    let error = without.step().unwrap_err();
    assert!(error.exit_code() == 2 && error.to_string().contains("an order between"), "{error}");

    let mut counting = new();
    counting.schedule_mut().add_systems(count.in_set(Phase::Drift));
    assert!(counting.check_order().is_err());
}

/// A system added between two phases runs there, once a step.
#[test]
fn a_system_added_between_phases_runs_there() {
    fn stop(mut velocities: Query<&mut Velocity<3>>) {
        velocities.iter_mut().for_each(|mut v| v.0 = v.0 * 0.0);
    }
    let mut flow = Flow::<3>::new(&small::<3>("inverse-3d")).unwrap();
    flow.schedule_mut().add_systems(stop.after(Phase::SecondKick).before(Phase::Loss));
    let before: State<3> = flow.state();
    flow.step().unwrap();
    let after = flow.state();
    assert!(after.velocities.iter().all(|v| v.norm() == 0.0));
    assert!(before.positions != after.positions, "the drift came first");
}

fn names(scene: &Scene, parts: (bool, bool)) -> Vec<String> {
    if scene.dimension == 2 {
        flow::<2>(scene, parts).systems()
    } else {
        flow::<3>(scene, parts).systems()
    }
}

#[test]
fn nothing_is_scheduled_that_a_scene_does_not_need() {
    for dimension in [2, 3] {
        for step in Step::ALL {
            for (name, forcing) in FORCINGS {
                for parts in [(false, false), (true, false), (false, true), (true, true)] {
                    let mut scene = small::<2>("inverse-2d");
                    (scene.dimension, scene.time.step) = (dimension, step);
                    scene.forcing = forcing.clone();
                    let systems = names(&scene, parts);
                    let count = |part: &str| systems.iter().filter(|s| s.contains(part)).count();
                    assert!(!systems.is_empty(), "no names");
                    let evaluations = if step.refreshes() { 2 } else { 1 };
                    let about = format!("{step:?}, forcing {name}, {parts:?}: {systems:?}");
                    let tangents = |n: usize| if parts.0 { n } else { 0 };
                    assert_eq!(count("accelerate"), evaluations + tangents(evaluations), "{about}");
                    assert_eq!(count("tangent") > 0, parts.0, "{about}");
                    assert_eq!(count("pack_sensitivities") > 0, parts.0, "{about}");
                    assert_eq!(count("loss"), usize::from(parts.1), "{about}");
                    assert_eq!(
                        count("sum_density"),
                        1 + tangents(1),
                        "density once per position: {about}"
                    );
                    let (plain, random) = match scene.forcing {
                        Forcing::None => (0, 0),
                        Forcing::Deterministic { .. } => (evaluations, 0),
                        Forcing::Stochastic { .. } | Forcing::OrnsteinUhlenbeck { .. } => {
                            (0, evaluations)
                        }
                    };
                    assert_eq!(
                        count("force_deterministically"),
                        plain + tangents(plain),
                        "{about}"
                    );
                    let drawn = count("force_stochastically") + count("force_by_waves");
                    assert_eq!(drawn, random + tangents(random), "{about}");
                    assert_eq!(count("watch"), 1, "{about}");
                }
            }
        }
    }
}

/// The systems of shipped scenes when they simulate and when they learn: the step of Woodward et
/// al. (arXiv:2110.13311), forced.
const SIMULATE: &[&str] = &[
    "packing::pack_velocities",
    "acceleration::accelerate",
    "deterministic::force_deterministically",
    "packing::write_acceleration",
    "verlet::kick",
    "verlet::drift",
    "neighbours::find_neighbours",
    "packing::pack_velocities",
    "density::sum_density",
    "density::write_density",
    "acceleration::accelerate",
    "deterministic::force_deterministically",
    "packing::write_acceleration",
    "verlet::kick",
    "verlet::tick",
    "watch::watch",
];

const LEARN: &[&str] = &[
    "packing::pack_velocities",
    "packing::pack_sensitivities",
    "acceleration::accelerate",
    "acceleration::accelerate_tangent",
    "deterministic::force_deterministically",
    "deterministic::force_deterministically_tangent",
    "packing::write_acceleration",
    "packing::write_acceleration_tangent",
    "verlet::kick",
    "verlet::kick_tangent",
    "verlet::drift",
    "verlet::drift_tangent",
    "neighbours::find_neighbours",
    "packing::pack_velocities",
    "packing::pack_sensitivities",
    "density::sum_density",
    "density::write_density",
    "density::sum_density_tangent",
    "acceleration::accelerate",
    "acceleration::accelerate_tangent",
    "deterministic::force_deterministically",
    "deterministic::force_deterministically_tangent",
    "packing::write_acceleration",
    "packing::write_acceleration_tangent",
    "verlet::kick",
    "verlet::tick",
    "verlet::kick_tangent",
    "packing::pack_velocities",
    "packing::pack_sensitivities",
    "loss::accumulate_loss",
    "watch::watch",
];

#[test]
fn the_systems_of_the_shipped_scenes_are_these_in_this_order() {
    for Shipped { name, .. } in SHIPPED {
        let scene = Scene::shipped(name).unwrap();
        let mut scene = if scene.dimension == 2 { small::<2>(name) } else { small::<3>(name) };
        // Another step has another order; `nothing_is_scheduled_that_a_scene_does_not_need` has them all.
        scene.time.step = Step::Paper;
        assert_eq!(names(&scene, (false, false)), SIMULATE, "simulate {name}");
        assert_eq!(names(&scene, (true, true)), LEARN, "train {name}");
    }
}
