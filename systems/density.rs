//! Density by summation, Eq. (17), with its tangent and its pullback.
//!
//! Equation numbers are those of Woodward et al., arXiv:2110.13311: see `docs/equations.md`.

use super::acceleration::{Laws, PairTerm, WINDOW};
use super::density_tangent::{
    DensityJacobian, DensityTangent, PressureTangent, PullsPass, StressColumns, density_by_kernel,
};
use super::near::Pairs;
use super::neighbours::Neighbours;
use super::particles::{
    AdjointCloud, Densities, Density, EvaluatedPairs, PairInputs, ParticleId, SensitivityBlock,
    SensitivityCloud, side_by_side,
};
use super::term::{Stage, Term};
use super::{Needs, Occasion, Phase};
use crate::models::{FluidConstants, Medium, Model, Scratch};
use crate::neighbours::cells::MIN_PARALLEL_LEN;
use crate::packed::{Packed, PackedAdjoint};
use crate::pairs::{
    AHEAD, CHUNK, Chunk, Entry, Lines, MAX_BLOCKS_PER_TASK, Neighbourhood, adjoints, separation,
};
use crate::scalar::{F64x8, Scalar, SimdFloat, SimdTask, WIDTH, dispatch, dispatch_by_kernel};
use crate::space::Space;
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use rayon::prelude::*;

/// Term: density by summation, and the model's function of density, `A(ρ)`.
#[derive(Clone, Copy, Debug)]
#[doc(hidden)]
pub struct DensitySummation;

impl<const D: usize> Term<D> for DensitySummation {
    fn name(&self) -> String {
        "density".to_owned()
    }

    /// The force evaluation that begins a step uses the densities at the end of the step before,
    /// and passes its derivatives to them.
    fn stages(&self, occasion: Occasion, _: &Needs) -> Vec<Stage> {
        if occasion == Occasion::Reevaluate {
            return vec![Stage::backwards(Phase::Density, carry_density_pullback::<D>)];
        }
        let sum = (sum_density::<D>, write_density::<D>).chain();
        let stage = Stage::new(Phase::Density, sum);
        vec![stage.tangent(sum_density_tangent::<D>).pullback(sum_density_pullback::<D>)]
    }
}

/// `ρᵢ = Σⱼ m W(rᵢⱼ; h)`, self term included, over one chunk of particles. Also writes one mask for
/// each eight of listed neighbours: bit `n` says whether neighbour `n` has a nonzero weight.
struct DensityPass<'a, const D: usize> {
    lines: Lines<'a>,
    chunk: &'a Chunk,
    space: Space,
    medium: &'a Medium<D>,
    density: &'a mut [f64],
    masks: &'a mut [u8],
}

impl<const D: usize> SimdTask for DensityPass<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        if self.chunk.is_short() { self.sweep::<W, u16>() } else { self.sweep::<W, u32>() }
    }
}

impl<const D: usize> DensityPass<'_, D> {
    #[inline(always)]
    fn sweep<W: SimdFloat, E: Entry>(self) {
        let Self { lines, chunk, space, .. } = self;
        let smoothing = &self.medium.smoothing;
        let own = smoothing.value(0.0);
        let all = W::lines(lines);
        for (k, density) in self.density.iter_mut().enumerate() {
            chunk.fetch_ahead::<W, E>(k + AHEAD, all);
            let mut sum = W::Double::of(0.0);
            let space = chunk.around(k, space);
            let masks = &mut self.masks[chunk.range(k)];
            for (eight, mask) in chunk.neighbours::<E>(k).zip(masks) {
                let r = separation::<W, D>(lines, chunk.first + k, eight, space);
                let weight = smoothing.value(r.norm_squared().sqrt());
                *mask = weight.nonzero();
                sum += weight.widen();
            }
            *density = self.medium.mass * (own + sum.sum());
        }
    }
}

