//! The energy spectrum `E(k)` of a velocity field on a periodic mesh.

use crate::losses::Mesh;
use crate::vector::Vector;
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;

/// Kinetic energy per unit mass by wavenumber: `E(k) = ½ Σ |û(κ)|²` over the shell
/// `k − ½ ≤ |κ| < k + ½`, wavenumbers in units of `2π/L`, with
/// `û(κ) = n⁻ᴰ Σₓ u(x) e^{−iκ·x}` on `nᴰ` nodes.
///
/// Entry `k` is shell `k`; their sum is `½⟨|u|²⟩` (Parseval). Shells beyond `n/2` are incomplete.
pub fn energy_spectrum<const D: usize>(mesh: &Mesh<D>, field: &[Vector<f64, D>]) -> Vec<f64> {
    let n = mesh.per_axis;
    // The longest wave vector has n/2 along every axis.
    let shells = (0.5 * n as f64 * (D as f64).sqrt()).round() as usize + 1;
    let mut energy = vec![0.0; shells];
    let mut planner = FftPlanner::new();
    for axis in 0..D {
        let mut modes: Vec<Complex<f64>> =
            field.iter().map(|u| Complex::new(u[axis], 0.0)).collect();
        transform(mesh, &mut planner, &mut modes);
        for (index, mode) in modes.iter().enumerate() {
            let k = wavenumber::<D>(n, index).round() as usize;
            energy[k.min(shells - 1)] += 0.5 * mode.norm_sqr();
        }
    }
    energy
}

/// `|κ|` of the mode at an index.
fn wavenumber<const D: usize>(n: usize, mut index: usize) -> f64 {
    let mut square = 0.0;
    for _ in 0..D {
        let along = index % n;
        let kappa = along.min(n - along) as f64;
        square += kappa * kappa;
        index /= n;
    }
    square.sqrt()
}

/// The transform over all axes, in place, normalised.
fn transform<const D: usize>(
    mesh: &Mesh<D>,
    planner: &mut FftPlanner<f64>,
    modes: &mut [Complex<f64>],
) {
    let n = mesh.per_axis;
    let fft = planner.plan_fft_forward(n);
    let mut line = vec![Complex::default(); n];
    for axis in 0..D {
        let stride = n.pow(axis as u32);
        for first in (0..modes.len()).filter(|index| (index / stride).is_multiple_of(n)) {
            for (k, value) in line.iter_mut().enumerate() {
                *value = modes[first + k * stride];
            }
            fft.process(&mut line);
            for (k, value) in line.iter().enumerate() {
                modes[first + k * stride] = *value;
            }
        }
    }
    let scale = 1.0 / modes.len() as f64;
    modes.iter_mut().for_each(|mode| *mode *= scale);
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn wave<const D: usize>(kappa: [f64; D]) -> (Mesh<D>, Vec<Vector<f64, D>>) {
        let mesh = Mesh { per_axis: 12, length: std::f64::consts::TAU };
        let at = |node: usize| {
            let angle = Vector(kappa).dot(mesh.node(node));
            let mut u = Vector::zero();
            (u[0], u[1]) = (0.6 * angle.sin(), 0.8 * angle.sin());
            u
        };
        (mesh, (0..mesh.len()).map(at).collect())
    }

    #[test]
    fn a_single_wave_has_all_its_energy_in_its_shell() {
        let (mesh, field) = wave([3.0, 0.0]);
        let flat = energy_spectrum(&mesh, &field);
        let (mesh, field) = wave([2.0, 2.0, 1.0]);
        let deep = energy_spectrum(&mesh, &field);
        for spectrum in [flat, deep] {
            // ½ ⟨sin²⟩ of unit amplitude, at |κ| = 3.
            for (k, energy) in spectrum.iter().enumerate() {
                let expected = if k == 3 { 0.25 } else { 0.0 };
                assert!((energy - expected).abs() < 1e-14, "shell {k}: {energy}");
            }
        }
    }

    #[test]
    fn the_shells_sum_to_the_kinetic_energy() {
        let mut generator = ChaCha8Rng::seed_from_u64(2);
        let mesh = Mesh::<3> { per_axis: 9, length: 1.7 };
        let mut component = || generator.random::<f64>() - 0.3;
        let field: Vec<Vector<f64, 3>> =
            (0..mesh.len()).map(|_| Vector(std::array::from_fn(|_| component()))).collect();
        let energy = field.iter().map(|u| 0.5 * u.norm_squared()).sum::<f64>() / mesh.len() as f64;
        let sum: f64 = energy_spectrum(&mesh, &field).iter().sum();
        assert!((sum - energy).abs() < 1e-13 * energy, "{sum} against {energy}");
    }
}
