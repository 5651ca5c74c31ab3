//! The growth of sensitivities, and the horizon beyond which a gradient is useless.
//!
//! In developed flow neighbouring states diverge exponentially, and so `S = ∂(r, v)/∂θ` grows
//! exponentially with the number of steps. The gradient stays exact, but the range of parameters in
//! which it predicts the loss shrinks, until no step of a search or of a difference is small
//! enough.

use super::Learner;
use crate::error::{Error, Result};
use crate::statistics::eddy_time;

/// Relative difference between the best central difference and the gradient, up to which a search
/// can follow the gradient.
pub const USEFUL: f64 = 1e-3;

/// The growth of `S` over a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Growth {
    /// `|S|` after each step: the root of the sum of squares of all its components.
    pub sizes: Vec<f64>,
    /// `d ln|S| / dt`, fitted over the second half of the run; NaN where that has less than two
    /// steps. Without chaos `|S|` grows by a power of the time, and this is about two divided by
    /// the run's length.
    pub rate: f64,
    /// The rate per step.
    pub per_step: f64,
    /// The rate per eddy time, [`eddy_time`] of the first state.
    pub per_eddy: f64,
}

/// Runs a prediction for `window` steps and records the size of its sensitivities.
///
/// # Errors
/// [`Error::Diverged`] from the flow, [`Error::Input`] for a learner with an adjoint gradient.
pub fn sensitivity_growth<const D: usize>(
    learner: &mut Learner<D>,
    learned: &[f64],
    window: usize,
) -> Result<Growth> {
    learner.start_over(learned, window);
    let flow = learner.flow_mut();
    if flow.columns().is_empty() {
        return Err(Error::input(
            "the growth of sensitivities",
            "a forward gradient",
            "an adjoint, which has none",
            "set learn.gradient to \"forward\"",
        ));
    }
    let eddy = eddy_time(&flow.state().velocities, flow.space().longest::<D>());
    let mut sizes = Vec::with_capacity(window);
    for _ in 0..window {
        flow.step()?;
        sizes.push(flow.sensitivity_size());
    }
    let per_step = slope_of_logarithms(&sizes[window / 2..]);
    let rate = per_step / flow.dt();
    Ok(Growth { sizes, rate, per_step, per_eddy: rate * eddy })
}

/// The slope of `ln y` over the index, by least squares.
fn slope_of_logarithms(y: &[f64]) -> f64 {
    let middle = 0.5 * (y.len() as f64 - 1.0);
    let along = |k: usize| k as f64 - middle;
    let over: f64 = y.iter().enumerate().map(|(k, y)| along(k) * y.ln()).sum();
    over / (0..y.len()).map(|k| along(k) * along(k)).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_of_an_exponential_is_its_exponent() {
        let sizes: Vec<f64> = (0..20).map(|k| 3.0 * (0.25 * f64::from(k)).exp()).collect();
        assert!((slope_of_logarithms(&sizes) - 0.25).abs() < 1e-14);
        assert!(slope_of_logarithms(&[1.0]).is_nan() && slope_of_logarithms(&[]).is_nan());
    }
}
