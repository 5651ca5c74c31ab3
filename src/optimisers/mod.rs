//! Optimisers: better parameters from a loss and its derivatives.
//!
//! | optimiser | needs | recommended |
//! |---|---|---|
//! | [`LevenbergMarquardt`] | residual derivatives | default for sums of squares of few parameters |
//! | [`Lbfgs`] | gradient | networks and statistical losses: ten times fewer evaluations than Adam |
//! | [`Adam`] | gradient | to compare with published searches |
//! | [`Rmsprop`] | gradient | as Adam, where its momentum overshoots |

mod adam;
mod conjugate_gradients;
mod coordinates;
mod lbfgs;
mod levenberg_marquardt;
mod rmsprop;
mod spectrum;

pub use adam::Adam;
pub(crate) use conjugate_gradients::dot;
pub use conjugate_gradients::{ConjugateSolution, conjugate_gradients};
pub use coordinates::Coordinates;
pub use lbfgs::{Lbfgs, LineSearch};
pub use levenberg_marquardt::LevenbergMarquardt;
pub(crate) use levenberg_marquardt::solve_positive;
pub use rmsprop::Rmsprop;
pub use spectrum::Spectrum;

/// A first-order optimiser: moves parameters against a gradient.
pub trait Descend {
    /// One step from `parameters` against the loss's `gradient`.
    fn descend(&mut self, parameters: &mut [f64], gradient: &[f64]);
    /// The current learning rate.
    fn rate(&self) -> f64;
    /// Changes the learning rate.
    fn set_rate(&mut self, rate: f64);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A narrow bent valley (Rosenbrock 1960), minimum 0 at (1, 1).
    fn gradient([x, y]: [f64; 2]) -> [f64; 2] {
        [2.0 * (x - 1.0) - 400.0 * x * (y - x * x), 200.0 * (y - x * x)]
    }

    fn descend(mut optimiser: impl Descend) -> [f64; 2] {
        let mut at = [-0.5, 0.5];
        for iteration in 0..20_000 {
            let slope = gradient(at);
            if iteration == 15_000 {
                optimiser.set_rate(0.01 * optimiser.rate());
            }
            optimiser.descend(&mut at, &slope);
        }
        at
    }

    #[test]
    fn first_order_optimisers_reach_the_floor_of_a_bent_valley() {
        for at in [descend(Adam::new(0.01, 2)), descend(Rmsprop::new(0.001, 2))] {
            assert!((at[0] - 1.0).abs() < 1e-3 && (at[1] - 1.0).abs() < 1e-3, "{at:?}");
        }
    }

    #[test]
    fn the_first_adam_step_is_the_learning_rate_against_the_sign_of_the_gradient() {
        let mut at = [1.0, 1.0];
        Adam::new(0.05, 2).descend(&mut at, &[3.0, -1e-3]);
        assert!((at[0] - 0.95).abs() < 1e-6 && (at[1] - 1.05).abs() < 1e-6);
    }
}
