//! Derivatives of a flow along directions of its parameters and of its initial state.

use super::{Flow, Request, Source, State};
use crate::error::{Error, Result};
use crate::parameters::Parameter;
use crate::scalar::WIDTH;
use crate::scene::Scene;
use crate::systems::acceleration::Laws;
use crate::systems::neighbours::Neighbours;
use crate::systems::particles::{
    BlockOf, Particles, PositionSensitivity, SensitivityCloud, VelocitySensitivity,
};
use crate::vector::Vector;
use bevy_ecs::prelude::*;

/// A direction in the parameters and the initial state of a flow. What is not named does not change.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Direction<const D: usize> {
    /// Changes of parameters.
    pub parameters: Vec<(Parameter, f64)>,
    /// Changes of the initial positions, particle `k` in row `k`; empty where they do not change.
    pub positions: Vec<Vector<f64, D>>,
    /// Changes of the initial velocities; empty where they do not change.
    pub velocities: Vec<Vector<f64, D>>,
}

/// The derivatives of a frame along a direction.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FrameTangent<const D: usize> {
    /// The step of the frame.
    pub step: u64,
    /// `δr`, particle `k` in row `k`.
    pub positions: Vec<Vector<f64, D>>,
    /// `δv`.
    pub velocities: Vec<Vector<f64, D>>,
    /// `δρ`.
    pub densities: Vec<f64>,
}

impl<const D: usize> FrameTangent<D> {
    /// Whether every component is a finite number.
    pub fn is_finite(&self) -> bool {
        let vectors = self.positions.iter().chain(&self.velocities);
        vectors.into_iter().all(|x| x.is_finite()) && self.densities.iter().all(|x| x.is_finite())
    }
}

impl<const D: usize> Flow<D> {
    /// The flow of the model that a scene learns or, where it learns none, of its own law; with an adjoint of cotangents,
    /// or with room for sensitivities along directions.
    pub(super) fn of_rollout(
        scene: &Scene,
        state: &State<D>,
        (adjoint, directions): (bool, usize),
    ) -> Result<Self> {
        Self::must_fit(scene)?;
        let own = scene.law.as_ref().filter(|_| scene.learn.is_none());
        let choice = own.map_or_else(|| scene.model(), |law| law.model.clone());
        let request = Request::new(scene, state, Source::Scene(choice));
        let mut flow = Self::assemble(Request { adjoint, directions, ..request })?;
        own.iter().try_for_each(|law| law.set(&mut flow))?;
        Ok(flow)
    }

    /// The flow of a rollout, with room for sensitivities along `count` directions.
    pub(crate) fn with_directions(scene: &Scene, state: &State<D>, count: usize) -> Result<Self> {
        Self::of_rollout(scene, state, (false, count))
    }

    /// Sets the directions of the sensitivities of a flow that has not started, one lane each.
    ///
    /// # Errors
    /// [`Error::Input`] for a parameter that no term has, and for columns of another length than the number of
    /// particles.
    pub(crate) fn set_directions(&mut self, directions: &[Direction<D>]) -> Result<()> {
        let count = self.world.resource::<Particles>().0;
        for direction in directions {
            let lengths = [direction.positions.len(), direction.velocities.len()];
            if let Some(found) = lengths.into_iter().find(|&found| found > 0 && found != count) {
                let expected = format!("{count} vectors, one for each particle");
                let remedy = "give a row for every particle, or none at all";
                return Err(Error::input(
                    "a direction of the initial state",
                    expected,
                    found,
                    remedy,
                ));
            }
        }
        let mut lanes = Vec::new();
        for own in directions.chunks(WIDTH) {
            let mut block = Vec::new();
            for (lane, direction) in own.iter().enumerate() {
                for (name, by) in &direction.parameters {
                    let place = self.parameters.place(name);
                    let place = place.ok_or_else(|| self.parameters.unknown(name))?;
                    block.push((lane, place, *by));
                }
            }
            lanes.push(block);
        }
        self.world.resource_scope(|world, mut cloud: Mut<'_, SensitivityCloud<D>>| {
            let laws = world.resource::<Laws<D>>();
            for (block, columns) in cloud.blocks.iter_mut().zip(lanes) {
                block.columns = columns;
                block.seed(laws);
            }
        });
        self.set_initial_sensitivities(directions);
        Ok(())
    }

    fn set_initial_sensitivities(&mut self, directions: &[Direction<D>]) {
        let mut rows =
            self.world
                .query::<(&BlockOf, &mut PositionSensitivity<D>, &mut VelocitySensitivity<D>)>();
        for (of, mut r, mut v) in rows.iter_mut(&mut self.world) {
            let first = of.block as usize * WIDTH;
            let own = directions.iter().skip(first).take(WIDTH);
            for (lane, direction) in own.enumerate() {
                let row = of.particle as usize;
                for (into, column) in
                    [(&mut r.0, &direction.positions), (&mut v.0, &direction.velocities)]
                {
                    let Some(change) = column.get(row) else { continue };
                    (0..D).for_each(|axis| into[axis].set_lane(lane, change[axis]));
                }
            }
        }
    }

    /// The derivatives of the current state along each of `count` directions.
    pub(crate) fn frame_tangents(&mut self, count: usize) -> Vec<FrameTangent<D>> {
        let particles = self.world.resource::<Particles>().0;
        let zeros = vec![Vector::zero(); particles];
        let zero = FrameTangent {
            step: self.steps(),
            positions: zeros.clone(),
            velocities: zeros,
            densities: vec![0.0; particles],
        };
        let mut tangents = vec![zero; count];
        let mut rows =
            self.world.query::<(&BlockOf, &PositionSensitivity<D>, &VelocitySensitivity<D>)>();
        for (of, r, v) in rows.iter(&self.world) {
            let (row, first) = (of.particle as usize, of.block as usize * WIDTH);
            for (lane, tangent) in tangents.iter_mut().skip(first).take(WIDTH).enumerate() {
                for axis in 0..D {
                    tangent.positions[row][axis] = r.0[axis].lane(lane);
                    tangent.velocities[row][axis] = v.0[axis].lane(lane);
                }
            }
        }
        let slots = self.world.resource::<Neighbours<D>>().order().slots();
        let blocks = &self.world.resource::<SensitivityCloud<D>>().blocks;
        for (number, tangent) in tangents.iter_mut().enumerate() {
            let (block, lane) = (&blocks[number / WIDTH], number % WIDTH);
            for (density, &slot) in tangent.densities.iter_mut().zip(slots) {
                *density = block.density[slot as usize].lane(lane);
            }
        }
        tangents
    }
}
