//! Rollouts: derivatives of frames for losses that a caller writes, backwards and forwards.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use crate::common;

use common::in_2d_and_3d;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use whirls::Flow;
use whirls::flow::{Direction, State};
use whirls::learn::{Learner, columns};
use whirls::parameters::Parameter;
use whirls::scene::{Forcing, Law, Optimiser, Scene, Weights};
use whirls::sensitivity::{
    Frame, Gradient, RecordedRollout, RolloutGradient, RolloutPlan, Storage,
};
use whirls::systems::tape::FrameAdjoint;
use whirls::systems::verlet::Step;
use whirls::truth::Truth;
use whirls::vector::Vector;

const PLAN: RolloutPlan = RolloutPlan { steps: 6, every: 2, storage: Storage::All };

/// A small disordered flow whose law has viscosity, stiffness and forcing.
fn scene<const D: usize>(step: Step) -> Scene {
    let mut scene = common::scene::<D>(if D == 2 { 10 } else { 6 });
    scene.time.step = step;
    scene.forcing = Forcing::Deterministic { theta: 0.3, power: Default::default() };
    scene
}

/// The scene of a model of the hierarchy, with random weights.
fn network(name: &str) -> Scene {
    let small = ["fluid.particles_per_side=8".to_owned()];
    Scene::open(name, &small).unwrap()
}

fn random<const D: usize>(count: usize, generator: &mut ChaCha8Rng) -> Vec<Vector<f64, D>> {
    let vector = |_| Vector(std::array::from_fn(|_| generator.sample(StandardNormal)));
    (0..count).map(vector).collect()
}

/// Random cotangents of the first, the second and the last frame.
fn cotangents<const D: usize>(rollout: &RecordedRollout<D>, seed: u64) -> Vec<FrameAdjoint<D>> {
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    let last = rollout.frames().len() - 1;
    let cotangent = |frame| {
        let zero = rollout.zero_cotangent(frame);
        let count = zero.position.len();
        FrameAdjoint {
            position: random(count, &mut generator),
            velocity: random(count, &mut generator),
            density: (0..count).map(|_| generator.sample(StandardNormal)).collect(),
            ..zero
        }
    };
    [last, 0, 1].map(cotangent).to_vec()
}

/// A random direction of all parameters and of the initial state; parameters change in proportion to their size, and
/// weights of a network by one hundredth.
fn direction<const D: usize>(rollout: &RecordedRollout<D>, seed: u64) -> Direction<D> {
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    let count = rollout.frames()[0].densities.len();
    let specs = rollout.parameters().specs().iter();
    let parameters = specs.map(|spec| {
        let size = if spec.is_weight { 0.01 } else { spec.value };
        (spec.name.clone(), size * generator.sample::<f64, _>(StandardNormal))
    });
    let parameters = parameters.collect();
    let scaled = |by: f64, all: Vec<Vector<f64, D>>| all.into_iter().map(|x| x * by).collect();
    let positions = scaled(0.1, random(count, &mut generator));
    let velocities = scaled(0.3, random(count, &mut generator));
    Direction { parameters, positions, velocities }
}

/// `g · d`.
fn along<const D: usize>(gradient: &RolloutGradient<D>, direction: &Direction<D>) -> f64 {
    let own = direction.parameters.iter().map(|(name, by)| gradient.of(name).unwrap() * by);
    let dot = |a: &[Vector<f64, D>], b: &[Vector<f64, D>]| {
        a.iter().zip(b).map(|(a, &b)| a.dot(b)).sum::<f64>()
    };
    own.sum::<f64>()
        + dot(&gradient.positions, &direction.positions)
        + dot(&gradient.velocities, &direction.velocities)
}

/// The point at a distance along a direction from a scene's own parameters and a start.
fn moved<const D: usize>(
    (start, own): (&State<D>, &[(Parameter, f64)]),
    direction: &Direction<D>,
    by: f64,
) -> (State<D>, Vec<(Parameter, f64)>) {
    let add = |a: &[Vector<f64, D>], b: &[Vector<f64, D>]| {
        a.iter().zip(b).map(|(&a, &b)| a + b * by).collect()
    };
    let state = State {
        time: start.time,
        positions: add(&start.positions, &direction.positions),
        velocities: add(&start.velocities, &direction.velocities),
    };
    let values = own.iter().zip(&direction.parameters);
    (state, values.map(|((name, value), (_, d))| (name.clone(), value + by * d)).collect())
}

