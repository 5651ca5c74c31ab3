//! The spectrum of a normal matrix with its diagonal scaled to one: which directions change the
//! residuals.

/// Eigenvalue, relative to the diagonal and per parameter, at or below which it is round-off and
/// its direction changes nothing.
const NOTHING: f64 = 1e-14;

/// Squared component of a parameter in directions that change nothing, above which the parameter
/// cannot be separated from others.
const SHARE: f64 = 1e-3;

/// Number of sweeps of Jacobi rotations, maximum; five are enough for matrices of a hundred rows.
const SWEEPS: usize = 50;

/// Eigenvalues and eigenvectors of a scaled symmetric matrix with a positive diagonal.
#[derive(Clone, Debug)]
pub struct Spectrum {
    count: usize,
    /// `1/√(diagonal)`.
    scale: Vec<f64>,
    values: Vec<f64>,
    /// Eigenvector `e` in column `e`.
    vectors: Vec<f64>,
}

impl Spectrum {
    /// Of a matrix, row by row; none where it is not finite or its diagonal is not positive.
    pub fn of(matrix: &[f64], count: usize) -> Option<Self> {
        let diagonal = |k: usize| matrix[k * count + k];
        if !matrix.iter().all(|x| x.is_finite()) || !(0..count).all(|k| diagonal(k) > 0.0) {
            return None;
        }
        let scale: Vec<f64> = (0..count).map(|k| 1.0 / diagonal(k).sqrt()).collect();
        let scaled = |index: usize| matrix[index] * scale[index / count] * scale[index % count];
        let mut work: Vec<f64> = (0..count * count).map(scaled).collect();
        let mut vectors = vec![0.0; count * count];
        (0..count).for_each(|k| vectors[k * count + k] = 1.0);
        for _ in 0..SWEEPS {
            if off_diagonal(&work, count) < f64::EPSILON * f64::EPSILON {
                break;
            }
            for p in 0..count {
                (p + 1..count).for_each(|q| rotate(&mut work, &mut vectors, (p, q, count)));
            }
        }
        let values = (0..count).map(|k| work[k * count + k]).collect();
        Some(Self { count, scale, values, vectors })
    }

    fn sees(&self, eigen: usize) -> bool {
        self.values[eigen] > NOTHING * self.count as f64
    }

    /// Which parameters have a share in a direction that changes nothing.
    pub fn inseparable(&self) -> Vec<bool> {
        let share = |k: usize| {
            let unseen = (0..self.count).filter(|&e| !self.sees(e));
            unseen.map(|e| self.vectors[k * self.count + e].powi(2)).sum::<f64>()
        };
        (0..self.count).map(|k| share(k) > SHARE).collect()
    }

    /// The inverse over the other directions, row by row.
    fn inverse(&self) -> Vec<f64> {
        let entry = |index: usize| {
            let (a, b) = (index / self.count, index % self.count);
            let seen = (0..self.count).filter(|&e| self.sees(e));
            let terms = seen.map(|e| {
                self.vectors[a * self.count + e] * self.vectors[b * self.count + e] / self.values[e]
            });
            terms.sum::<f64>() * self.scale[a] * self.scale[b]
        };
        (0..self.count * self.count).map(entry).collect()
    }

    /// `xᵀ N⁻¹ x`.
    pub fn quadratic_inverse(&self, x: &[f64]) -> f64 {
        let inverse = self.inverse();
        let terms = inverse.iter().enumerate();
        terms.map(|(index, entry)| x[index / self.count] * entry * x[index % self.count]).sum()
    }

    /// `N⁻¹ S N⁻¹`.
    pub fn sandwich(&self, scatter: &[f64]) -> Vec<f64> {
        let inverse = self.inverse();
        product(&product(&inverse, scatter, self.count), &inverse, self.count)
    }
}

fn product(a: &[f64], b: &[f64], count: usize) -> Vec<f64> {
    let entry = |index: usize| {
        let (row, column) = (index / count, index % count);
        (0..count).map(|k| a[row * count + k] * b[k * count + column]).sum()
    };
    (0..count * count).map(entry).collect()
}

fn off_diagonal(matrix: &[f64], count: usize) -> f64 {
    let entries = matrix.iter().enumerate().filter(|(index, _)| index / count != index % count);
    entries.map(|(_, x)| x * x).sum()
}

/// A Jacobi rotation, which makes entry `(p, q)` zero.
fn rotate(matrix: &mut [f64], vectors: &mut [f64], (p, q, count): (usize, usize, usize)) {
    let off = matrix[p * count + q];
    if off.abs() <= f64::MIN_POSITIVE {
        return;
    }
    let theta = (matrix[q * count + q] - matrix[p * count + p]) / (2.0 * off);
    let tangent = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
    let cosine = 1.0 / (tangent * tangent + 1.0).sqrt();
    let sine = tangent * cosine;
    let turn = |data: &mut [f64], i: usize, j: usize| {
        let (x, y) = (data[i], data[j]);
        (data[i], data[j]) = (cosine * x - sine * y, sine * x + cosine * y);
    };
    for k in 0..count {
        turn(matrix, k * count + p, k * count + q);
        turn(vectors, k * count + p, k * count + q);
    }
    (0..count).for_each(|k| turn(matrix, p * count + k, q * count + k));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_of_a_matrix_of_many_scales_is_its_inverse() {
        let matrix = [4e6, 2e3, 1.0, 2e3, 9.0, 2e-3, 1.0, 2e-3, 1e-4];
        let spectrum = Spectrum::of(&matrix, 3).unwrap();
        assert_eq!(spectrum.inseparable(), [false; 3]);
        let one = product(&spectrum.inverse(), &matrix, 3);
        for (index, entry) in one.iter().enumerate() {
            let expected = f64::from(u8::from(index / 3 == index % 3));
            let scale = matrix[4 * (index % 3)].sqrt() / matrix[4 * (index / 3)].sqrt();
            assert!((entry - expected).abs() < 1e-12 * scale.max(1.0), "{one:?}");
        }
        let exact = spectrum.inverse()[4];
        assert!((spectrum.quadratic_inverse(&[0.0, 1.0, 0.0]) - exact).abs() < 1e-14);
    }

    #[test]
    fn two_parameters_of_which_only_the_sum_counts_are_not_told_apart_and_the_third_is() {
        let matrix = [1.0, 1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 4.0];
        let spectrum = Spectrum::of(&matrix, 3).unwrap();
        assert_eq!(spectrum.inseparable(), [true, true, false]);
    }

    #[test]
    fn a_parameter_without_effect_has_no_spectrum() {
        assert!(Spectrum::of(&[1.0, 0.0, 0.0, 0.0], 2).is_none());
        assert!(Spectrum::of(&[f64::NAN], 1).is_none());
    }
}