/// System: sums the density of every particle, and evaluates the model's `A(ρ)`.
#[doc(hidden)]
pub fn sum_density<const D: usize>(
    neighbours: Res<Neighbours<D>>,
    laws: Res<Laws<D>>,
    mut inputs: ResMut<PairInputs>,
    mut densities: ResMut<Densities>,
) {
    let (model, scratch_pool) = (laws.model(), &laws.model.scratch_pool);
    let (space, medium) = (neighbours.embedded, model.medium());
    let Densities { by_slot, masks } = &mut *densities;
    by_slot.resize(inputs.len(), 0.0);
    masks.resize_with(neighbours.chunks.len(), Vec::new);
    let lines = inputs.lines();
    let chunks = neighbours.chunks.par_iter().zip(by_slot.par_chunks_mut(CHUNK)).zip(masks);
    chunks.with_max_len(MAX_BLOCKS_PER_TASK).for_each(|((chunk, density), masks)| {
        chunk.make_masks(masks);
        let pass = DensityPass { lines, chunk, space, medium, density, masks };
        dispatch_by_kernel(medium.smoothing.is_table(), lines.precision, pass);
    });
    let PairInputs { packed, singles, .. } = &mut *inputs;
    let count = by_slot.len();
    let lines = packed[..count].par_chunks_mut(CHUNK).zip(by_slot.par_chunks(CHUNK));
    lines.for_each(|(lines, density)| {
        lines.iter_mut().zip(density).for_each(|(line, &rho)| line.density = rho);
        if model.has_pressure() {
            scratch_pool.enter(model, |scratch| find_p_over_rho2(model, lines, scratch));
        }
    });
    let lines = singles.par_iter_mut().zip(&packed[..count]).with_min_len(MIN_PARALLEL_LEN);
    lines.for_each(|(single, line)| {
        (single.density, single.p_over_rho2) = (line.density as f32, line.p_over_rho2 as f32);
    });
}

/// Densities of up to eight particles; 1 in unused lanes.
#[inline(always)]
pub(super) fn densities(lines: &[Packed]) -> F64x8 {
    let mut rho = F64x8::of(1.0);
    for (lane, line) in lines.iter().enumerate() {
        rho.set_lane(lane, line.density);
    }
    rho
}

/// `A(ρ)` of some particles.
fn find_p_over_rho2<const D: usize>(
    model: &dyn Model<D>,
    lines: &mut [Packed],
    scratch: &mut Scratch,
) {
    for lines in lines.chunks_mut(WIDTH) {
        let p_over_rho2 = model.p_over_rho2(densities(lines), scratch);
        for (lane, line) in lines.iter_mut().enumerate() {
            line.p_over_rho2 = p_over_rho2.lane(lane);
        }
    }
}

/// System: writes the densities back to the particles.
#[doc(hidden)]
pub fn write_density<const D: usize>(
    mut rows: Query<(&ParticleId, &mut Density)>,
    neighbours: Res<Neighbours<D>>,
    densities: Res<Densities>,
) {
    let order = neighbours.order();
    for (ids, mut column) in rows.contiguous_iter_mut().into_iter().flatten() {
        let rows = column.par_iter_mut().zip(ids).with_min_len(MIN_PARALLEL_LEN);
        rows.for_each(|(density, id)| {
            if let Some(slot) = order.slot(id.0 as usize) {
                density.0 = densities.by_slot[slot];
            }
        });
    }
}

