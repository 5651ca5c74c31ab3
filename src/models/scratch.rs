//! A network inside a model, and the scratch buffer in which one thread evaluates it.

use crate::neighbours::near::Near;
use crate::network::{Cotangents, Network, Workspace};
use crate::scalar::{F64x8, SimdFloat, SimdTask, dispatch};
use rand_chacha::ChaCha8Rng;

/// A network with its weights.
#[derive(Clone, Debug)]
pub struct Learned {
    /// Its shape.
    pub shape: Network,
    /// Its parameters, [`Network::parameter_count`] of them.
    pub weights: Vec<f64>,
    /// Whether a search starts with outputs of zero.
    starts_at_zero: bool,
}

/// A thread's scratch buffer to evaluate and differentiate a model; made once, used for every
/// chunk.
#[derive(Clone, Debug, Default)]
pub struct Scratch {
    workspace: Option<Workspace>,
    /// Inputs of the network, `[inputs]`.
    pub input: Vec<F64x8>,
    /// `∂L/∂inputs`.
    pub input_cotangent: Vec<F64x8>,
    /// Outputs of the network, `[outputs]`.
    pub output: Vec<F64x8>,
    /// `∂L/∂outputs`.
    pub output_cotangent: Vec<F64x8>,
    /// `∂outputs/∂inputs`, `[outputs × inputs]`.
    pub jacobian: Vec<F64x8>,
    /// `∂L/∂` of each of the model's scalar parameters, summed lane by lane.
    pub scalars: Vec<F64x8>,
    /// `∂A/∂` of each of them, for eight particles, see [`super::Constitutive::p_over_rho2_slope`].
    pub p_over_rho2_by: Vec<F64x8>,
    /// Sums over the pairs of one particle, see [`super::ForceJacobian`].
    pub(super) direct: Vec<F64x8>,
    /// `∂L/∂weights`, summed lane by lane.
    pub weights: Vec<F64x8>,
    /// `∂aᵢ/∂weights` of a few particles, see [`super::Model::weight_shares`].
    pub shares: Vec<f64>,
    /// Candidates for the nearest neighbours of a particle, by distance, see [`super::Node`].
    pub candidates: Vec<(f64, u32)>,
    /// The nearest neighbours of each of eight particles: places in the lists of `near`.
    pub nearest: Vec<u32>,
    /// The neighbours within the support of the particles of a chunk.
    pub near: Near,
}

impl Scratch {
    /// A buffer for a model with this number of scalar parameters and this network, if any.
    pub fn new(scalars: usize, network: Option<&Learned>) -> Self {
        let zeros = |count: usize| vec![F64x8::ZERO; count];
        let plain =
            Self { scalars: zeros(scalars), p_over_rho2_by: zeros(scalars), ..Self::default() };
        let Some(Learned { shape, weights, .. }) = network else { return plain };
        Self {
            workspace: Some(Workspace::new(shape)),
            input: zeros(shape.inputs()),
            input_cotangent: zeros(shape.inputs()),
            output: zeros(shape.outputs()),
            output_cotangent: zeros(shape.outputs()),
            jacobian: zeros(shape.inputs() * shape.outputs()),
            weights: zeros(weights.len()),
            ..plain
        }
    }

    /// Sets the sums over parameters to zero.
    pub fn clear(&mut self) {
        self.scalars.fill(F64x8::ZERO);
        self.weights.fill(F64x8::ZERO);
    }

    /// Writes the sums over the parameters, scalars first, until `sums` is full.
    pub fn write_sums(&self, into: &mut [f64]) {
        let all = self.scalars.iter().chain(&self.weights);
        into.iter_mut().zip(all).for_each(|(sum, lanes)| *sum = lanes.sum());
    }
}

impl Learned {
    /// A network of a given shape, with all parameters at zero.
    pub fn new(shape: Network) -> Self {
        Self { shape, weights: vec![0.0; shape.parameter_count()], starts_at_zero: false }
    }

    /// The same; a search starts with outputs of zero.
    pub(super) fn at_zero(shape: Network) -> Self {
        Self { starts_at_zero: true, ..Self::new(shape) }
    }

    /// The weights that a search starts with, [`Network::initial`]; those of the last layer are zero where the outputs
    /// are to start at zero.
    pub(crate) fn initial(&self, generator: &mut ChaCha8Rng) -> Vec<f64> {
        let mut weights = self.shape.initial(generator);
        if self.starts_at_zero {
            let first = weights.len() - self.shape.last_layer();
            weights[first..].fill(0.0);
        }
        weights
    }

    /// Evaluates `scratch.output` for `scratch.input`.
    pub fn value(&self, scratch: &mut Scratch) {
        let Some(workspace) = &mut scratch.workspace else { return };
        let (input, output) = (&scratch.input, &mut scratch.output);
        dispatch(Value { network: self, workspace, input, output });
    }

    /// Computes `scratch.jacobian` of the last [`Learned::value`].
    pub fn jacobian(&self, scratch: &mut Scratch) {
        let Some(workspace) = &mut scratch.workspace else { return };
        dispatch(Jacobian { network: self, workspace, into: &mut scratch.jacobian });
    }

    /// The pullback of the last [`Learned::value`]: computes `scratch.input_cotangent` from
    /// `scratch.output_cotangent`, and adds to the sums over weights.
    pub fn pullback(&self, scratch: &mut Scratch) {
        let Some(workspace) = &mut scratch.workspace else { return };
        let into =
            Cotangents { input: &mut scratch.input_cotangent, parameters: &mut scratch.weights };
        let output = &scratch.output_cotangent;
        dispatch(Pullback { network: self, workspace, output, into });
    }

    /// `∂out/∂weights` of one output of the last [`Learned::value`]; overwrites the sums over
    /// weights.
    pub fn weight_gradient(&self, output: usize, scratch: &mut Scratch) {
        let Some(workspace) = &mut scratch.workspace else { return };
        let into = &mut scratch.weights;
        dispatch(WeightGradient { network: self, workspace, output, into });
    }
}

// Each of the four is compiled once for every instruction set, not once for every model and
// dimension that calls it. A call is cheap compared with a network, and compilation is much faster.

struct Value<'a> {
    network: &'a Learned,
    workspace: &'a mut Workspace,
    input: &'a [F64x8],
    output: &'a mut [F64x8],
}

impl SimdTask for Value<'_> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Learned { shape, weights, .. } = self.network;
        self.output.copy_from_slice(shape.value::<W>(weights, self.input, self.workspace));
    }
}

struct Jacobian<'a> {
    network: &'a Learned,
    workspace: &'a mut Workspace,
    into: &'a mut [F64x8],
}

impl SimdTask for Jacobian<'_> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Learned { shape, weights, .. } = self.network;
        shape.jacobian::<W>(weights, self.workspace, self.into);
    }
}

struct Pullback<'a> {
    network: &'a Learned,
    workspace: &'a mut Workspace,
    output: &'a [F64x8],
    into: Cotangents<'a>,
}

impl SimdTask for Pullback<'_> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Learned { shape, weights, .. } = self.network;
        shape.pullback::<W>(weights, self.output, self.workspace, self.into);
    }
}

struct WeightGradient<'a> {
    network: &'a Learned,
    workspace: &'a mut Workspace,
    output: usize,
    into: &'a mut [F64x8],
}

impl SimdTask for WeightGradient<'_> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Learned { shape, weights, .. } = self.network;
        shape.parameter_gradient::<W>(weights, self.output, self.workspace, self.into);
    }
}
