//! How a learner searches: stages of growing windows, each by the scene's optimiser.

use super::{Evaluation, Iteration, Learner, Outcome};
use crate::error::Result;
use crate::interrupt;
use crate::optimisers::{
    Adam, Coordinates, Descend, Lbfgs, LevenbergMarquardt, LineSearch, Rmsprop,
};
use crate::scene::Optimiser;

impl<const D: usize> Learner<D> {
    /// Searches from `guess`, through growing windows, and calls `watch` after each iteration.
    pub fn run(
        &mut self,
        guess: Vec<f64>,
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<Outcome> {
        // A trial that was interrupted is no iteration.
        let watch = &mut |iteration: &Iteration<'_>| {
            interrupt::check()?;
            watch(iteration)
        };
        // The guess is iteration zero; one whose flow diverges can still be left by a shorter window.
        let first = self.evaluate(&guess, self.frames).ok();
        let initial_loss = first.as_ref().map_or(f64::INFINITY, |e| e.loss);
        if let Some(evaluation) = &first {
            let (index, window, rate, note) = (0, self.frames, 0.0, None);
            watch(&Iteration { index, window, evaluation, rate, note })?;
        }
        let (guess, index) = self.warm_up(guess, watch)?;
        let mut windows = self.learn.windows.clone();
        windows.retain(|&w| w < self.frames);
        windows.push(self.frames);
        let mut search = Search { at: guess, first: index, index, window: self.frames, best: None };
        for window in windows {
            let full = window == self.frames;
            match self.learn.optimiser.clone() {
                Optimiser::LevenbergMarquardt { damping } => {
                    self.levenberg_marquardt(&mut search, (window, full), damping, watch)?;
                }
                Optimiser::Adam { rate, decay } => {
                    let adam = Adam::new(rate, search.at.len());
                    self.descend(&mut search, window, (adam, decay), watch)?;
                }
                Optimiser::Rmsprop { rate, decay } => {
                    let rmsprop = Rmsprop::new(rate, search.at.len());
                    self.descend(&mut search, window, (rmsprop, decay), watch)?;
                }
                Optimiser::Lbfgs { memory, length } => {
                    self.quasi_newton(&mut search, window, (memory, length), watch)?;
                }
            }
        }
        let evaluation = match search.best.take() {
            Some(best) => self.go_back(&mut search, best, watch)?,
            None => self.evaluate(&search.at, self.frames)?,
        };
        Ok(Outcome { evaluation, initial_loss, iterations: search.index })
    }
}

