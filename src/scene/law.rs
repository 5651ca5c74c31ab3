//! A learned law as a thing of its own: what moves particles, with where it was learned and how well.
//!
//! A law is a TOML file of its own (`export-law` writes one), which a scene names by its path, as in
//! `law = "eos.toml"`, relative to the scene. In the scene it takes the place of the constants of the
//! fluid, the kernel's shape and the laminar viscosity; box, particles, smoothing length, start,
//! forcing and time stay the scene's.

use super::{Fluid, Scene};
use crate::error::{Error, Result};
use crate::flow::Flow;
use crate::kernel::KernelChoice;
use crate::models::{FluidConstants, LaminarViscosity, ModelChoice};
use crate::parameters::Parameter;
use crate::viscosity::effective_nu;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// The version of the file.
const FORMAT: u32 = 1;

/// A learned law.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Law {
    /// Version of this layout: 1.
    pub format: u32,
    /// Its name, that of the scene in which it was learned.
    pub name: String,
    /// Number of space dimensions, 2 or 3.
    pub dimension: usize,
    /// The kernel.
    #[serde(default)]
    pub kernel: KernelChoice,
    /// Weights of its network, in the network's order; none for a law without one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub weights: Vec<f64>,
    /// Its form, with the sizes of a network and the scales of its inputs and outputs.
    pub model: ModelChoice,
    /// The constants of the fluid. The scales of a network are in units of these.
    pub constants: Constants,
    /// Laminar viscosity beside the law.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub viscosity: Option<LaminarViscosity>,
    /// Values of the learned parameters by name, without weights.
    #[serde(default)]
    pub parameters: BTreeMap<String, f64>,
    /// Standard errors, where they are known.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub standard_error: BTreeMap<String, f64>,
    /// Where it was learned, and how well.
    pub learned: Provenance,
}

/// The constants of a fluid, as in a scene's table `fluid`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Constants {
    /// Sound speed `c`.
    pub c: f64,
    /// Linear viscosity `α`.
    pub alpha: f64,
    /// Quadratic viscosity `β`.
    pub beta: f64,
    /// Exponent `γ` of the equation of state.
    pub gamma: f64,
    /// Background pressure `p₀`.
    #[serde(default)]
    pub p0: f64,
}

/// Where a law was learned, and how well.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// Name of the scene.
    pub scene: String,
    /// The recording of the search.
    pub recording: String,
    /// Number of particles.
    pub particles: usize,
    /// Smoothing length `h`.
    pub smoothing_length: f64,
    /// Spacing `Δx` of the particles.
    pub spacing: f64,
    /// Kind of step.
    pub step: String,
    /// Time step.
    pub dt: f64,
    /// Number of steps that were learned from.
    pub steps: u64,
    /// Loss at the end of the search.
    pub loss: f64,
    /// Iterations of the search.
    pub iterations: u64,
    /// Why the search ended, where that is known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stopped_by: Option<String>,
    /// Why a parameter is not identified by the data, by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub doubts: BTreeMap<String, String>,
    /// Version of the program.
    pub version: String,
}

impl Law {
    /// The law that a search in a scene found. The power of a forcing is not part of a law: it is left out.
    pub fn learned_in(scene: &Scene, names: &[Parameter], values: &[f64]) -> Self {
        let (mut parameters, mut weights) = (BTreeMap::new(), Vec::new());
        for (name, &value) in
            names.iter().zip(values).filter(|(name, _)| **name != Parameter::THETA)
        {
            match name.is_weight() {
                true => weights.push(value),
                false => drop(parameters.insert(name.to_string(), value)),
            }
        }
        let model = scene.model();
        let mut constants = Constants::of(&scene.fluid);
        if model == ModelChoice::Physics {
            // Without a network there are no scales: the constants are those that act.
            constants.replace(&parameters);
        }
        let fluid = &scene.fluid;
        Self {
            format: FORMAT,
            name: scene.name.clone(),
            dimension: scene.dimension,
            kernel: fluid.kernel,
            weights,
            model,
            constants,
            viscosity: fluid.viscosity,
            parameters,
            standard_error: BTreeMap::new(),
            learned: Provenance::of(scene),
        }
    }

