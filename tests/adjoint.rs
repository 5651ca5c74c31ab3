//! The adjoint: the gradient by all parameters from one backward sweep.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use crate::common;

use whirls::flow::{Differentiation, Flow, Snapshot};
use whirls::learn::Learner;
use whirls::parameters::Parameter;
use whirls::scalar::Precision;
use whirls::scene::{Optimiser, Scene, Weights};
use whirls::sensitivity::{AdjointGradient, Coupling, Gradient, Storage, adjoint_gradient};
use whirls::systems::neighbours::Neighbours;
use whirls::systems::particles::{AdjointCloud, PairInputs};
use whirls::systems::verlet::Step;
use whirls::truth::Truth;

/// A small rough flow with every term of the force.
fn scene(dimension: usize, step: Step, forcing: &str, loss: Weights) -> Scene {
    let name = if dimension == 2 { "inverse-2d" } else { "inverse-3d" };
    let (side, h) = if dimension == 2 { (14, 0.457) } else { (8, 0.67) };
    let mut overrides = vec![
        format!("fluid.particles_per_side={side}"),
        format!("fluid.smoothing_length={h}"),
        "learn.after=4".to_owned(),
        "learn.frames=5".to_owned(),
        "learn.windows=[]".to_owned(),
    ];
    if forcing != "paper" {
        overrides.push(format!("forcing={forcing}"));
    }
    let mut scene = Scene::open(name, &overrides).unwrap();
    scene.time.step = step;
    if let Some(learn) = &mut scene.learn {
        learn.loss = loss;
    }
    scene
}

const FORCINGS: [&str; 5] = [
    "paper",
    "{kind='deterministic',theta=0.3,power='exact'}",
    "{kind='stochastic',interval=0.05}",
    "{kind='ornstein-uhlenbeck',power=0.5,correlation_time=0.3}",
    "{kind='none'}",
];

/// Factors on `c, α, β, γ, θ`.
const OFF: [f64; 5] = [0.8, 0.7, 1.3, 0.75, 0.9];

/// Loss and gradient by both modes at parameters off the truth.
fn both<const D: usize>(scene: &Scene, storage: Storage) -> (Vec<f64>, Vec<f64>, [f64; 2]) {
    let learn = scene.learn.clone().unwrap();
    let truth = Truth::<D>::generate(scene, (learn.after, learn.frames)).unwrap();
    let observations = truth.observations(scene, &learn).unwrap();
    let known = scene.parameters();
    let mut parameters = Parameter::PHYSICAL.to_vec();
    parameters.retain(|name| known.place(name).is_some());
    let by = Differentiation { parameters: parameters.clone(), coupling: Coupling::Full };
    let start = &truth.states[0];
    let mut forward =
        Flow::<D>::build(scene, start, Some(&by), Some(observations.clone())).unwrap();
    common::scale_parameters(&mut forward, OFF);
    for _ in 0..learn.frames {
        forward.step().unwrap();
    }
    let sum = forward.loss();
    let exact = sum.gradient(parameters.len());
    let mut backward = Flow::<D>::with_adjoint(scene, start, observations).unwrap();
    backward.check_order().unwrap();
    common::scale_parameters(&mut backward, OFF);
    let found = adjoint_gradient(&mut backward, start, learn.frames as u64, storage).unwrap();
    let places = backward.places(&parameters).unwrap();
    let adjoint = places.iter().map(|&place| found.gradient[place]).collect();
    (exact, adjoint, [sum.value(), found.loss.value()])
}

#[test]
fn adjoint_and_forward_gradients_agree_to_round_off() {
    let mut worst = 0.0_f64;
    for step in Step::ALL {
        for forcing in FORCINGS {
            for (trajectory, field) in [(1.0, 0.0), (0.0, 1.0), (0.3, 2.0)] {
                for dimension in [2, 3] {
                    let scene =
                        scene(dimension, step, forcing, Weights { trajectory, field, kl: 0.0 });
                    let (forward, adjoint, losses) = match dimension {
                        2 => both::<2>(&scene, Storage::All),
                        _ => both::<3>(&scene, Storage::All),
                    };
                    assert!((losses[0] - losses[1]).abs() <= 1e-13 * losses[0]);
                    let size = forward.iter().map(|g| g * g).sum::<f64>().sqrt();
                    for (a, b) in forward.iter().zip(&adjoint) {
                        worst = worst.max((a - b).abs() / (a.abs() + 1e-4 * size));
                        assert!(
                            (a - b).abs() <= 1e-12 * size,
                            "{step:?} {forcing} {trajectory} {dimension}D: {forward:?} {adjoint:?}"
                        );
                    }
                }
            }
        }
    }
    println!("largest relative difference {worst:.1e}");
}

