//! The hierarchy of models: all modes of differentiation agree, and conservation laws hold.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use crate::common;

use common::{in_2d_and_3d, largest, taylor_slope};
use whirls::flow::{Differentiation, Flow};
use whirls::learn::Learner;
use whirls::models::ModelChoice;
use whirls::parameters::Parameter;
use whirls::scene::Scene;
use whirls::sensitivity::{Coupling, Gradient, Storage};
use whirls::systems::particles::AccelerationSensitivity;
use whirls::truth::Truth;

in_2d_and_3d!(
    forward_adjoint_and_differences_agree_for_every_model_loss_and_step,
    forward_adjoint_and_differences_agree_for_every_guest,
    local_coupling_is_exact_at_the_first_force_of_every_model,
    checkpoints_give_the_bits_of_full_storage_for_every_model,
);

/// Every model, in both of its forms if it has two, with the momentum that it conserves.
const MODELS: [(&str, bool); 13] = [
    ("{kind='physics'}", true),
    ("{kind='eos-nn',height=4}", true),
    ("{kind='grad-p',height=3}", false),
    ("{kind='grad-p',height=3,antisymmetric=true}", true),
    ("{kind='rot-inv',height=3}", false),
    ("{kind='rot-inv',height=3,antisymmetric=true}", true),
    ("{kind='nn-sum',height=3}", false),
    ("{kind='nn-sum',height=3,antisymmetric=true}", true),
    ("{kind='nn-sum',height=3,window=false}", false),
    ("{kind='node',height=3,nearest=9}", false),
    ("{kind='node',height=3,nearest=30,window=false}", false),
    ("{kind='exchange',height=3}", true),
    ("{kind='exchange',height=3,transverse=false}", true),
];

const LOSSES: [(&str, &str); 4] = [
    ("trajectory", "{trajectory=1.0,field=0.0,kl=0.0}"),
    ("field", "{trajectory=0.0,field=1.0,kl=0.0}"),
    ("kl", "{trajectory=0.0,field=0.0,kl=1.0}"),
    ("field+kl", "{trajectory=0.0,field=2.0,kl=0.5}"),
];

/// Additional terms beside or inside the physics, with their values in the truth and in the guess.
struct Guest {
    overrides: &'static [&'static str],
    learned: &'static str,
    guess: &'static str,
}

const GUESTS: [Guest; 7] = [
    Guest {
        overrides: &["fluid.viscosity={kind='morris',nu=0.05}"],
        learned: "['c','alpha','nu','gamma']",
        guess: "{c=8.0,alpha=0.7,nu=0.08,gamma=5.2}",
    },
    Guest {
        overrides: &["fluid.viscosity={kind='monaghan-cleary',nu=0.05}"],
        learned: "['c','nu','theta']",
        guess: "{c=8.0,nu=0.08,theta=0.45}",
    },
    Guest {
        overrides: &["fluid.p0=3.0"],
        learned: "['p0','gamma','c']",
        guess: "{p0=4.5,gamma=5.2,c=8.0}",
    },
    Guest {
        overrides: &["fluid.kernel='w-ab'", "fluid.viscosity={kind='morris',nu=0.05}"],
        learned: "['a','c','b','nu','alpha']",
        guess: "{a=3.1,c=8.0,b=3.3,nu=0.08,alpha=0.7}",
    },
    Guest {
        overrides: &["fluid.kernel='w-2'", "fluid.viscosity={kind='monaghan-cleary',nu=0.05}"],
        learned: "['a','b','nu','beta']",
        guess: "{a=0.3,b=-0.7,nu=0.08,beta=2.6}",
    },
    Guest {
        overrides: &["forcing={kind='ornstein-uhlenbeck',power=1.0,correlation_time=0.2}"],
        learned: "['c','alpha']",
        guess: "{c=8.0,alpha=0.7}",
    },
    Guest {
        overrides: &["learn.model={kind='grad-p',height=3}", "fluid.kernel='w-ab'"],
        learned: "['a','b','alpha']",
        guess: "{a=3.1,b=3.3,alpha=0.7}",
    },
];

const FRAMES: usize = 3;

