//! Standard smoothed particle hydrodynamics with a learned exchange of momentum between the two particles of a pair: what
//! motion below the smoothing length does to the flow above it.
//!
//! Invariants and form follow the closure problem of Lagrangian large-eddy simulation (Tian et al., PNAS 120 (2023)
//! e2213638120), with forces that are opposite by construction.

use super::physics::{tait_p_over_rho2, tait_p_over_rho2_slope};
use super::scales::Units;
use super::{
    Constitutive, GeneralSlope, Learned, Medium, PairCotangent, PairLaw, Scratch, Scales, Window,
};
use crate::error::Result;
use crate::network::Network;
use crate::pairs::Batch;
use crate::scalar::{F64x8, SimdFloat};
use crate::vector::Vector;
use serde::{Deserialize, Serialize};

/// Options of [`Exchange`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Units in each hidden layer.
    pub height: usize,
    /// Whether there is a force across the line between the particles, `ψ`. Without it the force is central, and angular
    /// momentum is conserved, too.
    pub transverse: bool,
    /// Sizes of inputs and outputs.
    pub scales: Scales,
}

impl Default for Options {
    /// Height 8, with a transverse force.
    fn default() -> Self {
        Self { height: 8, transverse: true, scales: Scales::default() }
    }
}

/// Number of invariants of a pair.
const INPUTS: usize = 5;

/// `ε` in `r² + εh²`, which keeps the projection finite for particles that coincide.
const SOFTENING: f64 = 0.01;

/// [`Physics`](super::Physics) and `Σⱼ F w(r) [φ r/h + ψ (v − q r)/V]` with `r = rᵢⱼ`, `v = vᵢⱼ`, `q = v·r/(r² + εh²)` and
/// `(φ, ψ) = NN(r/h, v·r/(hV), v²/V², (ρ̄ − 1)/ρ_s, (ρᵢ − ρⱼ)²/ρ_s²)`.
///
/// `5 → l → l → 2`, or 1 without the transverse force `ψ`. The invariants are the same for both particles of a pair, so that
/// forces are opposite: momentum is conserved to round-off, and angular momentum where there is no `ψ`. The last layer
/// starts at zero: a search starts at the physics, whose constants are learned with the weights.
#[derive(Clone, Debug)]
pub struct Exchange<const D: usize> {
    medium: Medium<D>,
    network: Learned,
    units: Units,
    transverse: bool,
    window: Window,
}

/// The vectors of the exchange of eight pairs.
struct Parts<W, const D: usize> {
    /// `r/h`.
    along: Vector<W, D>,
    /// `(v − q r)/V`.
    across: Vector<W, D>,
    /// `q`.
    q: W,
    /// `1/(r² + εh²)`.
    inverse: W,
}

/// The derivatives of `φ` or `ψ` by the state of a pair.
struct ByState<W, const D: usize> {
    separation: Vector<W, D>,
    velocity: Vector<W, D>,
    density: [W; 2],
}

impl<const D: usize> Exchange<D> {
    /// The model of a fluid.
    ///
    /// # Errors
    /// [`crate::Error::Input`] for a network without units.
    pub fn new(medium: Medium<D>, options: &Options) -> Result<Self> {
        let outputs = if options.transverse { 2 } else { 1 };
        let network = Learned::at_zero(Network::new(INPUTS, options.height, outputs)?);
        let window = Window::new(medium.smoothing.h, true);
        let transverse = options.transverse;
        Ok(Self { units: options.scales.units(&medium), medium, network, transverse, window })
    }

    /// `φ` and `ψ`, with the force's scale.
    #[inline(always)]
    fn evaluate<W: SimdFloat>(&self, pairs: &Batch<W, D>, scratch: &mut Scratch) -> [W; 2] {
        let u = &self.units;
        let (pair, v) = (&pairs.pair, pairs.velocity);
        let apart = (pair.rho_i - pair.rho_j) / u.compression;
        scratch.input[0] = (pair.r2.sqrt() / u.length).store();
        scratch.input[1] = (pair.v_dot_r / (u.length * u.velocity)).store();
        scratch.input[2] = (v.dot(v) / (u.velocity * u.velocity)).store();
        scratch.input[3] = ((pair.mean_density() - W::of(1.0)) / u.compression).store();
        scratch.input[4] = (apart * apart).store();
        self.network.value(scratch);
        let phi = W::load(&scratch.output[0]) * u.force;
        let psi = if self.transverse { W::load(&scratch.output[1]) * u.force } else { W::of(0.0) };
        [phi, psi]
    }

