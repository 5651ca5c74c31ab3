//! Where a search and its stages begin, and alternatives if the flow diverges there.

use super::search::Search;
use super::{Evaluation, Iteration, Learner};
use crate::error::{Error, Result};
use crate::parameters::Domain;

/// Start value of a positive parameter with a guess of zero or less: the mean of random guesses.
const MIDDLE: f64 = 0.5;

/// Number of times that a diverging guess is halved, maximum.
const HALVINGS: i32 = 20;

/// Number of guesses from other seeds that are tried if all halved guesses diverge.
const DRAWS: u64 = 8;

impl<const D: usize> Learner<D> {
    /// A guess within the domains of its parameters. At the open end of a domain the gradient would
    /// be zero.
    pub(super) fn leave_dead_start(
        &self,
        mut guess: Vec<f64>,
        remarks: &mut Vec<String>,
    ) -> Vec<f64> {
        for (k, value) in guess.iter_mut().enumerate() {
            let spec = &self.flow().parameters().specs()[self.places[k]];
            let free = self.learn.unbounded.contains(&spec.name) && value.is_finite();
            let dead = spec.domain == Domain::Positive && !(*value > 0.0 && value.is_finite());
            if dead && !(free && value.abs() > 0.0) {
                remarks.push(format!(
                    "the guess {} = {value} is one that a search cannot leave: it begins at {MIDDLE}",
                    spec.name
                ));
                *value = MIDDLE;
            }
        }
        guess
    }

    /// The evaluation from which a stage begins: the end of the stage before it or, if the flow
    /// diverges there over this window, the best parameters of the search for which it does not.
    /// None if there are none.
    pub(super) fn start(
        &mut self,
        search: &mut Search,
        window: usize,
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<Option<Evaluation>> {
        let failed = match self.evaluate(&search.at, window) {
            Ok(here) => return self.nearer(search, (window, here), watch).map(Some),
            Err(error @ Error::Diverged { .. }) => error,
            Err(error) => return Err(error),
        };
        let back = self.best_of_trail(search, window);
        let back = match (back, search.reached.is_some()) {
            (None, false) => self.another_guess(search, window),
            (back, _) => back,
        };
        let Some((place, here)) = back else {
            if search.reached.is_some() && window < self.frames {
                search.remarks.push(format!("the stage of {window} frames is left out: {failed}"));
            }
            search.failure = Some(failed);
            return Ok(None);
        };
        let text = format!("over {window} frames {failed}; the search went back to {place}");
        self.go_to(search, (window, &here), text, watch)?;
        Ok(Some(here))
    }

    /// Before the last stage: returns to the guess if the stages so far increased the loss over all
    /// frames.
    fn nearer(
        &mut self,
        search: &mut Search,
        (window, here): (usize, Evaluation),
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<Evaluation> {
        let better = |whole: &&Evaluation| window == self.frames && whole.loss < here.loss;
        let guess = search.whole.as_ref().filter(better).cloned();
        let Some(guess) = guess.filter(|_| self.warm_up.is_none()) else { return Ok(here) };
        let text = format!(
            "the stages before led away from the data: a loss of {:.2e} over all frames, {:.2e} at the guess; the \
             search went back to the guess",
            here.loss, guess.loss
        );
        self.go_to(search, (window, &guess), text, watch)?;
        Ok(guess)
    }

    /// Moves the search to an evaluation, and records that as an iteration with a reason.
    fn go_to(
        &self,
        search: &mut Search,
        (window, evaluation): (usize, &Evaluation),
        text: String,
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<()> {
        search.at.clone_from(&evaluation.parameters);
        search.index += 1;
        search.window = window;
        search.remarks.push(text.clone());
        let (index, rate, note) = (search.index, 0.0, Some(text));
        watch(&Iteration { index, window, evaluation, rate, note, with_first_frames: false })
    }

    /// The evaluation of lowest loss over a window, among the guess and the last best parameters at
    /// distances 1, 2, 4, … in the trail.
    fn best_of_trail(&mut self, search: &Search, window: usize) -> Option<(String, Evaluation)> {
        let last = search.trail.len() - 1;
        let mut places: Vec<usize> =
            (0..).map(|k| 1 << k).take_while(|&back| back <= last).collect();
        places.iter_mut().for_each(|back| *back = last - *back);
        if !places.contains(&0) {
            places.push(0);
        }
        let mut best: Option<(usize, Evaluation)> = None;
        for place in places {
            let at = &search.trail[place];
            let Some(found) = self.evaluate(at, window).ok().filter(|_| *at != search.at) else {
                continue;
            };
            if best.as_ref().is_none_or(|(_, best)| found.loss < best.loss) {
                best = Some((place, found));
            }
        }
        best.map(|(place, found)| match place {
            0 => ("the guess".to_owned(), found),
            _ => (self.in_words(&found.parameters), found),
        })
    }

    /// The first guess that holds over a window: halves of the guess, then guesses of other seeds.
    fn another_guess(&mut self, search: &Search, window: usize) -> Option<(String, Evaluation)> {
        let halves = (1..=HALVINGS).map(|k| {
            let share = 0.5_f64.powi(k);
            search.guess.iter().map(|x| x * share).collect::<Vec<f64>>()
        });
        let draws = (1..=DRAWS).map(|seed| self.draw(seed, false));
        let others: Vec<Vec<f64>> = halves.chain(draws).collect();
        let found = others.iter().find_map(|other| self.evaluate(other, window).ok())?;
        Some((format!("another guess, {}", self.in_words(&found.parameters)), found))
    }
}