/// A small rough flow with every term of every force.
fn scene<const D: usize>(model: &str, step: &str, loss: &str) -> Scene {
    let (name, side, h) = if D == 2 { ("inverse-2d", 12, 0.533) } else { ("inverse-3d", 7, 0.766) };
    let physical = if model.contains("physics") {
        "['c','alpha','beta','gamma','theta']"
    } else {
        // In addition to its weights a model may learn physical parameters.
        "['c','theta','alpha']"
    };
    let overrides = [
        format!("fluid.particles_per_side={side}"),
        format!("fluid.smoothing_length={h}"),
        format!("learn.model={model}"),
        format!("learn.parameters={physical}"),
        "learn.guess={c=8.0,alpha=0.7,beta=2.6,gamma=5.2,theta=0.45}".to_owned(),
        format!("learn.loss={loss}"),
        format!("learn.frames={FRAMES}"),
        "learn.after=4".to_owned(),
        "learn.windows=[]".to_owned(),
        "learn.optimiser={kind='adam',rate=0.05}".to_owned(),
        format!("time.step={step}"),
    ];
    let mut overrides = overrides.to_vec();
    if !model.contains("physics") {
        overrides[4] = "learn.guess={c=8.0,alpha=0.7,theta=0.45}".to_owned();
    }
    Scene::open(name, &overrides).unwrap()
}

fn learner<const D: usize>(scene: &Scene, gradient: Gradient) -> Learner<D> {
    let mut scene = scene.clone();
    scene.learn.as_mut().unwrap().gradient = gradient;
    let learn = scene.learn.clone().unwrap();
    let truth = Truth::<D>::generate(&scene, (learn.after, learn.frames)).unwrap();
    let observations = truth.observations(&scene, &learn).unwrap();
    Learner::new(&scene, truth.states[0].clone(), observations).unwrap()
}

/// Smallest difference between central differences along a direction and the slope given by a
/// gradient, relative to that slope or, if it is larger, to a thousandth of the product of both
/// lengths.
fn difference<const D: usize>(
    learner: &mut Learner<D>,
    (at, direction): (&[f64], &[f64]),
    gradient: &[f64],
) -> f64 {
    let length = |x: &[f64]| x.iter().map(|x| x * x).sum::<f64>().sqrt();
    let exact: f64 = gradient.iter().zip(direction).map(|(g, d)| g * d).sum();
    let size = exact.abs().max(1e-3 * length(gradient) * length(direction));
    let mut loss = |step: f64| {
        let moved: Vec<f64> = at.iter().zip(direction).map(|(x, d)| x + step * d).collect();
        learner.evaluate(&moved, FRAMES).unwrap().loss
    };
    let mut best = f64::INFINITY;
    for step in [1e-4, 1e-5, 1e-6, 1e-3, 3e-5, 3e-6] {
        let near = loss(step) - loss(-step);
        let far = loss(2.0 * step) - loss(-2.0 * step);
        for slope in [near / (2.0 * step), (8.0 * near - far) / (12.0 * step)] {
            best = best.min((slope - exact).abs() / size);
        }
        if best < 1e-8 {
            break;
        }
    }
    best
}

fn forward_adjoint_and_differences_agree_for_every_model_loss_and_step<const D: usize>() {
    let (mut apart, mut off) = (0.0_f64, 0.0_f64);
    let mut wrong = Vec::new();
    for (model, _) in MODELS {
        for step in ["paper", "kick-drift-kick"] {
            for (name, loss) in LOSSES {
                let scene = scene::<D>(model, step, loss);
                let mut forward = learner::<D>(&scene, Gradient::Forward);
                let mut backward = learner::<D>(&scene, Gradient::Adjoint);
                // Biases start at zero; here nothing should be zero by accident.
                let at = forward.guess(3).into_iter().enumerate();
                let at: Vec<f64> = at.map(|(k, x)| x + 0.2 * (1.3 * k as f64).sin()).collect();
                let a = forward.evaluate(&at, FRAMES).unwrap();
                let b = backward.evaluate(&at, FRAMES).unwrap();
                assert!((a.loss - b.loss).abs() <= 1e-12 * a.loss, "{} {}", a.loss, b.loss);
                let size = largest(a.gradient.iter().map(|g| g.abs()));
                let gap =
                    largest(a.gradient.iter().zip(&b.gradient).map(|(a, b)| (a - b).abs() / size));
                // Along the gradient, and perpendicular to it, which would show an error common to
                // both modes.
                let along: Vec<f64> = a.gradient.iter().map(|g| g / size).collect();
                let across: Vec<f64> =
                    (0..at.len()).map(|k| (1.7 * k as f64 + 0.3).sin()).collect();
                let difference = [along, across]
                    .map(|direction| difference(&mut backward, (&at, &direction), &a.gradient));
                let difference = largest(difference.into_iter());
                (apart, off) = (apart.max(gap), off.max(difference));
                if !(gap <= 1e-12 && difference <= 1e-6) {
                    wrong.push(format!(
                        "{model} {step} {name}: adjoint {gap:.1e}, differences {difference:.1e}"
                    ));
                }
            }
        }
    }
    println!("{D}D: forward against adjoint {apart:.1e}, against differences {off:.1e}");
    assert!(wrong.is_empty(), "{} wrong:\n{}", wrong.len(), wrong.join("\n"));
}