    #[inline(always)]
    fn parts<W: SimdFloat>(&self, pairs: &Batch<W, D>) -> Parts<W, D> {
        let h = self.units.length;
        let inverse = W::of(1.0) / (pairs.pair.r2 + W::of(SOFTENING * h * h));
        let q = pairs.pair.v_dot_r * inverse;
        let across = (pairs.velocity - pairs.separation * q) * W::of(1.0 / self.units.velocity);
        Parts { along: pairs.separation * W::of(1.0 / h), across, q, inverse }
    }

    /// From derivatives by the network's inputs.
    #[inline(always)]
    fn by_state<W: SimdFloat>(&self, pairs: &Batch<W, D>, by_input: &[F64x8]) -> ByState<W, D> {
        let u = &self.units;
        let by = |input: usize| W::load(&by_input[input]);
        let by_v_dot_r = by(1) / (u.length * u.velocity);
        let by_v2 = by(2) * (2.0 / (u.velocity * u.velocity));
        let mean = by(3) * (0.5 / u.compression);
        let apart = (pairs.pair.rho_i - pairs.pair.rho_j)
            * by(4)
            * (2.0 / (u.compression * u.compression));
        ByState {
            separation: pairs.direction() * (by(0) / u.length) + pairs.velocity * by_v_dot_r,
            velocity: pairs.separation * by_v_dot_r + pairs.velocity * by_v2,
            density: [mean + apart, mean - apart],
        }
    }

    /// The exchange alone.
    #[inline(always)]
    fn exchange<W: SimdFloat>(&self, pairs: &Batch<W, D>, scratch: &mut Scratch) -> Vector<W, D> {
        let (window, _) = self.window.at(pairs.pair.r2);
        let [phi, psi] = self.evaluate(pairs, scratch);
        let parts = self.parts(pairs);
        (parts.along * phi + parts.across * psi) * window
    }
}

impl<const D: usize> Constitutive<D> for Exchange<D> {
    fn has_pressure(&self) -> bool {
        true
    }

    medium_and_network!("exchange");

    #[inline(always)]
    fn p_over_rho2(&self, rho: F64x8, _: &mut Scratch) -> F64x8 {
        tait_p_over_rho2(&self.medium, rho)
    }

    #[inline(always)]
    fn p_over_rho2_slope(&self, rho: F64x8, scratch: &mut Scratch) -> F64x8 {
        tait_p_over_rho2_slope(&self.medium, rho, scratch)
    }
}

impl<const D: usize> PairLaw<D> for Exchange<D> {
    type ByParameter<W: SimdFloat> = [W; 3];
    type Slope<W: SimdFloat> = GeneralSlope<W, D, 3>;

