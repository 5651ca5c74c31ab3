//! A learned coefficient of central forces, Eq. (4): invariant under rotations.
//!
//! Equation numbers are those of Woodward et al., arXiv:2110.13311 ("the paper"): see `docs/equations.md`.

use super::physics::{tait_p_over_rho2, tait_p_over_rho2_slope};
use super::scales::Units;
use super::{
    CentralSlope, Constitutive, Learned, Medium, PairCotangent, PairLaw, Scratch, Scales, Window,
};
use crate::error::Result;
use crate::network::Network;
use crate::pairs::Batch;
use crate::scalar::{F64x8, SimdFloat};
use crate::vector::Vector;
use serde::{Deserialize, Serialize};

/// Options of [`RotInv`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Units in each hidden layer.
    pub height: usize,
    /// Whether the network depends symmetrically on the two `A`, so that forces are opposite.
    pub antisymmetric: bool,
    /// Whether the force ends smoothly at `2h`, see [`Window`].
    pub window: bool,
    /// Sizes of inputs and outputs.
    pub scales: Scales,
}

impl Default for Options {
    /// Height 5 and the features of the paper's Eq. (4), with a smooth window. It has 61
    /// parameters; the paper counts 66, because its code has a fifth input.
    fn default() -> Self {
        Self { height: 5, antisymmetric: false, window: true, scales: Scales::default() }
    }
}

/// Eq. (4): `aᵢ = Σⱼ (F/h) w(r) NN(Aᵢ/S, Aⱼ/S, vᵢⱼ·rᵢⱼ/(h V), r/h) rᵢⱼ`, `A = P/ρ²` of Tait's fluid; with
/// `antisymmetric`, `NN((Aᵢ + Aⱼ)/2S, (Aᵢ − Aⱼ)²/S², …)`.
///
/// `4 → l → l → 1`. The force is central. As printed in the paper, pair forces are not opposite and
/// momentum is not conserved. With `antisymmetric` momentum is conserved and pair torques cancel.
#[derive(Clone, Debug)]
pub struct RotInv<const D: usize> {
    medium: Medium<D>,
    network: Learned,
    units: Units,
    antisymmetric: bool,
    window: Window,
}

impl<const D: usize> RotInv<D> {
    /// The model of a fluid.
    ///
    /// # Errors
    /// [`crate::Error::Input`] for a network without units.
    pub fn new(medium: Medium<D>, options: &Options) -> Result<Self> {
        let network = Learned::new(Network::new(4, options.height, 1)?);
        let window = Window::new(medium.smoothing.h, options.window);
        let antisymmetric = options.antisymmetric;
        Ok(Self { units: options.scales.units(&medium), medium, network, antisymmetric, window })
    }

    /// The network's output.
    #[inline(always)]
    fn evaluate<W: SimdFloat>(&self, pairs: &Batch<W, D>, scratch: &mut Scratch) -> W {
        let u = &self.units;
        let (a, b) = (pairs.p_over_rho2_i / u.p_over_rho2, pairs.p_over_rho2_j / u.p_over_rho2);
        let inputs = if self.antisymmetric { [(a + b) * 0.5, (a - b) * (a - b)] } else { [a, b] };
        scratch.input[0] = inputs[0].store();
        scratch.input[1] = inputs[1].store();
        scratch.input[2] = (pairs.pair.v_dot_r / (u.length * u.velocity)).store();
        scratch.input[3] = (pairs.pair.r2.sqrt() / u.length).store();
        self.network.value(scratch);
        W::load(&scratch.output[0])
    }

