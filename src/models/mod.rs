//! The hierarchy of models, Eqs. (2) to (7): the law by which particles accelerate.
//!
//! A model consists of a function of density for each particle ([`Constitutive`]: `A(ρ)`, called
//! `P/ρ²`) and a force between two particles ([`PairLaw`]), each with its derivatives. The loops
//! over particles, forwards and backwards, follow from these. A model with a force that depends on
//! all neighbours together ([`Node`]) writes its own loops ([`Model`]). The systems call a
//! [`Model`] once per chunk of particles, by a virtual call of negligible cost: each loop is
//! compiled for its law, and the code around it only once.
//!
//! | model | acceleration of particle `i` | features | momentum |
//! |---|---|---|---|
//! | [`Node`], Eq. (2) | `NN(the m nearest rᵢⱼ, vᵢⱼ)` | `2dm` | not conserved |
//! | [`NnSum`], Eq. (3) | `Σⱼ NN(rᵢⱼ, vᵢⱼ)` | `2d` | with `antisymmetric` |
//! | [`RotInv`], Eq. (4) | `Σⱼ NN(Aᵢ, Aⱼ, vᵢⱼ·rᵢⱼ, r) rᵢⱼ` | 4 | with `antisymmetric` |
//! | [`GradP`], Eq. (5) | `−Σⱼ m (NN(rᵢⱼ) + Πᵢⱼ) ∇ᵢWᵢⱼ` | `d` | with `antisymmetric` |
//! | [`EosNn`], Eq. (6) | as `Physics`, with `P = NN(ρ)` | 1 | conserved |
//! | [`Exchange`] | as `Physics`, and `Σⱼ NN(invariants of the pair)` along and across `rᵢⱼ` | 5 | conserved |
//! | [`Physics`], Eq. (7) | `−Σⱼ m (Aᵢ + Aⱼ + Πᵢⱼ) ∇ᵢWᵢⱼ`, `A = P/ρ²` | – | conserved |
//!
//! **Mixed mode.** How each function is differentiated follows from its dimensions:
//!
//! | function | in → out | way |
//! |---|---|---|
//! | Tait's `A(ρ; c, γ)`, `Π` and the kernel | few → 1 | by hand, with dual numbers as the oracle ([`crate::state`], [`crate::viscosity`], [`crate::kernel`]) |
//! | pair force by the pair's state | ≤ `2d + 4` → `d` | one [`Slope`] per pair serves every column |
//! | network by its inputs and weights | many → 1 or `d` | reverse ([`crate::network`]) |
//! | loss by everything | many → 1 | adjoint, or forward for few parameters ([`crate::sensitivity`]) |
//!
//! **A law of your own** between two particles is one function, [`CentralForce`], which dual
//! numbers differentiate. [`crate::scene::Scene::add_pair_law`] adds it to a scene, and its
//! parameters are learned like any other. A law that needs a network, or the last bit of speed,
//! implements [`Constitutive`] and [`PairLaw`], as the models of this folder do.
//!
//! Equation numbers are those of Woodward et al., arXiv:2110.13311: see `docs/equations.md`.

mod central;
mod laminar;
mod medium;
mod pairwise;
mod scales;
mod scratch;
mod slope;
mod tangent;
mod window;

pub use central::{Central, CentralForce};
pub use laminar::{LaminarViscosity, MonaghanCleary, Morris};
pub use medium::{FluidConstants, Medium, PairCoefficient};
#[doc(hidden)]
pub use scales::Scales;
#[doc(hidden)]
pub use scratch::Learned;
pub use scratch::Scratch;
pub use slope::{CentralSlope, Change, GeneralSlope, PairCotangent, Slope, Slots};
use slope::{load_vector, store_vector};
#[doc(hidden)]
pub use tangent::{
    CentralRows, EightPairs, ForceJacobian, Form, GeneralRows, MatrixRows, OwnSlope, PairRows,
};
#[doc(hidden)]
pub use window::Window;

