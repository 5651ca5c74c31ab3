//! The pair forces, Eq. (7), with their tangent and their pullback.

use super::neighbours::{CHUNK, Chunk, Neighbours};
use super::pairs::{Batch, gather};
use super::particles::{Acceleration, AdjointCloud, Cloud, SensitivityBlock, SensitivityCloud};
use crate::models::{Model, Parameter, Strength};
use crate::packed::{Packed, PackedAdjoint, PackedSensitivity};
use crate::scalar::{Lanes, Scalar, WIDTH};
use crate::sensitivity::Coupling;
use crate::space::PeriodicBox;
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use pulp::{Arch, NullaryFnOnce};
use rayon::prelude::*;

/// The model that moves the particles of a World.
#[derive(Resource, Clone, Debug)]
pub struct Law<M: Send + Sync + 'static>(pub M);

/// `aᵢ = Σⱼ s rᵢⱼ` over one chunk of particles.
struct ForcePass<'a, M, const D: usize> {
    packed: &'a [Packed],
    chunk: &'a Chunk,
    space: PeriodicBox,
    model: &'a M,
    acceleration: &'a mut [Vector<f64, D>],
}

impl<M: Model<D>, const D: usize> NullaryFnOnce for ForcePass<'_, M, D> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        for (k, acceleration) in self.acceleration.iter_mut().enumerate() {
            let here = &self.packed[self.chunk.first + k];
            let mut sum = Vector::<Lanes, D>::zero();
            for slots in self.chunk.neighbours(k) {
                let batch = Batch::<D>::read(self.packed, here, slots, self.space);
                sum += batch.separation * self.model.strength(&batch.pair, batch.stresses);
            }
            for axis in 0..D {
                acceleration[axis] = sum[axis].sum();
            }
        }
    }
}

/// Pair accelerations of all particles, in cell order.
pub fn pair_accelerations<M: Model<D>, const D: usize>(
    neighbours: &Neighbours<D>,
    model: &M,
    packed: &[Packed],
    acceleration: &mut [Vector<f64, D>],
) {
    let chunks = neighbours.chunks.par_iter().zip(acceleration.par_chunks_mut(CHUNK));
    chunks.for_each(|(chunk, acceleration)| {
        let space = neighbours.space;
        Arch::new().dispatch(ForcePass { packed, chunk, space, model, acceleration });
    });
}

/// System: the force of all pairs.
pub fn accelerate<M: Model<D>, const D: usize>(
    neighbours: Res<Neighbours<D>>,
    law: Res<Law<M>>,
    mut cloud: ResMut<Cloud<D>>,
) {
    let Cloud { packed, acceleration, .. } = &mut *cloud;
    pair_accelerations(&neighbours, &law.0, packed, acceleration);
}

/// System: writes the accelerations back to the particles.
pub fn write_acceleration<const D: usize>(
    mut accelerations: Query<&mut Acceleration<D>>,
    cloud: Res<Cloud<D>>,
) {
    let mut slots = cloud.slot_of_row.iter();
    for column in accelerations.contiguous_iter_mut().into_iter().flatten() {
        for (acceleration, &slot) in column.into_iter().zip(&mut slots) {
            acceleration.0 = cloud.acceleration[slot as usize];
        }
    }
}

/// `δaᵢ = Σⱼ (s δrᵢⱼ + rᵢⱼ δs)` over one chunk of particles and one block of parameters: the gradient
/// of `s` is found for eight pairs at once, then serves the eight parameters of each pair at once.
struct ForceTangent<'a, M, const D: usize> {
    packed: &'a [Packed],
    chunk: &'a Chunk,
    space: PeriodicBox,
    model: &'a M,
    block: &'a SensitivityBlock<D>,
    coupling: Coupling,
    acceleration: &'a mut [Vector<Lanes, D>],
}

impl<M: Model<D>, const D: usize> NullaryFnOnce for ForceTangent<'_, M, D> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { acceleration, .. } = self;
        for (k, acceleration) in acceleration.iter_mut().enumerate() {
            let slot = self.chunk.first + k;
            let own = &self.block.packed[slot];
            let mut sum = Vector::<Lanes, D>::zero();
            for slots in self.chunk.neighbours(k) {
                let batch = Batch::<D>::read(self.packed, &self.packed[slot], slots, self.space);
                let pairs = PairTangents::new(self.model, &batch, &self.block.directions);
                for (lane, &j) in slots.iter().enumerate() {
                    let Some(other) = self.block.packed.get(j as usize) else {
                        break;
                    };
                    sum += match self.coupling {
                        Coupling::Full => pairs.full(lane, own, other),
                        Coupling::Local => {
                            let there = self.packed[j as usize].density;
                            let by_density = self.model.stress_gradient(there).by_density;
                            let pull = pull_of_density(self.model, &batch, lane);
                            pairs.local(lane, own, other, (pull, by_density))
                        }
                    };
                }
            }
            *acceleration = sum;
        }
    }
}

