//! The hierarchy of models, Eqs. (2) to (7): which law moves the particles.
//!
//! A model says what a particle is by itself ([`Constitutive`]: its *stress*, what it brings to its
//! pairs) and what two particles do to each other ([`PairLaw`]), each with its derivatives; the loops
//! over particles, forwards and backwards, follow from that. A model whose particles see all their
//! neighbours at once ([`Node`]) writes its loops itself ([`Model`]). The systems call a [`Model`] once
//! per chunk of particles, by a virtual call that nobody notices: each loop is compiled for its law,
//! everything around it once.
//!
//! | model | acceleration of particle `i` | features | momentum |
//! |---|---|---|---|
//! | [`Node`], Eq. (2) | `NN(the m nearest rᵢⱼ, vᵢⱼ)` | `2dm` | not conserved |
//! | [`NnSum`], Eq. (3) | `Σⱼ NN(rᵢⱼ, vᵢⱼ)` | `2d` | with `antisymmetric` |
//! | [`RotInv`], Eq. (4) | `Σⱼ NN(Aᵢ, Aⱼ, vᵢⱼ·rᵢⱼ, r) rᵢⱼ` | 4 | with `antisymmetric` |
//! | [`GradP`], Eq. (5) | `−Σⱼ m (NN(rᵢⱼ) + Πᵢⱼ) ∇ᵢWᵢⱼ` | `d` | with `antisymmetric` |
//! | [`EosNn`], Eq. (6) | as `Physics`, with `P = NN(ρ)` | 1 | conserved |
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
//! **A law of your own** is a struct with two traits. Here soft spheres that push each other away
//! with `k = 0.05 c²/h²`, fading towards `2h`:
//!
//! ```
//! use whirls::models::{CentralSlope, Constitutive, Medium, PairCotangent, PairLaw, Room, Slope, Strength, Window};
//! use whirls::{Flow, Scene, flow::State, pairs::Batch, scalar::Wide, vector::Vector};
//!
//! #[derive(Clone, Debug)]
//! struct SoftSpheres<const D: usize>(Medium<D>);
//!
//! impl<const D: usize> SoftSpheres<D> {
//!     /// `fᵢⱼ = s rᵢⱼ` with `s = k w(r)`, and its gradient.
//!     fn strength<W: Wide>(&self, pairs: &Batch<W, D>) -> Strength<W> {
//!         let (c, h) = (self.0.parameters.0[0], self.0.smoothing.h);
//!         let (window, by_r2) = Window::new(h, true).at(pairs.pair.r2);
//!         let (k, zero) = (0.05 * c * c / (h * h), W::of(0.0));
//!         Strength {
//!             value: window * k,
//!             by_separation: by_r2 * k,
//!             by_approach: zero,
//!             by_stress: zero,
//!             by_density: zero,
//!             by_parameter: [window * (2.0 * k / c), zero, zero],
//!         }
//!     }
//! }
//!
//! impl<const D: usize> Constitutive<D> for SoftSpheres<D> {
//!     fn medium(&self) -> &Medium<D> {
//!         &self.0
//!     }
//!     fn medium_mut(&mut self) -> &mut Medium<D> {
//!         &mut self.0
//!     }
//!     fn sound_speed(&self, _: f64) -> f64 {
//!         0.0 // pressure has no part in it, so no sound limits the step
//!     }
//! }
//!
//! impl<const D: usize> PairLaw<D> for SoftSpheres<D> {
//!     type Slope<W: Wide> = CentralSlope<W, D>;
//!     fn is_antisymmetric(&self) -> bool {
//!         true
//!     }
//!     fn force<W: Wide>(&self, pairs: &Batch<W, D>, _: &mut Room) -> Vector<W, D> {
//!         pairs.separation * self.strength(pairs).value
//!     }
//!     fn slope<W: Wide>(&self, pairs: &Batch<W, D>, _: &mut Room) -> CentralSlope<W, D> {
//!         CentralSlope::new(pairs, &self.strength(pairs), [W::of(0.0); 2])
//!     }
//!     fn pullback<W: Wide>(&self, pairs: &Batch<W, D>, force: Vector<W, D>, room: &mut Room) -> PairCotangent<W, D> {
//!         self.slope(pairs, room).pullback(force)
//!     }
//! }
//!
//! let scene = Scene::open("inverse-2d", &["fluid.particles_per_side=16".into(), "fluid.smoothing_length=0.4".into()])?;
//! let state = State::initial(&scene);
//! let spheres = SoftSpheres::<2>(Medium::of(&scene, state.positions.len()));
//! let mut flow = Flow::with_own_model(&scene, &state, Box::new(spheres))?;
//! (0..20).try_for_each(|_| flow.step())?;
//! assert!(flow.momentum_rates().pressure.norm() < 1e-13 * flow.momentum_rates().scale);
//! # Ok::<(), whirls::Error>(())
//! ```

