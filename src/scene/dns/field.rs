//! The velocity field of a direct numerical simulation as a table of a scene.

use super::super::defaults;
use crate::dns::{Forcing, Scheme, Settings, Solver, Start, StepSize, Truncation};
use crate::error::Result;
use crate::flow::initial::{Abc, Spectrum};
use crate::forcing::ornstein_uhlenbeck::Settings as Stochastic;
use serde::{Deserialize, Serialize};

/// The velocity field of a direct numerical simulation, see [`crate::dns`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dns {
    /// Nodes along each axis: even, from 8 on, without prime factors above 5.
    pub nodes: usize,
    /// Kinematic viscosity `ν`.
    pub viscosity: f64,
    /// Which wave vectors are kept.
    #[serde(default)]
    pub truncation: Truncation,
    /// The Runge–Kutta scheme.
    #[serde(default)]
    pub scheme: Scheme,
    /// Courant number of a step, `dt Σ|uᵢ|/Δx` at the fastest node.
    #[serde(default = "courant")]
    pub courant: f64,
    /// The time step instead of the Courant number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dt: Option<f64>,
    /// Degree of the splines by which tracers see the velocity: 5, 7 or 9.
    #[serde(default = "spline_degree")]
    pub spline_degree: usize,
    /// What it starts from.
    pub start: FieldStart,
    /// What keeps it going.
    #[serde(default)]
    pub forcing: FieldForcing,
    /// Runs before the first frame, in this order, each from the end of the one before: on a coarser mesh most of the
    /// spin-up costs little.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub spin_up: Vec<Development>,
}

/// A run before the first frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Development {
    /// Nodes along each axis.
    pub nodes: usize,
    /// How long it runs.
    pub time: f64,
}

/// What a velocity field starts from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind", deny_unknown_fields)]
pub enum FieldStart {
    /// Random waves of a given spectrum, [`crate::flow::initial::RandomSolenoidal`].
    RandomSolenoidal {
        /// `E(k)` up to a factor.
        spectrum: Spectrum,
        /// `u'`, the rms of a component.
        #[serde(default = "defaults::one")]
        velocity: f64,
    },
    /// The vortex of Taylor and Green.
    TaylorGreen {
        /// Amplitude `U`.
        #[serde(default = "defaults::one")]
        velocity: f64,
    },
    /// The flow of Arnold, Beltrami and Childress, of three dimensions.
    Abc {
        /// Amplitude `U`.
        #[serde(default = "defaults::one")]
        velocity: f64,
        /// `A`, `B` and `C`.
        #[serde(default)]
        shape: Abc,
    },
    /// Velocities at nodes in a `.npy` file of shape `[D, nodes, nodes(, nodes)]`.
    File {
        /// The file.
        path: std::path::PathBuf,
    },
}

/// What keeps a velocity field going, see [`Forcing`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind", deny_unknown_fields)]
pub enum FieldForcing {
    /// Decay.
    #[default]
    #[serde(deserialize_with = "crate::scene::nothing_beside")]
    None,
    /// `f = A u`.
    Linear {
        /// `A`.
        rate: f64,
    },
    /// `f = θ u/⟨|u|²⟩`.
    LinearPower {
        /// `θ`, per unit mass.
        power: f64,
    },
    /// `f(n) = θ û(n)/Σ |û|²` over `0 < |n| <= band`.
    Band {
        /// `θ`, per unit mass.
        power: f64,
        /// The longest wave vector, in units of `2π/L`.
        #[serde(default = "defaults::band")]
        band: f64,
    },
    /// Random waves with a correlation time.
    OrnsteinUhlenbeck {
        /// `P`, per unit mass.
        power: f64,
        /// `T`.
        correlation_time: f64,
        /// The longest wave vector, in units of `2π/L`.
        #[serde(default = "defaults::band")]
        band: f64,
    },
}

fn courant() -> f64 {
    0.5
}

fn spline_degree() -> usize {
    5
}

/// Share of the correlation time after which amplitudes of the Ornstein–Uhlenbeck forcing are drawn anew.
const DRAWS: f64 = 0.05;

impl Dns {
    /// The settings of a solver on a mesh.
    pub fn settings(&self, nodes: usize, (length, seed): (f64, u64)) -> Settings {
        let forcing = match self.forcing {
            FieldForcing::None => Forcing::None,
            FieldForcing::Linear { rate } => Forcing::Linear { rate },
            FieldForcing::LinearPower { power } => Forcing::LinearPower { power },
            FieldForcing::Band { power, band } => Forcing::Band { power, band },
            FieldForcing::OrnsteinUhlenbeck { power, correlation_time, band } => {
                let settings = Stochastic { power, correlation_time, band };
                Forcing::OrnsteinUhlenbeck { settings, interval: DRAWS * correlation_time, seed }
            }
        };
        Settings {
            nodes,
            length,
            viscosity: self.viscosity,
            forcing,
            truncation: self.truncation,
            scheme: self.scheme,
            step_size: self.dt.map_or(StepSize::Courant(self.courant), StepSize::Fixed),
            spline_degree: self.spline_degree,
        }
    }

    /// The flow after its spin-up, without tracers, in a box of a side and with a seed. `after` is called after each step
    /// with the share of the work that is done. Time goes on from each run to the next.
    ///
    /// # Errors
    /// As [`crate::scene::DnsScene::developed`].
    pub fn developed<const D: usize>(
        &self,
        of: (f64, u64),
        after: &mut dyn FnMut(f64),
    ) -> Result<Solver<D>> {
        let cost = |run: &Development| run.time * (run.nodes as f64).powi(D as i32 + 1);
        let all: f64 = self.spin_up.iter().map(cost).sum();
        let (mut start, mut time, mut done) = (self.start.start::<D>(of.1)?, 0.0, 0.0);
        for run in &self.spin_up {
            let mut solver = Solver::new(self.settings(run.nodes, of), &start)?;
            solver.set_time(time);
            let end = time + run.time;
            solver.advance_with(end, &mut |now| {
                after((done + cost(run) * (1.0 - (end - now) / run.time)) / all);
            })?;
            (time, done) = (end, done + cost(run));
            start = Start::Modes(solver.modes().clone());
        }
        let mut solver = Solver::new(self.settings(self.nodes, of), &start)?;
        solver.set_time(time);
        Ok(solver)
    }
}

impl FieldStart {
    fn start<const D: usize>(&self, seed: u64) -> Result<Start<D>> {
        Ok(match self {
            Self::RandomSolenoidal { spectrum, velocity } => {
                Start::RandomSolenoidal { spectrum: *spectrum, velocity: *velocity, seed }
            }
            Self::TaylorGreen { velocity } => Start::TaylorGreen { velocity: *velocity },
            Self::Abc { shape, velocity } => Start::Abc { shape: *shape, velocity: *velocity },
            #[cfg(feature = "laboratory")]
            Self::File { path } => Start::open(path)?,
            #[cfg(not(feature = "laboratory"))]
            Self::File { path } => {
                let expected = "a build that reads arrays";
                let remedy = "build with the feature laboratory, or give Start::Values";
                return Err(crate::Error::input("dns.start", expected, path.display(), remedy));
            }
        })
    }
}
