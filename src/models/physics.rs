//! The fully physics-informed model, Eq. (7): smoothed particle hydrodynamics itself.

use super::{Model, Pair, Strength, Stress};
use crate::kernel::{Kernel, Smoothing};
use crate::scalar::{Dual, Lanes, Scalar};
use crate::state;
use crate::viscosity::{Viscosity, monaghan, monaghan_gradient};
use serde::{Deserialize, Serialize};

/// A physical parameter that a scene can learn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Parameter {
    /// Sound speed `c`.
    C,
    /// Linear viscosity `α`.
    Alpha,
    /// Quadratic viscosity `β`.
    Beta,
    /// Stiffness exponent `γ` of Tait's equation of state.
    Gamma,
    /// Power `θ` of the deterministic forcing.
    Theta,
}

impl Parameter {
    /// How many there are.
    pub const COUNT: usize = 5;
    /// All of them, in the order of [`Parameters`].
    pub const ALL: [Self; Self::COUNT] =
        [Self::C, Self::Alpha, Self::Beta, Self::Gamma, Self::Theta];

    /// Its name in scenes, recordings and reports.
    pub fn name(self) -> &'static str {
        ["c", "alpha", "beta", "gamma", "theta"][self as usize]
    }
}

/// The five physical parameters, numbers or dual numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameters<T>(pub [T; Parameter::COUNT]);

impl<T: Copy> Parameters<T> {
    /// One of them.
    #[inline(always)]
    pub fn get(&self, parameter: Parameter) -> T {
        self.0[parameter as usize]
    }
}

impl Parameters<f64> {
    /// Replaces one of them.
    pub fn set(&mut self, parameter: Parameter, value: f64) {
        self.0[parameter as usize] = value;
    }
}

/// Eq. (7): `dvᵢ/dt = −Σⱼ m (Pᵢ/ρᵢ² + Pⱼ/ρⱼ² + Πᵢⱼ) ∇ᵢWᵢⱼ`, with Tait's pressure, Eq. (20), and
/// Monaghan's viscosity, Eq. (21). Learns any of `c, α, β, γ` (and the forcing's `θ`).
///
/// The sum carries `m` and the minus that the paper's Eq. (7) leaves out; `j = i` is excluded.
/// Momentum and pair torques are conserved to round-off (`tests/conservation.rs`).
#[derive(Clone, Debug)]
pub struct Physics<K, const D: usize> {
    mass: f64,
    smoothing: Smoothing<K, D>,
    parameters: Parameters<f64>,
}

impl<K: Kernel, const D: usize> Physics<K, D> {
    /// The model for particles of mass `mass`.
    pub fn new(mass: f64, smoothing: Smoothing<K, D>, parameters: Parameters<f64>) -> Self {
        Self { mass, smoothing, parameters }
    }

    #[inline(always)]
    fn viscosity<T: Scalar>(&self) -> Viscosity<T> {
        let [c, alpha, beta, ..] = self.parameters.0.map(T::of);
        Viscosity { c, alpha, beta }
    }
}

impl<K: Kernel, const D: usize> Model<D> for Physics<K, D> {
    type Kernel = K;

    fn smoothing(&self) -> &Smoothing<K, D> {
        &self.smoothing
    }

    fn mass(&self) -> f64 {
        self.mass
    }

    fn parameters(&self) -> &Parameters<f64> {
        &self.parameters
    }

    fn set_parameters(&mut self, parameters: Parameters<f64>) {
        self.parameters = parameters;
    }

    fn stress(&self, rho: f64) -> f64 {
        let [c, _, _, gamma, _] = self.parameters.0;
        state::stress(state::tait(rho, c, gamma), rho)
    }

    /// Three inputs, one output: forward mode, by dual numbers.
    fn stress_gradient(&self, rho: f64) -> Stress {
        let [c, _, _, gamma, _] = self.parameters.0;
        let variable = |x, index| Dual::<f64, 3>::variable(x, index, [0.0; 3]);
        let (rho, c, gamma) = (variable(rho, 0), variable(c, 1), variable(gamma, 2));
        let a = state::stress(state::tait(rho, c, gamma), rho);
        let [by_density, by_c, by_gamma] = a.gradient;
        Stress { value: a.value, by_density, by_parameter: [by_c, 0.0, 0.0, by_gamma, 0.0] }
    }

    /// `s = −m (Aᵢ + Aⱼ + Πᵢⱼ) G(r)`: the law of Eq. (7) in one line.
    #[inline(always)]
    fn strength<T: Scalar>(&self, pair: &Pair<T>, stresses: T) -> T {
        let viscous = monaghan(pair, self.smoothing.h, &self.viscosity());
        (stresses + viscous) * self.smoothing.gradient(pair.r2.sqrt()) * -self.mass
    }

    #[inline(always)]
    fn strength_gradient(&self, pair: &Pair<Lanes>, stresses: Lanes) -> Strength<Lanes> {
        let by = self.viscosity();
        let r = pair.r2.sqrt();
        let pull = self.smoothing.gradient(r) * -self.mass;
        let viscous = monaghan_gradient(pair, self.smoothing.h, &by);
        let total = stresses + viscous.value;
        Strength {
            value: total * pull,
            by_separation: total * self.smoothing.curvature(r) * -self.mass
                + viscous.by_r2 * pull * 2.0,
            by_approach: viscous.by_approach * pull,
            by_stress: pull,
            by_density: viscous.by_density * pull,
            by_parameter: [viscous.by.c * pull, viscous.by.alpha * pull, viscous.by.beta * pull],
        }
    }
}
