//! Conserved quantities of a flow.

use super::MomentumRates;
use crate::flow::{Flow, Rows};
use crate::models::FluidConstants;
use crate::reduce::{Partial, in_order};
use crate::state::internal_energies;
use crate::systems::neighbours::CHUNK;
use crate::vector::Vector;
use rayon::prelude::*;

/// Conserved quantities of a flow at one step.
///
/// Every list has one entry per dimension. `momentum_*` are sums of `m a` over all particles, one
/// per system that accelerates them: round-off if that system conserves momentum. They need
/// additional force evaluations, and are empty if they are not requested (`record.momentum_every`).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Conservation {
    /// The step, from 0.
    pub step: u64,
    /// Simulation time.
    pub time: f64,
    /// `Σ m |v|² / 2`.
    pub kinetic_energy: f64,
    /// Kinetic and internal energy, `Σ m (|v|²/2 + e(ρ))`.
    pub total_energy: f64,
    /// Largest speed divided by the speed of sound.
    pub max_mach: f64,
    /// Largest `|ρ/ρ₀ − 1|`.
    pub max_density_deviation: f64,
    /// Linear momentum `Σ m v`.
    pub momentum: Vec<f64>,
    /// `Σ m a` of the pressure.
    pub momentum_pressure: Vec<f64>,
    /// `Σ m a` of the viscosity.
    pub momentum_viscosity: Vec<f64>,
    /// `Σ m a` of the forcing.
    pub momentum_forcing: Vec<f64>,
    /// Courant number `dt (c + max |v|) / h`.
    pub courant: f64,
    /// Names of the parts of all terms that accelerate particles.
    pub terms: Vec<String>,
    /// `Σ m a` of each part, one vector after another.
    pub momentum_terms: Vec<f64>,
}

/// The conserved quantities of a flow's current state.
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
        in_order(Self::NOTHING, parts)
    }

    fn see_velocity(&mut self, velocity: Vector<f64, D>) {
        let square = velocity.norm_squared();
        self.velocity += velocity;
        self.squares += square;
        self.largest_square = self.largest_square.max(square);
    }
}

impl<const D: usize> Partial for Sums<D> {
    fn merge(&mut self, next: Self) {
        self.velocity += next.velocity;
        self.squares += next.squares;
        self.largest_square = self.largest_square.max(next.largest_square);
        self.internal_energy += next.internal_energy;
        self.deviation = self.deviation.max(next.deviation);
    }
}
