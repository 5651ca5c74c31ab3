//! A learned model to be evaluated, read from its recording.

use crate::error::{Error, Result};
use crate::flow::{Flow, State};
use crate::learn::columns;
use crate::parameters::Parameter;
use crate::recording::{Recording, TrainStep};
use crate::scene::{Fluid, Forcing, Learn, Scene, Time};
use crate::systems::loss::Observations;
use std::path::Path;

/// A learned model.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// Its name: the `kind`, or the recording's name where two candidates have the same kind.
    pub name: String,
    /// The scene of the training: its model, and everything that was not learned.
    pub scene: Scene,
    /// The learned parameters, then the weights.
    pub parameters: Vec<Parameter>,
    /// Their values at the end of the search.
    pub values: Vec<f64>,
    /// The last iteration: loss, parts of it, gradient.
    pub last: TrainStep,
    /// Duration of the search in seconds, if it is known; recordings do not contain it.
    pub seconds: Option<f64>,
}

impl Candidate {
    /// Reads a recording of `train`.
    ///
    /// # Errors
    /// [`Error::Input`] where the recording has no iteration, or does not fit the model of its own
    /// scene.
    pub fn open<const D: usize>(path: &Path) -> Result<Self> {
        let recording = Recording::open(path)?;
        let place = path.display().to_string();
        let scene = Scene::parse(&recording.run().scene_toml, &place, &[])?;
        let Some(last) = recording.train_steps()?.pop() else {
            let remedy = "give a file that `train` recorded";
            return Err(Error::input(place, "a search that was recorded", "no iteration", remedy));
        };
        let learn = scene.learning()?;
        let parameters = columns::<D>(&scene, learn)?;
        if parameters.len() != last.parameters.len() {
            return Err(Error::input(
                place,
                format!("{} parameters of {}", parameters.len(), learn.model.kind()),
                last.parameters.len(),
                "train it again with this version",
            ));
        }
        let (name, values) = (learn.model.kind().to_owned(), last.parameters.clone());
        Ok(Self { name, scene, parameters, values, last, seconds: None })
    }

    /// Names candidates of the same kind by their files. Adds folder or number where files have the
    /// same name, or where the name is reserved in recordings.
    pub fn name_apart(candidates: &mut [Self], paths: &[impl AsRef<Path>]) {
        let kinds: Vec<String> = candidates.iter().map(|c| c.name.clone()).collect();
        let mut taken = vec!["truth".to_owned(), "learned".to_owned()];
        for (k, (candidate, path)) in candidates.iter_mut().zip(paths).enumerate() {
            if kinds.iter().filter(|kind| **kind == candidate.name).count() > 1 {
                let part = |part: Option<&std::ffi::OsStr>| {
                    part.map(|part| part.to_string_lossy().into_owned()).unwrap_or_default()
                };
                let stem = part(path.as_ref().file_stem());
                let folder = part(path.as_ref().parent().and_then(Path::file_name));
                let names = [stem.clone(), format!("{folder}-{stem}"), format!("{stem}-{}", k + 1)];
                let free = names.into_iter().find(|name| !taken.contains(name));
                candidate.name = free.unwrap_or_else(|| format!("model-{}", k + 1));
            }
            taken.push(candidate.name.clone());
        }
    }

    /// The settings of its training.
    ///
    /// # Errors
    /// [`Error::Input`] for a scene without a training.
    pub fn learn(&self) -> Result<&Learn> {
        self.scene.learning()
    }

    /// The model in the box, at the resolution and with the steps of a truth. To what a law is tied in another scene is
    /// said by [`crate::scene::Law::remarks`].
    ///
    /// # Errors
    /// [`Error::Input`] for a truth in another dimension, or of another kernel: fields are compared in one.
    pub fn moved_to(self, truth: &Scene) -> Result<Self> {
        let kind = |scene: &Scene| {
            format!("{} dimensions, kernel {}", scene.dimension, scene.fluid.kernel.name())
        };
        let (expected, found) = (kind(truth), kind(&self.scene));
        if expected != found {
            let remedy = "evaluate it against a truth of the kind that it was learned from";
            return Err(Error::input(
                format!("learned model {}", self.name),
                expected,
                found,
                remedy,
            ));
        }
        let own = &self.scene.fluid;
        let fluid = Fluid {
            c: own.c,
            alpha: own.alpha,
            beta: own.beta,
            gamma: own.gamma,
            p0: own.p0,
            kernel: own.kernel,
            viscosity: own.viscosity,
            ..truth.fluid.clone()
        };
        let learn = Learn { every: truth.observed_every(), ..self.learn()?.clone() };
        let scene = Scene {
            name: self.scene.name.clone(),
            fluid,
            time: Time { dt: Some(truth.dt()), ..truth.time.clone() },
            limits: truth.limits,
            learn: Some(learn),
            ..self.scene
        };
        Ok(Self { scene, ..self })
    }

    /// The model's flow from a state, with the forcing of `truth`. The forcing's strength is not
    /// part of what was learned, unless it was learned under the same forcing.
    ///
    /// # Errors
    /// As [`Flow::build`].
    pub fn flow<const D: usize>(
        &self,
        truth: &Scene,
        state: &State<D>,
        observations: Option<Observations<D>>,
    ) -> Result<Flow<D>> {
        let scene = Scene { forcing: truth.forcing.clone(), ..self.scene.clone() };
        let mut flow = Flow::build(&scene, state, None, observations)?;
        let stirred_alike = self.scene.forcing == truth.forcing;
        let (mut parameters, mut values) = (Vec::new(), Vec::new());
        for (parameter, &value) in self.parameters.iter().zip(&self.values) {
            if *parameter != Parameter::THETA || stirred_alike {
                parameters.push(parameter.clone());
                values.push(value);
            }
        }
        flow.set_learned(&parameters, &values)?;
        Ok(flow)
    }

    /// The flow of its law without forcing.
    ///
    /// # Errors
    /// As [`Flow::build`].
    pub fn unstirred<const D: usize>(&self, state: &State<D>) -> Result<Flow<D>> {
        let still = Scene { forcing: Forcing::None, ..self.scene.clone() };
        self.flow(&still, state, None)
    }
}