use crate::error::{Error, Result};
use crate::kernel::{AnyKernel, Smoothing};
use crate::packed::PackedAdjoint;
use crate::pairs::{Batch, Neighbourhood};
use crate::parameters::ParameterSpec;
use crate::scalar::{F64x8, SimdFloat};
use crate::scene::nothing_beside;
use crate::sensitivity::Coupling;
use crate::vector::Vector;
use serde::{Deserialize, Serialize};
use std::any::Any;
use std::fmt::Debug;

mod physics;
pub use physics::Physics;

/// The accessors of a model that keeps a `medium` and a `network` under these names.
macro_rules! medium_and_network {
    ($kind:literal) => {
        fn name(&self) -> &str {
            $kind
        }

        fn medium(&self) -> &Medium<D> {
            &self.medium
        }

        fn medium_mut(&mut self) -> &mut Medium<D> {
            &mut self.medium
        }

        fn network(&self) -> Option<&Learned> {
            Some(&self.network)
        }

        fn network_mut(&mut self) -> Option<&mut Learned> {
            Some(&mut self.network)
        }
    };
}

/// The models with a network: each line is a file, a type and a `kind` in scenes.
macro_rules! hierarchy {
    ($($(#[$doc:meta])* $module:ident::$name:ident = $kind:literal;)*) => {
        $(mod $module; pub use $module::$name;)*

        /// The model that a scene learns, with its options.
        #[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
        #[serde(tag = "kind", deny_unknown_fields)]
        pub enum ModelChoice {
            /// [`Physics`].
            #[default]
            #[serde(rename = "physics", deserialize_with = "nothing_beside")]
            Physics,
            $($(#[$doc])* #[serde(rename = $kind)] $name($module::Options),)*
        }

        impl ModelChoice {
            /// Every `kind`.
            pub const KINDS: &'static [&'static str] = &["physics", $($kind),*];

            /// Its `kind` in scenes.
            pub fn kind(&self) -> &'static str {
                match self {
                    Self::Physics => "physics",
                    $(Self::$name(_) => $kind,)*
                }
            }

            /// Units in each hidden layer of its network, where it has one.
            pub fn height_mut(&mut self) -> Option<&mut usize> {
                match self {
                    Self::Physics => None,
                    $(Self::$name(options) => Some(&mut options.height),)*
                }
            }

            fn of<const D: usize>(&self, medium: Medium<D>) -> Result<Box<dyn Model<D>>> {
                Ok(match self {
                    Self::Physics => Box::new(Physics(medium)),
                    $(Self::$name(options) => Box::new($name::new(medium, options)?),)*
                })
            }
        }
    };
}

hierarchy! {
    /// [`EosNn`].
    eos_nn::EosNn = "eos-nn";
    /// [`GradP`].
    grad_p::GradP = "grad-p";
    /// [`RotInv`].
    rot_inv::RotInv = "rot-inv";
    /// [`NnSum`].
    nn_sum::NnSum = "nn-sum";
    /// [`Node`].
    node::Node = "node";
    /// [`Exchange`].
    exchange::Exchange = "exchange";
}

impl ModelChoice {
    /// The model of a fluid.
    ///
    /// It is compiled once for each dimension, in this crate, so that a caller of `Learner<3>` need
    /// not compile every pair loop of every model again.
    ///
    /// # Errors
    /// [`crate::Error::Input`] for options from which no network can be built.
    pub fn build<const D: usize>(&self, medium: Medium<D>) -> Result<Box<dyn Model<D>>> {
        let medium: Box<dyn Any> = Box::new(medium);
        let model: Option<Box<dyn Any>> = match medium.downcast::<Medium<2>>() {
            Ok(medium) => Some(Box::new(self.in_2d(*medium)?)),
            Err(medium) => match medium.downcast::<Medium<3>>() {
                Ok(medium) => Some(Box::new(self.in_3d(*medium)?)),
                Err(_) => None,
            },
        };
        match model.and_then(|model| model.downcast::<Box<dyn Model<D>>>().ok()) {
            Some(model) => Ok(*model),
            None => Err(Error::input("a model", "2 or 3 dimensions", D, "choose one of them")),
        }
    }

    #[inline(never)]
    fn in_2d(&self, medium: Medium<2>) -> Result<Box<dyn Model<2>>> {
        self.of(medium)
    }

    #[inline(never)]
    fn in_3d(&self, medium: Medium<3>) -> Result<Box<dyn Model<3>>> {
        self.of(medium)
    }
}

/// The function `A(ρ)` of each particle, and the constants of the fluid.
pub trait Constitutive<const D: usize>: Debug + Send + Sync {
    /// Mass, kernel and physical parameters.
    fn medium(&self) -> &Medium<D>;

    /// The same, mutable.
    fn medium_mut(&mut self) -> &mut Medium<D>;

    /// Its name: a `kind` in scenes, or the name of a user's law.
    fn name(&self) -> &str {
        "pair law"
    }

    /// Whether the model has a function `A(ρ)`.
    fn has_pressure(&self) -> bool {
        false
    }

    /// The kernel at the scene's smoothing length.
    fn smoothing(&self) -> &Smoothing<AnyKernel, D> {
        &self.medium().smoothing
    }

    /// Mass `m` of every particle.
    fn mass(&self) -> f64 {
        self.medium().mass
    }

    /// Its scalar parameters with their current values: those of the fluid, then its own.
    fn specs(&self) -> Vec<ParameterSpec> {
        self.medium().specs()
    }

    /// Number of its scalar parameters.
    fn scalars(&self) -> usize {
        self.medium().scalars()
    }

    /// Sets the values of its scalar parameters.
    fn set_scalars(&mut self, values: &[f64]) {
        self.medium_mut().set(values);
    }

    /// The network, where there is one.
    fn network(&self) -> Option<&Learned> {
        None
    }

    /// The same, mutable.
    fn network_mut(&mut self) -> Option<&mut Learned> {
        None
    }

    /// The speed of sound at density `rho`, for the Courant number; zero where the model has none.
    /// It must be monotonic in `rho`. The default is that of Tait's fluid, `c ρ^((γ−1)/2)`.
    fn sound_speed(&self, rho: f64) -> f64 {
        let FluidConstants { c, gamma, .. } = self.medium().fluid;
        c.abs() * rho.max(0.0).powf(0.5 * (gamma - 1.0))
    }

    /// `A` of eight particles of density `rho`.
    fn p_over_rho2(&self, rho: F64x8, scratch: &mut Scratch) -> F64x8 {
        let _ = (rho, scratch);
        F64x8::ZERO
    }

    /// `∂A/∂ρ`. Also writes `∂A` by each scalar parameter into `scratch.p_over_rho2_by`, zero for
    /// parameters that `A` does not depend on.
    fn p_over_rho2_slope(&self, rho: F64x8, scratch: &mut Scratch) -> F64x8 {
        let _ = rho;
        scratch.p_over_rho2_by.fill(F64x8::ZERO);
        F64x8::ZERO
    }

    /// Writes `∂A/∂weights` into `scratch.weights`; does nothing where `A` has no network.
    fn p_over_rho2_weights(&self, rho: F64x8, scratch: &mut Scratch) {
        let _ = (rho, scratch);
    }

    /// The transpose of both: from `∂L/∂A` of eight particles, `∂L/∂ρ` through `A`. The derivatives
    /// by parameters and weights are added to the sums in `scratch`.
    fn p_over_rho2_pullback(&self, rho: F64x8, p_over_rho2: F64x8, scratch: &mut Scratch) -> F64x8 {
        let by_density = self.p_over_rho2_slope(rho, scratch);
        for (sum, &by) in scratch.scalars.iter_mut().zip(&scratch.p_over_rho2_by) {
            *sum += by * p_over_rho2;
        }
        by_density * p_over_rho2
    }
}

/// The force between two particles.
pub trait PairLaw<const D: usize>: Constitutive<D> + Clone + 'static {
    /// One number for each of its first scalar parameters, those on which the pair force depends
    /// directly: `[W; P]`.
    type ByParameter<W: SimdFloat>: Slots<W>;
    /// The linearised force.
    type Slope<W: SimdFloat>: Slope<W, D, ByParameter = Self::ByParameter<W>>;

    /// Whether the law holds only plain numbers, except for the table of a tabulated kernel. The
    /// pullback then keeps them in registers.
    const IS_NUMBERS: bool = false;

    /// Whether the force is that of a fluid, Eq. (7), with the law's own [sums](PairLaw::p_over_rho2_sum)
    /// `Aᵢ + Aⱼ`. Its parts and its derivative by the kernel's shape then follow from the
    /// [`Medium`].
    const IS_FLUID: bool = false;

    /// Names of the parts into which reports divide its force.
    const PARTS: &'static [&'static str] =
        if Self::IS_FLUID { &["pressure", "viscosity"] } else { &["pair force"] };

    /// Whether the pair force depends on the model's network.
    const HAS_NETWORK: bool = false;

    /// Whether the pair force depends on the kernel's shape. The shape's parameters are the last of
    /// the law's scalars.
    const HAS_KERNEL: bool = Self::IS_FLUID;

    /// Whether `fᵢⱼ = −fⱼᵢ`: momentum is conserved, and one evaluation gives the force on both
    /// particles.
    fn is_antisymmetric(&self) -> bool;

    /// The sum `X = Aᵢ + Aⱼ` of eight pairs.
    #[inline(always)]
    fn p_over_rho2_sum<W: SimdFloat>(&self, pairs: &Batch<W, D>, scratch: &mut Scratch) -> W {
        let _ = scratch;
        pairs.p_over_rho2_i + pairs.p_over_rho2_j
    }

    /// One of the parts of [`PairLaw::force`].
    #[inline(always)]
    fn part_of_force<W: SimdFloat>(
        &self,
        part: usize,
        pairs: &Batch<W, D>,
        scratch: &mut Scratch,
    ) -> Vector<W, D> {
        if Self::IS_FLUID {
            let p_over_rho2_sum = self.p_over_rho2_sum(pairs, scratch);
            return pairs.separation
                * self.medium().coefficients(&pairs.pair, p_over_rho2_sum)[part];
        }
        self.force(pairs, scratch)
    }

    /// `∂f/∂p` by a parameter of the kernel's shape, where the law [has one](PairLaw::HAS_KERNEL).
    #[inline(always)]
    fn by_kernel<W: SimdFloat>(
        &self,
        pairs: &Batch<W, D>,
        parameter: usize,
        scratch: &mut Scratch,
    ) -> Vector<W, D> {
        if Self::IS_FLUID {
            let p_over_rho2_sum = self.p_over_rho2_sum(pairs, scratch);
            return self.medium().by_kernel(pairs, p_over_rho2_sum, parameter);
        }
        Vector::zero()
    }

    /// The acceleration `fᵢⱼ` of particle `i` by each of eight neighbours.
    fn force<W: SimdFloat>(&self, pairs: &Batch<W, D>, scratch: &mut Scratch) -> Vector<W, D>;

    /// Its derivative by the pair's state.
    fn slope<W: SimdFloat>(&self, pairs: &Batch<W, D>, scratch: &mut Scratch) -> Self::Slope<W>;

    /// From `∂L/∂fᵢⱼ`, the derivatives by the pair's state and by the first parameters, at fixed
    /// `A`. Derivatives by a network's weights are added to `scratch.weights`.
    fn pullback<W: SimdFloat>(
        &self,
        pairs: &Batch<W, D>,
        force: Vector<W, D>,
        scratch: &mut Scratch,
    ) -> PairCotangent<W, D, Self::ByParameter<W>>;
}

