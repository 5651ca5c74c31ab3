//! The coefficients of the tangent of the density and of `A(ρ)`.

use super::density::densities;
use crate::models::{Medium, Model, Scratch};
use crate::packed::{Packed, PackedSensitivity};
use crate::pairs::{Eight, Neighbourhood, separation};
use crate::scalar::{F64x8, Scalar, SimdFloat, SimdTask, WIDTH, dispatch, transposed};
use crate::sensitivity::Coupling;
use crate::vector::Vector;

/// The coefficients of the density tangent of a chunk of particles, the same for every block of
/// parameters: `δρᵢ = (Σⱼ m G rᵢⱼ)·δrᵢ − Σⱼ m G rᵢⱼ·δrⱼ`.
#[derive(Clone, Debug, Default)]
pub struct DensityJacobian<const D: usize> {
    /// `Σⱼ m G rᵢⱼ` of each particle.
    own: Vec<[f64; D]>,
    /// `∂ρᵢ/∂p = Σⱼ m ∂W/∂p`, self term included, for each particle and each learned parameter `p`
    /// of the kernel.
    by_kernel: Vec<f64>,
    /// Index of each particle's first pair, and the total at the end.
    start: Vec<u32>,
    /// The slots of the neighbours within `2h`.
    slots: Vec<u32>,
    /// `m G rᵢⱼ` of each pair.
    pulls: Vec<[f64; D]>,
    /// Number of pairs; elements from here on are unused.
    filled: usize,
}

impl<const D: usize> DensityJacobian<D> {
    /// Bytes held.
    pub fn bytes(&self) -> usize {
        size_of::<[f64; D]>() * (self.own.capacity() + self.pulls.capacity())
            + 8 * self.by_kernel.capacity()
            + 4 * (self.start.capacity() + self.slots.capacity())
    }

    /// Adds up to eight pairs. Sentinels, which come last, are not counted.
    #[inline(always)]
    fn push(&mut self, others: Eight<'_, u32>, sentinel: usize, pulls: &[F64x8; D]) {
        let end = self.filled + WIDTH;
        if self.slots.len() < end {
            self.slots.resize(end * 9 / 8, 0);
            self.pulls.resize(end * 9 / 8, [0.0; D]);
        }
        self.slots[self.filled..end].copy_from_slice(others.entries);
        for (lane, row) in self.pulls[self.filled..end].iter_mut().enumerate() {
            for axis in 0..D {
                row[axis] = pulls[axis].lane(lane);
            }
        }
        // The next call overwrites the sentinels.
        self.filled += others.count(sentinel);
    }
}

/// Finds the [`DensityJacobian`] of a chunk.
pub(super) struct PullsPass<'a, const D: usize> {
    pub(super) neighbourhood: Neighbourhood<'a>,
    pub(super) medium: &'a Medium<D>,
    pub(super) coupling: Coupling,
    /// Whether parameters of the kernel are learned.
    pub(super) shape: bool,
    pub(super) into: &'a mut DensityJacobian<D>,
}

impl<const D: usize> SimdTask for PullsPass<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Self {
            neighbourhood: Neighbourhood { lines, near, space },
            medium,
            coupling,
            shape,
            into,
        } = self;
        let Medium { smoothing, mass, .. } = medium;
        into.own.clear();
        into.by_kernel.clear();
        if shape {
            into.by_kernel.extend(density_by_kernel(self.neighbourhood, medium));
        }
        into.filled = 0;
        into.start.clear();
        into.start.push(0);
        for k in 0..near.len() {
            let space = near.around(k, space);
            let mut sum = Vector::<W::Double, D>::zero();
            for eight in near.neighbours(k) {
                let r = separation::<W, D>(lines, near.first + k, eight, space);
                let pull = smoothing.dw_over_r(r.norm_squared().sqrt()) * *mass;
                let mut pulls = [F64x8::ZERO; D];
                for axis in 0..D {
                    let along = (r[axis] * pull).widen();
                    pulls[axis] = along.store();
                    sum[axis] += along;
                }
                if coupling == Coupling::Full {
                    into.push(eight, lines.sentinel(), &pulls);
                }
            }
            let mut own = [0.0; D];
            for axis in 0..D {
                own[axis] = sum[axis].sum();
            }
            into.own.push(own);
            into.start.push(into.filled as u32);
        }
    }
}

/// `∂ρ/∂p = Σⱼ m ∂W/∂p` of a chunk of particles by each parameter of the kernel, self term
/// included, particle by particle. Not vectorised by instruction set: only learnable kernels need
/// it.
pub(super) fn density_by_kernel<const D: usize>(
    neighbourhood: Neighbourhood<'_>,
    medium: &Medium<D>,
) -> Vec<f64> {
    let Neighbourhood { lines, near, space } = neighbourhood;
    let Medium { smoothing, mass, .. } = medium;
    let count = medium.kernel_scalars();
    let mut sums = Vec::with_capacity(near.len() * count);
    for k in 0..near.len() {
        let around = near.around(k, space);
        for parameter in 0..count {
            let mut sum = F64x8::ZERO;
            for eight in near.neighbours(k) {
                let r = separation::<F64x8, D>(lines, near.first + k, eight, around);
                sum += smoothing.value_by(parameter, r.norm_squared().sqrt());
            }
            sums.push(mass * (smoothing.value_by(parameter, 0.0) + sum.sum()));
        }
    }
    sums
}

