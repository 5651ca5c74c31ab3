//! Every kernel in both dimensions: normalisation, moments, derivatives, support.

use crate::common;

use common::in_2d_and_3d;
use whirls::kernel::{
    AnyKernel, CubicSpline, Kernel, KernelChoice, NAMES, Smoothing, WendlandC2, WendlandC4,
};
use whirls::scalar::{Dual, F64x8, Scalar, WIDTH};

in_2d_and_3d!(
    a_kernel_integrates_to_one,
    the_mean_place_under_a_kernel_is_its_centre,
    the_first_moment_of_its_gradient_is_minus_one,
    gradient_and_curvature_are_derivatives_of_the_kernel,
    slopes_at_once_are_gradient_and_curvature,
    a_kernel_is_finite_where_two_particles_meet,
    a_kernel_vanishes_from_two_smoothing_lengths_on,
    a_kernel_falls_everywhere_inside_its_support,
    lanes_give_the_bits_of_single_numbers,
);

const H: f64 = 0.7;

/// Runs a check on every kernel.
macro_rules! every_kernel {
    ($check:ident, $D:ident) => {
        $check("cubic-spline", &Smoothing::<CubicSpline, $D>::new(H));
        $check("wendland-c2", &Smoothing::<WendlandC2, $D>::new(H));
        $check("wendland-c4", &Smoothing::<WendlandC4, $D>::new(H));
        for name in NAMES {
            let kernel = KernelChoice::named(name).unwrap().in_dimension($D);
            $check(name, &Smoothing::<AnyKernel, $D>::of(kernel, H));
        }
    };
}

/// `∫₀^b f(r) dr` by Simpson's rule on the two pieces of which every kernel here is a polynomial, and
/// on one beyond the support.
fn integral(f: impl Fn(f64) -> f64) -> f64 {
    let piece = |a: f64, b: f64| {
        let n = 2000;
        let step = (b - a) / f64::from(n);
        let weight = |k: i32| {
            if k == 0 || k == n {
                1.0
            } else if k % 2 == 1 {
                4.0
            } else {
                2.0
            }
        };
        (0..=n).map(|k| weight(k) * f(a + f64::from(k) * step)).sum::<f64>() * step / 3.0
    };
    piece(0.0, H) + piece(H, 2.0 * H) + piece(2.0 * H, 2.5 * H)
}

/// Surface of the sphere of radius `r`.
fn surface<const D: usize>(r: f64) -> f64 {
    let pi = std::f64::consts::PI;
    if D == 2 { 2.0 * pi * r } else { 4.0 * pi * r * r }
}

/// Simpson's rule with a thousandth of the support leaves `(1/1000)⁴` of a polynomial. A table has a knot
/// between any two nodes, where its third derivative jumps.
fn quadrature<K: Kernel, const D: usize>(w: &Smoothing<K, D>) -> f64 {
    if w.kernel().parameters() == 0 { 1e-11 } else { 1e-8 }
}

fn a_kernel_integrates_to_one<const D: usize>() {
    fn check<K: Kernel, const D: usize>(name: &str, w: &Smoothing<K, D>) {
        let one = integral(|r| surface::<D>(r) * w.value(r));
        assert!((one - 1.0).abs() < quadrature(w), "{name}: {one}");
    }
    every_kernel!(check, D);
}

/// Sums over a mesh that is not symmetric around the kernel.
fn the_mean_place_under_a_kernel_is_its_centre<const D: usize>() {
    fn check<K: Kernel, const D: usize>(name: &str, w: &Smoothing<K, D>) {
        let nodes = if D == 2 { 400_i32 } else { 100 };
        let step = 4.4 * H / f64::from(nodes);
        let place = |k: i32| (f64::from(k) + 0.3) * step - 2.2 * H;
        let mut moment = [0.0; 3];
        for index in 0..nodes.pow(D as u32) {
            let x: [f64; 3] = std::array::from_fn(|axis| {
                if axis < D { place(index / nodes.pow(axis as u32) % nodes) } else { 0.0 }
            });
            let r = x.iter().map(|x| x * x).sum::<f64>().sqrt();
            let share = w.value(r) * step.powi(D as i32);
            (0..3).for_each(|axis| moment[axis] += x[axis] * share);
        }
        // The kernels have a continuous second derivative at least piecewise: a mesh of step s
        // sums them to (s/h)⁴.
        let bound = H * (step / H).powi(4);
        assert!(moment.iter().all(|m| m.abs() < bound), "{name}: {moment:?}, bound {bound:e}");
    }
    every_kernel!(check, D);
}

/// `∫ x ∂W/∂x dV = −1`, which makes a summed gradient of a linear field exact.
fn the_first_moment_of_its_gradient_is_minus_one<const D: usize>() {
    fn check<K: Kernel, const D: usize>(name: &str, w: &Smoothing<K, D>) {
        // ⟨x²⟩ over directions is r²/D, and ∂W/∂x = G x.
        let moment = integral(|r| surface::<D>(r) * w.dw_over_r(r) * r * r / D as f64);
        assert!((moment + 1.0).abs() < quadrature(w), "{name}: {moment}");
    }
    every_kernel!(check, D);
}

/// Places `q = r/h` of interest: the centre, both knots from either side, and many between.
fn places() -> Vec<f64> {
    let hair = 1e-9;
    let mut places = vec![1.0 - hair, 1.0, 1.0 + hair, 2.0 - hair, 2.0, 2.0 + hair, 2.5, hair];
    places.extend((1..200).map(|k| 0.0103 * f64::from(k)));
    places
}

