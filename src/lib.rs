#![doc = include_str!("../README.md")]

#[cfg(feature = "laboratory")]
pub mod arrays;
pub mod cells;
pub mod chunk;
pub mod dns;
pub mod error;
#[cfg(feature = "laboratory")]
pub mod evaluation;
#[cfg_attr(
    not(feature = "laboratory"),
    allow(dead_code, reason = "readers of recordings and arrays use it")
)]
mod files;
pub mod fixed_point;
pub mod flow;
pub mod forcing;
pub mod interrupt;
pub mod kernel;
pub mod learn;
pub mod list_builder;
pub mod losses;
pub mod models;
pub mod near;
pub mod network;
pub mod optimisers;
#[cfg(feature = "recording")]
pub mod output;
pub mod packed;
pub mod pairs;
pub mod parameters;
#[cfg(feature = "recording")]
#[cfg_attr(
    not(feature = "laboratory"),
    allow(dead_code, unused_imports, reason = "the commands use it")
)]
pub mod recording;
#[cfg(feature = "laboratory")]
pub mod report;
#[cfg(feature = "laboratory")]
pub mod run;
pub mod scalar;
pub mod scene;
pub mod sensitivity;
pub mod space;
pub mod state;
pub mod statistics;
#[path = "../systems/mod.rs"]
pub mod systems;
#[cfg(feature = "laboratory")]
pub mod trade;
pub mod truth;
pub mod vector;
pub mod viscosity;
pub mod waves;

pub use error::{Error, Result};
pub use flow::Flow;
pub use scene::Scene;