fn forward_adjoint_and_differences_agree_for_every_guest<const D: usize>() {
    let (mut apart, mut off) = (0.0_f64, 0.0_f64);
    let mut wrong = Vec::new();
    for Guest { overrides, learned, guess } in GUESTS {
        for step in ["paper", "kick-drift-kick"] {
            for (name, loss) in LOSSES {
                let mut scene = scene::<D>("{kind='physics'}", step, loss);
                let text = scene.to_toml();
                let mut all: Vec<String> = overrides.iter().map(|&one| one.to_owned()).collect();
                all.extend([format!("learn.parameters={learned}"), format!("learn.guess={guess}")]);
                scene = Scene::parse(&text, "a guest", &all).unwrap();
                let mut forward = learner::<D>(&scene, Gradient::Forward);
                let mut backward = learner::<D>(&scene, Gradient::Adjoint);
                let at = forward.guess(3);
                let a = forward.evaluate(&at, FRAMES).unwrap();
                let b = backward.evaluate(&at, FRAMES).unwrap();
                let size = largest(a.gradient.iter().map(|g| g.abs()));
                let gap =
                    largest(a.gradient.iter().zip(&b.gradient).map(|(a, b)| (a - b).abs() / size));
                // Each parameter separately, so that a small derivative is not hidden by a large
                // one.
                let alone = (0..at.len().min(5)).map(|k| {
                    let alone = |other: usize| if other == k { at[k].abs() } else { 0.0 };
                    let direction: Vec<f64> = (0..at.len()).map(alone).collect();
                    let found = taylor_slope(
                        &mut |x| backward.evaluate(x, FRAMES).unwrap().loss,
                        (&at, &direction),
                        &a,
                    );
                    if found.slope > 1.9 { found.difference } else { f64::INFINITY }
                });
                let difference = largest(alone);
                (apart, off) = (apart.max(gap), off.max(difference));
                if !(gap <= 1e-12 && difference <= 1e-6) {
                    wrong.push(format!(
                        "{overrides:?} {step} {name}: adjoint {gap:.1e}, differences {difference:.1e}"
                    ));
                }
            }
        }
    }
    println!("{D}D: forward against adjoint {apart:.1e}, against differences {off:.1e}");
    assert!(wrong.is_empty(), "{} wrong:\n{}", wrong.len(), wrong.join("\n"));
}

/// The bits of `∂F/∂θ` of all particles.
fn by_parameters<const D: usize>(flow: &mut Flow<D>) -> Vec<u64> {
    let world = flow.world_mut();
    let mut rows = world.query::<&AccelerationSensitivity<D>>();
    let lanes = rows.iter(world).flat_map(|row| row.0.0);
    lanes.flat_map(|lanes| lanes.to_array().map(f64::to_bits)).collect()
}

/// At the start a force depends on the parameters only directly, so that local coupling is
/// complete.
fn local_coupling_is_exact_at_the_first_force_of_every_model<const D: usize>() {
    for (model, _) in MODELS {
        let scene = scene::<D>(model, "kick-drift-kick", LOSSES[1].1);
        let parameters = learner::<D>(&scene, Gradient::Adjoint).columns().to_vec();
        let [mut full, mut local] = [Coupling::Full, Coupling::Local].map(|coupling| {
            let by = Differentiation { parameters: parameters.clone(), coupling };
            Flow::<D>::build(&scene, &common::shaken(&scene), Some(&by), None).unwrap()
        });
        full.start().unwrap();
        local.start().unwrap();
        let (a, b) = (by_parameters(&mut full), by_parameters(&mut local));
        assert!(a.iter().any(|&bits| bits != 0) && a == b, "{model} at the start");
        (0..2).for_each(|_| (full.step().unwrap(), local.step().unwrap()).0);
        assert!(by_parameters(&mut full) != by_parameters(&mut local), "{model} after two steps");
    }
}

