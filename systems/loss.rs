//! Loss accumulation: at each observed step the flow is compared with the truth.

use super::acceleration::Law;
use super::neighbours::Neighbours;
use super::particles::{Cloud, SensitivityCloud};
use super::verlet::Clock;
use crate::losses::{Mesh, Points, SquareSum, field_loss, trajectory_loss};
use crate::models::Model;
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
}

/// The loss of a World so far.
#[derive(Resource, Clone, Debug, Default)]
pub struct LossSum {
    /// Trajectory loss, weighted.
    pub trajectory: SquareSum,
    /// Field loss, weighted.
    pub field: SquareSum,
}

impl LossSum {
    /// Nothing yet, of `blocks` blocks of parameters.
    pub fn new(blocks: usize) -> Self {
        Self { trajectory: SquareSum::new(blocks), field: SquareSum::new(blocks) }
    }
}

/// Run condition: whether the step just completed is observed.
pub fn is_observed<const D: usize>(
    clock: Res<Clock>,
    observations: Option<Res<Observations<D>>>,
) -> bool {
    observations.is_some_and(|o| o.frames[..o.window].iter().any(|frame| frame.step == clock.step))
}

/// System: adds an observed frame's share to the loss.
pub fn accumulate_loss<M: Model<D>, const D: usize>(
    clock: Res<Clock>,
    observations: Res<Observations<D>>,
    (law, neighbours, cloud): (Res<Law<M>>, Res<Neighbours<D>>, Res<Cloud<D>>),
    sensitivities: Option<Res<SensitivityCloud<D>>>,
    mut loss: ResMut<LossSum>,
) {
    let frames = &observations.frames[..observations.window];
    let Some(frame) = frames.iter().find(|frame| frame.step == clock.step) else {
        return;
    };
    let blocks: Vec<_> = match &sensitivities {
        Some(cloud) => cloud.blocks.iter().map(|block| block.packed.as_slice()).collect(),
        None => Vec::new(),
    };
    if observations.trajectory > 0.0 {
        let rows = &neighbours.cells.row_of_slot;
        let truth = |slot: usize| {
            let row = rows[slot] as usize;
            (frame.positions[row], frame.velocities[row])
        };
        let share = (neighbours.space, observations.trajectory);
        loss.trajectory.merge(&trajectory_loss(cloud.particles(), &blocks, truth, share));
    }
    if observations.field > 0.0 {
        let points = Points {
            packed: cloud.particles(),
            cells: &neighbours.cells,
            space: neighbours.space,
            smoothing: law.0.smoothing(),
            mass: law.0.mass(),
        };
        let share = (frame.field.as_slice(), observations.field / frames.len() as f64);
        loss.field.merge(&field_loss(&observations.mesh, &points, &blocks, share));
    }
}