/// `δρ` of one chunk of particles for one block of parameters; prefetches the sensitivities of the
/// `next` block.
pub(super) struct DensityTangent<'a, const D: usize> {
    pub(super) pulls: &'a DensityJacobian<D>,
    /// `∂(the kernel's parameters)/∂(the eight learned parameters)`.
    pub(super) shape: &'a [F64x8],
    pub(super) first: usize,
    pub(super) sensitivity: &'a [PackedSensitivity<D>],
    pub(super) next: &'a [PackedSensitivity<D>],
    pub(super) density: &'a mut [F64x8],
}

impl<const D: usize> SimdTask for DensityTangent<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Self { pulls, shape, first, sensitivity, next, density } = self;
        for (k, density) in density.iter_mut().enumerate() {
            if let Some(next) = next.get(first + k) {
                W::Double::fetch_columns(&next.position.0);
            }
            let own = &sensitivity[first + k].position;
            let mut sum = W::Double::of(0.0);
            if !pulls.by_kernel.is_empty() {
                let by = &pulls.by_kernel[k * shape.len()..(k + 1) * shape.len()];
                for (direction, by) in shape.iter().zip(by) {
                    sum += W::Double::load(direction) * *by;
                }
            }
            for axis in 0..D {
                sum += W::Double::load(&own[axis]) * pulls.own[k][axis];
            }
            let pairs = pulls.start[k] as usize..pulls.start[k + 1] as usize;
            for (&slot, pull) in pulls.slots[pairs.clone()].iter().zip(&pulls.pulls[pairs]) {
                let other = &sensitivity[slot as usize].position;
                for axis in 0..D {
                    sum -= W::Double::load(&other[axis]) * pull[axis];
                }
            }
            *density = sum.store();
        }
    }
}

/// The columns of one block of parameters from which `δA` follows.
pub(super) struct StressColumns<'a> {
    /// `δρ` per slot.
    pub(super) density: &'a [F64x8],
    /// `∂(the model's scalar parameters)/∂(the eight learned parameters)`.
    pub(super) directions: &'a [F64x8],
    /// `(lane, place in the network, ∂weight/∂lane)` of the block.
    pub(super) weights: &'a [(usize, usize, f64)],
}

/// `δAᵢ = ∂A/∂ρ δρᵢ + ∂A/∂θ` of some particles and all blocks of parameters. `A(ρ)` is
/// differentiated once for all blocks.
pub(super) struct PressureTangent<'a, 'b, const D: usize> {
    pub(super) model: &'a dyn Model<D>,
    /// Slot of the first particle.
    pub(super) first: usize,
    pub(super) columns: &'a [StressColumns<'a>],
    pub(super) particles: &'a [Packed],
    pub(super) into: (Vec<&'b mut [PackedSensitivity<D>]>, &'b mut [f64]),
    pub(super) scratch: &'a mut Scratch,
}

impl<const D: usize> PressureTangent<'_, '_, D> {
    pub(super) fn run(self) {
        let Self { model, first, columns, particles, into: (mut blocks, slopes), scratch } = self;
        let some_weights = columns.iter().any(|block| !block.weights.is_empty());
        let with_weights = some_weights && model.has_p_over_rho2_network();
        let rows = slopes.chunks_mut(WIDTH).zip(particles.chunks(WIDTH));
        for (number, (slopes, particles)) in rows.enumerate() {
            let rho = densities(particles);
            let by_density = model.p_over_rho2_slope(rho, scratch);
            if with_weights {
                model.p_over_rho2_weights(rho, scratch);
            }
            for (lane, slope) in slopes.iter_mut().enumerate() {
                *slope = by_density.lane(lane);
            }
            let by_weight = with_weights.then_some(&scratch.weights[..]);
            for (lines, columns) in blocks.iter_mut().zip(columns) {
                let lines = &mut lines[number * WIDTH..][..slopes.len()];
                let density = &columns.density[first + number * WIDTH..];
                let p_over_rho2 = (by_density, &scratch.p_over_rho2_by[..]);
                dispatch(Fill { columns, density, lines, p_over_rho2, by_weight });
            }
        }
    }
}

/// Writes `δρ` and `δA` of up to eight particles for one block of parameters.
struct Fill<'a, const D: usize> {
    columns: &'a StressColumns<'a>,
    density: &'a [F64x8],
    lines: &'a mut [PackedSensitivity<D>],
    /// `∂A/∂ρ`, and `∂A` by each of the model's scalar parameters.
    p_over_rho2: (F64x8, &'a [F64x8]),
    by_weight: Option<&'a [F64x8]>,
}

impl<const D: usize> SimdTask for Fill<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Self { columns, density, lines, p_over_rho2: (by_density, by_parameter), by_weight } =
            self;
        let mut direct = [F64x8::ZERO; WIDTH];
        if let Some(by_weight) = by_weight {
            for &(lane, weight, by) in columns.weights {
                direct[lane] += by_weight[weight] * F64x8::of(by);
            }
        }
        let direct = transposed::<W>(&direct);
        for (lane, (line, density)) in lines.iter_mut().zip(density).enumerate() {
            let mut change = W::Double::load(density) * by_density.lane(lane);
            for (direction, slope) in columns.directions.iter().zip(by_parameter) {
                change += W::Double::load(direction) * slope.lane(lane);
            }
            line.density = *density;
            line.p_over_rho2 = (change + direct[lane]).store();
        }
    }
}
