//! The flow of Arnold, Beltrami and Childress.

use super::VelocityField;
use crate::scene::{Requirement, Scene};
use crate::vector::Vector;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// `u = U (A sin kz + C cos ky, B sin kx + A cos kz, C sin ky + B cos kx)` with `k = 2π/L` and
/// `U = initial.velocity`.
///
/// It is free of divergence, and a Beltrami field, `∇×u = k u`. In an incompressible fluid it keeps
/// its form and decays as `e^{−νk²t}`: an exact unsteady solution (Dombre et al. 1986,
/// doi:10.1017/S0022112086002859). Three dimensions only. `½⟨|u|²⟩ = U² (A² + B² + C²)/2`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Abc {
    /// `A`, of the waves along z.
    pub a: f64,
    /// `B`, of the waves along x.
    pub b: f64,
    /// `C`, of the waves along y.
    pub c: f64,
}

impl Default for Abc {
    /// `A = B = C = 1`, the most symmetric one.
    fn default() -> Self {
        Self { a: 1.0, b: 1.0, c: 1.0 }
    }
}

impl VelocityField for Abc {
    fn requirements(&self, scene: &Scene) -> Vec<Requirement> {
        let factor = |key: &'static str, x: f64| {
            (x >= 0.0 && x.is_finite(), key, "zero or more", format!("{x}"))
        };
        vec![
            (
                scene.dimension == 3,
                "initial.field",
                "another field in two dimensions: \"abc\" has only a form in three",
                format!("\"abc\" in dimension {}", scene.dimension),
            ),
            (
                scene.dimension != 3 || scene.has_equal_sides(),
                "initial.field",
                "equal sides of the box: \"abc\" is a steady flow in a cube only",
                format!("sides {:?}", scene.space().sides::<3>()),
            ),
            factor("initial.field.a", self.a),
            factor("initial.field.b", self.b),
            factor("initial.field.c", self.c),
        ]
    }

    fn velocities<const D: usize>(
        &self,
        scene: &Scene,
        positions: &[Vector<f64, D>],
        _: &mut ChaCha8Rng,
    ) -> Vec<Vector<f64, D>> {
        let k = TAU / scene.fluid.box_length;
        let at = |r: &Vector<f64, D>| {
            let unit = self.velocity(r.to_3d().map(|x| k * x));
            Vector::from_3d(unit) * scene.initial.velocity
        };
        positions.iter().map(at).collect()
    }
}

impl Abc {
    /// The velocity at `kr`, of unit amplitude.
    pub(crate) fn velocity(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let Self { a, b, c } = *self;
        [a * z.sin() + c * y.cos(), b * x.sin() + a * z.cos(), c * y.sin() + b * x.cos()]
    }
}
