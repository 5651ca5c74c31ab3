//! The course of a search: stages of growing windows, each with the scene's optimiser.
//!
//! A search fails only where no parameters at all could be evaluated. If a stage cannot begin where
//! the stage before it ended, it begins at the best parameters for which the flow holds over its
//! window, or it is left out (`start.rs`).

use super::knowledge::Course;
use super::{Evaluation, Iteration, Learner, Outcome};
use crate::error::{Error, Result};
use crate::interrupt;
use crate::optimisers::{Adam, Rmsprop};
use crate::scene::Optimiser;

/// The state of a search.
pub(super) struct Search {
    /// The initial guess.
    pub(super) guess: Vec<f64>,
    /// The guess evaluated over all frames, if the flow does not diverge.
    pub(super) whole: Option<Evaluation>,
    pub(super) at: Vec<f64>,
    /// Iterations before this search.
    pub(super) first: usize,
    pub(super) index: usize,
    /// Window of the last iteration.
    pub(super) window: usize,
    /// The best evaluation over all frames in a first-order search, and its iteration.
    pub(super) best: Option<(usize, Evaluation)>,
    /// Parameters that were best at some time, starting with the guess.
    pub(super) trail: Vec<Vec<f64>>,
    /// Window and last evaluation of the last stage.
    pub(super) reached: Option<(usize, Evaluation)>,
    /// The error that kept the last failed stage from starting.
    pub(super) failure: Option<Error>,
    /// Events that qualify the result.
    pub(super) remarks: Vec<String>,
}

impl Search {
    fn new(guess: Vec<f64>, window: usize, remarks: Vec<String>) -> Self {
        Self {
            at: guess.clone(),
            trail: vec![guess.clone()],
            guess,
            whole: None,
            first: 0,
            index: 0,
            window,
            best: None,
            reached: None,
            failure: None,
            remarks,
        }
    }

    pub(super) fn meet(&mut self, here: &Evaluation) {
        if self.best.as_ref().is_none_or(|(_, best)| here.loss < best.loss) {
            self.best = Some((self.index, here.clone()));
        }
    }

    /// The window of the last stage that was evaluated; zero if there is none.
    fn reached(&self) -> usize {
        self.reached.as_ref().map_or(0, |(window, _)| *window)
    }
}

impl<const D: usize> Learner<D> {
    /// Searches from `guess`, through growing windows, and calls `watch` after each iteration.
    ///
    /// # Errors
    /// [`Error::Diverged`] where neither the guess nor any parameters tried in its place can be
    /// evaluated over any window, and the errors of `watch`.
    pub fn run(
        &mut self,
        guess: Vec<f64>,
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<Outcome> {
        // An interrupted trial is not an iteration.
        let watch = &mut |iteration: &Iteration<'_>| {
            interrupt::check()?;
            watch(iteration)
        };
        let initial = self.learn.initial.clone();
        let first = guess.clone();
        let outcome = match &initial {
            Some(initial) if initial.alone => self.unsearched(guess),
            _ => self.search(guess, watch)?,
        };
        match &initial {
            Some(noise) => self.estimate_first_frames(noise, (&first, outcome), watch),
            None => Ok(outcome),
        }
    }

