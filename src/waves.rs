//! Plane waves in a periodic box: fields that are sums of a few Fourier modes, exact at any
//! position.
//!
//! `u(x) = Σ a cos(κ·x) + b sin(κ·x)` with wave vectors `κ = 2π (n_x/L_x, n_y/L_y, …)` of integers `n`. A
//! wave with `a ⟂ κ` and `b ⟂ κ` has zero divergence. The sum costs six to eight nanoseconds per wave and
//! position: powers of `e^{ikx}` along each axis are multiplied up once per position, so that no
//! wave needs a sine of its own.

use crate::scalar::F64x8;
use crate::space::Space;
use crate::vector::Vector;
use num_complex::Complex;

/// Component of a wave vector, maximum.
pub const LONGEST: usize = 64;

/// One wave, `a cos(κ·x) + b sin(κ·x)`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wave {
    /// Integer wave vector `n`; its third component is 0 in two dimensions.
    pub n: [i32; 3],
    /// Amplitude `a` of the cosine.
    pub cosine: [f64; 3],
    /// Amplitude `b` of the sine.
    pub sine: [f64; 3],
}

/// A sum of waves in a box.
#[derive(Clone, Debug, PartialEq)]
pub struct Waves {
    /// `2π/L` of each axis.
    k: [f64; 3],
    longest: usize,
    pub(crate) list: Vec<Wave>,
}

/// Integer wave vectors with `0 < |n| <= longest`, one of each pair `±n`, shortest first, so that a
/// longer list begins with a shorter one. No component is larger than [`LONGEST`].
pub fn wave_vectors(dimension: usize, longest: f64) -> Vec<[i32; 3]> {
    let reach = longest.clamp(0.0, LONGEST as f64) as i32;
    let depth = if dimension == 3 { reach } else { 0 };
    let square = |n: &[i32; 3]| n.iter().map(|x| x * x).sum::<i32>();
    let positive = |n: &[i32; 3]| n.iter().rev().find(|&&x| x != 0).is_some_and(|&x| x > 0);
    let columns = (-depth..=depth).flat_map(|z| (-reach..=reach).map(move |y| (y, z)));
    let lattice = columns.flat_map(|(y, z)| (-reach..=reach).map(move |x| [x, y, z]));
    let inside = |n: &[i32; 3]| f64::from(square(n)) <= longest * longest;
    let mut all: Vec<[i32; 3]> = lattice.filter(|n| positive(n) && inside(n)).collect();
    all.sort_by_key(square);
    all
}

/// `2π/L` of each axis.
pub fn wave_numbers(space: Space) -> [f64; 3] {
    std::array::from_fn(|axis| std::f64::consts::TAU / space.side(axis))
}

/// A direction that a wave vector of integers has in a box: `n_x/L_x, n_y/L_y, …` in units of the
/// first axis, so that it is `n` in a cube.
pub(crate) fn direction(n: [i32; 3], space: Space) -> [f64; 3] {
    std::array::from_fn(|axis| f64::from(n[axis]) * (space.side(0) / space.side(axis)))
}

impl Waves {
    /// The sum of some waves in a box; along an open axis the side of the box is their period.
    ///
    /// # Panics
    /// Where a component of a wave vector is larger than [`LONGEST`].
    pub fn new(space: Space, list: Vec<Wave>) -> Self {
        let components = list.iter().flat_map(|wave| wave.n);
        let longest = components.map(|n| n.unsigned_abs() as usize).max().unwrap_or(0);
        assert!(longest <= LONGEST, "a wave vector has a component of {longest}");
        Self { k: wave_numbers(space), longest, list }
    }

    /// The waves.
    pub fn list(&self) -> &[Wave] {
        &self.list
    }

    /// `2π/L` of each axis.
    pub fn wave_numbers(&self) -> [f64; 3] {
        self.k
    }

    /// `⟨|u|²⟩` over the box, `½ Σ |a|² + |b|²`.
    pub fn mean_square(&self) -> f64 {
        0.5 * self.list.iter().map(Wave::square).sum::<f64>()
    }

