//! The equation of state, Eq. (20).
//!
//! Equation numbers are those of Woodward et al., arXiv:2110.13311: see `docs/equations.md`.

use crate::scalar::{F64x8, Scalar, WIDTH};

/// Tait's pressure `P = (c² ρ₀/γ) [(ρ/ρ₀)^γ − 1]`, Eq. (20), with `ρ₀ = 1`.
///
/// Weakly compressible: the sound speed at `ρ₀` is `c`, and the pressure becomes negative below
/// `ρ₀`.
#[inline(always)]
pub fn tait<T: Scalar>(rho: T, c: T, gamma: T) -> T {
    c * c / gamma * (rho.powf(gamma) - 1.0)
}

/// The function of pressure in the force on a pair, `P/ρ²`.
#[inline(always)]
pub fn p_over_rho2<T: Scalar>(pressure: T, rho: T) -> T {
    pressure / (rho * rho)
}

/// `A = P/ρ²` of Tait's fluid with background pressure `p₀`, for eight particles. Where `γ` is a
/// whole number, powers are computed as products.
pub fn tait_p_over_rho2(rho: F64x8, c: f64, gamma: f64, p0: f64) -> F64x8 {
    let power = match whole(gamma) {
        Some(gamma) => power(rho, gamma),
        None => rho.powf(F64x8::of(gamma)),
    };
    let pressure = (power - 1.0) * (c * c / gamma);
    let pressure = if p0 == 0.0 { pressure } else { pressure + p0 };
    pressure / (rho * rho)
}

/// The gradient of `A = P/ρ²` of Tait's fluid by `(ρ, c, γ)`, from `ln ρ` and `ρ^γ`. It is written
/// by hand and evaluates no power of its own; a test compares it with [`crate::scalar::Dual`]
/// numbers.
#[inline(always)]
pub fn tait_p_over_rho2_gradient<T: Scalar>(
    (rho, logarithm, power): (T, T, T),
    c: f64,
    gamma: f64,
) -> [T; 3] {
    let inverse = T::of(1.0) / rho;
    let (square, stiffness) = (inverse * inverse, c * c / gamma);
    let compression = power - 1.0;
    [
        (power * gamma - compression * 2.0) * (square * inverse) * stiffness,
        compression * square * (2.0 * c / gamma),
        (power * logarithm - compression * (1.0 / gamma)) * square * stiffness,
    ]
}

/// Specific internal energy of Tait's fluid, `e(ρ) = ∫ P/ρ² dρ` from `ρ₀ = 1`:
/// `e = (c²/γ) [ρ^(γ−1)/(γ−1) + 1/ρ − γ/(γ−1)]`, and `c² (ln ρ + 1/ρ − 1)` where `γ = 1`.
pub fn internal_energy(rho: f64, c: f64, gamma: f64) -> f64 {
    let compression = gamma - 1.0;
    // (ρ^(γ−1) − 1)/(γ−1), which is ln ρ in the limit γ = 1.
    let logarithm = if compression.abs() < 1e-12 {
        rho.ln()
    } else {
        (compression * rho.ln()).exp_m1() / compression
    };
    c * c / gamma * (logarithm + 1.0 / rho - 1.0)
}

/// `Σ e(ρ)` over particles. Where `γ` is a whole number, powers are computed as products, eight
/// particles at once.
pub(crate) fn internal_energies(mut rho: impl Iterator<Item = f64>, c: f64, gamma: f64) -> f64 {
    let Some(exponent) = whole(gamma - 1.0).filter(|&exponent| exponent > 0) else {
        return rho.map(|rho| internal_energy(rho, c, gamma)).sum();
    };
    let compression = f64::from(exponent);
    let energy =
        |rho: F64x8| (power(rho, exponent) - 1.0) / compression + (F64x8::of(1.0) / rho - 1.0);
    let mut sum = F64x8::ZERO;
    while let Some(first) = rho.next() {
        // Unused lanes are at `ρ₀`, where the energy is zero.
        let mut lanes = [1.0; WIDTH];
        lanes[0] = first;
        lanes[1..].iter_mut().zip(&mut rho).for_each(|(lane, rho)| *lane = rho);
        sum += energy(F64x8::new(lanes));
    }
    c * c / gamma * sum.sum()
}

