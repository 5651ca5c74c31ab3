//! Energy spectrum of the smoothed field: `E(k) = ½ Σ |û(κ)|²` over the shell `k − ½ ≤ |κ| < k + ½`, `k = 1, 2, …, n/2` with
//! the fewest nodes `n` along an axis, wavenumbers in units of `2π/L` of the longest side.

use super::{Seen, StateAdjoint, Statistic, TrueState, fields};
use crate::losses::Mesh;
use crate::vector::Vector;
use num_complex::Complex64;
use std::f64::consts::TAU;

/// `E(k)` by shell. Empty where an axis is open: a field without a period has no such modes.
#[derive(Clone, Copy, Debug)]
pub struct Spectrum;

/// The modes of a field: sums `û(κ) = N⁻¹ Σₓ u(x) e^{−iκ·x}` axis by axis, some `n^{D+1}` operations; a mesh of a loss
/// has few nodes.
struct Modes<'a, const D: usize> {
    mesh: &'a Mesh<D>,
    /// `e^{−2πij/n}`, axis by axis.
    waves: [Vec<Complex64>; D],
}

impl<'a, const D: usize> Modes<'a, D> {
    fn new(mesh: &'a Mesh<D>) -> Self {
        let wave = |n: usize| {
            (0..n).map(|j| Complex64::from_polar(1.0, -TAU * j as f64 / n as f64)).collect()
        };
        Self { mesh, waves: std::array::from_fn(|axis| wave(mesh.per_axis[axis])) }
    }

    /// Number of shells.
    fn shells(&self) -> usize {
        let periodic = (0..D).all(|axis| self.mesh.space.is_periodic(axis));
        let fewest = self.mesh.per_axis.iter().min().copied().unwrap_or(0);
        if periodic { fewest / 2 } else { 0 }
    }

    /// The shell of a mode, where it has one: `k` in place `k − 1`.
    fn shell(&self, mut index: usize) -> Option<usize> {
        let longest = self.mesh.space.longest::<D>();
        let mut square = 0.0;
        for (axis, &n) in self.mesh.per_axis.iter().enumerate() {
            let along = index % n;
            let kappa = along.min(n - along) as f64 * longest / self.mesh.space.side(axis);
            square += kappa * kappa;
            index /= n;
        }
        (square.sqrt().round() as usize).checked_sub(1).filter(|k| *k < self.shells())
    }

    /// The transform over all axes, without a factor; with `conjugate` the other sign of the exponent.
    fn transform(&self, mut values: Vec<Complex64>, conjugate: bool) -> Vec<Complex64> {
        for axis in 0..D {
            let (n, stride) = (self.mesh.per_axis[axis], self.mesh.stride(axis));
            let waves = &self.waves[axis];
            let mut line = vec![Complex64::default(); n];
            for first in (0..values.len()).filter(|index| index / stride % n == 0) {
                for (k, value) in line.iter_mut().enumerate() {
                    *value = values[first + k * stride];
                }
                for k in 0..n {
                    let term = |(j, x): (usize, &Complex64)| {
                        let wave = waves[j * k % n];
                        x * if conjugate { wave.conj() } else { wave }
                    };
                    values[first + k * stride] = line.iter().enumerate().map(term).sum();
                }
            }
        }
        values
    }

    /// `û` of one component.
    fn of(&self, field: &[Vector<f64, D>], axis: usize) -> Vec<Complex64> {
        let share = 1.0 / field.len() as f64;
        let component = field.iter().map(|u| Complex64::new(u[axis] * share, 0.0)).collect();
        self.transform(component, false)
    }

    fn spectrum(&self, field: &[Vector<f64, D>]) -> Vec<f64> {
        let mut energy = vec![0.0; self.shells()];
        for axis in 0..D {
            for (index, mode) in self.of(field, axis).iter().enumerate() {
                if let Some(k) = self.shell(index) {
                    energy[k] += 0.5 * mode.norm_sqr();
                }
            }
        }
        energy
    }
}

impl<const D: usize> Statistic<D> for Spectrum {
    fn name(&self) -> &'static str {
        "spectrum"
    }

    fn needs_field(&self) -> bool {
        true
    }

    fn of_truth(&self, truth: &TrueState<'_, D>) -> Vec<f64> {
        Modes::new(truth.mesh).spectrum(truth.field)
    }

    fn values(&self, seen: &Seen<'_, D>) -> Vec<f64> {
        Modes::new(&seen.observations.mesh).spectrum(&fields::predicted(seen))
    }

    /// `Σ_k c_k ∂E(k)/∂u(x) = N⁻¹ Σ_κ c_{k(κ)} û(κ) e^{iκ·x}`.
    fn pull_back(&self, seen: &Seen<'_, D>, cotangents: &[f64]) -> StateAdjoint<D> {
        let (mesh, field) = (&seen.observations.mesh, fields::predicted(seen));
        let modes = Modes::new(mesh);
        let share = 1.0 / field.len().max(1) as f64;
        let mut nodes = vec![Vector::zero(); field.len()];
        for axis in 0..D {
            let mut weighted = modes.of(&field, axis);
            for (index, mode) in weighted.iter_mut().enumerate() {
                *mode *= modes.shell(index).map_or(0.0, |k| share * cotangents[k]);
            }
            let back = modes.transform(weighted, true);
            nodes.iter_mut().zip(back).for_each(|(node, value)| node[axis] = value.re);
        }
        fields::pull_back(seen, &nodes)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(feature = "laboratory")]
    #[test]
    fn the_spectrum_is_that_of_the_fast_transform_to_round_off() {
        use rand::{RngExt, SeedableRng};
        let mut generator = rand_chacha::ChaCha8Rng::seed_from_u64(5);
        let mesh = Mesh::<3>::cube(2.0, 10);
        let mut component = || generator.random::<f64>() - 0.3;
        let field: Vec<Vector<f64, 3>> =
            (0..mesh.len()).map(|_| Vector(std::array::from_fn(|_| component()))).collect();
        let expected = crate::statistics::energy_spectrum(&mesh, &field);
        let found = Modes::new(&mesh).spectrum(&field);
        assert_eq!(found.len(), 5);
        for (found, expected) in found.iter().zip(&expected[1..]) {
            assert!((found - expected).abs() < 1e-14 * expected, "{found} {expected}");
        }
    }
}
