//! Compares a gradient with central differences: slow, but independent of all derivative code.

use super::{Evaluation, Learner};
use crate::error::Result;

/// The slope of a loss along one direction, by both methods.
#[derive(Clone, Copy, Debug)]
pub struct ComparedSlope {
    /// The exact derivative.
    pub exact: f64,
    /// Central differences, with the step of the best agreement.
    pub central: f64,
    /// `|central − exact|/|exact|`.
    pub relative: f64,
}

/// Steps of the differences, relative to the parameter. The largest suffer from curvature and from
/// pairs that change from approaching to receding, the smallest from round-off.
const STEPS: [f64; 4] = [1e-4, 1e-5, 1e-6, 1e-7];

/// Compares one component of an evaluation's gradient with central differences of the loss over
/// `window` frames. Steps are relative to the parameter if it is physical, and absolute for a
/// weight.
///
/// # Errors
/// [`crate::Error::Diverged`] where a neighbouring set of parameters makes a flow that diverges.
pub fn compare_component<const D: usize>(
    learner: &mut Learner<D>,
    evaluation: &Evaluation,
    component: usize,
    window: usize,
) -> Result<ComparedSlope> {
    let mut direction = vec![0.0; evaluation.gradient.len()];
    direction[component] = 1.0;
    let size = match learner.columns()[component].is_weight() {
        true => 1.0,
        false => evaluation.parameters[component].abs().max(1e-3),
    };
    compare_along(learner, evaluation, (&direction, size), window)
}

/// Compares the slope along an evaluation's gradient, which is the gradient's norm, with central
/// differences of the loss over `window` frames: one number to which every parameter contributes.
///
/// # Errors
/// [`crate::Error::Diverged`] as [`compare_component`].
pub fn compare_along_gradient<const D: usize>(
    learner: &mut Learner<D>,
    evaluation: &Evaluation,
    window: usize,
) -> Result<ComparedSlope> {
    let length = evaluation.gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
    let direction: Vec<f64> = evaluation.gradient.iter().map(|g| g / length).collect();
    compare_along(learner, evaluation, (&direction, 1.0), window)
}

fn compare_along<const D: usize>(
    learner: &mut Learner<D>,
    evaluation: &Evaluation,
    (direction, size): (&[f64], f64),
    window: usize,
) -> Result<ComparedSlope> {
    let exact = evaluation.gradient.iter().zip(direction).map(|(g, d)| g * d).sum();
    let mut loss_at = |step: f64| {
        let moved = evaluation.parameters.iter().zip(direction).map(|(x, d)| x + step * d);
        learner.evaluate(&moved.collect::<Vec<_>>(), window).map(|found| found.loss)
    };
    let mut best = ComparedSlope { exact, central: f64::NAN, relative: f64::INFINITY };
    for step in STEPS {
        let step = step * size;
        let central = (loss_at(step)? - loss_at(-step)?) / (2.0 * step);
        let relative = ((central - exact) / exact).abs();
        if relative < best.relative {
            best = ComparedSlope { central, relative, ..best };
        }
    }
    Ok(best)
}
