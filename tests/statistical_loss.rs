//! The statistical loss in a flow: its gradient in both modes and by differences, which times
//! count, and what is refused.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use whirls::flow::{Differentiation, Flow};
use whirls::learn::{Evaluation, Learner};
use whirls::losses::IncrementDensities;
use whirls::parameters::Parameter;
use whirls::scene::{Increments, Optimiser, Scene, Times, Weights};
use whirls::sensitivity::{Coupling, Gradient};
use whirls::systems::particles::Velocity;
use whirls::systems::verlet::Step;
use whirls::truth::{Truth, statistical_floor};

const KL: Weights = Weights { trajectory: 0.0, field: 0.0, kl: 1.0 };
const FIELD_AND_KL: Weights = Weights { trajectory: 0.0, field: 1.0, kl: 0.5 };
const FRAMES: usize = 5;

/// A small rough flow with every term of the force.
fn scene(dimension: usize, step: Step, loss: Weights, times: Times) -> Scene {
    let name = if dimension == 2 { "inverse-2d" } else { "inverse-3d" };
    let (side, h) = if dimension == 2 { (14, 0.457) } else { (8, 0.67) };
    let overrides = [
        format!("fluid.particles_per_side={side}"),
        format!("fluid.smoothing_length={h}"),
        "learn.after=4".to_owned(),
        format!("learn.frames={FRAMES}"),
        "learn.windows=[]".to_owned(),
        "learn.parameters=['c','alpha','beta','gamma','theta']".to_owned(),
        "learn.optimiser={kind='adam',rate=0.05}".to_owned(),
    ];
    let mut scene = Scene::open(name, &overrides).unwrap();
    scene.time.step = step;
    if let Some(learn) = &mut scene.learn {
        (learn.loss, learn.increments) = (loss, Increments { times, ..Increments::default() });
    }
    scene
}

/// Every combination that is tested, with its name.
fn every_scene() -> impl Iterator<Item = (String, Scene)> {
    let losses = [("kl", KL), ("field + kl", FIELD_AND_KL)];
    losses.into_iter().flat_map(|(name, loss)| {
        [Times::Last, Times::All].into_iter().flat_map(move |times| {
            [Step::KickDriftKick, Step::Paper].into_iter().flat_map(move |step| {
                [2, 3].map(|dimension| {
                    let name = format!("{name}, {times:?}, {step:?}, {dimension}D");
                    (name, scene(dimension, step, loss, times))
                })
            })
        })
    })
}

fn truth<const D: usize>(scene: &Scene) -> Truth<D> {
    let learn = scene.learning().unwrap();
    Truth::generate(scene, (learn.after, learn.frames)).unwrap()
}

fn learner<const D: usize>(scene: &Scene, gradient: Gradient) -> Learner<D> {
    let mut scene = scene.clone();
    let truth = truth::<D>(&scene);
    let learn = scene.learn.as_mut().unwrap();
    learn.gradient = gradient;
    let observations = truth.observations(&scene, scene.learning().unwrap()).unwrap();
    Learner::new(&scene, truth.states[0].clone(), observations).unwrap()
}

/// Far from the truth: the loss is far from its minimum there.
fn guess(scene: &Scene) -> Vec<f64> {
    let factors = [0.8, 0.7, 1.3, 0.75, 0.9];
    let learned = scene.learning().unwrap().parameters.iter();
    let index = |name| Parameter::PHYSICAL.iter().position(|p| p == name).unwrap();
    learned.map(|p| scene.parameters().get(p).unwrap() * factors[index(p)]).collect()
}

fn forward_and_adjoint(scene: &Scene) -> [Evaluation; 2] {
    let at = guess(scene);
    [Gradient::Forward, Gradient::Adjoint].map(|gradient| match scene.dimension {
        2 => learner::<2>(scene, gradient).evaluate(&at, FRAMES).unwrap(),
        _ => learner::<3>(scene, gradient).evaluate(&at, FRAMES).unwrap(),
    })
}

#[test]
fn forward_and_adjoint_gradients_agree_to_round_off() {
    let mut worst = 0.0_f64;
    for (name, scene) in every_scene() {
        let [forward, adjoint] = forward_and_adjoint(&scene);
        assert!(forward.kl > 1e-6, "{name}: nothing to differentiate, {}", forward.kl);
        assert!((forward.loss - adjoint.loss).abs() <= 1e-13 * forward.loss, "{name}");
        assert!((forward.loss - forward.field - forward.kl).abs() <= 1e-15 * forward.loss);
        let size = forward.gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
        for (a, b) in forward.gradient.iter().zip(&adjoint.gradient) {
            worst = worst.max((a - b).abs() / (a.abs() + 1e-4 * size));
            assert!((a - b).abs() <= 1e-10 * a.abs() + 1e-13 * size, "{name}: {a} {b}");
        }
    }
    println!("largest relative difference {worst:.1e}");
}

