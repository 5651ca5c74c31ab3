//! Searches in data with measurement noise: all end with a result, and with correct standard
//! errors.
//!
//! `WHIRLS_NOISE_SEEDS=32 cargo test --release --test noise -- --nocapture` runs all 32 seeds and prints every one.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use crate::common;

use common::{densities, true_value};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use whirls::Scene;
use whirls::flow::State;
use whirls::learn::{Learner, Outcome, Stop};
use whirls::truth::Truth;

/// Noise of positions in particle spacings, and of velocities in root-mean-square velocities.
const LEVELS: [(f64, f64); 3] = [(0.005, 0.05), (0.013, 0.05), (0.05, 0.2)];

fn scene(more: &[&str]) -> Scene {
    let small = ["fluid.particles_per_side=8", "fluid.smoothing_length=0.67", "learn.after=19"];
    let overrides = small.iter().chain(more).map(|&key| key.to_owned());
    Scene::open("inverse-3d", &overrides.collect::<Vec<_>>()).unwrap()
}

/// Number of seeds, `few` unless the environment sets more.
fn seeds(few: u64) -> std::ops::RangeInclusive<u64> {
    let asked = std::env::var("WHIRLS_NOISE_SEEDS").ok().and_then(|count| count.parse().ok());
    1..=asked.unwrap_or(few)
}

/// A measured truth: with normal noise on every frame from `first` on.
fn measured(
    (scene, truth): (&Scene, &Truth<3>),
    (positions, velocities): (f64, f64),
    (first, seed): (usize, u64),
) -> Truth<3> {
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    let speeds: f64 = truth.states[0].velocities.iter().map(|v| v.norm_squared()).sum();
    let speed = (speeds / (3 * truth.states[0].velocities.len()) as f64).sqrt();
    let (positions, velocities) = (positions * common::spacing(scene), velocities * speed);
    let mut measured = Truth { is_recorded: true, ..truth.clone() };
    for (k, state) in measured.states.iter_mut().enumerate().skip(first) {
        let mut shake = |all: &mut [whirls::vector::Vector<f64, 3>], size: f64| {
            for x in all.iter_mut().flat_map(|r| &mut r.0) {
                *x += size * generator.sample::<f64, _>(StandardNormal);
            }
        };
        shake(&mut state.positions, positions);
        shake(&mut state.velocities, velocities);
        let length = scene.fluid.box_length;
        let inside = state
            .positions
            .iter()
            .map(|r| whirls::vector::Vector(r.0.map(|x| x.rem_euclid(length))));
        let inside = State { positions: inside.collect(), ..state.clone() };
        measured.densities[k] = densities(scene, &inside);
        *state = inside;
    }
    measured
}

/// A search from the guess of a seed.
fn search(scene: &Scene, truth: &Truth<3>, seed: u64) -> Outcome {
    let mut learner = Learner::of_truth(scene, truth).unwrap();
    let guess = learner.guess(seed);
    learner.run(guess, &mut |_| Ok(())).unwrap()
}

/// The deviation of each parameter in standard errors; infinite for a parameter that is not
/// identified.
fn deviations(scene: &Scene, outcome: &Outcome) -> Vec<f64> {
    let parameters = &scene.learn.as_ref().unwrap().parameters;
    let off = parameters.iter().zip(&outcome.evaluation.parameters);
    off.map(|(p, value)| {
        let error = outcome.knowledge.standard_error.get(p.name());
        error.map_or(f64::INFINITY, |error| (value - true_value(scene, p)).abs() / error)
    })
    .collect()
}

fn show(seed: u64, scene: &Scene, outcome: &Outcome) {
    let names = &scene.learn.as_ref().unwrap().parameters;
    let values = names.iter().zip(&outcome.evaluation.parameters);
    let words = values.map(|(p, &x)| format!("{p} {}", outcome.knowledge.value(p.name(), x)));
    println!(
        "{seed:3} {:3} iterations, loss {:.2e}, {:?}: {}; {:?}",
        outcome.iterations,
        outcome.evaluation.loss,
        outcome.knowledge.stopped_by,
        words.collect::<Vec<_>>().join(", "),
        outcome.knowledge.remarks
    );
}

