#![doc = include_str!("../README.md")]
//!
//! # The modules
//!
//! What these pages show is the face of the library, and `docs/public-face.txt` lists it. Modules that only the
//! commands and the tests use are public and hidden; they may change in any version.
//!
//! | | |
//! |---|---|
//! | a run | [`scene`], [`flow`], [`learn`], [`truth`], [`recording`] |
//! | laws | [`models`], [`kernel`], [`state`], [`viscosity`], [`forcing`], [`parameters`] |
//! | derivatives | [`sensitivity`] |
//! | particles | [`systems`], [`neighbours`], [`space`], [`vector`], [`scalar`] |
//! | measures | [`statistics`], [`waves`] |

#[cfg(feature = "laboratory")]
#[doc(hidden)]
pub mod advise;
#[cfg(feature = "laboratory")]
#[doc(hidden)]
pub mod arrays;
#[cfg(feature = "laboratory")]
#[doc(hidden)]
pub mod commands;

#[doc(hidden)]
pub mod dns;
pub mod error;
#[cfg(feature = "laboratory")]
#[doc(hidden)]
pub mod evaluation;
#[cfg(feature = "laboratory")]
#[doc(hidden)]
pub mod export;
#[cfg_attr(
    not(feature = "laboratory"),
    allow(dead_code, reason = "readers of recordings and arrays use it")
)]
mod files;
pub mod flow;
pub mod forcing;
#[doc(hidden)]
pub mod interrupt;
pub mod kernel;
pub mod learn;
#[doc(hidden)]
pub mod losses;
#[cfg(feature = "laboratory")]
mod memory;
pub mod models;
pub mod neighbours;
#[doc(hidden)]
pub mod network;
#[doc(hidden)]
pub mod optimisers;
#[cfg(feature = "recording")]
#[doc(hidden)]
pub mod output;
#[doc(hidden)]
pub mod packed;
#[doc(hidden)]
pub mod pairs;
pub mod parameters;
mod pool;
mod random;
#[cfg(feature = "recording")]
#[cfg_attr(
    not(feature = "laboratory"),
    allow(dead_code, unused_imports, reason = "the commands use it")
)]
pub mod recording;
#[cfg(feature = "laboratory")]
mod recording_page;
#[doc(hidden)]
pub mod reduce;
#[cfg(feature = "laboratory")]
#[doc(hidden)]
pub mod report;
#[cfg(feature = "laboratory")]
#[doc(hidden)]
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
#[doc(hidden)]
pub mod tables;
#[cfg(feature = "laboratory")]
#[doc(hidden)]
pub mod trade;
pub mod truth;
pub mod vector;
pub mod viscosity;
pub mod waves;

pub use error::{Error, Result};
pub use flow::Flow;
pub use scene::Scene;
