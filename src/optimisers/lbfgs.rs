//! Limited-memory BFGS (Nocedal 1980) with a line search for nonsmooth losses (Lewis & Overton
//! 2013).
//!
//! It is implemented here, as is Levenberg–Marquardt and for the same reasons: every trial costs a
//! flow and its adjoint, may diverge, and must be recorded, while crates that offer it (`argmin`)
//! own the loop.

use super::dot;
use std::collections::VecDeque;

/// The stored curvature of the loss: pairs of steps and changes of the gradient.
#[derive(Clone, Debug)]
pub struct Lbfgs {
    memory: usize,
    /// `(s, y, 1/(s·y))`, the latest last.
    pairs: VecDeque<(Vec<f64>, Vec<f64>, f64)>,
}

impl Lbfgs {
    /// Stores up to `memory` pairs.
    pub fn new(memory: usize) -> Self {
        Self { memory, pairs: VecDeque::new() }
    }

    /// The direction `−H g` by the two-loop recursion; without stored pairs `−g/|g|`.
    pub fn direction(&self, gradient: &[f64]) -> Vec<f64> {
        let mut q: Vec<f64> = gradient.iter().map(|g| -g).collect();
        let Some((s, y, _)) = self.pairs.back() else {
            let size = dot(gradient, gradient).sqrt().max(f64::MIN_POSITIVE);
            q.iter_mut().for_each(|q| *q /= size);
            return q;
        };
        let scale = dot(s, y) / dot(y, y);
        let mut shares = Vec::with_capacity(self.pairs.len());
        for (s, y, inverse) in self.pairs.iter().rev() {
            let share = inverse * dot(s, &q);
            q.iter_mut().zip(y).for_each(|(q, y)| *q -= share * y);
            shares.push(share);
        }
        q.iter_mut().for_each(|q| *q *= scale);
        for ((s, y, inverse), share) in self.pairs.iter().zip(shares.into_iter().rev()) {
            let back = inverse * dot(y, &q);
            q.iter_mut().zip(s).for_each(|(q, s)| *q += (share - back) * s);
        }
        q
    }

    /// Stores the step `s` and the change `y` of the gradient. A pair without positive curvature is
    /// not stored.
    pub fn remember(&mut self, s: Vec<f64>, y: Vec<f64>) {
        let curvature = dot(&s, &y);
        if curvature.is_nan() || curvature <= 1e-12 * (dot(&s, &s) * dot(&y, &y)).sqrt() {
            return;
        }
        if self.pairs.len() == self.memory {
            self.pairs.pop_front();
        }
        self.pairs.push_back((s, y, 1.0 / curvature));
    }

    /// Removes all pairs.
    pub fn forget(&mut self) {
        self.pairs.clear();
    }

    /// Whether no pair is stored.
    pub fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }
}

/// A line search for a length that lowers the loss and the slope enough (weak Wolfe conditions), by
/// doubling and halving, from loss and slope at the start.
#[derive(Clone, Copy, Debug)]
pub struct LineSearch {
    loss: f64,
    slope: f64,
    low: f64,
    high: f64,
    /// The length to try next.
    pub length: f64,
}

impl LineSearch {
    /// From a point of this loss, with this slope along the direction, `< 0`.
    pub fn new(loss: f64, slope: f64, length: f64) -> Self {
        Self { loss, slope, low: 0.0, high: f64::INFINITY, length }
    }

    /// Whether a trial at [`LineSearch::length`] ends the search; if not, the length changes.
    /// `None` is a trial that diverged.
    pub fn accept(&mut self, trial: Option<(f64, f64)>) -> bool {
        match trial {
            Some((loss, slope)) if loss <= self.loss + 1e-4 * self.length * self.slope => {
                if slope >= 0.9 * self.slope {
                    return true;
                }
                self.low = self.length;
            }
            _ => self.high = self.length,
        }
        self.length =
            if self.high.is_finite() { 0.5 * (self.low + self.high) } else { 2.0 * self.length };
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A narrow bent valley (Rosenbrock 1960), minimum 0 at (1, 1).
    fn valley(x: &[f64]) -> (f64, Vec<f64>) {
        let bend = x[1] - x[0] * x[0];
        let loss = 100.0 * bend * bend + (1.0 - x[0]) * (1.0 - x[0]);
        (loss, vec![-400.0 * x[0] * bend - 2.0 * (1.0 - x[0]), 200.0 * bend])
    }

    #[test]
    fn the_floor_of_a_bent_valley_is_reached_in_a_hundred_evaluations() {
        let mut memory = Lbfgs::new(8);
        let mut at = vec![-1.2, 1.0];
        let (mut loss, mut gradient) = valley(&at);
        let mut evaluations = 0;
        while loss > 1e-20 && evaluations < 100 {
            let direction = memory.direction(&gradient);
            let mut line = LineSearch::new(loss, dot(&gradient, &direction), 1.0);
            loop {
                let there: Vec<f64> =
                    at.iter().zip(&direction).map(|(x, d)| x + line.length * d).collect();
                let (new, slopes) = valley(&there);
                evaluations += 1;
                if line.accept(Some((new, dot(&slopes, &direction)))) {
                    let step = there.iter().zip(&at).map(|(a, b)| a - b).collect();
                    let turn = slopes.iter().zip(&gradient).map(|(a, b)| a - b).collect();
                    memory.remember(step, turn);
                    (at, loss, gradient) = (there, new, slopes);
                    break;
                }
            }
        }
        assert!(loss <= 1e-20, "{loss} at {at:?} after {evaluations}");
    }

    #[test]
    fn a_trial_that_diverged_halves_the_length() {
        let mut line = LineSearch::new(1.0, -1.0, 1.0);
        assert!(!line.accept(None));
        assert!((line.length - 0.5).abs() < 1e-15);
        assert!(line.accept(Some((0.6, -0.1))));
    }
}
