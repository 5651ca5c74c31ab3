//! The kernel `W₂` of Woodward et al., Phys. Rev. Fluids 8, 054602 (2023).

use super::{LearnableShape, ShapeParameter};
use crate::scalar::Scalar;

/// `W₂ = σ (√(a²+1) − √(a²+q'²)) (1−q'²)² (1+b q'²)` with `q' = r/2h`.
///
/// `σ` is found by quadrature. Dimension `1/length^d`.
///
/// Source: Woodward et al., Phys. Rev. Fluids 8, 054602 (2023); the default values are those
/// learned there.
///
/// The tip is rounded over a width `2ha`: `a ≥ 0.1` keeps it wider than five intervals of the
/// table. `−1 ≤ b ≤ 2` keeps the kernel decreasing from the centre to the edge. In three dimensions
/// its Fourier transform has a minimum of `−3.2e-4` at `kh = 5.6` for the default values, and is
/// nowhere negative at `a = 0.15`, `b = −0.95`.
#[derive(Clone, Copy, Debug, Default)]
pub struct W2;

impl LearnableShape for W2 {
    const NAME: &'static str = "w-2";
    const PARAMETERS: [ShapeParameter; 2] = [
        ShapeParameter { name: "a", start: 0.2, range: [0.1, 10.0] },
        ShapeParameter { name: "b", start: -0.9, range: [-1.0, 2.0] },
    ];

    fn shape<T: Scalar>(q: T, [a, b]: &[T; 2]) -> T {
        let (a2, q2) = (*a * *a, q * q);
        let rest = -q2 + 1.0;
        ((a2 + 1.0).sqrt() - (a2 + q2).sqrt()) * rest * rest * (*b * q2 + 1.0)
    }
}
