//! Backward runs of a flow: snapshots forwards, pullbacks backwards.

use super::{Flow, State, in_pool};
use crate::error::Result;
use crate::scene::Scene;
use crate::systems::columns::{Column, KeptColumn};
use crate::systems::loss::LossSum;
use crate::systems::neighbours::Neighbours;
use crate::systems::particles::{
    Acceleration, AccelerationAdjoint, AdjointCloud, ParticleId, Particles, Position,
    PositionAdjoint, Velocity, VelocityAdjoint,
};
use crate::systems::tape::{FrameAdjoint, Tape};
use crate::systems::verlet::Clock;
use crate::vector::Vector;

/// A complete snapshot, from which a flow continues with the same bits: the state, the carried
/// force, and the positions from which the neighbour lists were built.
pub struct Snapshot<const D: usize> {
    clock: Clock,
    state: State<D>,
    accelerations: Vec<Vector<f64, D>>,
    reference: Vec<Vector<f64, D>>,
    /// Columns of terms, in order.
    columns: Vec<KeptColumn>,
}

impl<const D: usize> Snapshot<D> {
    /// Steps completed.
    pub fn step(&self) -> u64 {
        self.clock.step
    }

    /// Bytes held per particle.
    pub const BYTES: usize = 4 * 8 * D;
}

impl<const D: usize> Flow<D> {
    /// The flow of a rollout, with an adjoint of a loss that is known only by its cotangents,
    /// [`Self::give_cotangent`].
    pub(crate) fn with_cotangents(scene: &Scene, state: &State<D>) -> Result<Self> {
        Self::of_rollout(scene, state, (true, 0))
    }

    /// Gives the derivatives of a loss of the frame at the current step of the backward sweep, before its adjoint runs.
    pub(crate) fn give_cotangent(&mut self, frame: &FrameAdjoint<D>) {
        if let Some(mut tape) = self.world.get_resource_mut::<Tape<D>>() {
            tape.push_cotangent(frame);
        }
    }

    /// A snapshot of a started flow.
    pub fn snapshot(&mut self) -> Snapshot<D> {
        let columns: Vec<Column> = self.terms.iter().flat_map(|term| term.columns()).collect();
        let columns = columns.iter().map(|column| column.keep(&mut self.world)).collect();
        Snapshot {
            columns,
            clock: *self.world.resource::<Clock>(),
            state: self.state(),
            accelerations: self.accelerations(),
            reference: self.world.resource::<Neighbours<D>>().reference().to_vec(),
        }
    }

    /// Restores a snapshot. Does nothing for a flow that was not built with an adjoint.
    pub fn restore(&mut self, snapshot: &Snapshot<D>) {
        let Some(backward) = &mut self.backward else { return };
        let world = &mut self.world;
        let mut rows = world
            .query::<(&ParticleId, &mut Position<D>, &mut Velocity<D>, &mut Acceleration<D>)>();
        for (id, mut r, mut v, mut a) in rows.iter_mut(world) {
            let row = id.0 as usize;
            if row < snapshot.accelerations.len() {
                r.0 = snapshot.state.positions[row];
                v.0 = snapshot.state.velocities[row];
                a.0 = snapshot.accelerations[row];
            }
        }
        let columns = self.terms.iter().flat_map(|term| term.columns());
        for (column, kept) in columns.zip(&snapshot.columns) {
            column.restore(world, kept);
        }
        world.insert_resource(snapshot.clock);
        world.resource_mut::<Neighbours<D>>().restore(&snapshot.reference);
        in_pool(|| backward.prepare.run(world));
    }

    /// Switches recording of force evaluations on the tape on or off.
    pub fn keep_evaluations(&mut self, running: bool) {
        if let Some(mut tape) = self.world.get_resource_mut::<Tape<D>>() {
            tape.running = running;
        }
    }

    /// Current size of the tape in bytes.
    pub fn tape_bytes(&self) -> usize {
        self.world.get_resource::<Tape<D>>().map_or(0, Tape::bytes)
    }

    /// Clears the tape and all adjoint variables, before a forward sweep.
    pub fn clear_adjoint(&mut self) {
        let world = &mut self.world;
        let mut rows = world.query::<(
            &mut PositionAdjoint<D>,
            &mut VelocityAdjoint<D>,
            &mut AccelerationAdjoint<D>,
        )>();
        for (mut r, mut v, mut a) in rows.iter_mut(world) {
            (r.0, v.0, a.0) = (Vector::zero(), Vector::zero(), Vector::zero());
        }
        if let Some(mut tape) = world.get_resource_mut::<Tape<D>>() {
            tape.clear();
        }
        if let Some(mut adjoint) = world.get_resource_mut::<AdjointCloud<D>>() {
            adjoint.parameters.fill(0.0);
            adjoint.carried.clear();
        }
    }

    /// The adjoint of the last step on the tape.
    pub fn retreat(&mut self) {
        if let Some(backward) = &mut self.backward {
            let world = &mut self.world;
            in_pool(|| backward.retreat.run(world));
        }
    }

    /// The adjoint of the start: the first force on the tape.
    pub fn back_to_start(&mut self) {
        if let Some(backward) = &mut self.backward {
            let world = &mut self.world;
            in_pool(|| backward.back_to_start.run(world));
        }
    }

    /// `∂L/∂` of every parameter, as accumulated backwards, in the order of [`Flow::parameters`].
    pub fn adjoint_gradient(&self) -> Vec<f64> {
        let adjoint = self.world.get_resource::<AdjointCloud<D>>();
        adjoint.map(|adjoint| adjoint.parameters.clone()).unwrap_or_default()
    }

    /// `(∂L/∂r, ∂L/∂v)` at the current step of the backward sweep, particle `k` in row `k`.
    pub fn state_adjoint(&mut self) -> (Vec<Vector<f64, D>>, Vec<Vector<f64, D>>) {
        let mut rows =
            self.world.query::<(&ParticleId, &PositionAdjoint<D>, &VelocityAdjoint<D>)>();
        let count = self.world.resource::<Particles>().0;
        let mut both = (vec![Vector::zero(); count], vec![Vector::zero(); count]);
        for (id, r, v) in rows.iter(&self.world) {
            let row = id.0 as usize;
            if row < count {
                (both.0[row], both.1[row]) = (r.0, v.0);
            }
        }
        both
    }

    /// Replaces the accumulated loss, because repeated steps must not count twice.
    pub(crate) fn set_loss(&mut self, loss: LossSum) {
        self.world.insert_resource(loss);
    }

    /// Runs `steps` steps forward.
    pub(crate) fn advance_by(&mut self, steps: u64) -> Result<()> {
        (0..steps).try_for_each(|_| self.step())
    }
}
