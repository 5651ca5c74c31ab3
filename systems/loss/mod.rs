//! Losses: at each observed step the flow is compared with the truth.
//!
//! To add a loss, write one file here with a [`FrameLoss`], and add a line to [`losses`].

mod field;
mod increments;
#[doc(hidden)]
pub mod statistics;
mod trajectory;

pub use field::FieldLoss;
pub use increments::StatisticalLoss;
pub use trajectory::TrajectoryLoss;

use super::acceleration::Laws;
use super::neighbours::Neighbours;
use super::packing;
use super::particles::{PairInputs, SensitivityBlock, SensitivityCloud};
use super::tape::{Tape, add_loss};
use super::term::{Stage, Term};
use super::verlet::Clock;
use super::{Needs, Occasion, Phase};
use crate::flow::State;
use crate::losses::{GradientSum, IncrementDensities, Mesh, SquareSum, StateAdjoint};
use crate::models::Medium;
use crate::packed::PackedSensitivity;
use crate::scene::{StatisticWeights, Times};
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use std::fmt::Debug;
use std::sync::Arc;

/// A true state of the flow, and its smoothed field.
#[derive(Clone, Debug, Default)]
pub struct Observation<const D: usize> {
    /// The step of the predicted flow at which it is observed.
    pub step: u64,
    /// `r̂` by particle.
    pub positions: Vec<Vector<f64, D>>,
    /// `v̂` by particle.
    pub velocities: Vec<Vector<f64, D>>,
    /// `V̂` by mesh node; empty without a field loss.
    pub field: Vec<Vector<f64, D>>,
    /// Densities of `v̂ − u(0)`; none without a statistical loss.
    pub increments: Option<IncrementDensities<D>>,
    /// Values of each statistic that has a weight, in the order of [`StatisticWeights::named`].
    pub statistics: Vec<Vec<f64>>,
}

/// The observations that a World is compared with.
#[derive(Resource, Clone, Debug)]
pub struct Observations<const D: usize> {
    /// True states in order of step.
    pub frames: Arc<Vec<Observation<D>>>,
    /// Number of frames in the loss, counted from the first.
    pub window: usize,
    /// Weight of the trajectory loss; not computed at zero.
    pub trajectory: f64,
    /// Weight of the field loss; not computed at zero.
    pub field: f64,
    /// Mesh of the field loss.
    pub mesh: Mesh<D>,
    /// Weight of each frame that counts in the statistical loss.
    pub kl: f64,
    /// Which frames count in the statistical loss.
    pub times: Times,
    /// Weights of the losses of statistics, in each frame that counts.
    pub statistics: StatisticWeights,
    /// The state that the prediction starts with; its positions where a loss compares with them.
    pub first: Arc<State<D>>,
}

impl<const D: usize> Observations<D> {
    /// The frame observed at a step, if it lies within the window, and whether it is the window's
    /// last.
    fn at(&self, step: u64) -> Option<(&Observation<D>, bool)> {
        let frames = &self.frames[..self.window];
        let index = frames.iter().position(|frame| frame.step == step)?;
        Some((&frames[index], index + 1 == frames.len()))
    }
}

/// The inputs of a loss at an observed step.
#[derive(Clone, Copy, Debug)]
pub struct Seen<'a, const D: usize> {
    /// The observations.
    pub observations: &'a Observations<D>,
    /// The true state.
    pub frame: &'a Observation<D>,
    /// Whether it is the last of the window.
    pub is_last: bool,
    /// The flow: mass, kernel, parameters.
    pub medium: &'a Medium<D>,
    /// Places of the fluid's parameters in the flat vector.
    pub places: &'a [usize],
    /// Cells and box.
    pub neighbours: &'a Neighbours<D>,
    /// Particles in cell order.
    pub inputs: &'a PairInputs,
}

