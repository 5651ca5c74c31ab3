//! Memory of a World, per particle: columns of components, and arrays.

use super::Flow;
use crate::models::ForceJacobian;
use crate::neighbours::near::Near;
use crate::scalar::Precision;
use crate::systems::ScheduleKind;
use crate::systems::density_tangent::DensityJacobian;
use crate::systems::loss::{Observation, Observations};
use crate::systems::neighbours::{Chunk, Neighbours};
use crate::systems::particles::{
    Accelerations, AdjointCloud, BlockOf, Densities, PairInputs, ParticleId, SensitivityCloud,
};
use crate::systems::tape::{FrameAdjoint, Tape};
use crate::systems::verlet::Integrator;
use bevy_ecs::archetype::{Archetype, ArchetypeEntity};
use bevy_ecs::entity::{Entity, EntityLocation};
use bevy_ecs::prelude::Schedule;
use bevy_ecs::resource::IsResource;
use serde::Serialize;

/// One column: a component, or an array.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MemoryReport {
    /// The part to which it belongs.
    pub part: &'static str,
    /// Its name.
    pub name: String,
    /// Bytes per particle.
    pub bytes: f64,
}

impl MemoryReport {
    /// A column of a part.
    pub fn new(part: &'static str, name: impl Into<String>, bytes: f64) -> Self {
        Self { part, name: name.into(), bytes }
    }