/// `Σ c · (frame − base)` over all cotangents, positions as nearest images.
fn linear_loss<const D: usize>(
    scene: &Scene,
    (frames, base): (&[Frame<D>], &[Frame<D>]),
    cotangents: &[FrameAdjoint<D>],
) -> f64 {
    let space = common::space(scene);
    let share = |c: &FrameAdjoint<D>| {
        let k = frames.iter().position(|frame| frame.step == c.step).unwrap();
        let (now, then) = (&frames[k], &base[k]);
        let particle = |i: usize| {
            let r = space.minimum_image(now.state.positions[i] - then.state.positions[i]);
            let v = now.state.velocities[i] - then.state.velocities[i];
            let rho = now.densities[i] - then.densities[i];
            c.position[i].dot(r) + c.velocity[i].dot(v) + c.density[i] * rho
        };
        (0..c.position.len()).map(particle).sum::<f64>()
    };
    cotangents.iter().map(share).sum()
}

fn own_values<const D: usize>(rollout: &RecordedRollout<D>) -> Vec<(Parameter, f64)> {
    let specs = rollout.parameters().specs().iter();
    specs.map(|spec| (spec.name.clone(), spec.value)).collect()
}

/// By parameters, initial positions and initial velocities apart, so that none hides in the sum.
fn derivatives_by_parameters_and_initial_state_equal_central_differences<const D: usize>() {
    for step in [Step::KickDriftKick, Step::Paper] {
        let scene = scene::<D>(step);
        let start = common::shaken::<D>(&scene);
        let mut rollout = RecordedRollout::run(&scene, (&start, &[]), PLAN).unwrap();
        let own = own_values(&rollout);
        let base = rollout.frames().to_vec();
        let given = cotangents(&rollout, 1);
        let gradient = rollout.vjp(&given).unwrap();
        let all = direction(&rollout, 2);
        let still = vec![Vector::zero(); start.positions.len()];
        let fixed: Vec<_> = own.iter().map(|(name, _)| (name.clone(), 0.0)).collect();
        let parts = [
            Direction { positions: still.clone(), velocities: still.clone(), ..all.clone() },
            Direction { parameters: fixed.clone(), velocities: still.clone(), ..all.clone() },
            Direction { parameters: fixed, positions: still, ..all.clone() },
            all,
        ];
        for part in parts {
            let exact = along(&gradient, &part);
            let loss = |by: f64| {
                let (state, values) = moved((&start, &own), &part, by);
                let rollout = RecordedRollout::run(&scene, (&state, &values), PLAN).unwrap();
                linear_loss(&scene, (rollout.frames(), &base), &given)
            };
            let central = [3e-5, 1e-5, 3e-6, 1e-6].map(|by| {
                let (near, far) = (loss(by) - loss(-by), loss(2.0 * by) - loss(-2.0 * by));
                (((8.0 * near - far) / (12.0 * by) - exact) / exact).abs()
            });
            let best = central.into_iter().fold(f64::INFINITY, f64::min);
            println!("{D}D {step:?}: {exact:.6e}, differences off by {best:.1e}");
            assert!(best <= 1e-6, "{D}D {step:?}: {exact} {central:?}");
        }
    }
}

/// `⟨c, J d⟩ = ⟨Jᵀ c, d⟩` for the model of a scene; `J d` of two directions at once, and of more than eight.
fn must_be_transposed<const D: usize>(scene: &Scene, start: &State<D>) {
    let mut rollout = RecordedRollout::<D>::run(scene, (start, &[]), PLAN).unwrap();
    let directions: Vec<Direction<D>> = (0..9).map(|seed| direction(&rollout, seed)).collect();
    let given = cotangents(&rollout, 11);
    let gradient = rollout.vjp(&given).unwrap();
    let tangents = rollout.jvp(&directions).unwrap();
    for (direction, tangents) in directions.iter().zip(&tangents) {
        let backwards = along(&gradient, direction);
        let mut size = 0.0;
        let mut forwards = 0.0;
        for c in &given {
            let found = tangents.iter().find(|tangent| tangent.step == c.step).unwrap();
            for i in 0..c.position.len() {
                let terms = [
                    c.position[i].dot(found.positions[i]),
                    c.velocity[i].dot(found.velocities[i]),
                    c.density[i] * found.densities[i],
                ];
                forwards += terms.iter().sum::<f64>();
                size += terms.iter().map(|x| x.abs()).sum::<f64>();
            }
        }
        let name = scene.model().kind();
        assert!((forwards - backwards).abs() <= 1e-12 * size, "{name}: {forwards} {backwards}");
        assert!(backwards.abs() > 1e-6 * size, "{name}: {backwards} of {size} says nothing");
    }
}

