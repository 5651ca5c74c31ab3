//! The result of a training.

use super::HeldOut;
use crate::learn::Knowledge;
use crate::scene::CalibratedStep;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// The result of a training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TrainingReport {
    /// Name of the scene.
    pub scene: String,
    /// Kind of the model.
    pub model: String,
    /// Number of particles.
    pub particles: usize,
    /// Number of steps to the last observed one.
    pub steps: usize,
    /// The step chosen for a requested accuracy.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub chosen: Option<CalibratedStep>,
    /// The mode of differentiation.
    pub gradient: String,
    /// Iterations of the search, including those of an earlier recording that was resumed.
    pub iterations: usize,
    /// Number of iterations of that recording; none for a new search.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub iterations_before: Option<usize>,
    /// Loss of the guess; infinite, and `null` in JSON, where its flow diverges.
    #[serde(deserialize_with = "infinite_or")]
    pub loss_initial: f64,
    /// Loss at the end.
    pub loss_final: f64,
    /// Learned parameters by name.
    pub parameters: BTreeMap<String, f64>,
    /// True parameters, where they are known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub truth: Option<BTreeMap<String, f64>>,
    /// Wall-clock time.
    pub seconds: Seconds,
    /// Path of the recording.
    pub recording: PathBuf,
    /// Parts of the final loss.
    pub losses: Losses,
    /// How well the parameters are known, and why the search stopped.
    #[serde(flatten)]
    pub knowledge: Knowledge,
    /// The statistical loss between realisations of the truth.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub kl_floor: Option<f64>,
    /// Number of lessons, where there are several.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lessons: Option<usize>,
    /// The learned law in the lessons that are held out.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub held_out: Vec<HeldOut>,
    /// Largest difference between learned and true pressure, over the densities that occurred.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub pressure_error: Option<f64>,
}

/// Parts of a loss.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Losses {
    /// Of trajectories.
    pub trajectory: f64,
    /// Of fields.
    pub field: f64,
    /// Of velocity increments.
    pub kl: f64,
    /// Of other statistics, by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub statistics: BTreeMap<String, f64>,
}

/// Wall-clock times in seconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Seconds {
    /// To make or read the truth.
    pub truth: f64,
    /// To search, and to record it.
    pub train: f64,
}

/// JSON has no infinity.
fn infinite_or<'de, R: serde::Deserializer<'de>>(reader: R) -> std::result::Result<f64, R::Error> {
    Ok(Option::deserialize(reader)?.unwrap_or(f64::INFINITY))
}
