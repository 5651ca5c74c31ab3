//! The parameters of a flow, and the model that accelerates its particles.

use super::{Flow, Stream, stream};
use crate::error::Result;
use crate::models::Model;
use crate::parameters::{Parameter, Parameters};
use crate::systems::acceleration::Laws;
use crate::systems::term::Term;

impl<const D: usize> Flow<D> {
    /// The model that accelerates the particles.
    pub fn model(&self) -> &dyn Model<D> {
        self.world.resource::<Laws<D>>().model()
    }

    /// The terms of the flow, in the order in which those of one phase run.
    pub fn terms(&self) -> impl Iterator<Item = &dyn Term<D>> {
        self.terms.iter().map(|term| &**term)
    }

    /// All parameters with their current values, as one flat vector with names.
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// Sets the values of some parameters, from the next force evaluation on; the others keep
    /// theirs.
    ///
    /// # Errors
    /// [`crate::Error::Input`] for a parameter that no term has.
    pub fn set_learned(&mut self, parameters: &[Parameter], values: &[f64]) -> Result<()> {
        let places = self.places(parameters)?;
        self.set_at(&places, values);
        Ok(())
    }

    /// Places of parameters in the flat vector.
    ///
    /// # Errors
    /// [`crate::Error::Input`] for a parameter that no term has.
    pub fn places(&self, parameters: &[Parameter]) -> Result<Vec<usize>> {
        let place = |name| self.parameters.place(name);
        let found = |name| place(name).ok_or_else(|| self.parameters.unknown(name));
        parameters.iter().map(found).collect()
    }

    /// Sets the values at places of the flat vector.
    pub(crate) fn set_at(&mut self, places: &[usize], values: &[f64]) {
        for (&place, &value) in places.iter().zip(values) {
            self.parameters.set_at(place, value);
        }
        let all: Vec<f64> = self.parameters.values().collect();
        for (term, places) in self.terms.iter().zip(&self.term_places) {
            let own: Vec<f64> = places.iter().map(|&place| all[place]).collect();
            term.set_parameters(&own, &mut self.world);
        }
    }

    /// The weights of the model's network; empty where it has no network.
    pub fn weights(&self) -> Vec<f64> {
        self.model().network().map(|network| network.weights.clone()).unwrap_or_default()
    }

    /// Sets the weights, from the next force evaluation on; the length must be that of
    /// [`Flow::weights`].
    pub fn set_weights(&mut self, weights: &[f64]) {
        let places = self.world.resource::<Laws<D>>().model.weights().to_vec();
        self.set_at(&places, weights);
    }

    /// The random weights of the model's network for a seed.
    pub fn draw_weights(&self, seed: u64) -> Vec<f64> {
        let mut generator = stream(seed, Stream::Weights);
        let network = self.model().network();
        network.map(|network| network.initial(&mut generator)).unwrap_or_default()
    }
}
