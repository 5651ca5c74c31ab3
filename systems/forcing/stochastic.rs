//! Stochastic forcing: random large-scale modes, redrawn at fixed intervals.

use crate::forcing::{Mode, draw_stochastic_modes};
use crate::pairs::CHUNK;
use crate::scalar::F64x8;
use crate::space::Space;
use crate::systems::acceleration::Laws;
use crate::systems::particles::{Accelerations, AdjointCloud, PairInputs, SensitivityCloud};
use crate::systems::term::{Contribution, ContributionKind, Stage, Term};
use crate::systems::verlet::{Clock, Integrator};
use crate::systems::{Needs, Occasion, Phase};
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use rayon::prelude::*;

/// Term: stochastic forcing, [`crate::forcing::stochastic_modes`].
#[derive(Resource, Clone, Debug)]
pub struct StochasticForcing {
    /// Seed of the phases.
    pub seed: u64,
    /// Time between two draws of the phases. It is not the time step, so that the injected power
    /// does not depend on `dt`.
    pub interval: f64,
    /// Factor on the amplitudes of Woodward et al. (arXiv:2110.13311), appendix A.3.
    pub strength: f64,
    modes: Vec<Mode>,
    drawn: Option<u64>,
    /// Buffer of [`force_stochastically`].
    forces: Vec<[f64; 3]>,
}

impl StochasticForcing {
    /// Forcing with phases that change every `interval`.
    pub fn new(seed: u64, interval: f64, strength: f64) -> Self {
        Self { seed, interval, strength, modes: Vec::new(), drawn: None, forces: Vec::new() }
    }

    fn draw(&mut self, dimension: usize, space: Space, time: f64) {
        // The caller adds half a step to the time, so that round-off cannot move a draw by a step.
        let interval = (time / self.interval).floor() as u64;
        if self.drawn != Some(interval) {
            let drawn = (self.seed, interval);
            draw_stochastic_modes((dimension, space), drawn, &mut self.modes);
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

    /// The force on each particle, minus the mean over the particles, in cell order.
    fn find_forces<const D: usize>(&self, inputs: &PairInputs, into: &mut Vec<[f64; 3]>) {
        let particles = inputs.particles().par_iter().with_min_len(CHUNK);
        particles.map(|p| self.force::<D>(p.position).to_3d()).collect_into_vec(into);
        let mut mean = Vector::<f64, D>::zero();
        into.iter().for_each(|&force| mean += Vector::from_3d(force));
        mean = mean * (1.0 / inputs.len().max(1) as f64);
        into.iter_mut().for_each(|f| *f = (Vector::<f64, D>::from_3d(*f) - mean).to_3d());
    }

    fn tangent<const D: usize>(
        &self,
        position: [f64; 3],
        change: Vector<F64x8, D>,
    ) -> Vector<F64x8, D> {
        let mut force = Vector::zero();
        for mode in &self.modes {
            let mut angle = F64x8::ZERO;
            (0..D).for_each(|axis| angle += change[axis] * mode.k[axis]);
            let wave = angle * (-self.strength * mode.angle(position).sin());
            (0..D).for_each(|axis| force[axis] += wave * mode.amplitude[axis]);
        }
        force
    }
}

impl<const D: usize> Term<D> for StochasticForcing {
    fn name(&self) -> String {
        "stochastic forcing".to_owned()
    }

    fn insert(&self, _: &[usize], world: &mut World) {
        world.insert_resource(self.clone());
    }

    fn stages(&self, occasion: Occasion, _: &Needs) -> Vec<Stage> {
        let stage = || {
            Stage::new(Phase::Forcing, force_stochastically::<D>)
                .tangent(force_stochastically_tangent::<D>)
                .pullback(force_stochastically_pullback::<D>)
        };
        if occasion.has_forces() { vec![stage()] } else { Vec::new() }
    }

    fn contributions(&self, world: &World) -> Vec<Contribution<D>> {
        let (inputs, mut forces) = (world.resource::<PairInputs>(), Vec::new());
        world.get_resource::<Self>().unwrap_or(self).find_forces::<D>(inputs, &mut forces);
        let forces: Vec<Vector<f64, D>> = forces.into_iter().map(Vector::from_3d).collect();
        let mass = world.resource::<Laws<D>>().model().mass();
        let kind = ContributionKind::Forcing;
        vec![Contribution::of(Term::<D>::name(self), kind, mass, &forces)]
    }
}

/// System: adds the stochastic force minus its mean over the particles, so that the total momentum
/// is not forced.
fn force_stochastically<const D: usize>(
    clock: Res<Clock>,
    integrator: Res<Integrator>,
    mut forcing: ResMut<StochasticForcing>,
    inputs: Res<PairInputs>,
    mut accelerations: ResMut<Accelerations<D>>,
) {
    let time = clock.time_at(clock.evaluated, integrator.dt);
    forcing.draw(D, integrator.space, time + 0.5 * integrator.dt);
    let mut forces = std::mem::take(&mut forcing.forces);
    forcing.find_forces::<D>(&inputs, &mut forces);
    for (a, &force) in accelerations.0.iter_mut().zip(&forces) {
        *a += Vector::from_3d(force);
    }
    forcing.forces = forces;
}

/// System: the tangent of [`force_stochastically`].
fn force_stochastically_tangent<const D: usize>(
    forcing: Res<StochasticForcing>,
    inputs: Res<PairInputs>,
    mut sensitivities: ResMut<SensitivityCloud<D>>,
) {
    let full = sensitivities.coupling == crate::sensitivity::Coupling::Full;
    let each = 1.0 / inputs.len().max(1) as f64;
    for block in &mut sensitivities.blocks {
        let lines = block.packed.par_iter().zip(inputs.particles()).with_min_len(CHUNK);
        let changes: Vec<Vector<F64x8, D>> =
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

/// System: the pullback of [`force_stochastically`].
fn force_stochastically_pullback<const D: usize>(
    (clock, integrator): (Res<Clock>, Res<Integrator>),
    mut forcing: ResMut<StochasticForcing>,
    inputs: Res<PairInputs>,
    mut adjoint: ResMut<AdjointCloud<D>>,
) {
    let time = clock.time_at(clock.evaluated, integrator.dt);
    forcing.draw(D, integrator.space, time + 0.5 * integrator.dt);
    let AdjointCloud { packed, position, .. } = &mut *adjoint;
    let mut mean = Vector::<f64, D>::zero();
    packed.iter().for_each(|line| mean += Vector::from_3d(line.force));
    mean = mean * (1.0 / inputs.len().max(1) as f64);
    for ((p, line), out) in inputs.particles().iter().zip(packed).zip(position) {
        let across = Vector::<f64, D>::from_3d(line.force) - mean;
        for mode in &forcing.modes {
            let amplitude = Vector::<f64, D>::from_3d(mode.amplitude);
            let wave = -forcing.strength * mode.angle(p.position).sin() * amplitude.dot(across);
            *out += Vector::from_3d(mode.k) * wave;
        }
    }
}
