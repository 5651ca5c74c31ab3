//! Laminar viscosity along the line between two particles (Monaghan 2005, Rep. Prog. Phys. 68, 1703; Cleary 1998).

use super::{EPSILON, medium_and_nu};
use crate::models::{
    CentralSlope, Constitutive, Medium, PairCoefficient, PairCotangent, PairLaw, Scratch, Slope,
};
use crate::pairs::Batch;
use crate::parameters::ParameterSpec;
use crate::scalar::SimdFloat;
use crate::vector::Vector;

/// `aᵢ = Σⱼ m 2(d+2) ν/ρ̄ · vᵢⱼ·rᵢⱼ/(r² + 0.01 h²) ∇ᵢWᵢⱼ`, `ν` the kinematic viscosity, `ρ̄ = (ρᵢ + ρⱼ)/2`.
///
/// The force is central and opposite: linear and angular momentum are conserved to round-off. The
/// factor `2(d+2)/ρ̄` makes it `ν(∇²v + 2∇∇·v)`, which is `ν∇²v` in incompressible flow. Decaying
/// Taylor–Green flow in two dimensions confirms it (`cargo bench --bench viscosity`).
#[derive(Clone, Debug)]
pub struct MonaghanCleary<const D: usize> {
    medium: Medium<D>,
    nu: f64,
}

impl<const D: usize> MonaghanCleary<D> {
    /// With a viscosity `ν` in a fluid.
    pub fn new(medium: Medium<D>, nu: f64) -> Self {
        Self { medium, nu }
    }

    /// `4(d+2) m`: over `ρᵢ + ρⱼ` it is `2(d+2) m/ρ̄`.
    #[inline(always)]
    fn factor(&self) -> f64 {
        4.0 * (D as f64 + 2.0) * self.medium.mass
    }

    /// `s = factor ν v·r G/((ρᵢ + ρⱼ)(r² + 0.01 h²))` and its derivatives.
    #[inline(always)]
    fn strength<W: SimdFloat>(&self, pairs: &Batch<W, D>) -> PairCoefficient<W, [W; 1]> {
        let (pair, smoothing) = (&pairs.pair, &self.medium.smoothing);
        let [dw_over_r, d_dw_over_r] = smoothing.dw_derivatives(pair.r2.sqrt());
        let densities = pair.rho_i + pair.rho_j;
        let inverse = W::of(1.0) / (pair.r2 + EPSILON * smoothing.h * smoothing.h);
        // By ν and v·r.
        let both = dw_over_r * inverse / densities * self.factor();
        let by_nu = both * pair.v_dot_r;
        let value = by_nu * self.nu;
        let curved = d_dw_over_r * inverse / densities * self.factor();
        let by_separation = (curved - both * inverse * 2.0) * pair.v_dot_r * self.nu;
        PairCoefficient {
            value,
            by_separation,
            by_v_dot_r: both * self.nu,
            by_p_over_rho2: W::of(0.0),
            by_density: -(value / densities),
            by_parameter: [by_nu],
        }
    }
}

impl<const D: usize> Constitutive<D> for MonaghanCleary<D> {
    medium_and_nu!("monaghan-cleary");
}

impl<const D: usize> PairLaw<D> for MonaghanCleary<D> {
    type ByParameter<W: SimdFloat> = [W; 1];
    type Slope<W: SimdFloat> = CentralSlope<W, D, [W; 1]>;

    const IS_NUMBERS: bool = true;
    const HAS_KERNEL: bool = true;

    #[inline(always)]
    fn is_antisymmetric(&self) -> bool {
        true
    }

    #[inline(always)]
    fn by_kernel<W: SimdFloat>(
        &self,
        pairs: &Batch<W, D>,
        parameter: usize,
        _: &mut Scratch,
    ) -> Vector<W, D> {
        let (pair, smoothing) = (&pairs.pair, &self.medium.smoothing);
        let by = smoothing.dw_over_r_by(parameter, pair.r2.sqrt());
        let under = (pair.r2 + EPSILON * smoothing.h * smoothing.h) * (pair.rho_i + pair.rho_j);
        pairs.separation * (by * pair.v_dot_r / under * (self.factor() * self.nu))
    }

    #[inline(always)]
    fn force<W: SimdFloat>(&self, pairs: &Batch<W, D>, _: &mut Scratch) -> Vector<W, D> {
        let (pair, smoothing) = (&pairs.pair, &self.medium.smoothing);
        let under = (pair.r2 + EPSILON * smoothing.h * smoothing.h) * (pair.rho_i + pair.rho_j);
        let strength = smoothing.dw_over_r(pair.r2.sqrt()) * pair.v_dot_r / under;
        pairs.separation * (strength * (self.factor() * self.nu))
    }

    #[inline(always)]
    fn slope<W: SimdFloat>(
        &self,
        pairs: &Batch<W, D>,
        _: &mut Scratch,
    ) -> CentralSlope<W, D, [W; 1]> {
        CentralSlope::new(pairs, &self.strength(pairs), [W::of(0.0); 2])
    }

    #[inline(always)]
    fn pullback<W: SimdFloat>(
        &self,
        pairs: &Batch<W, D>,
        force: Vector<W, D>,
        scratch: &mut Scratch,
    ) -> PairCotangent<W, D, [W; 1]> {
        self.slope(pairs, scratch).pullback(force)
    }
}
