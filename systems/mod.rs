//! The equations of motion on a World: its components, its systems and their order.
//!
//! [`Phase`] is the order of one step, appendix A.4, written once. Every contribution to the motion is a
//! [`term::Term`], which says for each phase which systems it needs, with their tangents and pullbacks;
//! [`programs::Programs`] makes all schedules from the list of terms: a tangent runs after the system it
//! differentiates, and an adjoint runs the pullbacks of the same systems in reverse. Two systems that touch the same
//! data without an order between them are an error.
//!
//! | module | term | phases |
//! |---|---|---|
//! | [`neighbours`] | cell lists with a skin | `Neighbours` |
//! | [`packing`] | particles to packed arrays and back | `Pack`, `Unpack` |
//! | [`verlet`] | kicks and drift | `FirstKick`, `Drift`, `SecondKick` |
//! | [`density`] | density by summation | `Density` |
//! | [`acceleration`] | pair forces of one law or several | `Force` |
//! | [`forcing`], [`particle_force`] | forces on each particle | `Forcing` |
//! | [`loss`] | comparison with a truth | `Loss` |
//! | [`cotangents`] | derivatives of a caller's loss, backwards | `Loss` |
//! | [`watch`] | limits | `Watch` |
//!
//! A direct numerical simulation is a World of its own, [`dns`].
//!
//! A flow is extended by a term ([`crate::scene::Scene::add_term`]), which can be learned, or, where nothing is
//! differentiated, by a system added to a phase or between two:
//!
//! ```
//! use bevy_ecs::prelude::*;
//! use whirls::systems::{Phase, particles::Velocity};
//! use whirls::{Flow, Scene};
//!
//! fn drag(mut velocities: Query<&mut Velocity<2>>) {
//!     velocities.iter_mut().for_each(|mut velocity| **velocity *= 0.999);
//! }
//!
//! let scene = Scene::shipped("inverse-2d")?;
//! let mut flow = Flow::<2>::new(&scene)?;
//! flow.schedule_mut().add_systems(drag.after(Phase::SecondKick).before(Phase::Loss));
//! flow.step()?;
//! # Ok::<(), whirls::Error>(())
//! ```
//!
//! Equation numbers and appendices are those of Woodward et al., arXiv:2110.13311: see `docs/equations.md`.

pub mod acceleration;
#[doc(hidden)]
pub mod columns;
#[doc(hidden)]
pub mod cotangents;
pub mod density;
#[doc(hidden)]
pub mod density_tangent;
#[doc(hidden)]
pub mod dns;
pub mod forcing;
pub mod loss;
#[doc(hidden)]
pub mod near;
pub mod neighbours;
#[doc(hidden)]
pub mod packing;
pub mod particle_force;
pub mod particles;
#[doc(hidden)]
pub mod programs;
#[doc(hidden)]
pub mod tape;
pub mod term;
pub mod verlet;
pub mod watch;

use bevy_ecs::prelude::*;
use bevy_ecs::schedule::ScheduleLabel;
use verlet::Step;

/// One step, in order.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Phase {
    /// The force evaluated again at `(rᵏ, vᵏ)`: only in the steps `paper` and `two-force`.
    Reevaluate,
    /// `v½ = vᵏ + dt/2 Fᵏ`.
    FirstKick,
    /// `rᵏ⁺¹ = rᵏ + dt v½`.
    Drift,
    /// The neighbour lists at `rᵏ⁺¹`.
    Neighbours,
    /// Packs positions and velocities, as the force evaluation reads them.
    Pack,
    /// `ρᵏ⁺¹`, Eq. (17), and with it the neighbours within the support.
    Density,
    /// The forces of the model, Eqs. (2) to (7).
    Force,
    /// The external forcing, A.3.
    Forcing,
    /// Accelerations are written from the packed arrays back to the particles.
    Unpack,
    /// `vᵏ⁺¹ = v½ + dt/2 F`.
    SecondKick,
    /// The loss of the completed step, where it is observed.
    Loss,
    /// Stops the run where the flow has left its limits.
    Watch,
}

impl Phase {
    /// All phases, in order.
    pub const ALL: [Self; 12] = [
        Self::Reevaluate,
        Self::FirstKick,
        Self::Drift,
        Self::Neighbours,
        Self::Pack,
        Self::Density,
        Self::Force,
        Self::Forcing,
        Self::Unpack,
        Self::SecondKick,
        Self::Loss,
        Self::Watch,
    ];
}

/// The schedules of a World.
#[derive(ScheduleLabel, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ScheduleKind {
    /// From positions and velocities to the forces at step zero.
    Start,
    /// One step.
    Advance,
    /// Neighbours and density of a restored state.
    Prepare,
    /// The adjoint of one step: every pullback, in the reverse of the step's order.
    StepAdjoint,
    /// The adjoint of the start.
    StartAdjoint,
}

/// The occasions on which the systems of a term are requested.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Occasion {
    /// The first force evaluation, at step zero.
    Start,
    /// The force evaluated again at `(rᵏ, vᵏ)`, with the densities of the step before; only in the
    /// steps `paper` and `two-force`.
    Reevaluate,
    /// The step itself, with a force evaluation after the drift.
    Step,
    /// A snapshot was restored: neighbours and densities are recomputed.
    Restore,
}

impl Occasion {
    /// Whether forces are evaluated.
    pub fn has_forces(self) -> bool {
        self != Self::Restore
    }

    /// Whether positions have changed, so that neighbours and densities are recomputed.
    pub fn has_densities(self) -> bool {
        self != Self::Reevaluate
    }

    /// Whether the state is complete, so that losses and limits apply.
    pub fn has_judgement(self) -> bool {
        matches!(self, Self::Start | Self::Step)
    }
}

/// What the schedules of a World must support.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Needs {
    /// The kind of step.
    pub step: Step,
    /// Whether forward sensitivities are carried.
    pub sensitivities: bool,
    /// Whether a tape is recorded for an adjoint.
    pub adjoint: bool,
}

impl Needs {
    /// The occasions of one step, in order.
    pub fn occasions_of_a_step(&self) -> &'static [Occasion] {
        match self.step.refreshes() {
            true => &[Occasion::Reevaluate, Occasion::Step],
            false => &[Occasion::Step],
        }
    }
}
