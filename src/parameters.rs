//! Parameters: what a flow can learn, as one flat vector with names.
//!
//! Every term of a flow names its own parameters ([`crate::systems::term::Term::parameters`]). A
//! parameter that two terms name is one parameter. The weights of networks come last in the vector.

use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::fmt::{self, Display};

/// The name of a parameter, in scenes, recordings and reports.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Parameter(Cow<'static, str>);

impl Parameter {
    /// Sound speed `c`.
    pub const C: Self = Self::named("c");
    /// Linear viscosity `α`.
    pub const ALPHA: Self = Self::named("alpha");
    /// Quadratic viscosity `β`.
    pub const BETA: Self = Self::named("beta");
    /// Stiffness exponent `γ` of Tait's equation of state.
    pub const GAMMA: Self = Self::named("gamma");
    /// Power `θ` of the deterministic forcing.
    pub const THETA: Self = Self::named("theta");
    /// The five parameters that Woodward et al. (arXiv:2110.13311) learn.
    pub const PHYSICAL: [Self; 5] = [Self::C, Self::ALPHA, Self::BETA, Self::GAMMA, Self::THETA];

    /// A name known at compile time.
    pub const fn named(name: &'static str) -> Self {
        Self(Cow::Borrowed(name))
    }

    /// A weight or a bias of a model's network, by its index there: `w0`, `w1`, …
    pub fn weight(place: usize) -> Self {
        Self(format!("w{place}").into())
    }

    /// The name.
    pub fn name(&self) -> &str {
        &self.0
    }

    /// Whether it is a weight of the model's network.
    pub fn is_weight(&self) -> bool {
        let digits = self.0.strip_prefix('w').unwrap_or_default();
        !digits.is_empty() && digits.bytes().all(|b| b.is_ascii_digit())
    }
}

impl Display for Parameter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl From<String> for Parameter {
    fn from(name: String) -> Self {
        Self(name.into())
    }
}

impl From<&'static str> for Parameter {
    fn from(name: &'static str) -> Self {
        Self::named(name)
    }
}

/// The values that a parameter may take.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Domain {
    /// Any number.
    Real,
    /// Zero or more.
    NonNegative,
    /// More than zero.
    Positive,
    /// From the first to the second, both included.
    Between(f64, f64),
}

impl Domain {
    /// Whether a value lies in the domain.
    pub fn contains(self, value: f64) -> bool {
        value.is_finite()
            && match self {
                Self::Real => true,
                Self::NonNegative => value >= 0.0,
                Self::Positive => value > 0.0,
                Self::Between(least, most) => (least..=most).contains(&value),
            }
    }

    /// The value in the domain nearest to `there`, on the way from `here`, which lies in it. An
    /// open end is approached by halving `here`.
    pub fn clamp(self, here: f64, there: f64) -> f64 {
        match self {
            Self::Real => there,
            Self::NonNegative => there.max(0.0),
            Self::Positive if there > 0.0 => there,
            Self::Positive => 0.5 * here,
            Self::Between(least, most) => there.clamp(least, most),
        }
    }

    /// In words.
    pub fn words(self) -> String {
        match self {
            Self::Real => "a number".to_owned(),
            Self::NonNegative => "zero or more".to_owned(),
            Self::Positive => "a positive number".to_owned(),
            Self::Between(least, most) => format!("a number from {least} to {most}"),
        }
    }
}

/// The coordinate in which a search moves a parameter. The force is nearly linear in it.
#[derive(Clone, Debug, PartialEq)]
pub enum Coordinate {
    /// The parameter itself.
    Itself,
    /// Its square, for a positive parameter.
    Square,
    /// Its product with a power of another parameter, where that one is searched by its
    /// [`Coordinate::Square`].
    Times(Parameter, i32),
}

/// A parameter: its name, its value, and how to search it.
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterSpec {
    /// Its name.
    pub name: Parameter,
    /// Its value.
    pub value: f64,
    /// The values that it may take.
    pub domain: Domain,
    /// The coordinate of a search.
    pub coordinate: Coordinate,
    /// Whether it is a weight of a network.
    pub is_weight: bool,
}

impl ParameterSpec {
    /// A parameter that may take any value.
    pub fn new(name: impl Into<Parameter>, value: f64) -> Self {
        let (domain, coordinate) = (Domain::Real, Coordinate::Itself);
        Self { name: name.into(), value, domain, coordinate, is_weight: false }
    }

    /// With this domain.
    #[must_use]
    pub fn within(self, domain: Domain) -> Self {
        Self { domain, ..self }
    }

    /// With this coordinate.
    #[must_use]
    pub fn searched_by(self, coordinate: Coordinate) -> Self {
        Self { coordinate, ..self }
    }

    /// A weight of a network.
    pub fn weight(name: Parameter, value: f64) -> Self {
        Self { is_weight: true, ..Self::new("", value) }.renamed(name)
    }

    fn renamed(self, name: Parameter) -> Self {
        Self { name, ..self }
    }
}

