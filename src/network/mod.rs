//! A multilayer perceptron in place of a law, `Rⁱ → tanh(Rˡ) → tanh(Rˡ) → Rᵒ`.
//!
//! A [`Network`] is a shape; its parameters are one flat slice, so that an optimiser has a vector.
//! [`Network::plain`] is the formula over any [`Scalar`], slow and simple; [`Network::value`] and
//! its derivatives evaluate eight inputs at once, write into a [`Workspace`] and never allocate.

mod batch;
mod elementary;

pub use batch::{Cotangents, Workspace};
pub use elementary::{COUNT, exp, tanh};

use crate::error::{Error, Result};
use crate::scalar::Scalar;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Number of parameters, maximum.
pub const MOST_PARAMETERS: usize = 10_000_000;

/// The shape of a perceptron with two hidden layers of `height` units each:
/// `y¹ = tanh(W¹x + b¹)`, `y² = tanh(W²y¹ + b²)`, `out = W³y² + b³` (section 4.1 of
/// Woodward et al., arXiv:2110.13311).
///
/// Its parameters are one slice, layer by layer: `W¹ [height × inputs]`, `b¹ [height]`,
/// `W² [height × height]`, `b² [height]`, `W³ [outputs × height]`, `b³ [outputs]`. Row `j` of a
/// matrix holds the weights of unit `j`'s inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Network {
    inputs: usize,
    height: usize,
    outputs: usize,
}

/// One layer of a slice in the layout of the parameters.
#[derive(Clone, Copy, Debug)]
struct Layer<'a, T> {
    /// Row by row.
    weights: &'a [T],
    bias: &'a [T],
}

/// The same, mutable.
#[derive(Debug)]
struct LayerMut<'a, T> {
    weights: &'a mut [T],
    bias: &'a mut [T],
}

impl Network {
    /// The shape `inputs → height → height → outputs`.
    ///
    /// # Errors
    /// [`Error::Input`] where one of the three is zero, or the network larger than [`MOST_PARAMETERS`].
    pub fn new(inputs: usize, height: usize, outputs: usize) -> Result<Self> {
        if inputs == 0 || height == 0 || outputs == 0 {
            return Err(Error::input(
                "network",
                "at least one input, one unit and one output",
                format!("{inputs} → {height} → {height} → {outputs}"),
                "give every layer at least one",
            ));
        }
        let count = |units: usize, receives: usize| units.checked_mul(receives.checked_add(1)?);
        let layers = [count(height, inputs), count(height, height), count(outputs, height)];
        let sum = layers.iter().try_fold(0_usize, |sum, &layer| sum.checked_add(layer?));
        if sum.is_none_or(|sum| sum > MOST_PARAMETERS) {
            return Err(Error::input(
                "network",
                format!("at most {MOST_PARAMETERS} parameters"),
                format!("{inputs} → {height} → {height} → {outputs}"),
                "give it less height",
            ));
        }
        Ok(Self { inputs, height, outputs })
    }

    /// Number of inputs.
    #[inline(always)]
    pub fn inputs(&self) -> usize {
        self.inputs
    }

    /// Units in each hidden layer.
    #[inline(always)]
    pub fn height(&self) -> usize {
        self.height
    }

    /// Number of outputs.
    #[inline(always)]
    pub fn outputs(&self) -> usize {
        self.outputs
    }

    /// `(inputs, units)` of each layer.
    #[inline(always)]
    fn shapes(&self) -> [(usize, usize); 3] {
        [(self.inputs, self.height), (self.height, self.height), (self.height, self.outputs)]
    }

    /// Number of parameters, `l(i + 1) + l(l + 1) + o(l + 1)`.
    #[inline(always)]
    pub fn parameter_count(&self) -> usize {
        let [a, b, c] = self.shapes();
        a.1 * (a.0 + 1) + b.1 * (b.0 + 1) + c.1 * (c.0 + 1)
    }

    /// Initial parameters: weights uniform in `±√(6/(inputs + units))` of their layer (Glorot &
    /// Bengio 2010), biases zero. The same generator gives the same numbers on every machine.
    pub fn initial(&self, generator: &mut ChaCha8Rng) -> Vec<f64> {
        let mut parameters = Vec::with_capacity(self.parameter_count());
        for (receives, units) in self.shapes() {
            let bound = (6.0 / (receives + units) as f64).sqrt();
            for _ in 0..receives * units {
                parameters.push(bound * (2.0 * generator.random::<f64>() - 1.0));
            }
            parameters.resize(parameters.len() + units, 0.0);
        }
        parameters
    }

    /// Number of parameters of the last layer, which are the last ones.
    pub fn last_layer(&self) -> usize {
        let [_, _, (receives, units)] = self.shapes();
        units * (receives + 1)
    }

    /// The output for one input, by the formula, over any [`Scalar`]: numbers, or dual numbers for
    /// derivatives.
    ///
    /// It allocates and is not vectorised: the oracle of [`Network::value`]. `parameters` holds
    /// [`Network::parameter_count`] numbers, `input` [`Network::inputs`].
    pub fn plain<T: Scalar>(&self, parameters: &[T], input: &[T]) -> Vec<T> {
        let [first, second, last] = self.layers(parameters);
        let hidden = |layer: Layer<'_, T>, x: &[T]| -> Vec<T> {
            layer.apply(x).into_iter().map(T::tanh).collect()
        };
        last.apply(&hidden(second, &hidden(first, input)))
    }

    /// A slice in the layout of the parameters, layer by layer.
    #[inline(always)]
    fn layers<'a, T>(&self, parameters: &'a [T]) -> [Layer<'a, T>; 3] {
        debug_assert_eq!(parameters.len(), self.parameter_count());
        let [a, b, c] = self.shapes();
        let (first, rest) = Layer::split(parameters, a);
        let (second, rest) = Layer::split(rest, b);
        let (last, _) = Layer::split(rest, c);
        [first, second, last]
    }

    /// The same, mutable.
    #[inline(always)]
    fn layers_mut<'a, T>(&self, parameters: &'a mut [T]) -> [LayerMut<'a, T>; 3] {
        debug_assert_eq!(parameters.len(), self.parameter_count());
        let [a, b, c] = self.shapes();
        let (first, rest) = LayerMut::split(parameters, a);
        let (second, rest) = LayerMut::split(rest, b);
        let (last, _) = LayerMut::split(rest, c);
        [first, second, last]
    }
}

impl<'a, T> Layer<'a, T> {
    #[inline(always)]
    fn split(parameters: &'a [T], (receives, units): (usize, usize)) -> (Self, &'a [T]) {
        let (weights, rest) = parameters.split_at(receives * units);
        let (bias, rest) = rest.split_at(units);
        (Self { weights, bias }, rest)
    }
}

impl<T: Scalar> Layer<'_, T> {
    /// `W x + b`.
    fn apply(&self, x: &[T]) -> Vec<T> {
        let rows = self.weights.chunks_exact(x.len()).zip(self.bias);
        let unit = |(row, &bias): (&[T], &T)| {
            row.iter().zip(x).fold(bias, |sum, (&weight, &x)| sum + weight * x)
        };
        rows.map(unit).collect()
    }
}

impl<'a, T> LayerMut<'a, T> {
    #[inline(always)]
    fn split(parameters: &'a mut [T], (receives, units): (usize, usize)) -> (Self, &'a mut [T]) {
        let (weights, rest) = parameters.split_at_mut(receives * units);
        let (bias, rest) = rest.split_at_mut(units);
        (Self { weights, bias }, rest)
    }
}

#[cfg(test)]
mod tests;
