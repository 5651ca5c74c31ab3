//! The kernel as a scene specifies it.

use super::{AnyKernel, NAMES, SHAPES, ShapeKind, ShapeParameter, check_positive};
use crate::error::{Error, Result};
use crate::parameters::{Domain, ParameterSpec};
use serde::de::{MapAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer, de};
use std::fmt;
use std::sync::Arc;

/// The kernel of a scene: a name such as `"cubic-spline"`, or a table with the parameters of a learnable
/// shape, `{kind = "w-ab", a = 2.9, b = 3.5}`.
#[derive(Clone, Copy, Debug, PartialEq, Default)]
pub enum KernelChoice {
    /// [`CubicSpline`](super::CubicSpline).
    #[default]
    CubicSpline,
    /// [`WendlandC2`](super::WendlandC2).
    WendlandC2,
    /// [`WendlandC4`](super::WendlandC4).
    WendlandC4,
    /// A learnable shape.
    Learnable(LearnableKernel),
}

/// A learnable shape with its parameters.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LearnableKernel {
    /// The shape.
    pub shape: &'static ShapeKind,
    /// Its parameters, in the order of the shape's.
    pub parameters: [f64; 2],
    /// Whether parameters with a pairing instability are refused, see [`check_positive`].
    pub positive: bool,
}

impl LearnableKernel {
    /// A shape with its default parameters.
    pub fn start(shape: &'static ShapeKind) -> Self {
        let parameters = shape.parameters.map(|parameter| parameter.start);
        Self { shape, parameters, positive: false }
    }

    /// Refuses parameters outside of their ranges and, if `positive` is set, those with a pairing
    /// instability; `place` names the kernel in the error.
    ///
    /// # Errors
    /// [`Error::Input`].
    pub fn check(&self, place: &str, dimension: usize) -> Result<()> {
        for (parameter, value) in self.shape.parameters.iter().zip(self.parameters) {
            let &ShapeParameter { name, range: [least, greatest], .. } = parameter;
            if !(least..=greatest).contains(&value) {
                return Err(Error::input(
                    format!("{place}.{name}"),
                    format!("a number from {least} to {greatest}"),
                    value,
                    "change it in the scene or with --set",
                ));
            }
        }
        if self.positive {
            check_positive(place, &self.in_dimension(dimension), dimension)?;
        }
        Ok(())
    }

    /// The kernel to run in `dimension` 2 or 3.
    pub fn in_dimension(&self, dimension: usize) -> AnyKernel {
        AnyKernel::Table(Arc::new(self.shape.table(self.parameters, dimension)))
    }
}

impl KernelChoice {
    /// Its name in scenes.
    pub fn name(self) -> &'static str {
        match self {
            Self::CubicSpline => "cubic-spline",
            Self::WendlandC2 => "wendland-c2",
            Self::WendlandC4 => "wendland-c4",
            Self::Learnable(kernel) => kernel.shape.name,
        }
    }

    /// The kernel of a name, with default parameters.
    pub fn named(name: &str) -> Option<Self> {
        let classical = [Self::CubicSpline, Self::WendlandC2, Self::WendlandC4];
        let learnable = SHAPES.iter().map(|shape| Self::Learnable(LearnableKernel::start(shape)));
        classical.into_iter().chain(learnable).find(|kernel| kernel.name() == name)
    }

    /// The parameters of its shape, with their values; empty for a classical kernel.
    pub fn specs(&self) -> Vec<ParameterSpec> {
        let Self::Learnable(kernel) = self else { return Vec::new() };
        let spec = |(parameter, value): (&ShapeParameter, f64)| {
            let [least, most] = parameter.range;
            ParameterSpec::new(parameter.name, value).within(Domain::Between(least, most))
        };
        kernel.shape.parameters.iter().zip(kernel.parameters).map(spec).collect()
    }

    /// Sets the values of its parameters; returns whether that changes the kernel.
    pub fn set(&mut self, values: &[f64]) -> bool {
        let (Self::Learnable(kernel), &[a, b]) = (self, values) else { return false };
        let bits = |all: [f64; 2]| all.map(f64::to_bits);
        let changes = bits(kernel.parameters) != bits([a, b]);
        kernel.parameters = [a, b];
        changes
    }

    /// The kernel to run in `dimension` 2 or 3.
    pub fn in_dimension(self, dimension: usize) -> AnyKernel {
        match self {
            Self::CubicSpline => AnyKernel::CubicSpline,
            Self::WendlandC2 => AnyKernel::WendlandC2,
            Self::WendlandC4 => AnyKernel::WendlandC4,
            Self::Learnable(kernel) => kernel.in_dimension(dimension),
        }
    }

    /// As [`LearnableKernel::check`]; kernels without parameters are always valid.
    ///
    /// # Errors
    /// [`Error::Input`].
    pub fn check(&self, place: &str, dimension: usize) -> Result<()> {
        match self {
            Self::Learnable(kernel) => kernel.check(place, dimension),
            _ => Ok(()),
        }
    }
}