#[test]
fn checkpoints_give_the_bits_of_full_storage() {
    for step in [Step::KickDriftKick, Step::Paper] {
        let mut scene = scene(3, step, "paper", Weights { trajectory: 1.0, field: 1.0, kl: 0.0 });
        if let Some(learn) = &mut scene.learn {
            learn.frames = 11;
        }
        let (_, everything, _) = both::<3>(&scene, Storage::All);
        for snapshots in [1, 2, 3, 20] {
            let (_, few, _) = both::<3>(&scene, Storage::Checkpoints(snapshots));
            let bits = |all: &[f64]| all.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
            assert_eq!(bits(&everything), bits(&few), "{step:?} {snapshots}");
        }
    }
}

/// Lists of at least three eights, built for a larger radius than the support.
#[test]
fn the_way_back_meets_everybody_within_the_support_and_nobody_else() {
    let loss = Weights { trajectory: 1.0, field: 1.0, kl: 0.0 };
    for precision in Precision::ALL {
        let mut scene = scene(3, Step::Paper, "paper", loss);
        scene.precision = precision;
        let learn = scene.learn.clone().unwrap();
        let truth = Truth::<3>::generate(&scene, (learn.after, learn.frames)).unwrap();
        let (start, observations) = (&truth.states[0], truth.observations(&scene, &learn).unwrap());
        let mut flow = Flow::<3>::with_adjoint(&scene, start, observations).unwrap();
        adjoint_gradient(&mut flow, start, learn.frames as u64, Storage::All).unwrap();
        let cloud = flow.world().resource::<PairInputs>();
        let neighbours = flow.world().resource::<Neighbours<3>>();
        let adjoint = flow.world().resource::<AdjointCloud<3>>();
        let met = adjoint.near.iter().zip(&neighbours.chunks[..]).map(|(near, all)| {
            let within = |k: usize| {
                let all = Vec::from_iter(all.slots_of(k));
                let near = near.neighbours(k).flat_map(|eight| eight.slots());
                let near = Vec::from_iter(near.filter(|&j| j < 512));
                assert!(near.iter().all(|&j| all.contains(&(j as usize))));
                near.len() as u64
            };
            (0..near.len()).map(within).sum::<u64>()
        });
        let (met, listed) = (met.sum::<u64>(), neighbours.chunks.iter().map(|all| all.batches()));
        assert_eq!(met, neighbours.pairs(cloud.particles()), "{}", precision.name());
        assert!(met * 5 < 4 * 8 * listed.sum::<usize>() as u64);
    }
}

/// Observing every third step is observing every step with two of three frames left out.
#[test]
fn frames_that_are_steps_apart_are_states_of_the_same_flow_with_the_same_gradients_both_ways() {
    for loss in [(1.0, 0.0), (0.3, 2.0)] {
        let (trajectory, field) = loss;
        let mut often =
            scene(3, Step::KickDriftKick, "paper", Weights { trajectory, field, kl: 0.0 });
        let mut seldom = often.clone();
        if let (Some(often), Some(seldom)) = (&mut often.learn, &mut seldom.learn) {
            (often.frames, seldom.frames, seldom.every) = (6, 2, 3);
        }
        let [all, some] = [(&often, 6), (&seldom, 2)]
            .map(|(scene, frames)| Truth::<3>::generate(scene, (4, frames)).unwrap());
        let third = all.states.iter().step_by(3).cloned().collect::<Vec<_>>();
        assert_eq!(some.states, third);
        let steps: Vec<u64> = {
            let observed = some.observations(&seldom, &seldom.learn.clone().unwrap()).unwrap();
            observed.frames.iter().map(|frame| frame.step).collect()
        };
        assert_eq!(steps, [3, 6]);
        let gradients = [Gradient::Forward, Gradient::Adjoint].map(|gradient| {
            let mut scene = seldom.clone();
            if let Some(learn) = &mut scene.learn {
                learn.optimiser = Optimiser::Adam { rate: 0.1, decay: 1.0 };
                learn.gradient = gradient;
            }
            let mut learner = Learner::of_truth(&scene, &some).unwrap();
            learner.evaluate(&[8.0, 0.7, 2.6, 5.0], 2).unwrap()
        });
        let [forward, adjoint] = gradients;
        assert!((forward.loss - adjoint.loss).abs() <= 1e-13 * forward.loss);
        for (a, b) in forward.gradient.iter().zip(&adjoint.gradient) {
            assert!((a - b).abs() <= 1e-10 * a.abs(), "{forward:?} {adjoint:?}");
        }
    }
}

/// The adjoint with a storage, at parameters off the truth.
fn backward(scene: &Scene, storage: Storage) -> whirls::Result<AdjointGradient> {
    let learn = scene.learn.clone().unwrap();
    let truth = Truth::<3>::generate(scene, (learn.after, learn.frames)).unwrap();
    let observations = truth.observations(scene, &learn).unwrap();
    let mut flow = Flow::<3>::with_adjoint(scene, &truth.states[0], observations).unwrap();
    common::scale_parameters(&mut flow, [0.8, 1.0, 1.0, 1.0, 1.0]);
    adjoint_gradient(&mut flow, &truth.states[0], learn.frames as u64, storage)
}

