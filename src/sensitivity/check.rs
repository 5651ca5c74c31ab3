//! The gradient against central differences: slow and certain.

use crate::error::Result;
use crate::learn::{Evaluation, Learner};
use crate::models::Parameter;

/// One component of a gradient, both ways.
#[derive(Clone, Copy, Debug)]
pub struct ComparedSlope {
    /// Of which parameter.
    pub parameter: Parameter,
    /// The exact derivative.
    pub exact: f64,
    /// Central differences, with the step that comes closest.
    pub central: f64,
    /// `|central − exact|/|exact|`.
    pub relative: f64,
}

/// Steps of the differences, relative to the parameter: the largest are spoilt by curvature and by
/// pairs that turn from approaching to receding, the smallest by round-off.
const STEPS: [f64; 4] = [1e-4, 1e-5, 1e-6, 1e-7];

/// The gradient of an evaluation against central differences of the loss over `window` frames.
///
/// # Errors
/// [`crate::Error::Diverged`] where a neighbouring set of parameters makes a flow that diverges.
pub fn compare_with_differences<const D: usize>(
    learner: &mut Learner<D>,
    evaluation: &Evaluation,
    window: usize,
) -> Result<Vec<ComparedSlope>> {
    let mut slopes = Vec::new();
    for (k, parameter) in learner.columns().to_vec().into_iter().enumerate() {
        let (here, exact) = (evaluation.parameters[k], evaluation.gradient[k]);
        let mut best =
            ComparedSlope { parameter, exact, central: f64::NAN, relative: f64::INFINITY };
        for relative in STEPS {
            let step = relative * here.abs().max(1e-3);
            let mut loss_at = |x: f64| {
                let mut moved = evaluation.parameters.clone();
                moved[k] = x;
                learner.evaluate(&moved, window).map(|found| found.loss)
            };
            let central = (loss_at(here + step)? - loss_at(here - step)?) / (2.0 * step);
            let relative = ((central - exact) / exact).abs();
            if relative < best.relative {
                best = ComparedSlope { central, relative, ..best };
            }
        }
        slopes.push(best);
    }
    Ok(slopes)
}