mod medium;
mod pairwise;
mod parameter;
mod room;
mod scales;
mod slope;
mod tangent;
mod window;

pub use medium::{Medium, Strength};
pub use parameter::{Parameter, Parameters};
pub use room::{Learned, Room};
pub use scales::Scales;
pub use slope::{CentralSlope, Change, MatrixSlope, PairCotangent, Slope};
use slope::{load_vector, store_vector};
pub use tangent::{CentralRows, EightPairs, Form, MatrixRows, OwnSlope, PairRows, Slopes};
pub use window::Window;

use crate::error::{Error, Result};
use crate::kernel::{AnyKernel, Smoothing};
use crate::packed::PackedAdjoint;
use crate::pairs::{Batch, Hood};
use crate::scalar::{Lanes, Wide};
use crate::sensitivity::Coupling;
use crate::vector::Vector;
use serde::{Deserialize, Serialize};
use std::any::Any;
use std::fmt::Debug;

mod physics;
pub use physics::Physics;

/// The accessors of a model that keeps a `medium` and a `network` under these names.
macro_rules! medium_and_network {
    () => {
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
            #[serde(rename = "physics")]
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
}

impl ModelChoice {
    /// The model of a medium.
    ///
    /// Compiled once for each dimension, in this crate: a caller that names `Learner<3>` does not compile
    /// every pair loop of every model again.
    ///
    /// # Errors
    /// [`crate::Error::Input`] for options that make no network.
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

/// How a particle's stress `A` changes, eight particles at once; by the weights of a network see
/// [`Constitutive::stress_weights`].
#[derive(Clone, Copy, Debug)]
pub struct StressSlope {
    /// `∂A/∂ρ`.
    pub by_density: Lanes,
    /// `∂A/∂(c, α, β, γ, θ)`.
    pub by_parameter: [Lanes; Parameter::COUNT],
}

impl StressSlope {
    /// No dependence.
    pub const ZERO: Self =
        Self { by_density: Lanes::ZERO, by_parameter: [Lanes::ZERO; Parameter::COUNT] };
}

/// What a particle is by itself.
pub trait Constitutive<const D: usize>: Debug + Send + Sync {
    /// Mass, kernel and physical parameters.
    fn medium(&self) -> &Medium<D>;

    /// The same, to change.
    fn medium_mut(&mut self) -> &mut Medium<D>;

    /// Whether particles bring a stress to their pairs.
    fn has_stress(&self) -> bool {
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

    /// The physical parameters in force.
    fn parameters(&self) -> &Parameters<f64> {
        &self.medium().parameters
    }

    /// Puts other physical parameters in force.
    fn set_parameters(&mut self, parameters: Parameters<f64>) {
        self.medium_mut().parameters = parameters;
    }

    /// The network, where there is one.
    fn network(&self) -> Option<&Learned> {
        None
    }

    /// The same, to change.
    fn network_mut(&mut self) -> Option<&mut Learned> {
        None
    }

    /// The speed of sound at density `rho`, for the Courant number; zero where the model has none.
    /// Monotonic in `rho`. By default that of Tait's fluid, `c ρ^((γ−1)/2)`.
    fn sound_speed(&self, rho: f64) -> f64 {
        let [c, _, _, gamma, _] = self.medium().parameters.0;
        c.abs() * rho.max(0.0).powf(0.5 * (gamma - 1.0))
    }

    /// What eight particles of density `rho` bring to their pairs, `A`.
    fn stress(&self, rho: Lanes, room: &mut Room) -> Lanes {
        let _ = (rho, room);
        Lanes::ZERO
    }

    /// How that changes.
    fn stress_slope(&self, rho: Lanes, room: &mut Room) -> StressSlope {
        let _ = (rho, room);
        StressSlope::ZERO
    }

    /// `∂A/∂weights` into `room.weights`; nothing where the stress has no network.
    fn stress_weights(&self, rho: Lanes, room: &mut Room) {
        let _ = (rho, room);
    }

    /// The transpose of both: from `∂L/∂A` of eight particles, `∂L/∂ρ` through `A`; the derivatives by
    /// parameters and weights are added to the room's sums.
    fn stress_pullback(&self, rho: Lanes, stress: Lanes, room: &mut Room) -> Lanes {
        let slope = self.stress_slope(rho, room);
        for (sum, by) in room.physical.iter_mut().zip(slope.by_parameter) {
            *sum += by * stress;
        }
        slope.by_density * stress
    }
}

/// What two particles do to each other.
pub trait PairLaw<const D: usize>: Constitutive<D> + Clone + 'static {
    /// The linearised force.
    type Slope<W: Wide>: Slope<W, D>;

    /// Whether `fᵢⱼ = −fⱼᵢ`, so that momentum is conserved and one end of a pair knows both.
    fn is_antisymmetric(&self) -> bool;

    /// Whether the pair force holds the model's network.
    fn has_network(&self) -> bool {
        false
    }

    /// The acceleration `fᵢⱼ` that eight neighbours each give to particle `i`.
    fn force<W: Wide>(&self, pairs: &Batch<W, D>, room: &mut Room) -> Vector<W, D>;

    /// Its derivative by the pair's state.
    fn slope<W: Wide>(&self, pairs: &Batch<W, D>, room: &mut Room) -> Self::Slope<W>;

    /// From `∂L/∂fᵢⱼ`, the derivatives by the pair's state and by the physical parameters at fixed
    /// stress; those by a network's weights are added to `room.weights`.
    fn pullback<W: Wide>(
        &self,
        pairs: &Batch<W, D>,
        force: Vector<W, D>,
        room: &mut Room,
    ) -> PairCotangent<W, D>;
}

/// Which derivatives of a force are kept.
#[derive(Clone, Copy, Debug)]
pub struct Kept<'a> {
    /// All, or particle `i`'s own.
    pub coupling: Coupling,
    /// `∂A/∂ρ` per slot.
    pub stress_slopes: &'a [f64],
}

/// What one chunk passes back through the force, in the order of its slots.
#[derive(Debug)]
pub struct Passed<'a, const D: usize> {
    /// `∂L/∂r`, added to.
    pub position: &'a mut [Vector<f64, D>],
    /// `∂L/∂v`, added to.
    pub velocity: &'a mut [Vector<f64, D>],
    /// `(∂L/∂A, ∂L/∂ρ)`, added to.
    pub scalars: &'a mut [(f64, f64)],
    /// What belongs to the neighbours, place by place as in the lists of who is near; filled where
    /// [`Model::passes_to_neighbours`].
    pub neighbours: &'a mut Vec<PairShare<D>>,
}

