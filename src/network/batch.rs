//! Eight inputs at once: the value of a network and its derivatives by reverse mode.
//!
//! Lane `l` of every number belongs to pair (or particle) `l`; weights are the same in all lanes.
//! Everything here is inlined into its caller, which dispatches once to the widest instructions
//! ([`crate::scalar::dispatch`]), and works in a [`Workspace`], so that no call allocates.
//!
//! The form of the loops matters. If the iterations of an innermost loop are independent, the
//! compiler vectorises over them, with gathers, instead of over the lanes, which takes ten times as
//! long. Every innermost loop here is therefore a sum, or walks a matrix with two counters. None
//! steps through a slice in chunks or strides, because computing their number costs a division.

use super::elementary::tanh;
use super::{Layer, LayerMut, Network};
use crate::scalar::{F64x8, SimdFloat};

/// The intermediate values of an evaluation: [`Network::value`] writes them, the derivatives read
/// them.
#[derive(Clone, Debug)]
pub struct Workspace {
    input: Vec<F64x8>,
    /// `y¹`, the first hidden layer.
    first: Vec<F64x8>,
    /// `y²`, the second hidden layer.
    second: Vec<F64x8>,
    output: Vec<F64x8>,
    /// Derivatives by the arguments of the first hidden layer's `tanh`.
    first_cotangent: Vec<F64x8>,
    /// By the arguments of the second layer's.
    second_cotangent: Vec<F64x8>,
    /// One for the output that is differentiated, zero for the others.
    chosen: Vec<F64x8>,
}

impl Workspace {
    /// A workspace for `network`.
    pub fn new(network: &Network) -> Self {
        let zeros = |count: usize| vec![F64x8::ZERO; count];
        Self {
            input: zeros(network.inputs()),
            first: zeros(network.height()),
            second: zeros(network.height()),
            output: zeros(network.outputs()),
            first_cotangent: zeros(network.height()),
            second_cotangent: zeros(network.height()),
            chosen: zeros(network.outputs()),
        }
    }

    /// The last result of [`Network::value`], `[outputs]`.
    #[inline(always)]
    pub fn output(&self) -> &[F64x8] {
        &self.output
    }
}

/// The output of [`Network::pullback`].
#[derive(Debug)]
pub struct Cotangents<'a> {
    /// `[inputs]`: overwritten.
    pub input: &'a mut [F64x8],
    /// `[parameters]`: added to, lane by lane; the caller sums the lanes once, at the end
    /// ([`F64x8::sum`]).
    pub parameters: &'a mut [F64x8],
}

impl Network {
    /// The outputs `[outputs]` for eight inputs `[inputs]`: [`Network::plain`], lane by lane.
    #[inline(always)]
    pub fn value<'w, W: SimdFloat>(
        &self,
        parameters: &[f64],
        input: &[F64x8],
        workspace: &'w mut Workspace,
    ) -> &'w [F64x8] {
        let [first, second, last] = self.layers(parameters);
        workspace.input.copy_from_slice(input);
        first.hidden::<W>(&workspace.input, &mut workspace.first);
        second.hidden::<W>(&workspace.first, &mut workspace.second);
        last.affine::<W>(&workspace.second, &mut workspace.output);
        &workspace.output
    }

    /// The transposed derivative of the last [`Network::value`]: from `λ = ∂L/∂out` `[outputs]`,
    /// computes `∂L/∂in` and adds to `∂L/∂θ`.
    ///
    /// With `λ = 1` it gives both gradients of a network's only output. In forward mode the direct
    /// derivative of `Σⱼ wᵢⱼ NN(ij)` by the parameters is the same sum: pull `wᵢⱼ` back for all
    /// neighbours of one particle, then sum the lanes once.
    #[inline(always)]
    pub fn pullback<W: SimdFloat>(
        &self,
        parameters: &[f64],
        output_cotangent: &[F64x8],
        workspace: &mut Workspace,
        into: Cotangents<'_>,
    ) {
        let layers = self.layers(parameters);
        let [first_into, second_into, last_into] = self.layers_mut(into.parameters);
        pull::<W>(&layers, output_cotangent, workspace);
        last_into.add::<W>(output_cotangent, &workspace.second);
        second_into.add::<W>(&workspace.second_cotangent, &workspace.first);
        first_into.add::<W>(&workspace.first_cotangent, &workspace.input);
        layers[0].transposed::<W>(&workspace.first_cotangent, into.input);
    }

    /// `∂out/∂in` of the last [`Network::value`], row by row, `[outputs × inputs]`.
    #[inline(always)]
    pub fn jacobian<W: SimdFloat>(
        &self,
        parameters: &[f64],
        workspace: &mut Workspace,
        jacobian: &mut [F64x8],
    ) {
        let layers = self.layers(parameters);
        for (output, row) in jacobian.chunks_exact_mut(self.inputs()).enumerate() {
            pull_chosen::<W>(&layers, output, workspace);
            layers[0].transposed::<W>(&workspace.first_cotangent, row);
        }
    }

    /// `∂out/∂θ` of one output of the last [`Network::value`], `[parameters]`: overwrites `gradient`.
    #[inline(always)]
    pub fn parameter_gradient<W: SimdFloat>(
        &self,
        parameters: &[f64],
        output: usize,
        workspace: &mut Workspace,
        gradient: &mut [F64x8],
    ) {
        let layers = self.layers(parameters);
        gradient.fill(F64x8::ZERO);
        let [first_into, second_into, last_into] = self.layers_mut(gradient);
        pull_chosen::<W>(&layers, output, workspace);
        last_into.add::<W>(&workspace.chosen, &workspace.second);
        second_into.add::<W>(&workspace.second_cotangent, &workspace.first);
        first_into.add::<W>(&workspace.first_cotangent, &workspace.input);
    }

    /// Forward mode for one pair and a block of eight parameters: `δout = J δin`, `[outputs]`.
    ///
    /// `jacobian` is that of [`Network::jacobian`], and `lane` the pair's lane in it; the lanes of
    /// `input_tangent` `[inputs]` and of the result are parameters.
    #[inline(always)]
    pub fn tangent<W: SimdFloat>(
        &self,
        jacobian: &[F64x8],
        lane: usize,
        input_tangent: &[F64x8],
        output_tangent: &mut [F64x8],
    ) {
        let rows = jacobian.chunks_exact(self.inputs());
        for (change, row) in output_tangent.iter_mut().zip(rows) {
            let mut sum = W::of(0.0);
            for (slope, x) in row.iter().zip(input_tangent) {
                sum += W::load(x) * slope.lane(lane);
            }
            *change = sum.store();
        }
    }
}

