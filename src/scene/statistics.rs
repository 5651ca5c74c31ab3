//! Weights of the losses of statistics, `learn.statistics`.

use serde::{Deserialize, Serialize};

/// Weights of the losses of statistics, [`crate::systems::loss::statistics`]: each is the mean square of `ln f − ln f̂` over
/// the values of a statistic; a loss of weight zero is not computed. They count at the times of `learn.increments.times`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StatisticWeights {
    /// Of the mean kinetic energy of particles.
    pub energy: f64,
    /// Of the flatness of velocity increments, component by component.
    pub flatness: f64,
    /// Of the pair dispersion of particles that begin as neighbours.
    pub dispersion: f64,
    /// Of the energy spectrum `E(k)` of the smoothed field on the mesh of the field loss.
    pub spectrum: f64,
    /// Of the longitudinal structure function `S₂(r)` of that field.
    pub structure: f64,
}

impl StatisticWeights {
    /// The weights with their names.
    pub fn named(&self) -> [(&'static str, f64); 5] {
        [
            ("energy", self.energy),
            ("flatness", self.flatness),
            ("dispersion", self.dispersion),
            ("spectrum", self.spectrum),
            ("structure", self.structure),
        ]
    }

    /// Whether none has a weight.
    pub fn is_none(&self) -> bool {
        self.named().iter().all(|(_, weight)| *weight <= 0.0)
    }
}
