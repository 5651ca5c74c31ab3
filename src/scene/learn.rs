//! The learning part of a scene.

use super::{InitialState, Lessons, StatisticWeights};
use crate::models::ModelChoice;
use crate::parameters::Parameter;
use crate::sensitivity::{Coupling, Gradient, Storage};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// The settings of a training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Learn {
    /// The model that predicts; all of its network's weights are learned.
    #[serde(default)]
    pub model: ModelChoice,
    /// The parameters to learn, by name: `c`, `alpha`, `beta`, `gamma`, `p0`, `theta`, and those of
    /// the scene's other terms, such as `nu` of a laminar viscosity or `drag.k` of a user's term.
    #[serde(default)]
    pub parameters: Vec<Parameter>,
    /// Those of them that may leave their domain during the search. By default `c` and `gamma` stay
    /// positive, `alpha` and `beta` nonnegative.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unbounded: Vec<Parameter>,
    /// The start of the search; parameters not named here are drawn uniformly from `(0, 1)`.
    #[serde(default)]
    pub guess: BTreeMap<String, f64>,
    /// Steps of the truth before the first observed state, from which the prediction starts.
    #[serde(default)]
    pub after: u64,
    /// Observed frames.
    pub frames: usize,
    /// Steps from one observed frame to the next.
    #[serde(default = "defaults::every", skip_serializing_if = "defaults::is_every")]
    pub every: u64,
    /// Weights of the losses.
    #[serde(default)]
    pub loss: Weights,
    /// Nodes of the field's mesh along each axis; by default the number of particles along each
    /// axis.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mesh: Option<usize>,
    /// What the field loss compares with.
    #[serde(default, skip_serializing_if = "FieldTarget::is_default")]
    pub field: FieldTarget,
    /// Which velocity increments the statistical loss compares, and how.
    #[serde(default)]
    pub increments: Increments,
    /// Weights of the losses of statistics.
    #[serde(default, skip_serializing_if = "StatisticWeights::is_none")]
    pub statistics: StatisticWeights,
    /// The mode of differentiation; all modes agree to round-off.
    #[serde(default)]
    pub gradient: Gradient,
    /// What an adjoint keeps during the forward sweep.
    #[serde(default)]
    pub storage: Storage,
    /// Which derivatives the sensitivities include.
    #[serde(default)]
    pub coupling: Coupling,
    /// The optimiser.
    #[serde(default)]
    pub optimiser: Optimiser,
    /// A search before this one, with another loss or optimiser; its end is the start of this one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warm_up: Option<WarmUp>,
    /// Number of frames of each stage: a short first window makes the problem nearly linear. The
    /// last stage always has all frames.
    #[serde(default)]
    pub windows: Vec<usize>,
    /// Number of iterations over all stages, maximum.
    #[serde(default = "defaults::iterations")]
    pub iterations: usize,
    /// The loss below which the search ends.
    #[serde(default = "defaults::target")]
    pub target: f64,
    /// The noise of a measured truth, whose first frame is then estimated together with the parameters.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub initial: Option<InitialState>,
    /// Many windows of one or more truths instead of one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lessons: Option<Lessons>,
}

/// What the field loss compares with.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FieldTarget {
    /// The field that the kernel estimates from the true particles (default).
    #[default]
    Tracers,
    /// The true velocity convolved with the kernel, `û(k) Ŵ(kh)`: known where the truth is a direct numerical
    /// simulation.
    Filtered,
}

impl FieldTarget {
    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
    fn is_default(&self) -> bool {
        *self == Self::Tracers
    }
}

/// A search before the search, for losses that converge only from nearby: same model, parameters
/// and frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WarmUp {
    /// Weights of the losses.
    pub loss: Weights,
    /// The optimiser.
    pub optimiser: Optimiser,
    /// As [`Learn::windows`].
    pub windows: Vec<usize>,
    /// As [`Learn::iterations`].
    pub iterations: usize,
    /// As [`Learn::target`].
    pub target: f64,
}

