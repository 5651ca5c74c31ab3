//! The loss of velocity increments: a divergence, its exact gradient, and finite numbers in all
//! extremes.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use whirls::losses::{Density1d, IncrementDensities, increment_loss, sampling_floor};
use whirls::vector::Vector;

const NODES: usize = 200;

fn normal(seed: u64, count: usize, mean: f64, deviation: f64) -> Vec<f64> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    (0..count).map(|_| mean + deviation * random.sample::<f64, _>(StandardNormal)).collect()
}

fn loss(truth: &[f64], predicted: &[f64]) -> f64 {
    increment_loss(truth, predicted, NODES).unwrap().value
}

/// The largest difference between the gradient and central differences with the best of three steps,
/// over `picks` samples, relative to the largest component of the gradient.
fn gradient_error(truth: &[f64], predicted: &[f64], picks: usize, scale: f64) -> f64 {
    let density = Density1d::new(truth, NODES).unwrap();
    let exact = density.loss(predicted).unwrap().gradient;
    let size = exact.iter().fold(0.0, |size: f64, g| size.max(g.abs()));
    let mut worst: f64 = 0.0;
    for pick in 0..picks {
        let k = pick * predicted.len() / picks;
        let value = |x: f64| {
            let mut moved = predicted.to_vec();
            moved[k] = x;
            density.loss(&moved).unwrap().value
        };
        let difference = |step: f64| {
            let x = predicted[k];
            let near = (value(x + step) - value(x - step)) / (2.0 * step);
            let far = (value(x + 2.0 * step) - value(x - 2.0 * step)) / (4.0 * step);
            ((4.0 * near - far) / 3.0 - exact[k]).abs()
        };
        let steps = [1e-2, 1e-3, 1e-4].map(|step| difference(step * scale));
        worst = worst.max(steps.into_iter().fold(f64::INFINITY, f64::min) / size);
    }
    worst
}

#[test]
fn a_density_integrates_to_one() {
    let density = Density1d::new(&normal(1, 4096, 0.3, 0.8), NODES).unwrap();
    let x: Vec<f64> = density.nodes().collect();
    let log = density.log_density();
    let mass: f64 =
        (1..NODES).map(|k| 0.5 * (x[k] - x[k - 1]) * (log[k].exp() + log[k - 1].exp())).sum();
    assert!((mass - 1.0).abs() < 1e-9, "{mass}");
}

#[test]
fn a_density_is_the_mean_of_the_kernels() {
    let samples = normal(2, 500, -0.2, 1.3);
    let count = samples.len() as f64;
    let mean = samples.iter().sum::<f64>() / count;
    let variance = samples.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (count - 1.0);
    let b = 0.9 * variance.sqrt() * count.powf(-0.2);
    let density = Density1d::new(&samples, NODES).unwrap();
    for (x, log) in density.nodes().zip(density.log_density()) {
        let bells: f64 = samples.iter().map(|s| (-0.5 * ((x - s) / b).powi(2)).exp()).sum();
        let plain = bells / (count * b * std::f64::consts::TAU.sqrt());
        assert!((log.exp() - plain).abs() < 1e-9 * plain + 1e-12, "{x}: {log} {plain}");
    }
}

#[test]
fn the_floor_does_not_move_the_divergence_of_samples_that_overlap() {
    let (truth, predicted) = (normal(70, 4096, 0.0, 1.0), normal(71, 4096, 0.0, 1.0));
    let density = Density1d::new(&truth, NODES).unwrap();
    let x: Vec<f64> = density.nodes().collect();
    // Without a floor, directly from the definition; bandwidths of almost equal samples.
    let log_density = |samples: &[f64], x: f64| {
        let count = samples.len() as f64;
        let mean = samples.iter().sum::<f64>() / count;
        let square = samples.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (count - 1.0);
        let b = 0.9 * square.sqrt() * count.powf(-0.2);
        let exponents = samples.iter().map(|s| -0.5 * ((x - s) / b).powi(2));
        let top = exponents.clone().fold(f64::NEG_INFINITY, f64::max);
        top + exponents.map(|e| (e - top).exp()).sum::<f64>().ln()
            - (count * b * std::f64::consts::TAU.sqrt()).ln()
    };
    let part = |&x: &f64| {
        let (truth, predicted) = (log_density(&truth, x), log_density(&predicted, x));
        truth.exp() * (truth - predicted)
    };
    let plain = (x[1] - x[0]) * x.iter().map(part).sum::<f64>();
    let value = density.loss(&predicted).unwrap().value;
    println!("{value:.6e} with the floor, {plain:.6e} without");
    assert!((value - plain).abs() < 1e-2 * plain, "{value} {plain}");
}

