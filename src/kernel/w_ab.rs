//! The kernel `W_ab` of Woodward et al., Phys. Rev. Fluids 8, 054602 (2023).

use super::{LearnableShape, ShapeParameter};
use crate::scalar::Scalar;

/// Lower bound of a base of a power: below it the powers have underflowed to zero, while the
/// logarithms in the derivatives by the exponents stay finite.
const SMALLEST: f64 = 1e-100;

/// `W_ab = σ (1 − q'ᵃ)ᵇ` with `q' = r/2h`.
///
/// `σ₃ = 3Γ(b + 3/a + 1)/(32π h³ Γ(b+1) Γ(3/a+1))`, `σ₂ = Γ(b + 2/a + 1)/(4π h² Γ(b+1) Γ(2/a+1))`.
/// They are computed by quadrature, and compared with these formulas in `tests/kernel_tables.rs`.
/// Dimension `1/length^d`.
///
/// Source: Woodward et al., Phys. Rev. Fluids 8, 054602 (2023); the default values are those
/// learned there.
///
/// `a ≥ 2` keeps `W'(r)/r` finite at `r = 0`, `b ≥ 2` keeps its slope finite at the edge. If
/// `a < 4` is not an even number, the table's slope is least accurate at the centre, where `W` has
/// no fourth derivative. In three dimensions the minimum of its Fourier transform is `−2.9e-2` at
/// `kh = 4.4` for the default values, and `−3.8e-4` in the best case, `a = 2`, `b = 10`: `positive`
/// refuses all parameters.
#[derive(Clone, Copy, Debug, Default)]
pub struct WAb;

impl LearnableShape for WAb {
    const NAME: &'static str = "w-ab";
    const PARAMETERS: [ShapeParameter; 2] = [
        ShapeParameter { name: "a", start: 2.932, range: [2.0, 10.0] },
        ShapeParameter { name: "b", start: 3.559, range: [2.0, 10.0] },
    ];

    fn shape<T: Scalar>(q: T, [a, b]: &[T; 2]) -> T {
        let smallest = T::smallest(SMALLEST);
        let rest = -q.max(smallest).powf(*a) + 1.0;
        rest.max(smallest).powf(*b)
    }
}
