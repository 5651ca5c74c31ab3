//! Scenes: everything that defines a run, as typed values that a TOML file spells out.
//!
//! A misspelt key, a wrong type or an impossible number is refused with file, line, what was expected
//! and what to do. The shipped scenes are compiled in; [`Scene::shipped`] finds them by name.

mod check;
mod read;

pub use read::{SHIPPED, Shipped};

use crate::error::{Error, Result};
use crate::forcing::Power;
pub use crate::kernel::KernelName;
use crate::models::{ModelChoice, Parameter, Parameters};
use crate::sensitivity::{Coupling, Gradient, Storage};
use crate::systems::verlet::Step;
use crate::systems::watch::Limits;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// A whole scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scene {
    /// Name, also of the recording it writes.
    pub name: String,
    /// What it shows, in a sentence.
    #[serde(default)]
    pub about: String,
    /// Number of space dimensions, 2 or 3.
    pub dimension: usize,
    /// Seed of everything random: initial state, forcing and guess each draw from a stream of it.
    #[serde(default)]
    pub seed: u64,
    /// The fluid and its law.
    pub fluid: Fluid,
    /// Where particles start.
    #[serde(default)]
    pub initial: Initial,
    /// What stirs the flow.
    #[serde(default)]
    pub forcing: Forcing,
    /// How time passes.
    pub time: Time,
    /// What is learned; a scene without it only simulates.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub learn: Option<Learn>,
    /// What is recorded.
    #[serde(default)]
    pub record: Record,
    /// When a run counts as failed.
    #[serde(default)]
    pub limits: Limits,
}

/// The fluid: particles, kernel and the parameters of Eqs. (20) and (21). Reference density is 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fluid {
    /// Particles along each axis of the initial lattice.
    pub particles_per_side: usize,
    /// Side of the periodic box.
    #[serde(default = "defaults::box_length")]
    pub box_length: f64,
    /// Smoothing length `h`; the kernel's support is `2h`.
    pub smoothing_length: f64,
    /// The kernel.
    #[serde(default)]
    pub kernel: KernelName,
    /// Sound speed `c`.
    pub c: f64,
    /// Linear viscosity `α`.
    pub alpha: f64,
    /// Quadratic viscosity `β`.
    pub beta: f64,
    /// Exponent `γ` of the equation of state.
    pub gamma: f64,
}

/// The initial state: a lattice with its first particle in the corner, shaken.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Initial {
    /// Each coordinate is moved by a uniform number in `±jitter`.
    pub jitter: f64,
    /// Each velocity component is drawn from a normal distribution of this width.
    pub velocity: f64,
}

impl Default for Initial {
    /// The paper's: jitter 0.0025, unit velocities.
    fn default() -> Self {
        Self { jitter: 0.0025, velocity: 1.0 }
    }
}

/// What stirs the flow.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind", deny_unknown_fields)]
pub enum Forcing {
    /// Nothing.
    #[default]
    None,
    /// Energy at a fixed rate, [`crate::forcing::EnergyInjection`].
    Deterministic {
        /// Power `θ`.
        theta: f64,
        /// What `θ` means.
        #[serde(default)]
        power: Power,
    },
    /// Random large-scale modes, [`crate::forcing::stochastic_modes`].
    Stochastic {
        /// Time between two draws of the phases.
        interval: f64,
        /// Factor on the paper's amplitudes.
        #[serde(default = "defaults::one")]
        strength: f64,
    },
}

/// How time passes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Time {
    /// Kind of step.
    #[serde(default)]
    pub step: Step,
    /// The time step; `courant · h/c` where it is not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dt: Option<f64>,
    /// Courant number of the time step.
    #[serde(default = "defaults::courant")]
    pub courant: f64,
    /// Steps that `simulate` runs.
    #[serde(default = "defaults::steps")]
    pub steps: u64,
    /// How far the neighbour lists reach beyond the support, in units of `h`: speed only.
    #[serde(default = "defaults::skin")]
    pub skin: f64,
}

