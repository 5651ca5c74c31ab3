//! Density by summation, Eq. (17), with its tangent and its pullback.

use super::acceleration::Law;
use super::neighbours::{CHUNK, Chunk, Neighbours};
use super::pairs::{gather, separation};
use super::particles::{AdjointCloud, Cloud, Density, SensitivityCloud};
use crate::models::{Model, Parameter};
use crate::packed::{Packed, PackedAdjoint, PackedSensitivity};
use crate::scalar::{Lanes, Scalar};
use crate::sensitivity::Coupling;
use crate::space::PeriodicBox;
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use pulp::{Arch, NullaryFnOnce};
use rayon::prelude::*;

/// `ρᵢ = Σⱼ m W(rᵢⱼ; h)`, self term included, over one chunk of particles.
struct DensityPass<'a, M, const D: usize> {
    packed: &'a [Packed],
    chunk: &'a Chunk,
    space: PeriodicBox,
    model: &'a M,
    density: &'a mut [f64],
}

impl<M: Model<D>, const D: usize> NullaryFnOnce for DensityPass<'_, M, D> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let smoothing = self.model.smoothing();
        let own = smoothing.value(0.0);
        for (k, density) in self.density.iter_mut().enumerate() {
            let here = &self.packed[self.chunk.first + k];
            let mut sum = Lanes::ZERO;
            for slots in self.chunk.neighbours(k) {
                let r = separation::<D>(self.packed, here, slots, self.space);
                sum += smoothing.value(r.norm_squared().sqrt());
            }
            *density = self.model.mass() * (own + sum.sum());
        }
    }
}

/// System: sums the density at every particle, and what the model makes of it.
pub fn sum_density<M: Model<D>, const D: usize>(
    neighbours: Res<Neighbours<D>>,
    law: Res<Law<M>>,
    mut cloud: ResMut<Cloud<D>>,
) {
    let Cloud { packed, density, .. } = &mut *cloud;
    neighbours.chunks.par_iter().zip(density.par_chunks_mut(CHUNK)).for_each(|(chunk, density)| {
        let pass = DensityPass {
            packed: &*packed,
            chunk,
            space: neighbours.space,
            model: &law.0,
            density,
        };
        Arch::new().dispatch(pass);
    });
    packed.par_iter_mut().zip(&*density).with_min_len(CHUNK).for_each(|(line, &rho)| {
        line.density = rho;
        line.stress = law.0.stress(rho);
    });
}

/// System: writes the densities back to the particles.
pub fn write_density<const D: usize>(mut densities: Query<&mut Density>, cloud: Res<Cloud<D>>) {
    let mut slots = cloud.slot_of_row.iter();
    for column in densities.contiguous_iter_mut().into_iter().flatten() {
        for (density, &slot) in column.into_iter().zip(&mut slots) {
            density.0 = cloud.density[slot as usize];
        }
    }
}

/// `δρᵢ = Σⱼ m G rᵢⱼ·(δrᵢ − δrⱼ)` over one chunk of particles and one block of parameters.
struct DensityTangent<'a, M, const D: usize> {
    packed: &'a [Packed],
    chunk: &'a Chunk,
    space: PeriodicBox,
    model: &'a M,
    sensitivity: &'a [PackedSensitivity<D>],
    coupling: Coupling,
    density: &'a mut [Lanes],
}

impl<M: Model<D>, const D: usize> NullaryFnOnce for DensityTangent<'_, M, D> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let smoothing = self.model.smoothing();
        for (k, density) in self.density.iter_mut().enumerate() {
            let slot = self.chunk.first + k;
            let here = &self.packed[slot];
            let own = &self.sensitivity[slot];
            let mut sum = Lanes::ZERO;
            for slots in self.chunk.neighbours(k) {
                let r = separation::<D>(self.packed, here, slots, self.space);
                let pull = smoothing.gradient(r.norm_squared().sqrt()) * self.model.mass();
                let pulls: Vector<Lanes, D> = r * pull;
                let pulls = pulls.map(Lanes::to_array);
                for (lane, &j) in slots.iter().enumerate() {
                    let Some(other) = self.sensitivity.get(j as usize) else {
                        break;
                    };
                    for axis in 0..D {
                        let apart = match self.coupling {
                            Coupling::Full => own.position[axis] - other.position[axis],
                            Coupling::Local => own.position[axis],
                        };
                        sum += apart * pulls[axis][lane];
                    }
                }
            }
            *density = sum;
        }
    }
}

