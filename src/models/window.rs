//! The cutoff at `2h` of pair terms that have no kernel.

use crate::scalar::Scalar;

/// The factor on a pair term: one at zero distance, zero at the end of the support.
///
/// | window | recommended | price |
/// |---|---|---|
/// | smooth, `w = (1 − r²/4h²)₊²` | yes, default | the network must compensate for `w` inside the support |
/// | sharp, `w = 1` inside | to compare with published networks | the force jumps where a neighbour enters the support, and no gradient contains the jump |
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Window {
    /// `4h²`.
    support2: f64,
    smooth: bool,
}

impl Window {
    /// The window of a support `2h`.
    pub fn new(h: f64, smooth: bool) -> Self {
        Self { support2: 4.0 * h * h, smooth }
    }

    /// `w` and `2 ∂w/∂(r²)`, so that `δw` is the second times `r·δr`.
    #[inline(always)]
    pub fn at<T: Scalar>(&self, r2: T) -> (T, T) {
        let zero = T::of(0.0);
        if self.smooth {
            let inside = (r2 * (-1.0 / self.support2) + 1.0).max(zero);
            (inside * inside, inside * (-4.0 / self.support2))
        } else {
            (T::select_less(r2, T::of(self.support2), T::of(1.0), zero), zero)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Dual;

    #[test]
    fn the_smooth_window_ends_without_a_jump_in_value_or_slope() {
        let window = Window::new(0.5, true);
        for r2 in [0.0, 0.3, 0.9, 0.999_999, 1.0, 1.5] {
            let (value, slope) = window.at(r2);
            let dual = window.at(Dual::variable(r2, 0, [0.0])).0;
            assert!((dual.value - value).abs() < 1e-15);
            assert!((2.0 * dual.gradient[0] - slope).abs() < 1e-12);
        }
        let (value, slope) = window.at(1.0 - 1e-9);
        assert!(value < 1e-15 && slope.abs() < 1e-8);
        let sharp = Window::new(0.5, false);
        assert!((sharp.at(0.99).0 - 1.0_f64).abs() < 1e-15 && sharp.at(1.0).0.abs() < 1e-15);
    }
}