/// Which derivatives of a force are computed.
#[derive(Clone, Copy, Debug)]
pub struct TangentOptions<'a> {
    /// All, or only those by particle `i`'s own state.
    pub coupling: Coupling,
    /// Whether the direct derivatives by scalar parameters are needed.
    pub direct: bool,
    /// `∂A/∂ρ` per slot.
    pub p_over_rho2_slopes: &'a [f64],
}

/// The output of a force evaluation, for a chunk of particles.
#[derive(Debug)]
pub struct ForceOutput<'a, const D: usize> {
    /// `a` of each particle.
    pub accelerations: &'a mut [Vector<f64, D>],
    /// Whether forces are added to those of another law.
    pub add: bool,
}

/// The output of the pullback of one chunk's forces, in the order of its slots.
#[derive(Debug)]
pub struct PullbackOutput<'a, const D: usize> {
    /// `∂L/∂r`, added to.
    pub position: &'a mut [Vector<f64, D>],
    /// `∂L/∂v`, added to.
    pub velocity: &'a mut [Vector<f64, D>],
    /// `(∂L/∂A, ∂L/∂ρ)`, added to.
    pub scalars: &'a mut [(f64, f64)],
    /// The shares of neighbours, one for each place in the lists of neighbours within the support;
    /// filled where [`Model::passes_to_neighbours`].
    pub neighbours: &'a mut Vec<PairShare<D>>,
}