#[test]
fn a_staged_search_in_noisy_data_always_ends_with_a_result() {
    for loss in ["learn.loss={field=1.0}", "learn.loss={trajectory=1.0,field=0.0}"] {
        let scene = scene(&[loss]);
        let truth = Truth::<3>::generate(&scene, (19, 10)).unwrap();
        for level in LEVELS {
            println!("{loss}, noise {level:?} on all frames");
            for seed in seeds(4) {
                let measured = measured((&scene, &truth), level, (0, seed));
                let outcome = search(&scene, &measured, seed);
                show(seed, &scene, &outcome);
                assert_eq!(outcome.knowledge.window, 10, "{:?}", outcome.knowledge.remarks);
                assert!(outcome.evaluation.loss < outcome.initial_loss, "seed {seed}");
            }
        }
    }
}

#[test]
fn true_values_are_within_two_standard_errors_where_the_first_frame_is_exact() {
    for loss in ["learn.loss={field=1.0}", "learn.loss={trajectory=1.0,field=0.0}"] {
        let scene = scene(&[loss]);
        let truth = Truth::<3>::generate(&scene, (19, 10)).unwrap();
        for level in [LEVELS[0], LEVELS[1]] {
            let (mut within, mut all) = (0, 0);
            println!("{loss}, noise {level:?} on all frames but the first");
            for seed in seeds(6) {
                let measured = measured((&scene, &truth), level, (1, seed));
                let outcome = search(&scene, &measured, seed);
                show(seed, &scene, &outcome);
                assert_eq!(outcome.knowledge.stopped_by, Stop::Noise);
                let off = deviations(&scene, &outcome);
                within += off.iter().filter(|&&off| off <= 2.0).count();
                all += off.len();
            }
            println!("within two standard errors: {within} of {all}");
            assert!(100 * within >= 85 * all, "{loss}, {level:?}: {within} of {all}");
        }
    }
}

/// The noise of positions and velocities of a level, in units of the flow.
fn sigmas((scene, truth): (&Scene, &Truth<3>), (positions, velocities): (f64, f64)) -> [f64; 2] {
    let speeds: f64 = truth.states[0].velocities.iter().map(|v| v.norm_squared()).sum();
    let speed = (speeds / (3 * truth.states[0].velocities.len()) as f64).sqrt();
    [positions * common::spacing(scene), velocities * speed]
}

/// `WHIRLS_NOISE_SIDE=16 WHIRLS_NOISE_SEEDS=20` is the measurement of the README.
#[test]
fn true_values_are_within_two_standard_errors_where_the_noisy_first_frame_is_estimated() {
    let side = std::env::var("WHIRLS_NOISE_SIDE").unwrap_or_else(|_| "8".to_owned());
    let size = [format!("fluid.particles_per_side={side}")];
    let h =
        if side == "8" { "fluid.smoothing_length=0.67" } else { "fluid.smoothing_length=0.335" };
    let more = [
        size[0].as_str(),
        h,
        "learn.loss={trajectory=1.0,field=0.0}",
        "learn.parameters=[\"c\",\"alpha\",\"gamma\"]",
    ];
    let plain = scene(&more);
    let truth = Truth::<3>::generate(&plain, (19, 10)).unwrap();
    let level = LEVELS[1];
    let [position, velocity] = sigmas((&plain, &truth), level);
    let initial = format!("learn.initial={{position={position:e},velocity={velocity:e}}}");
    let scene = scene(&[&more[..], &[initial.as_str()]].concat());
    let (mut within, mut all) = (0, 0);
    // Of each parameter: the sum of deviations from the truth, of stated variances, and of deviations where the first
    // frame is taken as exact.
    let mut sums = [[0.0; 3]; 3];
    let names = scene.learn.as_ref().unwrap().parameters.clone();
    for seed in seeds(4) {
        let measured = measured((&scene, &truth), level, (0, seed));
        let outcome = search(&scene, &measured, seed);
        show(seed, &scene, &outcome);
        let first = outcome.knowledge.first_frames.as_ref().unwrap();
        println!("    {}; {} products", first.words(), first.products);
        assert_eq!(outcome.knowledge.stopped_by, Stop::Noise, "{:?}", outcome.knowledge);
        let chi_squared = outcome.knowledge.residual_per_freedom.unwrap();
        assert!((0.95..1.05).contains(&chi_squared), "{chi_squared}");
        let off = deviations(&scene, &outcome);
        within += off.iter().filter(|&&off| off <= 2.0).count();
        all += off.len();
        for ((sum, p), value) in sums.iter_mut().zip(&names).zip(&outcome.evaluation.parameters) {
            let error = outcome.knowledge.standard_error[p.name()];
            *sum = [sum[0] + value - true_value(&scene, p), sum[1] + error * error, sum[2]];
        }
        let taken = search(&plain, &measured, seed);
        for ((sum, p), value) in sums.iter_mut().zip(&names).zip(&taken.evaluation.parameters) {
            sum[2] += value - true_value(&scene, p);
        }
    }
    let count = all as f64 / 3.0;
    for (sum, p) in sums.iter().zip(&names) {
        let (off, error) = (sum[0] / count, sum[1].sqrt() / count);
        let truth = true_value(&scene, p);
        println!(
            "mean {p} {:.4} +- {error:.4} for {truth}; with the first frame taken as exact {:.4}",
            truth + off,
            truth + sum[2] / count,
        );
        assert!(off.abs() <= 2.0 * error, "the mean of {p} is off by {off} +- {error}");
    }
    println!("within two standard errors: {within} of {all}");
    assert!(100 * within >= 85 * all, "{within} of {all}");
}