/// `m G` of one pair, for the density that particle `i` gives to `j`.
#[inline(always)]
fn pull_of_density<M: Model<D>, const D: usize>(model: &M, batch: &Batch<D>, lane: usize) -> f64 {
    let r2 = batch.pair.r2.to_array()[lane];
    model.smoothing().gradient(r2.sqrt()) * model.mass()
}

/// The linearised forces of eight pairs, ready to be applied to columns.
struct PairTangents<const D: usize> {
    separation: Vector<[f64; WIDTH], D>,
    velocity: Vector<[f64; WIDTH], D>,
    strength: Strength<[f64; WIDTH]>,
    directions: [Lanes; 3],
}

impl<const D: usize> PairTangents<D> {
    #[inline(always)]
    fn new<M: Model<D>>(
        model: &M,
        batch: &Batch<D>,
        directions: &[Lanes; Parameter::COUNT],
    ) -> Self {
        let s = model.strength_gradient(&batch.pair, batch.stresses);
        Self {
            separation: batch.separation.map(Lanes::to_array),
            velocity: batch.velocity.map(Lanes::to_array),
            strength: Strength {
                value: s.value.to_array(),
                by_separation: s.by_separation.to_array(),
                by_approach: s.by_approach.to_array(),
                by_stress: s.by_stress.to_array(),
                by_density: s.by_density.to_array(),
                by_parameter: s.by_parameter.map(Lanes::to_array),
            },
            directions: [directions[0], directions[1], directions[2]],
        }
    }

    /// `s δr + r δs` of one pair, from `δr`, `δv`, `δρᵢ + δρⱼ` and `δAᵢ + δAⱼ`.
    #[inline(always)]
    fn apply(&self, lane: usize, change: &PackedSensitivity<D>) -> Vector<Lanes, D> {
        let s = &self.strength;
        let mut along = Lanes::ZERO;
        let mut approach = Lanes::ZERO;
        for axis in 0..D {
            along += change.position[axis] * self.separation[axis][lane];
            approach += change.position[axis] * self.velocity[axis][lane];
            approach += change.velocity[axis] * self.separation[axis][lane];
        }
        let mut ds = along * s.by_separation[lane] + approach * s.by_approach[lane];
        ds += change.stress * s.by_stress[lane] + change.density * s.by_density[lane];
        for (direction, by) in self.directions.iter().zip(&s.by_parameter) {
            ds += *direction * by[lane];
        }
        let mut force = change.position;
        for axis in 0..D {
            force[axis] = change.position[axis] * s.value[lane] + ds * self.separation[axis][lane];
        }
        force
    }

    #[inline(always)]
    fn full(
        &self,
        lane: usize,
        own: &PackedSensitivity<D>,
        other: &PackedSensitivity<D>,
    ) -> Vector<Lanes, D> {
        let change = PackedSensitivity {
            position: own.position - other.position,
            velocity: own.velocity - other.velocity,
            density: own.density + other.density,
            stress: own.stress + other.stress,
        };
        self.apply(lane, &change)
    }

    /// As [`Self::full`] with the neighbour's own sensitivities dropped: of `δρⱼ` only what particle
    /// `i` itself gives remains, of `δAⱼ` that and the explicit dependence on the parameters.
    #[inline(always)]
    fn local(
        &self,
        lane: usize,
        own: &PackedSensitivity<D>,
        other: &PackedSensitivity<D>,
        (pull, by_density): (f64, f64),
    ) -> Vector<Lanes, D> {
        let mut given = Lanes::ZERO;
        for axis in 0..D {
            given += own.position[axis] * (self.separation[axis][lane] * pull);
        }
        let explicit = other.stress - other.density * by_density;
        let change = PackedSensitivity {
            position: own.position,
            velocity: own.velocity,
            density: own.density + given,
            stress: own.stress + explicit + given * by_density,
        };
        self.apply(lane, &change)
    }
}