#[test]
fn the_divergence_of_a_sample_from_itself_is_zero() {
    for truth in [normal(3, 4096, 0.0, 1.0), vec![0.25], vec![0.0; 7], vec![3.0; 7]] {
        assert_eq!(loss(&truth, &truth).to_bits(), 0.0_f64.to_bits());
    }
    let truth = normal(3, 4096, 0.0, 1.0);
    let reversed: Vec<f64> = truth.iter().rev().copied().collect();
    assert!(loss(&truth, &reversed).abs() < 1e-12);
}

#[test]
fn the_divergence_is_never_negative() {
    for seed in 0..40 {
        let mean = 0.05 * seed as f64 * (seed % 3) as f64;
        let truth = normal(seed, 300, 0.0, 1.0);
        let value = loss(&truth, &normal(seed + 100, 300, mean, 0.7 + 0.03 * seed as f64));
        assert!(value > -1e-6, "{seed}: {value}");
    }
}

#[test]
fn the_divergence_of_normal_samples_is_the_analytic_one() {
    let count = 20_000;
    // Kernels of bandwidth 0.9 σ N^(−1/5) broaden both.
    let wide = 1.0 + 0.81 * (count as f64).powf(-0.4);
    let moments = |x: &[f64]| {
        let mean = x.iter().sum::<f64>() / count as f64;
        (mean, wide * x.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / count as f64)
    };
    let truth = normal(5, count, 0.0, 1.0);
    for (mean, deviation) in [(0.5, 1.0), (0.0, 1.4), (-0.3, 0.8), (1.0, 1.2)] {
        let predicted = normal(6, count, mean, deviation);
        let ((a, v), (b, w)) = (moments(&truth), moments(&predicted));
        let analytic = 0.5 * ((w / v).ln() + (v + (a - b) * (a - b)) / w - 1.0);
        let value = loss(&truth, &predicted);
        println!("{value:.5} against {analytic:.5}");
        // The tail of a finite sample ends; where the truth's extends further, the error is a few
        // per cent.
        assert!((value - analytic).abs() < 0.05 * analytic, "{value} against {analytic}");
    }
}

#[test]
fn the_gradient_is_that_of_central_differences() {
    let truth = normal(7, 500, 0.1, 1.0);
    for (mean, deviation) in [(0.1, 1.0), (0.6, 1.3), (-0.5, 0.6), (2.0, 1.0), (0.0, 4.0)] {
        let predicted = normal(8, 500, mean, deviation);
        let error = gradient_error(&truth, &predicted, 25, deviation);
        println!("mean {mean}, deviation {deviation}: {error:.1e}");
        assert!(error < 1e-7, "{mean} {deviation}: {error:e}");
    }
}

#[test]
fn the_gradient_is_exact_for_disjoint_and_for_collapsed_predictions() {
    let truth = normal(9, 400, 0.0, 1.0);
    for (mean, deviation) in [(8.0, 1.0), (30.0, 0.5), (-1e3, 2.0), (0.2, 0.05), (3.0, 1e-3)] {
        let predicted = normal(10, 300, mean, deviation);
        let error = gradient_error(&truth, &predicted, 15, deviation.max(0.1));
        println!("mean {mean}, deviation {deviation}: {error:.1e}");
        assert!(error < 1e-7, "{mean} {deviation}: {error:e}");
    }
}

#[test]
fn disjoint_samples_give_a_large_finite_loss_that_pulls_home() {
    let truth = normal(11, 1000, 0.0, 1.0);
    let mut last = 1.0;
    for away in [5.0, 20.0, 100.0, 1e4, 1e6] {
        let result = increment_loss(&truth, &normal(12, 1000, away, 0.5), NODES).unwrap();
        assert!(result.value.is_finite() && result.value > last, "{away}: {}", result.value);
        last = result.value;
        assert!(result.gradient.iter().all(|g| g.is_finite()));
        assert!(result.gradient.iter().sum::<f64>() > 0.0, "{away}: towards the truth is down");
    }
}

#[test]
fn a_spread_too_small_grows_and_one_too_large_shrinks() {
    let truth = normal(13, 1000, 0.0, 1.0);
    let growth = |deviation: f64| {
        let predicted = normal(14, 1000, 0.0, deviation);
        let result = increment_loss(&truth, &predicted, NODES).unwrap();
        assert!(result.value.is_finite() && result.value > 0.0);
        result.gradient.iter().zip(&predicted).map(|(g, x)| -g * x).sum::<f64>()
    };
    for deviation in [1e-3, 0.01, 0.1, 0.5] {
        assert!(growth(deviation) > 0.0, "{deviation}");
    }
    for deviation in [2.0, 10.0, 1e3] {
        assert!(growth(deviation) < 0.0, "{deviation}");
    }
}

