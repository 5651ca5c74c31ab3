//! What is learned: names, places, values.

use serde::{Deserialize, Serialize};
use std::borrow::Cow;

/// A parameter that can be learned: one of the five physical ones, or one of a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Parameter {
    /// Sound speed `c`.
    C,
    /// Linear viscosity `α`.
    Alpha,
    /// Quadratic viscosity `β`.
    Beta,
    /// Stiffness exponent `γ` of Tait's equation of state.
    Gamma,
    /// Power `θ` of the deterministic forcing.
    Theta,
    /// A weight or a bias of the model's network, by its place there.
    #[serde(skip)]
    Weight(u32),
}

impl Parameter {
    /// How many physical ones there are.
    pub const COUNT: usize = 5;
    /// The physical ones, in the order of [`Parameters`].
    pub const ALL: [Self; Self::COUNT] =
        [Self::C, Self::Alpha, Self::Beta, Self::Gamma, Self::Theta];

    /// Its place in a gradient by all parameters: the physical ones come first.
    #[inline(always)]
    pub fn index(self) -> usize {
        match self {
            Self::C => 0,
            Self::Alpha => 1,
            Self::Beta => 2,
            Self::Gamma => 3,
            Self::Theta => 4,
            Self::Weight(place) => Self::COUNT + place as usize,
        }
    }

    /// Its name in scenes, recordings and reports: `c`, `alpha`, `beta`, `gamma`, `theta`, and `w0`,
    /// `w1`, … for a network's.
    pub fn name(self) -> Cow<'static, str> {
        match self {
            Self::C => "c".into(),
            Self::Alpha => "alpha".into(),
            Self::Beta => "beta".into(),
            Self::Gamma => "gamma".into(),
            Self::Theta => "theta".into(),
            Self::Weight(place) => format!("w{place}").into(),
        }
    }
}

/// The five physical parameters, numbers or dual numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parameters<T>(pub [T; Parameter::COUNT]);

impl<T: Copy> Parameters<T> {
    /// One of them; a physical one.
    #[inline(always)]
    pub fn get(&self, parameter: Parameter) -> T {
        self.0[parameter.index()]
    }
}

impl Parameters<f64> {
    /// Replaces one of them; a physical one.
    pub fn set(&mut self, parameter: Parameter, value: f64) {
        self.0[parameter.index()] = value;
    }
}
