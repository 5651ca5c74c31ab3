//! The step in time, appendix A.4: kicks and drifts, with their tangents.
//!
//! Appendices are those of Woodward et al., arXiv:2110.13311 ("the paper"): see `docs/equations.md`.

use super::particles::{
    Acceleration, AccelerationAdjoint, AccelerationSensitivity, ParticleId, Position,
    PositionAdjoint, PositionSensitivity, Velocity, VelocityAdjoint, VelocitySensitivity,
};
use super::term::{Stage, Term};
use super::{Needs, Occasion, Phase};
use crate::neighbours::cells::MIN_PARALLEL_LEN;
use crate::scalar::{F64x8, SimdFloat, SimdTask, dispatch};
use crate::space::Space;
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Which velocity the forces see, and how often they are evaluated.
///
/// | step | order | forces per step | |
/// |---|---|---|---|
/// | `kick-drift-kick` | 2 | 1 | default |
/// | `paper` | 1 with viscosity or forcing | 2 | reproduces the published data |
/// | `one-force` | 1 | 1 | only to be priced |
/// | `two-force` | 2 | 2 | only as a check |
///
/// The orders are asserted in `tests/convergence.rs`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Step {
    /// `v½ = v + dt/2 F`; `r' = r + dt v½`; `F' = F(r', v½ + dt/2 F)`; `v' = v½ + dt/2 F'`, and `F'`
    /// is the next step's `F`: it belongs to the state.
    #[default]
    KickDriftKick,
    /// `F = F(r, v)`; `v½ = v + dt/2 F`; `r' = r + dt v½`; `v' = v½ + dt/2 F(r', v½)`.
    Paper,
    /// The paper's step with `F(r', v½)` carried as the next step's `F`.
    OneForce,
    /// Kick-drift-kick with `F` evaluated again at `(r', v')`.
    TwoForce,
}

impl Step {
    /// All steps.
    pub const ALL: [Self; 4] = [Self::KickDriftKick, Self::Paper, Self::OneForce, Self::TwoForce];

    /// Its name in scenes.
    pub fn name(self) -> &'static str {
        match self {
            Self::KickDriftKick => "kick-drift-kick",
            Self::Paper => "paper",
            Self::OneForce => "one-force",
            Self::TwoForce => "two-force",
        }
    }

    /// Whether each step begins with a force evaluation of its own.
    pub fn refreshes(self) -> bool {
        matches!(self, Self::Paper | Self::TwoForce)
    }

    /// Whether the force after the drift sees the velocity predicted to the end of the step.
    pub fn predicts(self) -> bool {
        matches!(self, Self::KickDriftKick | Self::TwoForce)
    }
}

/// How a World advances.
#[derive(Resource, Clone, Copy, Debug)]
pub struct Integrator {
    /// Kind of step.
    pub step: Step,
    /// Time step.
    pub dt: f64,
    /// The box that positions are wrapped into.
    pub space: Space,
}

/// Where a World is in time.
#[derive(Resource, Clone, Copy, Debug, Default)]
pub struct Clock {
    /// Steps completed.
    pub step: u64,
    /// Step of the positions that forces use: `step` before the drift, `step + 1` after it.
    pub evaluated: u64,
    /// Time at step zero.
    pub start: f64,
}

impl Clock {
    /// Time at a step, without the accumulated error of repeated addition.
    pub fn time_at(&self, step: u64, dt: f64) -> f64 {
        self.start + step as f64 * dt
    }
}

/// Term: the kicks and the drift of a step.
#[derive(Clone, Copy, Debug)]
#[doc(hidden)]
pub struct KickAndDrift;

impl<const D: usize> Term<D> for KickAndDrift {
    fn name(&self) -> String {
        "kick and drift".to_owned()
    }

    fn stages(&self, occasion: Occasion, _: &Needs) -> Vec<Stage> {
        if occasion != Occasion::Step {
            return Vec::new();
        }
        vec![
            Stage::new(Phase::FirstKick, kick::<D>)
                .tangent(kick_tangent::<D>)
                .pullback(kick_pullback::<D>),
            Stage::new(Phase::Drift, drift::<D>)
                .tangent(drift_tangent::<D>)
                .pullback(drift_pullback::<D>),
            Stage::new(Phase::SecondKick, (kick::<D>, tick).chain())
                .tangent(kick_tangent::<D>)
                .pullback((tick_pullback, kick_pullback::<D>).chain()),
        ]
    }
}

