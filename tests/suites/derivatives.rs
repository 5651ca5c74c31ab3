//! Promises of the gradients: forward, adjoint and differences agree. A suite is one program, so that the engine is compiled for it once.

#[path = "../common/mod.rs"]
mod common;
#[path = "../common/place.rs"]
mod place;

#[path = "../adjoint.rs"]
mod adjoint;
#[path = "../gradients.rs"]
mod gradients;
#[path = "../hierarchy.rs"]
mod hierarchy;
#[path = "../increments.rs"]
mod increments;
#[path = "../long_horizons.rs"]
mod long_horizons;
#[path = "../rollout.rs"]
mod rollout;
#[path = "../statistical_loss.rs"]
mod statistical_loss;
#[path = "../statistics_losses.rs"]
mod statistics_losses;
#[path = "../terms.rs"]
mod terms;
