//! The law of a flow: which model, with which parameters.

use super::{Flow, Stream, stream};
use crate::models::{Model, Parameter, Parameters};
use crate::systems::acceleration::Law;

impl<const D: usize> Flow<D> {
    /// The model that moves the particles.
    pub fn model(&self) -> &dyn Model<D> {
        &*self.world.resource::<Law<D>>().0
    }

    fn model_mut(&mut self) -> &mut dyn Model<D> {
        &mut *self.world.resource_mut::<Law<D>>().into_inner().0
    }

    /// The physical parameters in force.
    pub fn parameters(&self) -> Parameters<f64> {
        *self.model().parameters()
    }

    /// Puts other physical parameters in force, from the next force evaluation on.
    pub fn set_parameters(&mut self, parameters: Parameters<f64>) {
        self.model_mut().set_parameters(parameters);
    }

    /// The weights of the model's network, none where it has no network.
    pub fn weights(&self) -> Vec<f64> {
        self.model().network().map(|network| network.weights.clone()).unwrap_or_default()
    }

    /// Puts other weights in force, from the next force evaluation on; as many as
    /// [`Flow::weights`] gives.
    pub fn set_weights(&mut self, weights: &[f64]) {
        if let Some(network) = self.model_mut().network_mut() {
            network.weights.copy_from_slice(weights);
        }
    }

    /// The weights that a seed draws for the model's network.
    pub fn draw_weights(&self, seed: u64) -> Vec<f64> {
        let mut generator = stream(seed, Stream::Weights);
        let network = self.model().network();
        network.map(|network| network.shape.initial(&mut generator)).unwrap_or_default()
    }

    /// Puts the values of some parameters in force, and leaves the others as they are.
    pub fn set_learned(&mut self, parameters: &[Parameter], values: &[f64]) {
        let (mut physical, mut weights) = (self.parameters(), self.weights());
        for (&parameter, &value) in parameters.iter().zip(values) {
            match parameter {
                Parameter::Weight(place) => weights[place as usize] = value,
                _ => physical.set(parameter, value),
            }
        }
        self.set_parameters(physical);
        self.set_weights(&weights);
    }
}