/// The part of a pair's cotangent that belongs to particle `j`. It is one cache line in 3D, because
/// `j` reads its shares one by one.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct PairShare<const D: usize> {
    /// `∂L/∂rⱼ`.
    pub position: Vector<f64, D>,
    /// `∂L/∂vⱼ`.
    pub velocity: Vector<f64, D>,
    /// `∂L/∂Aⱼ`.
    pub p_over_rho2: f64,
    /// `∂L/∂ρⱼ`.
    pub density: f64,
}

impl<const D: usize> PairShare<D> {
    /// Zero.
    pub const ZERO: Self = Self {
        position: Vector([0.0; D]),
        velocity: Vector([0.0; D]),
        p_over_rho2: 0.0,
        density: 0.0,
    };
}

/// A law of motion over chunks of particles, as the systems call it. Every [`PairLaw`] is one.
pub trait Model<const D: usize>: Constitutive<D> {
    /// A copy.
    fn boxed(&self) -> Box<dyn Model<D>>;

    /// `aᵢ` of every particle of a chunk.
    fn accelerations(
        &self,
        neighbourhood: Neighbourhood<'_>,
        scratch: &mut Scratch,
        out: ForceOutput<'_, D>,
    );

    /// A scratch buffer to evaluate it in.
    fn scratch(&self) -> Scratch {
        Scratch::new(self.scalars(), self.network())
    }

