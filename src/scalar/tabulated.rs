//! Tabulated functions, evaluated at any [`Scalar`](super::Scalar).

use super::{F64x8, WIDTH};

/// A tabulated function of one argument with its derivatives, which
/// [`Scalar::tabulated`](super::Scalar::tabulated) evaluates.
pub trait Tabulated {
    /// `N` successive derivatives at `x`, from the given order on; order zero is the function
    /// itself.
    fn at<const N: usize>(&self, x: f64, order: usize) -> [f64; N];

    /// The same at eight arguments. It is never inlined, so that the lookup adds no code to a pair
    /// loop that may evaluate a table.
    #[cold]
    #[inline(never)]
    fn at_eight<const N: usize>(&self, x: &F64x8, order: usize) -> [F64x8; N] {
        let mut found = [F64x8::ZERO; N];
        for lane in 0..WIDTH {
            let derivatives = self.at::<N>(x.lane(lane), order);
            for (found, derivative) in found.iter_mut().zip(derivatives) {
                found.set_lane(lane, derivative);
            }
        }
        found
    }
}
