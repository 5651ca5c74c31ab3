//! The fully physics-informed model, Eq. (7): standard smoothed particle hydrodynamics.
//!
//! Equation numbers are those of Woodward et al., arXiv:2110.13311 ("the paper"): see `docs/equations.md`.

use super::{CentralSlope, Constitutive, FluidConstants, Medium, PairCotangent, PairLaw, Scratch};
use crate::network::exp;
use crate::pairs::Batch;
use crate::scalar::{F64x8, Scalar, SimdFloat, SimdTask, dispatch};
use crate::state;
use crate::vector::Vector;

/// Eq. (7): `dvᵢ/dt = −Σⱼ m (Pᵢ/ρᵢ² + Pⱼ/ρⱼ² + Πᵢⱼ) ∇ᵢWᵢⱼ`, with Tait's pressure, Eq. (20), and
/// Monaghan's viscosity, Eq. (21). Learns any of `c, α, β, γ` (and the forcing's `θ`).
///
/// The sum includes the factor `−m`, which the paper's Eq. (7) leaves out; `j = i` is excluded.
/// Linear momentum is conserved and pair torques cancel, to round-off (`tests/conservation.rs`).
#[derive(Clone, Debug)]
pub struct Physics<const D: usize>(pub Medium<D>);

impl<const D: usize> Constitutive<D> for Physics<D> {
    fn name(&self) -> &str {
        "physics"
    }

    fn has_pressure(&self) -> bool {
        true
    }

    fn medium(&self) -> &Medium<D> {
        &self.0
    }

    fn medium_mut(&mut self) -> &mut Medium<D> {
        &mut self.0
    }

    #[inline(always)]
    fn p_over_rho2(&self, rho: F64x8, _: &mut Scratch) -> F64x8 {
        tait_p_over_rho2(&self.0, rho)
    }

    #[inline(always)]
    fn p_over_rho2_slope(&self, rho: F64x8, scratch: &mut Scratch) -> F64x8 {
        tait_p_over_rho2_slope(&self.0, rho, scratch)
    }
}

impl<const D: usize> PairLaw<D> for Physics<D> {
    type ByParameter<W: SimdFloat> = [W; 3];
    type Slope<W: SimdFloat> = CentralSlope<W, D, [W; 3]>;

    const IS_FLUID: bool = true;
    const IS_NUMBERS: bool = true;

    #[inline(always)]
    fn is_antisymmetric(&self) -> bool {
        true
    }

    #[inline(always)]
    fn force<W: SimdFloat>(&self, pairs: &Batch<W, D>, _: &mut Scratch) -> Vector<W, D> {
        self.0.force(pairs)
    }

    #[inline(always)]
    fn slope<W: SimdFloat>(
        &self,
        pairs: &Batch<W, D>,
        _: &mut Scratch,
    ) -> CentralSlope<W, D, [W; 3]> {
        self.0.slope(pairs)
    }

    #[inline(always)]
    fn pullback<W: SimdFloat>(
        &self,
        pairs: &Batch<W, D>,
        force: Vector<W, D>,
        _: &mut Scratch,
    ) -> PairCotangent<W, D, [W; 3]> {
        self.0.pullback(pairs, force)
    }
}

/// `P/ρ²` of Tait's fluid.
#[inline(always)]
pub(super) fn tait_p_over_rho2<const D: usize>(medium: &Medium<D>, rho: F64x8) -> F64x8 {
    let FluidConstants { c, gamma, p0, .. } = medium.fluid;
    state::tait_p_over_rho2(rho, c, gamma, p0)
}

/// `∂A/∂ρ`, and `∂A/∂(c, γ, p₀)` into `scratch.p_over_rho2_by`. The derivatives are written by hand, with
/// `ρ^γ = exp(γ ln ρ)` of eight particles at once.
pub(super) fn tait_p_over_rho2_slope<const D: usize>(
    medium: &Medium<D>,
    rho: F64x8,
    scratch: &mut Scratch,
) -> F64x8 {
    let FluidConstants { c, gamma, p0, .. } = medium.fluid;
    let [by_density, by_c, by_gamma] = dispatch(TaitGradient { rho, c, gamma });
    scratch.p_over_rho2_by.fill(F64x8::ZERO);
    if let [of_c, _, _, of_gamma, of_p0, ..] = &mut scratch.p_over_rho2_by[..] {
        (*of_c, *of_gamma) = (by_c, by_gamma);
        *of_p0 = F64x8::of(1.0) / (rho * rho);
    }
    if p0 == 0.0 { by_density } else { by_density - F64x8::of(2.0 * p0) / (rho * rho * rho) }
}

/// `∂A/∂(ρ, c, γ)` of eight particles.
struct TaitGradient {
    rho: F64x8,
    c: f64,
    gamma: f64,
}

impl SimdTask for TaitGradient {
    type Output = [F64x8; 3];

    #[inline(always)]
    fn run<W: SimdFloat>(self) -> [F64x8; 3] {
        let (rho, logarithm) = (W::Double::load(&self.rho), W::Double::load(&self.rho.ln()));
        let power = exp(logarithm * self.gamma);
        let gradient =
            state::tait_p_over_rho2_gradient((rho, logarithm, power), self.c, self.gamma);
        [gradient[0].store(), gradient[1].store(), gradient[2].store()]
    }
}