/// System: the tangent of [`sum_density`] for every block of parameters.
pub fn sum_density_tangent<M: Model<D>, const D: usize>(
    neighbours: Res<Neighbours<D>>,
    law: Res<Law<M>>,
    cloud: Res<Cloud<D>>,
    mut sensitivities: ResMut<SensitivityCloud<D>>,
) {
    let (model, coupling) = (&law.0, sensitivities.coupling);
    for block in &mut sensitivities.blocks {
        let (packed, sensitivity) = (&cloud.packed, &block.packed);
        let chunks = neighbours.chunks.par_iter().zip(block.density.par_chunks_mut(CHUNK));
        chunks.for_each(|(chunk, density)| {
            let space = neighbours.space;
            let pass =
                DensityTangent { packed, chunk, space, model, sensitivity, coupling, density };
            Arch::new().dispatch(pass);
        });
        let lines = block.packed.par_iter_mut().zip(&block.density).zip(cloud.particles());
        lines.with_min_len(CHUNK).for_each(|((line, &density), here)| {
            let stress = model.stress_gradient(here.density);
            line.density = density;
            line.stress = density * stress.by_density;
            for parameter in Parameter::ALL {
                let slope = stress.by_parameter[parameter as usize];
                line.stress += block.directions[parameter as usize] * slope;
            }
        });
    }
}

/// `∂L/∂rᵢ += Σⱼ m G rᵢⱼ (∂L/∂ρᵢ + ∂L/∂ρⱼ)` over one chunk of particles.
struct DensityPullback<'a, M, const D: usize> {
    packed: &'a [Packed],
    adjoint: &'a [PackedAdjoint],
    chunk: &'a Chunk,
    space: PeriodicBox,
    model: &'a M,
    position: &'a mut [Vector<f64, D>],
}

impl<M: Model<D>, const D: usize> NullaryFnOnce for DensityPullback<'_, M, D> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let smoothing = self.model.smoothing();
        for (k, position) in self.position.iter_mut().enumerate() {
            let slot = self.chunk.first + k;
            let mut sum = Vector::<Lanes, D>::zero();
            for slots in self.chunk.neighbours(k) {
                let r = separation::<D>(self.packed, &self.packed[slot], slots, self.space);
                let pull = smoothing.gradient(r.norm_squared().sqrt()) * self.model.mass();
                let both = gather(self.adjoint, slots, |a| a.density) + self.adjoint[slot].density;
                sum += r * (pull * both);
            }
            for axis in 0..D {
                position[axis] += sum[axis].sum();
            }
        }
    }
}

/// System: the pullback of [`sum_density`]: `∂L/∂A` and `∂L/∂ρ` become `∂L/∂r` and parameters.
pub fn sum_density_pullback<M: Model<D>, const D: usize>(
    neighbours: Res<Neighbours<D>>,
    law: Res<Law<M>>,
    cloud: Res<Cloud<D>>,
    mut adjoint: ResMut<AdjointCloud<D>>,
) {
    let AdjointCloud { packed: lines, position, stress, parameters, .. } = &mut *adjoint;
    let model = &law.0;
    let through_stress =
        |(lines, (stresses, particles)): (&mut [PackedAdjoint], (&[f64], &[Packed]))| {
            let mut sums = [0.0; Parameter::COUNT];
            for ((line, &by_stress), here) in lines.iter_mut().zip(stresses).zip(particles) {
                let stress = model.stress_gradient(here.density);
                line.density += by_stress * stress.by_density;
                for (sum, slope) in sums.iter_mut().zip(stress.by_parameter) {
                    *sum += by_stress * slope;
                }
            }
            sums
        };
    let chunks = stress.par_chunks(CHUNK).zip(cloud.particles().par_chunks(CHUNK));
    let sums: Vec<_> = lines.par_chunks_mut(CHUNK).zip(chunks).map(through_stress).collect();
    for sum in sums {
        (0..Parameter::COUNT).for_each(|k| parameters[k] += sum[k]);
    }
    pull_density_back(&neighbours, model, (&cloud.packed, lines), position);
}

/// Adds to `∂L/∂r` what `∂L/∂ρ` makes of it, in cell order.
pub fn pull_density_back<M: Model<D>, const D: usize>(
    neighbours: &Neighbours<D>,
    model: &M,
    (packed, adjoint): (&[Packed], &[PackedAdjoint]),
    position: &mut [Vector<f64, D>],
) {
    let space = neighbours.space;
    let chunks = neighbours.chunks.par_iter().zip(position.par_chunks_mut(CHUNK));
    chunks.for_each(|(chunk, position)| {
        let pass = DensityPullback { packed, adjoint, chunk, space, model, position };
        Arch::new().dispatch(pass);
    });
}
