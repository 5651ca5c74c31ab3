//! What a flow can be asked: where it stands, what its particles do, what it holds.

use super::{Flow, State};
use crate::models::Room;
use crate::scalar::{Lanes, Scalar};
use crate::statistics::{self, MomentumRates};
use crate::systems::neighbours::Neighbours;
use crate::systems::particles::{Acceleration, Cloud, Density, Identity, Position, Velocity};
use crate::systems::verlet::{Clock, Integrator};
use crate::vector::Vector;

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
        let mut state = State { time: self.time(), ..State::default() };
        let mut rows = self.world.query::<(&Identity, &Position<D>, &Velocity<D>)>();
        let count = rows.iter(&self.world).count();
        state.positions.resize(count, Vector::zero());
        state.velocities.resize(count, Vector::zero());
        for (id, r, v) in rows.iter(&self.world) {
            state.positions[id.0 as usize] = r.0;
            state.velocities[id.0 as usize] = v.0;
        }
        state
    }

    /// Densities, particle `k` in row `k`.
    pub fn densities(&mut self) -> Vec<f64> {
        let mut rows = self.world.query::<(&Identity, &Density)>();
        let mut densities = vec![0.0; rows.iter(&self.world).count()];
        rows.iter(&self.world).for_each(|(id, rho)| densities[id.0 as usize] = rho.0);
        densities
    }

    /// Accelerations of the last force evaluation, particle `k` in row `k`.
    pub fn accelerations(&mut self) -> Vec<Vector<f64, D>> {
        let mut rows = self.world.query::<(&Identity, &Acceleration<D>)>();
        let mut all = vec![Vector::zero(); rows.iter(&self.world).count()];
        rows.iter(&self.world).for_each(|(id, a)| all[id.0 as usize] = a.0);
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

    /// The pressure `P = A ρ²` that the model gives to a density; zero where it knows none.
    pub fn pressure(&self, rho: f64) -> f64 {
        let model = self.model();
        let mut room = Room::new(model.network());
        model.stress(Lanes::of(rho), &mut room).lane(0) * rho * rho
    }

    /// `Σ m a` per system at the last force evaluation.
    pub fn momentum_rates(&self) -> MomentumRates<D> {
        statistics::momentum_rates(&self.world)
    }

    /// Mean number of neighbours within the support.
    pub fn neighbours_per_particle(&self) -> f64 {
        let cloud = self.world.resource::<Cloud<D>>();
        let pairs = self.world.resource::<Neighbours<D>>().pairs(cloud);
        pairs as f64 / cloud.len().max(1) as f64
    }
}
