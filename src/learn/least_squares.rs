//! The search by Levenberg–Marquardt, stage by stage.

use super::search::Search;
use super::{Evaluation, Iteration, Learner};
use crate::error::Result;
use crate::optimisers::LevenbergMarquardt;

/// Consecutive trials that may fail before a Levenberg–Marquardt search ends.
const PATIENCE: usize = 12;

/// Predicted relative decrease of the loss at or below which a step is only round-off.
const NOTHING: f64 = 1e-14;

impl<const D: usize> Learner<D> {
    /// One stage; returns the best evaluation.
    pub(super) fn levenberg_marquardt(
        &mut self,
        search: &mut Search,
        (window, mut best): (usize, Evaluation),
        damping: f64,
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<Evaluation> {
        let mut optimiser = LevenbergMarquardt::new(damping);
        let target = self.learn.target;
        let enough = if window == self.frames { target } else { target.max(1e-9 * best.loss) };
        let mut failures = 0;
        let end = search.first + self.learn.iterations;
        while best.loss > enough && failures < PATIENCE && search.index < end {
            let Some(trial) = self.attempt(&mut optimiser, &mut best, window) else { break };
            let note = trial.err();
            if note.is_none() {
                search.trail.push(best.parameters.clone());
                failures = 0;
            } else {
                failures += 1;
            }
            (search.index, search.window) = (search.index + 1, window);
            let (index, rate) = (search.index, optimiser.damping());
            watch(&Iteration {
                index,
                window,
                evaluation: &best,
                rate,
                note,
                with_first_frames: false,
            })?;
        }
        Ok(best)
    }

    /// One trial: updates `best` if it is better, otherwise returns the reason. None where no
    /// decrease is predicted.
    fn attempt(
        &mut self,
        optimiser: &mut LevenbergMarquardt,
        best: &mut Evaluation,
        window: usize,
    ) -> Option<std::result::Result<(), String>> {
        let coordinates = self.coordinates();
        let from = &best.parameters;
        let (mut gradient, mut normal) = coordinates.pull_back(from, &best.gradient, &best.normal);
        hold(&coordinates.held(from, &best.gradient), &mut gradient, &mut normal);
        let Some((step, predicted)) = optimiser.propose(&gradient, &normal) else {
            optimiser.reject();
            return Some(Err("the damped normal matrix is not positive definite".to_owned()));
        };
        if predicted <= NOTHING * best.loss {
            return None;
        }
        let here = coordinates.coordinates(from);
        let there: Vec<f64> = here.iter().zip(step).map(|(x, s)| x + s).collect();
        let Some(trial) = coordinates.parameters(&there) else {
            optimiser.reject();
            return Some(Err("trial taken back: its sound speed is imaginary".to_owned()));
        };
        let trial = coordinates.into_domain(from, &trial);
        Some(match self.evaluate(&trial, window) {
            Ok(found) if found.loss < best.loss => {
                optimiser.accept(best.loss - found.loss, predicted);
                *best = found;
                Ok(())
            }
            Ok(found) => {
                optimiser.reject();
                Err(format!("trial taken back: loss {:.3e}", found.loss))
            }
            Err(error) => {
                optimiser.reject();
                Err(format!("trial taken back: {error}"))
            }
        })
    }
}

/// Fixes the parameters that are at the edge of their domain during a step.
fn hold(held: &[bool], gradient: &mut [f64], normal: &mut [f64]) {
    let count = held.len();
    for held in (0..count).filter(|&k| held[k]) {
        gradient[held] = 0.0;
        for other in 0..count {
            normal[held * count + other] = 0.0;
            normal[other * count + held] = 0.0;
        }
        normal[held * count + held] = 1.0;
    }
}
