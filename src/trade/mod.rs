//! The price list: what each setting that buys speed costs in accuracy, measured on this machine.
//!
//! Flows are compared with a *reference*: the scene's own law from the same state in steps sixteen
//! times finer, of second order. Gradients are compared with the full, exact one. Times are taken
//! in turns with the scene's own setting, and given as multiples of its: whatever else slows the machine
//! down slows both.

mod choose;
mod flows;
mod gradients;
mod tables;

pub use choose::{CALIBRATION, Choice, Trial, choose, settle};
pub use flows::{FlowErrors, FlowPrice, price_flows};
pub use gradients::{GradientPrice, price_gradients};
pub use tables::report;

use crate::scene::Scene;

/// How much is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    /// How far flows are followed, in steps of the scene.
    pub steps: u64,
    /// How often each time is taken; the median counts.
    pub rounds: usize,
}

impl Plan {
    /// Settings in all, for an estimate of the time left.
    pub fn work(scene: &Scene) -> u64 {
        flows::work(scene) + if scene.learn.is_some() { gradients::work(scene) } else { 0 }
    }
}

impl Default for Plan {
    fn default() -> Self {
        Self { steps: 40, rounds: 5 }
    }
}

/// What a setting does to the results.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect {
    /// Nothing but round-off.
    None,
    /// It approximates the same equations less or more closely.
    Accuracy,
    /// It solves other equations: what stands there as an error is a difference.
    Other,
}

/// One setting: the scene with one choice made differently.
#[derive(Clone, Debug)]
pub struct Setting {
    /// Which choice.
    pub knob: &'static str,
    /// How it is made.
    pub value: String,
    /// The scene with it.
    pub scene: Scene,
    /// What it does to the results.
    pub effect: Effect,
}

impl Setting {
    fn new(
        (knob, effect): (&'static str, Effect),
        value: impl ToString,
        scene: &Scene,
        change: impl FnOnce(&mut Scene),
    ) -> Self {
        let mut scene = scene.clone();
        change(&mut scene);
        Self { knob, value: value.to_string(), scene, effect }
    }
}

/// The median; not a number of nothing.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    match values.len() {
        0 => f64::NAN,
        count => 0.5 * (values[(count - 1) / 2] + values[count / 2]),
    }
}

/// Marks what is best of its price: nothing else is both cheaper and more accurate.
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
    fn the_median_of_an_even_number_is_between_the_middle_two() {
        assert!((median(vec![4.0, 1.0, 3.0, 2.0]) - 2.5).abs() < 1e-15);
        assert!(median(Vec::new()).is_nan());
    }
}
