//! Loss accumulation: at each observed step the flow is compared with the truth.

use super::acceleration::Law;
use super::neighbours::Neighbours;
use super::particles::{Cloud, SensitivityCloud};
use super::tape::Tape;
use super::verlet::Clock;
use crate::kernel::AnyKernel;
use crate::losses::{
    GradientSum, IncrementDensities, Mesh, Points, SquareSum, StateAdjoint, field_adjoint,
    field_loss, field_value, statistical_adjoint, statistical_loss, trajectory_adjoint,
    trajectory_loss,
};
use crate::models::Medium;
use crate::scene::Times;
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use std::sync::Arc;

/// A true state of the flow, and the field it makes.
#[derive(Clone, Debug, Default)]
pub struct Observation<const D: usize> {
    /// Step of the predicted flow that it belongs to.
    pub step: u64,
    /// `r̂` by particle.
    pub positions: Vec<Vector<f64, D>>,
    /// `v̂` by particle.
    pub velocities: Vec<Vector<f64, D>>,
    /// `V̂` by mesh node; empty where no field loss is asked for.
    pub field: Vec<Vector<f64, D>>,
    /// Densities of `v̂ − u(0)`; none where no statistical loss is asked for.
    pub increments: Option<IncrementDensities<D>>,
}

/// What a World is compared with.
#[derive(Resource, Clone, Debug)]
pub struct Observations<const D: usize> {
    /// True states in order of step.
    pub frames: Arc<Vec<Observation<D>>>,
    /// How many of them count.
    pub window: usize,
    /// Weight of the trajectory loss; not computed at zero.
    pub trajectory: f64,
    /// Weight of the field loss; not computed at zero.
    pub field: f64,
    /// Mesh of the field loss.
    pub mesh: Mesh<D>,
    /// Weight of each frame that counts in the statistical loss.
    pub kl: f64,
    /// Which frames those are.
    pub times: Times,
    /// `u(0)` by particle: the velocities that the prediction starts with.
    pub start: Arc<Vec<Vector<f64, D>>>,
}

/// An observed frame, and how much it counts in each loss.
struct Share<'a, const D: usize> {
    frame: &'a Observation<D>,
    trajectory: f64,
    field: f64,
    kl: Option<(&'a IncrementDensities<D>, f64)>,
    start: &'a [Vector<f64, D>],
}

impl<const D: usize> Observations<D> {
    /// What is observed at a step, within the window.
    fn share(&self, step: u64) -> Option<Share<'_, D>> {
        let frames = &self.frames[..self.window];
        let index = frames.iter().position(|frame| frame.step == step)?;
        let counts = self.times == Times::All || index + 1 == frames.len();
        let frame = &frames[index];
        Some(Share {
            frame,
            trajectory: self.trajectory,
            field: self.field / frames.len() as f64,
            kl: frame.increments.as_ref().filter(|_| counts).map(|truth| (truth, self.kl)),
            start: &self.start,
        })
    }
}

impl<const D: usize> Share<'_, D> {
    /// `(r̂, v̂)` of the particle in a slot.
    fn truth(&self, rows: &[u32]) -> impl Fn(usize) -> (Vector<f64, D>, Vector<f64, D>) {
        |slot| {
            let row = rows[slot] as usize;
            (self.frame.positions[row], self.frame.velocities[row])
        }
    }
}

/// The loss of a World so far.
#[derive(Resource, Clone, Debug, Default)]
pub struct LossSum {
    /// Trajectory loss, weighted.
    pub trajectory: SquareSum,
    /// Field loss, weighted.
    pub field: SquareSum,
    /// Statistical loss, weighted.
    pub kl: GradientSum,
}

impl LossSum {
    /// Nothing yet, of `blocks` blocks of parameters.
    pub fn new(blocks: usize) -> Self {
        let squares = SquareSum::new(blocks);
        Self { trajectory: squares.clone(), field: squares, kl: GradientSum::new(blocks) }
    }

    /// All parts together.
    pub fn value(&self) -> f64 {
        self.trajectory.value + self.field.value + self.kl.value
    }

    /// `∂value/∂θ` of the first `count` parameters.
    pub fn gradient(&self, count: usize) -> Vec<f64> {
        let squares = self.trajectory.gradient(count).into_iter().zip(self.field.gradient(count));
        squares.zip(self.kl.gradient(count)).map(|((a, b), c)| a + b + c).collect()
    }
}

