//! Normally distributed velocities.

use super::VelocityField;
use crate::scene::{Requirement, Scene};
use crate::vector::Vector;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::{Deserialize, Serialize};

/// Each component of each particle is drawn independently from a normal distribution of standard
/// deviation `initial.velocity`: a start without any length scale, with the spectrum of white noise
/// (Woodward et al. 2021, arXiv:2110.13311).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Normal {}

impl VelocityField for Normal {
    fn requirements(&self, _: &Scene) -> Vec<Requirement> {
        Vec::new()
    }

    fn velocities<const D: usize>(
        &self,
        scene: &Scene,
        positions: &[Vector<f64, D>],
        generator: &mut ChaCha8Rng,
    ) -> Vec<Vector<f64, D>> {
        let width = scene.initial.velocity;
        let mut component = || width * generator.sample::<f64, _>(StandardNormal);
        positions.iter().map(|_| Vector(std::array::from_fn(|_| component()))).collect()
    }
}
