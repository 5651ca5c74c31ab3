//! Scenes: the complete definition of a run, as typed values of a TOML file.
//!
//! A misspelt key, a wrong type or an impossible number is refused with file, line, what was
//! expected and what to do. The shipped scenes are compiled in; [`Scene::shipped`] finds them by
//! name.
//!
//! Equation numbers are those of Woodward et al., arXiv:2110.13311 ("the paper"): see `docs/equations.md`.

mod accuracy;
mod check;
mod check_learn;
pub mod dns;
mod guests;
mod initial_state;
mod law;
mod learn;
mod lessons;
mod read;
mod statistics;
mod suggest;

pub use accuracy::{CalibratedStep, Speed};
pub(crate) use check::Requirement;
pub use dns::DnsScene;
pub use guests::{Guests, Values};
pub use initial_state::InitialState;
pub use law::{Constants, Law, Provenance};
pub use learn::{FieldTarget, Increments, Learn, Optimiser, Times, WarmUp, Weights};
pub use lessons::{FurtherTruth, Lessons};
pub use read::{AnyScene, SHIPPED, SHIPPED_DNS, Shipped};
pub use statistics::StatisticWeights;

use crate::error::{Error, Result};
use crate::flow::initial::Field;
use crate::forcing::Power;
pub use crate::kernel::{KernelChoice, KernelName};
use crate::models::{FluidConstants, LaminarViscosity, ModelChoice};
use crate::parameters::{Parameter, ParameterSpec, Parameters};
pub use crate::scalar::Precision;
use crate::sensitivity::Gradient;
pub use crate::space::Axis;
use crate::space::Space;
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
    /// Its description in a sentence.
    #[serde(default)]
    pub about: String,
    /// Number of space dimensions, 2 or 3.
    pub dimension: usize,
    /// Seed of all random numbers: initial state, forcing and guess each draw from a stream of it.
    #[serde(default)]
    pub seed: u64,
    /// The precision in which pairs are evaluated.
    #[serde(default)]
    pub precision: Precision,
    /// Requested accuracy: distance of particles from a much finer run after twenty steps, in
    /// smoothing lengths (root mean square). Kind of step and time step are then chosen, see
    /// [`crate::trade::calibrate_step`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub accuracy: Option<f64>,
    /// The same by name.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub speed: Option<Speed>,
    /// The chosen step, if any: written by the run, not by hand.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub chosen: Option<CalibratedStep>,
    /// The fluid and its law.
    pub fluid: Fluid,
    /// The initial state.
    #[serde(default)]
    pub initial: Initial,
    /// A run before the first step.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spin_up: Option<SpinUp>,
    /// The forcing.
    #[serde(default)]
    pub forcing: Forcing,
    /// A user's terms by name, with the values of their parameters; their code is added by
    /// [`Scene::add_force`] and similar functions.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub terms: BTreeMap<String, Values>,
    /// Their code.
    #[serde(skip)]
    pub guests: Guests,
    /// A learned law that moves the flow in place of Eq. (7); in a file also the path of a law, relative to the file.
    /// The constants of `fluid` are then those of the law.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub law: Option<Box<Law>>,
    /// The time integration.
    pub time: Time,
    /// Where the truth of the training comes from; by default from the scene's own law.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub truth: Option<dns::TruthSource>,
    /// The training; a scene without it only simulates.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub learn: Option<Learn>,
    /// What is recorded.
    #[serde(default)]
    pub record: Record,
    /// Limits beyond which a run fails.
    #[serde(default)]
    pub limits: Limits,
}

