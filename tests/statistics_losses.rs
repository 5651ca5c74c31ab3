//! Losses of statistics: energy, flatness, pair dispersion, spectrum, structure function.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use crate::common;

use common::in_2d_and_3d;
use whirls::learn::{Evaluation, Learner};
use whirls::scene::{Scene, StatisticWeights};
use whirls::sensitivity::Gradient;
use whirls::truth::Truth;

in_2d_and_3d!(
    forward_and_adjoint_gradients_of_every_statistic_agree_to_1e_11,
    the_gradient_of_every_statistic_agrees_with_differences_to_1e_6,
    at_the_truth_every_statistic_is_met_to_round_off,
);

const NAMES: [&str; 5] = ["energy", "flatness", "dispersion", "spectrum", "structure"];

/// A flow of few particles, learned by one statistic in every frame, with a learnable kernel.
fn scene<const D: usize>(name: &str) -> Scene {
    let statistic = format!("learn.statistics={{{name}=1.5}}");
    let per_side = format!("fluid.particles_per_side={}", if D == 2 { 16 } else { 9 });
    let more = [
        &per_side[..],
        &statistic,
        "fluid.kernel={kind='w-ab',a=2.9,b=3.5}",
        "initial.jitter=0.05",
        "learn.parameters=['c','alpha','beta','gamma','a']",
        "learn.unbounded=[]",
        "learn.after=3",
        "learn.frames=4",
        "learn.windows=[]",
        "learn.loss={field=0.0}",
        "learn.increments={times='all'}",
        "learn.optimiser={kind='adam',rate=0.01}",
    ];
    let scene = if D == 2 { "inverse-2d" } else { "inverse-3d" };
    Scene::open(scene, &more.map(str::to_owned)).unwrap()
}

const GUESS: [f64; 5] = [11.0, 0.8, 1.5, 6.0, 2.7];

fn learner<const D: usize>(name: &str, gradient: Gradient) -> Learner<D> {
    let mut scene = scene::<D>(name);
    let learn = scene.learn.as_mut().unwrap();
    learn.gradient = gradient;
    let part = (learn.after, learn.frames);
    let truth = Truth::<D>::generate(&scene, part).unwrap();
    Learner::of_truth(&scene, &truth).unwrap()
}

fn evaluate<const D: usize>(name: &str, gradient: Gradient) -> Evaluation {
    learner::<D>(name, gradient).evaluate(&GUESS, 4).unwrap()
}

fn forward_and_adjoint_gradients_of_every_statistic_agree_to_1e_11<const D: usize>() {
    for name in NAMES {
        let forward = evaluate::<D>(name, Gradient::Forward);
        let adjoint = evaluate::<D>(name, Gradient::Adjoint);
        assert!(forward.loss > 1e-12, "{name}: {}", forward.loss);
        assert!((forward.loss - adjoint.loss).abs() <= 1e-13 * forward.loss, "{name}");
        assert_eq!(forward.statistics.len(), 1);
        let size = forward.gradient.iter().map(|slope| slope * slope).sum::<f64>().sqrt();
        for (a, b) in forward.gradient.iter().zip(&adjoint.gradient) {
            assert!((a - b).abs() <= 1e-11 * size, "{name}: {a} {b}");
        }
    }
}

fn the_gradient_of_every_statistic_agrees_with_differences_to_1e_6<const D: usize>() {
    for name in NAMES {
        let mut learner = learner::<D>(name, Gradient::Adjoint);
        let exact = learner.evaluate(&GUESS, 4).unwrap().gradient;
        let size = exact.iter().map(|slope| slope * slope).sum::<f64>().sqrt();
        let direction: Vec<f64> = exact.iter().map(|slope| slope / size).collect();
        // Along the gradient every parameter contributes.
        let mut value = |step: f64| {
            let there = GUESS.iter().zip(&direction).map(|(x, d)| x + step * d);
            learner.evaluate(&there.collect::<Vec<_>>(), 4).unwrap().loss
        };
        let best = [1e-3, 1e-4, 1e-5].map(|step| {
            let central = (value(step) - value(-step)) / (2.0 * step);
            (central / size - 1.0).abs()
        });
        assert!(best.iter().any(|apart| *apart <= 1e-6), "{name}: {best:?}");
    }
}

fn at_the_truth_every_statistic_is_met_to_round_off<const D: usize>() {
    for name in NAMES {
        let truth: Vec<f64> = if D == 2 { vec![12.0] } else { vec![10.0] };
        let truth = [&truth[..], &[1.0, 2.0, 7.0, 2.9]].concat();
        let found = learner::<D>(name, Gradient::Forward).evaluate(&truth, 4).unwrap();
        assert!(found.loss < 1e-20, "{name}: {}", found.loss);
    }
}

#[test]
fn levenberg_marquardt_learns_constants_from_statistics_alone_to_1e_6() {
    let mut scene = scene::<2>("spectrum");
    let learn = scene.learn.as_mut().unwrap();
    learn.statistics = StatisticWeights { energy: 1.0, spectrum: 1.0, ..Default::default() };
    learn.parameters = vec!["c".to_owned().into(), "alpha".to_owned().into()];
    learn.optimiser = whirls::scene::Optimiser::LevenbergMarquardt { damping: 1e-3 };
    let truth = Truth::<2>::generate(&scene, (3, 4)).unwrap();
    let mut learner = Learner::of_truth(&scene, &truth).unwrap();
    let outcome = learner.run(vec![10.0, 0.7], &mut |_| Ok(())).unwrap();
    let found = &outcome.evaluation.parameters;
    assert!((found[0] - 12.0).abs() < 1e-6 && (found[1] - 1.0).abs() < 1e-6, "{found:?}");
}

#[test]
fn weights_below_zero_and_a_training_without_any_loss_are_refused() {
    for (key, expected) in [
        ("learn.statistics={energy=-1.0}", "zero or more"),
        ("learn.statistics={energie=1.0}", "energie"),
        ("learn.statistics={energy=0.0}", "one of them positive"),
    ] {
        let keys = ["learn.loss={field=0.0}".to_owned(), key.to_owned()];
        let error = Scene::open("inverse-2d", &keys).unwrap_err().to_string();
        assert!(error.contains(expected), "{key}: {error}");
    }
}