    /// `u(x)`; `z` is 0 in two dimensions.
    pub fn at<const D: usize>(&self, x: [f64; 3]) -> Vector<f64, D> {
        let phases = self.phases(x);
        let mut sum = Vector::zero();
        for wave in &self.list {
            let z = phases.of(wave.n);
            for axis in 0..D {
                sum[axis] += wave.cosine[axis] * z.re + wave.sine[axis] * z.im;
            }
        }
        sum
    }

    /// `δu = Σ (b cos − a sin) κ·δx`, eight directions at once.
    pub fn tangent<const D: usize>(
        &self,
        x: [f64; 3],
        change: Vector<F64x8, D>,
    ) -> Vector<F64x8, D> {
        let phases = self.phases(x);
        let mut sum = Vector([F64x8::ZERO; D]);
        for wave in &self.list {
            let slope = self.slope::<D>(wave, phases.of(wave.n));
            let mut along = F64x8::ZERO;
            (0..D).for_each(|axis| along += change[axis] * self.relative(wave, axis));
            (0..D).for_each(|axis| sum[axis] += along * slope[axis]);
        }
        sum
    }

    /// `∂L/∂x = Σ κ (b cos − a sin)·∂L/∂u`: the pullback of the field.
    pub fn pullback<const D: usize>(&self, x: [f64; 3], adjoint: Vector<f64, D>) -> Vector<f64, D> {
        let phases = self.phases(x);
        let mut sum = Vector::zero();
        for wave in &self.list {
            let across = self.slope::<D>(wave, phases.of(wave.n)).dot(adjoint);
            (0..D).for_each(|axis| sum[axis] += self.relative(wave, axis) * across);
        }
        sum
    }

    /// A component of the wave vector, in units of `2π/L` of the first axis.
    fn relative(&self, wave: &Wave, axis: usize) -> f64 {
        f64::from(wave.n[axis]) * (self.k[axis] / self.k[0])
    }

    /// `k (b cos − a sin)`: the derivative of a wave by its phase, times `k = 2π/L` of the first axis.
    fn slope<const D: usize>(&self, wave: &Wave, z: Complex<f64>) -> Vector<f64, D> {
        let along = |axis: usize| self.k[0] * (wave.sine[axis] * z.re - wave.cosine[axis] * z.im);
        Vector(std::array::from_fn(along))
    }

    fn phases(&self, x: [f64; 3]) -> Phases {
        let one = Complex::new(1.0, 0.0);
        let mut powers = [[one; LONGEST + 1]; 3];
        for ((powers, x), k) in powers.iter_mut().zip(x).zip(self.k) {
            powers[1] = Complex::cis(k * x);
            // By halving: round-off grows with the logarithm of the exponent.
            for m in 2..=self.longest {
                powers[m] = powers[m / 2] * powers[m - m / 2];
            }
        }
        Phases(powers)
    }
}

impl Wave {
    /// `|a|² + |b|²`.
    fn square(&self) -> f64 {
        self.cosine.iter().chain(&self.sine).map(|x| x * x).sum()
    }
}

/// `e^{ikmx}` along each axis at one position, entry `m` of each.
struct Phases([[Complex<f64>; LONGEST + 1]; 3]);

