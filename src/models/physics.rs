//! The fully physics-informed model, Eq. (7): smoothed particle hydrodynamics itself.

use super::{CentralSlope, Constitutive, Medium, PairCotangent, PairLaw, Room, StressSlope};
use crate::network::exp;
use crate::pairs::Batch;
use crate::scalar::{Lanes, Pass, Scalar, Wide, dispatch};
use crate::state;
use crate::vector::Vector;

/// Eq. (7): `dvᵢ/dt = −Σⱼ m (Pᵢ/ρᵢ² + Pⱼ/ρⱼ² + Πᵢⱼ) ∇ᵢWᵢⱼ`, with Tait's pressure, Eq. (20), and
/// Monaghan's viscosity, Eq. (21). Learns any of `c, α, β, γ` (and the forcing's `θ`).
///
/// The sum carries `m` and the minus that the paper's Eq. (7) leaves out; `j = i` is excluded.
/// Momentum and pair torques are conserved to round-off (`tests/conservation.rs`).
#[derive(Clone, Debug)]
pub struct Physics<const D: usize>(pub Medium<D>);

impl<const D: usize> Constitutive<D> for Physics<D> {
    fn has_stress(&self) -> bool {
        true
    }

    fn medium(&self) -> &Medium<D> {
        &self.0
    }

    fn medium_mut(&mut self) -> &mut Medium<D> {
        &mut self.0
    }

    #[inline(always)]
    fn stress(&self, rho: Lanes, _: &mut Room) -> Lanes {
        tait_stress(&self.0, rho)
    }

    #[inline(always)]
    fn stress_slope(&self, rho: Lanes, _: &mut Room) -> StressSlope {
        tait_stress_slope(&self.0, rho)
    }
}

impl<const D: usize> PairLaw<D> for Physics<D> {
    type Slope<W: Wide> = CentralSlope<W, D>;

    #[inline(always)]
    fn is_antisymmetric(&self) -> bool {
        true
    }

    #[inline(always)]
    fn force<W: Wide>(&self, pairs: &Batch<W, D>, _: &mut Room) -> Vector<W, D> {
        self.0.force(pairs)
    }

    #[inline(always)]
    fn slope<W: Wide>(&self, pairs: &Batch<W, D>, _: &mut Room) -> CentralSlope<W, D> {
        self.0.slope(pairs)
    }

    #[inline(always)]
    fn pullback<W: Wide>(
        &self,
        pairs: &Batch<W, D>,
        force: Vector<W, D>,
        _: &mut Room,
    ) -> PairCotangent<W, D> {
        self.0.pullback(pairs, force)
    }
}

/// `P/ρ²` of Tait's fluid.
#[inline(always)]
pub(super) fn tait_stress<const D: usize>(medium: &Medium<D>, rho: Lanes) -> Lanes {
    let [c, _, _, gamma, _] = medium.parameters.0;
    state::tait_stress(rho, c, gamma)
}

/// Three inputs, one output: by hand, with `ρ^γ = exp(γ ln ρ)` of eight particles at once.
pub(super) fn tait_stress_slope<const D: usize>(medium: &Medium<D>, rho: Lanes) -> StressSlope {
    let [c, _, _, gamma, _] = medium.parameters.0;
    let [by_density, by_c, by_gamma] = dispatch(TaitGradient { rho, c, gamma });
    let mut slope = StressSlope { by_density, ..StressSlope::ZERO };
    (slope.by_parameter[0], slope.by_parameter[3]) = (by_c, by_gamma);
    slope
}

/// `∂A/∂(ρ, c, γ)` of eight particles.
struct TaitGradient {
    rho: Lanes,
    c: f64,
    gamma: f64,
}

impl Pass for TaitGradient {
    type Output = [Lanes; 3];

    #[inline(always)]
    fn run<W: Wide>(self) -> [Lanes; 3] {
        let (rho, logarithm) = (W::Double::load(&self.rho), W::Double::load(&self.rho.ln()));
        let power = exp(logarithm * self.gamma);
        let gradient = state::tait_stress_gradient((rho, logarithm, power), self.c, self.gamma);
        [gradient[0].store(), gradient[1].store(), gradient[2].store()]
    }
}
