//! Measured quantities of a flow: conserved quantities, and the contribution of each system.

mod conservation;
mod dispersion;
mod increments;
#[cfg(feature = "laboratory")]
mod spectrum;
mod structure;
#[cfg(feature = "laboratory")]
mod turbulence;

#[cfg(feature = "laboratory")]
pub(crate) use conservation::conservation_of;
pub use conservation::{Conservation, conservation};
pub use dispersion::{Displacement, close_pairs, pair_dispersion};
pub use increments::Moments;
#[cfg(feature = "laboratory")]
pub use spectrum::energy_spectrum;
pub use structure::{Structure, structure_functions};
#[cfg(feature = "laboratory")]
pub use turbulence::{Turbulence, ViscosityOf, acting_viscosity};

use crate::flow::Flow;
use crate::models::FluidConstants;
use crate::state::tait;
use crate::systems::term::{Contribution, ContributionKind};
use crate::vector::Vector;

/// `Σ m a` over all particles, term by term: zero to round-off where a term conserves momentum.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MomentumRates<const D: usize> {
    /// Of every part of every term.
    pub contributions: Vec<Contribution<D>>,
    /// Of the pressure, or of the learned function in its place: the first part of the model.
    pub pressure: Vector<f64, D>,
    /// Of the viscosity: the second part of the model, and the pair laws added to it.
    pub viscosity: Vector<f64, D>,
    /// Of the forces on each particle.
    pub forcing: Vector<f64, D>,
    /// `Σ m |a|` of all, with which round-off is compared.
    pub scale: f64,
}

/// `Σ m a` of every term at the current state, part by part.
pub(crate) fn momentum_rates<const D: usize>(flow: &Flow<D>) -> MomentumRates<D> {
    let mut rates = MomentumRates::default();
    for term in flow.terms() {
        for found in term.contributions(flow.world()) {
            let sum = match found.kind {
                ContributionKind::Pressure => &mut rates.pressure,
                ContributionKind::Viscosity => &mut rates.viscosity,
                ContributionKind::Forcing => &mut rates.forcing,
            };
            *sum += found.rate;
            rates.scale += found.scale;
            rates.contributions.push(found);
        }
    }
    rates
}

/// `Σ m v` (or `Σ m a`).
pub fn momentum<const D: usize>(mass: f64, velocities: &[Vector<f64, D>]) -> Vector<f64, D> {
    let mut sum = Vector::zero();
    velocities.iter().for_each(|&v| sum += v);
    sum * mass
}

/// The turnover time of the largest eddies of a box of (longest) side `L`: `L/2π` divided by the root mean
/// square of a component of `v − v̄`.
pub fn eddy_time<const D: usize>(velocities: &[Vector<f64, D>], box_length: f64) -> f64 {
    let count = velocities.len() as f64;
    let mean = momentum(1.0 / count, velocities);
    let square: f64 = velocities.iter().map(|&v| (v - mean).norm_squared()).sum();
    box_length / (std::f64::consts::TAU * (square / (count * D as f64)).sqrt())
}

/// The largest difference of a flow's pressure from Tait's with these constants, over densities
/// from `lowest` to `highest`, divided by the largest pressure there.
pub fn pressure_error<const D: usize>(
    flow: &Flow<D>,
    fluid: &FluidConstants,
    (lowest, highest): (f64, f64),
) -> f64 {
    let FluidConstants { c, gamma, p0, .. } = *fluid;
    let (mut apart, mut largest) = (0.0_f64, 0.0_f64);
    for k in 0..=200 {
        let rho = lowest + (highest - lowest) * f64::from(k) / 200.0;
        let truth = tait(rho, c, gamma) + p0;
        apart = apart.max((flow.pressure(rho) - truth).abs());
        largest = largest.max(truth.abs());
    }
    apart / largest
}

/// `Σᵢ rᵢ × Fᵢ` with each pair force at its minimum image, `½ Σᵢⱼ rᵢⱼ × m aᵢⱼ`: zero to round-off for
/// central forces. In 2D only the last component differs from zero.
pub fn pair_torque(pairs: impl Iterator<Item = ([f64; 3], [f64; 3])>) -> [f64; 3] {
    let cross = |a: [f64; 3], b: [f64; 3]| glam::DVec3::from(a).cross(glam::DVec3::from(b));
    (pairs.map(|(r, f)| cross(r, f)).sum::<glam::DVec3>() * 0.5).to_array()
}