impl Serialize for KernelChoice {
    fn serialize<S: Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        let Self::Learnable(kernel) = self else { return serializer.serialize_str(self.name()) };
        let mut map = serializer.serialize_map(None)?;
        map.serialize_entry("kind", kernel.shape.name)?;
        for (parameter, value) in kernel.shape.parameters.iter().zip(kernel.parameters) {
            map.serialize_entry(parameter.name, &value)?;
        }
        map.serialize_entry("positive", &kernel.positive)?;
        map.end()
    }
}

impl<'de> Deserialize<'de> for KernelChoice {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> std::result::Result<Self, D::Error> {
        deserializer.deserialize_any(Spelling)
    }
}

/// Parses a name or a table.
struct Spelling;

impl<'de> Visitor<'de> for Spelling {
    type Value = KernelChoice;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the name of a kernel ({}), or a table with its kind", NAMES.join(", "))
    }

    fn visit_str<E: de::Error>(self, name: &str) -> std::result::Result<KernelChoice, E> {
        KernelChoice::named(name).ok_or_else(|| E::unknown_variant(name, NAMES))
    }

    fn visit_map<A: MapAccess<'de>>(
        self,
        mut map: A,
    ) -> std::result::Result<KernelChoice, A::Error> {
        let (mut kind, mut positive, mut numbers) = (None, None, Vec::new());
        while let Some(key) = map.next_key::<String>()? {
            match key.as_str() {
                "kind" => kind = Some(map.next_value::<String>()?),
                "positive" => positive = Some(map.next_value::<bool>()?),
                _ => numbers.push((key, map.next_value::<f64>()?)),
            }
        }
        let kind = kind.ok_or_else(|| de::Error::missing_field("kind"))?;
        with_parameters(self.visit_str(&kind)?, positive, numbers)
    }
}

/// A kernel with the parameters that a table gives; unknown keys are refused.
fn with_parameters<E: de::Error>(
    mut choice: KernelChoice,
    positive: Option<bool>,
    numbers: Vec<(String, f64)>,
) -> std::result::Result<KernelChoice, E> {
    let name = choice.name();
    let unknown = |key: &str, known: &str| {
        E::custom(format!("unknown key `{key}` of kernel {name}, expected {known}"))
    };
    let KernelChoice::Learnable(kernel) = &mut choice else {
        let first = numbers.first().map(|(key, _)| key.as_str());
        let found = first.or(positive.map(|_| "positive"));
        return found.map_or(Ok(choice), |key| Err(unknown(key, "kind alone")));
    };
    for (key, value) in numbers {
        let names = kernel.shape.parameters.map(|parameter| parameter.name);
        let at = names.iter().position(|name| *name == key);
        let at = at.ok_or_else(|| {
            unknown(&key, &format!("one of kind, {}, positive", names.join(", ")))
        })?;
        kernel.parameters[at] = value;
    }
    kernel.positive = positive.unwrap_or(false);
    Ok(choice)
}