/// A loss of one observed frame.
pub trait FrameLoss<const D: usize>: Debug + Send + Sync + 'static {
    /// Its name, in scenes and reports.
    fn name(&self) -> &'static str;

    /// An empty sum for this loss, over `blocks` blocks of parameters.
    fn empty(&self, blocks: usize) -> LossPart;

    /// Adds a frame's share, with its gradient by the parameters of each block of sensitivities.
    fn accumulate(&self, seen: &Seen<'_, D>, blocks: &[SensitivityBlock<D>], sum: &mut LossPart);

    /// A frame's share, with its derivatives by the state of every particle; none where the frame
    /// has no share.
    fn adjoint(&self, seen: &Seen<'_, D>) -> Option<StateAdjoint<D>>;

    /// A frame's share alone.
    fn value(&self, seen: &Seen<'_, D>) -> f64 {
        self.adjoint(seen).map_or(0.0, |adjoint| adjoint.value)
    }
}

/// The packed sensitivities of all particles, block by block.
fn packed<const D: usize>(blocks: &[SensitivityBlock<D>]) -> Vec<&[PackedSensitivity<D>]> {
    blocks.iter().map(|block| &block.packed[..]).collect()
}

/// The losses that observations ask for, in the order in which they are summed. A loss of weight
/// zero is left out.
#[doc(hidden)]
pub fn losses<const D: usize>(observations: &Observations<D>) -> Vec<Box<dyn FrameLoss<D>>> {
    let all: [(f64, Box<dyn FrameLoss<D>>); 3] = [
        (observations.trajectory, Box::new(TrajectoryLoss)),
        (observations.field, Box::new(FieldLoss)),
        (observations.kl, Box::new(StatisticalLoss)),
    ];
    let all = all.into_iter().chain(statistics::losses(observations));
    all.filter(|(weight, _)| *weight > 0.0).map(|(_, loss)| loss).collect()
}

/// The losses of a World.
#[derive(Resource, Debug)]
#[doc(hidden)]
pub struct Losses<const D: usize>(pub Vec<Box<dyn FrameLoss<D>>>);

/// The sum of one loss.
#[derive(Clone, Debug, PartialEq)]
#[doc(hidden)]
pub enum LossPart {
    /// Sums of squares by measured quantity, with their Gauss–Newton matrices.
    Squares(Vec<(&'static str, SquareSum)>),
    /// A loss that is not a sum of squares.
    Gradient(GradientSum),
}

impl LossPart {
    /// Empty sums of squares of the named quantities, over `blocks` blocks of parameters.
    pub fn squares<const N: usize>(names: [&'static str; N], blocks: usize) -> Self {
        Self::Squares(names.map(|name| (name, SquareSum::new(blocks))).to_vec())
    }

    /// Adds a frame's sums of squares, quantity by quantity.
    pub fn merge(&mut self, frame: &[SquareSum]) {
        if let Self::Squares(sums) = self {
            sums.iter_mut().zip(frame).for_each(|((_, sum), frame)| sum.add_sum(frame));
        }
    }

    /// The weighted loss.
    pub fn value(&self) -> f64 {
        match self {
            Self::Squares(sums) => sums.iter().map(|(_, sum)| sum.value).sum(),
            Self::Gradient(sum) => sum.value,
        }
    }

    /// `∂value/∂θ` of the first `count` parameters.
    pub fn gradient(&self, count: usize) -> Vec<f64> {
        match self {
            Self::Squares(sums) => sum(count, sums.iter().map(|(_, sum)| sum.gradient(count))),
            Self::Gradient(sum) => sum.gradient(count),
        }
    }

    /// The Gauss–Newton matrix of the first `count` parameters; none where the loss is not a sum of
    /// squares.
    pub fn normal(&self, count: usize) -> Option<Vec<f64>> {
        match self {
            Self::Squares(sums) => {
                Some(sum(count * count, sums.iter().map(|(_, sum)| sum.normal(count))))
            }
            Self::Gradient(_) => None,
        }
    }

    fn add_value(&mut self, value: f64) {
        match self {
            // In adjoint mode there is no Gauss–Newton matrix, and the first sum holds the total of
            // all quantities.
            Self::Squares(sums) => sums.iter_mut().take(1).for_each(|(_, sum)| sum.value += value),
            Self::Gradient(sum) => sum.value += value,
        }
    }
}

/// The loss of a World so far, loss by loss.
#[derive(Resource, Clone, Debug, Default)]
pub struct LossSum {
    parts: Vec<(&'static str, LossPart)>,
}

impl LossSum {
    /// Empty sums of these losses, over `blocks` blocks of parameters.
    pub fn new<const D: usize>(losses: &[Box<dyn FrameLoss<D>>], blocks: usize) -> Self {
        Self { parts: losses.iter().map(|loss| (loss.name(), loss.empty(blocks))).collect() }
    }

    /// The sum of all parts.
    pub fn value(&self) -> f64 {
        self.parts.iter().map(|(_, part)| part.value()).sum()
    }

    /// The weighted value of one loss; zero where it is not computed.
    pub fn value_of(&self, name: &str) -> f64 {
        self.part(name).map_or(0.0, LossPart::value)
    }

    /// One loss, where it is computed.
    pub fn part(&self, name: &str) -> Option<&LossPart> {
        self.parts.iter().find(|(own, _)| *own == name).map(|(_, part)| part)
    }

    /// `∂value/∂θ` of the first `count` parameters.
    pub fn gradient(&self, count: usize) -> Vec<f64> {
        sum(count, self.parts.iter().map(|(_, part)| part.gradient(count)))
    }

    /// The sums of squares by measured quantity; none where some part is not a sum of squares.
    pub fn squares(&self) -> Option<Vec<&(&'static str, SquareSum)>> {
        let parts = self.parts.iter().map(|(_, part)| match part {
            LossPart::Squares(sums) => Some(sums),
            LossPart::Gradient(_) => None,
        });
        Some(parts.collect::<Option<Vec<_>>>()?.into_iter().flatten().collect())
    }

    /// The Gauss–Newton matrix of the first `count` parameters, over all sums of squares.
    pub fn normal(&self, count: usize) -> Vec<f64> {
        sum(count * count, self.parts.iter().filter_map(|(_, part)| part.normal(count)))
    }
}

fn sum(count: usize, parts: impl Iterator<Item = Vec<f64>>) -> Vec<f64> {
    let add = |a: Vec<f64>, b: Vec<f64>| a.iter().zip(b).map(|(a, b)| a + b).collect();
    parts.reduce(add).unwrap_or_else(|| vec![0.0; count])
}

/// Term: one of the losses of a World. The term of the first loss runs the systems of all losses.
#[derive(Clone, Debug)]
#[doc(hidden)]
pub struct LossTerm {
    /// Its number in [`Losses`].
    pub number: usize,
    /// Its name.
    pub name: &'static str,
}

impl<const D: usize> Term<D> for LossTerm {
    fn name(&self) -> String {
        format!("{} loss", self.name)
    }

    fn stages(&self, occasion: Occasion, needs: &Needs) -> Vec<Stage> {
        if self.number > 0 || !occasion.has_judgement() {
            return Vec::new();
        }
        let observed = packing::observed::<D>(is_observed::<D>);
        let judge = match needs.adjoint {
            true => accumulate_loss_adjoint::<D>.run_if(is_observed::<D>),
            false => accumulate_loss::<D>.run_if(is_observed::<D>),
        };
        vec![observed, Stage::constant(Phase::Loss, judge).pullback(add_loss::<D>)]
    }
}

/// Run condition: whether the step just completed is observed.
#[doc(hidden)]
pub fn is_observed<const D: usize>(
    clock: Res<Clock>,
    observations: Option<Res<Observations<D>>>,
) -> bool {
    observations.is_some_and(|observations| observations.at(clock.step).is_some())
}

/// The data that losses read.
#[derive(bevy_ecs::system::SystemParam)]
#[doc(hidden)]
pub struct Comparison<'w, const D: usize> {
    clock: Res<'w, Clock>,
    observations: Res<'w, Observations<D>>,
    losses: Res<'w, Losses<D>>,
    laws: Res<'w, Laws<D>>,
    neighbours: Res<'w, Neighbours<D>>,
    inputs: Res<'w, PairInputs>,
}

impl<const D: usize> Comparison<'_, D> {
    fn seen(&self) -> Option<Seen<'_, D>> {
        let (frame, is_last) = self.observations.at(self.clock.step)?;
        Some(Seen {
            observations: &self.observations,
            frame,
            is_last,
            medium: self.laws.model().medium(),
            places: self.laws.model.scalars(),
            neighbours: &self.neighbours,
            inputs: &self.inputs,
        })
    }
}

/// System: adds an observed frame's share to the loss.
#[doc(hidden)]
pub fn accumulate_loss<const D: usize>(
    comparison: Comparison<'_, D>,
    sensitivities: Option<Res<SensitivityCloud<D>>>,
    mut sum: ResMut<LossSum>,
) {
    let Some(seen) = comparison.seen() else { return };
    let blocks = sensitivities.as_ref().map_or(&[][..], |cloud| &cloud.blocks);
    for (loss, (_, part)) in comparison.losses.0.iter().zip(&mut sum.parts) {
        loss.accumulate(&seen, blocks, part);
    }
}

/// System: as [`accumulate_loss`], in adjoint mode: records the derivatives of the loss by the
/// state of every particle on the tape.
#[doc(hidden)]
pub fn accumulate_loss_adjoint<const D: usize>(
    comparison: Comparison<'_, D>,
    mut tape: ResMut<Tape<D>>,
    mut sum: ResMut<LossSum>,
) {
    let Some(seen) = comparison.seen() else { return };
    for (loss, (_, part)) in comparison.losses.0.iter().zip(&mut sum.parts) {
        if !tape.running {
            part.add_value(loss.value(&seen));
        } else if let Some(adjoint) = loss.adjoint(&seen) {
            part.add_value(adjoint.value);
            tape.push_frame(comparison.clock.step, &adjoint, seen.neighbours.order().slots());
        }
    }
}