#[test]
fn descending_the_gradient_brings_a_prediction_home() {
    let truth = normal(15, 500, 0.0, 1.0);
    for (mean, deviation) in [(12.0, 0.3), (-3.0, 3.0), (0.5, 0.02)] {
        let base = normal(16, 500, 0.0, 1.0);
        let (mut place, mut width) = (mean, f64::ln(deviation));
        for step in 0..1500 {
            let predicted: Vec<f64> = base.iter().map(|x| place + width.exp() * x).collect();
            let g = increment_loss(&truth, &predicted, NODES).unwrap().gradient;
            let by_place: f64 = g.iter().sum();
            let by_width: f64 = g.iter().zip(&base).map(|(g, x)| g * x * width.exp()).sum();
            let rate = 0.03 * (1.0 - f64::from(step) / 1500.0);
            place -= rate * by_place.signum();
            width -= rate * by_width.signum();
        }
        println!("from {mean}, {deviation}: {place:.3}, {:.3}", width.exp());
        assert!(place.abs() < 0.15 && (width.exp() - 1.0).abs() < 0.1, "{place} {width}");
    }
}

#[test]
fn samples_without_spread_give_numbers() {
    let spread = normal(17, 200, 0.0, 1.0);
    let single = [vec![0.0], vec![0.5; 9], vec![0.0; 9], vec![-2.0], vec![1e6; 3]];
    for a in single.iter().chain([&spread]) {
        for b in single.iter().chain([&spread]) {
            let result = increment_loss(a, b, NODES).unwrap();
            assert!(result.value.is_finite(), "{:?} {:?}: {}", a[0], b[0], result.value);
            assert!(result.gradient.iter().all(|g| g.is_finite()));
        }
    }
}

#[test]
fn what_cannot_be_compared_is_refused_with_a_reason() {
    let fine = [0.0, 1.0];
    for bad in [&[][..], &[f64::NAN], &[0.0, f64::INFINITY], &[1e300, -1e300]] {
        for error in [increment_loss(bad, &fine, NODES), increment_loss(&fine, bad, NODES)] {
            assert!(error.unwrap_err().to_string().contains("at least one sample"));
        }
    }
    assert!(increment_loss(&fine, &fine, 3).unwrap_err().to_string().contains("nodes"));
    assert!(sampling_floor(&[&fine], NODES).is_err());
}

#[test]
fn components_add_up() {
    let vectors = |seed| -> Vec<Vector<f64, 3>> {
        let axes = [0, 1, 2_u64].map(|k| normal(seed + k, 300, 0.1 * k as f64, 1.0));
        (0..300).map(|k| Vector([axes[0][k], axes[1][k], axes[2][k]])).collect()
    };
    let (truth, predicted) = (vectors(20), vectors(30));
    let sum = IncrementDensities::new(&truth, NODES).unwrap().loss(&predicted).unwrap();
    let mut value = 0.0;
    for axis in 0..3 {
        let one = |v: &[Vector<f64, 3>]| v.iter().map(|v| v[axis]).collect::<Vec<_>>();
        let part = increment_loss(&one(&truth), &one(&predicted), NODES).unwrap();
        value += part.value;
        for (sum, part) in sum.gradient.iter().zip(part.gradient) {
            assert_eq!(sum[axis].to_bits(), part.to_bits());
        }
    }
    assert_eq!(sum.value.to_bits(), value.to_bits());
}

#[test]
fn two_hundred_nodes_are_enough() {
    let (truth, predicted) = (normal(40, 4096, 0.0, 1.0), normal(41, 4096, 0.3, 1.2));
    let coarse = loss(&truth, &predicted);
    let fine = increment_loss(&truth, &predicted, 3200).unwrap().value;
    println!("{coarse} on 200 nodes, {fine} on 3200");
    assert!((coarse - fine).abs() < 1e-5 * fine, "{coarse} {fine}");
}

#[test]
fn the_sampling_floor_is_small_and_falls_with_the_number_of_samples() {
    let floor = |count| {
        let all: Vec<_> = (0..5).map(|seed| normal(50 + seed, count, 0.0, 1.0)).collect();
        let all: Vec<&[f64]> = all.iter().map(|x| &x[..]).collect();
        sampling_floor(&all, NODES).unwrap()
    };
    let (few, many) = (floor(512), floor(4096));
    println!("sampling floor of one component: {few:.2e} at 512, {many:.2e} at 4096");
    assert!(0.0 < many && many < few && many < 1e-2);
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads() {
    let (truth, predicted) = (normal(60, 4096, 0.0, 1.0), normal(61, 4096, 0.3, 1.2));
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| increment_loss(&truth, &predicted, NODES).unwrap())
    };
    assert_eq!(with(1), with(3));
}
