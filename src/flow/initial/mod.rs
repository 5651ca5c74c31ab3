//! Initial velocities: one file per field, and one line in the list below.
//!
//! `initial.field` names the field, `initial.velocity` is its amplitude. The field is evaluated at
//! each particle's own position, that is, after the lattice has been perturbed by `initial.jitter`.
//!
//! | `initial.field` | velocity | dimensions |
//! |---|---|---|
//! | `"normal"` | [`Normal`]: each component of each particle drawn by itself | 2, 3 |
//! | `"taylor-green"` | [`TaylorGreen`]: the vortex that breaks into turbulence | 2, 3 |
//! | `"abc"` | [`Abc`]: a Beltrami flow, exact and steady without viscosity | 3 |
//! | `{kind="random-solenoidal", spectrum={…}}` | [`RandomSolenoidal`]: random waves of a given `E(k)` | 2, 3 |

mod abc;
mod normal;
mod random_solenoidal;
mod taylor_green;

pub use abc::Abc;
pub use normal::Normal;
pub use random_solenoidal::{RandomSolenoidal, Spectrum};
pub use taylor_green::TaylorGreen;

use crate::scene::{Requirement, Scene};
use crate::vector::Vector;
use rand_chacha::ChaCha8Rng;
use serde::de::value::{MapAccessDeserializer, MapDeserializer};
use serde::de::{Deserializer, Error, MapAccess, Visitor};
use serde::{Deserialize, Serialize};
use std::fmt::Formatter;

/// An initial velocity field.
pub(crate) trait VelocityField {
    /// What its parameters must satisfy in a scene.
    fn requirements(&self, scene: &Scene) -> Vec<Requirement>;

    /// The velocity of each particle. `generator` has already drawn the perturbation of the
    /// lattice.
    fn velocities<const D: usize>(
        &self,
        scene: &Scene,
        positions: &[Vector<f64, D>],
        generator: &mut ChaCha8Rng,
    ) -> Vec<Vector<f64, D>>;
}

/// The enum of all fields, with dispatch to each.
macro_rules! fields {
    ($($(#[$about:meta])* $name:ident,)*) => {
        /// The initial velocity field.
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        #[serde(rename_all = "kebab-case", tag = "kind")]
        pub enum Field {
            $($(#[$about])* $name($name),)*
        }

        impl Field {
            pub(crate) fn requirements(&self, scene: &Scene) -> Vec<Requirement> {
                match self {
                    $(Self::$name(field) => field.requirements(scene),)*
                }
            }

            /// The velocity of each particle. `generator` has already drawn the perturbation of the
            /// lattice.
            pub(crate) fn velocities<const D: usize>(
                &self,
                scene: &Scene,
                positions: &[Vector<f64, D>],
                generator: &mut ChaCha8Rng,
            ) -> Vec<Vector<f64, D>> {
                match self {
                    $(Self::$name(field) => field.velocities(scene, positions, generator),)*
                }
            }
        }
    };
}

fields! {
    /// Each component of each particle drawn independently.
    Normal,
    /// The vortex of Taylor and Green.
    TaylorGreen,
    /// The flow of Arnold, Beltrami and Childress.
    Abc,
    /// Random waves of a given energy spectrum.
    RandomSolenoidal,
}

impl Default for Field {
    fn default() -> Self {
        Self::Normal(Normal {})
    }
}

impl Field {
    /// Whether it is the default.
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// Parses a table, or the name of a field with default parameters.
    pub(crate) fn by_table_or_name<'de, S: Deserializer<'de>>(source: S) -> Result<Self, S::Error> {
        source.deserialize_any(TableOrName)
    }
}

struct TableOrName;

impl<'de> Visitor<'de> for TableOrName {
    type Value = Field;

    fn expecting(&self, formatter: &mut Formatter<'_>) -> std::fmt::Result {
        formatter.write_str("the name of a velocity field, or a table with its `kind`")
    }

    fn visit_str<E: Error>(self, name: &str) -> Result<Field, E> {
        Field::deserialize(MapDeserializer::new(std::iter::once(("kind", name))))
    }

    fn visit_map<M: MapAccess<'de>>(self, table: M) -> Result<Field, M::Error> {
        Field::deserialize(MapAccessDeserializer::new(table))
    }
}

#[cfg(test)]
mod tests;