/// Relative difference between `exact` and the slope of the loss along parameter `k`, by differences
/// of second and fourth order with the best of their steps: long ones see pairs that turn from
/// approach to recession, short ones round-off.
fn difference<const D: usize>(
    learner: &mut Learner<D>,
    (at, k): (&[f64], usize),
    exact: f64,
) -> f64 {
    let mut loss = |step: f64| {
        let mut moved = at.to_vec();
        moved[k] += step * at[k];
        learner.evaluate(&moved, FRAMES).unwrap().loss
    };
    let mut best = f64::INFINITY;
    for step in [1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6] {
        let near = loss(step) - loss(-step);
        let far = loss(2.0 * step) - loss(-2.0 * step);
        for slope in [near / (2.0 * step), (8.0 * near - far) / (12.0 * step)] {
            best = best.min((slope / (exact * at[k]) - 1.0).abs());
        }
        if best < 1e-9 {
            break;
        }
    }
    best
}

#[test]
fn gradients_equal_central_differences() {
    let mut worst = (0.0_f64, String::new());
    for (name, scene) in every_scene() {
        let (at, [exact, _]) = (guess(&scene), forward_and_adjoint(&scene));
        for (k, &slope) in exact.gradient.iter().enumerate() {
            let error = match scene.dimension {
                2 => difference(&mut learner::<2>(&scene, Gradient::Forward), (&at, k), slope),
                _ => difference(&mut learner::<3>(&scene, Gradient::Forward), (&at, k), slope),
            };
            assert!(error <= 1e-6, "{name}, parameter {k}: {error:.1e}");
            if error > worst.0 {
                worst = (error, format!("{name}, {}", Parameter::PHYSICAL[k].name()));
            }
        }
    }
    println!("worst: {:.1e}, {}", worst.0, worst.1);
}

#[test]
fn the_loss_at_the_parameters_of_the_truth_is_zero() {
    for (name, scene) in every_scene() {
        let learned = scene.learning().unwrap().parameters.iter();
        let at: Vec<f64> = learned.map(|p| scene.parameters().get(p).unwrap()).collect();
        let kl = match scene.dimension {
            2 => learner::<2>(&scene, Gradient::Forward).evaluate(&at, FRAMES).unwrap().kl,
            _ => learner::<3>(&scene, Gradient::Forward).evaluate(&at, FRAMES).unwrap().kl,
        };
        // A divergence of order one is summed over 200 nodes.
        assert!(kl.abs() < 1e-14, "{name}: {kl:e}");
    }
}

/// The divergence of each frame of a flow with the guessed parameters, directly from its states.
fn frame_by_frame<const D: usize>(scene: &Scene, truth: &Truth<D>) -> Vec<f64> {
    let mut flow = Flow::<D>::from_state(scene, &truth.states[0]).unwrap();
    flow.set_learned(&scene.learning().unwrap().parameters, &guess(scene)).unwrap();
    flow.start().unwrap();
    let mut predicted = Truth::default();
    predicted.keep(&mut flow);
    let frame = |frame| {
        flow.step().unwrap();
        predicted.keep(&mut flow);
        let densities = IncrementDensities::new(&truth.increments(frame), 200).unwrap();
        densities.loss(&predicted.increments(frame)).unwrap().value
    };
    (1..=FRAMES).map(frame).collect()
}

fn the_times_that_count_are_those_asked_for<const D: usize>() {
    for times in [Times::Last, Times::All] {
        let scene = scene(D, Step::KickDriftKick, Weights { kl: 0.3, ..KL }, times);
        let frames = frame_by_frame(&scene, &truth::<D>(&scene));
        let mut learner = learner::<D>(&scene, Gradient::Forward);
        for window in 1..=FRAMES {
            let expected = match times {
                Times::Last => 0.3 * frames[window - 1],
                Times::All => 0.3 * scene.dt() * frames[..window].iter().sum::<f64>(),
            };
            let found = learner.evaluate(&guess(&scene), window).unwrap().kl;
            assert!((found - expected).abs() < 1e-12 * expected, "{times:?} {window}");
        }
    }
}

#[test]
fn the_times_that_count_are_those_asked_for_in_2d_and_3d() {
    the_times_that_count_are_those_asked_for::<2>();
    the_times_that_count_are_those_asked_for::<3>();
}

