//! The loss over several lessons: `L = (1/n) Σ_k L_k`, with gradients, normal matrices and sums of squares alike.
//!
//! Lessons are evaluated side by side, and added in their order: the result has the same bits for any number of threads.
//! Tested in `tests/lessons.rs`.

use super::prediction::{Prediction, Setting};
use super::{Evaluation, Learner, Squares};
use crate::error::Result;
use crate::flow::in_pool;
use crate::random::{Stream, stream};
use rand::seq::SliceRandom;
use rayon::prelude::*;

/// Evaluations of the lessons at some places, in order.
pub(super) fn evaluate_all<const D: usize>(
    lessons: &mut [Prediction<D>],
    chosen: &[usize],
    setting: &Setting<'_>,
    at: (&[f64], usize),
) -> Result<Evaluation> {
    // A search with one lesson has all threads for its flow.
    if let [only] = lessons {
        return only.evaluate(setting, at);
    }
    let mut lessons: Vec<(usize, &mut Prediction<D>)> = lessons.iter_mut().enumerate().collect();
    lessons.retain(|(place, _)| chosen.is_empty() || chosen.contains(place));
    let each: Vec<Result<Evaluation>> = in_pool(|| {
        let one = |(_, lesson): &mut (usize, &mut Prediction<D>)| lesson.evaluate(setting, at);
        lessons.par_iter_mut().with_max_len(1).map(one).collect()
    });
    // The first lesson that diverges, in order, is the error: not the first in time.
    mean(each.into_iter().collect::<Result<Vec<_>>>()?)
}

/// The mean of evaluations at the same parameters.
fn mean(all: Vec<Evaluation>) -> Result<Evaluation> {
    let share = 1.0 / all.len() as f64;
    let mut all = all.into_iter();
    let Some(mut sum) = all.next() else {
        return Err(crate::Error::input("lessons", "at least one", "none", "give a window"));
    };
    for next in all {
        sum.loss += next.loss;
        sum.trajectory += next.trajectory;
        sum.field += next.field;
        sum.kl += next.kl;
        sum.statistics.iter_mut().zip(&next.statistics).for_each(|(sum, next)| sum.1 += next.1);
        add(&mut sum.gradient, &next.gradient);
        add(&mut sum.normal, &next.normal);
        sum.squares.iter_mut().zip(&next.squares).for_each(|(sum, next)| sum.add(next));
    }
    for part in [&mut sum.loss, &mut sum.trajectory, &mut sum.field, &mut sum.kl] {
        *part *= share;
    }
    sum.statistics.iter_mut().for_each(|part| part.1 *= share);
    sum.gradient.iter_mut().chain(&mut sum.normal).for_each(|x| *x *= share);
    for squares in &mut sum.squares {
        squares.value *= share;
        squares.size *= share;
        squares.normal.iter_mut().for_each(|x| *x *= share);
    }
    Ok(sum)
}

fn add(sum: &mut [f64], next: &[f64]) {
    sum.iter_mut().zip(next).for_each(|(sum, next)| *sum += next);
}

impl Squares {
    /// Adds those of another lesson. Numbers of residuals add up, too, and are not divided afterwards.
    fn add(&mut self, next: &Self) {
        self.value += next.value;
        self.count += next.count;
        self.size += next.size;
        add(&mut self.normal, &next.normal);
    }
}

/// Batches of lessons in a random order, in which each lesson has its turn before one has a second.
pub(super) struct Batches {
    seed: u64,
    lessons: usize,
    size: usize,
}

impl Batches {
    pub(super) fn new(seed: u64, (lessons, size): (usize, usize)) -> Self {
        Self { seed, lessons, size }
    }

    /// The lessons of an iteration, in order. The last batch of a round takes what is left.
    fn of(&self, iteration: usize) -> Vec<usize> {
        let rounds = self.lessons.div_ceil(self.size);
        let (round, part) = (iteration / rounds, iteration % rounds);
        let mut order: Vec<usize> = (0..self.lessons).collect();
        order.shuffle(&mut stream(self.seed.wrapping_add(round as u64), Stream::Lessons));
        let from = part * self.size;
        let mut batch = order[from..(from + self.size).min(self.lessons)].to_vec();
        batch.sort_unstable();
        batch
    }
}

impl<const D: usize> Learner<D> {
    /// Chooses the lessons of the next evaluation: a batch, or all of them where `whole` is set or the scene asks for
    /// none. Returns whether they are all.
    pub(super) fn choose(&mut self, iteration: usize, whole: bool) -> bool {
        self.chosen = match &self.batches {
            Some(batches) if !whole => batches.of(iteration),
            _ => Vec::new(),
        };
        self.chosen.is_empty()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn in_each_round_each_lesson_has_one_turn() {
        let batches = Batches::new(7, (10, 4));
        for round in 0..5 {
            let mut all: Vec<usize> = (0..3).flat_map(|k| batches.of(3 * round + k)).collect();
            all.sort_unstable();
            assert_eq!(all, (0..10).collect::<Vec<_>>());
        }
        assert_ne!(batches.of(0), batches.of(3), "the order changes from round to round");
    }
}
