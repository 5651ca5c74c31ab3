//! Losses: the distance of a predicted flow from the truth, with exact gradients.
//!
//! [`trajectory_loss`] and [`field_loss`] are sums of squares. Each observed frame adds its
//! residuals `R` and their derivatives `J = ∂R/∂θ` to one [`SquareSum`]. It serves both gradient
//! descent (`2 Σ w R J`) and Levenberg–Marquardt (`Σ w J Jᵀ`), and its memory does not grow with
//! the number of residuals. [`statistical_loss`] is a divergence: it yields a [`GradientSum`], for
//! gradient descent only.

mod field;
mod field_tangent;
mod increments;
mod lattice;
mod mesh;
mod statistical;
mod trajectory;

pub(crate) use field::pull_back_nodes;
pub use field::{Points, field, field_adjoint, field_value};
pub use field_tangent::{DirectParameter, field_loss};
pub use increments::{
    Density1d, FEWEST_NODES, IncrementDensities, IncrementLoss, increment_loss, sampling_floor,
};
pub use mesh::Mesh;
pub use statistical::{statistical_adjoint, statistical_loss};
pub use trajectory::{trajectory_adjoint, trajectory_loss};

use crate::reduce::Partial;
use crate::scalar::{F64x8, SimdFloat, WIDTH};
use crate::vector::Vector;

/// A loss of one frame, with its derivatives by the state of every particle.
#[derive(Clone, Debug, PartialEq)]
pub struct StateAdjoint<const D: usize> {
    /// The weighted loss.
    pub value: f64,
    /// `∂L/∂r` at fixed density.
    pub position: Vec<Vector<f64, D>>,
    /// `∂L/∂v`.
    pub velocity: Vec<Vector<f64, D>>,
    /// `∂L/∂ρ`.
    pub density: Vec<f64>,
    /// `(place in the flat vector, ∂L/∂parameter)` of parameters that the loss depends on directly.
    pub parameters: Vec<(usize, f64)>,
}

impl<const D: usize> StateAdjoint<D> {
    /// Zero loss, of `count` particles.
    pub fn zero(count: usize) -> Self {
        let zeros = vec![Vector::zero(); count];
        let (value, density, parameters) = (0.0, vec![0.0; count], Vec::new());
        Self { value, position: zeros.clone(), velocity: zeros, density, parameters }
    }
}

/// A weighted sum of squared residuals, with its gradient and its Gauss–Newton matrix.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SquareSum {
    /// `Σ w R²`.
    pub value: f64,
    /// Number of independent residuals, as defined by the loss.
    pub count: f64,
    /// `Σ w X̂²`: the same sum over the observed quantity itself, by which the value is made
    /// relative.
    pub size: f64,
    /// `½ ∂value/∂θ = Σ w R J`, in blocks of eight parameters.
    half_gradient: Vec<F64x8>,
    /// `Σ w J Jᵀ`, upper triangle: for each row, its blocks from the diagonal on.
    normal: Vec<F64x8>,
}

impl SquareSum {
    /// An empty sum over `blocks` blocks of eight parameters.
    pub fn new(blocks: usize) -> Self {
        Self {
            value: 0.0,
            count: 0.0,
            size: 0.0,
            half_gradient: vec![F64x8::ZERO; blocks],
            normal: vec![F64x8::ZERO; blocks * WIDTH * blocks],
        }
    }

    /// Adds one residual with the derivative `columns(b)` by the parameters of block `b`.
    #[inline(always)]
    pub fn add(&mut self, weight: f64, residual: f64, columns: impl Fn(usize) -> F64x8) {
        self.add_gradient(weight, residual, &columns);
        let blocks = self.half_gradient.len();
        for b in 0..blocks {
            for (lane, slope) in (columns(b) * weight).to_array().into_iter().enumerate() {
                let row = (b * WIDTH + lane) * blocks;
                for other in b..blocks {
                    self.normal[row + other] += columns(other) * slope;
                }
            }
        }
    }

    /// As [`Self::add`], without the matrix.
    #[inline(always)]
    fn add_gradient(&mut self, weight: f64, residual: f64, columns: impl Fn(usize) -> F64x8) {
        self.value += weight * residual * residual;
        for (b, half) in self.half_gradient.iter_mut().enumerate() {
            *half += columns(b) * (weight * residual);
        }
    }

    /// Adds many residuals of one weight. `columns` holds the blocks of one residual after another,
    /// and may be longer.
    #[inline(always)]
    pub(crate) fn add_rows<W: SimdFloat>(
        &mut self,
        weight: f64,
        residuals: &[f64],
        columns: &[F64x8],
    ) {
        let blocks = self.half_gradient.len();
        for (&residual, row) in residuals.iter().zip(columns.chunks_exact(blocks)) {
            self.value += weight * residual * residual;
            for (half, column) in self.half_gradient.iter_mut().zip(row) {
                *half = (W::load(half) + W::load(column) * (weight * residual)).store();
            }
        }
        for rows in columns[..residuals.len() * blocks].chunks(Self::PANEL * blocks) {
            self.add_normal::<W>(weight, rows);
        }
    }

    /// Residuals per panel of the matrix product, so that each tile of the matrix stays in
    /// registers and the panel in the cache.
    const PANEL: usize = 48;

