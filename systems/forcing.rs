//! Forcing as systems: appendix A.3 over the cloud, and its tangents.

use super::acceleration::Law;
use super::neighbours::CHUNK;
use super::particles::{AdjointCloud, Cloud, SensitivityBlock, SensitivityCloud};
use super::verlet::{Clock, Integrator};
use crate::cells::FEWEST;
use crate::forcing::{EnergyInjection, Mode, Power, stochastic_modes};
use crate::models::Parameter;
use crate::packed::{Packed, PackedSensitivity};
use crate::scalar::Lanes;
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use rayon::prelude::*;

/// Deterministic forcing of a World, with the law it last obeyed.
#[derive(Resource, Clone, Debug)]
pub struct DeterministicForcing {
    /// What `θ` means.
    pub power: Power,
    law: Option<EnergyInjection>,
}

impl DeterministicForcing {
    /// Forcing whose `θ` is a parameter of the model.
    pub fn new(power: Power) -> Self {
        Self { power, law: None }
    }

    /// The law for the velocities that a cloud now holds.
    fn now<const D: usize>(&self, cloud: &Cloud<D>) -> Option<EnergyInjection> {
        let particles = cloud.particles();
        self.law.map(|law| EnergyInjection::new(law.theta, self.power, particles, |p| p.velocity))
    }
}

/// The forces of whatever forcing a World has, in cell order, as its cloud stands.
pub fn external_forces<const D: usize>(world: &World) -> Vec<Vector<f64, D>> {
    let cloud = world.resource::<Cloud<D>>();
    let particles = cloud.particles().iter();
    if let Some(law) = world.get_resource::<DeterministicForcing>().and_then(|f| f.now(cloud)) {
        return particles.map(|p| law.force(p.velocity)).collect();
    }
    match world.get_resource::<StochasticForcing>() {
        Some(forcing) => forcing.forces(cloud),
        None => vec![Vector::zero(); cloud.len()],
    }
}

/// System: adds `f = (θ/E)(v − v̄)`.
pub fn force_deterministically<const D: usize>(
    law: Res<Law<D>>,
    mut forcing: ResMut<DeterministicForcing>,
    mut cloud: ResMut<Cloud<D>>,
) {
    let theta = law.0.parameters().get(Parameter::Theta);
    let particles = cloud.particles();
    let injection = EnergyInjection::new(theta, forcing.power, particles, |p| p.velocity);
    let Cloud { packed, acceleration, .. } = &mut *cloud;
    let lines = acceleration.par_iter_mut().zip(packed).with_min_len(FEWEST);
    lines.for_each(|(a, p)| *a += injection.force(p.velocity));
    forcing.law = Some(injection);
}

/// System: the tangent of [`force_deterministically`]: `v̄` and `E` couple all particles, so two sums
/// over all of them come first.
pub fn force_deterministically_tangent<const D: usize>(
    forcing: Res<DeterministicForcing>,
    cloud: Res<Cloud<D>>,
    mut sensitivities: ResMut<SensitivityCloud<D>>,
) {
    let Some(law) = forcing.law else { return };
    let full = sensitivities.coupling == crate::sensitivity::Coupling::Full;
    let particles = cloud.particles();
    sensitivities.blocks.par_iter_mut().for_each(|block| {
        let SensitivityBlock { packed, acceleration, directions, .. } = block;
        let theta = directions[Parameter::Theta.index()];
        let of = |particles: &[Packed], changes: &[PackedSensitivity<D>]| {
            law.tangent(cloud.len(), law.sums(particles, changes), theta)
        };
        if full {
            let all = of(particles, packed);
            let chunks = acceleration.par_chunks_mut(CHUNK).zip(packed.par_chunks(CHUNK));
            let chunks = chunks.zip(particles.par_chunks(CHUNK));
            chunks.for_each(|((out, changes), rows)| all.add_force(&law, (rows, changes), out));
        } else {
            for (slot, a) in acceleration.chunks_mut(1).enumerate() {
                let (change, particle) = (&packed[slot..=slot], &particles[slot..=slot]);
                of(particle, change).add_force(&law, (particle, change), a);
            }
        }
    });
}

/// Stochastic forcing of a World.
#[derive(Resource, Clone, Debug)]
pub struct StochasticForcing {
    /// Seed of the phases.
    pub seed: u64,
    /// Time after which the phases are drawn anew: not per step, so that the injected power does
    /// not depend on `dt`.
    pub interval: f64,
    /// Factor on the paper's amplitudes.
    pub strength: f64,
    modes: Vec<Mode>,
    drawn: Option<u64>,
}

impl StochasticForcing {
    /// Forcing with phases that change every `interval`.
    pub fn new(seed: u64, interval: f64, strength: f64) -> Self {
        Self { seed, interval, strength, modes: Vec::new(), drawn: None }
    }

    fn draw(&mut self, dimension: usize, length: f64, time: f64) {
        // Half a step of slack in time, so that round-off cannot move a redraw by a step.
        let interval = (time / self.interval).floor() as u64;
        if self.drawn != Some(interval) {
            self.modes = stochastic_modes(dimension, length, self.seed, interval);
            self.drawn = Some(interval);
        }
    }