impl Phases {
    /// `e^{ik n·x}`.
    fn of(&self, n: [i32; 3]) -> Complex<f64> {
        let [x, y, z] = std::array::from_fn(|axis| {
            let power = self.0[axis][n[axis].unsigned_abs() as usize];
            if n[axis] < 0 { power.conj() } else { power }
        });
        x * y * z
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn waves(dimension: usize, longest: f64, length: f64) -> Waves {
        let list = wave_vectors(dimension, longest).into_iter().enumerate().map(|(row, n)| {
            let number = |axis: usize, shift: f64| (1.7 * row as f64 + axis as f64 + shift).sin();
            let cosine = std::array::from_fn(|axis| number(axis, 0.3));
            Wave { n, cosine, sine: std::array::from_fn(|axis| number(axis, 4.1)) }
        });
        Waves::new(Space::cube(length), list.collect())
    }

    #[test]
    fn one_of_each_pair_is_listed_and_a_longer_list_begins_with_a_shorter_one() {
        for (dimension, longest, count) in [(2, 2.5, 10), (3, 2.5, 40), (2, 1.0, 2), (3, 0.9, 0)] {
            let list = wave_vectors(dimension, longest);
            assert_eq!(list.len(), count);
            assert!(list.iter().all(|n| !list.contains(&n.map(|x| -x))));
            assert_eq!(wave_vectors(dimension, longest + 2.0)[..count], list);
        }
    }

    #[test]
    fn products_of_powers_are_the_sines_and_cosines() {
        let length = 1.7;
        for (dimension, longest) in [(2, LONGEST as f64), (3, 5.0)] {
            let waves = waves(dimension, longest, length);
            let x = [0.31, 1.62, if dimension == 3 { 0.77 } else { 0.0 }];
            let mut expected = [0.0; 3];
            for wave in waves.list() {
                let along: f64 = (0..3).map(|axis| f64::from(wave.n[axis]) * x[axis]).sum();
                let (sin, cos) = (waves.wave_numbers()[0] * along).sin_cos();
                for (axis, sum) in expected.iter_mut().enumerate() {
                    *sum += wave.cosine[axis] * cos + wave.sine[axis] * sin;
                }
            }
            let found = waves.at::<3>(x);
            // A phase of up to 64·2π·√2 has an error of 1e-13; errors of waves add at random.
            let round_off = 1e-13 * (waves.list().len() as f64).sqrt();
            for (found, expected) in found.0.into_iter().zip(expected) {
                assert!((found - expected).abs() < round_off, "{found} against {expected}");
            }
        }
    }

    #[test]
    fn tangent_and_pullback_are_the_derivative() {
        let mut waves = waves(3, 2.5, 1.7);
        for sides in [[1.7; 3], [1.7, 2.3, 0.9]] {
            waves.k = wave_numbers(Space::new(sides, [crate::space::Axis::Periodic; 3]));
            pulls_back(&waves);
        }
    }

    fn pulls_back(waves: &Waves) {
        let (x, step) = ([0.31, 1.62, 0.77], 1e-5);
        let direction = [0.4, -0.7, 0.2];
        let moved = |by: f64| waves.at::<3>(std::array::from_fn(|a| x[a] + by * direction[a]));
        let difference = (moved(step) - moved(-step)) * (0.5 / step);
        let change = Vector(direction.map(|d| F64x8::unit(2) * d));
        let tangent = waves.tangent(x, change).0.map(|lanes| lanes.lane(2));
        let adjoint = Vector([0.9, 0.1, -1.3]);
        // Central differences: step² k³ |u|/6 is about 1e-7.
        assert!((Vector(tangent) - difference).norm() < 1e-6 * difference.norm());
        let there = adjoint.dot(Vector(tangent));
        let back = waves.pullback(x, adjoint).dot(Vector(direction));
        assert!((there - back).abs() < 1e-13 * there.abs().max(1.0), "{there} against {back}");
    }

    #[test]
    fn the_mean_square_is_that_of_a_mesh_that_resolves_every_wave() {
        let waves = waves(3, 2.5, 1.7);
        let nodes = 6;
        let at = |m: usize| 1.7 * m as f64 / f64::from(nodes as u32);
        let all = (0..nodes * nodes * nodes)
            .map(|m| waves.at::<3>([at(m % nodes), at(m / nodes % nodes), at(m / nodes / nodes)]));
        let mean = all.map(Vector::norm_squared).sum::<f64>() / nodes.pow(3) as f64;
        assert!((mean - waves.mean_square()).abs() < 1e-12 * mean);
    }
}