/// Positions alone, of ten frames: the initial velocities by a known law, and by differences of positions.
#[test]
fn from_noisy_positions_alone_initial_velocities_have_less_than_half_the_error_of_differences() {
    let alone = "learn.parameters=[]";
    let plain = scene(&["learn.loss={trajectory=1.0,field=0.0}"]);
    let truth = Truth::<3>::generate(&plain, (19, 10)).unwrap();
    let level = (LEVELS[1].0, 0.0);
    let [position, _] = sigmas((&plain, &truth), level);
    let initial = format!("learn.initial={{position={position:e},alone=true}}");
    let scene = scene(&["learn.guess={}", alone, &initial]);
    let mut measured = measured((&scene, &truth), level, (0, 1));
    let (dt, space) = (scene.observed_interval(), scene.space());
    let at = |k: usize| measured.states[k].positions.clone();
    let one_sided: Vec<_> =
        at(0).iter().zip(at(1)).map(|(&a, b)| space.minimum_image(b - a) * (1.0 / dt)).collect();
    let far: Vec<_> =
        at(0).iter().zip(at(10)).map(|(&a, b)| space.minimum_image(b - a) * (0.1 / dt)).collect();
    let error = |found: &[whirls::vector::Vector<f64, 3>]| {
        let off =
            found.iter().zip(&truth.states[0].velocities).map(|(&a, &b)| (a - b).norm_squared());
        (off.sum::<f64>() / (3 * found.len()) as f64).sqrt()
    };
    let differences = error(&one_sided).min(error(&far));
    measured.states[0].velocities = far.clone();
    let mut learner = Learner::of_truth(&scene, &measured).unwrap();
    let outcome = learner.run(Vec::new(), &mut |_| Ok(())).unwrap();
    let found = error(&learner.first_frames()[0].velocities);
    println!("{}", outcome.knowledge.first_frames.as_ref().unwrap().words());
    println!(
        "rms error of initial velocities: {found:.4}, of differences {:.4} (one frame) and {:.4} (ten frames)",
        error(&one_sided),
        error(&far)
    );
    assert_eq!(outcome.knowledge.stopped_by, Stop::Noise);
    assert!(found < 0.5 * differences, "{found} and {differences}");
}

/// The effect of noise in the first frame, which a prediction takes as exact: a bias of the
/// parameters that is not in the standard errors.
#[test]
fn noise_of_the_first_frame_biases_the_parameters_and_the_result_says_so() {
    let scene = scene(&["learn.loss={trajectory=1.0,field=0.0}"]);
    let truth = Truth::<3>::generate(&scene, (19, 10)).unwrap();
    for level in LEVELS {
        let mut means = [0.0; 4];
        let count = seeds(4).count() as f64;
        for seed in seeds(4) {
            let measured = measured((&scene, &truth), level, (0, seed));
            let outcome = search(&scene, &measured, seed);
            let values = outcome.evaluation.parameters.iter();
            means.iter_mut().zip(values).for_each(|(mean, value)| *mean += value / count);
            let said = |text: &String| text.contains("the first frame is taken as exact");
            assert!(outcome.knowledge.remarks.iter().any(said), "{:?}", outcome.knowledge.remarks);
        }
        println!("noise {level:?}: mean c, alpha, beta, gamma {means:.3?} for 10, 1, 2, 7");
    }
}