    /// The sum of every part, in the order in which the parts first occur.
    pub fn parts(columns: &[Self]) -> Vec<(&'static str, f64)> {
        let mut parts: Vec<(&'static str, f64)> = Vec::new();
        for Self { part, bytes, .. } in columns {
            match parts.iter_mut().find(|(known, _)| known == part) {
                Some((_, sum)) => *sum += bytes,
                None => parts.push((part, *bytes)),
            }
        }
        parts
    }
}

/// Size of the ECS's own record of an entity, in bytes: its place in a table and in an archetype,
/// its generation, and the tick of its spawn.
const ENTITY: usize = size_of::<Entity>()
    + size_of::<ArchetypeEntity>()
    + (size_of::<Option<EntityLocation>>() + 4 + 4);

/// Size of the ECS's own record of a component of an entity, in bytes: the ticks at which it was
/// added and changed.
const TICKS: usize = 8;

/// Arrays of a part: name, and total bytes.
type Arrays = Vec<(&'static str, usize)>;

fn room<T>(column: &Vec<T>) -> usize {
    size_of::<T>() * column.capacity()
}

impl<const D: usize> Flow<D> {
    /// Every column that the World currently holds for its particles.
    pub fn held(&self) -> Vec<MemoryReport> {
        let mut held = self.components();
        let count = self.particles().max(1) as f64;
        let parts: [(&'static str, Arrays); 7] = [
            ("cloud", self.cloud_arrays()),
            ("neighbour lists", self.list_arrays()),
            ("sensitivities", self.sensitivity_arrays()),
            ("linearised pairs", self.pair_arrays()),
            ("adjoint", self.adjoint_arrays()),
            ("tape", self.tape_arrays()),
            ("observations", self.observation_arrays()),
        ];
        for (part, arrays) in parts {
            let arrays = arrays.into_iter().filter(|(_, bytes)| *bytes > 0);
            held.extend(
                arrays.map(|(name, bytes)| MemoryReport::new(part, name, bytes as f64 / count)),
            );
        }
        held
    }

    /// Bytes per particle of everything that the World holds, by part.
    pub fn bytes_per_particle(&self) -> Vec<(&'static str, f64)> {
        MemoryReport::parts(&self.held())
    }

    /// Memory that one step adds to the tape of an adjoint, at most: evaluations share their lists
    /// until the lists are rebuilt. Empty without a tape.
    pub fn tape_of_a_step(&self) -> Vec<MemoryReport> {
        if !self.world.contains_resource::<Tape<D>>() {
            return Vec::new();
        }
        let count = self.particles().max(1) as f64;
        let evaluations =
            if self.world.resource::<Integrator>().step.refreshes() { 2.0 } else { 1.0 };
        let inputs = self.world.resource::<PairInputs>();
        let chunks = &self.world.resource::<Neighbours<D>>().chunks;
        let lists: usize = chunks.iter().map(Chunk::bytes).sum();
        let near: usize = chunks.iter().map(Chunk::batches).sum();
        let lines = size_of_val(inputs.packed.as_slice()) + 4 * inputs.len();
        let tape = |name: &str, bytes: f64| MemoryReport::new("tape, a step", name, bytes);
        let mut all = vec![
            tape("cloud of each evaluation", evaluations * lines as f64 / count),
            tape("lists of each evaluation", evaluations * lists as f64 / count),
            tape("who is near in each evaluation", evaluations * near as f64 / count),
        ];
        if let Some(observations) = self.world.get_resource::<Observations<D>>() {
            let steps = observations.frames.first().map_or(1, |frame| frame.step.max(1));
            all.push(tape(
                "loss by each observed state",
                FrameAdjoint::<D>::BYTES as f64 / steps as f64,
            ));
        }
        all
    }

    /// The schedules of the flow, and the systems of each, in order.
    pub fn programs(&mut self) -> Vec<(ScheduleKind, Vec<String>)> {
        if self.check_order().is_err() {
            return Vec::new();
        }
        let mut programs = vec![
            (ScheduleKind::Start, systems_of(&self.start)),
            (ScheduleKind::Advance, systems_of(&self.advance)),
        ];
        if let Some(backward) = &self.backward {
            programs.push((ScheduleKind::Prepare, systems_of(&backward.prepare)));
            programs.push((ScheduleKind::StepAdjoint, systems_of(&backward.retreat)));
            programs.push((ScheduleKind::StartAdjoint, systems_of(&backward.back_to_start)));
        }
        programs
    }

    /// Names of the systems of one step, in order.
    pub fn systems(&mut self) -> Vec<String> {
        let programs = self.programs().into_iter();
        let advance = programs.filter(|(program, _)| *program == ScheduleKind::Advance);
        advance.flat_map(|(_, systems)| systems).collect()
    }

    /// Number of particles.
    fn particles(&self) -> usize {
        let Some(identity) = self.world.component_id::<ParticleId>() else { return 0 };
        let all = self.world.archetypes().iter().filter(|kind| kind.contains(identity));
        all.map(|kind| kind.len() as usize).sum()
    }

    /// Components of all entities that are not resources, with the ECS's own records.
    fn components(&self) -> Vec<MemoryReport> {
        let count = self.particles().max(1) as f64;
        let resource = self.world.component_id::<IsResource>();
        let is_resource = |kind: &&Archetype| resource.is_some_and(|id| kind.contains(id));
        let (mut held, mut kept) = (Vec::new(), Vec::new());
        let kinds = self.world.archetypes().iter().filter(|kind| !kind.is_empty());
        for kind in kinds.filter(|kind| !is_resource(kind)) {
            let each = f64::from(kind.len()) / count;
            let of_blocks =
                self.world.component_id::<BlockOf>().is_some_and(|id| kind.contains(id));
            for &id in kind.components() {
                let Some(info) = self.world.components().get_info(id) else { continue };
                let name = short(&info.name().to_string());
                let part = match (of_blocks, name.ends_with("Adjoint")) {
                    (true, _) => "sensitivities",
                    (_, true) => "adjoint",
                    _ => "components",
                };
                held.push(MemoryReport::new(
                    part,
                    name,
                    each * (info.layout().size() + TICKS) as f64,
                ));
            }
            let part = if of_blocks { "sensitivities" } else { "components" };
            kept.push(MemoryReport::new(part, "entity", each * ENTITY as f64));
        }
        held.append(&mut kept);
        held
    }

    fn cloud_arrays(&self) -> Arrays {
        let Some(inputs) = self.world.get_resource::<PairInputs>() else { return Vec::new() };
        let densities = self.world.resource::<Densities>();
        let mut arrays = vec![
            ("packed", room(&inputs.packed)),
            ("acceleration", room(&self.world.resource::<Accelerations<D>>().0)),
            ("density", room(&densities.by_slot)),
            ("masks", densities.masks.iter().map(room).sum()),
        ];
        if inputs.precision == Precision::Mixed {
            arrays.push(("singles", room(&inputs.singles)));
        }
        arrays
    }

    fn list_arrays(&self) -> Arrays {
        let Some(neighbours) = self.world.get_resource::<Neighbours<D>>() else {
            return Vec::new();
        };
        let lists: usize = neighbours.chunks.iter().map(Chunk::bytes).sum();
        let (cells, bounds) = (neighbours.cells.bytes(), neighbours.bytes_of_bounds());
        let rest = neighbours.bytes() - size_of_val(neighbours.reference());
        vec![
            ("lists", lists),
            ("cells", cells),
            ("bounds", bounds),
            // By cell, in fixed point, at the last rebuild.
            ("positions", rest - lists - cells - bounds),
        ]
    }

    fn sensitivity_arrays(&self) -> Arrays {
        let Some(cloud) = self.world.get_resource::<SensitivityCloud<D>>() else {
            return Vec::new();
        };
        let blocks = cloud.blocks.iter();
        vec![
            ("packed", blocks.clone().map(|block| room(&block.packed)).sum()),
            ("density", blocks.clone().map(|block| room(&block.density)).sum()),
            ("acceleration", blocks.map(|block| room(&block.acceleration)).sum()),
            ("stress_slopes", room(&cloud.p_over_rho2_slopes)),
        ]
    }

    /// Pairs of one window of chunks, shared by all blocks.
    fn pair_arrays(&self) -> Arrays {
        let Some(cloud) = self.world.get_resource::<SensitivityCloud<D>>() else {
            return Vec::new();
        };
        vec![
            ("pulls", cloud.pulls.iter().map(DensityJacobian::bytes).sum()),
            ("slopes", cloud.slopes.iter().map(ForceJacobian::bytes).sum()),
        ]
    }

    fn adjoint_arrays(&self) -> Arrays {
        let Some(cloud) = self.world.get_resource::<AdjointCloud<D>>() else { return Vec::new() };
        let reference = self.world.get_resource::<Neighbours<D>>().map(Neighbours::reference);
        vec![
            ("reference", reference.map_or(0, size_of_val)),
            ("packed", room(&cloud.packed)),
            ("position", room(&cloud.position)),
            ("velocity", room(&cloud.velocity)),
            ("scalars", room(&cloud.scalars)),
            ("carried", room(&cloud.carried)),
            ("sums", room(&cloud.sums)),
            ("lists of who is near", cloud.near.iter().map(Near::bytes).sum()),
            ("shares", cloud.shares.iter().map(room).sum()),
            ("senders", cloud.senders.bytes()),
        ]
    }

    fn tape_arrays(&self) -> Arrays {
        let spare = self.world.get_resource::<Tape<D>>().map_or(0, Tape::spare_bytes);
        vec![("evaluations and frames", self.tape_bytes()), ("to be used again", spare)]
    }

    fn observation_arrays(&self) -> Arrays {
        let Some(observed) = self.world.get_resource::<Observations<D>>() else {
            return Vec::new();
        };
        let frames = observed.frames.iter();
        let statistics = |frame: &Observation<D>| {
            room(&frame.statistics) + frame.statistics.iter().map(room).sum::<usize>()
        };
        vec![
            ("positions of each frame", frames.clone().map(|frame| room(&frame.positions)).sum()),
            ("velocities of each frame", frames.clone().map(|frame| room(&frame.velocities)).sum()),
            ("field of each frame", frames.map(|frame| room(&frame.field)).sum()),
            ("velocities at the start", room(&observed.first.velocities)),
            ("positions at the start", room(&observed.first.positions)),
            ("statistics of each frame", observed.frames.iter().map(statistics).sum()),
        ]
    }
}

/// `module::system` of each system of an initialised schedule.
fn systems_of(schedule: &Schedule) -> Vec<String> {
    let all = schedule.systems();
    let named = all.map(|all| all.map(|(_, system)| system.name().to_string()).collect());
    let named: Vec<String> = named.unwrap_or_default();
    let last_two = |name: &String| {
        let path = name.split('<').next().unwrap_or_default();
        let mut parts: Vec<&str> = path.rsplit("::").take(2).collect();
        parts.reverse();
        parts.join("::")
    };
    named.iter().map(last_two).collect()
}

/// The name of a type without modules and generic arguments.
fn short(name: &str) -> String {
    let path = name.split('<').next().unwrap_or_default();
    path.rsplit("::").next().unwrap_or_default().to_owned()
}