/// What is learned, from what, and how.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Learn {
    /// The model that predicts; all of its network's weights are learned.
    #[serde(default)]
    pub model: ModelChoice,
    /// The physical parameters to learn: any of `c`, `alpha`, `beta`, `gamma`, `theta`.
    #[serde(default)]
    pub parameters: Vec<Parameter>,
    /// Where the search starts; drawn uniformly from `(0, 1)` for a parameter not named here.
    #[serde(default)]
    pub guess: BTreeMap<String, f64>,
    /// Steps of the truth before the first observed state, from which the prediction starts.
    #[serde(default)]
    pub after: u64,
    /// Observed frames, one per step.
    pub frames: usize,
    /// Weights of the losses.
    #[serde(default)]
    pub loss: Weights,
    /// Nodes of the field's mesh along each axis; as many as particles where it is not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mesh: Option<usize>,
    /// Which velocity increments the statistical loss compares, and how.
    #[serde(default)]
    pub increments: Increments,
    /// How the gradient is found; all ways agree to round-off.
    #[serde(default)]
    pub gradient: Gradient,
    /// What an adjoint keeps of the way forward.
    #[serde(default)]
    pub storage: Storage,
    /// Which derivatives the sensitivities keep.
    #[serde(default)]
    pub coupling: Coupling,
    /// How the loss is brought down.
    #[serde(default)]
    pub optimiser: Optimiser,
    /// A search before this one, by another loss or optimiser; its end is where this one starts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warm_up: Option<WarmUp>,
    /// Frames that count, stage by stage: a first short window makes the problem nearly linear.
    /// The last stage is always all frames.
    #[serde(default)]
    pub windows: Vec<usize>,
    /// Most iterations, over all stages.
    #[serde(default = "defaults::iterations")]
    pub iterations: usize,
    /// The loss below which the search ends.
    #[serde(default = "defaults::target")]
    pub target: f64,
}

/// A search before the search, for losses that lead home only from nearby: same model, parameters and
/// frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WarmUp {
    /// Weights of the losses.
    pub loss: Weights,
    /// How the loss is brought down.
    pub optimiser: Optimiser,
    /// As [`Learn::windows`].
    pub windows: Vec<usize>,
    /// As [`Learn::iterations`].
    pub iterations: usize,
    /// As [`Learn::target`].
    pub target: f64,
}

impl Default for WarmUp {
    /// The field loss, by Levenberg–Marquardt.
    fn default() -> Self {
        Self {
            loss: Weights::default(),
            optimiser: Optimiser::default(),
            windows: Vec::new(),
            iterations: defaults::iterations(),
            target: defaults::target(),
        }
    }
}

/// Weights of the losses; one at zero is not computed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Weights {
    /// Of the trajectory loss.
    pub trajectory: f64,
    /// Of the field loss.
    pub field: f64,
    /// Of the statistical loss, which is no sum of squares.
    pub kl: f64,
}

impl Default for Weights {
    fn default() -> Self {
        Self { trajectory: 0.0, field: 1.0, kl: 0.0 }
    }
}

/// What the statistical loss compares: velocity increments `δu(τ) = u(τ) − u(0)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Increments {
    /// Which times `τ` count.
    pub times: Times,
    /// Nodes at which two densities are compared.
    pub nodes: usize,
}

impl Default for Increments {
    /// The paper's: the last time, 200 nodes.
    fn default() -> Self {
        Self { times: Times::Last, nodes: 200 }
    }
}

/// The times of which increments count.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Times {
    /// The last frame of the window (default).
    #[default]
    Last,
    /// Every frame of the window: the integral over time, `Σ dt L_kl`.
    All,
}

impl Learn {
    /// Weight of each frame that counts in the statistical loss, at a time step `dt`.
    pub fn statistical_weight(&self, dt: f64) -> f64 {
        match self.increments.times {
            Times::Last => self.loss.kl,
            Times::All => self.loss.kl * dt,
        }
    }
}