impl<const D: usize> Learner<D> {
    /// Lets the warm-up search first: where it ended, and after how many iterations.
    fn warm_up(
        &mut self,
        guess: Vec<f64>,
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<(Vec<f64>, usize)> {
        let Some(before) = &mut self.warm_up else { return Ok((guess, 0)) };
        let outcome = before.run(guess, &mut |iteration| match iteration.index {
            0 => Ok(()),
            _ => watch(iteration),
        })?;
        Ok((outcome.evaluation.parameters, outcome.iterations))
    }
}

/// Where a search stands.
struct Search {
    at: Vec<f64>,
    /// Iterations before this search.
    first: usize,
    index: usize,
    /// Window of the last iteration.
    window: usize,
    /// The best evaluation over all frames that a first-order search met, and behind which iteration.
    best: Option<(usize, Evaluation)>,
}

impl Search {
    fn meet(&mut self, here: &Evaluation) {
        if self.best.as_ref().is_none_or(|(_, best)| here.loss < best.loss) {
            self.best = Some((self.index, here.clone()));
        }
    }
}

/// Trials in a row that may fail before a search by Levenberg–Marquardt counts as finished.
const PATIENCE: usize = 12;

/// Trials along one line of a quasi-Newton search.
const TRIALS: usize = 20;

impl<const D: usize> Learner<D> {
    fn levenberg_marquardt(
        &mut self,
        search: &mut Search,
        (window, last): (usize, bool),
        damping: f64,
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<()> {
        let mut optimiser = LevenbergMarquardt::new(damping);
        let mut best = self.evaluate(&search.at, window)?;
        let enough = if last { self.learn.target } else { self.learn.target.max(1e-9 * best.loss) };
        let mut failures = 0;
        let end = search.first + self.learn.iterations;
        while best.loss > enough && failures < PATIENCE && search.index < end {
            let note = self.attempt(&mut optimiser, &mut best, window);
            failures = if note.is_some() { failures + 1 } else { 0 };
            search.index += 1;
            let (index, rate) = (search.index, optimiser.damping());
            watch(&Iteration { index, window, evaluation: &best, rate, note })?;
        }
        search.at = best.parameters;
        Ok(())
    }

    /// One trial: `best` moves there if it is better, otherwise the reason comes back.
    fn attempt(
        &mut self,
        optimiser: &mut LevenbergMarquardt,
        best: &mut Evaluation,
        window: usize,
    ) -> Option<String> {
        let coordinates = self.coordinates();
        let from = &best.parameters;
        let (mut gradient, mut normal) = coordinates.pull_back(from, &best.gradient, &best.normal);
        hold(&coordinates.held(from, &best.gradient), &mut gradient, &mut normal);
        let Some((step, predicted)) = optimiser.propose(&gradient, &normal) else {
            optimiser.reject();
            return Some("the damped normal matrix is not positive definite".to_owned());
        };
        let here = coordinates.coordinates(from);
        let there: Vec<f64> = here.iter().zip(step).map(|(x, s)| x + s).collect();
        let Some(trial) = coordinates.parameters(&there) else {
            optimiser.reject();
            return Some("trial taken back: its sound speed is imaginary".to_owned());
        };
        let trial = coordinates.into_domain(from, &trial);
        match self.evaluate(&trial, window) {
            Ok(found) if found.loss < best.loss => {
                optimiser.accept(best.loss - found.loss, predicted);
                *best = found;
                None
            }
            Ok(found) => {
                optimiser.reject();
                Some(format!("trial taken back: loss {:.3e}", found.loss))
            }
            Err(error) => {
                optimiser.reject();
                Some(format!("trial taken back: {error}"))
            }
        }
    }

    /// Iterations that one stage of a search by gradients may take: all have an equal share.
    fn share(&self) -> usize {
        let stages = self.learn.windows.iter().filter(|&&w| w < self.frames).count() + 1;
        self.learn.iterations.div_ceil(stages)
    }

    fn descend(
        &mut self,
        search: &mut Search,
        window: usize,
        (mut optimiser, decay): (impl Descend, f64),
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<()> {
        // Ten decays a stage.
        let share = self.share();
        let last = window == self.frames;
        let coordinates = self.coordinates();
        let mut here = self.evaluate(&search.at, window)?;
        for iteration in 0..=share {
            if last {
                search.meet(&here);
            }
            if iteration == share || here.loss <= self.learn.target {
                break;
            }
            let rate = optimiser.rate();
            optimiser.descend(&mut search.at, &here.gradient);
            search.at = coordinates.into_domain(&here.parameters, &search.at);
            if (iteration + 1) % share.div_ceil(10) == 0 {
                optimiser.set_rate(rate * decay);
            }
            let mut note = None;
            match self.evaluate(&search.at, window) {
                Ok(found) => here = found,
                Err(error) => {
                    // Back to the last flow that could be trusted, and on more carefully.
                    search.at.copy_from_slice(&here.parameters);
                    optimiser.set_rate(0.5 * optimiser.rate());
                    note = Some(format!("step taken back, rate halved: {error}"));
                }
            }
            (search.index, search.window) = (search.index + 1, window);
            let index = search.index;
            watch(&Iteration { index, window, evaluation: &here, rate, note })?;
        }
        Ok(())
    }

    /// Limited-memory BFGS in the coordinates. An iteration is one evaluation: a trial on a line counts
    /// like any other.
    fn quasi_newton(
        &mut self,
        search: &mut Search,
        window: usize,
        (memory, length): (usize, f64),
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<()> {
        let end = search.index + self.share();
        let coordinates = self.coordinates();
        let mut optimiser = Lbfgs::new(memory);
        let mut here = self.evaluate(&search.at, window)?;
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
                // Once it may be the memory's fault; twice nowhere is the end.
                None => {
                    optimiser.forget();
                    failures += 1;
                }
            }
        }
        search.at.copy_from_slice(&here.parameters);
        if window == self.frames {
            search.meet(&here);
        }
        Ok(())
    }

    /// The first evaluation on a line that satisfies its conditions, or else the last that is lower.
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
            // A length that is too long or too short is a line search's daily bread; a flow that
            // diverged is not.
            let note = trial.as_ref().err().map(|error| format!("trial taken back: {error}"));
            found = trial.ok().filter(|t| t.loss < here.loss).or(found);
            let evaluation = found.as_ref().filter(|_| done).unwrap_or(here);
            let (index, window) = (search.index, line.window);
            watch(&Iteration { index, window, evaluation, rate, note })?;
            if done {
                break;
            }
        }
        Ok(found)
    }

    /// Ends a first-order search with its best evaluation, where the last iteration is another one.
    fn go_back(
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
            watch(&Iteration { index, window, evaluation: &best, rate: 0.0, note })?;
        }
        Ok(best)
    }
}

/// Keeps the parameters that stand at the edge of their domain out of a step.
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

/// A line in the space of the coordinates.
struct Line<'a> {
    coordinates: &'a Coordinates,
    /// The parameters where it begins.
    start: &'a [f64],
    from: &'a [f64],
    direction: &'a [f64],
    /// Frames over which evaluations on it run.
    window: usize,
}

impl Line<'_> {
    /// The parameters at a length; `None` where there are none.
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

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