/// The part of a pair's cotangent that belongs to particle `j`: one cache line in 3D, since `j` fetches
/// them one by one.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct PairShare<const D: usize> {
    /// `∂L/∂rⱼ`.
    pub position: Vector<f64, D>,
    /// `∂L/∂vⱼ`.
    pub velocity: Vector<f64, D>,
    /// `∂L/∂Aⱼ`.
    pub stress: f64,
    /// `∂L/∂ρⱼ`.
    pub density: f64,
}

impl<const D: usize> PairShare<D> {
    /// Nothing.
    pub const ZERO: Self =
        Self { position: Vector([0.0; D]), velocity: Vector([0.0; D]), stress: 0.0, density: 0.0 };
}

/// A law of motion over chunks of particles: what the systems run. Every [`PairLaw`] is one.
pub trait Model<const D: usize>: Constitutive<D> {
    /// A copy.
    fn boxed(&self) -> Box<dyn Model<D>>;

    /// `aᵢ` of every particle of a chunk.
    fn accelerations(&self, hood: Hood<'_>, room: &mut Room, out: &mut [Vector<f64, D>]);

    /// `∂aᵢ` at fixed weights by what every particle of a chunk and its neighbours bring; overwrites `into`.
    fn slopes(&self, hood: Hood<'_>, kept: Kept<'_>, room: &mut Room, into: &mut Slopes);

    /// Whether the force itself (not only the stress) depends on the network.
    fn has_force_network(&self) -> bool;

    /// Whether the stress depends on the network.
    fn has_stress_network(&self) -> bool {
        self.has_stress() && self.network().is_some() && !self.has_force_network()
    }

    /// `∂aᵢ/∂weights` at fixed state, `[particle][axis][weight]`, of as many particles as `out` has room for,
    /// from a chunk's `first` on; that is a multiple of eight.
    fn weight_shares(&self, hood: Hood<'_>, first: usize, room: &mut Room, out: &mut [f64]);

    /// Whether particles pass derivatives on to their neighbours one way only.
    fn passes_to_neighbours(&self) -> bool;

    /// From `∂L/∂a` (`forces`, per slot) to the derivatives by the state; those by the parameters are
    /// added to the room's sums.
    fn pull_back(
        &self,
        hood: Hood<'_>,
        forces: &[PackedAdjoint],
        room: &mut Room,
        into: Passed<'_, D>,
    );
}
