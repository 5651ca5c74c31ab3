//! The hierarchy of models: which law moves the particles.
//!
//! A model is a struct with parameters that implements [`Model`]; it says what each particle brings
//! to its pairs (its *stress*) and how strongly a pair pushes. The systems are generic over it, so a
//! scene chooses a model by choosing a type, once, where it becomes a World.

mod physics;

pub use physics::{Parameter, Parameters, Physics};

use crate::kernel::{Kernel, Smoothing};
use crate::scalar::{Lanes, Scalar};

/// What the law between two particles may depend on, for directed pair `i ← j`.
#[derive(Clone, Copy, Debug)]
pub struct Pair<T> {
    /// `|rᵢⱼ|²`.
    pub r2: T,
    /// `vᵢⱼ·rᵢⱼ`, negative while the pair approaches.
    pub approach: T,
    /// `ρᵢ`.
    pub rho_i: T,
    /// `ρⱼ`.
    pub rho_j: T,
}

impl<T: Scalar> Pair<T> {
    /// `ρ̄ = (ρᵢ + ρⱼ)/2`.
    #[inline(always)]
    pub fn mean_density(&self) -> T {
        (self.rho_i + self.rho_j) * 0.5
    }
}

/// What a particle brings to its pairs, and how that changes: `A(ρ)`, for pressure `P/ρ²`.
#[derive(Clone, Copy, Debug)]
pub struct Stress {
    /// `A`.
    pub value: f64,
    /// `∂A/∂ρ`.
    pub by_density: f64,
    /// `∂A/∂(c, α, β, γ, θ)`.
    pub by_parameter: [f64; Parameter::COUNT],
}

/// The strength `s` of a central pair force, `aᵢ += s rᵢⱼ`, and its gradient: all that a forward
/// sensitivity of any number of columns needs to know of a pair.
#[derive(Clone, Copy, Debug)]
pub struct Strength<T> {
    /// `s`.
    pub value: T,
    /// `∂s/∂(r·δr)`, that is `2 ∂s/∂(r²)`.
    pub by_separation: T,
    /// `∂s/∂(v·r)`.
    pub by_approach: T,
    /// `∂s/∂Aᵢ = ∂s/∂Aⱼ`.
    pub by_stress: T,
    /// `∂s/∂ρᵢ = ∂s/∂ρⱼ` at fixed `A`.
    pub by_density: T,
    /// `∂s/∂(c, α, β)` at fixed `A`.
    pub by_parameter: [T; 3],
}

/// A law of motion that acts between pairs, along the line that joins them.
pub trait Model<const D: usize>: Clone + Send + Sync + 'static {
    /// The kernel it smooths with.
    type Kernel: Kernel;

    /// The kernel at the scene's smoothing length.
    fn smoothing(&self) -> &Smoothing<Self::Kernel, D>;

    /// Mass `m` of every particle.
    fn mass(&self) -> f64;

    /// The physical parameters now in force.
    fn parameters(&self) -> &Parameters<f64>;

    /// Puts other parameters in force.
    fn set_parameters(&mut self, parameters: Parameters<f64>);

    /// What a particle of density `rho` brings to its pairs.
    fn stress(&self, rho: f64) -> f64;

    /// [`Model::stress`] with its derivatives.
    fn stress_gradient(&self, rho: f64) -> Stress;

    /// The strength `s` of the force between two particles whose stresses sum to `stresses`.
    fn strength<T: Scalar>(&self, pair: &Pair<T>, stresses: T) -> T;

    /// [`Model::strength`] with its derivatives.
    fn strength_gradient(&self, pair: &Pair<Lanes>, stresses: Lanes) -> Strength<Lanes>;
}
