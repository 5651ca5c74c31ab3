//! The price list: the accuracy that each faster setting costs, measured on this machine.
//!
//! Flows are compared with a *reference*: the scene's own law from the same state, with a step of
//! second order that is sixteen times finer. Gradients are compared with the full, exact one, and
//! learned parameters with the truth. Times are measured in alternation with the scene's own
//! setting, and given as ratios to it, so that other loads on the machine affect both.

mod choose;
mod flows;
mod gradients;
mod knobs;
mod learned;
mod tables;

pub use choose::{CALIBRATION, Choice, Trial, calibrate_step, choose};
pub use flows::{FINER, FlowErrors, FlowPrice, distance, fine, price_flows};
pub use gradients::{GradientPrice, price_gradients};
pub use knobs::{Effect, Setting};
pub use learned::{LearnedPrice, price_learning};
pub use tables::{Prices, report};

use crate::scene::Scene;

/// The extent of the measurements.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Number of steps of the scene for which flows are followed.
    pub steps: u64,
    /// Number of measurements of each time, of which the median counts.
    pub rounds: usize,
    /// Number of iterations of each search, maximum.
    pub iterations: usize,
}

impl Plan {
    /// Settings in all, for an estimate of the time left.
    pub fn work(scene: &Scene) -> u64 {
        let learned = match &scene.learn {
            Some(_) => gradients::work(scene) + learned::work(scene),
            None => 0,
        };
        flows::work(scene) + learned
    }
}

impl Default for Plan {
    fn default() -> Self {
        Self { steps: 40, rounds: 5, iterations: 40 }
    }
}

/// The median; NaN for an empty list.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => f64::NAN,
        count => 0.5 * (values[(count - 1) / 2] + values[count / 2]),
    }
}

/// Error below which differences are round-off: none is better than another.
const ROUND_OFF: f64 = 1e-12;

/// Marks the settings that are best at their cost, among those with a cost and an error.
fn best(points: impl Iterator<Item = Option<(f64, f64)>>) -> Vec<bool> {
    let outside = (f64::NAN, f64::NAN);
    let points: Vec<_> = points.map(|point| point.unwrap_or(outside)).collect();
    pareto(
        &points
            .iter()
            .map(|&(cost, error)| (cost, error.clamp(ROUND_OFF, f64::INFINITY)))
            .collect::<Vec<_>>(),
    )
}

/// Marks the Pareto-optimal settings: no other is both cheaper and more accurate.
fn pareto(points: &[(f64, f64)]) -> Vec<bool> {
    let beaten = |&(cost, error): &(f64, f64)| {
        points.iter().any(|&(c, e)| c <= cost && e <= error && (c < cost || e < error))
    };
    points
        .iter()
        .map(|point| point.0.is_finite() && point.1.is_finite() && !beaten(point))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_are_those_that_nothing_beats_in_both() {
        let points = [(1.0, 1.0), (2.0, 0.1), (2.0, 0.2), (3.0, 0.1), (0.5, 9.0), (0.4, f64::NAN)];
        assert_eq!(pareto(&points), [true, true, false, false, true, false]);
    }

    #[test]
    fn errors_of_round_off_are_equal_and_who_has_none_stands_outside() {
        let points = [Some((1.0, 1e-15)), Some((2.0, 1e-16)), None, Some((0.5, 0.1))];
        assert_eq!(best(points.into_iter()), [true, false, false, true]);
    }

    #[test]
    fn the_median_of_an_even_number_is_between_the_middle_two() {
        assert!((median(vec![4.0, 1.0, 3.0, 2.0]) - 2.5).abs() < 1e-15);
        assert!(median(Vec::new()).is_nan());
    }
}
