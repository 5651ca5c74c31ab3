//! Terms: what a flow is made of. Every contribution to the motion, and everything that judges it, is one object
//! that says which systems it needs, forwards and for derivatives; all schedules follow from the list of terms.

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

/// One contribution to the motion, or one judgement of it.
///
/// A term without a tangent (or pullback) runs forwards; a forward gradient (or an adjoint) of a flow that holds it
/// is refused, with the name of the term.
///
/// A force on each particle that depends on its own state is written more shortly as a
/// [`ParticleForce`](super::particle_force::ParticleForce), and a force between two particles as a
/// [`CentralForce`](crate::models::CentralForce); both are differentiated by dual numbers.
pub trait Term<const D: usize>: Debug + Send + Sync + 'static {
    /// Its name, in scenes, in `--explain` and in the momentum of each term.
    fn name(&self) -> String;

    /// The columns that particles carry for it, beside position, velocity, density and acceleration.
    fn columns(&self) -> Vec<Column> {
        Vec::new()
    }

    /// Its parameters with the values that they start with. Two terms may name the same parameter.
    fn parameters(&self) -> Vec<ParameterSpec> {
        Vec::new()
    }

    /// Puts its resources into the World, once, before the particles are there; `places` are those of its parameters in the flat vector of all.
    fn insert(&self, places: &[usize], world: &mut World) {
        let _ = (places, world);
    }

    /// Puts other values of its parameters in force; in the order of [`Term::parameters`].
    fn set_parameters(&self, values: &[f64], world: &mut World) {
        let _ = (values, world);
    }

    /// Forgets what it remembers of a run, since the flow goes back to step zero.
    fn reset(&self, world: &mut World) {
        let _ = world;
    }

    /// Its systems on an occasion; asked once for each.
    fn stages(&self, occasion: Occasion, needs: &Needs) -> Vec<Stage>;

    /// `Σ m a` of each of its contributions, as the flow stands after a force evaluation; none of a term that gives
    /// no acceleration.
    fn contributions(&self, world: &World) -> Vec<Contribution<D>> {
        let _ = world;
        Vec::new()
    }
}

/// What a contribution is summed under where a report has three columns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ContributionKind {
    /// Pressure, or what a model has learned in its place.
    Pressure,
    /// Any other force between pairs.
    Viscosity,
    /// Forces on each particle.
    Forcing,
}

/// What a part of a term does to the momentum of all particles.
#[derive(Clone, Debug, PartialEq)]
pub struct Contribution<const D: usize> {
    /// Name of the part, for example `physics: pressure`.
    pub name: String,
    /// What it is summed under.
    pub kind: ContributionKind,
    /// `Σ m a`: zero to round-off where the part conserves momentum.
    pub rate: Vector<f64, D>,
    /// `Σ m |a|`, against which round-off is measured.
    pub scale: f64,
}

impl<const D: usize> Contribution<D> {
    /// Of these accelerations of particles of mass `mass`.
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

/// What is known of a system's derivative.
enum Derivative {
    /// Nothing: the system may change anything.
    Unknown,
    /// The system changes nothing that a derivative passes through.
    None,
    /// These systems.
    Known(Systems),
}

/// Some systems of a term in one phase, with their derivatives.
pub struct Stage {
    phase: Phase,
    forward: Option<Systems>,
    tangent: Derivative,
    pullback: Derivative,
}

impl Stage {
    /// Systems whose derivatives are not known.
    pub fn new<M>(phase: Phase, forward: impl IntoScheduleConfigs<ScheduleSystem, M>) -> Self {
        let forward = Some(forward.into_configs());
        Self { phase, forward, tangent: Derivative::Unknown, pullback: Derivative::Unknown }
    }

    /// Systems that change nothing that derivatives pass through.
    pub fn constant<M>(phase: Phase, forward: impl IntoScheduleConfigs<ScheduleSystem, M>) -> Self {
        let forward = Some(forward.into_configs());
        Self { phase, forward, tangent: Derivative::None, pullback: Derivative::None }
    }

    /// Nothing forwards, and a pullback of what an earlier evaluation left.
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

    /// Whether a gradient of this kind lacks the derivative.
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
