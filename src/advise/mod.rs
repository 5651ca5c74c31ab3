//! Advice on a scene: from what is known of a flow (Reynolds and Mach number, box, size, duration) to sound speed,
//! smoothing length, kernel, time step, viscosity, memory, time and size of the recording.
//!
//! Each number comes with its reason and its source. What cannot be had is said as a warning: a
//! Reynolds number that the spacing does not carry, a flow that does not fit into memory. The advice
//! is a scene ([`Advice::scene_toml`]), and everything that is said of it is computed from that
//! scene.

mod limits;
mod price;
mod scene;
mod size;
mod warnings;

pub use limits::Limit;
pub use price::Price;

use crate::error::Result;
use crate::scene::Scene;
use serde::Serialize;

/// What is known of a flow.
#[derive(Clone, Debug, PartialEq)]
pub struct Wish {
    /// 2 or 3.
    pub dimension: usize,
    /// Side `L` of the periodic box.
    pub box_length: f64,
    /// The velocity `U`: the largest of Taylor–Green, root mean square of a component of the others.
    pub speed: f64,
    /// The length `ℓ` of the Reynolds number `U ℓ/ν`; by default `L/2π`.
    pub length: Option<f64>,
    /// The viscosity.
    pub viscosity: Viscous,
    /// The sound.
    pub sound: Sound,
    /// The resolution.
    pub size: Size,
    /// Smoothing length in particle spacings.
    pub h_over_spacing: Option<f64>,
    /// The flow.
    pub flow: Start,
    /// Duration; by default five eddy times `L/(2πU)`.
    pub duration: Option<f64>,
    /// Requested accuracy of the steps, in smoothing lengths.
    pub accuracy: Option<f64>,
}

/// How viscous a flow shall be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Viscous {
    /// Reynolds number `U ℓ/ν`.
    Reynolds(f64),
    /// Kinematic viscosity `ν`.
    Nu(f64),
    /// Monaghan's `α`.
    Alpha(f64),
}

/// How compressible a flow shall be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Sound {
    /// Mach number `U/c`.
    Mach(f64),
    /// Sound speed `c`.
    Speed(f64),
}

/// How fine a flow shall be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Size {
    /// Number of particles, rounded to a square or cube.
    Particles(u64),
    /// The smallest length that the kernel must resolve: its support `2h`.
    Smallest(f64),
}

/// A flow.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Start {
    /// Taylor–Green vortices, which decay.
    TaylorGreen,
    /// A random solenoidal field, which decays.
    Decaying,
    /// The same field, stirred at constant power.
    Stirred,
}

/// One number or choice of the advice.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Item {
    /// Its name; a key of the scene where it is one.
    pub name: &'static str,
    /// Its value in words, with its unit.
    pub value: String,
    /// Its value, where it is a number.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub number: Option<f64>,
    /// Why.
    pub reason: String,
    /// From where: a publication, a table of README, a measurement on this machine.
    pub source: String,
}

/// The advice.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Advice {
    /// What is advised, in order.
    pub items: Vec<Item>,
    /// The limits of the time step; the first is the smallest, which binds.
    pub limits: Vec<Limit>,
    /// What cannot be had, or costs more than one may think.
    pub warnings: Vec<String>,
    /// Memory and time.
    pub price: Price,
    /// The scene as text, with reasons as comments.
    #[serde(skip)]
    pub scene_toml: String,
    /// The same scene.
    #[serde(skip)]
    pub scene: Scene,
}

impl Advice {
    /// The advice on a wish. With `measure`, small flows are run for about a second, for the time on this machine.
    ///
    /// # Errors
    /// [`crate::Error::Input`] where no scene of these numbers can be made.
    pub fn on(wish: &Wish, measure: bool) -> Result<Self> {
        let (numbers, mut items) = size::choose(wish)?;
        let mut scene_toml = scene::text(wish, &numbers, None);
        let mut scene = Scene::parse(&scene_toml, "the advised scene", &[])?;
        let limits = limits::of(wish, &scene);
        let least = limits.first().map_or(f64::INFINITY, |limit| limit.dt);
        if scene.dt() > least && wish.accuracy.is_none() {
            scene_toml = scene::text(wish, &numbers, Some(least));
            scene = Scene::parse(&scene_toml, "the advised scene", &[])?;
        }
        let price = match wish.dimension {
            2 => price::of::<2>(&scene, measure)?,
            _ => price::of::<3>(&scene, measure)?,
        };
        items.extend(limits::item(&limits, &scene));
        items.extend(price.items(&scene));
        let warnings = warnings::of(wish, &scene, (&numbers, &price));
        Ok(Self { items, limits, warnings, price, scene_toml, scene })
    }
}