/// From derivatives by the outputs to derivatives by the arguments of each `tanh`.
#[inline(always)]
fn pull<W: SimdFloat>(
    [_, second, last]: &[Layer<'_, f64>; 3],
    cotangent: &[F64x8],
    workspace: &mut Workspace,
) {
    let Workspace { first, second: y2, first_cotangent, second_cotangent, .. } = workspace;
    last.transposed_hidden::<W>(cotangent, y2, second_cotangent);
    second.transposed_hidden::<W>(second_cotangent, first, first_cotangent);
}

/// The same for a single output.
#[inline(always)]
fn pull_chosen<W: SimdFloat>(
    layers: &[Layer<'_, f64>; 3],
    output: usize,
    workspace: &mut Workspace,
) {
    let mut chosen = std::mem::take(&mut workspace.chosen);
    chosen.fill(F64x8::ZERO);
    chosen[output] = W::of(1.0).store();
    pull::<W>(layers, &chosen, workspace);
    workspace.chosen = chosen;
}

impl Layer<'_, f64> {
    /// `W x + b`, unit by unit.
    #[inline(always)]
    fn affine<W: SimdFloat>(&self, x: &[F64x8], units: &mut [F64x8]) {
        let mut rows = self.weights;
        for (unit, &bias) in units.iter_mut().zip(self.bias) {
            let (row, rest) = rows.split_at(x.len());
            *unit = row_times::<W>(row, x, bias).store();
            rows = rest;
        }
    }

    /// `tanh(W x + b)`, unit by unit.
    #[inline(always)]
    fn hidden<W: SimdFloat>(&self, x: &[F64x8], units: &mut [F64x8]) {
        let mut rows = self.weights;
        for (unit, &bias) in units.iter_mut().zip(self.bias) {
            let (row, rest) = rows.split_at(x.len());
            *unit = tanh(row_times::<W>(row, x, bias)).store();
            rows = rest;
        }
    }

    /// `Wᵀ λ`.
    #[inline(always)]
    fn transposed<W: SimdFloat>(&self, cotangent: &[F64x8], into: &mut [F64x8]) {
        let receives = into.len();
        for (column, into) in into.iter_mut().enumerate() {
            *into = self.column_times::<W>(column, receives, cotangent).store();
        }
    }

    /// `Wᵀ λ` times `1 − x²`: the derivative by `z` where the input was `x = tanh z`.
    #[inline(always)]
    fn transposed_hidden<W: SimdFloat>(
        &self,
        cotangent: &[F64x8],
        x: &[F64x8],
        into: &mut [F64x8],
    ) {
        for (column, (into, y)) in into.iter_mut().zip(x).enumerate() {
            let y = W::load(y);
            let received = self.column_times::<W>(column, x.len(), cotangent);
            *into = (received * (W::of(1.0) - y * y)).store();
        }
    }

    /// One column of `W` times `λ`.
    #[inline(always)]
    fn column_times<W: SimdFloat>(&self, column: usize, receives: usize, cotangent: &[F64x8]) -> W {
        let mut sum = W::of(0.0);
        let mut place = column;
        for cotangent in cotangent {
            sum += W::load(cotangent) * self.weights[place];
            place += receives;
        }
        sum
    }
}

/// One row of `W` times `x`, and the bias.
#[inline(always)]
fn row_times<W: SimdFloat>(row: &[f64], x: &[F64x8], bias: f64) -> W {
    let mut sum = W::of(bias);
    for (&weight, x) in row.iter().zip(x) {
        sum += W::load(x) * weight;
    }
    sum
}

impl LayerMut<'_, F64x8> {
    /// `W̄ += λ xᵀ`, `b̄ += λ`.
    #[inline(always)]
    fn add<W: SimdFloat>(self, cotangent: &[F64x8], x: &[F64x8]) {
        let (mut unit, mut column) = (0, 0);
        for weight in self.weights {
            let share = W::load(&cotangent[unit]) * W::load(&x[column]);
            *weight = (W::load(weight) + share).store();
            column += 1;
            if column == x.len() {
                let bias = W::load(&self.bias[unit]) + W::load(&cotangent[unit]);
                self.bias[unit] = bias.store();
                (unit, column) = (unit + 1, 0);
            }
        }
    }
}