#[test]
fn any_number_of_threads_finds_the_same_bits() {
    let scene = scene(3, Step::KickDriftKick, FIELD_AND_KL, Times::All);
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let bits = |e: Evaluation| {
            let numbers = [e.loss, e.kl].into_iter().chain(e.gradient);
            numbers.map(f64::to_bits).collect::<Vec<_>>()
        };
        pool.install(|| forward_and_adjoint(&scene).map(bits))
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn a_search_by_adam_lowers_the_loss() {
    let mut scene = scene(3, Step::KickDriftKick, FIELD_AND_KL, Times::Last);
    if let Some(learn) = &mut scene.learn {
        (learn.iterations, learn.windows) = (40, vec![2]);
        learn.optimiser = Optimiser::Adam { rate: 0.1, decay: 0.9 };
    }
    for gradient in [Gradient::Forward, Gradient::Adjoint] {
        let mut learner = learner::<3>(&scene, gradient);
        let outcome = learner.run(guess(&scene), &mut |_| Ok(())).unwrap();
        let (first, last) = (outcome.initial_loss, outcome.evaluation);
        println!("{gradient:?}: {first:.2e} -> {:.2e}, kl {:.2e}", last.loss, last.kl);
        assert!(last.loss < 0.3 * first, "{first} -> {}", last.loss);
    }
}

#[test]
fn the_sampling_floor_is_the_divergence_between_realisations() {
    let scene = scene(3, Step::KickDriftKick, KL, Times::Last);
    let learn = scene.learning().unwrap();
    let other = truth::<3>(&Scene { seed: scene.seed + 1, ..scene.clone() });
    let one = truth::<3>(&scene);
    let ways = [(&one, &other), (&other, &one)].map(|(truth, predicted)| {
        let densities = IncrementDensities::new(&truth.increments(FRAMES), 200).unwrap();
        densities.loss(&predicted.increments(FRAMES)).unwrap().value
    });
    let floor = statistical_floor(&[&one, &other], &scene, learn).unwrap();
    println!("sampling floor {floor:.2e}");
    assert!((floor - 0.5 * (ways[0] + ways[1])).abs() < 1e-12 * floor);
    // 512 particles, three components.
    assert!(1e-3 < floor && floor < 1.0);
    let alone = statistical_floor(&[&one], &scene, learn).unwrap_err();
    assert_eq!(alone.exit_code(), 2, "{alone}");
}

#[test]
fn a_velocity_lost_on_the_way_is_a_failure_of_the_flow_that_names_it() {
    let scene = scene(3, Step::KickDriftKick, KL, Times::All);
    let truth = truth::<3>(&scene);
    let observations = || truth.observations(&scene, scene.learning().unwrap()).unwrap();
    let start = &truth.states[0];
    let by = Differentiation { parameters: vec![Parameter::C], coupling: Coupling::Full };
    let forward = Flow::build(&scene, start, Some(&by), Some(observations())).unwrap();
    let backward = Flow::with_adjoint(&scene, start, observations()).unwrap();
    for mut flow in [forward, backward] {
        flow.step().unwrap();
        let world = flow.world_mut();
        let mut velocities = world.query::<&mut Velocity<3>>();
        velocities.iter_mut(world).nth(17).unwrap().0[1] = f64::NAN;
        let error = flow.step().unwrap_err();
        assert!(error.to_string().contains("of particle 17"), "{error}");
        assert!(flow.loss().value_of("kl").is_infinite(), "{:?}", flow.loss());
    }
}

#[test]
fn a_truth_with_a_lost_velocity_is_refused() {
    let scene = scene(2, Step::KickDriftKick, KL, Times::Last);
    let mut truth = truth::<2>(&scene);
    truth.states[3].velocities[5][0] = f64::NAN;
    let error = truth.observations(&scene, scene.learning().unwrap()).unwrap_err();
    assert_eq!(error.exit_code(), 2);
    assert!(error.to_string().contains("velocity of particle 5 in frame 3"), "{error}");
}

#[test]
fn what_a_statistical_loss_cannot_be_learned_with_is_refused_with_a_reason() {
    let adam = "learn.optimiser={kind='adam',rate=0.1}";
    for (overrides, expected) in [
        (vec!["learn.loss.kl=1.0"], "not a sum of squares"),
        (vec![adam, "learn.loss.kl=1.0", "learn.increments.nodes=15"], "at least 16 nodes"),
        (vec![adam, "learn.loss.kl=-1.0"], "kl -1"),
        (vec![adam, "learn.increments.times='first'"], "first"),
        (vec![adam, "learn.increments.bandwidth=0.1"], "bandwidth"),
    ] {
        let overrides: Vec<String> = overrides.into_iter().map(str::to_owned).collect();
        let error = Scene::open("inverse-3d", &overrides).unwrap_err();
        assert_eq!(error.exit_code(), 2);
        assert!(error.to_string().contains(expected), "{error}");
    }
}
