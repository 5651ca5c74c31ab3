//! A learned equation of state, Eq. (6).
//!
//! Equation numbers are those of Woodward et al., arXiv:2110.13311 ("the paper"): see `docs/equations.md`.

use super::scales::Units;
use super::{
    CentralSlope, Constitutive, Learned, Medium, PairCotangent, PairLaw, Scratch, Scales,
};
use crate::error::Result;
use crate::network::Network;
use crate::pairs::Batch;
use crate::scalar::{F64x8, Scalar, SimdFloat};
use crate::vector::Vector;
use serde::{Deserialize, Serialize};

/// Options of [`EosNn`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Units in each hidden layer.
    pub height: usize,
    /// Sizes of inputs and outputs.
    pub scales: Scales,
}

impl Default for Options {
    /// Height 10, as in the paper (141 parameters).
    fn default() -> Self {
        Self { height: 10, scales: Scales::default() }
    }
}

/// Eq. (6): the fluid of [`super::Physics`] with `P(ρ) = S NN((ρ − 1)/ρ_s)` in place of Tait's pressure,
/// `S = c² ρ_s`; Monaghan's viscosity is kept.
///
/// `1 → l → l → 1`. Linear momentum is conserved and pair torques cancel for any weights.
/// Recommended where the fluid is known but its equation of state is not. It evaluates the network
/// once per particle.
#[derive(Clone, Debug)]
pub struct EosNn<const D: usize> {
    medium: Medium<D>,
    network: Learned,
    units: Units,
}

impl<const D: usize> EosNn<D> {
    /// The model of a fluid.
    ///
    /// # Errors
    /// [`crate::Error::Input`] for a network without units.
    pub fn new(medium: Medium<D>, options: &Options) -> Result<Self> {
        let network = Learned::new(Network::new(1, options.height, 1)?);
        Ok(Self { units: options.scales.units(&medium), medium, network })
    }

    /// `NN`; leaves `scratch` ready for its derivatives.
    #[inline(always)]
    fn evaluate(&self, rho: F64x8, scratch: &mut Scratch) -> F64x8 {
        scratch.input[0] = (rho - 1.0) / self.units.compression;
        self.network.value(scratch);
        scratch.output[0]
    }
}

impl<const D: usize> Constitutive<D> for EosNn<D> {
    fn has_pressure(&self) -> bool {
        true
    }

    medium_and_network!("eos-nn");

    /// `c`, because the learned pressure at other densities is unknown before training.
    fn sound_speed(&self, _: f64) -> f64 {
        self.medium.fluid.c.abs()
    }

    /// `A = S NN/ρ²`.
    #[inline(always)]
    fn p_over_rho2(&self, rho: F64x8, scratch: &mut Scratch) -> F64x8 {
        self.evaluate(rho, scratch) * self.units.p_over_rho2 / (rho * rho)
    }

    #[inline(always)]
    fn p_over_rho2_slope(&self, rho: F64x8, scratch: &mut Scratch) -> F64x8 {
        scratch.p_over_rho2_by.fill(F64x8::ZERO);
        let value = self.evaluate(rho, scratch);
        self.network.jacobian(scratch);
        let by_density = scratch.jacobian[0] / self.units.compression - value * 2.0 / rho;
        by_density * self.units.p_over_rho2 / (rho * rho)
    }

    #[inline(always)]
    fn p_over_rho2_weights(&self, rho: F64x8, scratch: &mut Scratch) {
        self.evaluate(rho, scratch);
        self.network.weight_gradient(0, scratch);
        let scale = F64x8::of(self.units.p_over_rho2) / (rho * rho);
        for slope in &mut scratch.weights {
            *slope = *slope * scale;
        }
    }

    /// One evaluation and one pullback of the network. The sums over weights are per lane, not yet
    /// added up.
    #[inline(always)]
    fn p_over_rho2_pullback(&self, rho: F64x8, p_over_rho2: F64x8, scratch: &mut Scratch) -> F64x8 {
        let value = self.evaluate(rho, scratch);
        let by_value = p_over_rho2 * self.units.p_over_rho2 / (rho * rho);
        scratch.output_cotangent[0] = by_value;
        self.network.pullback(scratch);
        scratch.input_cotangent[0] / self.units.compression - value * by_value * 2.0 / rho
    }
}

impl<const D: usize> PairLaw<D> for EosNn<D> {
    type ByParameter<W: SimdFloat> = [W; 3];
    type Slope<W: SimdFloat> = CentralSlope<W, D, [W; 3]>;

    const IS_FLUID: bool = true;

    #[inline(always)]
    fn is_antisymmetric(&self) -> bool {
        true
    }

    #[inline(always)]
    fn force<W: SimdFloat>(&self, pairs: &Batch<W, D>, _: &mut Scratch) -> Vector<W, D> {
        self.medium.force(pairs)
    }

    #[inline(always)]
    fn slope<W: SimdFloat>(&self, pairs: &Batch<W, D>, _: &mut Scratch) -> CentralSlope<W, D, [W; 3]> {
        self.medium.slope(pairs)
    }

    #[inline(always)]
    fn pullback<W: SimdFloat>(
        &self,
        pairs: &Batch<W, D>,
        force: Vector<W, D>,
        _: &mut Scratch,
    ) -> PairCotangent<W, D, [W; 3]> {
        self.medium.pullback(pairs, force)
    }
}
