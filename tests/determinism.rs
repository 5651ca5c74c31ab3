//! Bitwise reproducibility: for any number of threads, in every run, after every reset.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use crate::common;

use common::{FORCINGS, in_2d_and_3d, shaken};
use whirls::flow::State;
use whirls::learn::{Evaluation, Learner};
use whirls::parameters::Parameter;
use whirls::scene::{Learn, Weights};
use whirls::systems::verlet::Step;
use whirls::truth::Truth;
use whirls::{Flow, Scene};

in_2d_and_3d!(
    any_number_of_threads_makes_the_same_flow,
    any_number_of_threads_finds_the_same_gradient,
    a_second_run_has_the_bits_of_the_first,
    another_seed_makes_another_flow,
    a_reset_flow_has_the_bits_of_a_new_one,
    a_reset_flow_with_other_parameters_forgets_the_old_ones,
);

/// Particles of more than three chunks, so that threads share the work.
fn scene<const D: usize>() -> Scene {
    let mut scene = common::scene::<D>(if D == 2 { 30 } else { 10 });
    scene.initial.jitter = 0.1 * common::spacing(&scene);
    scene
}

/// Runs something on a pool of its own.
fn on_threads<T: Send>(threads: usize, run: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(run)
}

fn bits<const D: usize>(flow: &mut Flow<D>) -> Vec<u64> {
    let (state, densities) = (flow.state(), flow.densities());
    let accelerations = flow.accelerations();
    let vectors = state.positions.iter().chain(&state.velocities).chain(&accelerations);
    let numbers = vectors.flat_map(|x| x.0).chain(densities).chain([state.time]);
    numbers.map(f64::to_bits).collect()
}

fn run<const D: usize>(scene: &Scene, steps: usize) -> Vec<u64> {
    let mut flow = Flow::<D>::new(scene).unwrap();
    (0..steps).for_each(|_| flow.step().unwrap());
    bits(&mut flow)
}

fn any_number_of_threads_makes_the_same_flow<const D: usize>() {
    for (name, forcing) in FORCINGS {
        let mut scene = scene::<D>();
        scene.forcing = forcing;
        let one = on_threads(1, || run::<D>(&scene, 20));
        for threads in [2, 3] {
            let more = on_threads(threads, || run::<D>(&scene, 20));
            assert!(one == more, "forcing {name}, {threads} threads");
        }
    }
}

/// Loss, gradient and normal matrix of a wrong guess.
fn evaluation<const D: usize>(scene: &Scene) -> Evaluation {
    let learn = scene.learn.clone().unwrap();
    let truth = Truth::<D>::generate(scene, (3, learn.frames)).unwrap();
    let observations = truth.observations(scene, &learn).unwrap();
    let mut learner = Learner::new(scene, truth.states[0].clone(), observations).unwrap();
    let guess: Vec<f64> =
        learn.parameters.iter().map(|p| 1.1 * common::true_value(scene, p)).collect();
    learner.evaluate(&guess, learn.frames).unwrap()
}

fn any_number_of_threads_finds_the_same_gradient<const D: usize>() {
    let mut scene = scene::<D>();
    scene.forcing = FORCINGS[1].1.clone();
    scene.time.step = Step::KickDriftKick;
    scene.learn = Some(Learn {
        parameters: Parameter::PHYSICAL.to_vec(),
        loss: Weights { trajectory: 1.0, field: 1.0, kl: 1.0 },
        frames: 4,
        windows: Vec::new(),
        ..Scene::shipped("inverse-3d").unwrap().learn.unwrap()
    });
    let all_bits = |e: &Evaluation| -> Vec<u64> {
        let numbers = [e.loss, e.trajectory, e.field, e.kl].into_iter();
        numbers.chain(e.gradient.clone()).chain(e.normal.clone()).map(f64::to_bits).collect()
    };
    let one = on_threads(1, || evaluation::<D>(&scene));
    assert!(one.loss > 0.0 && one.gradient.iter().all(|&g| g != 0.0));
    for threads in [2, 3] {
        let more = on_threads(threads, || evaluation::<D>(&scene));
        assert_eq!(all_bits(&one), all_bits(&more), "{threads} threads");
    }
}

fn a_second_run_has_the_bits_of_the_first<const D: usize>() {
    for (name, forcing) in FORCINGS {
        let mut scene = scene::<D>();
        scene.forcing = forcing;
        assert!(run::<D>(&scene, 5) == run::<D>(&scene, 5), "forcing {name}");
    }
}

fn another_seed_makes_another_flow<const D: usize>() {
    let scene = scene::<D>();
    let mut other = scene.clone();
    other.seed += 1;
    let (a, b) = (State::<D>::initial(&scene), State::<D>::initial(&other));
    assert!(a.positions.iter().zip(&b.positions).all(|(a, b)| a != b));
    assert!(a.velocities.iter().zip(&b.velocities).all(|(a, b)| a != b));
    // The stochastic forcing is seeded, too: from one state, two flows.
    let mut stirred = scene.clone();
    stirred.forcing = FORCINGS[3].1.clone();
    let mut other = stirred.clone();
    other.seed += 1;
    let forces = |scene: &Scene| common::started(scene, &a).accelerations();
    assert!(forces(&stirred) != forces(&other));
}

fn a_reset_flow_has_the_bits_of_a_new_one<const D: usize>() {
    for step in Step::ALL {
        for (name, forcing) in FORCINGS {
            let mut scene = scene::<D>();
            (scene.time.step, scene.forcing) = (step, forcing);
            let start = shaken::<D>(&scene);
            let mut used = common::started(&scene, &State::<D>::initial(&scene));
            (0..7).for_each(|_| used.step().unwrap());
            used.reset(&start);
            assert_eq!(used.state(), start);
            let mut new = Flow::from_state(&scene, &start).unwrap();
            for k in 0..4 {
                used.step().unwrap();
                new.step().unwrap();
                assert!(bits(&mut used) == bits(&mut new), "{step:?}, forcing {name}, step {k}");
                assert_eq!(
                    (used.steps(), used.time().to_bits()),
                    (new.steps(), new.time().to_bits())
                );
            }
        }
    }
}

fn a_reset_flow_with_other_parameters_forgets_the_old_ones<const D: usize>() {
    let scene = scene::<D>();
    let start = shaken::<D>(&scene);
    let mut stiff = scene.clone();
    (stiff.fluid.c, stiff.fluid.gamma) = (8.0, 5.0);
    stiff.time.dt = Some(scene.dt());
    let mut used = common::started(&scene, &start);
    used.step().unwrap();
    used.set_learned(&[Parameter::C, Parameter::GAMMA], &[8.0, 5.0]).unwrap();
    used.reset(&start);
    used.step().unwrap();
    let mut new = common::started(&stiff, &start);
    new.step().unwrap();
    assert!(bits(&mut used) == bits(&mut new));
}