/// System: the tangent of [`sum_density`] for every block of parameters.
#[doc(hidden)]
pub fn sum_density_tangent<const D: usize>(
    evaluated: EvaluatedPairs<'_, D>,
    laws: Res<Laws<D>>,
    mut sensitivities: ResMut<SensitivityCloud<D>>,
) {
    let (law, pairs) = (&laws.model, evaluated.pairs());
    let model = laws.model();
    let (medium, precision) = (model.medium(), evaluated.inputs.precision);
    let SensitivityCloud { blocks, coupling, p_over_rho2_slopes, pulls, .. } = &mut *sensitivities;
    p_over_rho2_slopes.resize(evaluated.len(), 0.0);
    let coupling = *coupling;
    pulls.resize_with(pairs.chunks().min(WINDOW), DensityJacobian::default);
    let (mut packed, mut changes, mut shapes) = (Vec::new(), Vec::new(), Vec::new());
    for SensitivityBlock { packed: lines, density, directions, .. } in &mut *blocks {
        packed.push(&lines[..]);
        changes.push(density);
        shapes.push(kernel_of(model, &directions[0]));
    }
    let shape = shapes.iter().any(|of| of.iter().any(|direction| *direction != F64x8::ZERO));
    for window in (0..pairs.chunks()).step_by(WINDOW) {
        let chunks = window..(window + WINDOW).min(pairs.chunks());
        chunks.clone().into_par_iter().zip(&mut *pulls).for_each(|(chunk, into)| {
            pairs.meet(chunk, law, |neighbourhood, _| {
                let pass = PullsPass { neighbourhood, medium, coupling, shape, into };
                dispatch_by_kernel(medium.smoothing.is_table(), precision, pass);
            });
        });
        changes.par_iter_mut().enumerate().for_each(|(block, density)| {
            let sensitivity = packed[block];
            let next = packed.get(block + 1).copied().unwrap_or_default();
            let columns = density[window * CHUNK..].par_chunks_mut(CHUNK);
            let chunks = columns.zip(&*pulls).zip(chunks.clone());
            chunks.for_each(|((density, pulls), chunk)| {
                let first = chunk * CHUNK;
                let shape = shapes[block];
                dispatch(DensityTangent { pulls, shape, first, sensitivity, next, density });
            });
        });
    }
    let (mut packed, mut columns) = (Vec::new(), Vec::new());
    for block in blocks {
        let SensitivityBlock { packed: lines, density, directions, weights, .. } = block;
        packed.push(&mut lines[..]);
        let (directions, weights) = (&directions[0][..], &weights[0][..]);
        columns.push(StressColumns { density, directions, weights });
    }
    let particles = evaluated.inputs.particles().par_chunks(CHUNK);
    let chunks = side_by_side(packed).into_par_iter().zip(particles);
    let chunks = chunks.zip(p_over_rho2_slopes.par_chunks_mut(CHUNK)).enumerate();
    chunks.for_each(|(chunk, ((lines, particles), slopes))| {
        law.scratch_pool.enter(model, |scratch| {
            let (first, columns, into) = (chunk * CHUNK, &columns[..], (lines, slopes));
            PressureTangent { model, first, columns, particles, into, scratch }.run();
        });
    });
}

/// `∂L/∂rᵢ += Σⱼ m G rᵢⱼ (∂L/∂ρᵢ + ∂L/∂ρⱼ)` over one chunk of particles.
struct DensityPullback<'a, const D: usize> {
    neighbourhood: Neighbourhood<'a>,
    adjoint: &'a [PackedAdjoint],
    medium: &'a Medium<D>,
    position: &'a mut [Vector<f64, D>],
}

impl<const D: usize> SimdTask for DensityPullback<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Neighbourhood { lines, near, space } = self.neighbourhood;
        let Medium { smoothing, mass, .. } = self.medium;
        for (k, position) in self.position.iter_mut().enumerate() {
            let slot = near.first + k;
            let own = self.adjoint[slot].density;
            let mut sum = Vector::<W::Double, D>::zero();
            let space = near.around(k, space);
            for eight in near.neighbours(k) {
                let r = separation::<W, D>(lines, slot, eight, space);
                let pull = smoothing.dw_over_r(r.norm_squared().sqrt()) * *mass;
                let [.., density] = adjoints::<W>(self.adjoint, eight);
                let both = pull.widen() * (density + own);
                for axis in 0..D {
                    sum[axis] += r[axis].widen() * both;
                }
            }
            for axis in 0..D {
                position[axis] += sum[axis].sum();
            }
        }
    }
}

/// System: the pullback of [`sum_density`]: turns `∂L/∂A` and `∂L/∂ρ` into `∂L/∂r` and derivatives
/// by parameters.
#[doc(hidden)]
pub fn sum_density_pullback<const D: usize>(
    evaluated: EvaluatedPairs<'_, D>,
    laws: Res<Laws<D>>,
    mut adjoint: ResMut<AdjointCloud<D>>,
) {
    let (law, model) = (&laws.model, laws.model());
    let places = if model.has_p_over_rho2_network() { &law.places } else { law.scalars() };
    adjoint.sum_parameters(places, |adjoint, sums, width| {
        let AdjointCloud { packed: lines, scalars, .. } = adjoint;
        let particles = evaluated.inputs.particles().par_chunks(CHUNK);
        let chunks = scalars.par_chunks(CHUNK).zip(particles);
        let chunks = chunks.zip(sums.par_chunks_mut(width));
        lines[..evaluated.len()].par_chunks_mut(CHUNK).zip(chunks).for_each(
            |(lines, (rows, sums))| {
                law.scratch_pool.enter(model, |scratch| {
                    scratch.clear();
                    pull_p_over_rho2_back(model, scratch, rows, lines);
                    scratch.write_sums(sums);
                });
            },
        );
    });
    pull_back_to_kernel(law, evaluated.pairs(), &mut adjoint);
    let AdjointCloud { packed: by_density, position, near, .. } = &mut *adjoint;
    let (pairs, adjoint, medium) = (evaluated.pairs(), &by_density[..], model.medium());
    near.par_iter().zip(position.par_chunks_mut(CHUNK)).for_each(|(near, position)| {
        let neighbourhood = pairs.neighbourhood(near);
        let pass = DensityPullback { neighbourhood, adjoint, medium, position };
        dispatch_by_kernel(medium.smoothing.is_table(), evaluated.inputs.precision, pass);
    });
}

