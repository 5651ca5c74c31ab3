//! Adam (Kingma & Ba 2014).

use super::Descend;

/// Gradient descent with momentum, scaled by the recent size of each component:
/// `m ← β₁m + (1−β₁)g`, `s ← β₂s + (1−β₂)g²`, `x ← x − rate · m̂/(√ŝ + ε)`, with `β₁ = 0.9`,
/// `β₂ = 0.999`, `ε = 1e-8`; hats mark the correction of the bias from starting at zero.
#[derive(Clone, Debug)]
pub struct Adam {
    rate: f64,
    step: i32,
    mean: Vec<f64>,
    square: Vec<f64>,
}

impl Adam {
    /// For `count` parameters.
    pub fn new(rate: f64, count: usize) -> Self {
        Self { rate, step: 0, mean: vec![0.0; count], square: vec![0.0; count] }
    }
}

impl Descend for Adam {
    fn descend(&mut self, parameters: &mut [f64], gradient: &[f64]) {
        const BETA: (f64, f64) = (0.9, 0.999);
        self.step += 1;
        let unbias = (1.0 - BETA.0.powi(self.step), 1.0 - BETA.1.powi(self.step));
        let moments = self.mean.iter_mut().zip(&mut self.square);
        for ((x, &g), (mean, square)) in parameters.iter_mut().zip(gradient).zip(moments) {
            *mean = BETA.0 * *mean + (1.0 - BETA.0) * g;
            *square = BETA.1 * *square + (1.0 - BETA.1) * g * g;
            *x -= self.rate * (*mean / unbias.0) / ((*square / unbias.1).sqrt() + 1e-8);
        }
    }

    fn rate(&self) -> f64 {
        self.rate
    }

    fn set_rate(&mut self, rate: f64) {
        self.rate = rate;
    }
}
