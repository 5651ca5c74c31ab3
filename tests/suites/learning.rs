//! Promises of the searches and of what is said about their results. A suite is one program, so that the engine is compiled for it once.

#[path = "../common/mod.rs"]
mod common;
#[path = "../common/place.rs"]
mod place;

#[path = "../evaluation.rs"]
mod evaluation;
#[path = "../first_order_search.rs"]
mod first_order_search;
#[path = "../first_steps.rs"]
mod first_steps;
#[path = "../knowledge.rs"]
mod knowledge;
#[path = "../learning.rs"]
mod learning;
#[path = "../lessons.rs"]
mod lessons;
#[path = "../noise.rs"]
mod noise;
#[path = "../recorded_gradients.rs"]
mod recorded_gradients;
#[path = "../recovery_of_parameters.rs"]
mod recovery_of_parameters;
