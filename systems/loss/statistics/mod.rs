//! Losses of statistics: `L = (w/n) Σ_k (ln f_k − ln f̂_k)²` over the `n` values of a statistic `f` of one frame, with the
//! truth's `f̂` by the same formula.
//!
//! A loss of logarithms weighs a small wave number as much as a large one: `L = 0.01` is ten per cent apart, root mean
//! square. It is a sum of squares, so that Levenberg–Marquardt has its normal matrix. Two realisations of a truth differ
//! by the square of what `evaluate` prints as the floor of the same statistic, below which a loss means nothing.
//!
//! Each statistic is one file with its formula and its pullback `c ↦ Σ_k c_k ∂f_k/∂(r, v, ρ)`; forward sensitivities
//! are contracted with the pullback of each value. Tested in `tests/statistics_losses.rs`.

mod dispersion;
mod energy;
mod fields;
mod flatness;
mod spectrum;
mod structure;

pub use dispersion::Dispersion;
pub use energy::Energy;
pub use flatness::Flatness;
pub use spectrum::Spectrum;
pub use structure::StructureFunction;

use super::{FrameLoss, LossPart, Observations, Seen, packed};
use crate::flow::State;
use crate::losses::{Mesh, SquareSum, StateAdjoint};
use crate::scalar::F64x8;
use crate::scene::{StatisticWeights, Times};
use crate::systems::particles::SensitivityBlock;
use crate::vector::Vector;
use std::fmt::Debug;

/// A true state as a statistic sees it.
#[derive(Clone, Copy, Debug)]
#[doc(hidden)]
pub struct TrueState<'a, const D: usize> {
    /// The first state of the window.
    pub first: &'a State<D>,
    /// The state.
    pub state: &'a State<D>,
    /// The smoothed velocity at the nodes of the mesh.
    pub field: &'a [Vector<f64, D>],
    /// The mesh.
    pub mesh: &'a Mesh<D>,
}