    /// Adds the matrix of a panel of residuals of one weight.
    #[inline(always)]
    fn add_normal<W: SimdFloat>(&mut self, weight: f64, columns: &[F64x8]) {
        let blocks = self.half_gradient.len();
        for b in 0..blocks {
            for other in b..blocks {
                let mut tile = [W::of(0.0); WIDTH];
                for row in columns.chunks_exact(blocks) {
                    let (left, right) = (&row[b], W::load(&row[other]));
                    for (lane, tile) in tile.iter_mut().enumerate() {
                        *tile += right * left.lane(lane);
                    }
                }
                for (lane, tile) in tile.iter().enumerate() {
                    let sum = &mut self.normal[(b * WIDTH + lane) * blocks + other];
                    *sum = (W::load(sum) + *tile * weight).store();
                }
            }
        }
    }

    /// Adds another sum.
    pub fn add_sum(&mut self, other: &Self) {
        self.value += other.value;
        self.count += other.count;
        self.size += other.size;
        for (a, b) in self.half_gradient.iter_mut().zip(&other.half_gradient) {
            *a += *b;
        }
        for (a, b) in self.normal.iter_mut().zip(&other.normal) {
            *a += *b;
        }
    }

    /// `∂value/∂θ` of the first `count` parameters.
    pub fn gradient(&self, count: usize) -> Vec<f64> {
        let flat = self.half_gradient.iter().flat_map(|lanes| (*lanes * 2.0).to_array());
        flat.take(count).collect()
    }

    /// The Gauss–Newton matrix `Σ w J Jᵀ` of the first `count` parameters, row by row.
    pub fn normal(&self, count: usize) -> Vec<f64> {
        let blocks = self.half_gradient.len();
        let entry = |a: usize, b: usize| {
            let (a, b) = (a.min(b), a.max(b));
            self.normal[a * blocks + b / WIDTH].lane(b % WIDTH)
        };
        (0..count).flat_map(|a| (0..count).map(move |b| entry(a, b))).collect()
    }
}

/// A weighted loss that is not a sum of squares, with its gradient.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GradientSum {
    /// The loss.
    pub value: f64,
    /// `∂value/∂θ`, in blocks of eight parameters.
    gradient: Vec<F64x8>,
}

impl GradientSum {
    /// An empty sum over `blocks` blocks of eight parameters.
    pub fn new(blocks: usize) -> Self {
        Self { value: 0.0, gradient: vec![F64x8::ZERO; blocks] }
    }

    /// Adds another sum.
    pub fn add_sum(&mut self, other: &Self) {
        self.value += other.value;
        self.gradient.iter_mut().zip(&other.gradient).for_each(|(a, b)| *a += *b);
    }

    /// `∂value/∂θ` of the first `count` parameters.
    pub fn gradient(&self, count: usize) -> Vec<f64> {
        self.gradient.iter().flat_map(|lanes| lanes.to_array()).take(count).collect()
    }
}

impl Partial for SquareSum {
    fn merge(&mut self, next: Self) {
        self.add_sum(&next);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_square_sum_is_the_sum_of_squares_with_its_gradient_and_normal_matrix() {
        let slopes = |k: usize| [0.3 * k as f64 - 1.0, 0.7, 0.1 * (k * k) as f64];
        let mut sum = SquareSum::new(1);
        let (mut value, mut gradient, mut normal) = (0.0, [0.0; 3], [0.0; 9]);
        for k in 0..5 {
            let (weight, residual, j) = (0.5, 1.0 - 0.4 * k as f64, slopes(k));
            let mut lanes = [0.0; WIDTH];
            lanes[..3].copy_from_slice(&j);
            sum.add(weight, residual, |_| F64x8::new(lanes));
            value += weight * residual * residual;
            for a in 0..3 {
                gradient[a] += 2.0 * weight * residual * j[a];
                (0..3).for_each(|b| normal[3 * a + b] += weight * j[a] * j[b]);
            }
        }
        let near = |a: &[f64], b: &[f64]| a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-14);
        assert!(near(&[sum.value], &[value]));
        assert!(near(&sum.gradient(3), &gradient) && near(&sum.normal(3), &normal));
    }

    #[test]
    fn many_residuals_add_what_each_adds_alone() {
        const BLOCKS: usize = 3;
        let column = |k: usize, b: usize| {
            let mut lanes = F64x8::ZERO;
            (0..WIDTH).for_each(|l| lanes.set_lane(l, ((7 * k + 3 * b + l) % 11) as f64 - 4.5));
            lanes
        };
        let (mut one, mut many) = (SquareSum::new(BLOCKS), SquareSum::new(BLOCKS));
        let rows = 2 * SquareSum::PANEL + 5;
        let residuals: Vec<f64> = (0..rows).map(|k| 0.3 * k as f64 - 2.0).collect();
        for (k, &residual) in residuals.iter().enumerate() {
            one.add(0.7, residual, |b| column(k, b));
        }
        let columns = (0..rows + 1).flat_map(|k| (0..BLOCKS).map(move |b| column(k, b)));
        many.add_rows::<F64x8>(0.7, &residuals, &columns.collect::<Vec<_>>());
        let count = BLOCKS * WIDTH;
        assert_eq!((one.value, one.gradient(count)), (many.value, many.gradient(count)));
        let (one, many) = (one.normal(count), many.normal(count));
        for (a, b) in one.iter().zip(&many) {
            assert!((a - b).abs() < 1e-12 * (1.0 + a.abs()), "{a} {b}");
        }
        let bits = |a: usize, b: usize| many[a * count + b].to_bits();
        assert!((0..count).all(|a| (0..count).all(|b| bits(a, b) == bits(b, a))), "symmetric");
    }
}