    const HAS_NETWORK: bool = true;
    const HAS_KERNEL: bool = true;
    const PARTS: &'static [&'static str] = &["pressure", "viscosity", "exchange"];

    #[inline(always)]
    fn is_antisymmetric(&self) -> bool {
        true
    }

    #[inline(always)]
    fn part_of_force<W: SimdFloat>(
        &self,
        part: usize,
        pairs: &Batch<W, D>,
        scratch: &mut Scratch,
    ) -> Vector<W, D> {
        if part == 2 {
            return self.exchange(pairs, scratch);
        }
        let sum = pairs.p_over_rho2_i + pairs.p_over_rho2_j;
        pairs.separation * self.medium.coefficients(&pairs.pair, sum)[part]
    }

    #[inline(always)]
    fn by_kernel<W: SimdFloat>(
        &self,
        pairs: &Batch<W, D>,
        parameter: usize,
        _: &mut Scratch,
    ) -> Vector<W, D> {
        self.medium.by_kernel(pairs, pairs.p_over_rho2_i + pairs.p_over_rho2_j, parameter)
    }

    #[inline(always)]
    fn force<W: SimdFloat>(&self, pairs: &Batch<W, D>, scratch: &mut Scratch) -> Vector<W, D> {
        self.medium.force(pairs) + self.exchange(pairs, scratch)
    }

    #[inline(always)]
    fn slope<W: SimdFloat>(
        &self,
        pairs: &Batch<W, D>,
        scratch: &mut Scratch,
    ) -> GeneralSlope<W, D, 3> {
        let (h, speed) = (self.units.length, self.units.velocity);
        let (r, v) = (pairs.separation, pairs.velocity);
        let (window, by_r2) = self.window.at(pairs.pair.r2);
        let [phi, psi] = self.evaluate(pairs, scratch);
        self.network.jacobian(scratch);
        let parts = self.parts(pairs);
        let scale = window * self.units.force;
        let of_phi = self.by_state(pairs, &scratch.jacobian[..INPUTS]);
        let by_q_r = v * parts.inverse - r * (parts.q * parts.inverse * 2.0);
        let central = self.medium.slope(pairs);
        let mut slope = GeneralSlope::<W, D, 3>::zero();
        let whole = parts.along * phi + parts.across * psi;
        let (diagonal_r, diagonal_v) = (
            phi * window * (1.0 / h) - psi * window * parts.q * (1.0 / speed),
            psi * window * (1.0 / speed),
        );
        for a in 0..D {
            let along = parts.along[a] * scale;
            slope.by_separation[a] = r * (whole[a] * by_r2) + of_phi.separation * along
                - by_q_r * (r[a] * diagonal_v)
                + central.by_separation * r[a];
            slope.by_velocity[a] = of_phi.velocity * along
                - r * (r[a] * parts.inverse * diagonal_v)
                + central.by_velocity * r[a];
            slope.by_separation[a][a] += diagonal_r + central.value;
            slope.by_velocity[a][a] += diagonal_v;
        }
        for end in 0..2 {
            slope.by_density[end] =
                parts.along * (of_phi.density[end] * scale) + r * central.by_density;
            slope.by_p_over_rho2[end] = r * central.by_p_over_rho2[end];
        }
        if self.transverse {
            let of_psi = self.by_state(pairs, &scratch.jacobian[INPUTS..2 * INPUTS]);
            for a in 0..D {
                let across = parts.across[a] * scale;
                slope.by_separation[a] += of_psi.separation * across;
                slope.by_velocity[a] += of_psi.velocity * across;
            }
            for end in 0..2 {
                slope.by_density[end] += parts.across * (of_psi.density[end] * scale);
            }
        }
        for (by, own) in slope.by_parameter.iter_mut().zip(central.by_parameter) {
            *by = r * own;
        }
        slope
    }

    #[inline(always)]
    fn pullback<W: SimdFloat>(
        &self,
        pairs: &Batch<W, D>,
        force: Vector<W, D>,
        scratch: &mut Scratch,
    ) -> PairCotangent<W, D, [W; 3]> {
        let (h, speed) = (self.units.length, self.units.velocity);
        let (r, v) = (pairs.separation, pairs.velocity);
        let mut cotangent = self.medium.pullback(pairs, force);
        let (window, by_r2) = self.window.at(pairs.pair.r2);
        let [phi, psi] = self.evaluate(pairs, scratch);
        let parts = self.parts(pairs);
        let (along, across) = (parts.along.dot(force), parts.across.dot(force));
        // The factors of the network's outputs.
        let scale = window * self.units.force;
        scratch.output_cotangent[0] = (along * scale).store();
        if self.transverse {
            scratch.output_cotangent[1] = (across * scale).store();
        }
        self.network.pullback(scratch);
        let by = self.by_state(pairs, &scratch.input_cotangent[..INPUTS]);
        // The vectors: `∂L/∂(v − q r)/V` is `μ`, and `∂L/∂q = −μ·r`.
        let mu = force * (psi * window * (1.0 / speed));
        let by_q = -(mu.dot(r));
        let q_of_r = v * parts.inverse - r * (parts.q * parts.inverse * 2.0);
        cotangent.separation += r * ((along * phi + across * psi) * by_r2)
            + force * (phi * window * (1.0 / h))
            - mu * parts.q
            + q_of_r * by_q
            + by.separation;
        cotangent.velocity += mu + r * (parts.inverse * by_q) + by.velocity;
        for end in 0..2 {
            cotangent.density[end] += by.density[end];
        }
        cotangent
    }
}
