//! Gauss–Legendre quadrature.

use std::f64::consts::PI;
use std::sync::LazyLock;

/// The quadrature rule for integrals of kernels, on `[0, 1]`: nodes with weights.
///
/// With `n` nodes, a shape that ends as `(1 − q')ᵇ` is integrated with an error of about
/// `n^(−2b−2)`: here less than `1e-12` for `b ≥ 2`.
pub(super) static RULE: LazyLock<Vec<[f64; 2]>> = LazyLock::new(|| gauss_legendre(128));

/// The rule of `n` nodes on `[0, 1]`, exact for polynomials of degree `2n − 1`: node and weight of each,
/// by Newton's method on the Legendre polynomial `Pₙ`.
pub(super) fn gauss_legendre(n: usize) -> Vec<[f64; 2]> {
    let node = |k: usize| {
        let mut x = -(PI * (k as f64 + 0.75) / (n as f64 + 0.5)).cos();
        // Newton's method converges quadratically from a guess with an error of 1/n³.
        for _ in 0..6 {
            let (value, slope) = legendre(n, x);
            x -= value / slope;
        }
        let (_, slope) = legendre(n, x);
        [0.5 * (1.0 + x), 1.0 / ((1.0 - x * x) * slope * slope)]
    };
    (0..n).map(node).collect()
}

/// `Pₙ(x)` and `Pₙ'(x)`, by the three-term recurrence.
fn legendre(n: usize, x: f64) -> (f64, f64) {
    let (mut before, mut value) = (1.0, x);
    for k in 2..=n {
        let k = k as f64;
        (before, value) = (value, ((2.0 * k - 1.0) * x * value - (k - 1.0) * before) / k);
    }
    (value, n as f64 * (x * value - before) / (x * x - 1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_up_to_the_degree_of_the_rule_are_integrated_exactly() {
        for degree in [0, 1, 2, 17, 100, 255] {
            let sum: f64 = RULE.iter().map(|[x, weight]| weight * x.powi(degree)).sum();
            let exact = 1.0 / f64::from(degree + 1);
            assert!((sum / exact - 1.0).abs() < 1e-13, "degree {degree}: {sum}");
        }
    }
}
