//! The solver: the World of a velocity field and its tracers.

use super::field::{Settings, SpectralField};
use super::spline::Splines;
use super::start::Start;
use crate::error::Result;
use crate::space::Space;
use crate::systems::dns::{Field, Interpolant, TracerStage, observing, stepping};
use crate::systems::particles::{Acceleration, ParticleId, Particles, Position, Velocity};
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use std::ops::{Deref, DerefMut};

/// An incompressible flow in a periodic box, and the tracers in it: a World in which the velocity field is a resource
/// and each tracer an entity.
///
/// It dereferences to its [`SpectralField`].
pub struct Solver<const D: usize> {
    world: World,
    /// One stage of a step.
    stage: Schedule,
    /// Velocities and accelerations of the tracers.
    observe: Schedule,
}

impl<const D: usize> std::fmt::Debug for Solver<D> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let field: &SpectralField<D> = self;
        f.debug_struct("Solver").field("time", &field.time()).finish_non_exhaustive()
    }
}

impl<const D: usize> Deref for Solver<D> {
    type Target = SpectralField<D>;

    fn deref(&self) -> &Self::Target {
        &self.world.resource::<Field<D>>().0
    }
}

impl<const D: usize> DerefMut for Solver<D> {
    fn deref_mut(&mut self) -> &mut Self::Target {
        &mut self.world.resource_mut::<Field<D>>().into_inner().0
    }
}

impl<const D: usize> Solver<D> {
    /// A flow at time 0, without tracers.
    ///
    /// # Errors
    /// As [`SpectralField::new`].
    pub fn new(settings: Settings, start: &Start<D>) -> Result<Self> {
        let mut world = World::new();
        world.insert_resource(Field(SpectralField::<D>::new(settings, start)?));
        world.insert_resource(Particles(0));
        Ok(Self { world, stage: stepping::<D>(), observe: observing::<D>() })
    }

    /// Puts tracers at some positions; those there before are taken away.
    pub fn seed(&mut self, positions: &[Vector<f64, D>]) {
        let mut before = self.world.query_filtered::<Entity, With<ParticleId>>();
        let before: Vec<Entity> = before.iter(&self.world).collect();
        for entity in before {
            self.world.despawn(entity);
        }
        let space = Space::cube(self.settings().length);
        let tracers = (0..).zip(positions).map(|(id, &x)| {
            let at = space.wrap(x);
            let still = Vector::zero();
            (
                (ParticleId(id), Position(at), Velocity(still), Acceleration(still)),
                TracerStage { position: at, velocity: still, moved: still },
            )
        });
        let tracers: Vec<_> = tracers.collect();
        drop(self.world.spawn_batch(tracers));
        self.world.insert_resource(Particles(positions.len()));
        if !self.world.contains_resource::<Interpolant<D>>() {
            let splines = Splines::new(self.modes().layout(), self.settings().spline_degree);
            self.world.insert_resource(Interpolant(splines));
        }
    }

    /// The World, to add entities and resources to.
    pub fn world_mut(&mut self) -> &mut World {
        &mut self.world
    }

    /// The systems of one stage, to add others to; their order is [`crate::systems::dns::StagePhase`].
    pub fn schedule_mut(&mut self) -> &mut Schedule {
        &mut self.stage
    }

    /// One step; returns its length.
    ///
    /// # Errors
    /// [`crate::Error::Diverged`] where the velocity is not finite.
    pub fn step(&mut self) -> Result<f64> {
        self.step_within(f64::INFINITY)
    }

    /// Steps of about equal length up to a time.
    ///
    /// # Errors
    /// As [`Self::step`], and [`crate::Error::Interrupted`].
    pub fn advance_to(&mut self, time: f64) -> Result<()> {
        self.advance_with(time, &mut |_| {})
    }

    /// The same; calls `after` after each step with the time.
    ///
    /// # Errors
    /// As [`Self::advance_to`].
    pub fn advance_with(&mut self, time: f64, after: &mut dyn FnMut(f64)) -> Result<()> {
        while self.time() < time {
            crate::interrupt::check()?;
            let left = time - self.time();
            let dt = self.step_within(left)?;
            if dt >= left {
                self.set_time(time);
            }
            after(self.time());
        }
        Ok(())
    }

    /// One step of at most `left`.
    fn step_within(&mut self, left: f64) -> Result<f64> {
        let dt = self.begin(left)?;
        for _ in 0..self.settings().scheme.evaluations() {
            self.stage.run(&mut self.world);
        }
        Ok(dt)
    }

    /// Positions of the tracers, in the box.
    pub fn tracers(&mut self) -> Vec<Vector<f64, D>> {
        self.column(|position: &Position<D>| position.0)
    }

    /// Velocities of the tracers.
    pub fn tracer_velocities(&mut self) -> Vec<Vector<f64, D>> {
        self.observe.run(&mut self.world);
        self.column(|velocity: &Velocity<D>| velocity.0)
    }

    /// Accelerations of the tracers, `Du/Dt = −∇p + ν∇²u + f` with `ρ₀ = 1`.
    pub fn tracer_accelerations(&mut self) -> Vec<Vector<f64, D>> {
        self.observe.run(&mut self.world);
        self.column(|acceleration: &Acceleration<D>| acceleration.0)
    }

    /// Positions, velocities and accelerations of the tracers, in this order.
    pub fn observe(&mut self) -> [Vec<Vector<f64, D>>; 3] {
        self.observe.run(&mut self.world);
        [
            self.column(|position: &Position<D>| position.0),
            self.column(|velocity: &Velocity<D>| velocity.0),
            self.column(|acceleration: &Acceleration<D>| acceleration.0),
        ]
    }

    /// A component of all tracers, tracer `k` in row `k`.
    fn column<C: Component>(&mut self, of: impl Fn(&C) -> Vector<f64, D>) -> Vec<Vector<f64, D>> {
        let mut all = vec![Vector::zero(); self.world.resource::<Particles>().0];
        let mut rows = self.world.query::<(&ParticleId, &C)>();
        for (id, value) in rows.iter(&self.world) {
            if let Some(row) = all.get_mut(id.0 as usize) {
                *row = of(value);
            }
        }
        all
    }

    /// The rms difference between the splines and the sum over all waves at the first `count` tracers, in units of the
    /// rms velocity there.
    pub fn spline_error(&mut self, count: usize) -> f64 {
        let (mut apart, mut all) = (0.0, 0.0);
        let found = self.tracer_velocities();
        for (found, x) in found.into_iter().zip(self.tracers()).take(count) {
            let exact = self.modes().velocity_at(x);
            apart += (found - exact).norm_squared();
            all += exact.norm_squared();
        }
        if all > 0.0 { (apart / all).sqrt() } else { 0.0 }
    }
}
