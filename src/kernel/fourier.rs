//! Fourier transforms of kernels, which decide whether particles pair up.
//!
//! If a kernel's transform is negative somewhere, particles with enough neighbours can lower their
//! energy by forming pairs (Dehnen & Aly, MNRAS 425, 1068 (2012)).

use super::Kernel;
use super::quadrature::gauss_legendre;
use crate::error::{Error, Result};
use std::f64::consts::{FRAC_PI_2, PI};

/// Depth of a negative lobe, relative to the transform at zero, up to which a kernel counts as
/// positive: a sixth of the depth for the cubic spline in three dimensions.
pub const DEEPEST_LOBE: f64 = 1e-4;

/// Largest `kh` searched: beyond it transforms only decay.
const SEARCHED: f64 = 20.0;

/// Number of values of `kh` tried: sixty per period `2π` of `2kh`.
const TRIED: usize = 400;

/// Quadrature nodes on each half of the support: at `kh = 20` a half holds three periods.
const NODES: usize = 64;

/// The minimum of a transform.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lobe {
    /// `Ŵ/Ŵ(0)` at the minimum, negative.
    pub depth: f64,
    /// `kh` of the minimum.
    pub kh: f64,
}

/// The Fourier transform of a kernel: `Ŵ(k) = 4π ∫ W r² sin(kr)/(kr) dr` in three dimensions,
/// `2π ∫ W r J₀(kr) dr` in two; a function of `kh`, without dimension.
///
/// Computed by Gauss–Legendre quadrature on both halves of the support. For the cubic spline it
/// agrees to `1e-12` with the analytic transform, for a table to the error of the table.
#[derive(Clone, Debug)]
pub struct Transform {
    dimension: usize,
    /// `q` with the weight `S qᵈ⁻¹ W hᵈ dq`.
    samples: Vec<[f64; 2]>,
}

impl Transform {
    /// The transform of a kernel in `dimension` 2 or 3.
    pub fn of<K: Kernel>(kernel: &K, dimension: usize) -> Self {
        let scale = kernel.normalisation(dimension);
        let sample = |q: f64, dq: f64| {
            let surface = if dimension == 2 { 2.0 * PI * q } else { 4.0 * PI * q * q };
            [q, surface * scale * kernel.value(q) * dq]
        };
        let rule = gauss_legendre(NODES);
        let half = |start: f64| rule.iter().map(move |[x, weight]| sample(start + x, *weight));
        Self { dimension, samples: half(0.0).chain(half(1.0)).collect() }
    }

    /// `Ŵ` at `kh`.
    pub fn at(&self, kh: f64) -> f64 {
        let wave = if self.dimension == 2 { bessel } else { sinc };
        self.samples.iter().map(|&[q, weight]| weight * wave(kh * q)).sum()
    }

    /// The deepest negative lobe up to `kh = 20`; none where the transform is positive.
    pub fn most_negative(&self) -> Option<Lobe> {
        let step = SEARCHED / TRIED as f64;
        let tried = (0..=TRIED).map(|k| k as f64 * step).map(|kh| (self.at(kh), kh));
        let (_, near) = tried.min_by(|a, b| a.0.total_cmp(&b.0))?;
        // There is one minimum within two steps: ternary search, by a third of the interval at a
        // time.
        let [mut low, mut high] = [near - step, near + step];
        while high - low > 1e-9 {
            let third = (high - low) / 3.0;
            let left_is_lower = self.at(low + third) < self.at(high - third);
            if left_is_lower { high -= third } else { low += third }
        }
        let kh = 0.5 * (low + high);
        let depth = self.at(kh) / self.at(0.0);
        (depth < 0.0).then_some(Lobe { depth, kh })
    }
}

/// Refuses a kernel with a negative lobe deeper than [`DEEPEST_LOBE`]; `place` names the kernel in
/// the error.
///
/// # Errors
/// [`Error::Input`], with depth and place of the lobe.
pub fn check_positive<K: Kernel>(place: &str, kernel: &K, dimension: usize) -> Result<()> {
    match Transform::of(kernel, dimension).most_negative() {
        Some(Lobe { depth, kh }) if depth < -DEEPEST_LOBE => Err(Error::input(
            place,
            format!(
                "a kernel that does not let particles pair up: its Fourier transform nowhere below \
                 {:e} of that at zero",
                -DEEPEST_LOBE
            ),
            format!("a lobe of {depth:.1e} at kh = {kh:.2}"),
            "choose other parameters, or leave out `positive`",
        )),
        _ => Ok(()),
    }
}

/// `sin x / x`.
fn sinc(x: f64) -> f64 {
    if x.abs() < 1e-8 { 1.0 } else { x.sin() / x }
}

