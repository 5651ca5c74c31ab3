//! A learned pressure gradient, Eq. (5).
//!
//! Equation numbers are those of Woodward et al., arXiv:2110.13311 ("the paper"): see `docs/equations.md`.

use super::scales::Units;
use super::{
    CentralSlope, Constitutive, Learned, Medium, PairCotangent, PairLaw, Scratch, Scales,
};
use crate::error::Result;
use crate::network::Network;
use crate::pairs::Batch;
use crate::scalar::{F64x8, SimdFloat};
use crate::vector::Vector;
use serde::{Deserialize, Serialize};

/// Options of [`GradP`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Units in each hidden layer.
    pub height: usize,
    /// Whether the network depends on `|rᵢⱼ|` only, so that forces are opposite.
    pub antisymmetric: bool,
    /// Sizes of inputs and outputs.
    pub scales: Scales,
}

impl Default for Options {
    /// Height 5 and the paper's features (56 parameters in 3D).
    fn default() -> Self {
        Self { height: 5, antisymmetric: false, scales: Scales::default() }
    }
}

/// Eq. (5): `aᵢ = −Σⱼ m (S NN(rᵢⱼ/h) + Πᵢⱼ) ∇ᵢWᵢⱼ`; with `antisymmetric`, `NN(|rᵢⱼ|/h)`.
///
/// `d → l → l → 1`. The kernel ends the force at `2h`. As printed in the paper, `NN(rᵢⱼ)` and
/// `NN(rⱼᵢ)` differ and momentum is not conserved; with `antisymmetric` it is.
#[derive(Clone, Debug)]
pub struct GradP<const D: usize> {
    medium: Medium<D>,
    network: Learned,
    units: Units,
    antisymmetric: bool,
}

impl<const D: usize> GradP<D> {
    /// The model of a fluid.
    ///
    /// # Errors
    /// [`crate::Error::Input`] for a network without units.
    pub fn new(medium: Medium<D>, options: &Options) -> Result<Self> {
        let inputs = if options.antisymmetric { 1 } else { D };
        let network = Learned::new(Network::new(inputs, options.height, 1)?);
        let antisymmetric = options.antisymmetric;
        Ok(Self { units: options.scales.units(&medium), medium, network, antisymmetric })
    }

    /// Derivatives by `rᵢⱼ` from derivatives by the network's inputs.
    #[inline(always)]
    fn by_separation<W: SimdFloat>(&self, pairs: &Batch<W, D>, by_input: &[F64x8]) -> Vector<W, D> {
        if self.antisymmetric {
            return pairs.direction() * (W::load(&by_input[0]) / self.units.length);
        }
        let mut by = Vector::zero();
        for axis in 0..D {
            by[axis] = W::load(&by_input[axis]) / self.units.length;
        }
        by
    }
}

impl<const D: usize> Constitutive<D> for GradP<D> {
    medium_and_network!("grad-p");

    fn sound_speed(&self, _: f64) -> f64 {
        0.0
    }
}

impl<const D: usize> PairLaw<D> for GradP<D> {
    type ByParameter<W: SimdFloat> = [W; 3];
    type Slope<W: SimdFloat> = CentralSlope<W, D, [W; 3]>;

    const HAS_NETWORK: bool = true;
    const IS_FLUID: bool = true;

    #[inline(always)]
    fn is_antisymmetric(&self) -> bool {
        self.antisymmetric
    }

    /// `S NN` in place of `Aᵢ + Aⱼ`.
    #[inline(always)]
    fn p_over_rho2_sum<W: SimdFloat>(&self, pairs: &Batch<W, D>, scratch: &mut Scratch) -> W {
        if self.antisymmetric {
            scratch.input[0] = (pairs.pair.r2.sqrt() / self.units.length).store();
        } else {
            for axis in 0..D {
                scratch.input[axis] = (pairs.separation[axis] / self.units.length).store();
            }
        }
        self.network.value(scratch);
        W::load(&scratch.output[0]) * self.units.p_over_rho2
    }

    #[inline(always)]
    fn force<W: SimdFloat>(&self, pairs: &Batch<W, D>, scratch: &mut Scratch) -> Vector<W, D> {
        let p_over_rho2_sum = self.p_over_rho2_sum(pairs, scratch);
        pairs.separation * self.medium.strength(&pairs.pair, p_over_rho2_sum)
    }

    #[inline(always)]
    fn slope<W: SimdFloat>(&self, pairs: &Batch<W, D>, scratch: &mut Scratch) -> CentralSlope<W, D, [W; 3]> {
        let p_over_rho2_sum = self.p_over_rho2_sum(pairs, scratch);
        self.network.jacobian(scratch);
        let s = self.medium.coefficient_gradient(&pairs.pair, p_over_rho2_sum);
        let mut slope = CentralSlope::new(pairs, &s, [W::of(0.0); 2]);
        let by_network = s.by_p_over_rho2 * self.units.p_over_rho2;
        slope.by_separation += self.by_separation(pairs, &scratch.jacobian) * by_network;
        slope
    }

    #[inline(always)]
    fn pullback<W: SimdFloat>(
        &self,
        pairs: &Batch<W, D>,
        force: Vector<W, D>,
        scratch: &mut Scratch,
    ) -> PairCotangent<W, D, [W; 3]> {
        let p_over_rho2_sum = self.p_over_rho2_sum(pairs, scratch);
        let (mut cotangent, by_p_over_rho2) = self.medium.pullback_of(pairs, p_over_rho2_sum, force);
        scratch.output_cotangent[0] = (by_p_over_rho2 * self.units.p_over_rho2).store();
        self.network.pullback(scratch);
        cotangent.separation += self.by_separation(pairs, &scratch.input_cotangent);
        cotangent
    }
}
