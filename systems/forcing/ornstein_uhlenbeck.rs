//! Ornstein–Uhlenbeck forcing: large-scale waves with a correlation time.

use crate::forcing::ornstein_uhlenbeck::{OrnsteinUhlenbeck, Settings};
use crate::pairs::CHUNK;
use crate::scalar::F64x8;
use crate::scene::Scene;
use crate::sensitivity::Coupling;
use crate::systems::acceleration::Laws;
use crate::systems::particles::{Accelerations, AdjointCloud, PairInputs, SensitivityCloud};
use crate::systems::term::{Contribution, ContributionKind, Stage, Term};
use crate::systems::verlet::Clock;
use crate::systems::{Needs, Occasion, Phase};
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use rayon::prelude::*;

/// Term: a solenoidal large-scale force with a correlation time, [`OrnsteinUhlenbeck`], minus its
/// mean over the particles, so that the total momentum is not forced.
#[derive(Resource, Clone, Debug)]
pub struct OrnsteinUhlenbeckForcing {
    process: OrnsteinUhlenbeck,
    /// Buffer of [`force_by_waves`].
    forces: Vec<[f64; 3]>,
}

impl OrnsteinUhlenbeckForcing {
    /// The forcing of a scene with these settings; its seed draws the amplitudes.
    pub fn new(scene: &Scene, settings: Settings) -> Self {
        let (space, dt) = (scene.space(), scene.dt());
        let process = OrnsteinUhlenbeck::new(settings, scene.dimension, space, dt, scene.seed);
        Self { process, forces: Vec::new() }
    }

    /// The force on each particle at a step, minus the mean over the particles, in cell order.
    fn find_forces<const D: usize>(
        &mut self,
        (inputs, step): (&PairInputs, u64),
        into: &mut Vec<[f64; 3]>,
    ) {
        let waves = self.process.modes_at(step);
        let particles = inputs.particles().par_iter().with_min_len(CHUNK);
        particles.map(|p| waves.at::<D>(p.position).to_3d()).collect_into_vec(into);
        let mut mean = Vector::<f64, D>::zero();
        into.iter().for_each(|&force| mean += Vector::from_3d(force));
        mean = mean * (1.0 / inputs.len().max(1) as f64);
        into.iter_mut().for_each(|f| *f = (Vector::<f64, D>::from_3d(*f) - mean).to_3d());
    }
}

impl<const D: usize> Term<D> for OrnsteinUhlenbeckForcing {
    fn name(&self) -> String {
        "Ornstein–Uhlenbeck forcing".to_owned()
    }

    fn insert(&self, _: &[usize], world: &mut World) {
        world.insert_resource(self.clone());
    }

    fn stages(&self, occasion: Occasion, _: &Needs) -> Vec<Stage> {
        let stage = || {
            Stage::new(Phase::Forcing, force_by_waves::<D>)
                .tangent(force_by_waves_tangent::<D>)
                .pullback(force_by_waves_pullback::<D>)
        };
        if occasion.has_forces() { vec![stage()] } else { Vec::new() }
    }

    fn contributions(&self, world: &World) -> Vec<Contribution<D>> {
        let (inputs, clock) = (world.resource::<PairInputs>(), world.resource::<Clock>());
        let mut forces = Vec::new();
        self.clone().find_forces::<D>((inputs, clock.evaluated), &mut forces);
        let forces: Vec<Vector<f64, D>> = forces.into_iter().map(Vector::from_3d).collect();
        let mass = world.resource::<Laws<D>>().model().mass();
        let kind = ContributionKind::Forcing;
        vec![Contribution::of(Term::<D>::name(self), kind, mass, &forces)]
    }
}

/// System: adds the force of the waves.
fn force_by_waves<const D: usize>(
    clock: Res<Clock>,
    mut forcing: ResMut<OrnsteinUhlenbeckForcing>,
    inputs: Res<PairInputs>,
    mut accelerations: ResMut<Accelerations<D>>,
) {
    let mut forces = std::mem::take(&mut forcing.forces);
    forcing.find_forces::<D>((&inputs, clock.evaluated), &mut forces);
    for (a, &force) in accelerations.0.iter_mut().zip(&forces) {
        *a += Vector::from_3d(force);
    }
    forcing.forces = forces;
}

/// System: the tangent of [`force_by_waves`].
fn force_by_waves_tangent<const D: usize>(
    clock: Res<Clock>,
    mut forcing: ResMut<OrnsteinUhlenbeckForcing>,
    inputs: Res<PairInputs>,
    mut sensitivities: ResMut<SensitivityCloud<D>>,
) {
    let waves = forcing.process.modes_at(clock.evaluated);
    let full = sensitivities.coupling == Coupling::Full;
    let each = 1.0 / inputs.len().max(1) as f64;
    for block in &mut sensitivities.blocks {
        let lines = block.packed.par_iter().zip(inputs.particles()).with_min_len(CHUNK);
        let changes: Vec<Vector<F64x8, D>> =
            lines.map(|(change, p)| waves.tangent(p.position, change.position)).collect();
        let mut mean = Vector::zero();
        if full {
            changes.iter().for_each(|&change| mean += change);
        }
        for (a, &change) in block.acceleration.iter_mut().zip(&changes) {
            let shared = if full { mean } else { change };
            *a += change - shared.map(|x| x * each);
        }
    }
}

/// System: the pullback of [`force_by_waves`].
fn force_by_waves_pullback<const D: usize>(
    clock: Res<Clock>,
    mut forcing: ResMut<OrnsteinUhlenbeckForcing>,
    inputs: Res<PairInputs>,
    mut adjoint: ResMut<AdjointCloud<D>>,
) {
    let waves = forcing.process.modes_at(clock.evaluated);
    let AdjointCloud { packed, position, .. } = &mut *adjoint;
    let mut mean = Vector::<f64, D>::zero();
    packed.iter().for_each(|line| mean += Vector::from_3d(line.force));
    mean = mean * (1.0 / inputs.len().max(1) as f64);
    let rows = position.par_iter_mut().zip(inputs.particles()).zip(&*packed);
    rows.with_min_len(CHUNK).for_each(|((out, p), line)| {
        *out += waves.pullback(p.position, Vector::from_3d(line.force) - mean);
    });
}