#[test]
fn a_budget_of_bytes_is_kept_and_gives_the_bits_of_full_storage() {
    for step in Step::ALL {
        let mut scene = scene(3, step, "paper", Weights { trajectory: 1.0, field: 1.0, kl: 1.0 });
        // Lists that are rebuilt in almost every step.
        scene.time.skin = 0.05;
        if let Some(learn) = &mut scene.learn {
            learn.frames = 14;
        }
        let all = backward(&scene, Storage::All).unwrap();
        let refused = backward(&scene, Storage::Bytes(1000)).unwrap_err();
        assert_eq!(refused.exit_code(), 2);
        let text = refused.to_string();
        let (_, smallest) = text.split_once("at least ").unwrap();
        let smallest: usize = smallest.split(' ').next().unwrap().parse().unwrap();
        backward(&scene, Storage::Bytes(smallest - 1)).unwrap_err();
        let snapshot = Snapshot::<3>::BYTES * 512;
        let mut steps_run = u64::MAX;
        for (more, snapshots) in [(0, 1), (snapshot - 1, 1), (snapshot, 2), (4 * snapshot, 5)] {
            let found = backward(&scene, Storage::Bytes(smallest + more)).unwrap();
            let counted = backward(&scene, Storage::Checkpoints(snapshots)).unwrap();
            assert_eq!(found.gradient, all.gradient);
            assert_eq!((found.steps_run, found.bytes), (counted.steps_run, counted.bytes));
            assert!(found.bytes <= smallest + more && found.bytes < all.bytes, "{step:?} {more}");
            assert!(found.steps_run <= steps_run);
            steps_run = found.steps_run;
            println!(
                "{step:?}: {} of {} bytes for {snapshots} snapshots, {steps_run} steps; all {}",
                found.bytes,
                smallest + more,
                all.bytes
            );
        }
    }
}

#[test]
fn a_search_by_adjoint_follows_the_search_by_forward_gradients() {
    let search = |gradient: &str, storage: &str| {
        let overrides: Vec<String> = [
            "fluid.particles_per_side=8",
            "fluid.smoothing_length=0.67",
            "learn.after=4",
            "learn.frames=4",
            "learn.windows=[]",
            "learn.iterations=15",
            "learn.guess={c=8,alpha=0.5,beta=1,gamma=5}",
            "learn.optimiser={kind='adam',rate=0.1}",
            &format!("learn.gradient={gradient}"),
            &format!("learn.storage={storage}"),
        ]
        .map(str::to_owned)
        .to_vec();
        let scene = Scene::open("inverse-3d", &overrides).unwrap();
        let learn = scene.learn.clone().unwrap();
        let truth = Truth::<3>::generate(&scene, (learn.after, learn.frames)).unwrap();
        let observations = truth.observations(&scene, &learn).unwrap();
        let mut learner = Learner::new(&scene, truth.states[0].clone(), observations).unwrap();
        let guess = learner.guess(1);
        learner.run(guess, &mut |_| Ok(())).unwrap().evaluation
    };
    let forward = search("forward", "all");
    for found in [
        search("adjoint", "all"),
        search("adjoint", "{checkpoints=2}"),
        search("adjoint", "{bytes=4000000}"),
    ] {
        assert!((found.loss - forward.loss).abs() < 1e-10 * forward.loss);
        for (a, b) in found.parameters.iter().zip(&forward.parameters) {
            assert!((a - b).abs() < 1e-10, "{a} against {b}");
        }
    }
}

#[test]
fn what_cannot_be_combined_with_the_adjoint_is_refused_with_a_reason() {
    for (overrides, expected) in [
        (vec!["learn.gradient=adjoint"], "residual"),
        (
            vec![
                "learn.gradient=adjoint",
                "learn.optimiser={kind='adam',rate=0.1}",
                "learn.coupling=local",
            ],
            "exact",
        ),
    ] {
        let overrides: Vec<String> = overrides.into_iter().map(str::to_owned).collect();
        let error = Scene::open("inverse-3d", &overrides).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains(expected), "{error}");
    }
}

#[test]
fn the_way_is_chosen_by_what_the_search_needs() {
    for (search, expected) in [
        ("learn.optimiser={kind='lbfgs'}", Gradient::Adjoint),
        ("learn.optimiser={kind='levenberg-marquardt'}", Gradient::Forward),
    ] {
        for (coupling, expected) in [("full", expected), ("local", Gradient::Forward)] {
            let mut scene = scene(2, Step::Paper, "paper", Weights::default());
            let overrides = [search.to_owned(), format!("learn.coupling={coupling}")];
            let choice = Scene::open("inverse-2d", &overrides).unwrap().learn.unwrap();
            if let Some(learn) = &mut scene.learn {
                (learn.optimiser, learn.coupling) = (choice.optimiser, choice.coupling);
            }
            let truth = Truth::<2>::generate(&scene, (4, 5)).unwrap();
            let learner = Learner::of_truth(&scene, &truth).unwrap();
            assert_eq!(learner.gradient(), expected, "{search} {coupling}");
        }
    }
}