fn checkpoints_give_the_bits_of_full_storage_for_every_model<const D: usize>() {
    for (model, _) in MODELS {
        let scene = scene::<D>(model, "kick-drift-kick", LOSSES[3].1);
        let gradient = |storage: Storage| {
            let mut scene = scene.clone();
            scene.learn.as_mut().unwrap().storage = storage;
            let mut learner = learner::<D>(&scene, Gradient::Adjoint);
            let at = learner.guess(3);
            learner.evaluate(&at, FRAMES).unwrap()
        };
        let (all, few) = (gradient(Storage::All), gradient(Storage::Checkpoints(1)));
        let bits = |x: &[f64]| x.iter().map(|x| x.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&all.gradient), bits(&few.gradient), "{model}");
    }
}

#[test]
fn antisymmetric_models_keep_momentum_and_the_others_say_how_much_they_lose() {
    for (model, keeps) in MODELS {
        let scene = scene::<3>(model, "kick-drift-kick", LOSSES[1].1);
        let mut flow = Flow::<3>::build(&scene, &common::shaken(&scene), None, None).unwrap();
        // With zero biases a network is odd, and `nn-sum` conserves momentum by accident.
        let weights: Vec<f64> = (0..flow.weights().len()).map(|k| (1.3 * k as f64).sin()).collect();
        flow.set_weights(&weights);
        flow.start().unwrap();
        let rates = flow.momentum_rates();
        let lost = rates.pressure.norm() / rates.scale;
        println!("{model}: |Σ m a| of the model's force is {lost:.1e} of Σ m |a|");
        assert!(rates.scale > 0.0);
        if keeps {
            assert!(lost < 1e-14, "{model}: {lost:e}");
        } else {
            assert!(lost > 1e-6, "{model} should not keep momentum: {lost:e}");
        }
    }
}

/// An isolated cluster smaller than the box: its angular momentum is well defined.
#[test]
fn central_antisymmetric_models_exert_no_torque_and_the_others_say_how_much() {
    for (model, keeps) in MODELS {
        let mut scene = scene::<3>(model, "kick-drift-kick", LOSSES[1].1);
        scene.limits.courant = 1e30;
        let mut state = common::cloud::<3>(60, 0.4 * scene.fluid.box_length, 5);
        let middle = whirls::vector::Vector([0.3 * scene.fluid.box_length; 3]);
        state.positions.iter_mut().for_each(|r| *r += middle);
        let mut flow = Flow::<3>::build(&scene, &state, None, None).unwrap();
        let weights: Vec<f64> = (0..flow.weights().len()).map(|k| (1.3 * k as f64).sin()).collect();
        flow.set_weights(&weights);
        // No forcing: only the model's own forces act.
        let names = [Parameter::C, Parameter::ALPHA, Parameter::BETA, Parameter::GAMMA];
        flow.set_learned(&names, &[10.0, 1.0, 2.0, 7.0]).unwrap();
        if flow.parameters().place(&Parameter::THETA).is_some() {
            flow.set_learned(&[Parameter::THETA], &[0.0]).unwrap();
        }
        flow.start().unwrap();
        let mut torque = glam::DVec3::ZERO;
        let mut size = 0.0;
        for (r, a) in state.positions.iter().zip(flow.accelerations()) {
            let turn = glam::DVec3::from(*r).cross(glam::DVec3::from(a));
            torque += turn;
            size += turn.length();
        }
        let share = torque.length() / size;
        println!("{model}: the torque of all pairs is {share:.1e} of Σ |r × a|");
        let central = !(model.contains("nn-sum") || model == "{kind='exchange',height=3}");
        if keeps && central {
            assert!(share < 1e-13, "{model}: {share:e}");
        } else {
            assert!(share > 1e-8, "{model} should exert a torque: {share:e}");
        }
    }
}

