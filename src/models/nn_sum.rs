//! A learned pair force, Eq. (3).
//!
//! Equation numbers are those of Woodward et al., arXiv:2110.13311 ("the paper"): see `docs/equations.md`.

use super::scales::Units;
use super::{
    Constitutive, GeneralSlope, Learned, MatrixRows, Medium, PairCotangent, PairLaw, Scratch, Scales,
    Window,
};
use crate::error::Result;
use crate::network::Network;
use crate::pairs::Batch;
use crate::scalar::SimdFloat;
use crate::vector::Vector;
use serde::{Deserialize, Serialize};

/// Options of [`NnSum`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Units in each hidden layer.
    pub height: usize,
    /// Whether the force is `½ [NN(ij) − NN(ji)]`, so that forces are opposite.
    pub antisymmetric: bool,
    /// Whether the force ends smoothly at `2h`, see [`Window`].
    pub window: bool,
    /// Sizes of inputs and outputs.
    pub scales: Scales,
}

impl Default for Options {
    /// Height 5 and the features of the paper's Eq. (3), with a smooth window. In 3D it has 83
    /// parameters; the paper counts 113, because its code has twelve inputs.
    fn default() -> Self {
        Self { height: 5, antisymmetric: false, window: true, scales: Scales::default() }
    }
}

/// Eq. (3): `aᵢ = Σⱼ F w(r) NN(rᵢⱼ/h, vᵢⱼ/V)`; with `antisymmetric`, `½ [NN(ij) − NN(ji)]`.
///
/// `2d → l → l → d`. As printed in the paper, momentum is not conserved. With `antisymmetric` it
/// is, for twice the network evaluations, but pair torques do not cancel.
#[derive(Clone, Debug)]
pub struct NnSum<const D: usize> {
    medium: Medium<D>,
    network: Learned,
    units: Units,
    antisymmetric: bool,
    window: Window,
}

impl<const D: usize> NnSum<D> {
    /// The model of a fluid.
    ///
    /// # Errors
    /// [`crate::Error::Input`] for a network without units.
    pub fn new(medium: Medium<D>, options: &Options) -> Result<Self> {
        let network = Learned::new(Network::new(2 * D, options.height, D)?);
        let window = Window::new(medium.smoothing.h, options.window);
        let antisymmetric = options.antisymmetric;
        Ok(Self { units: options.scales.units(&medium), medium, network, antisymmetric, window })
    }

    /// Evaluates `NN(ij)`, or `NN(ji)` for `sign = −1`, into `scratch`.
    #[inline(always)]
    fn evaluate<W: SimdFloat>(&self, pairs: &Batch<W, D>, sign: f64, scratch: &mut Scratch) {
        for axis in 0..D {
            scratch.input[axis] = (pairs.separation[axis] * (sign / self.units.length)).store();
            scratch.input[D + axis] = (pairs.velocity[axis] * (sign / self.units.velocity)).store();
        }
        self.network.value(scratch);
    }

    /// The factors of a pair's network evaluations: positive for `NN(ij)`, negative for `NN(ji)`.
    #[inline(always)]
    fn ends(&self) -> &'static [f64] {
        if self.antisymmetric { &[0.5, -0.5] } else { &[1.0] }
    }
}

impl<const D: usize> Constitutive<D> for NnSum<D> {
    medium_and_network!("nn-sum");

    fn sound_speed(&self, _: f64) -> f64 {
        0.0
    }
}

impl<const D: usize> PairLaw<D> for NnSum<D> {
    type ByParameter<W: SimdFloat> = [W; 0];
    type Slope<W: SimdFloat> = GeneralSlope<W, D, 0, MatrixRows>;

    const HAS_NETWORK: bool = true;

    #[inline(always)]
    fn is_antisymmetric(&self) -> bool {
        self.antisymmetric
    }

    #[inline(always)]
    fn force<W: SimdFloat>(&self, pairs: &Batch<W, D>, scratch: &mut Scratch) -> Vector<W, D> {
        let (window, _) = self.window.at(pairs.pair.r2);
        let mut force = Vector::zero();
        for &factor in self.ends() {
            self.evaluate(pairs, factor.signum(), scratch);
            for axis in 0..D {
                force[axis] += W::load(&scratch.output[axis]) * (factor * self.units.force);
            }
        }
        force * window
    }

    #[inline(always)]
    fn slope<W: SimdFloat>(&self, pairs: &Batch<W, D>, scratch: &mut Scratch) -> GeneralSlope<W, D, 0, MatrixRows> {
        let (window, by_r2) = self.window.at(pairs.pair.r2);
        let mut slope = GeneralSlope::zero();
        for &factor in self.ends() {
            self.evaluate(pairs, factor.signum(), scratch);
            self.network.jacobian(scratch);
            let scale = factor * self.units.force;
            // The inputs have the sign of the factor, and so have the derivatives by them.
            let inner = window * (scale * factor.signum());
            for a in 0..D {
                let row = &scratch.jacobian[2 * D * a..2 * D * (a + 1)];
                let output = W::load(&scratch.output[a]);
                slope.by_separation[a] += pairs.separation * (output * by_r2 * scale);
                for b in 0..D {
                    slope.by_separation[a][b] += W::load(&row[b]) * inner / self.units.length;
                    slope.by_velocity[a][b] += W::load(&row[D + b]) * inner / self.units.velocity;
                }
            }
        }
        slope
    }

    #[inline(always)]
    fn pullback<W: SimdFloat>(
        &self,
        pairs: &Batch<W, D>,
        force: Vector<W, D>,
        scratch: &mut Scratch,
    ) -> PairCotangent<W, D> {
        let (window, by_r2) = self.window.at(pairs.pair.r2);
        let mut cotangent = PairCotangent::zero();
        for &factor in self.ends() {
            self.evaluate(pairs, factor.signum(), scratch);
            let scale = factor * self.units.force;
            let mut along = W::of(0.0);
            for axis in 0..D {
                along += W::load(&scratch.output[axis]) * force[axis];
                scratch.output_cotangent[axis] = (force[axis] * window * scale).store();
            }
            self.network.pullback(scratch);
            cotangent.separation += pairs.separation * (along * by_r2 * scale);
            for axis in 0..D {
                let by_r = W::load(&scratch.input_cotangent[axis]);
                let by_v = W::load(&scratch.input_cotangent[D + axis]);
                let sign = factor.signum();
                cotangent.separation[axis] += by_r * (sign / self.units.length);
                cotangent.velocity[axis] += by_v * (sign / self.units.velocity);
            }
        }
        cotangent
    }
}