/// A statistic of one frame.
#[doc(hidden)]
pub trait Statistic<const D: usize>: Debug + Send + Sync + 'static {
    /// Its name, in scenes and reports.
    fn name(&self) -> &'static str;

    /// Whether it needs the field of the truth.
    fn needs_field(&self) -> bool {
        false
    }

    /// Its values in a true state.
    fn of_truth(&self, truth: &TrueState<'_, D>) -> Vec<f64>;

    /// Its values in the predicted state.
    fn values(&self, seen: &Seen<'_, D>) -> Vec<f64>;

    /// `Σ_k c_k ∂f_k/∂(r, v, ρ)`, in the order of packed particles.
    fn pull_back(&self, seen: &Seen<'_, D>, cotangents: &[f64]) -> StateAdjoint<D>;
}

/// The statistics that have a weight, in the order of [`StatisticWeights::named`].
pub(crate) fn statistics<const D: usize>(
    weights: &StatisticWeights,
) -> Vec<(f64, Box<dyn Statistic<D>>)> {
    let all: [Box<dyn Statistic<D>>; 5] = [
        Box::new(Energy),
        Box::new(Flatness),
        Box::new(Dispersion),
        Box::new(Spectrum),
        Box::new(StructureFunction),
    ];
    let weights = weights.named().map(|(_, weight)| weight);
    weights.into_iter().zip(all).filter(|(weight, _)| *weight > 0.0).collect()
}

/// The losses of the statistics that have a weight.
pub(super) fn losses<const D: usize>(
    observations: &Observations<D>,
) -> impl Iterator<Item = (f64, Box<dyn FrameLoss<D>>)> {
    let all = statistics(&observations.statistics).into_iter().enumerate();
    all.map(|(number, (weight, statistic))| {
        let loss = StatisticLoss { number, weight, statistic };
        (weight, Box::new(loss) as Box<dyn FrameLoss<D>>)
    })
}

/// The loss of a statistic.
#[derive(Debug)]
struct StatisticLoss<const D: usize> {
    /// Its place in [`super::Observation::statistics`].
    number: usize,
    weight: f64,
    statistic: Box<dyn Statistic<D>>,
}

impl<const D: usize> StatisticLoss<D> {
    /// `(f, ln f − ln f̂)` of each value, and the weight of a square, where the frame counts. Where one of the two is not
    /// positive, as in a flow at rest, there is nothing to compare.
    fn residuals(&self, seen: &Seen<'_, D>) -> Option<(Vec<(f64, f64)>, f64)> {
        let counts = seen.is_last || seen.observations.times == Times::All;
        let truth = seen.frame.statistics.get(self.number).filter(|_| counts)?;
        let pairs = self.statistic.values(seen).into_iter().zip(truth);
        let residual = |(found, truth): (f64, &f64)| match found > 0.0 && *truth > 0.0 {
            true => (found, (found / truth).ln()),
            false => (1.0, 0.0),
        };
        let residuals: Vec<(f64, f64)> = pairs.map(residual).collect();
        let weight = self.weight / residuals.len().max(1) as f64;
        Some((residuals, weight))
    }
}

impl<const D: usize> FrameLoss<D> for StatisticLoss<D> {
    fn name(&self) -> &'static str {
        self.statistic.name()
    }

    fn empty(&self, blocks: usize) -> LossPart {
        LossPart::squares([self.statistic.name()], blocks)
    }

    fn accumulate(&self, seen: &Seen<'_, D>, blocks: &[SensitivityBlock<D>], sum: &mut LossPart) {
        let Some((residuals, weight)) = self.residuals(seen) else { return };
        let mut found = SquareSum::new(blocks.len());
        let mut cotangents = vec![0.0; residuals.len()];
        for (k, &(value, residual)) in residuals.iter().enumerate() {
            if blocks.is_empty() {
                found.add(weight, residual, |_| F64x8::ZERO);
                continue;
            }
            cotangents[k] = 1.0 / value;
            let slopes = contract(&self.statistic.pull_back(seen, &cotangents), blocks);
            cotangents[k] = 0.0;
            found.add(weight, residual, |b| slopes[b]);
        }
        // The size of a logarithm is one: a residual is a relative error.
        found.count = residuals.len() as f64;
        found.size = weight * found.count;
        sum.merge(&[found]);
    }

    fn adjoint(&self, seen: &Seen<'_, D>) -> Option<StateAdjoint<D>> {
        let (residuals, weight) = self.residuals(seen)?;
        let cotangent = |&(value, residual): &(f64, f64)| 2.0 * weight * residual / value;
        let cotangents: Vec<f64> = residuals.iter().map(cotangent).collect();
        let value = residuals.iter().map(|(_, residual)| weight * residual * residual).sum();
        Some(StateAdjoint { value, ..self.statistic.pull_back(seen, &cotangents) })
    }

    fn value(&self, seen: &Seen<'_, D>) -> f64 {
        let Some((residuals, weight)) = self.residuals(seen) else { return 0.0 };
        residuals.iter().map(|(_, residual)| weight * residual * residual).sum()
    }
}

/// `Σᵢ (∂L/∂rᵢ·∂rᵢ/∂θ + ∂L/∂vᵢ·∂vᵢ/∂θ + ∂L/∂ρᵢ ∂ρᵢ/∂θ)` and the direct dependence on parameters, block by block.
fn contract<const D: usize>(
    adjoint: &StateAdjoint<D>,
    blocks: &[SensitivityBlock<D>],
) -> Vec<F64x8> {
    let one = |(block, rows): (&SensitivityBlock<D>, &[_])| {
        let rows: &[crate::packed::PackedSensitivity<D>] = rows;
        let mut sum = F64x8::ZERO;
        let states = adjoint.position.iter().zip(&adjoint.velocity).zip(&adjoint.density);
        for (((position, velocity), density), row) in states.zip(rows) {
            for axis in 0..D {
                sum += row.position[axis] * position[axis];
                sum += row.velocity[axis] * velocity[axis];
            }
            sum += row.density * *density;
        }
        for &(place, slope) in &adjoint.parameters {
            sum += block.direction(place) * slope;
        }
        sum
    };
    blocks.iter().zip(packed(blocks)).map(one).collect()
}
