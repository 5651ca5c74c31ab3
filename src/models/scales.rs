//! The constants that make a network's inputs and outputs numbers of order one.

use super::Medium;
use serde::{Deserialize, Serialize};

/// What a scene says about the size of things; recorded with it, never fitted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Scales {
    /// Size of a velocity difference.
    pub velocity: f64,
    /// Size of `ρ − 1`.
    pub compression: f64,
}

impl Default for Scales {
    /// Unit velocities, densities within five per cent.
    fn default() -> Self {
        Self { velocity: 1.0, compression: 0.05 }
    }
}

/// The scales of a medium.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Units {
    /// `h`.
    pub(super) length: f64,
    /// Of a velocity difference.
    pub(super) velocity: f64,
    /// Of `ρ − 1`.
    pub(super) compression: f64,
    /// Of `A`: the pressure at that compression, `c² (ρ − 1)`.
    pub(super) stress: f64,
    /// Of a pair's acceleration: that stress times `m |W'(h)|`.
    pub(super) force: f64,
}

impl Scales {
    pub(super) fn units<const D: usize>(&self, medium: &Medium<D>) -> Units {
        let (c, h) = (medium.fluid.c, medium.smoothing.h);
        let stress = c * c * self.compression;
        let pull = medium.mass * (medium.smoothing.gradient(h) * h).abs();
        Units {
            length: h,
            velocity: self.velocity,
            compression: self.compression,
            stress,
            force: stress * pull,
        }
    }
}