/// The fluid: particles, kernel and the parameters of Eqs. (20) and (21). Reference density is 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Fluid {
    /// Particles of the initial lattice along the first axis, and along the others where all sides
    /// are equal; else each side holds as many as the same spacing makes of it.
    pub particles_per_side: usize,
    /// Side of the box; where `sides` are given, the first of them.
    #[serde(default = "defaults::box_length")]
    pub box_length: f64,
    /// The sides of the box, where they are not all equal: one number for each axis.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sides: Vec<f64>,
    /// The kind of each axis, `"periodic"` or `"open"`; without it all are periodic.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub boundary: Vec<Axis>,
    /// Smoothing length `h`; the kernel's support is `2h`.
    pub smoothing_length: f64,
    /// The kernel.
    #[serde(default)]
    pub kernel: KernelChoice,
    /// Sound speed `c`.
    pub c: f64,
    /// Linear viscosity `α`.
    pub alpha: f64,
    /// Quadratic viscosity `β`.
    pub beta: f64,
    /// Exponent `γ` of the equation of state.
    pub gamma: f64,
    /// Laminar viscosity, beside the artificial one of `alpha` and `beta`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub viscosity: Option<LaminarViscosity>,
    /// Background pressure `p₀`, added to the equation of state.
    #[serde(default, skip_serializing_if = "defaults::is_zero")]
    pub p0: f64,
}

impl Fluid {
    /// The constants of the fluid.
    pub fn constants(&self) -> FluidConstants {
        let Self { c, alpha, beta, gamma, p0, .. } = *self;
        FluidConstants { c, alpha, beta, gamma, p0 }
    }
}

/// The initial state: a lattice with its first particle in the corner, perturbed, and the
/// velocities of a field at the perturbed positions.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Initial {
    /// Perturbation: each coordinate is moved by a uniform random number in `±jitter`.
    pub jitter: f64,
    /// Amplitude of the velocity field: standard deviation of the normal distribution, largest
    /// velocity `U` of Taylor–Green, factor on the ABC flow, rms `u'` of one component of the
    /// random solenoidal field.
    pub velocity: f64,
    /// The velocity field, [`crate::flow::initial`]: a table, or only its name.
    #[serde(
        skip_serializing_if = "Field::is_default",
        deserialize_with = "Field::by_table_or_name"
    )]
    pub field: Field,
}

impl Default for Initial {
    /// As in the paper: jitter 0.0025, normal velocities of unit standard deviation.
    fn default() -> Self {
        Self { jitter: 0.0025, velocity: 1.0, field: Field::default() }
    }
}

/// A run before the run, with its own forcing, so that the flow starts developed: its end is step
/// zero.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SpinUp {
    /// Number of steps.
    pub steps: u64,
    /// Its forcing.
    pub forcing: Forcing,
}

/// The forcing.
#[derive(Clone, Debug, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind", deny_unknown_fields)]
pub enum Forcing {
    /// No forcing.
    #[default]
    #[serde(deserialize_with = "nothing_beside")]
    None,
    /// Energy injection at a constant rate, [`crate::forcing::EnergyInjection`].
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
    /// Random large-scale waves with a correlation time, [`crate::forcing::ornstein_uhlenbeck`].
    OrnsteinUhlenbeck {
        /// Power per unit mass `P`, for a flow in which large eddies live longer than the
        /// correlation time.
        power: f64,
        /// Correlation time `T`.
        correlation_time: f64,
        /// The longest wave vector, in units of `2π/L`.
        #[serde(default = "defaults::band")]
        band: f64,
    },
}

/// The time integration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Time {
    /// Kind of step.
    #[serde(default)]
    pub step: Step,
    /// The time step; by default `courant · h/c`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dt: Option<f64>,
    /// Courant number of the time step.
    #[serde(default = "defaults::courant")]
    pub courant: f64,
    /// Number of steps of `simulate`.
    #[serde(default = "defaults::steps")]
    pub steps: u64,
    /// How much farther than the support the neighbour lists reach, in units of `h`; it affects
    /// only the speed. The default is [`Scene::usual_skin`].
    #[serde(default)]
    pub skin: f64,
}

