#![doc = include_str!("../README.md")]

pub mod arrays;
pub mod cells;
pub mod chunk;
pub mod draft;
pub mod error;
pub mod evaluation;
mod files;
pub mod flow;
pub mod forcing;
pub mod interrupt;
pub mod kernel;
pub mod learn;
pub mod losses;
pub mod models;
pub mod near;
pub mod network;
pub mod optimisers;
pub mod output;
pub mod packed;
pub mod pairs;
pub mod parameters;
pub mod recording;
pub mod report;
pub mod run;
pub mod scalar;
pub mod scene;
pub mod sensitivity;
pub mod space;
pub mod state;
pub mod statistics;
#[path = "../systems/mod.rs"]
pub mod systems;
pub mod trade;
pub mod truth;
pub mod vector;
pub mod viscosity;
pub mod waves;

pub use error::{Error, Result};
pub use flow::Flow;
pub use scene::Scene;