    fn force<const D: usize>(&self, position: [f64; 3]) -> Vector<f64, D> {
        let mut force = Vector::zero();
        for mode in &self.modes {
            let wave = self.strength * mode.angle(position).cos();
            (0..D).for_each(|axis| force[axis] += mode.amplitude[axis] * wave);
        }
        force
    }

    /// The force on each particle less their mean, in cell order.
    fn forces<const D: usize>(&self, cloud: &Cloud<D>) -> Vec<Vector<f64, D>> {
        let particles = cloud.particles().par_iter().with_min_len(CHUNK);
        let mut forces: Vec<Vector<f64, D>> = particles.map(|p| self.force(p.position)).collect();
        let mut mean = Vector::zero();
        forces.iter().for_each(|&force| mean += force);
        mean = mean * (1.0 / cloud.len().max(1) as f64);
        forces.iter_mut().for_each(|force| *force -= mean);
        forces
    }

    fn tangent<const D: usize>(
        &self,
        position: [f64; 3],
        change: Vector<Lanes, D>,
    ) -> Vector<Lanes, D> {
        let mut force = Vector::zero();
        for mode in &self.modes {
            let mut angle = Lanes::ZERO;
            (0..D).for_each(|axis| angle += change[axis] * mode.k[axis]);
            let wave = angle * (-self.strength * mode.angle(position).sin());
            (0..D).for_each(|axis| force[axis] += wave * mode.amplitude[axis]);
        }
        force
    }
}

/// System: adds the stochastic force less its mean over the particles, which would push the whole
/// flow.
pub fn force_stochastically<const D: usize>(
    clock: Res<Clock>,
    integrator: Res<Integrator>,
    neighbours: Res<super::neighbours::Neighbours<D>>,
    mut forcing: ResMut<StochasticForcing>,
    mut cloud: ResMut<Cloud<D>>,
) {
    let time = clock.time_at(clock.evaluated, integrator.dt);
    forcing.draw(D, neighbours.space.length, time + 0.5 * integrator.dt);
    let forces = forcing.forces(&cloud);
    for (a, force) in cloud.acceleration.iter_mut().zip(forces) {
        *a += force;
    }
}

/// System: the tangent of [`force_stochastically`].
pub fn force_stochastically_tangent<const D: usize>(
    forcing: Res<StochasticForcing>,
    cloud: Res<Cloud<D>>,
    mut sensitivities: ResMut<SensitivityCloud<D>>,
) {
    let full = sensitivities.coupling == crate::sensitivity::Coupling::Full;
    let each = 1.0 / cloud.len().max(1) as f64;
    for block in &mut sensitivities.blocks {
        let lines = block.packed.par_iter().zip(cloud.particles()).with_min_len(CHUNK);
        let changes: Vec<Vector<Lanes, D>> =
            lines.map(|(change, p)| forcing.tangent(p.position, change.position)).collect();
        let mut mean = Vector::zero();
        if full {
            for &change in &changes {
                mean += change;
            }
        }
        for (a, &change) in block.acceleration.iter_mut().zip(&changes) {
            let shared = if full { mean } else { change };
            *a += change - shared.map(|x| x * each);
        }
    }
}

/// System: the pullback of [`force_deterministically`].
pub fn force_deterministically_pullback<const D: usize>(
    forcing: Res<DeterministicForcing>,
    cloud: Res<Cloud<D>>,
    mut adjoint: ResMut<AdjointCloud<D>>,
) {
    let Some(law) = forcing.now(&cloud) else { return };
    let AdjointCloud { packed, velocity, parameters, .. } = &mut *adjoint;
    let velocities = cloud.particles().iter().map(|p| p.velocity);
    let forces = packed.iter().map(|line| line.force);
    parameters[Parameter::Theta.index()] += law.pullback(velocities, forces, velocity);
}

/// System: the pullback of [`force_stochastically`].
pub fn force_stochastically_pullback<const D: usize>(
    (clock, integrator): (Res<Clock>, Res<Integrator>),
    neighbours: Res<super::neighbours::Neighbours<D>>,
    mut forcing: ResMut<StochasticForcing>,
    cloud: Res<Cloud<D>>,
    mut adjoint: ResMut<AdjointCloud<D>>,
) {
    let time = clock.time_at(clock.evaluated, integrator.dt);
    forcing.draw(D, neighbours.space.length, time + 0.5 * integrator.dt);
    let AdjointCloud { packed, position, .. } = &mut *adjoint;
    let mut mean = Vector::<f64, D>::zero();
    packed.iter().for_each(|line| mean += Vector::from_3d(line.force));
    mean = mean * (1.0 / cloud.len().max(1) as f64);
    for ((p, line), out) in cloud.particles().iter().zip(packed).zip(position) {
        let across = Vector::<f64, D>::from_3d(line.force) - mean;
        for mode in &forcing.modes {
            let amplitude = Vector::<f64, D>::from_3d(mode.amplitude);
            let wave = -forcing.strength * mode.angle(p.position).sin() * amplitude.dot(across);
            *out += Vector::from_3d(mode.k) * wave;
        }
    }
}
