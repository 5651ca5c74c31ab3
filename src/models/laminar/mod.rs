//! Laminar viscosity: an additional pair law with a kinematic viscosity `ν` that can be learned.
//!
//! | `kind` | force | linear momentum | angular momentum |
//! |---|---|---|---|
//! | [`Morris`] | along `vᵢⱼ` | kept | not kept |
//! | [`MonaghanCleary`] | along `rᵢⱼ` | kept | kept |
//!
//! The effective viscosity is compared with `ν`, by `h/Δx` and resolution, in
//! `cargo bench --bench viscosity`.

mod monaghan_cleary;
mod morris;

pub use monaghan_cleary::MonaghanCleary;
pub use morris::Morris;

use super::{Medium, Model};
use crate::parameters::{Domain, Parameter, ParameterSpec};
use serde::{Deserialize, Serialize};

/// Regularisation `ε` in units of `h²`: keeps a quotient by `r² + ε h²` finite where two particles
/// coincide.
const EPSILON: f64 = 0.01;

/// The laminar viscosities: each line is a file, a type and a `kind` in scenes.
macro_rules! laminar {
    ($($name:ident = $kind:literal;)*) => {
        /// A laminar viscosity of a scene.
        #[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(tag = "kind", deny_unknown_fields)]
        pub enum LaminarViscosity {
            $(
                #[doc = concat!("[`", stringify!($name), "`].")]
                #[serde(rename = $kind)]
                $name {
                    /// Kinematic viscosity `ν`, in box units squared per unit of time.
                    nu: f64,
                },
            )*
        }

        impl LaminarViscosity {
            /// Every `kind`.
            pub const KINDS: &'static [&'static str] = &[$($kind),*];

            /// The viscosity of a `kind`.
            pub fn of_kind(kind: &str, nu: f64) -> Option<Self> {
                match kind {
                    $($kind => Some(Self::$name { nu }),)*
                    _ => None,
                }
            }

            /// Kinematic viscosity `ν`.
            pub fn nu(self) -> f64 {
                match self {
                    $(Self::$name { nu } => nu,)*
                }
            }

            /// The law in a fluid, with its name.
            pub(crate) fn law<const D: usize>(
                self,
                medium: Medium<D>,
            ) -> (String, Box<dyn Model<D>>) {
                match self {
                    $(Self::$name { nu } => {
                        (format!("{} viscosity", $kind), Box::new($name::new(medium, nu)))
                    })*
                }
            }
        }
    };
}

laminar! {
    Morris = "morris";
    MonaghanCleary = "monaghan-cleary";
}

impl LaminarViscosity {
    /// Its parameter.
    pub fn spec(self) -> ParameterSpec {
        spec(self.nu())
    }
}

fn spec(nu: f64) -> ParameterSpec {
    ParameterSpec::new(Parameter::named("nu"), nu).within(Domain::NonNegative)
}

/// The accessors of a law with the fields `medium` and `nu`. Its parameters are `ν` and those of
/// the kernel.
macro_rules! medium_and_nu {
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

        fn specs(&self) -> Vec<ParameterSpec> {
            let mut specs = vec![super::spec(self.nu)];
            specs.extend(self.medium.kernel_specs());
            specs
        }

        fn scalars(&self) -> usize {
            1 + self.medium.kernel_scalars()
        }

        fn set_scalars(&mut self, values: &[f64]) {
            if let Some((&nu, kernel)) = values.split_first() {
                self.nu = nu;
                self.medium.set_kernel(kernel);
            }
        }

        fn sound_speed(&self, _: f64) -> f64 {
            0.0
        }
    };
}
use medium_and_nu;
