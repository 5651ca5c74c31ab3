//! The energy spectrum `E(k)` of a velocity field on a periodic mesh.

use crate::losses::Mesh;
use crate::vector::Vector;
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;

/// Kinetic energy per unit mass by wavenumber: `E(k) = ½ Σ |û(κ)|²` over the shell
/// `k − ½ ≤ |κ| < k + ½`, wavenumbers in units of `2π/L` of the longest axis, with
/// `û(κ) = N⁻¹ Σₓ u(x) e^{−iκ·x}` on `N` nodes.
///
/// Entry `k` is shell `k`; their sum is `½⟨|u|²⟩` (Parseval). Shells beyond half the nodes along an
/// axis are incomplete. Empty where an axis is open: a field without a period has no such modes.
pub fn energy_spectrum<const D: usize>(mesh: &Mesh<D>, field: &[Vector<f64, D>]) -> Vec<f64> {
    if (0..D).any(|axis| !mesh.space.is_periodic(axis)) {
        return Vec::new();
    }
    let unit = units(mesh);
    // The longest wave vector has n/2 along every axis.
    let square = |axis: usize| (mesh.per_axis[axis] as f64 * unit[axis]).powi(2);
    let shells = (0.5 * (0..D).map(square).sum::<f64>().sqrt()).round() as usize + 1;
    let mut energy = vec![0.0; shells];
    each_mode(mesh, field, |kappa, own| {
        let k = kappa.round() as usize;
        energy[k.min(shells - 1)] += own;
    });
    energy
}

/// Sums over the modes of a velocity field in a periodic box, wavenumbers in units of `2π/L` of the longest axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ModeSums {
    /// `½⟨|u − ū|²⟩`.
    pub(super) energy: f64,
    /// `½ Σ |κ|² |û|²`, half the mean square of the vorticity of an incompressible flow.
    pub(super) square_gradient: f64,
    /// `½ Σ |û|²/|κ|`, without the mean.
    pub(super) over_wavenumber: f64,
}

/// The sums of a velocity field.
pub(super) fn mode_sums<const D: usize>(mesh: &Mesh<D>, field: &[Vector<f64, D>]) -> ModeSums {
    let mut sums = ModeSums::default();
    each_mode(mesh, field, |kappa, own| {
        if kappa > 0.0 {
            sums.energy += own;
            sums.square_gradient += kappa * kappa * own;
            sums.over_wavenumber += own / kappa;
        }
    });
    sums
}

/// The wavenumber of the first mode along each axis, in units of `2π/L` of the longest.
fn units<const D: usize>(mesh: &Mesh<D>) -> [f64; D] {
    let longest = mesh.space.longest::<D>();
    std::array::from_fn(|axis| longest / mesh.space.side(axis))
}

/// Calls `each` with `|κ|` and `½|û_a|²` of every mode and component.
fn each_mode<const D: usize>(
    mesh: &Mesh<D>,
    field: &[Vector<f64, D>],
    mut each: impl FnMut(f64, f64),
) {
    let unit = units(mesh);
    let mut planner = FftPlanner::new();
    for axis in 0..D {
        let mut modes: Vec<Complex<f64>> =
            field.iter().map(|u| Complex::new(u[axis], 0.0)).collect();
        transform(mesh, &mut planner, &mut modes);
        for (index, mode) in modes.iter().enumerate() {
            each(wavenumber(mesh.per_axis, unit, index), 0.5 * mode.norm_sqr());
        }
    }
}

/// `|κ|` of the mode at an index, where the first mode along each axis has the wavenumber `unit`.
fn wavenumber<const D: usize>(per_axis: [usize; D], unit: [f64; D], mut index: usize) -> f64 {
    let mut square = 0.0;
    for (n, unit) in per_axis.into_iter().zip(unit) {
        let along = index % n;
        let kappa = along.min(n - along) as f64 * unit;
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
    for axis in 0..D {
        let (n, stride) = (mesh.per_axis[axis], mesh.stride(axis));
        let fft = planner.plan_fft_forward(n);
        let mut line = vec![Complex::default(); n];
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
        let mesh = Mesh::cube(std::f64::consts::TAU, 12);
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
    fn a_wave_along_a_short_axis_lies_in_the_shell_of_its_length_and_an_open_axis_has_no_modes() {
        use crate::space::{Axis, Space};
        let space = Space::new([2.0, 1.0], [Axis::Periodic; 2]);
        let mesh = Mesh::<2>::over(space, 16);
        assert_eq!(mesh.per_axis, [16, 8]);
        let at = |node| Vector([(std::f64::consts::TAU * 2.0 * mesh.node(node)[1]).sin(), 0.0]);
        let field: Vec<_> = (0..mesh.len()).map(at).collect();
        // Two periods in a side of one: four in the longest.
        for (k, energy) in energy_spectrum(&mesh, &field).iter().enumerate() {
            let expected = if k == 4 { 0.25 } else { 0.0 };
            assert!((energy - expected).abs() < 1e-14, "shell {k}: {energy}");
        }
        let open = Space::new([2.0, 1.0], [Axis::Periodic, Axis::Open]);
        assert!(energy_spectrum(&Mesh { space: open, ..mesh }, &field).is_empty());
    }

    #[test]
    fn the_shells_sum_to_the_kinetic_energy() {
        let mut generator = ChaCha8Rng::seed_from_u64(2);
        let mesh = Mesh::<3>::cube(1.7, 9);
        let mut component = || generator.random::<f64>() - 0.3;
        let field: Vec<Vector<f64, 3>> =
            (0..mesh.len()).map(|_| Vector(std::array::from_fn(|_| component()))).collect();
        let energy = field.iter().map(|u| 0.5 * u.norm_squared()).sum::<f64>() / mesh.len() as f64;
        let sum: f64 = energy_spectrum(&mesh, &field).iter().sum();
        assert!((sum - energy).abs() < 1e-13 * energy, "{sum} against {energy}");
    }
}