    /// The search with the first frames as they are.
    fn search(
        &mut self,
        guess: Vec<f64>,
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<Outcome> {
        let mut search = self.begin(guess, watch)?;
        let mut windows = self.learn.windows.clone();
        windows.retain(|&w| w < self.frames);
        windows.push(self.frames);
        let mut learned = None;
        for window in windows {
            let used_up = search.index >= search.first + self.learn.iterations;
            if let (true, Some(before)) = (used_up, learned.take()) {
                search.remarks.push(format!(
                    "all {} iterations (learn.iterations) were used up over the first {before} of {} frames: nothing \
                     was learned from the later ones",
                    self.learn.iterations, self.frames
                ));
            } else if !used_up {
                learned = Some(window);
            }
            self.stage(&mut search, window, watch)?;
        }
        self.reach_farther(&mut search, watch)?;
        self.end(search, watch)
    }

    /// Evaluates the guess, and runs the warm-up.
    fn begin(
        &mut self,
        guess: Vec<f64>,
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<Search> {
        let mut remarks = Vec::new();
        let guess = self.leave_dead_start(guess, &mut remarks);
        let mut search = Search::new(guess, self.frames, remarks);
        // The guess is iteration zero. If its flow diverges over all frames, a shorter window may
        // still work.
        search.whole = self.evaluate(&search.guess, self.frames).ok();
        if let Some(evaluation) = &search.whole {
            let (index, window, rate, note) = (0, self.frames, 0.0, None);
            watch(&Iteration { index, window, evaluation, rate, note, with_first_frames: false })?;
        }
        self.warm_up(&mut search, watch)?;
        Ok(search)
    }

    /// Runs the warm-up's search first; one that diverges is left out.
    fn warm_up(
        &mut self,
        search: &mut Search,
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<()> {
        let Some(before) = &mut self.warm_up else { return Ok(()) };
        let outcome = before.run(search.guess.clone(), &mut |iteration| match iteration.index {
            0 => Ok(()),
            _ => watch(iteration),
        });
        match outcome {
            Ok(outcome) => {
                search.at = outcome.evaluation.parameters;
                search.trail.push(search.at.clone());
                (search.first, search.index) = (outcome.iterations, outcome.iterations);
                search.remarks.extend(outcome.knowledge.remarks);
                Ok(())
            }
            Err(error @ Error::Diverged { .. }) => {
                search.remarks.push(format!("the warm-up is left out: {error}"));
                Ok(())
            }
            Err(error) => Err(error),
        }
    }

    /// One stage, with the scene's optimiser; left out where no parameters hold over its window.
    fn stage(
        &mut self,
        search: &mut Search,
        window: usize,
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<()> {
        let Some(here) = self.start(search, window, watch)? else { return Ok(()) };
        let count = search.at.len();
        let end = match self.learn.optimiser.clone() {
            Optimiser::LevenbergMarquardt { damping } => {
                self.levenberg_marquardt(search, (window, here), damping, watch)?
            }
            Optimiser::Adam { rate, decay } => {
                self.descend(search, (window, here), (Adam::new(rate, count), decay), watch)?
            }
            Optimiser::Rmsprop { rate, decay } => {
                self.descend(search, (window, here), (Rmsprop::new(rate, count), decay), watch)?
            }
            Optimiser::Lbfgs { memory, length } => {
                self.quasi_newton(search, (window, here), (memory, length), watch)?
            }
        };
        search.at.clone_from(&end.parameters);
        search.trail.push(search.at.clone());
        search.reached = Some((window, end));
        Ok(())
    }

    /// If no parameters held over all frames, adds intermediate stages as far as possible.
    fn reach_farther(
        &mut self,
        search: &mut Search,
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<()> {
        let mut low = search.reached();
        let mut more = (self.frames - low) / 2;
        while low > 0 && low < self.frames && more > 0 {
            let window = low + more;
            self.stage(search, window, watch)?;
            if search.reached() == window {
                low = window;
                more = self.frames - low;
            } else {
                more /= 2;
            }
        }
        if low > 0 && low < self.frames {
            let found = &search.failure;
            let why = found.as_ref().map_or_else(String::new, |error| format!(": {error}"));
            search.remarks.push(format!(
                "no parameters held over all {} frames; the result is that of the first {low}{why}",
                self.frames
            ));
        }
        Ok(())
    }

    /// The result, with its knowledge.
    fn end(
        &mut self,
        mut search: Search,
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<Outcome> {
        // Evaluations of an interrupted flow are not results.
        interrupt::check()?;
        let (window, evaluation) = match (search.best.take(), search.reached.take()) {
            (Some(best), _) => (self.frames, self.go_back(&mut search, best, watch)?),
            (None, Some(reached)) => reached,
            (None, None) => {
                return Err(search.failure.unwrap_or_else(|| {
                    let remedy = "give it a window of at least one frame";
                    Error::input("a search", "a stage", "none", remedy)
                }));
            }
        };
        let initial_loss = search.whole.as_ref().map_or(f64::INFINITY, |whole| whole.loss);
        let course = Course {
            guess: &search.guess,
            window,
            is_used_up: search.index >= search.first + self.learn.iterations,
            remarks: search.remarks,
        };
        let knowledge = self.knowledge(&evaluation, course);
        interrupt::check()?;
        Ok(Outcome { evaluation, initial_loss, iterations: search.index, knowledge })
    }
}