/// How the loss is brought down.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind", deny_unknown_fields)]
pub enum Optimiser {
    /// Second order on the residuals: few iterations, few parameters.
    LevenbergMarquardt {
        /// First damping, relative to the diagonal of the normal matrix.
        #[serde(default = "defaults::damping")]
        damping: f64,
    },
    /// Curvature from the last gradients (limited-memory BFGS): for networks and statistical losses.
    Lbfgs {
        /// How many gradients are remembered.
        #[serde(default = "defaults::memory")]
        memory: usize,
        /// Length of the very first step.
        #[serde(default = "defaults::length")]
        length: f64,
    },
    /// First order with momentum (Kingma & Ba 2014).
    Adam {
        /// Learning rate.
        rate: f64,
        /// Factor on the rate after each tenth of the iterations.
        #[serde(default = "defaults::one")]
        decay: f64,
    },
    /// First order, scaled by the recent size of the gradient.
    Rmsprop {
        /// Learning rate.
        rate: f64,
        /// Factor on the rate after each tenth of the iterations.
        #[serde(default = "defaults::one")]
        decay: f64,
    },
}

impl Default for Optimiser {
    fn default() -> Self {
        Self::LevenbergMarquardt { damping: defaults::damping() }
    }
}

/// What is recorded.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Record {
    /// Every how many steps a frame is kept; 0 keeps none.
    pub every: u64,
    /// Speed at the bright end of the colour scale; twice the initial velocity where it is 0.
    pub speed_scale: f64,
}

impl Default for Record {
    fn default() -> Self {
        Self { every: 1, speed_scale: 0.0 }
    }
}

mod defaults {
    pub(super) fn box_length() -> f64 {
        std::f64::consts::TAU
    }
    pub(super) fn one() -> f64 {
        1.0
    }
    pub(super) fn courant() -> f64 {
        0.4
    }
    pub(super) fn steps() -> u64 {
        200
    }
    pub(super) fn skin() -> f64 {
        0.2
    }
    pub(super) fn iterations() -> usize {
        300
    }
    pub(super) fn target() -> f64 {
        1e-26
    }
    pub(super) fn memory() -> usize {
        30
    }
    pub(super) fn length() -> f64 {
        0.1
    }
    pub(super) fn damping() -> f64 {
        1e-3
    }
}

impl Scene {
    /// What the scene learns.
    ///
    /// # Errors
    /// [`Error::Input`] where it learns nothing.
    pub fn learning(&self) -> Result<&Learn> {
        self.learn.as_ref().ok_or_else(|| {
            Error::input(
                format!("scene {}", self.name),
                "a [learn] table",
                "none",
                "say what is to be learned, or run `simulate`",
            )
        })
    }

    /// The model that the scene learns; that of the truth where it learns nothing.
    pub fn model(&self) -> ModelChoice {
        self.learn.as_ref().map(|learn| learn.model.clone()).unwrap_or_default()
    }

    /// The scene of the warm-up, where there is one: this one with the warm-up's search.
    pub fn warm_up(&self) -> Option<Self> {
        let mut scene = self.clone();
        let learn = scene.learn.as_mut()?;
        let warm_up = learn.warm_up.take()?;
        let WarmUp { loss, optimiser, windows, iterations, target } = warm_up;
        (learn.loss, learn.optimiser, learn.windows) = (loss, optimiser, windows);
        (learn.iterations, learn.target) = (iterations, target);
        learn.gradient = Gradient::Auto;
        Some(scene)
    }

    /// Number of particles `N`.
    pub fn particles(&self) -> usize {
        self.fluid.particles_per_side.pow(self.dimension as u32)
    }

    /// Mass of each particle, `m = ρ₀ Lᵈ/N`.
    pub fn mass(&self) -> f64 {
        self.fluid.box_length.powi(self.dimension as i32) / self.particles() as f64
    }

    /// The time step.
    pub fn dt(&self) -> f64 {
        self.time.dt.unwrap_or(self.time.courant * self.fluid.smoothing_length / self.fluid.c)
    }

    /// The physical parameters that make the truth.
    pub fn parameters(&self) -> Parameters<f64> {
        let theta = match self.forcing {
            Forcing::Deterministic { theta, .. } => theta,
            _ => 0.0,
        };
        let Fluid { c, alpha, beta, gamma, .. } = self.fluid;
        Parameters([c, alpha, beta, gamma, theta])
    }
}