    /// Reads a file.
    ///
    /// # Errors
    /// [`Error::File`] where it cannot be read, [`Error::Input`] where it is not a law.
    pub fn open(path: &Path) -> Result<Self> {
        let place = path.display().to_string();
        Self::parse(&super::read::text_of(path, "a law")?, &place)
    }

    /// A law from TOML text; `place` names the text in errors.
    ///
    /// # Errors
    /// [`Error::Input`] where it is not a law.
    pub fn parse(text: &str, place: &str) -> Result<Self> {
        let law: Self = toml::from_str(text).map_err(|error| refused(place, &error))?;
        law.check(place)?;
        Ok(law)
    }

    /// A law from a table; `place` names the table in errors.
    ///
    /// # Errors
    /// [`Error::Input`] where it is not a law.
    pub(super) fn of_table(table: &toml::Value, place: &str) -> Result<Self> {
        let law: Self = table.clone().try_into().map_err(|error| refused(place, &error))?;
        law.check(place)?;
        Ok(law)
    }

    fn check(&self, place: &str) -> Result<()> {
        if self.format != FORMAT {
            let remedy = "read it with the version of whirls that wrote it";
            return Err(Error::input(place, "a law of format 1", self.format, remedy));
        }
        let numbers = self.parameters.values().chain(&self.weights);
        if let Some(found) = numbers.copied().find(|x| !x.is_finite()) {
            let remedy = "export it again from its recording";
            return Err(Error::input(place, "finite parameters and weights", found, remedy));
        }
        Ok(())
    }

    /// The law as TOML text, which [`Law::parse`] reads back equal.
    pub fn to_toml(&self) -> String {
        // It holds only strings, numbers and tables: TOML can always write it.
        super::read::with_exponents(&toml::to_string(self).unwrap_or_default())
    }

    /// Gives a flow of the law's model the learned values.
    ///
    /// # Errors
    /// [`Error::Input`] where the flow has no such parameter, or another number of weights.
    pub(crate) fn set<const D: usize>(&self, flow: &mut Flow<D>) -> Result<()> {
        let (names, values): (Vec<Parameter>, Vec<f64>) =
            self.parameters.iter().map(|(name, x)| (Parameter::from(name.clone()), *x)).unzip();
        flow.set_learned(&names, &values)?;
        let expected = flow.weights().len();
        if expected != self.weights.len() {
            return Err(Error::input(
                format!("law {}", self.name),
                format!("{expected} weights of {}", self.model.kind()),
                self.weights.len(),
                "export it again from its recording",
            ));
        }
        flow.set_weights(&self.weights);
        Ok(())
    }

    /// What differs between the place where the law was learned and a scene, as sentences: lengths and
    /// steps to which it is tied.
    pub fn remarks(&self, scene: &Scene) -> Vec<String> {
        let (there, h) = (&self.learned, scene.fluid.smoothing_length);
        let spacing = scene.spacing();
        let kind = self.model.kind();
        let mut all = Vec::new();
        let ratios = [there.smoothing_length / there.spacing, h / spacing];
        if apart(ratios[0], ratios[1]) {
            let [then, now] = ratios;
            let tied = match kind {
                "physics" | "exchange" => "its constants stand for the pressure of these densities",
                "eos-nn" => "its pressure was learned for the densities that this width sums",
                _ => "its sums over neighbours were learned with that number of them",
            };
            all.push(format!(
                "{kind} was learned at h/spacing {then:.3}, and runs at {now:.3}: {tied}"
            ));
        }
        if apart(there.smoothing_length, h) {
            all.push(self.of_lengths(there.smoothing_length, h));
        }
        let (step, dt) = (scene.time.step.name(), scene.dt());
        if step != there.step || apart(dt, there.dt) {
            all.push(format!(
                "{kind} was learned in {} steps of {:.6}, and runs in {step} steps of {dt:.6}: errors of the step for \
                 which it made up stay in it",
                there.step, there.dt
            ));
        }
        all
    }

