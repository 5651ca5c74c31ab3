//! Searches by gradients: first-order methods, and limited-memory BFGS with a line search.

use super::search::Search;
use super::{Evaluation, Iteration, Learner};
use crate::error::Result;
use crate::optimisers::{Coordinates, Descend, Lbfgs, LineSearch, dot};

/// Number of trials along one line of a quasi-Newton search, maximum.
const TRIALS: usize = 20;

impl<const D: usize> Learner<D> {
    /// Iterations of one stage of a search by gradients: all stages have an equal share.
    fn share(&self) -> usize {
        let stages = self.learn.windows.iter().filter(|&&w| w < self.frames).count() + 1;
        self.learn.iterations.div_ceil(stages)
    }

    /// One stage of first-order steps; returns the last evaluation.
    pub(super) fn descend(
        &mut self,
        search: &mut Search,
        (window, mut here): (usize, Evaluation),
        (mut optimiser, decay): (impl Descend, f64),
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<Evaluation> {
        // The rate decays ten times per stage.
        let share = self.share();
        let last = window == self.frames;
        let coordinates = self.coordinates();
        let mut is_whole = true;
        for iteration in 0..=share {
            // Losses of batches do not compare.
            if last && is_whole {
                search.meet(&here);
            }
            if iteration == share || (is_whole && here.loss <= self.learn.target) {
                break;
            }
            let at_end = iteration + 1 == share || (iteration + 1) % share.div_ceil(10) == 0;
            let of_all = self.choose(iteration, at_end);
            let rate = optimiser.rate();
            optimiser.descend(&mut search.at, &here.gradient);
            search.at = coordinates.into_domain(&here.parameters, &search.at);
            if (iteration + 1) % share.div_ceil(10) == 0 {
                optimiser.set_rate(rate * decay);
            }
            let mut note = None;
            match self.evaluate(&search.at, window) {
                Ok(found) => (here, is_whole) = (found, of_all),
                Err(error) => {
                    // Return to the last parameters that could be evaluated, with half the rate.
                    search.at.copy_from_slice(&here.parameters);
                    optimiser.set_rate(0.5 * optimiser.rate());
                    note = Some(format!("step taken back, rate halved: {error}"));
                }
            }
            (search.index, search.window) = (search.index + 1, window);
            let index = search.index;
            watch(&Iteration {
                index,
                window,
                evaluation: &here,
                rate,
                note,
                with_first_frames: false,
            })?;
        }
        self.choose(0, true);
        Ok(here)
    }

    /// Limited-memory BFGS in the coordinates of the search. Every evaluation is an iteration, also
    /// a trial on a line.
    pub(super) fn quasi_newton(
        &mut self,
        search: &mut Search,
        (window, mut here): (usize, Evaluation),
        (memory, length): (usize, f64),
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<Evaluation> {
        let end = search.index + self.share();
        let coordinates = self.coordinates();
        let mut optimiser = Lbfgs::new(memory);
        let mut failures = 0;
        while search.index < end && here.loss > self.learn.target && failures < 2 {
            let slopes = coordinates.pull_gradient_back(&here.parameters, &here.gradient);
            let direction = optimiser.direction(&slopes);
            let from = coordinates.coordinates(&here.parameters);
            let first = if optimiser.is_empty() { length } else { 1.0 };
            let (coordinates, start) = (&coordinates, &here.parameters[..]);
            let line = Line { coordinates, start, from: &from, direction: &direction, window };
            let trials = TRIALS.min(end - search.index);
            match self.search_line(search, (&line, first, trials), &here, watch)? {
                Some(new) => {
                    let there = coordinates.coordinates(&new.parameters);
                    let turned = coordinates.pull_gradient_back(&new.parameters, &new.gradient);
                    optimiser.remember(minus(&there, &from), minus(&turned, &slopes));
                    here = new;
                    failures = 0;
                }
                // A first failure may be due to the memory, which is cleared; a second one ends the
                // stage.
                None => {
                    optimiser.forget();
                    failures += 1;
                }
            }
        }
        if window == self.frames {
            search.meet(&here);
        }
        Ok(here)
    }

    /// The first evaluation on a line that satisfies the conditions of the line search, otherwise
    /// the last that lowers the loss.
    fn search_line(
        &mut self,
        search: &mut Search,
        (line, first, trials): (&Line<'_>, f64, usize),
        here: &Evaluation,
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<Option<Evaluation>> {
        let mut lengths = LineSearch::new(here.loss, line.slope(here), first);
        let mut found = None;
        for _ in 0..trials {
            let rate = lengths.length;
            let trial = match line.at(rate) {
                Some(there) => self.evaluate(&there, line.window).map_err(|e| e.to_string()),
                None => Err("its sound speed is imaginary".to_owned()),
            };
            (search.index, search.window) = (search.index + 1, line.window);
            let done = lengths.accept(trial.as_ref().ok().map(|t| (t.loss, line.slope(t))));
            // Only a trial that diverged gets a note: lengths that are too long or too short are
            // normal in a line search.
            let note = trial.as_ref().err().map(|error| format!("trial taken back: {error}"));
            found = trial.ok().filter(|t| t.loss < here.loss).or(found);
            let evaluation = found.as_ref().filter(|_| done).unwrap_or(here);
            let (index, window) = (search.index, line.window);
            watch(&Iteration { index, window, evaluation, rate, note, with_first_frames: false })?;
            if done {
                break;
            }
        }
        Ok(found)
    }

    /// Ends a first-order search at its best evaluation, if that is not the last iteration.
    pub(super) fn go_back(
        &self,
        search: &mut Search,
        (met, best): (usize, Evaluation),
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<Evaluation> {
        let window = self.frames;
        if met != search.index || search.window != window {
            search.index += 1;
            let note = Some(format!("the parameters of iteration {met}, the best over all frames"));
            let index = search.index;
            watch(&Iteration {
                index,
                window,
                evaluation: &best,
                rate: 0.0,
                note,
                with_first_frames: false,
            })?;
        }
        Ok(best)
    }
}

/// A line in the space of the coordinates.
struct Line<'a> {
    coordinates: &'a Coordinates,
    /// The parameters at its start.
    start: &'a [f64],
    from: &'a [f64],
    direction: &'a [f64],
    /// Number of frames of an evaluation.
    window: usize,
}

impl Line<'_> {
    /// The parameters at a length; `None` where no parameters have these coordinates.
    fn at(&self, length: f64) -> Option<Vec<f64>> {
        let steps = self.from.iter().zip(self.direction).map(|(x, d)| x + length * d);
        let there = self.coordinates.parameters(&steps.collect::<Vec<_>>())?;
        Some(self.coordinates.into_domain(self.start, &there))
    }

    /// The loss's slope along the line.
    fn slope(&self, evaluation: &Evaluation) -> f64 {
        let (at, gradient) = (&evaluation.parameters, &evaluation.gradient);
        dot(&self.coordinates.pull_gradient_back(at, gradient), self.direction)
    }
}

fn minus(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}