/// Exponent, maximum, up to which a power is computed as a product.
const MOST_PRODUCTS: f64 = 64.0;

/// The exponent as a whole number, if the power is computed as a product.
fn whole(power: f64) -> Option<u32> {
    let whole = power.clamp(0.0, MOST_PRODUCTS) as u32;
    (f64::from(whole).to_bits() == power.to_bits()).then_some(whole)
}

/// `xⁿ` by squaring.
#[inline(always)]
fn power(x: F64x8, mut n: u32) -> F64x8 {
    let (mut result, mut square) = (F64x8::of(1.0), x);
    while n > 0 {
        if n % 2 == 1 {
            result = result * square;
        }
        square = square * square;
        n /= 2;
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Dual;

    #[test]
    fn energy_is_the_integral_of_pressure_over_density_squared() {
        for gamma in [1.0, 1.4, 7.0] {
            for rho in [0.7, 0.95, 1.0, 1.3] {
                let step = 1e-5;
                let slope = (internal_energy(rho + step, 3.0, gamma)
                    - internal_energy(rho - step, 3.0, gamma))
                    / (2.0 * step);
                let expected = p_over_rho2(tait(rho, 3.0, gamma), rho);
                assert!((slope - expected).abs() < 1e-8 * (1.0 + expected.abs()));
            }
        }
    }

    #[test]
    fn a_whole_power_gives_the_p_over_rho2_of_the_power_function() {
        for gamma in [1.0, 2.0, 6.999, 7.0, 64.0, 65.0] {
            for rho in [0.0, 0.3, 0.95, 1.0, 1.0 + 1e-9, 1.3, 40.0] {
                let expected = p_over_rho2(tait(rho, 3.0, gamma), rho);
                let found = tait_p_over_rho2(F64x8::of(rho), 3.0, gamma, 0.0).to_array()[5];
                // The relative error of the power is one rounding for each of its products.
                let bound = 2.0 * gamma * f64::EPSILON * (expected.abs() + 9.0 / (rho * rho));
                let same = found.to_bits() == expected.to_bits();
                assert!(same || (found - expected).abs() <= bound, "{gamma} {rho} {found:e}");
            }
        }
    }

    #[test]
    fn the_sum_of_energies_is_the_energy_summed() {
        for gamma in [1.0, 1.4, 2.0, 6.93, 7.0, 500.0] {
            let rho = || (0..21).map(|k| 0.9 + 0.01 * f64::from(k));
            let expected: f64 = rho().map(|rho| internal_energy(rho, 3.0, gamma)).sum();
            let found = internal_energies(rho(), 3.0, gamma);
            assert!((found - expected).abs() < 1e-13 * (1.0 + expected), "{gamma}: {found}");
        }
    }

    #[test]
    fn the_gradient_by_hand_is_the_gradient_by_dual_numbers() {
        let variable = |x, index| Dual::<f64, 3>::variable(x, index, [0.0; 3]);
        for (c, gamma) in [(10.0, 7.0), (0.7, 1.0), (-3.0, 1.4), (0.0, 7.0)] {
            for rho in [0.3_f64, 0.97, 1.0, 1.02, 2.5] {
                let (r, by_c, by_gamma) = (variable(rho, 0), variable(c, 1), variable(gamma, 2));
                let exact = p_over_rho2(tait(r, by_c, by_gamma), r).gradient;
                let found = tait_p_over_rho2_gradient((rho, rho.ln(), rho.powf(gamma)), c, gamma);
                let size = 1.0 + exact.iter().fold(0.0_f64, |size, x| size.max(x.abs()));
                for (exact, found) in exact.into_iter().zip(found) {
                    assert!((exact - found).abs() < 1e-14 * size, "{exact} {found}");
                }
            }
        }
    }

    #[test]
    fn the_slope_of_pressure_at_reference_density_is_the_sound_speed_squared() {
        let slope = (tait(1.0 + 1e-6, 10.0, 7.0) - tait(1.0 - 1e-6, 10.0, 7.0)) / 2e-6;
        assert!((slope - 100.0).abs() < 1e-6);
    }
}