/// What is recorded.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Record {
    /// Number of steps between two recorded frames; 0 records none.
    pub every: u64,
    /// Number of recorded frames between two records of each system's rate of momentum, which take
    /// two force evaluations; 0 records none.
    pub momentum_every: u64,
    /// Speed at the bright end of the colour scale; 0 means twice the initial velocity.
    pub speed_scale: f64,
    /// Parameters by which `train` records the derivatives of every particle's position, velocity and density, on
    /// `/learned/sensitivity/NAME`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub sensitivity: Vec<Parameter>,
    /// Whether `train` records the derivatives of the loss by every particle's position and velocity, on
    /// `/learned/adjoint`.
    #[serde(skip_serializing_if = "initial_state::is_false")]
    pub adjoint: bool,
}

impl Default for Record {
    fn default() -> Self {
        Self {
            every: 1,
            momentum_every: 50,
            speed_scale: 0.0,
            sensitivity: Vec::new(),
            adjoint: false,
        }
    }
}

impl Record {
    /// Whether a step is recorded.
    pub fn keeps(&self, step: u64) -> bool {
        self.every > 0 && step.is_multiple_of(self.every)
    }

    /// Whether a recorded step has the rate of momentum of each system.
    pub fn splits_momentum(&self, step: u64) -> bool {
        self.keeps(step)
            && self.momentum_every > 0
            && (step / self.every).is_multiple_of(self.momentum_every)
    }
}

/// Reads the other keys of a `kind` that has none, and refuses any.
pub(crate) fn nothing_beside<'de, R: serde::Deserializer<'de>>(
    reader: R,
) -> std::result::Result<(), R::Error> {
    /// A table without keys.
    #[derive(Deserialize)]
    #[serde(deny_unknown_fields)]
    struct Nothing {}
    Nothing::deserialize(reader).map(|Nothing {}| ())
}

mod defaults {
    pub(super) fn box_length() -> f64 {
        std::f64::consts::TAU
    }
    #[expect(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
    pub(super) fn is_zero(x: &f64) -> bool {
        x.to_bits() == 0
    }
    pub(super) fn one() -> f64 {
        1.0
    }
    pub(super) fn band() -> f64 {
        2.5
    }
    pub(super) fn courant() -> f64 {
        0.4
    }
    pub(super) fn steps() -> u64 {
        200
    }
}

impl Scene {
    /// The training settings.
    ///
    /// # Errors
    /// [`Error::Input`] for a scene that learns nothing.
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

    /// The model that the scene learns; without a training, that of the truth.
    pub fn model(&self) -> ModelChoice {
        self.learn.as_ref().map(|learn| learn.model.clone()).unwrap_or_default()
    }

    /// The scene of the warm-up, if there is one: this one with the search of the warm-up.
    pub fn warm_up(&self) -> Option<Self> {
        let mut scene = self.clone();
        let learn = scene.learn.as_mut()?;
        let warm_up = learn.warm_up.take()?;
        let WarmUp { loss, optimiser, windows, iterations, target } = warm_up;
        (learn.loss, learn.optimiser, learn.windows) = (loss, optimiser, windows);
        (learn.iterations, learn.target) = (iterations, target);
        learn.gradient = Gradient::Auto;
        learn.initial = None;
        learn.lessons.iter_mut().for_each(|lessons| lessons.batch = None);
        Some(scene)
    }

    /// The scene of the spin-up, if there is one: this one with the forcing of the spin-up.
    pub fn before_start(&self) -> Option<(Self, u64)> {
        let mut scene = self.clone();
        let SpinUp { steps, forcing } = scene.spin_up.take()?;
        scene.forcing = forcing;
        Some((scene, steps))
    }

    /// The box: a length and a kind for each axis.
    pub fn space(&self) -> Space {
        let mut sides = [self.fluid.box_length; 3];
        sides.iter_mut().zip(&self.fluid.sides).for_each(|(side, own)| *side = *own);
        let mut axes = [Axis::Periodic; 3];
        axes.iter_mut().zip(&self.fluid.boundary).for_each(|(axis, own)| *axis = *own);
        Space::new(sides, axes)
    }

