//! Measured quantities of a flow: conserved quantities, and the contribution of each system.

mod dispersion;
mod increments;
mod spectrum;
mod structure;

pub use dispersion::{Displacement, close_pairs, pair_dispersion};
pub use increments::Moments;
pub use spectrum::energy_spectrum;
pub use structure::{Structure, structure_functions};

use crate::flow::{Flow, Rows};
use crate::models::FluidConstants;
use crate::recording::Conservation;
use crate::state::{internal_energies, tait};
use crate::systems::neighbours::CHUNK;
use crate::systems::term::{Contribution, ContributionKind};
use crate::vector::Vector;
use rayon::prelude::*;

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

/// The turnover time of the largest eddies: `L/2π` divided by the root mean square of a component
/// of `v − v̄`.
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

/// The record `/diag/conservation` of a flow's current state.
pub fn conservation<const D: usize>(flow: &mut Flow<D>) -> Conservation {
    conservation_of(flow, &flow.rows(), true)
}

/// The same for given rows. The momentum rates of each system, which need force evaluations, are
/// included only if requested.
pub(crate) fn conservation_of<const D: usize>(
    flow: &Flow<D>,
    rows: &Rows<'_, D>,
    by_system: bool,
) -> Conservation {
    let fluid = flow.model().medium().fluid;
    let c = fluid.c;
    let (sums, mass) = (Sums::of(rows, &fluid), flow.mass());
    let (kinetic, fastest) = (0.5 * mass * sums.squares, sums.largest_square.sqrt());
    let rates = by_system.then(|| flow.momentum_rates());
    let rate = |rate: fn(&MomentumRates<D>) -> Vector<f64, D>| {
        rates.iter().flat_map(|rates| rate(rates).0).collect()
    };
    let terms = || rates.iter().flat_map(|rates| &rates.contributions);
    Conservation {
        step: flow.steps(),
        time: flow.time(),
        kinetic_energy: kinetic,
        total_energy: kinetic + mass * sums.internal_energy,
        max_mach: fastest / c,
        max_density_deviation: sums.deviation,
        momentum: (sums.velocity * mass).0.to_vec(),
        momentum_pressure: rate(|rates| rates.pressure),
        momentum_viscosity: rate(|rates| rates.viscosity),
        momentum_forcing: rate(|rates| rates.forcing),
        terms: terms().map(|found| found.name.clone()).collect(),
        momentum_terms: terms().flat_map(|found| found.rate.0).collect(),
        courant: flow.dt() * (c + fastest) / flow.smoothing_length(),
    }
}

/// Sums over particles in one pass, chunk by chunk, so that they do not depend on threads.
#[derive(Clone, Copy, Debug)]
struct Sums<const D: usize> {
    /// `Σ v`.
    velocity: Vector<f64, D>,
    /// `Σ |v|²`.
    squares: f64,
    /// Largest `|v|²`.
    largest_square: f64,
    /// `Σ e(ρ)`.
    internal_energy: f64,
    /// Largest `|ρ − 1|`.
    deviation: f64,
}

impl<const D: usize> Sums<D> {
    const NOTHING: Self = Self {
        velocity: Vector([0.0; D]),
        squares: 0.0,
        largest_square: 0.0,
        internal_energy: 0.0,
        deviation: 0.0,
    };

    fn of(rows: &Rows<'_, D>, &FluidConstants { c, gamma, p0, .. }: &FluidConstants) -> Self {
        let velocities = rows.velocities.par_chunks(CHUNK);
        let parts = velocities.zip(rows.densities.par_chunks(CHUNK)).map(|(v, rho)| {
            let mut sums = Self::NOTHING;
            v.iter().for_each(|v| sums.see_velocity(v.0));
            rho.iter().for_each(|rho| sums.deviation = sums.deviation.max((rho.0 - 1.0).abs()));
            sums.internal_energy = internal_energies(rho.iter().map(|rho| rho.0), c, gamma);
            if p0 != 0.0 {
                // ∫ p₀/ρ² dρ from ρ₀ = 1.
                sums.internal_energy += p0 * rho.iter().map(|rho| 1.0 - 1.0 / rho.0).sum::<f64>();
            }
            sums
        });
        let parts: Vec<Self> = parts.collect();
        parts.into_iter().fold(Self::NOTHING, Self::and)
    }

    fn see_velocity(&mut self, velocity: Vector<f64, D>) {
        let square = velocity.norm_squared();
        self.velocity += velocity;
        self.squares += square;
        self.largest_square = self.largest_square.max(square);
    }

    fn and(mut self, other: Self) -> Self {
        self.velocity += other.velocity;
        self.squares += other.squares;
        self.largest_square = self.largest_square.max(other.largest_square);
        self.internal_energy += other.internal_energy;
        self.deviation = self.deviation.max(other.deviation);
        self
    }
}

/// `Σᵢ rᵢ × Fᵢ` with each pair force at its minimum image, `½ Σᵢⱼ rᵢⱼ × m aᵢⱼ`: zero to round-off for
/// central forces. In 2D only the last component differs from zero.
pub fn pair_torque(pairs: impl Iterator<Item = ([f64; 3], [f64; 3])>) -> [f64; 3] {
    let cross = |a: [f64; 3], b: [f64; 3]| glam::DVec3::from(a).cross(glam::DVec3::from(b));
    (pairs.map(|(r, f)| cross(r, f)).sum::<glam::DVec3>() * 0.5).to_array()
}