/// All parameters of a flow.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameters {
    specs: Vec<ParameterSpec>,
}

impl Parameters {
    /// Merges the parameters of several owners: scalars in the order in which they first occur,
    /// then weights. Also returns the places of each owner's parameters, in the owner's order.
    ///
    /// # Errors
    /// [`Error::Input`] where two owners give one parameter different values.
    pub fn merged(owners: &[Vec<ParameterSpec>]) -> Result<(Self, Vec<Vec<usize>>)> {
        let mut all = Self::default();
        for weights in [false, true] {
            for spec in owners.iter().flatten().filter(|spec| spec.is_weight == weights) {
                match all.specs.iter().find(|known| known.name == spec.name) {
                    None => all.specs.push(spec.clone()),
                    Some(known) if known.value.to_bits() == spec.value.to_bits() => {}
                    Some(known) => {
                        return Err(Error::input(
                            format!("parameter {}", spec.name),
                            format!("one value, {}", known.value),
                            spec.value,
                            "give the terms that share it the same value, or another name",
                        ));
                    }
                }
            }
        }
        let place = |spec: &ParameterSpec| all.place(&spec.name).unwrap_or_default();
        let places = owners.iter().map(|specs| specs.iter().map(place).collect()).collect();
        Ok((all, places))
    }

    /// Number of parameters.
    pub fn len(&self) -> usize {
        self.specs.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.specs.is_empty()
    }

    /// Number of scalars, that is, of parameters that are not weights; these come first.
    pub fn scalars(&self) -> usize {
        self.specs.partition_point(|spec| !spec.is_weight)
    }

    /// All of them.
    pub fn specs(&self) -> &[ParameterSpec] {
        &self.specs
    }

    /// The place of a parameter in the flat vector.
    pub fn place(&self, name: &Parameter) -> Option<usize> {
        self.specs.iter().position(|spec| spec.name == *name)
    }

    /// The values, place by place.
    pub fn values(&self) -> impl Iterator<Item = f64> {
        self.specs.iter().map(|spec| spec.value)
    }

    /// The value of a parameter, where there is one of that name.
    pub fn get(&self, name: &Parameter) -> Option<f64> {
        self.place(name).map(|place| self.specs[place].value)
    }

    /// Replaces the value at a place.
    pub(crate) fn set_at(&mut self, place: usize, value: f64) {
        self.specs[place].value = value;
    }

    /// Replaces the value of a parameter.
    ///
    /// # Errors
    /// [`Error::Input`] where there is none of that name.
    pub fn set(&mut self, name: &Parameter, value: f64) -> Result<()> {
        let place = self.place(name).ok_or_else(|| self.unknown(name))?;
        self.set_at(place, value);
        Ok(())
    }

    /// The error for an unknown name.
    pub(crate) fn unknown(&self, name: &Parameter) -> Error {
        let mut names: Vec<&str> = Vec::new();
        names.extend(self.specs.iter().filter(|s| !s.is_weight).map(|spec| spec.name.name()));
        if self.scalars() < self.len() {
            names.push("weights of the network");
        }
        Error::input(
            "a parameter",
            format!("one of {}", names.join(", ")),
            name,
            "check the spelling, or add the term that owns it",
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parameter_that_two_terms_name_is_one_and_weights_come_last() {
        let owners = [
            vec![ParameterSpec::new("c", 3.0), ParameterSpec::weight(Parameter::weight(0), 0.5)],
            vec![ParameterSpec::new("nu", 0.1), ParameterSpec::new("c", 3.0)],
        ];
        let (all, places) = Parameters::merged(&owners).unwrap();
        let names: Vec<&str> = all.specs().iter().map(|spec| spec.name.name()).collect();
        assert_eq!(names, ["c", "nu", "w0"]);
        assert_eq!(places, [vec![0, 2], vec![1, 0]]);
        assert_eq!(all.scalars(), 2);
        assert!(all.specs()[2].name.is_weight() && !Parameter::named("w").is_weight());
    }

    #[test]
    fn terms_that_disagree_on_a_shared_value_are_refused() {
        let owners = [vec![ParameterSpec::new("c", 3.0)], vec![ParameterSpec::new("c", 4.0)]];
        let error = Parameters::merged(&owners).unwrap_err().to_string();
        assert!(error.contains("parameter c") && error.contains('4'), "{error}");
    }

    #[test]
    fn a_step_out_of_a_domain_ends_at_its_edge_or_half_way_to_an_open_one() {
        let clamped = [
            Domain::NonNegative.clamp(1.0, -2.0),
            Domain::Positive.clamp(1.0, -2.0),
            Domain::Between(1.0, 2.0).clamp(1.5, 3.0),
        ];
        assert_eq!(clamped.map(f64::to_bits), [0.0, 0.5, 2.0_f64].map(f64::to_bits));
        assert!(!Domain::Real.contains(f64::NAN) && Domain::Positive.contains(1e-300));
    }
}