    /// Names of the parts of its force.
    fn part_names(&self) -> &'static [&'static str];

    /// One of the parts, for every particle of a chunk.
    fn part(
        &self,
        part: usize,
        neighbourhood: Neighbourhood<'_>,
        scratch: &mut Scratch,
        out: &mut [Vector<f64, D>],
    );

    /// The linearised accelerations of a chunk at fixed weights, by the states of its particles and
    /// of their neighbours; overwrites `into`.
    fn slopes(
        &self,
        neighbourhood: Neighbourhood<'_>,
        kept: TangentOptions<'_>,
        scratch: &mut Scratch,
        into: &mut ForceJacobian,
    );

    /// Whether the pair force itself, and not only `A`, depends on the network.
    fn has_force_network(&self) -> bool;

    /// Whether `A` depends on the network.
    fn has_p_over_rho2_network(&self) -> bool {
        self.has_pressure() && self.network().is_some() && !self.has_force_network()
    }

    /// `∂aᵢ/∂weights` at fixed state, `[particle][axis][weight]`, of consecutive particles until
    /// `out` is full, starting from a chunk's particle `first`, a multiple of eight.
    fn weight_shares(
        &self,
        neighbourhood: Neighbourhood<'_>,
        first: usize,
        scratch: &mut Scratch,
        out: &mut [f64],
    );

    /// Whether the pullback writes separate shares for neighbours, because pair forces are not
    /// opposite.
    fn passes_to_neighbours(&self) -> bool;

    /// From `∂L/∂a` (`forces`, per slot) to the derivatives by the state. Derivatives by the
    /// parameters are added to the sums in `scratch`.
    fn pull_back(
        &self,
        neighbourhood: Neighbourhood<'_>,
        forces: &[PackedAdjoint],
        scratch: &mut Scratch,
        into: PullbackOutput<'_, D>,
    );
}
