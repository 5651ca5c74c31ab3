//! One lesson of a search: a flow with derivatives that starts from the lesson's first state.

use super::{Evaluation, Squares};
use crate::error::{Error, Result};
use crate::flow::{Differentiation, Flow, State};
use crate::losses::SquareSum;
use crate::parameters::Parameter;
use crate::scene::{Learn, Scene, StatisticWeights};
use crate::sensitivity::{Gradient, SHORTEN, adjoint_gradient};
use crate::systems::loss::{LossSum, Observations};

/// What the predictions of all lessons have in common.
pub(super) struct Setting<'a> {
    pub(super) learn: &'a Learn,
    pub(super) gradient: Gradient,
    /// Places of the learned parameters in the flat vector of a flow.
    pub(super) places: &'a [usize],
}

/// A flow with derivatives, started again from the same state for every evaluation.
pub(super) struct Prediction<const D: usize> {
    pub(super) flow: Flow<D>,
    pub(super) from: State<D>,
    /// Largest memory of the last adjoint, in bytes.
    held: usize,
}

impl<const D: usize> Prediction<D> {
    /// A prediction of a scene from the first true state of a lesson, with the observations after it.
    pub(super) fn new(
        scene: &Scene,
        (from, observations): (State<D>, Observations<D>),
        (gradient, columns): (Gradient, &[Parameter]),
    ) -> Result<Self> {
        let flow = match gradient {
            Gradient::Adjoint => Flow::with_adjoint(scene, &from, observations)?,
            Gradient::Auto | Gradient::Forward => {
                let (parameters, coupling) = (columns.to_vec(), scene.learning()?.coupling);
                let by = Differentiation { parameters, coupling };
                Flow::build(scene, &from, Some(&by), Some(observations))?
            }
        };
        Ok(Self { flow, from, held: 0 })
    }

    /// Resets the prediction to its start, with other parameters, for a comparison over `window` frames.
    pub(super) fn start_over(&mut self, places: &[usize], (learned, window): (&[f64], usize)) {
        self.flow.set_at(places, learned);
        self.flow.set_window(window);
        self.flow.reset(&self.from);
    }

    /// Runs the prediction over the first `window` frames and compares it with the truth.
    pub(super) fn evaluate(
        &mut self,
        setting: &Setting<'_>,
        (learned, window): (&[f64], usize),
    ) -> Result<Evaluation> {
        self.start_over(setting.places, (learned, window));
        // A kernel that must stay positive rejects parameters with a negative lobe.
        self.flow.model().medium().kernel.check("the kernel of this trial", D)?;
        let steps = window as u64 * setting.learn.every;
        if setting.gradient == Gradient::Adjoint {
            return self.evaluate_backwards(setting, (learned, steps));
        }
        (0..steps).try_for_each(|_| self.flow.step())?;
        let loss = self.flow.loss();
        let count = learned.len();
        let found = self.evaluation(learned, &loss, (loss.gradient(count), loss.normal(count)))?;
        Ok(Evaluation { squares: squares(&loss, count), ..found })
    }

    fn evaluate_backwards(
        &mut self,
        setting: &Setting<'_>,
        (learned, steps): (&[f64], u64),
    ) -> Result<Evaluation> {
        let storage = setting.learn.storage;
        let found = adjoint_gradient(&mut self.flow, &self.from, steps, storage)?;
        self.held = found.bytes;
        let gradient = setting.places.iter().map(|&place| found.gradient[place]).collect();
        self.evaluation(learned, &found.loss, (gradient, Vec::new()))
    }

    fn evaluation(
        &self,
        learned: &[f64],
        loss: &LossSum,
        (gradient, normal): (Vec<f64>, Vec<f64>),
    ) -> Result<Evaluation> {
        let value = loss.value();
        let lost = |quantity: &str, found: f64, remedy: &str| {
            Err(Error::Diverged {
                step: self.flow.steps(),
                time: self.flow.time(),
                quantity: quantity.to_owned(),
                found: format!("is {found}"),
                remedy: remedy.to_owned(),
            })
        };
        if !value.is_finite() {
            return lost(
                "the loss",
                value,
                "start nearer to the truth, or take a smaller time step",
            );
        }
        if let Some(slope) = gradient.iter().find(|slope| !slope.is_finite()) {
            return lost("a component of the gradient", *slope, SHORTEN);
        }
        Ok(Evaluation {
            parameters: learned.to_vec(),
            loss: value,
            trajectory: loss.value_of("trajectory"),
            field: loss.value_of("field"),
            kl: loss.value_of("kl"),
            statistics: by_statistic(loss),
            gradient,
            normal,
            squares: Vec::new(),
        })
    }

    /// Bytes of the gradient in addition to the flow: forward sensitivities and linearised pairs, or the largest memory
    /// of tape and snapshots in the last adjoint.
    pub(super) fn gradient_bytes(&self) -> usize {
        let parts = self.flow.bytes_per_particle();
        let forward = ["sensitivities", "linearised pairs"];
        let each = parts.iter().filter(|(part, _)| forward.contains(part));
        let each = each.map(|(_, bytes)| *bytes).sum::<f64>();
        self.held + (each * self.from.positions.len() as f64).round() as usize
    }
}

/// The values of the losses of statistics.
fn by_statistic(loss: &LossSum) -> Vec<(&'static str, f64)> {
    let named = StatisticWeights::default().named().map(|(name, _)| name);
    named.iter().filter(|name| loss.part(name).is_some()).map(|&n| (n, loss.value_of(n))).collect()
}

/// The sums of squares of a loss; empty if it has another part.
fn squares(loss: &LossSum, count: usize) -> Vec<Squares> {
    let one = |(of, sum): &(&'static str, SquareSum)| Squares {
        of,
        value: sum.value,
        count: sum.count,
        size: sum.size,
        normal: sum.normal(count),
    };
    loss.squares().unwrap_or_default().into_iter().map(one).collect()
}
