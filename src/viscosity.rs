//! Monaghan's artificial viscosity, Eq. (21).
//!
//! Equation numbers are those of Woodward et al., arXiv:2110.13311: see `docs/equations.md`.

use crate::pairs::Pair;
use crate::scalar::Scalar;

/// Regularisation `ε` of Eq. (21), in units of `h²`: keeps `μ` finite where two particles coincide.
const EPSILON: f64 = 0.01;

/// The kinematic viscosity `ν` with which `α` of Eq. (21) acts on shear, from `α c h` and the smoothing length in
/// particle spacings.
///
/// It is measured: the force of `Π` on a shear wave of one wavelength, in the arrangement that the particles of the shipped
/// flows have taken (`tests/first_hour.rs`, `alpha_acts_on_a_shear_wave_with_the_viscosity_of_the_table`). The last rows are
/// the integral over many neighbours, `αch/4(d+2)` without the `0.01 h²` of Eq. (21): half of `αch/2(d+2)` (Monaghan 2005,
/// doi:10.1088/0034-4885/68/8/R01), because only pairs that approach contribute. Between the rows it is interpolated, beyond
/// them constant.
///
/// | dimension | `h/Δx` | `ν/(αch)` |
/// |---|---|---|
/// | 3 | 0.853 | 0.044 |
/// | 3 | 1.2 | 0.0475 |
/// | 3 | 2 | 0.0495 |
/// | 2 | 1.02 | 0.060 |
/// | 2 | 1.3 | 0.061 |
/// | 2 | 2 | 0.0615 |
///
/// A flow dissipates more than this: `β` adds `β h |v|` beside `α c h`, and so does the disorder of the particles. Vortices
/// that begin on a lattice decay 1.0 to 1.7 times as fast, the more so the fewer the neighbours.
pub fn effective_nu(dimension: usize, h_over_spacing: f64, alpha_c_h: f64) -> f64 {
    let table = if dimension == 3 { EFFECTIVE_3D } else { EFFECTIVE_2D };
    let after = table.partition_point(|(ratio, _)| *ratio < h_over_spacing);
    let share = match (after.checked_sub(1).map(|before| table[before]), table.get(after)) {
        (Some((low, a)), Some((high, b))) => a + (b - a) * (h_over_spacing - low) / (high - low),
        (None, Some((_, first))) => *first,
        (Some((_, last)), None) => last,
        (None, None) => 0.0,
    };
    share * alpha_c_h
}

/// `(h/Δx, ν/(αch))` in three dimensions.
const EFFECTIVE_3D: [(f64, f64); 3] = [(0.853, 0.044), (1.2, 0.0475), (2.0, 0.0495)];

/// The same in two dimensions.
const EFFECTIVE_2D: [(f64, f64); 3] = [(1.02, 0.06), (1.3, 0.061), (2.0, 0.0615)];

/// The coefficients of the viscosity: `α` (bulk and shear), `β` (shocks) and the sound speed `c`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Viscosity<T> {
    /// Sound speed.
    pub c: T,
    /// Coefficient of the term linear in the velocity difference.
    pub alpha: T,
    /// Coefficient of the quadratic (von Neumann–Richtmyer) term.
    pub beta: T,
}

/// `Πᵢⱼ = (−α c μ + β μ²)/ρ̄`, Eq. (21), while the pair approaches, and zero while it recedes;
/// `μ = h vᵢⱼ·rᵢⱼ/(r² + 0.01 h²)`, `ρ̄ = (ρᵢ + ρⱼ)/2`.
///
/// The force acts along `rᵢⱼ`, so that it conserves linear and angular momentum, and it only
/// dissipates energy (`tests/conservation.rs`). It is continuous but not smooth at `vᵢⱼ·rᵢⱼ = 0`,
/// where gradients are one-sided.
#[inline(always)]
pub fn monaghan<T: Scalar>(pair: &Pair<T>, h: f64, by: &Viscosity<T>) -> T {
    // With μ = a/s multiplied out: one division instead of two.
    let a = pair.v_dot_r.min(T::of(0.0)) * h;
    let s = pair.r2 + EPSILON * h * h;
    (by.beta * a - by.alpha * by.c * s) * a / (s * s * pair.mean_density())
}

/// The gradient of [`monaghan`] written by hand, at a third of the cost of [`crate::scalar::Dual`]
/// numbers; a test compares the two.
#[derive(Clone, Copy, Debug)]
pub struct ViscosityGradient<T> {
    /// `Π`.
    pub value: T,
    /// `∂Π/∂(r²)`.
    pub by_r2: T,
    /// `∂Π/∂(v·r)`.
    pub by_v_dot_r: T,
    /// `∂Π/∂ρᵢ = ∂Π/∂ρⱼ`.
    pub by_density: T,
    /// `∂Π/∂(c, α, β)`.
    pub by: Viscosity<T>,
    /// `μ/ρ̄`, a factor of these derivatives.
    pub linear: T,
    /// `μ`.
    pub mu: T,
}

/// `Π` of Eq. (21) and its derivatives by all its arguments.
#[inline(always)]
pub fn monaghan_gradient<T: Scalar>(
    pair: &Pair<T>,
    h: f64,
    by: &Viscosity<T>,
) -> ViscosityGradient<T> {
    let zero = T::of(0.0);
    let (s, rho) = (pair.r2 + EPSILON * h * h, pair.mean_density());
    let both = T::of(1.0) / (s * rho);
    let (softened, inverse_density) = (both * rho * h, both * s);
    let mu = pair.v_dot_r.min(zero) * softened;
    let linear = mu * inverse_density;
    let value = (by.beta * mu - by.alpha * by.c) * linear;
    let by_mu = (by.beta * mu * 2.0 - by.alpha * by.c) * inverse_density;
    let by_v_dot_r = T::select_less(pair.v_dot_r, zero, by_mu * softened, zero);
    ViscosityGradient {
        value,
        by_r2: by_v_dot_r * mu * (-1.0 / h),
        by_v_dot_r,
        by_density: value * inverse_density * -0.5,
        by: Viscosity { c: -(by.alpha * linear), alpha: -(by.c * linear), beta: mu * linear },
        linear,
        mu,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Dual;

    #[test]
    fn gradient_by_hand_is_the_gradient_by_dual_numbers() {
        for v_dot_r in [-0.8, -1e-9, 0.3] {
            let x = [0.5, v_dot_r, 1.1, 0.9, 10.0, 1.0, 2.0];
            let d: [Dual<f64, 7>; 7] = std::array::from_fn(|k| Dual::variable(x[k], k, [0.0; 7]));
            let dual = monaghan(
                &Pair { r2: d[0], v_dot_r: d[1], rho_i: d[2], rho_j: d[3] },
                0.3,
                &Viscosity { c: d[4], alpha: d[5], beta: d[6] },
            );
            let hand = monaghan_gradient(
                &Pair { r2: x[0], v_dot_r: x[1], rho_i: x[2], rho_j: x[3] },
                0.3,
                &Viscosity { c: x[4], alpha: x[5], beta: x[6] },
            );
            let g = hand;
            let by_hand =
                [g.by_r2, g.by_v_dot_r, g.by_density, g.by_density, g.by.c, g.by.alpha, g.by.beta];
            assert!((hand.value - dual.value).abs() < 1e-15);
            for (a, b) in by_hand.iter().zip(dual.gradient) {
                assert!((a - b).abs() <= 1e-14 * (1.0 + b.abs()), "{a} against {b}");
            }
        }
    }
}
