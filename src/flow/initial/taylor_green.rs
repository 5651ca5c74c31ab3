//! The Taylor–Green vortex.

use super::VelocityField;
use crate::scene::{Requirement, Scene};
use crate::vector::Vector;
use crate::waves::wave_numbers;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// `u = U (sin kx cos ky, −cos kx sin ky)` in two dimensions, and in three
/// `u = U (sin kx cos ky cos kz, −cos kx sin ky cos kz, 0)`, with `k = 2π/L` and `U = initial.velocity`.
/// In a box that is no cube each axis has its own `k`, and the second component the factor `k_x/k_y`.
///
/// It is free of divergence. In two dimensions it keeps its form and decays as `e^{−2νk²t}`; in
/// three it breaks down into turbulence (Taylor & Green 1937, doi:10.1098/rspa.1937.0036; Brachet
/// et al. 1983, doi:10.1017/S0022112083001159). `½⟨|u|²⟩ = U²/4` in two dimensions, `U²/8` in
/// three.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaylorGreen {}

impl VelocityField for TaylorGreen {
    fn requirements(&self, _: &Scene) -> Vec<Requirement> {
        Vec::new()
    }

    fn velocities<const D: usize>(
        &self,
        scene: &Scene,
        positions: &[Vector<f64, D>],
        _: &mut ChaCha8Rng,
    ) -> Vec<Vector<f64, D>> {
        let k = wave_numbers(scene.space());
        let at = |r: &Vector<f64, D>| {
            let angles = Vector(std::array::from_fn(|axis| k[axis] * r[axis]));
            let mut unit = Self::unit::<D>(angles);
            unit[1] *= k[0] / k[1];
            unit * scene.initial.velocity
        };
        positions.iter().map(at).collect()
    }
}

impl TaylorGreen {
    /// The velocity at `kr`, of unit amplitude.
    pub(crate) fn unit<const D: usize>(angles: Vector<f64, D>) -> Vector<f64, D> {
        let [x, y, z] = angles.to_3d();
        let depth = z.cos(); // z = 0 in two dimensions
        Vector::from_3d([x.sin() * y.cos() * depth, -x.cos() * y.sin() * depth, 0.0])
    }
}