/// The part of a model's scalar parameters that belongs to the kernel.
fn kernel_of<'a, T, const D: usize>(model: &dyn Model<D>, scalars: &'a [T]) -> &'a [T] {
    let count = model.medium().kernel_scalars();
    scalars.get(FluidConstants::COUNT..FluidConstants::COUNT + count).unwrap_or_default()
}

/// Adds `∂L/∂p = Σᵢ ∂L/∂ρᵢ ∂ρᵢ/∂p` for each parameter `p` of the kernel.
fn pull_back_to_kernel<const D: usize>(
    law: &PairTerm<D>,
    pairs: Pairs<'_>,
    adjoint: &mut AdjointCloud<D>,
) {
    let (medium, places) = (law.model.medium(), kernel_of(&*law.model, law.scalars()));
    if places.is_empty() {
        return;
    }
    adjoint.sum_parameters(places, |adjoint, sums, width| {
        let AdjointCloud { packed, near, .. } = adjoint;
        let lines = near.par_iter().zip(packed.par_chunks(CHUNK));
        lines.zip(sums.par_chunks_mut(width)).for_each(|((near, lines), sums)| {
            sums.fill(0.0);
            let by = density_by_kernel(pairs.neighbourhood(near), medium);
            for (line, by) in lines.iter().zip(by.chunks_exact(width)) {
                sums.iter_mut().zip(by).for_each(|(sum, by)| *sum += line.density * by);
            }
        });
    });
}

/// System: takes the place of [`sum_density_pullback`] for forces that used the densities of an
/// earlier evaluation at the same positions. It carries `∂L/∂A` and `∂L/∂ρ` to that evaluation.
#[doc(hidden)]
pub fn carry_density_pullback<const D: usize>(
    neighbours: Res<Neighbours<D>>,
    mut adjoint: ResMut<AdjointCloud<D>>,
) {
    let AdjointCloud { scalars, carried, .. } = &mut *adjoint;
    carried.clear();
    carried.extend(neighbours.order().slots().iter().map(|&slot| scalars[slot as usize]));
}

/// `(∂L/∂A, ∂L/∂ρ)` of some particles, and the particles.
type Rows<'a> = (&'a [(f64, f64)], &'a [Packed]);

/// `∂L/∂ρᵢ` of some particles, directly and through `A(ρ)`. The sums over parameters go to the
/// scratch buffer.
fn pull_p_over_rho2_back<const D: usize>(
    model: &dyn Model<D>,
    scratch: &mut Scratch,
    (scalars, particles): Rows<'_>,
    lines: &mut [PackedAdjoint],
) {
    let rows = lines.chunks_mut(WIDTH).zip(scalars.chunks(WIDTH)).zip(particles.chunks(WIDTH));
    for ((lines, scalars), particles) in rows {
        let mut by_density = F64x8::ZERO;
        if model.has_pressure() {
            let mut p_over_rho2 = F64x8::ZERO;
            for (lane, scalar) in scalars.iter().enumerate() {
                p_over_rho2.set_lane(lane, scalar.0);
            }
            by_density = model.p_over_rho2_pullback(densities(particles), p_over_rho2, scratch);
        }
        for (lane, (line, scalar)) in lines.iter_mut().zip(scalars).enumerate() {
            line.density = scalar.1 + by_density.lane(lane);
        }
    }
}
