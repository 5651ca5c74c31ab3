//! Laminar viscosity along the velocity difference (Morris, Fox & Zhu 1997, J. Comput. Phys. 136, 214).

use super::{EPSILON, medium_and_nu};
use crate::models::{Constitutive, GeneralSlope, Medium, PairCotangent, PairLaw, Scratch};
use crate::pairs::Batch;
use crate::parameters::ParameterSpec;
use crate::scalar::SimdFloat;
use crate::vector::Vector;

/// `aᵢ = Σⱼ m 2ν rᵢⱼ·∇ᵢWᵢⱼ/(ρ̄ (r² + 0.01 h²)) vᵢⱼ`, `ν` the kinematic viscosity, `ρ̄ = (ρᵢ + ρⱼ)/2`.
///
/// The force is opposite for the two particles, so that linear momentum is conserved to round-off.
/// It is not central, so that angular momentum is not conserved.
#[derive(Clone, Debug)]
pub struct Morris<const D: usize> {
    medium: Medium<D>,
    nu: f64,
}

/// The weight `w` of a pair, `f = w vᵢⱼ`, with its derivatives.
struct Weight<W> {
    value: W,
    /// `2 ∂w/∂(r²)`.
    by_separation: W,
    /// `∂w/∂ρᵢ = ∂w/∂ρⱼ`.
    by_density: W,
    /// `∂w/∂ν`.
    by_nu: W,
}

impl<const D: usize> Morris<D> {
    /// With a viscosity `ν` in a fluid.
    pub fn new(medium: Medium<D>, nu: f64) -> Self {
        Self { medium, nu }
    }

    /// `w = 4 m ν G r²/((ρᵢ + ρⱼ)(r² + 0.01 h²))`.
    #[inline(always)]
    fn weight<W: SimdFloat>(&self, pairs: &Batch<W, D>) -> Weight<W> {
        let (pair, smoothing) = (&pairs.pair, &self.medium.smoothing);
        let [dw_over_r, d_dw_over_r] = smoothing.dw_derivatives(pair.r2.sqrt());
        let inverse = W::of(1.0) / (pair.r2 + EPSILON * smoothing.h * smoothing.h);
        let inverse_density = W::of(1.0) / (pair.rho_i + pair.rho_j);
        let scale = inverse * inverse_density * (4.0 * self.medium.mass);
        let by_nu = dw_over_r * pair.r2 * scale;
        let value = by_nu * self.nu;
        let bent = d_dw_over_r * pair.r2 + dw_over_r * (W::of(1.0) - pair.r2 * inverse) * 2.0;
        Weight {
            value,
            by_separation: bent * scale * self.nu,
            by_density: -(value * inverse_density),
            by_nu,
        }
    }
}

impl<const D: usize> Constitutive<D> for Morris<D> {
    medium_and_nu!("morris");
}

impl<const D: usize> PairLaw<D> for Morris<D> {
    type ByParameter<W: SimdFloat> = [W; 1];
    type Slope<W: SimdFloat> = GeneralSlope<W, D, 1>;

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
        pairs.velocity * (by * pair.r2 / under * (4.0 * self.medium.mass * self.nu))
    }

    #[inline(always)]
    fn force<W: SimdFloat>(&self, pairs: &Batch<W, D>, _: &mut Scratch) -> Vector<W, D> {
        let (pair, smoothing) = (&pairs.pair, &self.medium.smoothing);
        let under = (pair.r2 + EPSILON * smoothing.h * smoothing.h) * (pair.rho_i + pair.rho_j);
        let weight = smoothing.dw_over_r(pair.r2.sqrt()) * pair.r2 / under;
        pairs.velocity * (weight * (4.0 * self.medium.mass * self.nu))
    }

    #[inline(always)]
    fn slope<W: SimdFloat>(&self, pairs: &Batch<W, D>, _: &mut Scratch) -> GeneralSlope<W, D, 1> {
        let (weight, r, v) = (self.weight(pairs), pairs.separation, pairs.velocity);
        let mut slope = GeneralSlope::zero();
        for axis in 0..D {
            slope.by_separation[axis] = r * (weight.by_separation * v[axis]);
            slope.by_velocity[axis][axis] = weight.value;
        }
        slope.by_density = [v * weight.by_density; 2];
        slope.by_parameter = [v * weight.by_nu];
        slope
    }

    #[inline(always)]
    fn pullback<W: SimdFloat>(
        &self,
        pairs: &Batch<W, D>,
        force: Vector<W, D>,
        _: &mut Scratch,
    ) -> PairCotangent<W, D, [W; 1]> {
        let weight = self.weight(pairs);
        let along = force.dot(pairs.velocity);
        PairCotangent {
            separation: pairs.separation * (along * weight.by_separation),
            velocity: force * weight.value,
            p_over_rho2: [W::of(0.0); 2],
            density: [along * weight.by_density; 2],
            parameters: [along * weight.by_nu],
        }
    }
}
