//! Terms: the parts of a flow. Every contribution to the motion, every loss and every limit is one
//! object that names the systems it needs, forwards and for derivatives. All schedules follow from
//! the list of terms.

use super::columns::Column;
use super::{Needs, Occasion, Phase};
use crate::parameters::ParameterSpec;
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use bevy_ecs::schedule::ScheduleConfigs;
use bevy_ecs::system::ScheduleSystem;
use std::fmt::Debug;

/// Systems with their order.
pub type Systems = ScheduleConfigs<ScheduleSystem>;

/// One contribution to the motion, one loss or one limit.
///
/// A term without a tangent can run forwards, but a forward gradient of a flow that holds it is
/// refused, with the name of the term; likewise an adjoint for a term without a pullback.
///
/// A force on each particle that depends on its own state is written more shortly as a
/// [`ParticleForce`](super::particle_force::ParticleForce), and a force between two particles as a
/// [`CentralForce`](crate::models::CentralForce). Both are differentiated with dual numbers.
pub trait Term<const D: usize>: Debug + Send + Sync + 'static {
    /// Its name, in scenes, in `--explain` and in the momentum of each term.
    fn name(&self) -> String;

    /// The columns that particles carry for it, beside position, velocity, density and acceleration.
    fn columns(&self) -> Vec<Column> {
        Vec::new()
    }

    /// Its parameters with their initial values. Two terms may name the same parameter.
    fn parameters(&self) -> Vec<ParameterSpec> {
        Vec::new()
    }

    /// Inserts its resources into the World, once, before the particles are spawned; `places` are
    /// the places of its parameters in the flat vector of all parameters.
    fn insert(&self, places: &[usize], world: &mut World) {
        let _ = (places, world);
    }

    /// Sets the values of its parameters, in the order of [`Term::parameters`].
    fn set_parameters(&self, values: &[f64], world: &mut World) {
        let _ = (values, world);
    }

    /// Resets what it keeps of a run, because the flow returns to step zero.
    fn reset(&self, world: &mut World) {
        let _ = world;
    }

    /// Its systems on an occasion; called once for each occasion.
    fn stages(&self, occasion: Occasion, needs: &Needs) -> Vec<Stage>;

    /// `Σ m a` of each of its contributions at the last force evaluation; empty for a term that
    /// gives no acceleration.
    fn contributions(&self, world: &World) -> Vec<Contribution<D>> {
        let _ = world;
        Vec::new()
    }
}

/// The column under which a report sums a contribution.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ContributionKind {
    /// Pressure, or the learned function in its place.
    Pressure,
    /// Any other force between pairs.
    Viscosity,
    /// Forces on each particle.
    Forcing,
}

/// The rate at which a part of a term changes the total momentum.
#[derive(Clone, Debug, PartialEq)]
pub struct Contribution<const D: usize> {
    /// Name of the part, for example `physics: pressure`.
    pub name: String,
    /// The column that it is summed under.
    pub kind: ContributionKind,
    /// `Σ m a`: zero to round-off where the part conserves momentum.
    pub rate: Vector<f64, D>,
    /// `Σ m |a|`, against which round-off is measured.
    pub scale: f64,
}

impl<const D: usize> Contribution<D> {
    /// From the accelerations of particles of mass `mass`.
    pub fn of(
        name: impl Into<String>,
        kind: ContributionKind,
        mass: f64,
        accelerations: &[Vector<f64, D>],
    ) -> Self {
        let rate = crate::statistics::momentum(mass, accelerations);
        let scale = mass * accelerations.iter().map(|a| a.norm()).sum::<f64>();
        Self { name: name.into(), kind, rate, scale }
    }
}

/// A stage's tangent or pullback.
enum Derivative {
    /// Not given, and the systems may change anything.
    Unknown,
    /// None needed: the systems change nothing that a derivative passes through.
    None,
    /// These systems.
    Known(Systems),
}

/// The systems of a term in one phase, with their derivatives.
pub struct Stage {
    phase: Phase,
    forward: Option<Systems>,
    tangent: Derivative,
    pullback: Derivative,
}

impl Stage {
    /// Systems without known derivatives.
    pub fn new<M>(phase: Phase, forward: impl IntoScheduleConfigs<ScheduleSystem, M>) -> Self {
        let forward = Some(forward.into_configs());
        Self { phase, forward, tangent: Derivative::Unknown, pullback: Derivative::Unknown }
    }

    /// Systems that change nothing that derivatives pass through.
    pub fn constant<M>(phase: Phase, forward: impl IntoScheduleConfigs<ScheduleSystem, M>) -> Self {
        let forward = Some(forward.into_configs());
        Self { phase, forward, tangent: Derivative::None, pullback: Derivative::None }
    }

    /// A pullback without forward systems: of values that an earlier evaluation computed.
    pub fn backwards<M>(
        phase: Phase,
        pullback: impl IntoScheduleConfigs<ScheduleSystem, M>,
    ) -> Self {
        let pullback = Derivative::Known(pullback.into_configs());
        Self { phase, forward: None, tangent: Derivative::None, pullback }
    }

    /// With a tangent, which runs after the systems themselves.
    #[must_use]
    pub fn tangent<M>(self, tangent: impl IntoScheduleConfigs<ScheduleSystem, M>) -> Self {
        Self { tangent: Derivative::Known(tangent.into_configs()), ..self }
    }

    /// With a pullback, which runs in the reverse order of all systems.
    #[must_use]
    pub fn pullback<M>(self, pullback: impl IntoScheduleConfigs<ScheduleSystem, M>) -> Self {
        Self { pullback: Derivative::Known(pullback.into_configs()), ..self }
    }

    /// The phase that it belongs to.
    pub(super) fn phase(&self) -> Phase {
        self.phase
    }

    /// The derivative that a gradient of this kind needs and the stage lacks.
    pub(super) fn lacks(&self, needs: &Needs) -> Option<&'static str> {
        let unknown = |derivative: &Derivative| matches!(derivative, Derivative::Unknown);
        if needs.sensitivities && unknown(&self.tangent) {
            return Some("tangent");
        }
        (needs.adjoint && unknown(&self.pullback)).then_some("pullback")
    }

    /// The systems forwards, with the tangent after them where sensitivities are carried.
    pub(super) fn into_forward(self, sensitivities: bool) -> Option<Systems> {
        match (self.forward, self.tangent) {
            (Some(forward), Derivative::Known(tangent)) if sensitivities => {
                Some((forward, tangent).chain())
            }
            (forward, _) => forward,
        }
    }

    /// The pullback, where there is one.
    pub(super) fn into_pullback(self) -> Option<Systems> {
        match self.pullback {
            Derivative::Known(pullback) => Some(pullback),
            Derivative::Unknown | Derivative::None => None,
        }
    }
}