/// System: half a kick, `v += dt/2 F`.
#[doc(hidden)]
pub fn kick<const D: usize>(
    mut particles: Query<(&mut Velocity<D>, &Acceleration<D>), With<ParticleId>>,
    integrator: Res<Integrator>,
) {
    let half = 0.5 * integrator.dt;
    for (mut velocities, accelerations) in particles.contiguous_iter_mut().into_iter().flatten() {
        let rows = velocities.par_iter_mut().zip(accelerations).with_min_len(MIN_PARALLEL_LEN);
        rows.for_each(|(v, a)| v.0 += a.0 * half);
    }
}

/// System: the drift, `r += dt v`, wrapped into the box.
#[doc(hidden)]
pub fn drift<const D: usize>(
    mut particles: Query<(&mut Position<D>, &Velocity<D>), With<ParticleId>>,
    integrator: Res<Integrator>,
    mut clock: ResMut<Clock>,
) {
    for (mut positions, velocities) in particles.contiguous_iter_mut().into_iter().flatten() {
        let rows = positions.par_iter_mut().zip(velocities).with_min_len(MIN_PARALLEL_LEN);
        rows.for_each(|(r, v)| r.0 = integrator.space.wrap(r.0 + v.0 * integrator.dt));
    }
    clock.evaluated = clock.step + 1;
}

/// System: the step is complete.
#[doc(hidden)]
pub fn tick(mut clock: ResMut<Clock>) {
    clock.step += 1;
    clock.evaluated = clock.step;
}

/// System: the tangent of [`kick`].
#[doc(hidden)]
pub fn kick_tangent<const D: usize>(
    mut blocks: Query<(&mut VelocitySensitivity<D>, &AccelerationSensitivity<D>)>,
    integrator: Res<Integrator>,
) {
    let factor = 0.5 * integrator.dt;
    for (mut velocities, accelerations) in blocks.contiguous_iter_mut().into_iter().flatten() {
        let rows = velocities.par_iter_mut().zip(accelerations).with_min_len(MIN_PARALLEL_LEN);
        rows.for_each(|(v, a)| dispatch(Add { to: &mut v.0, rate: &a.0, factor }));
    }
}

/// System: the tangent of [`drift`].
#[doc(hidden)]
pub fn drift_tangent<const D: usize>(
    mut blocks: Query<(&mut PositionSensitivity<D>, &VelocitySensitivity<D>)>,
    integrator: Res<Integrator>,
) {
    let factor = integrator.dt;
    for (mut positions, velocities) in blocks.contiguous_iter_mut().into_iter().flatten() {
        let rows = positions.par_iter_mut().zip(velocities).with_min_len(MIN_PARALLEL_LEN);
        rows.for_each(|(r, v)| dispatch(Add { to: &mut r.0, rate: &v.0, factor }));
    }
}

/// Adds a rate times a factor.
struct Add<'a, const D: usize> {
    to: &'a mut Vector<F64x8, D>,
    rate: &'a Vector<F64x8, D>,
    factor: f64,
}

impl<const D: usize> SimdTask for Add<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        for axis in 0..D {
            let rate = W::Double::load(&self.rate[axis]) * self.factor;
            self.to[axis] = (W::Double::load(&self.to[axis]) + rate).store();
        }
    }
}

/// System: the pullback of [`kick`]: `∂L/∂F += dt/2 ∂L/∂v`.
#[doc(hidden)]
pub fn kick_pullback<const D: usize>(
    mut particles: Query<(&mut AccelerationAdjoint<D>, &VelocityAdjoint<D>), With<ParticleId>>,
    integrator: Res<Integrator>,
) {
    let half = 0.5 * integrator.dt;
    for (accelerations, velocities) in particles.contiguous_iter_mut().into_iter().flatten() {
        for (a, v) in accelerations.into_iter().zip(velocities) {
            a.0 += v.0 * half;
        }
    }
}

/// System: the pullback of [`drift`]: `∂L/∂v += dt ∂L/∂r`.
#[doc(hidden)]
pub fn drift_pullback<const D: usize>(
    mut particles: Query<(&mut VelocityAdjoint<D>, &PositionAdjoint<D>), With<ParticleId>>,
    integrator: Res<Integrator>,
) {
    for (velocities, positions) in particles.contiguous_iter_mut().into_iter().flatten() {
        for (v, r) in velocities.into_iter().zip(positions) {
            v.0 += r.0 * integrator.dt;
        }
    }
}

/// System: the pullback of [`tick`].
#[doc(hidden)]
pub fn tick_pullback(mut clock: ResMut<Clock>) {
    clock.step = clock.step.saturating_sub(1);
}
