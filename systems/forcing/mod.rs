//! Forcing terms, appendix A.3, with tangents and pullbacks.
//!
//! Appendices are those of Woodward et al., arXiv:2110.13311: see `docs/equations.md`.

mod deterministic;
mod ornstein_uhlenbeck;
mod stochastic;

pub use deterministic::DeterministicForcing;
pub use ornstein_uhlenbeck::OrnsteinUhlenbeckForcing;
pub use stochastic::StochasticForcing;

use super::term::Term;
use crate::forcing::ornstein_uhlenbeck::Settings;
use crate::scene::{Forcing, Scene};

/// The terms of a scene's forcing; empty without forcing.
#[doc(hidden)]
pub fn terms<const D: usize>(scene: &Scene) -> Vec<Box<dyn Term<D>>> {
    match scene.forcing {
        Forcing::None => Vec::new(),
        Forcing::Deterministic { theta, power } => {
            vec![Box::new(DeterministicForcing::new(theta, power))]
        }
        Forcing::Stochastic { interval, strength } => {
            vec![Box::new(StochasticForcing::new(scene.seed, interval, strength))]
        }
        Forcing::OrnsteinUhlenbeck { power, correlation_time, band } => {
            let settings = Settings { power, correlation_time, band };
            vec![Box::new(OrnsteinUhlenbeckForcing::new(scene, settings))]
        }
    }
}
