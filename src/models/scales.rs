//! The constants that scale a network's inputs and outputs to order one.

use super::Medium;
use serde::{Deserialize, Serialize};

/// Typical sizes given by a scene; recorded with it, never fitted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Scales {
    /// Typical velocity difference.
    pub velocity: f64,
    /// Typical `ρ − 1`.
    pub compression: f64,
}

impl Default for Scales {
    /// Velocity differences of 1, densities within five per cent.
    fn default() -> Self {
        Self { velocity: 1.0, compression: 0.05 }
    }
}

/// The scales of a fluid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Units {
    /// Of a length: `h`.
    pub(super) length: f64,
    /// Of a velocity difference.
    pub(super) velocity: f64,
    /// Of `ρ − 1`.
    pub(super) compression: f64,
    /// Of `A`: the pressure at a typical compression, `c² (ρ − 1)`.
    pub(super) p_over_rho2: f64,
    /// Of a pair's acceleration: the scale of `A` times `m |W'(h)|`.
    pub(super) force: f64,
}

impl Scales {
    pub(super) fn units<const D: usize>(&self, medium: &Medium<D>) -> Units {
        let (c, h) = (medium.fluid.c, medium.smoothing.h);
        let p_over_rho2 = c * c * self.compression;
        let pull = medium.mass * (medium.smoothing.dw_over_r(h) * h).abs();
        Units {
            length: h,
            velocity: self.velocity,
            compression: self.compression,
            p_over_rho2,
            force: p_over_rho2 * pull,
        }
    }
}
