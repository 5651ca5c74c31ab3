//! A cubic spline with equal intervals on `[0, 1]`, zero from 1 on.

use super::quadrature::gauss_legendre;
use crate::scalar::Tabulated;

/// Number of intervals of every spline: 16 KiB of coefficients.
pub(super) const INTERVALS: usize = 512;

/// The twice continuously differentiable piecewise cubic through values at equal distances. Its
/// slope is zero at 1, it is one cubic on the first two intervals ("not a knot"), and it is zero
/// from 1 on. It is a linear function of the values.
#[derive(Clone, Debug)]
pub(super) struct Spline {
    /// Coefficients of `1, t, t², t³` on each interval, with `t` from 0 to 1; a last piece of zeros
    /// for all arguments from 1 on.
    pieces: Vec<[f64; 4]>,
}

impl Spline {
    /// The spline through the values `of(k)` at `k/INTERVALS`.
    pub(super) fn through(of: impl Fn(usize) -> f64) -> Self {
        let knots: Vec<f64> = (0..=INTERVALS).map(of).collect();
        let rises: Vec<f64> = knots.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let slopes = slopes(&rises);
        let piece = |k: usize| {
            let (rise, [left, right]) = (rises[k], [slopes[k], slopes[k + 1]]);
            [knots[k], left, 3.0 * rise - 2.0 * left - right, left + right - 2.0 * rise]
        };
        Self { pieces: (0..INTERVALS).map(piece).chain([[0.0; 4]]).collect() }
    }

    /// `∫₀¹ qⁿ P(q²) dq` for `n` up to 3, exact: between two knots the integrand is a polynomial in
    /// `q` of degree `n + 6`, which five nodes integrate exactly.
    pub(super) fn moment(&self, n: i32) -> f64 {
        let rule = gauss_legendre(5);
        let knot = |k: usize| (k as f64 / INTERVALS as f64).sqrt();
        let interval = |k: usize| {
            let (start, width) = (knot(k), knot(k + 1) - knot(k));
            let at = |&[x, weight]: &[f64; 2]| {
                let q = start + width * x;
                let t = q * q * INTERVALS as f64 - k as f64;
                width * weight * q.powi(n) * derivative(&self.pieces[k], t, 0)
            };
            rule.iter().map(at).sum::<f64>()
        };
        (0..INTERVALS).map(interval).sum()
    }
}

/// Slopes at the knots, per interval, from the rises `dₖ` over the intervals:
/// `sₖ₋₁ + 4 sₖ + sₖ₊₁ = 3 (dₖ₋₁ + dₖ)` inside, `s₀ + 2 s₁ = (5 d₀ + d₁)/2` for one cubic on the
/// first two intervals, and zero at the end.
fn slopes(rises: &[f64]) -> Vec<f64> {
    let n = rises.len();
    let mut slopes = vec![0.0; n + 1];
    // Forward elimination, `sₖ + upper[k] sₖ₊₁ = slopes[k]`, then back substitution.
    let mut upper = vec![2.0; n];
    slopes[0] = 0.5 * (5.0 * rises[0] + rises[1]);
    for k in 1..n {
        let pivot = 1.0 / (4.0 - upper[k - 1]);
        upper[k] = pivot;
        slopes[k] = (3.0 * (rises[k - 1] + rises[k]) - slopes[k - 1]) * pivot;
    }
    for k in (0..n).rev() {
        slopes[k] -= upper[k] * slopes[k + 1];
    }
    slopes
}

/// Derivative of a piece by the argument of the spline.
#[inline(always)]
fn derivative([a, b, c, d]: &[f64; 4], t: f64, order: usize) -> f64 {
    const PER: f64 = INTERVALS as f64;
    match order {
        0 => ((d * t + c) * t + b) * t + a,
        1 => ((3.0 * d * t + 2.0 * c) * t + b) * PER,
        2 => (6.0 * d * t + 2.0 * c) * (PER * PER),
        3 => 6.0 * d * (PER * PER * PER),
        _ => 0.0,
    }
}

impl Tabulated for Spline {
    #[inline(always)]
    fn at<const N: usize>(&self, x: f64, order: usize) -> [f64; N] {
        let end = INTERVALS as f64;
        let place = if x * end > end { end } else { x * end };
        // NaN converts to index 0 and stays NaN in `t`.
        let k = (place as usize).min(INTERVALS);
        let (piece, t) = (&self.pieces[k], place - k as f64);
        let mut found = [0.0; N];
        for (step, found) in found.iter_mut().enumerate() {
            *found = derivative(piece, t, order + step);
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_that_ends_flat_is_its_own_spline() {
        let cubic = |x: f64| (1.0 - x) * (1.0 - x) * (2.0 + x);
        let spline = Spline::through(|k| cubic(k as f64 / INTERVALS as f64));
        for k in 0..1000 {
            let x = 0.000_999_7 * f64::from(k);
            let [value, slope, bend] = spline.at(x, 0);
            assert!((value - cubic(x)).abs() < 1e-14, "{x}");
            assert!((slope - 3.0 * (x * x - 1.0)).abs() < 1e-12, "{x}: {slope}");
            assert!((bend - 6.0 * x).abs() < 1e-9, "{x}: {bend}");
        }
    }

    #[test]
    fn moments_are_those_of_the_cubic() {
        let spline = Spline::through(|k| (1.0 - k as f64 / INTERVALS as f64).powi(3));
        // ∫ qⁿ (1 − q²)³ dq.
        for (n, exact) in [(0, 16.0 / 35.0), (1, 1.0 / 8.0), (2, 16.0 / 315.0)] {
            assert!((spline.moment(n) / exact - 1.0).abs() < 1e-13, "{n}: {}", spline.moment(n));
        }
    }

    #[test]
    fn two_derivatives_are_continuous_at_every_knot() {
        let spline =
            Spline::through(|k| (-5.0 * k as f64 / INTERVALS as f64).exp() * (k as f64).sin());
        for pair in spline.pieces[..INTERVALS].windows(2) {
            // The third derivative jumps by about the interval's length; each further derivative
            // costs a factor 512.
            for (order, bound) in [1e-14, 1e-11, 1e-8].into_iter().enumerate() {
                let [left, right] = [(&pair[0], 1.0), (&pair[1], 0.0)];
                let [left, right] = [left, right].map(|(piece, t)| derivative(piece, t, order));
                assert!((left - right).abs() < bound, "order {order}: {left} and {right}");
            }
        }
    }

    #[test]
    fn what_is_not_a_number_stays_so_and_infinity_is_beyond() {
        let spline = Spline::through(|k| 1.0 - k as f64 / INTERVALS as f64);
        assert!(spline.at::<1>(f64::NAN, 0)[0].is_nan());
        for x in [1.0, 1.5, 1e300, f64::INFINITY] {
            assert_eq!(spline.at::<4>(x, 0).map(f64::to_bits), [0; 4]);
        }
    }
}
