//! Functions that are known piece by piece, evaluated at any [`Scalar`](super::Scalar).

use super::{Lanes, WIDTH};

/// A function of one argument that is looked up, with its derivatives: what
/// [`Scalar::tabulated`](super::Scalar::tabulated) evaluates.
pub trait Tabulated {
    /// `N` successive derivatives at `x`, first the one of the given order; the function itself is the
    /// one of order zero.
    fn at<const N: usize>(&self, x: f64, order: usize) -> [f64; N];

    /// The same at eight arguments. Never inlined: a loop over pairs that may meet a table at run time
    /// is then no longer than one that may not.
    #[cold]
    #[inline(never)]
    fn at_eight<const N: usize>(&self, x: &Lanes, order: usize) -> [Lanes; N] {
        let mut found = [Lanes::ZERO; N];
        for lane in 0..WIDTH {
            let derivatives = self.at::<N>(x.lane(lane), order);
            for (found, derivative) in found.iter_mut().zip(derivatives) {
                found.set_lane(lane, derivative);
            }
        }
        found
    }
}