/// Run condition: whether the step just completed is observed.
pub fn is_observed<const D: usize>(
    clock: Res<Clock>,
    observations: Option<Res<Observations<D>>>,
) -> bool {
    observations.is_some_and(|observations| observations.share(clock.step).is_some())
}

/// System: adds an observed frame's share to the loss.
pub fn accumulate_loss<const D: usize>(
    clock: Res<Clock>,
    observations: Res<Observations<D>>,
    (law, neighbours, cloud): (Res<Law<D>>, Res<Neighbours<D>>, Res<Cloud<D>>),
    sensitivities: Option<Res<SensitivityCloud<D>>>,
    mut loss: ResMut<LossSum>,
) {
    let Some(share) = observations.share(clock.step) else { return };
    let blocks: Vec<_> = match &sensitivities {
        Some(cloud) => cloud.blocks.iter().map(|block| block.packed.as_slice()).collect(),
        None => Vec::new(),
    };
    if share.trajectory > 0.0 {
        let truth = share.truth(&neighbours.cells.row_of_slot);
        let weight = (neighbours.space, share.trajectory);
        loss.trajectory.merge(&trajectory_loss(cloud.particles(), &blocks, truth, weight));
    }
    if share.field > 0.0 {
        let points = points(law.0.medium(), &neighbours, &cloud);
        let truth = (share.frame.field.as_slice(), share.field);
        loss.field.merge(&field_loss(&observations.mesh, &points, &blocks, truth));
    }
    if let Some(truth) = share.kl {
        let particles = (cloud.particles(), &cloud.slot_of_row[..]);
        loss.kl.merge(&statistical_loss(particles, &blocks, share.start, truth));
    }
}

/// System: as [`accumulate_loss`] without sensitivities; keeps on the tape how the loss depends on
/// the state of every particle.
pub fn accumulate_loss_adjoint<const D: usize>(
    clock: Res<Clock>,
    observations: Res<Observations<D>>,
    (law, neighbours, cloud): (Res<Law<D>>, Res<Neighbours<D>>, Res<Cloud<D>>),
    mut tape: ResMut<Tape<D>>,
    mut loss: ResMut<LossSum>,
) {
    let Some(share) = observations.share(clock.step) else { return };
    let mut adjoint = None;
    if share.trajectory > 0.0 {
        let truth = share.truth(&neighbours.cells.row_of_slot);
        let part =
            trajectory_adjoint(cloud.particles(), truth, (neighbours.space, share.trajectory));
        loss.trajectory.value += part.value;
        add(&mut adjoint, part);
    }
    if share.field > 0.0 {
        let points = points(law.0.medium(), &neighbours, &cloud);
        let (mesh, truth) = (&observations.mesh, (share.frame.field.as_slice(), share.field));
        if tape.running {
            let part = field_adjoint(mesh, &points, truth);
            loss.field.value += part.value;
            add(&mut adjoint, part);
        } else {
            loss.field.value += field_value(mesh, &points, truth);
        }
    }
    if let Some(truth) = share.kl {
        let particles = (cloud.particles(), &cloud.slot_of_row[..]);
        let part = statistical_adjoint(particles, share.start, truth);
        loss.kl.value += part.value;
        add(&mut adjoint, part);
    }
    if let Some(adjoint) = adjoint.filter(|_| tape.running) {
        tape.push_frame(clock.step, &adjoint, &cloud.slot_of_row);
    }
}

/// Adds a part to a loss that may have none yet.
fn add<const D: usize>(sum: &mut Option<StateAdjoint<D>>, part: StateAdjoint<D>) {
    match sum {
        Some(sum) => sum.merge(&part),
        None => *sum = Some(part),
    }
}

fn points<'a, const D: usize>(
    medium: &'a Medium<D>,
    neighbours: &'a Neighbours<D>,
    cloud: &'a Cloud<D>,
) -> Points<'a, AnyKernel, D> {
    Points {
        packed: cloud.particles(),
        cells: &neighbours.cells,
        space: neighbours.space,
        smoothing: &medium.smoothing,
        mass: medium.mass,
    }
}