fn forwards_and_backwards_are_transposed_to_round_off<const D: usize>() {
    for step in Step::ALL {
        let scene = scene::<D>(step);
        must_be_transposed(&scene, &common::shaken::<D>(&scene));
    }
}

#[test]
fn so_they_are_for_the_weights_of_networks() {
    for name in ["node-2d", "nn-sum-2d", "rot-inv-2d", "grad-p-2d", "eos-nn-2d"] {
        let scene = network(name);
        must_be_transposed::<2>(&scene, &State::initial(&scene));
    }
}

/// The trajectory loss, written by a caller, of a flow that learns from a truth.
fn a_trajectory_loss_of_the_caller_has_the_bits_of_the_learners_adjoint<const D: usize>() {
    let side = if D == 2 { 10 } else { 6 };
    let name = if D == 2 { "inverse-2d" } else { "inverse-3d" };
    let mut scene =
        Scene::open(name, &[format!("fluid.particles_per_side={side}"), "learn.windows=[]".into()])
            .unwrap();
    if let Some(learn) = &mut scene.learn {
        (learn.frames, learn.every, learn.gradient) = (3, 2, Gradient::Adjoint);
        learn.optimiser = Optimiser::Adam { rate: 0.1, decay: 1.0 };
        learn.loss = Weights { trajectory: 1.0, field: 0.0, kl: 0.0 };
    }
    let truth = Truth::<D>::generate(&scene, (3, 3)).unwrap();
    let mut learner = Learner::of_truth(&scene, &truth).unwrap();
    let at = [8.0, 0.7, 1.6, 5.0, 0.08];
    let names = learner.columns().to_vec();
    let expected = learner.evaluate(&at[..names.len()], 3).unwrap();
    let values: Vec<_> = names.iter().cloned().zip(at).collect();
    let space = common::space(&scene);
    let weight = 1.0 / truth.states[0].positions.len() as f64;
    for storage in [Storage::All, Storage::Checkpoints(2), Storage::Bytes(10_000_000)] {
        let plan = RolloutPlan { storage, ..PLAN };
        let run = (&truth.states[0], &values[..]);
        let mut rollout = RecordedRollout::<D>::run(&scene, run, plan).unwrap();
        let mut given = Vec::new();
        for (k, seen) in truth.states.iter().enumerate().skip(1) {
            let state = &rollout.frames()[k].state;
            let mut cotangent = rollout.zero_cotangent(k);
            for i in 0..seen.positions.len() {
                let r = space.minimum_image(state.positions[i] - space.wrap(seen.positions[i]));
                cotangent.position[i] = r * (2.0 * weight);
                cotangent.velocity[i] = (state.velocities[i] - seen.velocities[i]) * (2.0 * weight);
            }
            given.push(cotangent);
        }
        for _ in 0..2 {
            let found = rollout.vjp(&given).unwrap();
            for (name, expected) in names.iter().zip(&expected.gradient) {
                let found = found.of(name).unwrap();
                assert_eq!(found.to_bits(), expected.to_bits(), "{storage:?} {name}");
            }
        }
    }
}

fn every_storage_gives_the_same_bits_within_its_memory<const D: usize>() {
    let scene = scene::<D>(Step::KickDriftKick);
    let start = common::shaken::<D>(&scene);
    let run = |storage| {
        let plan = RolloutPlan { steps: 12, every: 3, storage };
        let mut rollout = RecordedRollout::run(&scene, (&start, &[]), plan).unwrap();
        let given = cotangents(&rollout, 5);
        (rollout.vjp(&given).unwrap(), rollout.frames().to_vec(), rollout.bytes())
    };
    let (gradient, frames, all) = run(Storage::All);
    for storage in [1, 2, 3, 50].map(Storage::Checkpoints) {
        let (found, same, bytes) = run(storage);
        assert_eq!((&found, &same), (&gradient, &frames), "{storage:?}");
        assert!(storage != Storage::Checkpoints(1) || bytes < all / 2, "{bytes} of {all} bytes");
    }
    let plan = RolloutPlan { steps: 12, every: 3, storage: Storage::Bytes(1000) };
    let refused = RecordedRollout::run(&scene, (&start, &[]), plan).err().unwrap().to_string();
    assert!(refused.contains("at least") && refused.contains("1000 bytes"), "{refused}");
}

