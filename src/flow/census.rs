//! Checks that the World is still the one the flow was built with: the same particles, and no
//! systems without derivatives.

use super::Flow;
use crate::error::{Error, Result};
use crate::systems::particles::Particles;
use bevy_ecs::prelude::Schedule;
use bevy_ecs::system::SystemAccess;

/// The systems of an initialised schedule: the name, and whether the system may change anything.
fn systems_of(schedule: &Schedule) -> Vec<(String, bool)> {
    let Ok(all) = schedule.systems_with_access() else { return Vec::new() };
    let changes = |access: &SystemAccess| match access {
        SystemAccess::None => false,
        SystemAccess::Shared(access) => access.combined_access().has_any_write(),
        SystemAccess::Exclusive => true,
    };
    let named = all.map(|(_, with_access)| {
        let system = with_access.system();
        (system.name().to_string(), system.has_deferred() || changes(with_access.access()))
    });
    named.collect()
}

impl<const D: usize> Flow<D> {
    /// Stores the names of the systems that come from terms.
    pub(super) fn know_own_systems(&mut self) -> Result<()> {
        self.advance.initialize(&mut self.world).map_err(|error| {
            let expected = "an order between any two systems that touch the same data";
            let remedy = "give the stages of the terms phases of their own";
            Error::input("the terms of this flow", expected, format!("{error:?}"), remedy)
        })?;
        self.own_systems = systems_of(&self.advance).into_iter().map(|(name, _)| name).collect();
        Ok(())
    }

    /// Refuses systems that the user has added and that change something, if the flow is
    /// differentiated.
    pub(super) fn must_be_differentiated(&self) -> Result<()> {
        if self.columns.is_empty() && self.backward.is_none() {
            return Ok(());
        }
        let mut known = self.own_systems.clone();
        for (name, changes) in systems_of(&self.advance) {
            match known.iter().position(|own| *own == name) {
                Some(own) => drop(known.swap_remove(own)),
                None if !changes => {}
                None => {
                    return Err(Error::input(
                        format!("system {name}"),
                        "only systems whose derivatives are known, since this flow is differentiated",
                        "a system added to the schedule that may change the flow",
                        "make it a term with Scene::add_force or Scene::add_term, or let it only read",
                    ));
                }
            }
        }
        Ok(())
    }

    /// Refuses a World that has lost or gained particles.
    pub(super) fn take_census(&mut self) -> Result<()> {
        let expected = *self.world.resource::<Particles>();
        let query = self.identities.query(&self.world);
        let mut tables = query.contiguous_iter().into_iter().flatten();
        if let (Some(ids), None) = (tables.next(), tables.next())
            && expected.are_in_order(ids)
        {
            return Ok(());
        }
        let mut seen = vec![0_u32; expected.0];
        let mut unknown = None;
        for id in self.identities.query(&self.world).iter() {
            match seen.get_mut(id.0 as usize) {
                Some(count) => *count += 1,
                None => unknown = Some(id.0),
            }
        }
        let wrong = seen.iter().position(|&count| count != 1);
        let found = match (wrong, unknown) {
            (None, None) => return Ok(()),
            (Some(particle), _) if seen[particle] == 0 => {
                format!("no entity with ParticleId({particle}): it was despawned")
            }
            (Some(particle), _) => {
                format!("{} entities with ParticleId({particle})", seen[particle])
            }
            (None, Some(id)) => format!("an entity with ParticleId({id})"),
        };
        Err(Error::input(
            "the particles of this flow",
            format!("one entity for each ParticleId from 0 to {}", expected.0.saturating_sub(1)),
            found,
            "build a new flow from the particles that are left; entities that are no particles go without an ParticleId",
        ))
    }
}