#[test]
fn a_neighbour_that_enters_the_support_brings_no_jump_with_a_window_and_one_without() {
    for (kind, options) in [("nn-sum", ""), ("rot-inv", ""), ("node", ",nearest=4")] {
        let jump = |window: bool| {
            let model = format!("{{kind='{kind}',window={window}{options}}}");
            let mut scene = scene::<3>(&model, "kick-drift-kick", LOSSES[1].1);
            // Two particles have a large mass, and their pressure is meaningless here.
            scene.limits.courant = 1e30;
            let mut accelerations = [-1e-9, 1e-9].map(|beyond| {
                let mut state = common::two_particles::<3>(scene.fluid.box_length, 0.1);
                let apart = 2.0 * scene.fluid.smoothing_length * (1.0 + beyond);
                state.positions[0] = whirls::vector::Vector([1.0, 1.0, 1.0]);
                state.positions[1] = whirls::vector::Vector([1.0 + apart, 1.0, 1.0]);
                let mut flow = Flow::<3>::build(&scene, &state, None, None).unwrap();
                flow.start().unwrap();
                flow.accelerations()
            });
            let [inside, outside] = &mut accelerations;
            common::farthest(inside, outside)
        };
        assert!(jump(true) < 1e-7, "{kind} with a window: {}", jump(true));
        assert!(jump(false) > 1e-3, "{kind} without: {}", jump(false));
    }
}

#[test]
fn the_papers_sizes_of_networks_are_the_defaults() {
    let weights = |kind: &str| {
        let model: ModelChoice = toml::from_str(&format!("kind = '{kind}'")).unwrap();
        let mut scene = Scene::shipped("inverse-3d").unwrap();
        scene.learn.as_mut().unwrap().model = model;
        Flow::<3>::build(&scene, &common::shaken(&scene), None, None).unwrap().weights().len()
    };
    // With the features listed in `models/`; Woodward et al. (arXiv:2110.13311) count 66 and 113
    // for rot-inv and nn-sum, because their published code has five and twelve inputs.
    let found = ["physics", "eos-nn", "grad-p", "rot-inv", "nn-sum", "node"].map(weights);
    assert_eq!(found, [0, 141, 56, 61, 83, 653]);
}

#[test]
fn an_exchange_starts_at_the_physics_and_keeps_momentum_with_any_weights() {
    let scene = |model: &str| scene::<3>(model, "kick-drift-kick", LOSSES[1].1);
    let (plain, learned) = (scene("{kind='physics'}"), scene("{kind='exchange',height=6}"));
    let start = |scene: &Scene| {
        let mut flow = Flow::<3>::build(scene, &common::shaken(scene), None, None).unwrap();
        flow.set_weights(&flow.draw_weights(1));
        flow.start().unwrap();
        flow
    };
    let (mut physics, mut exchange) = (start(&plain), start(&learned));
    assert!(exchange.weights().iter().any(|weight| *weight != 0.0));
    let bits = |flow: &mut Flow<3>| {
        flow.accelerations().iter().flat_map(|a| a.0).map(f64::to_bits).collect::<Vec<_>>()
    };
    assert_eq!(bits(&mut physics), bits(&mut exchange));
    let weights: Vec<f64> = (0..exchange.weights().len()).map(|k| (1.3 * k as f64).sin()).collect();
    exchange.set_weights(&weights);
    exchange.reset(&common::shaken(&learned));
    exchange.start().unwrap();
    assert_ne!(bits(&mut physics), bits(&mut exchange));
    let rates = exchange.momentum_rates();
    let parts: Vec<&str> = rates.contributions.iter().map(|part| part.name.as_str()).collect();
    assert!(parts.iter().any(|name| name.contains("exchange")), "{parts:?}");
    let lost = rates.contributions.iter().filter(|part| !part.name.contains("forcing"));
    let lost = lost.map(|part| part.rate.norm()).fold(0.0, f64::max) / rates.scale;
    assert!(lost < 1e-14, "{lost:e}");
}

#[test]
fn what_a_model_cannot_do_is_refused_with_a_reason() {
    for (overrides, expected) in [
        ("learn.model={kind='nn-sums'}", "nn-sum"),
        ("learn.model={kind='nn-sum',height=0}", "at least one"),
        ("learn.model={kind='eos-nn',antisymmetric=true}", "antisymmetric"),
        ("learn.model={kind='node',nearest=0}", "at least one"),
        ("learn.model={kind='node',nearest=100000}", "1000"),
    ] {
        let error = Scene::open("inverse-3d", &[overrides.to_owned()]).map(|scene| {
            let state = common::shaken::<3>(&scene);
            Flow::<3>::build(&scene, &state, None, None).map(|_| ()).unwrap_err()
        });
        let error = error.unwrap_or_else(|error| error);
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains(expected), "{overrides}: {error}");
    }
}
