//! Deterministic forcing: injects energy at a constant rate, `f = (θ/E)(v − v̄)`.

use crate::forcing::{EnergyInjection, Power};
use crate::neighbours::cells::MIN_PARALLEL_LEN;
use crate::packed::{Packed, PackedSensitivity};
use crate::pairs::CHUNK;
use crate::parameters::{Parameter, ParameterSpec};
use crate::systems::acceleration::Laws;
use crate::systems::particles::{
    Accelerations, AdjointCloud, PairInputs, SensitivityBlock, SensitivityCloud,
};
use crate::systems::term::{Contribution, ContributionKind, Stage, Term};
use crate::systems::{Needs, Occasion, Phase};
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use rayon::prelude::*;

/// Term: energy injection at the power `θ`, [`EnergyInjection`].
#[derive(Resource, Clone, Copy, Debug)]
pub struct DeterministicForcing {
    /// Power `θ`.
    pub theta: f64,
    /// What `θ` means.
    pub power: Power,
    /// Place of `θ` in the flat vector of parameters.
    place: usize,
    /// The law of the last force evaluation.
    law: Option<EnergyInjection>,
}

impl DeterministicForcing {
    /// Forcing of a given power.
    pub fn new(theta: f64, power: Power) -> Self {
        Self { theta, power, place: 0, law: None }
    }

    /// The law for the velocities in a inputs.
    fn now(&self, inputs: &PairInputs) -> EnergyInjection {
        EnergyInjection::new(self.theta, self.power, inputs.particles(), |p| p.velocity)
    }
}

impl<const D: usize> Term<D> for DeterministicForcing {
    fn name(&self) -> String {
        "deterministic forcing".to_owned()
    }

    fn parameters(&self) -> Vec<ParameterSpec> {
        vec![ParameterSpec::new(Parameter::THETA, self.theta)]
    }

    fn insert(&self, places: &[usize], world: &mut World) {
        world.insert_resource(Self { place: places.first().copied().unwrap_or_default(), ..*self });
    }

    fn set_parameters(&self, values: &[f64], world: &mut World) {
        if let (Some(mut forcing), Some(&theta)) =
            (world.get_resource_mut::<Self>(), values.first())
        {
            forcing.theta = theta;
        }
    }

    fn stages(&self, occasion: Occasion, _: &Needs) -> Vec<Stage> {
        let stage = || {
            Stage::new(Phase::Forcing, force_deterministically::<D>)
                .tangent(force_deterministically_tangent::<D>)
                .pullback(force_deterministically_pullback::<D>)
        };
        if occasion.has_forces() { vec![stage()] } else { Vec::new() }
    }

    fn contributions(&self, world: &World) -> Vec<Contribution<D>> {
        let inputs = world.resource::<PairInputs>();
        let law = world.get_resource::<Self>().unwrap_or(self).now(inputs);
        let forces: Vec<Vector<f64, D>> =
            inputs.particles().iter().map(|p| law.force(p.velocity)).collect();
        let mass = world.resource::<Laws<D>>().model().mass();
        let kind = ContributionKind::Forcing;
        vec![Contribution::of(Term::<D>::name(self), kind, mass, &forces)]
    }
}

/// System: adds `f = (θ/E)(v − v̄)`.
fn force_deterministically<const D: usize>(
    mut forcing: ResMut<DeterministicForcing>,
    inputs: Res<PairInputs>,
    mut accelerations: ResMut<Accelerations<D>>,
) {
    let injection = forcing.now(&inputs);
    let lines =
        accelerations.0.par_iter_mut().zip(inputs.particles()).with_min_len(MIN_PARALLEL_LEN);
    lines.for_each(|(a, p)| *a += injection.force(p.velocity));
    forcing.law = Some(injection);
}

/// System: the tangent of [`force_deterministically`]. `v̄` and `E` couple all particles, so that
/// two sums over all particles are needed first.
fn force_deterministically_tangent<const D: usize>(
    forcing: Res<DeterministicForcing>,
    inputs: Res<PairInputs>,
    mut sensitivities: ResMut<SensitivityCloud<D>>,
) {
    let Some(law) = forcing.law else { return };
    let full = sensitivities.coupling == crate::sensitivity::Coupling::Full;
    let particles = inputs.particles();
    sensitivities.blocks.par_iter_mut().for_each(|block| {
        let theta = block.direction(forcing.place);
        let SensitivityBlock { packed, acceleration, .. } = block;
        let of = |particles: &[Packed], changes: &[PackedSensitivity<D>]| {
            law.tangent(inputs.len(), law.sums(particles, changes), theta)
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

/// System: the pullback of [`force_deterministically`].
fn force_deterministically_pullback<const D: usize>(
    forcing: Res<DeterministicForcing>,
    inputs: Res<PairInputs>,
    mut adjoint: ResMut<AdjointCloud<D>>,
) {
    let law = forcing.now(&inputs);
    let AdjointCloud { packed, velocity, parameters, .. } = &mut *adjoint;
    let velocities = inputs.particles().iter().map(|p| p.velocity);
    let forces = packed.iter().map(|line| line.force);
    parameters[forcing.place] += law.pullback(velocities, forces, velocity);
}
