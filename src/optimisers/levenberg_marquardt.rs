//! Levenberg–Marquardt (Levenberg 1944, Marquardt 1963), with Nielsen's damping (1999).
//!
//! It is implemented here, on the normal equations: the crate `levenberg-marquardt` needs every
//! residual and its derivatives in one matrix, cannot reject a trial that diverged, and reports
//! nothing between its first and last iteration. Here memory does not grow with the number of
//! residuals, a failed trial only raises the damping, and every trial can be recorded. Normal
//! equations lose digits, which does not matter if the residuals vanish at the solution.

/// The damping of the search, and its adaptation.
#[derive(Clone, Debug)]
pub struct LevenbergMarquardt {
    damping: f64,
    growth: f64,
}

impl LevenbergMarquardt {
    /// Starts with a damping relative to the diagonal of the normal matrix.
    pub fn new(damping: f64) -> Self {
        Self { damping, growth: 2.0 }
    }

    /// The current damping `λ`.
    pub fn damping(&self) -> f64 {
        self.damping
    }

    /// The step `δ` with `(N + λ diag N) δ = −g/2`, from gradient `g` and normal matrix `N` (row by
    /// row), and the decrease of the loss that it predicts for linear residuals. `None` where the
    /// damped matrix is not positive definite.
    pub fn propose(&self, gradient: &[f64], normal: &[f64]) -> Option<(Vec<f64>, f64)> {
        let count = gradient.len();
        let mut matrix = normal.to_vec();
        for k in 0..count {
            let diagonal = matrix[k * count + k];
            // A parameter without any effect does not move.
            matrix[k * count + k] =
                if diagonal > 0.0 { diagonal * (1.0 + self.damping) } else { 1.0 };
        }
        let right: Vec<f64> = gradient.iter().map(|g| -0.5 * g).collect();
        let step = solve_positive(matrix, right)?;
        let mut gain = 0.0;
        for a in 0..count {
            gain -= step[a] * gradient[a];
            for b in 0..count {
                gain -= step[a] * normal[a * count + b] * step[b];
            }
        }
        step.iter().all(|x| x.is_finite()).then_some((step, gain))
    }

    /// The trial lowered the loss by `actual`, where `predicted` was expected: adapts the damping.
    pub fn accept(&mut self, actual: f64, predicted: f64) {
        let ratio = if predicted > 0.0 { actual / predicted } else { 0.0 };
        let factor = 1.0 - (2.0 * ratio - 1.0).powi(3);
        self.damping = (self.damping * factor.max(1.0 / 10.0)).max(1e-15);
        self.growth = 2.0;
    }

    /// The trial was worse, or the flow diverged.
    pub fn reject(&mut self) {
        self.damping *= self.growth;
        self.growth *= 2.0;
    }
}

/// Solves `A x = b` for a symmetric positive definite matrix by Cholesky decomposition, after
/// scaling its diagonal to one; `None` where it is not positive definite.
pub(crate) fn solve_positive(mut a: Vec<f64>, mut b: Vec<f64>) -> Option<Vec<f64>> {
    let n = b.len();
    let scale: Vec<f64> = (0..n).map(|k| 1.0 / a[k * n + k].sqrt()).collect();
    for i in 0..n {
        b[i] *= scale[i];
        (0..n).for_each(|j| a[i * n + j] *= scale[i] * scale[j]);
    }
    for i in 0..n {
        for j in 0..=i {
            let dot: f64 = (0..j).map(|k| a[i * n + k] * a[j * n + k]).sum();
            let rest = a[i * n + j] - dot;
            if i != j {
                a[i * n + j] = rest / a[j * n + j];
            } else if rest > 0.0 {
                a[i * n + i] = rest.sqrt();
            } else {
                return None;
            }
        }
    }
    for i in 0..n {
        let dot: f64 = (0..i).map(|k| a[i * n + k] * b[k]).sum();
        b[i] = (b[i] - dot) / a[i * n + i];
    }
    for i in (0..n).rev() {
        let dot: f64 = (i + 1..n).map(|k| a[k * n + i] * b[k]).sum();
        b[i] = (b[i] - dot) / a[i * n + i];
    }
    Some(b.iter().zip(scale).map(|(x, s)| x * s).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rosenbrock's function as residuals: loss, gradient, normal matrix.
    fn valley([x, y]: [f64; 2]) -> (f64, [f64; 2], [f64; 4]) {
        let residuals = [10.0 * (y - x * x), 1.0 - x];
        let slopes = [[-20.0 * x, 10.0], [-1.0, 0.0]];
        let loss = residuals.iter().map(|r| r * r).sum();
        let gradient =
            [0, 1].map(|a| (0..2).map(|k| 2.0 * residuals[k] * slopes[k][a]).sum::<f64>());
        let normal = [(0, 0), (0, 1), (1, 0), (1, 1)]
            .map(|(a, b)| (0..2).map(|k| slopes[k][a] * slopes[k][b]).sum::<f64>());
        (loss, gradient, normal)
    }

    #[test]
    fn the_floor_of_a_bent_valley_is_reached_to_round_off() {
        let mut search = LevenbergMarquardt::new(1e-3);
        let mut at = [-1.2, 1.0];
        for _ in 0..60 {
            let (loss, gradient, normal) = valley(at);
            let (step, predicted) = search.propose(&gradient, &normal).unwrap();
            let trial = [at[0] + step[0], at[1] + step[1]];
            let (new, ..) = valley(trial);
            if new < loss {
                search.accept(loss - new, predicted);
                at = trial;
            } else {
                search.reject();
            }
        }
        assert!(valley(at).0 < 1e-28, "{at:?}");
    }

    #[test]
    fn a_parameter_without_effect_stays_where_it_is() {
        let (step, _) =
            LevenbergMarquardt::new(0.0).propose(&[2.0, 0.0], &[1.0, 0.0, 0.0, 0.0]).unwrap();
        assert_eq!(step, [-1.0, 0.0]);
    }

    #[test]
    fn an_indefinite_matrix_is_refused() {
        assert!(solve_positive(vec![1.0, 2.0, 2.0, 1.0], vec![1.0, 1.0]).is_none());
    }
}