/// `J₀(x) = 2/π ∫ cos(x sin θ) dθ` over the quarter circle, by the midpoint rule. The error of `n`
/// points is `J₄ₙ(x)`, which is below round-off if `4n` exceeds `x` by forty.
fn bessel(x: f64) -> f64 {
    let n = 12 + (x / 3.0) as usize;
    let angle = |k: usize| FRAC_PI_2 * (k as f64 + 0.5) / n as f64;
    (0..n).map(|k| (x * angle(k).sin()).cos()).sum::<f64>() / n as f64
}

#[cfg(test)]
mod tests {
    use super::super::{CubicSpline, KernelChoice, KernelTable, SHAPES, WendlandC2, WendlandC4};
    use super::*;

    #[test]
    fn bessel_function_has_its_tabulated_values() {
        // Abramowitz & Stegun, tables 9.1 and 9.5.
        for (x, value) in
            [(0.0, 1.0), (1.0, 0.765_197_686_557_966_6), (10.0, -0.245_935_764_451_348_3)]
        {
            assert!((bessel(x) - value).abs() < 1e-14, "{x}: {}", bessel(x));
        }
        for zero in [2.404_825_557_695_773, 5.520_078_110_286_311, 18.071_063_967_910_92] {
            assert!(bessel(zero).abs() < 1e-14, "{zero}: {}", bessel(zero));
        }
    }

    #[test]
    fn transform_of_the_cubic_spline_is_the_analytic_one() {
        // `4/k⁶ (18 − 24 cos k + 6 cos 2k − 6k sin k + 3k sin 2k)`, from ∫ (c−r)³ cos kr dr by parts.
        let transform = Transform::of(&CubicSpline, 3);
        for k in [1.0_f64, 3.0, 7.8, 15.0, 20.0] {
            let even = 18.0 - 24.0 * k.cos() + 6.0 * (2.0 * k).cos();
            let exact = 4.0 / k.powi(6) * (even + 3.0 * k * ((2.0 * k).sin() - 2.0 * k.sin()));
            assert!((transform.at(k) - exact).abs() < 1e-12, "{k}: {}", transform.at(k));
        }
    }

    /// Asserts place and depth of a kernel's deepest lobe, to the digits given.
    fn has_lobe(transform: &Transform, (depth, kh): (f64, f64)) {
        let lobe = transform.most_negative().unwrap();
        assert!((lobe.depth / depth - 1.0).abs() < 0.005, "{lobe:?}");
        assert!((lobe.kh - kh).abs() < 0.005, "{lobe:?}");
    }

    #[test]
    fn kernels_have_the_negative_lobes_that_are_known() {
        has_lobe(&Transform::of(&CubicSpline, 3), (-5.99e-4, 7.88));
        has_lobe(&Transform::of(&CubicSpline, 2), (-6.41e-4, 7.35));
        for dimension in [2, 3] {
            let none = |lobe: Option<Lobe>| assert_eq!(lobe, None, "{dimension}D");
            none(Transform::of(&WendlandC2, dimension).most_negative());
            none(Transform::of(&WendlandC4, dimension).most_negative());
        }
        let start = |name: &str, dimension: usize| {
            let kernel = KernelChoice::named(name).unwrap().in_dimension(dimension);
            Transform::of(&kernel, dimension)
        };
        has_lobe(&start("w-ab", 3), (-2.915e-2, 4.39));
        has_lobe(&start("w-ab", 2), (-4.644e-2, 4.04));
        has_lobe(&start("w-2", 3), (-3.19e-4, 5.62));
        has_lobe(&start("w-2", 2), (-5.39e-6, 14.97));
    }

    fn table(name: &str, parameters: [f64; 2]) -> KernelTable {
        SHAPES.iter().find(|shape| shape.name == name).unwrap().table(parameters, 3)
    }

    #[test]
    fn a_kernel_that_lets_particles_pair_up_is_refused_with_its_lobe() {
        let refused = |name: &str, parameters| {
            check_positive("fluid.kernel", &table(name, parameters), 3).unwrap_err().to_string()
        };
        let message = refused("w-ab", [2.932, 3.559]);
        assert!(message.contains("-2.9e-2 at kh = 4.39"), "{message}");
        assert!(message.contains("fluid.kernel") && message.contains("-1e-4"), "{message}");
        assert!(refused("w-2", [0.2, -0.9]).contains("-3.2e-4 at kh = 5.62"));
        for a in [2.0, 2.5, 4.0, 10.0] {
            for b in [2.0, 5.0, 10.0] {
                assert!(refused("w-ab", [a, b]).contains("kh"));
            }
        }
        check_positive("fluid.kernel", &table("w-2", [0.15, -0.95]), 3).unwrap();
        check_positive("fluid.kernel", &WendlandC2, 3).unwrap();
    }
}
