//! Columns that a term adds to all particles: spawned, reset, kept in snapshots and counted in the
//! same way.

use super::particles::ParticleId;
use bevy_ecs::component::Mutable;
use bevy_ecs::prelude::*;
use std::any::Any;
use std::fmt::{self, Debug};

/// A snapshot of a column: one value for each particle, particle `k` in row `k`.
pub type KeptColumn = Box<dyn Any + Send + Sync>;

/// A component that every particle carries.
#[derive(Clone, Copy)]
pub struct Column {
    name: &'static str,
    bytes: usize,
    spawn: fn(&mut World),
    forget: fn(&mut World),
    keep: fn(&mut World) -> KeptColumn,
    restore: fn(&mut World, &KeptColumn),
}

impl Debug for Column {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Column").field("name", &self.name).field("bytes", &self.bytes).finish()
    }
}

impl Column {
    /// The column of a component, which starts with its default value.
    pub fn of<T: Component<Mutability = Mutable> + Clone + Default + Sync>() -> Self {
        Self {
            name: std::any::type_name::<T>(),
            bytes: size_of::<T>(),
            spawn: |world| {
                let mut particles = world.query_filtered::<Entity, With<ParticleId>>();
                let all: Vec<Entity> = particles.iter(world).collect();
                world.insert_batch(all.into_iter().map(|entity| (entity, T::default())));
            },
            forget: |world| {
                let mut rows = world.query_filtered::<&mut T, With<ParticleId>>();
                rows.iter_mut(world).for_each(|mut value| *value = T::default());
            },
            keep: |world| {
                let mut rows = world.query::<(&ParticleId, &T)>();
                let mut all: Vec<(u32, T)> =
                    rows.iter(world).map(|(id, value)| (id.0, value.clone())).collect();
                all.sort_unstable_by_key(|(id, _)| *id);
                Box::new(all.into_iter().map(|(_, value)| value).collect::<Vec<T>>())
            },
            restore: |world, kept| {
                let Some(kept) = kept.downcast_ref::<Vec<T>>() else { return };
                let mut rows = world.query::<(&ParticleId, &mut T)>();
                for (id, mut value) in rows.iter_mut(world) {
                    if let Some(kept) = kept.get(id.0 as usize) {
                        value.clone_from(kept);
                    }
                }
            },
        }
    }

    /// Name of the component.
    pub fn name(&self) -> &'static str {
        self.name
    }

    /// Bytes per particle.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// Gives every particle the default value.
    pub(crate) fn spawn(&self, world: &mut World) {
        (self.spawn)(world);
    }

    /// Resets the column to the default value.
    pub(crate) fn forget(&self, world: &mut World) {
        (self.forget)(world);
    }

    /// A copy of the values, for [`Self::restore`].
    pub(crate) fn keep(&self, world: &mut World) -> KeptColumn {
        (self.keep)(world)
    }

    /// Restores the values of a copy.
    pub(crate) fn restore(&self, world: &mut World, kept: &KeptColumn) {
        (self.restore)(world, kept);
    }
}
