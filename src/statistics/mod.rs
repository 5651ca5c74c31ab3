//! What is measured of a flow: what it keeps, and what each system gives away.

mod dispersion;
mod increments;
mod spectrum;
mod structure;

pub use dispersion::{Displacement, close_pairs, pair_dispersion};
pub use increments::Moments;
pub use spectrum::energy_spectrum;
pub use structure::{Structure, structure_functions};

use crate::flow::{Flow, State};
use crate::models::{Parameter, Parameters};
use crate::recording::Conservation;
use crate::state::{internal_energy, tait};
use crate::systems::acceleration::{Law, model_accelerations};
use crate::systems::forcing::external_forces;
use crate::systems::neighbours::{CHUNK, Neighbours};
use crate::systems::particles::{Cloud, Rooms};
use crate::vector::Vector;
use bevy_ecs::prelude::World;
use rayon::prelude::*;

/// `Σ m a` over all particles, per system: zero to round-off where the system conserves momentum.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MomentumRates<const D: usize> {
    /// Of the pressure, or of what a model has learned in its place.
    pub pressure: Vector<f64, D>,
    /// Of the viscosity; zero where a model has none.
    pub viscosity: Vector<f64, D>,
    /// Of the forcing.
    pub forcing: Vector<f64, D>,
    /// `Σ m |a|` of all three: what round-off is measured against.
    pub scale: f64,
}

/// `Σ m a` of pressure, viscosity and forcing as the cloud stands, by the very loops that move the
/// particles: pressure with `α = β = 0`, viscosity what is missing to the whole.
pub(crate) fn momentum_rates<const D: usize>(world: &World) -> MomentumRates<D> {
    let law = &*world.resource::<Law<D>>().0;
    let cloud = world.resource::<Cloud<D>>();
    let neighbours = world.resource::<Neighbours<D>>();
    let rooms = world.resource::<Rooms>();
    let mut inviscid = law.boxed();
    let mut parameters: Parameters<f64> = *law.parameters();
    parameters.set(Parameter::Alpha, 0.0);
    parameters.set(Parameter::Beta, 0.0);
    inviscid.set_parameters(parameters);
    let mut rates = MomentumRates::default();
    let mut total = |accelerations: &[Vector<f64, D>]| {
        rates.scale += law.mass() * accelerations.iter().map(|a| a.norm()).sum::<f64>();
        momentum(law.mass(), accelerations)
    };
    let mut pressed = vec![Vector::zero(); cloud.len()];
    let mut viscous = pressed.clone();
    model_accelerations(neighbours, (&*inviscid, rooms), cloud.lines(), &mut pressed);
    model_accelerations(neighbours, (law, rooms), cloud.lines(), &mut viscous);
    viscous.iter_mut().zip(&pressed).for_each(|(whole, pressed)| *whole -= *pressed);
    let (pressure, viscosity) = (total(&pressed), total(&viscous));
    let forcing = total(&external_forces::<D>(world));
    MomentumRates { pressure, viscosity, forcing, ..rates }
}

/// `Σ m v` (or `Σ m a`).
pub fn momentum<const D: usize>(mass: f64, velocities: &[Vector<f64, D>]) -> Vector<f64, D> {
    let mut sum = Vector::zero();
    velocities.iter().for_each(|&v| sum += v);
    sum * mass
}

/// The time in which the largest eddies turn: `L/2π` over the root-mean-square of a component of `v − v̄`.
pub fn eddy_time<const D: usize>(velocities: &[Vector<f64, D>], box_length: f64) -> f64 {
    let count = velocities.len() as f64;
    let mean = momentum(1.0 / count, velocities);
    let square: f64 = velocities.iter().map(|&v| (v - mean).norm_squared()).sum();
    box_length / (std::f64::consts::TAU * (square / (count * D as f64)).sqrt())
}

/// The largest difference of a flow's pressure from Tait's with `parameters`, over the densities from
/// `lowest` to `highest`, as a share of the largest pressure there.
pub fn pressure_error<const D: usize>(
    flow: &Flow<D>,
    parameters: &Parameters<f64>,
    (lowest, highest): (f64, f64),
) -> f64 {
    let (c, gamma) = (parameters.get(Parameter::C), parameters.get(Parameter::Gamma));
    let (mut apart, mut largest) = (0.0_f64, 0.0_f64);
    for k in 0..=200 {
        let rho = lowest + (highest - lowest) * f64::from(k) / 200.0;
        let truth = tait(rho, c, gamma);
        apart = apart.max((flow.pressure(rho) - truth).abs());
        largest = largest.max(truth.abs());
    }
    apart / largest
}

/// Everything that `/diag/conservation` records of a flow as it stands.
pub fn conservation<const D: usize>(flow: &mut Flow<D>) -> Conservation {
    let (state, densities) = (flow.state(), flow.densities());
    conservation_of(flow, &state, &densities)
}

/// The same of a flow whose state and densities are at hand.
pub(crate) fn conservation_of<const D: usize>(
    flow: &Flow<D>,
    state: &State<D>,
    densities: &[f64],
) -> Conservation {
    let parameters = flow.parameters();
    let (c, gamma) = (parameters.get(Parameter::C), parameters.get(Parameter::Gamma));
    let mass = flow.mass();
    let kinetic: f64 = state.velocities.iter().map(|v| 0.5 * mass * v.norm_squared()).sum();
    let energy = |part: &[f64]| part.iter().map(|&rho| internal_energy(rho, c, gamma)).sum();
    let parts: Vec<f64> = densities.par_chunks(CHUNK).map(energy).collect();
    let internal = mass * parts.iter().sum::<f64>();
    let fastest = state.velocities.iter().map(|v| v.norm()).fold(0.0, f64::max);
    let deviation = densities.iter().map(|rho| (rho - 1.0).abs()).fold(0.0, f64::max);
    let rates = flow.momentum_rates();
    Conservation {
        step: flow.steps(),
        time: flow.time(),
        kinetic_energy: kinetic,
        total_energy: kinetic + internal,
        max_mach: fastest / c,
        max_density_deviation: deviation,
        momentum: momentum(mass, &state.velocities).0.to_vec(),
        momentum_pressure: rates.pressure.0.to_vec(),
        momentum_viscosity: rates.viscosity.0.to_vec(),
        momentum_forcing: rates.forcing.0.to_vec(),
        courant: flow.dt() * (c + fastest) / flow.smoothing_length(),
    }
}

/// `Σᵢ rᵢ × Fᵢ` with each pair force at its minimum image, `½ Σᵢⱼ rᵢⱼ × m aᵢⱼ`: zero to round-off for
/// central forces. In 2D only the last component differs from zero.
pub fn pair_torque(pairs: impl Iterator<Item = ([f64; 3], [f64; 3])>) -> [f64; 3] {
    let cross = |a: [f64; 3], b: [f64; 3]| glam::DVec3::from(a).cross(glam::DVec3::from(b));
    (pairs.map(|(r, f)| cross(r, f)).sum::<glam::DVec3>() * 0.5).to_array()
}