impl Default for WarmUp {
    /// The field loss, with Levenberg–Marquardt.
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

/// Weights of the losses; a loss of weight zero is not computed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Weights {
    /// Of the trajectory loss.
    pub trajectory: f64,
    /// Of the field loss.
    pub field: f64,
    /// Of the statistical loss, which is not a sum of squares.
    pub kl: f64,
}

impl Default for Weights {
    fn default() -> Self {
        Self { trajectory: 0.0, field: 1.0, kl: 0.0 }
    }
}

/// The settings of the statistical loss of velocity increments `δu(τ) = u(τ) − u(0)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Increments {
    /// Which times `τ` count.
    pub times: Times,
    /// Nodes at which two densities are compared.
    pub nodes: usize,
}

impl Default for Increments {
    /// As in Woodward et al. (arXiv:2110.13311): the last time, 200 nodes.
    fn default() -> Self {
        Self { times: Times::Last, nodes: 200 }
    }
}

/// The times at which increments count.
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
    /// Frames of one step each, from which nothing is learned yet: defaults for everything else.
    pub fn of_frames(frames: usize) -> Self {
        Self {
            model: ModelChoice::default(),
            parameters: Vec::new(),
            unbounded: Vec::new(),
            guess: BTreeMap::new(),
            after: 0,
            frames,
            every: defaults::every(),
            loss: Weights::default(),
            mesh: None,
            field: FieldTarget::default(),
            increments: Increments::default(),
            statistics: StatisticWeights::default(),
            gradient: Gradient::default(),
            storage: Storage::default(),
            coupling: Coupling::default(),
            optimiser: Optimiser::default(),
            warm_up: None,
            windows: Vec::new(),
            iterations: defaults::iterations(),
            target: defaults::target(),
            initial: None,
            lessons: None,
        }
    }

    /// Number of steps from the first state to the last observed one.
    pub fn steps(&self) -> u64 {
        self.frames as u64 * self.every
    }

    /// Weight of each frame that counts in the statistical loss, at a time `interval` between frames.
    pub fn statistical_weight(&self, interval: f64) -> f64 {
        self.loss.kl * self.share_of_a_frame(interval)
    }

    /// Share of each frame that counts in a loss of weight one.
    fn share_of_a_frame(&self, interval: f64) -> f64 {
        match self.increments.times {
            Times::Last => 1.0,
            Times::All => interval,
        }
    }

    /// Weights of each frame that counts in the losses of statistics, at a time `interval` between frames.
    pub fn weights_of_statistics(&self, interval: f64) -> StatisticWeights {
        let share = self.share_of_a_frame(interval);
        let StatisticWeights { energy, flatness, dispersion, spectrum, structure } =
            self.statistics;
        StatisticWeights {
            energy: energy * share,
            flatness: flatness * share,
            dispersion: dispersion * share,
            spectrum: spectrum * share,
            structure: structure * share,
        }
    }
}

/// The optimiser.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind", deny_unknown_fields)]
pub enum Optimiser {
    /// Second order in the residuals: few iterations, for few parameters.
    LevenbergMarquardt {
        /// Initial damping, relative to the diagonal of the normal matrix.
        #[serde(default = "defaults::damping")]
        damping: f64,
    },
    /// Curvature from the last gradients (limited-memory BFGS): for networks and statistical losses.
    Lbfgs {
        /// Number of stored gradients.
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

impl Optimiser {
    /// Whether it is Adam or RMSprop, which compare no two losses.
    pub fn is_first_order(&self) -> bool {
        matches!(self, Self::Adam { .. } | Self::Rmsprop { .. })
    }
}

impl Default for Optimiser {
    fn default() -> Self {
        Self::LevenbergMarquardt { damping: defaults::damping() }
    }
}

mod defaults {
    pub(super) fn every() -> u64 {
        1
    }
    pub(super) fn is_every(every: &u64) -> bool {
        *every == 1
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
    pub(super) fn one() -> f64 {
        1.0
    }
}