fn gradient_and_curvature_are_derivatives_of_the_kernel<const D: usize>() {
    fn check<K: Kernel, const D: usize>(name: &str, w: &Smoothing<K, D>) {
        let scale = w.value(0.0) / H;
        for q in places() {
            let r = q * H;
            let variable = Dual::variable(r, 0, [0.0]);
            let (slope, bend) = (w.value(variable).gradient[0], w.dw_over_r(variable).gradient[0]);
            // A few roundings of the largest slope; the knots are rounded, too.
            let apart = (w.dw_over_r(r) * r - slope).abs();
            assert!(apart < 1e-14 * scale, "{name}: W'({q} h) off by {apart:e}");
            if (q - 1.0).abs() > 1e-8 {
                // Between the knots: at one the cubic spline's third derivative jumps.
                let apart = (w.d_dw_over_r(r) * r - bend).abs();
                assert!(apart < 1e-13 * scale / (H * r), "{name}: G'({q} h) off by {apart:e}");
            }
            // Differences as well, so that an error of dual numbers cannot hide one of the formula.
            let step = 3e-6 * H;
            if q > 1e-4 && (q - 1.0).abs() > 1e-4 && (q - 2.0).abs() > 1e-4 {
                let difference = (w.value(r + step) - w.value(r - step)) / (2.0 * step);
                let apart = (w.dw_over_r(r) * r - difference).abs();
                assert!(apart < 1e-9 * scale, "{name}: W'({q} h) is not {difference}");
                let difference = (w.dw_over_r(r + step) - w.dw_over_r(r - step)) / (2.0 * step);
                let apart = (w.d_dw_over_r(r) * r - difference).abs();
                assert!(apart < 1e-8 * scale / (H * H), "{name}: G'({q} h) is not {difference}");
            }
        }
    }
    every_kernel!(check, D);
}

fn a_kernel_is_finite_where_two_particles_meet<const D: usize>() {
    fn check<K: Kernel, const D: usize>(name: &str, w: &Smoothing<K, D>) {
        for r in [0.0, f64::MIN_POSITIVE, 1e-200, 1e-100, 1e-16] {
            let all = [w.value(r), w.dw_over_r(r), w.d_dw_over_r(r) * r, w.d_dw_over_r(r) * r * r];
            assert!(all.iter().all(|x| x.is_finite()), "{name} at {r:e}: {all:?}");
        }
        assert!(w.dw_over_r(0.0) < 0.0, "{name}");
        // The sensitivities use rᵢⱼ (H rᵢⱼ·δrᵢⱼ), which vanishes at the centre.
        assert_eq!((w.d_dw_over_r(0.0) * 0.0 * 0.0).abs().to_bits(), 0, "{name}");
    }
    every_kernel!(check, D);
}

fn a_kernel_vanishes_from_two_smoothing_lengths_on<const D: usize>() {
    fn check<K: Kernel, const D: usize>(name: &str, w: &Smoothing<K, D>) {
        let edge = w.support();
        for r in [edge, edge * (1.0 + f64::EPSILON), 3.0, 1e10, 1e150] {
            for value in [w.value(r), w.dw_over_r(r), w.d_dw_over_r(r)] {
                assert_eq!(value.abs().to_bits(), 0, "{name} at {r}: {value}");
            }
        }
        assert!(w.value(edge * (1.0 - 1e-3)) > 0.0, "{name}");
    }
    every_kernel!(check, D);
}

fn a_kernel_falls_everywhere_inside_its_support<const D: usize>() {
    fn check<K: Kernel, const D: usize>(name: &str, w: &Smoothing<K, D>) {
        for k in 0..1990 {
            let (r, next) = (0.001 * f64::from(k) * H, 0.001 * f64::from(k + 1) * H);
            assert!(w.value(next) < w.value(r) && w.dw_over_r(next) < 0.0, "{name} at {r}");
        }
    }
    every_kernel!(check, D);
}

fn lanes_give_the_bits_of_single_numbers<const D: usize>() {
    fn check<K: Kernel, const D: usize>(name: &str, w: &Smoothing<K, D>) {
        for eight in places().chunks_exact(WIDTH) {
            let r: [f64; WIDTH] = std::array::from_fn(|lane| eight[lane] * H);
            let lanes = F64x8::new(r);
            let bits = |lanes: F64x8| lanes.to_array().map(f64::to_bits);
            assert_eq!(bits(w.value(lanes)), r.map(|r| w.value(r).to_bits()), "{name}");
            assert_eq!(bits(w.dw_over_r(lanes)), r.map(|r| w.dw_over_r(r).to_bits()), "{name}");
            assert_eq!(bits(w.d_dw_over_r(lanes)), r.map(|r| w.d_dw_over_r(r).to_bits()), "{name}");
            let back = F64x8::of(r[0]).to_array();
            assert_eq!(back.map(f64::to_bits), [r[0].to_bits(); WIDTH]);
        }
    }
    every_kernel!(check, D);
}

fn slopes_at_once_are_gradient_and_curvature<const D: usize>() {
    fn check<K: Kernel, const D: usize>(name: &str, w: &Smoothing<K, D>) {
        for k in 0..60 {
            let r = 0.04 * f64::from(k) * H;
            let [gradient, curvature] = w.dw_derivatives(r);
            let near = |a: f64, b: f64| (a - b).abs() <= 1e-14 * a.abs().max(1e-300);
            assert!(near(w.dw_over_r(r), gradient), "{name} at {r}");
            assert!(near(w.d_dw_over_r(r), curvature), "{name} at {r}");
        }
    }
    every_kernel!(check, D);
}
