//! The statistical loss `L_kl` of a flow: its velocity increments, compared with the truth's.

use super::{GradientSum, IncrementDensities, IncrementLoss, StateAdjoint};
use crate::packed::{Packed, PackedSensitivity};
use crate::scalar::F64x8;
use crate::vector::Vector;
use rayon::prelude::*;

/// `w` times [`IncrementDensities::loss`] of `δu = v − u(0)`, and its gradient `w Σᵢ gᵢ·∂vᵢ/∂θ`
/// with `gᵢ = ∂L/∂vᵢ`. The start `u(0)` depends on no parameter.
///
/// `packed` and `blocks` are in the order of slots, `u(0)` in the order of rows. Every sum is taken
/// in the order of rows, so that neither the cell order nor the number of threads changes its bits.
/// If an increment is not finite, the loss is infinite with gradient zero. Tested in
/// `tests/statistical_loss.rs`.
pub fn statistical_loss<const D: usize>(
    (packed, slot_of_row): (&[Packed], &[u32]),
    blocks: &[&[PackedSensitivity<D>]],
    start: &[Vector<f64, D>],
    (truth, weight): (&IncrementDensities<D>, f64),
) -> GradientSum {
    let IncrementLoss { value, gradient } = divergence((packed, slot_of_row), start, truth);
    let column = |block: &&[PackedSensitivity<D>]| {
        let mut sum = F64x8::ZERO;
        for (slope, &slot) in gradient.iter().zip(slot_of_row) {
            for axis in 0..D {
                sum += block[slot as usize].velocity[axis] * (weight * slope[axis]);
            }
        }
        sum
    };
    GradientSum { value: weight * value, gradient: blocks.par_iter().map(column).collect() }
}

/// The value of [`statistical_loss`], and its derivative `w gᵢ` by each particle's velocity, in the
/// order of `packed`.
pub fn statistical_adjoint<const D: usize>(
    (packed, slot_of_row): (&[Packed], &[u32]),
    start: &[Vector<f64, D>],
    (truth, weight): (&IncrementDensities<D>, f64),
) -> StateAdjoint<D> {
    let IncrementLoss { value, gradient } = divergence((packed, slot_of_row), start, truth);
    let mut adjoint = StateAdjoint { value: weight * value, ..StateAdjoint::zero(packed.len()) };
    for (slope, &slot) in gradient.into_iter().zip(slot_of_row) {
        adjoint.velocity[slot as usize] = slope * weight;
    }
    adjoint
}

/// The divergence and `∂L/∂v`, particle `k` in row `k`.
fn divergence<const D: usize>(
    (packed, slot_of_row): (&[Packed], &[u32]),
    start: &[Vector<f64, D>],
    truth: &IncrementDensities<D>,
) -> IncrementLoss<Vector<f64, D>> {
    let velocity = |&slot: &u32| Vector::<f64, D>::from_3d(packed[slot as usize].velocity);
    let rows = slot_of_row.iter().map(velocity).zip(start);
    let increments: Vec<Vector<f64, D>> = rows.map(|(v, &start)| v - start).collect();
    match truth.loss(&increments) {
        Ok(found) if found.is_finite() => found,
        _ => {
            let gradient = vec![Vector::zero(); increments.len()];
            IncrementLoss { value: f64::INFINITY, gradient }
        }
    }
}

impl<const D: usize> IncrementLoss<Vector<f64, D>> {
    fn is_finite(&self) -> bool {
        self.value.is_finite() && self.gradient.iter().all(|slope| slope.is_finite())
    }
}
