//! Queries of a flow: its time, its particles, its conserved quantities.

use super::{Flow, State};
use crate::scalar::{F64x8, Scalar};
use crate::statistics::{self, MomentumRates};
use crate::systems::neighbours::Neighbours;
use crate::systems::particles::{
    Acceleration, Density, PairInputs, ParticleId, Particles, Position, Velocity,
};
use crate::systems::verlet::{Clock, Integrator};
use crate::systems::watch::loneliness;
use crate::vector::Vector;
use std::borrow::Cow;

/// Columns of all particles, particle `k` in row `k`.
#[derive(Default)]
pub(crate) struct Rows<'a, const D: usize> {
    pub(crate) positions: Cow<'a, [Position<D>]>,
    pub(crate) velocities: Cow<'a, [Velocity<D>]>,
    pub(crate) densities: Cow<'a, [Density]>,
}

impl<const D: usize> Flow<D> {
    /// Steps completed.
    pub fn steps(&self) -> u64 {
        self.world.resource::<Clock>().step
    }

    /// Simulation time.
    pub fn time(&self) -> f64 {
        let clock = self.world.resource::<Clock>();
        clock.time_at(clock.step, self.dt())
    }

    /// The time step.
    pub fn dt(&self) -> f64 {
        self.world.resource::<Integrator>().dt
    }

    /// Positions and velocities, particle `k` in row `k`.
    pub fn state(&mut self) -> State<D> {
        let rows = self.rows();
        State {
            time: self.time(),
            positions: rows.positions.iter().map(|r| r.0).collect(),
            velocities: rows.velocities.iter().map(|v| v.0).collect(),
        }
    }

    /// Densities, particle `k` in row `k`.
    pub fn densities(&mut self) -> Vec<f64> {
        self.rows().densities.iter().map(|rho| rho.0).collect()
    }

    /// Columns of all particles, particle `k` in row `k`. They are borrowed where the World stores
    /// them in that order, and sorted where systems or components of a user have changed it.
    pub(crate) fn rows(&self) -> Rows<'_, D> {
        type Row<'a, const D: usize> =
            (&'a ParticleId, &'a Position<D>, &'a Velocity<D>, &'a Density);
        let Some(mut query) = self.world.try_query::<Row<'_, D>>() else {
            return Rows::default();
        };
        let mut tables = query.contiguous_iter(&self.world).into_iter().flatten();
        if let (Some((ids, r, v, rho)), None) = (tables.next(), tables.next())
            && (0..).zip(ids).all(|(row, id)| id.0 == row)
        {
            return Rows { positions: r.into(), velocities: v.into(), densities: rho.into() };
        }
        let mut all: Vec<_> = query.iter(&self.world).collect();
        all.sort_unstable_by_key(|(id, ..)| id.0);
        Rows {
            positions: all.iter().map(|row| *row.1).collect(),
            velocities: all.iter().map(|row| *row.2).collect(),
            densities: all.iter().map(|row| *row.3).collect(),
        }
    }

    /// Accelerations of the last force evaluation, particle `k` in row `k`.
    pub fn accelerations(&mut self) -> Vec<Vector<f64, D>> {
        let count = self.world.resource::<Particles>().0;
        let mut rows = self.world.query::<(&ParticleId, &Acceleration<D>)>();
        let mut all = vec![Vector::zero(); count];
        for (id, a) in rows.iter(&self.world) {
            if let Some(row) = all.get_mut(id.0 as usize) {
                *row = a.0;
            }
        }
        all
    }

    /// Mass of each particle.
    pub fn mass(&self) -> f64 {
        self.model().mass()
    }

    /// Smoothing length `h`.
    pub fn smoothing_length(&self) -> f64 {
        self.model().smoothing().h
    }

    /// The model's pressure `P = A ρ²` at a density; zero for a model without one.
    pub fn pressure(&self, rho: f64) -> f64 {
        let model = self.model();
        let mut scratch = model.scratch();
        model.p_over_rho2(F64x8::of(rho), &mut scratch).lane(0) * rho * rho
    }

    /// `Σ m a` of each term at the last force evaluation.
    pub fn momentum_rates(&self) -> MomentumRates<D> {
        statistics::momentum_rates(self)
    }

    /// Mean number of neighbours within the support.
    pub fn neighbours_per_particle(&self) -> f64 {
        let inputs = self.world.resource::<PairInputs>();
        let pairs = self.world.resource::<Neighbours<D>>().pairs(inputs.particles());
        pairs as f64 / inputs.len().max(1) as f64
    }

    /// The warning that particles have too few neighbours for any pressure.
    pub fn loneliness(&self) -> Option<String> {
        let neighbours = self.world.resource::<Neighbours<D>>();
        loneliness(neighbours, self.world.resource::<PairInputs>())
    }
}