    /// What a change of the smoothing length means.
    fn of_lengths(&self, then: f64, now: f64) -> String {
        let Constants { c, alpha, .. } = self.constants;
        let alpha = self.parameters.get("alpha").copied().unwrap_or(alpha);
        let ratio = then / self.learned.spacing;
        let nu = |h: f64| effective_nu(self.dimension, ratio, alpha * c * h);
        let kind = self.model.kind();
        match kind {
            "physics" | "eos-nn" => format!(
                "{kind} was learned at h {then:.4}, and runs at {now:.4}: its alpha acts as a viscosity of about {:.2e} \
                 there and {:.2e} here",
                nu(then),
                nu(now)
            ),
            _ => format!(
                "{kind} was learned at h {then:.4}, and runs at {now:.4}: its lengths are in units of h, and its forces \
                 grow like the kernel's slope"
            ),
        }
    }
}

fn refused(place: &str, error: &toml::de::Error) -> Error {
    let found = error.message().trim().replace('\n', " ");
    let remedy = "write one with `export-law LEARNED.mcap --out law.toml`";
    Error::input(place, "a law, as `export-law` writes it", found, remedy)
}

/// Whether two lengths or times differ by more than round-off of their text.
fn apart(a: f64, b: f64) -> bool {
    (a - b).abs() > 1e-9 * a.abs().max(b.abs())
}

impl Constants {
    fn of(fluid: &Fluid) -> Self {
        let FluidConstants { c, alpha, beta, gamma, p0 } = fluid.constants();
        Self { c, alpha, beta, gamma, p0 }
    }

    fn replace(&mut self, by: &BTreeMap<String, f64>) {
        let Self { c, alpha, beta, gamma, p0 } = self;
        let all = [("c", c), ("alpha", alpha), ("beta", beta), ("gamma", gamma), ("p0", p0)];
        for (name, value) in all {
            *value = by.get(name).copied().unwrap_or(*value);
        }
    }
}

impl Provenance {
    fn of(scene: &Scene) -> Self {
        let fluid = &scene.fluid;
        Self {
            scene: scene.name.clone(),
            recording: String::new(),
            particles: scene.particles(),
            smoothing_length: fluid.smoothing_length,
            spacing: scene.spacing(),
            step: scene.time.step.name().to_owned(),
            dt: scene.dt(),
            steps: scene.learn.as_ref().map_or(0, super::Learn::steps),
            loss: 0.0,
            iterations: 0,
            stopped_by: None,
            doubts: BTreeMap::new(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
        }
    }
}

impl Scene {
    /// The keys of a scene's `fluid` that belong to its law, where it has one.
    const OF_A_LAW: [&str; 7] = ["c", "alpha", "beta", "gamma", "p0", "kernel", "viscosity"];

    /// Refuses overrides of keys that a law determines.
    ///
    /// # Errors
    /// [`Error::Input`] for the first of them.
    pub fn leave_to_law(law: &Law, overrides: &[String]) -> Result<()> {
        let is_owned = |assignment: &&String| {
            let key = assignment.split('=').next().unwrap_or_default().trim();
            let own = key.strip_prefix("fluid.").and_then(|key| key.split('.').next());
            own.is_some_and(|key| Self::OF_A_LAW.contains(&key))
        };
        match overrides.iter().find(is_owned) {
            None => Ok(()),
            Some(found) => Err(Error::input(
                format!("--set {found}"),
                format!("a key that law {} leaves to the scene", law.name),
                "one of the law",
                "change it in the file of the law, or run the scene without one",
            )),
        }
    }

    /// The scene with its flow moved by a learned law.
    ///
    /// # Errors
    /// [`Error::Input`] where the law is of another dimension.
    pub fn with_law(mut self, law: Law) -> Result<Self> {
        if law.dimension != self.dimension {
            return Err(Error::input(
                format!("law {} in scene {}", law.name, self.name),
                format!("a law in {} dimensions", self.dimension),
                format!("one in {}", law.dimension),
                "choose a scene of its dimension",
            ));
        }
        let Constants { c, alpha, beta, gamma, p0 } = law.constants;
        let (kernel, viscosity) = (law.kernel, law.viscosity);
        self.fluid = Fluid { c, alpha, beta, gamma, p0, kernel, viscosity, ..self.fluid };
        let origin = format!("scene {} with law {}", self.name, law.name);
        self.law = Some(Box::new(law));
        self.check(&origin)?;
        Ok(self)
    }
}
