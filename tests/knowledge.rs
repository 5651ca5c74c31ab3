//! What is known at the end of a search: errors, effects, and why it stopped.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use whirls::Scene;
use whirls::learn::{Learner, Outcome, Stop};
use whirls::truth::Truth;

fn scene(more: &[&str]) -> Scene {
    let small = [
        "fluid.particles_per_side=8",
        "fluid.smoothing_length=0.67",
        "learn.after=4",
        "learn.frames=4",
        "learn.windows=[1]",
    ];
    let overrides = small.iter().chain(more).map(|&key| key.to_owned());
    Scene::open("inverse-3d", &overrides.collect::<Vec<_>>()).unwrap()
}

fn truth(scene: &Scene) -> Truth<3> {
    let learn = scene.learn.as_ref().unwrap();
    Truth::generate(scene, (learn.after, learn.frames)).unwrap()
}

fn search(scene: &Scene, truth: &Truth<3>) -> Outcome {
    let mut learner = Learner::of_truth(scene, truth).unwrap();
    let guess = learner.guess(scene.seed);
    let outcome = learner.run(guess, &mut |_| Ok(())).unwrap();
    for (name, value) in learner.columns().iter().zip(&outcome.evaluation.parameters) {
        println!("  {name} {}", outcome.knowledge.value(name.name(), *value));
    }
    outcome.knowledge.lines().iter().for_each(|line| println!("  {line}"));
    outcome
}

fn learn(more: &[&str]) -> Outcome {
    let scene = scene(more);
    search(&scene, &truth(&scene))
}

/// A kernel that hardly reaches the next particle, in a fluid that is stable at its densities.
const LONELY: [&str; 5] = [
    "fluid.smoothing_length=0.3",
    "fluid.gamma=1.0",
    "fluid.c=1.0",
    "forcing={kind='none'}",
    "time.dt=0.01",
];

#[test]
fn exact_data_identify_every_parameter_at_round_off() {
    let outcome = learn(&[]);
    let knowledge = &outcome.knowledge;
    assert_eq!((knowledge.stopped_by, knowledge.window), (Stop::RoundOff, 4));
    assert!(knowledge.converged && knowledge.doubts.is_empty());
    assert!(["c", "alpha", "beta", "gamma"].iter().all(|&name| knowledge.identified[name]));
    assert!(knowledge.standard_error.values().all(|&error| error < 1e-9), "{knowledge:?}");
    // A smoothed field has fewer independent values than the mesh has nodes.
    let freedom = knowledge.degrees_of_freedom.unwrap();
    assert!(freedom > 100.0 && freedom < 3.0 * 512.0 * 4.0, "{freedom}");
    let text = knowledge.value("c", outcome.evaluation.parameters[0]);
    assert_eq!(text.split('.').nth(1).unwrap().len(), 12, "{text}");
}

#[test]
fn a_parameter_without_effect_is_not_identified() {
    // No particle is in reach of another.
    let outcome = learn(&[&LONELY[..], &["learn.after=0", "learn.frames=1"]].concat());
    for name in ["c", "alpha", "beta", "gamma"] {
        assert!(!outcome.knowledge.identified[name]);
        assert_eq!(outcome.knowledge.doubts[name], "no effect on the loss");
        let text = outcome.knowledge.value(name, 0.123_456_789);
        assert!(text.starts_with("not identified: no effect on the loss"), "{text}");
    }
}

#[test]
fn a_search_that_never_left_its_guess_says_so() {
    let outcome = learn(&["learn.optimiser={kind='levenberg-marquardt',damping=1e300}"]);
    assert!(!outcome.knowledge.converged);
    assert_eq!(outcome.knowledge.stopped_by, Stop::Stalled);
    assert_eq!(outcome.knowledge.doubts["c"], "did not move from its guess");
}

#[test]
fn a_search_cut_short_says_that_it_did_not_come_to_rest() {
    let outcome = learn(&["learn.iterations=3", "learn.windows=[]"]);
    assert_eq!(outcome.knowledge.stopped_by, Stop::Iterations);
    assert!(outcome.knowledge.identified.values().all(|identified| !identified));
    assert!(outcome.knowledge.lines()[0].contains("learn.iterations"));
}

#[test]
fn a_parameter_outside_what_a_scene_accepts_is_called_so() {
    let outside = ["learn.unbounded=['alpha']", "learn.guess={alpha=-0.5}", "learn.iterations=0"];
    let doubt = &learn(&outside).knowledge.doubts["alpha"];
    assert_eq!(doubt, "outside what a scene accepts, zero or more");
}

#[test]
fn parameters_that_the_data_tell_apart_badly_are_said_to_be_correlated() {
    // With few close pairs, stiffness and sound speed act only through their product.
    let outcome = learn(&[&LONELY[..], &["learn.windows=[]"]].concat());
    let correlated = &outcome.knowledge.correlated;
    assert!(correlated.iter().any(|(a, b, r)| a == "c" && b == "gamma" && r.abs() > 0.95));
}

#[test]
fn data_in_single_precision_end_at_their_noise_with_errors_that_hold() {
    let scene = scene(&[]);
    let mut single = truth(&scene);
    for state in &mut single.states {
        for x in state.positions.iter_mut().chain(&mut state.velocities).flat_map(|x| &mut x.0) {
            *x = f64::from(*x as f32);
        }
    }
    let outcome = search(&scene, &single);
    assert_eq!(outcome.knowledge.stopped_by, Stop::Noise);
    for (name, truth) in [("c", 10.0), ("alpha", 1.0), ("beta", 2.0), ("gamma", 7.0)] {
        let place = ["c", "alpha", "beta", "gamma"].iter().position(|own| *own == name).unwrap();
        let off = (outcome.evaluation.parameters[place] - truth).abs();
        let error = outcome.knowledge.standard_error[name];
        assert!(error < 1e-3 && off < 5.0 * error, "{name}: {off:e} against {error:e}");
    }
    let text = outcome.knowledge.value("c", outcome.evaluation.parameters[0]);
    assert!(text.contains('±'), "{text}");
}

#[test]
fn a_search_by_the_adjoint_says_that_it_has_no_normal_matrix_and_how_flat_its_loss_is() {
    let adjoint = ["learn.optimiser={kind='lbfgs'}", "learn.gradient='adjoint'"];
    let outcome = learn(&[&adjoint[..], &["learn.iterations=6"]].concat());
    let why = outcome.knowledge.no_standard_error.as_ref().unwrap();
    assert!(why.contains("the gradient comes from the adjoint"), "{why}");
    assert!(outcome.knowledge.relative_gradient.unwrap() > 1e-3);
    assert!(!outcome.knowledge.converged && outcome.knowledge.standard_error.is_empty());
    assert_eq!(outcome.knowledge.stopped_by, Stop::Iterations);
}