/// System: the tangent of [`accelerate`] for every block of parameters.
pub fn accelerate_tangent<M: Model<D>, const D: usize>(
    neighbours: Res<Neighbours<D>>,
    law: Res<Law<M>>,
    cloud: Res<Cloud<D>>,
    mut sensitivities: ResMut<SensitivityCloud<D>>,
) {
    let (model, coupling) = (&law.0, sensitivities.coupling);
    for block in &mut sensitivities.blocks {
        let mut acceleration = std::mem::take(&mut block.acceleration);
        let (packed, space, block_read) = (&cloud.packed, neighbours.space, &*block);
        let chunks = neighbours.chunks.par_iter().zip(acceleration.par_chunks_mut(CHUNK));
        chunks.for_each(|(chunk, acceleration)| {
            Arch::new().dispatch(ForceTangent {
                packed,
                chunk,
                space,
                model,
                block: block_read,
                coupling,
                acceleration,
            });
        });
        block.acceleration = acceleration;
    }
}

/// What one chunk of particles passes back through the pair forces.
struct ForcePullback<'a, M, const D: usize> {
    packed: &'a [Packed],
    adjoint: &'a [PackedAdjoint],
    chunk: &'a Chunk,
    space: PeriodicBox,
    model: &'a M,
    position: &'a mut [Vector<f64, D>],
    velocity: &'a mut [Vector<f64, D>],
    /// `(∂L/∂A, ∂L/∂ρ)` per particle.
    scalars: &'a mut [(f64, f64)],
}

impl<M: Model<D>, const D: usize> NullaryFnOnce for ForcePullback<'_, M, D> {
    /// `∂L/∂(c, α, β)` at fixed stress.
    type Output = [f64; 3];

    /// A pair's two forces are opposite, so its part of the loss is `Λ·s rᵢⱼ` with `Λ = λᵢ − λⱼ`, from
    /// which each particle takes its own derivatives: `s Λ + (Λ·rᵢⱼ) ∂s/∂rᵢⱼ` and so on.
    #[inline(always)]
    fn call(self) -> [f64; 3] {
        let mut by_parameter = [Lanes::ZERO; 3];
        for k in 0..self.chunk.len() {
            let slot = self.chunk.first + k;
            let mut position = Vector::<Lanes, D>::zero();
            let mut velocity = Vector::<Lanes, D>::zero();
            let (mut stress, mut density) = (Lanes::ZERO, Lanes::ZERO);
            for slots in self.chunk.neighbours(k) {
                let batch = Batch::<D>::read(self.packed, &self.packed[slot], slots, self.space);
                let s = self.model.strength_gradient(&batch.pair, batch.stresses);
                let mut across = Vector::<Lanes, D>::zero();
                for axis in 0..D {
                    let there = gather(self.adjoint, slots, |a| a.force[axis]);
                    across[axis] = Lanes::of(self.adjoint[slot].force[axis]) - there;
                }
                let along = across.dot(batch.separation);
                let (by_r, by_v) = (along * s.by_separation, along * s.by_approach);
                position += across * s.value + batch.separation * by_r + batch.velocity * by_v;
                velocity += batch.separation * by_v;
                stress += along * s.by_stress;
                density += along * s.by_density;
                for (sum, slope) in by_parameter.iter_mut().zip(&s.by_parameter) {
                    *sum += along * *slope;
                }
            }
            for axis in 0..D {
                self.position[k][axis] += position[axis].sum();
                self.velocity[k][axis] += velocity[axis].sum();
            }
            self.scalars[k] = (stress.sum(), density.sum());
        }
        // Every pair was met from both ends.
        [by_parameter[0].sum() * 0.5, by_parameter[1].sum() * 0.5, by_parameter[2].sum() * 0.5]
    }
}

/// System: the pullback of [`accelerate`].
pub fn accelerate_pullback<M: Model<D>, const D: usize>(
    neighbours: Res<Neighbours<D>>,
    law: Res<Law<M>>,
    cloud: Res<Cloud<D>>,
    mut adjoint: ResMut<AdjointCloud<D>>,
) {
    let AdjointCloud { packed: lines, position, velocity, stress, parameters } = &mut *adjoint;
    let mut scalars = vec![(0.0, 0.0); cloud.len()];
    let (model, packed, space, adjoint) = (&law.0, &cloud.packed, neighbours.space, &*lines);
    let places = position.par_chunks_mut(CHUNK).zip(velocity.par_chunks_mut(CHUNK));
    let places = places.zip(scalars.par_chunks_mut(CHUNK));
    let pass = |(chunk, ((position, velocity), scalars))| {
        Arch::new().dispatch(ForcePullback {
            packed,
            adjoint,
            chunk,
            space,
            model,
            position,
            velocity,
            scalars,
        })
    };
    let sums: Vec<[f64; 3]> = neighbours.chunks.par_iter().zip(places).map(pass).collect();
    for sum in sums {
        (0..3).for_each(|k| parameters[k] += sum[k]);
    }
    for ((line, stress), (by_stress, by_density)) in lines.iter_mut().zip(stress).zip(scalars) {
        *stress = by_stress;
        line.density = by_density;
    }
}