in_2d_and_3d!(
    a_rollout_of_a_scene_with_a_learned_law_follows_that_law,
    derivatives_by_parameters_and_initial_state_equal_central_differences,
    forwards_and_backwards_are_transposed_to_round_off,
    a_trajectory_loss_of_the_caller_has_the_bits_of_the_learners_adjoint,
    every_storage_gives_the_same_bits_within_its_memory,
);

#[test]
fn what_a_rollout_cannot_mean_is_refused_with_a_reason() {
    let scene = scene::<2>(Step::KickDriftKick);
    let start = common::shaken::<2>(&scene);
    let of_run = |start: &State<2>, given: &[(Parameter, f64)], plan| {
        RecordedRollout::run(&scene, (start, given), plan).err().unwrap().to_string()
    };
    let mut lost = start.clone();
    lost.velocities[7][1] = f64::NAN;
    let mut short = start.clone();
    short.velocities.pop();
    let odd = RolloutPlan { steps: 5, ..PLAN };
    let refusals = [
        (of_run(&start, &[], odd), "5 steps"),
        (of_run(&lost, &[], PLAN), "particle 7"),
        (of_run(&short, &[], PLAN), "100 positions and 99 velocities"),
        (of_run(&start, &[("nu".into(), 1.0)], PLAN), "alpha"),
        (of_run(&start, &[(Parameter::C, f64::NAN)], PLAN), "parameter c"),
    ];
    for (found, expected) in refusals {
        assert!(found.contains(expected), "{found}");
    }
    let mut rollout = RecordedRollout::run(&scene, (&start, &[]), PLAN).unwrap();
    let zero = rollout.zero_cotangent(1);
    let mut refused = |change: &dyn Fn(&mut FrameAdjoint<2>)| {
        let mut given = zero.clone();
        change(&mut given);
        rollout.vjp(&[given]).unwrap_err().to_string()
    };
    let refusals = [
        (refused(&|c| c.step = 3), "step 3"),
        (refused(&|c| c.density.clear()), "[100, 100, 0]"),
        (refused(&|c| c.position[3][0] = f64::INFINITY), "step 2"),
    ];
    for (found, expected) in refusals {
        assert!(found.contains(expected), "{found}");
    }
    assert!(rollout.vjp(&[zero.clone(), zero]).unwrap_err().to_string().contains("twice"));
}

#[test]
fn a_derivative_that_overflows_is_an_error_with_the_step_where_that_began() {
    let scene = scene::<2>(Step::KickDriftKick);
    let start = common::shaken::<2>(&scene);
    let mut rollout = RecordedRollout::run(&scene, (&start, &[]), PLAN).unwrap();
    let mut huge = rollout.zero_cotangent(3);
    huge.position[0] = Vector([1.7e308; 2]);
    let error = rollout.vjp(&[huge]).unwrap_err();
    let step = error.diverged_at().unwrap();
    assert!(
        (1..=6).contains(&step) && error.to_string().contains("adjoint of particle"),
        "{error}"
    );
    let velocities = vec![Vector([1.7e308; 2]); start.positions.len()];
    let error = rollout.jvp(&[Direction { velocities, ..Direction::default() }]).unwrap_err();
    assert!(error.diverged_at().is_some(), "{error}");
    assert_eq!(rollout.jvp(&[]).unwrap(), Vec::<Vec<_>>::new());
    // The rollout is whole after that.
    let given = cotangents(&rollout, 3);
    assert!(rollout.vjp(&given).is_ok());
}

/// A scene that learns nothing, and names a learned law.
fn a_rollout_of_a_scene_with_a_learned_law_follows_that_law<const D: usize>() {
    let trained = network(if D == 2 { "eos-nn-2d" } else { "eos-nn-3d" });
    let names = columns::<D>(&trained, trained.learning().unwrap()).unwrap();
    let values: Vec<f64> = (0..names.len()).map(|k| 0.3 * (1.3 * k as f64).sin()).collect();
    let plain = scene::<D>(Step::KickDriftKick);
    let lawful = plain.clone().with_law(Law::learned_in(&trained, &names, &values)).unwrap();
    let mut flow = Flow::<D>::new(&lawful).unwrap();
    let start = flow.state();
    let last = |scene: &Scene| {
        let rollout = RecordedRollout::run(scene, (&start, &[]), PLAN).unwrap();
        rollout.frames().last().unwrap().state.clone()
    };
    (0..PLAN.steps).for_each(|_| flow.step().unwrap());
    assert_eq!(last(&lawful), flow.state());
    assert_ne!(last(&plain), flow.state());
}
