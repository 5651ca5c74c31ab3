//! A learned equation of state, Eq. (6).
//!
//! Equation numbers are those of Woodward et al., arXiv:2110.13311 ("the paper"): see `docs/equations.md`.

use super::scales::Units;
use super::{
    CentralSlope, Constitutive, Learned, Medium, PairCotangent, PairLaw, Room, Scales,
};
use crate::error::Result;
use crate::network::Network;
use crate::pairs::Batch;
use crate::scalar::{Lanes, Scalar, Wide};
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

    /// `NN`; leaves `room` ready for its derivatives.
    #[inline(always)]
    fn evaluate(&self, rho: Lanes, room: &mut Room) -> Lanes {
        room.input[0] = (rho - 1.0) / self.units.compression;
        self.network.value(room);
        room.output[0]
    }
}

impl<const D: usize> Constitutive<D> for EosNn<D> {
    fn has_stress(&self) -> bool {
        true
    }

    medium_and_network!("eos-nn");

    /// `c`, because the learned pressure at other densities is unknown before training.
    fn sound_speed(&self, _: f64) -> f64 {
        self.medium.fluid.c.abs()
    }

    /// `A = S NN/ρ²`.
    #[inline(always)]
    fn stress(&self, rho: Lanes, room: &mut Room) -> Lanes {
        self.evaluate(rho, room) * self.units.stress / (rho * rho)
    }

    #[inline(always)]
    fn stress_slope(&self, rho: Lanes, room: &mut Room) -> Lanes {
        room.stress_by.fill(Lanes::ZERO);
        let value = self.evaluate(rho, room);
        self.network.jacobian(room);
        let by_density = room.jacobian[0] / self.units.compression - value * 2.0 / rho;
        by_density * self.units.stress / (rho * rho)
    }

    #[inline(always)]
    fn stress_weights(&self, rho: Lanes, room: &mut Room) {
        self.evaluate(rho, room);
        self.network.weight_gradient(0, room);
        let scale = Lanes::of(self.units.stress) / (rho * rho);
        for slope in &mut room.weights {
            *slope = *slope * scale;
        }
    }

    /// One evaluation and one pullback of the network. The sums over weights are per lane, not yet
    /// added up.
    #[inline(always)]
    fn stress_pullback(&self, rho: Lanes, stress: Lanes, room: &mut Room) -> Lanes {
        let value = self.evaluate(rho, room);
        let by_value = stress * self.units.stress / (rho * rho);
        room.output_cotangent[0] = by_value;
        self.network.pullback(room);
        room.input_cotangent[0] / self.units.compression - value * by_value * 2.0 / rho
    }
}

impl<const D: usize> PairLaw<D> for EosNn<D> {
    type ByParameter<W: Wide> = [W; 3];
    type Slope<W: Wide> = CentralSlope<W, D, [W; 3]>;

    const IS_FLUID: bool = true;

    #[inline(always)]
    fn is_antisymmetric(&self) -> bool {
        true
    }

    #[inline(always)]
    fn force<W: Wide>(&self, pairs: &Batch<W, D>, _: &mut Room) -> Vector<W, D> {
        self.medium.force(pairs)
    }

    #[inline(always)]
    fn slope<W: Wide>(&self, pairs: &Batch<W, D>, _: &mut Room) -> CentralSlope<W, D, [W; 3]> {
        self.medium.slope(pairs)
    }

    #[inline(always)]
    fn pullback<W: Wide>(
        &self,
        pairs: &Batch<W, D>,
        force: Vector<W, D>,
        _: &mut Room,
    ) -> PairCotangent<W, D, [W; 3]> {
        self.medium.pullback(pairs, force)
    }
}
