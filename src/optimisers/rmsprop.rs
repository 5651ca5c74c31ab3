//! RMSprop (Tieleman & Hinton 2012).

use super::Descend;

/// Gradient descent scaled by the recent size of each component:
/// `s ← 0.9s + 0.1g²`, `x ← x − rate · g/(√s + 1e-8)`.
#[derive(Clone, Debug)]
pub struct Rmsprop {
    rate: f64,
    square: Vec<f64>,
}

impl Rmsprop {
    /// For `count` parameters.
    pub fn new(rate: f64, count: usize) -> Self {
        Self { rate, square: vec![0.0; count] }
    }
}

impl Descend for Rmsprop {
    fn descend(&mut self, parameters: &mut [f64], gradient: &[f64]) {
        for ((x, &g), square) in parameters.iter_mut().zip(gradient).zip(&mut self.square) {
            *square = 0.9 * *square + 0.1 * g * g;
            *x -= self.rate * g / (square.sqrt() + 1e-8);
        }
    }

    fn rate(&self) -> f64 {
        self.rate
    }

    fn set_rate(&mut self, rate: f64) {
        self.rate = rate;
    }
}