    /// `(s, slope)` from the derivative of `s` by the network's inputs, `by_input`, and by the
    /// window, `by_window`.
    #[inline(always)]
    fn gather<W: SimdFloat>(
        &self,
        pairs: &Batch<W, D>,
        value: W,
        by_window: W,
        by_input: &[F64x8],
    ) -> CentralSlope<W, D> {
        let u = &self.units;
        let by = |input: usize| W::load(&by_input[input]);
        let by_v_dot_r = by(2) / (u.length * u.velocity);
        let (mut by_i, mut by_j) = (by(0) / u.p_over_rho2, by(1) / u.p_over_rho2);
        if self.antisymmetric {
            let mean = by_i * 0.5;
            let difference = by_j * (pairs.p_over_rho2_i - pairs.p_over_rho2_j) * (2.0 / u.p_over_rho2);
            (by_i, by_j) = (mean + difference, mean - difference);
        }
        let mut by_separation = pairs.separation * by_window + pairs.velocity * by_v_dot_r;
        by_separation += pairs.direction() * (by(3) / u.length);
        CentralSlope {
            separation: pairs.separation,
            value,
            by_separation,
            by_velocity: pairs.separation * by_v_dot_r,
            by_p_over_rho2: [by_i, by_j],
            by_density: W::of(0.0),
            by_parameter: [],
        }
    }
}

impl<const D: usize> Constitutive<D> for RotInv<D> {
    fn has_pressure(&self) -> bool {
        true
    }

    medium_and_network!("rot-inv");

    /// `c`, because the learned force at other densities is unknown before training.
    fn sound_speed(&self, _: f64) -> f64 {
        self.medium.fluid.c.abs()
    }

    #[inline(always)]
    fn p_over_rho2(&self, rho: F64x8, _: &mut Scratch) -> F64x8 {
        tait_p_over_rho2(&self.medium, rho)
    }

    #[inline(always)]
    fn p_over_rho2_slope(&self, rho: F64x8, scratch: &mut Scratch) -> F64x8 {
        tait_p_over_rho2_slope(&self.medium, rho, scratch)
    }
}

impl<const D: usize> PairLaw<D> for RotInv<D> {
    type ByParameter<W: SimdFloat> = [W; 0];
    type Slope<W: SimdFloat> = CentralSlope<W, D>;

    const HAS_NETWORK: bool = true;

    #[inline(always)]
    fn is_antisymmetric(&self) -> bool {
        self.antisymmetric
    }

    #[inline(always)]
    fn force<W: SimdFloat>(&self, pairs: &Batch<W, D>, scratch: &mut Scratch) -> Vector<W, D> {
        let (window, _) = self.window.at(pairs.pair.r2);
        let scale = self.units.force / self.units.length;
        pairs.separation * (self.evaluate(pairs, scratch) * window * scale)
    }

    #[inline(always)]
    fn slope<W: SimdFloat>(&self, pairs: &Batch<W, D>, scratch: &mut Scratch) -> CentralSlope<W, D> {
        let (window, by_r2) = self.window.at(pairs.pair.r2);
        let scale = self.units.force / self.units.length;
        let value = self.evaluate(pairs, scratch) * scale;
        self.network.jacobian(scratch);
        let factor = window * scale;
        for slope in &mut scratch.jacobian {
            *slope = (W::load(slope) * factor).store();
        }
        self.gather(pairs, value * window, value * by_r2, &scratch.jacobian)
    }

    #[inline(always)]
    fn pullback<W: SimdFloat>(
        &self,
        pairs: &Batch<W, D>,
        force: Vector<W, D>,
        scratch: &mut Scratch,
    ) -> PairCotangent<W, D> {
        let (window, by_r2) = self.window.at(pairs.pair.r2);
        let scale = self.units.force / self.units.length;
        let value = self.evaluate(pairs, scratch) * scale;
        let along = force.dot(pairs.separation);
        scratch.output_cotangent[0] = (along * window * scale).store();
        self.network.pullback(scratch);
        // The derivatives by the inputs already include the factor `along`.
        let by = self.gather(pairs, value * window, value * by_r2 * along, &scratch.input_cotangent);
        PairCotangent {
            separation: force * by.value + by.by_separation,
            velocity: by.by_velocity,
            p_over_rho2: by.by_p_over_rho2,
            ..PairCotangent::zero()
        }
    }
}
