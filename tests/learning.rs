//! Every model of the hierarchy learns, with every mode of differentiation, to the same result.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use whirls::learn::{Learner, Outcome};
use whirls::scene::Scene;
use whirls::statistics::pressure_error;
use whirls::truth::Truth;
use whirls::{Flow, Result};

/// A shipped scene in few particles and frames.
fn small(name: &str, more: &[&str]) -> Scene {
    let mut overrides: Vec<String> = [
        "fluid.particles_per_side=8",
        "fluid.smoothing_length=0.67",
        "learn.after=4",
        "learn.frames=4",
    ]
    .map(str::to_owned)
    .to_vec();
    overrides.extend(more.iter().map(|&more| more.to_owned()));
    Scene::open(name, &overrides).unwrap()
}

fn learn(scene: &Scene) -> Result<(Outcome, Flow<3>, Truth<3>)> {
    let lesson = scene.learn.clone().unwrap();
    let truth = Truth::<3>::generate(scene, (lesson.after, lesson.frames))?;
    let mut learner = Learner::of_truth(scene, &truth)?;
    let guess = learner.guess(scene.seed);
    let outcome = learner.run(guess, &mut |_| Ok(()))?;
    let mut flow = Flow::build(scene, &truth.states[0], None, None)?;
    flow.set_learned(learner.columns(), &outcome.evaluation.parameters).unwrap();
    Ok((outcome, flow, truth))
}

#[test]
fn every_network_model_learns_field_and_statistics_from_random_weights() {
    for name in ["node-3d", "nn-sum-3d", "rot-inv-3d", "grad-p-3d"] {
        let (outcome, ..) = learn(&small(name, &["learn.iterations=40"])).unwrap();
        let (before, after) = (outcome.initial_loss, outcome.evaluation.loss);
        println!("{name}: {before:.2e} -> {after:.2e} in {} iterations", outcome.iterations);
        assert!(after < 0.2 * before, "{name}: {before} -> {after}");
        assert!(outcome.iterations <= 40);
    }
}

#[test]
fn the_equation_of_state_is_learned_within_one_per_cent() {
    let scene = small("eos-nn-3d", &["learn.iterations=40", "learn.model.height=6"]);
    let (outcome, flow, truth) = learn(&scene).unwrap();
    let error = pressure_error(&flow, &scene.fluid.constants(), truth.densities_seen());
    println!("loss {:.1e}, pressure within {:.3} %", outcome.evaluation.loss, 100.0 * error);
    assert!(outcome.evaluation.loss < 1e-8, "{}", outcome.evaluation.loss);
    assert!(error < 0.01, "{error}");
}

#[test]
fn a_warm_up_brings_the_statistical_loss_home() {
    let (outcome, ..) = learn(&small("physics-3d", &["learn.iterations=30"])).unwrap();
    let found = &outcome.evaluation.parameters;
    println!("{found:?} in {} iterations", outcome.iterations);
    for (found, truth) in found.iter().zip([10.0, 1.0, 2.0, 7.0]) {
        assert!((found - truth).abs() < 1e-3, "{found} against {truth}");
    }
}

#[test]
fn a_search_by_adjoint_ends_where_a_search_by_forward_gradients_does() {
    for name in ["nn-sum-3d", "eos-nn-3d"] {
        let search = |gradient: &str| {
            let gradient = format!("learn.gradient={gradient}");
            let more = [
                &gradient,
                "learn.iterations=6",
                "learn.windows=[]",
                "learn.optimiser={kind='lbfgs'}",
                "learn.model.height=3",
            ];
            learn(&small(name, &more)).unwrap().0.evaluation
        };
        let (forward, adjoint) = (search("forward"), search("adjoint"));
        assert!((forward.loss - adjoint.loss).abs() < 1e-8 * forward.loss, "{name}");
        for (a, b) in forward.parameters.iter().zip(&adjoint.parameters) {
            assert!((a - b).abs() < 1e-7 * (1.0 + a.abs()), "{name}: {a} against {b}");
        }
    }
}

#[test]
fn a_step_that_diverges_is_taken_back_and_the_search_goes_on() {
    // A rate at which the flow diverges after the second step.
    let more =
        ["learn.iterations=12", "learn.optimiser={kind='adam',rate=300.0}", "limits.energy=4"];
    let scene = small("nn-sum-3d", &more);
    let truth = Truth::<3>::generate(&scene, (4, 4)).unwrap();
    let mut learner = Learner::of_truth(&scene, &truth).unwrap();
    let guess: Vec<f64> = learner.guess(1).iter().map(|x| 0.01 * x).collect();
    let mut notes = Vec::new();
    let outcome = learner.run(guess, &mut |iteration| {
        notes.extend(iteration.note.clone());
        Ok(())
    });
    assert!(outcome.unwrap().evaluation.loss.is_finite());
    assert!(notes.iter().any(|note| note.contains("taken back")), "{notes:?}");
}