    /// The box in words: its side, or the sides and the kinds of its axes.
    pub fn box_words(&self) -> String {
        let (fluid, axes) = (&self.fluid, self.dimension.min(3));
        let side = match fluid.sides.is_empty() {
            true => fluid.box_length.to_string(),
            false => format!("{:?}", fluid.sides),
        };
        let space = self.space();
        let open =
            (0..axes).filter(|&axis| !space.is_periodic(axis)).map(|axis| ["x", "y", "z"][axis]);
        match open.collect::<Vec<_>>().join(" and ") {
            none if none.is_empty() => side,
            open => format!("{side}, open along {open}"),
        }
    }

    /// The shortest period of the box; infinite where no axis is periodic.
    pub fn shortest_period(&self) -> f64 {
        let space = self.space();
        if self.dimension == 2 {
            space.shortest_period::<2>()
        } else {
            space.shortest_period::<3>()
        }
    }

    /// Whether the box is a square or a cube.
    pub fn has_equal_sides(&self) -> bool {
        let first = self.fluid.box_length;
        self.fluid.sides.iter().all(|side| side.to_bits() == first.to_bits())
    }

    /// Distance of the particles in the initial lattice.
    pub fn spacing(&self) -> f64 {
        self.fluid.box_length / self.fluid.particles_per_side as f64
    }

    /// Particles of the initial lattice along each axis; 1 along axes that the flow does not have.
    pub fn lattice(&self) -> [usize; 3] {
        let mut counts = [self.fluid.particles_per_side; 3];
        let spacing = self.spacing();
        for (count, side) in counts.iter_mut().zip(&self.fluid.sides) {
            *count = (side / spacing).round() as usize;
        }
        counts[self.dimension.min(3)..].fill(1);
        counts
    }

    /// Number of particles `N`.
    pub fn particles(&self) -> usize {
        self.lattice().iter().product()
    }

    /// Volume of the box, in 2D its area.
    pub fn volume(&self) -> f64 {
        let space = self.space();
        if self.dimension == 2 { space.volume::<2>() } else { space.volume::<3>() }
    }

    /// Mass of each particle, `m = ρ₀ V/N`.
    pub fn mass(&self) -> f64 {
        self.volume() / self.particles() as f64
    }

    /// The default skin of a scene, in units of `h`: 0.26 particle spacings in three dimensions,
    /// 0.2 in two.
    ///
    /// Neighbours separate by about a tenth of a spacing per step, so that lists are valid for two
    /// or three steps. A larger skin costs more in every density than it saves in rebuilds;
    /// `tests/measure/README.md` has the times.
    pub fn usual_skin(&self) -> f64 {
        let spacing = self.spacing();
        let spacings = if self.dimension == 3 { 0.26 } else { 0.2 };
        spacings * spacing / self.fluid.smoothing_length
    }

    /// The time step: by default `courant · h/c`, or `h²/8ν` of a laminar viscosity if that is less
    /// (Morris, Fox & Zhu 1997).
    pub fn dt(&self) -> f64 {
        let h = self.fluid.smoothing_length;
        let acoustic = self.time.courant * h / self.fluid.c;
        let nu = self.fluid.viscosity.map_or(0.0, LaminarViscosity::nu);
        self.time.dt.unwrap_or(if nu > 0.0 { acoustic.min(0.125 * h * h / nu) } else { acoustic })
    }

    /// The parameters of the truth, without weights: those of the fluid, of the forcing and of the
    /// scene's terms.
    pub fn parameters(&self) -> Parameters {
        let mut specs = self.fluid.constants().specs().to_vec();
        specs.extend(self.fluid.kernel.specs());
        specs.extend(self.fluid.viscosity.map(LaminarViscosity::spec));
        if let Forcing::Deterministic { theta, .. } = self.forcing {
            specs.push(ParameterSpec::new(Parameter::THETA, theta));
        }
        for (term, values) in &self.terms {
            let own = |(name, &value): (&String, &f64)| {
                ParameterSpec::new(Parameter::from(format!("{term}.{name}")), value)
            };
            specs.extend(values.iter().map(own));
        }
        // A single owner cannot give a parameter two values.
        Parameters::merged(&[specs]).map(|(all, _)| all).unwrap_or_default()
    }
}
