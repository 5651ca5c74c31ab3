//! The shipped scenes learn the parameters of their own flow from guesses in (0, 1).

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use whirls::Scene;
use whirls::learn::{Learner, Outcome};
use whirls::parameters::Parameter;
use whirls::truth::Truth;

/// A search from the guess of a seed: how it ended, and the largest error of a parameter.
fn search<const D: usize>(scene: &Scene, learner: &mut Learner<D>, seed: u64) -> (Outcome, f64) {
    let guess = learner.guess(seed);
    assert!(guess.iter().all(|x| (0.0..1.0).contains(x)), "{guess:?}");
    let outcome = learner.run(guess, &mut |_| Ok(())).unwrap();
    let found = outcome.evaluation.parameters.iter();
    let known = scene.parameters();
    let error = |(p, x): (&Parameter, &f64)| (x - known.get(p).unwrap()).abs();
    let worst = learner.columns().iter().zip(found).map(error).fold(0.0, f64::max);
    (outcome, worst)
}

/// Number of seeds that converge: loss and parameters at round-off.
fn home<const D: usize>(name: &str, seeds: std::ops::Range<u64>) -> usize {
    let scene = Scene::shipped(name).unwrap();
    let learn = scene.learn.clone().unwrap();
    let truth = Truth::<D>::generate(&scene, (learn.after, learn.frames)).unwrap();
    let observations = truth.observations(&scene, &learn).unwrap();
    let mut learner = Learner::new(&scene, truth.states[0].clone(), observations).unwrap();
    println!("{name}\n seed  iterations  first loss  last loss  largest error");
    let mut home = 0;
    for seed in seeds {
        let (outcome, error) = search(&scene, &mut learner, seed);
        let loss = outcome.evaluation.loss;
        println!(
            "{seed:5} {:11} {:11.2e} {loss:10.2e} {error:14.1e}",
            outcome.iterations, outcome.initial_loss
        );
        home += usize::from(loss <= 1e-20 && error <= 1e-8);
    }
    home
}

#[test]
fn four_parameters_come_back_from_ten_steps_in_3d_for_nine_of_ten_guesses() {
    assert!(home::<3>("inverse-3d", 1..11) >= 9);
}

#[test]
fn the_power_of_the_forcing_comes_back_with_them() {
    assert!(home::<3>("inverse-3d-forcing", 1..11) >= 9);
}

#[test]
fn four_parameters_come_back_from_fifteen_steps_in_2d() {
    assert_eq!(home::<2>("inverse-2d", 1..2), 1);
}
