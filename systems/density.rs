//! Density by summation, Eq. (17), with its tangent and its pullback.

use super::acceleration::{Law, WINDOW};
use super::neighbours::Neighbours;
use super::particles::{
    AdjointCloud, Cloud, Density, Rooms, SensitivityBlock, SensitivityCloud, side_by_side,
};
use crate::cells::FEWEST;
use crate::models::{Medium, Model, Parameter, Room, StressSlope};
use crate::packed::{Packed, PackedAdjoint, PackedSensitivity};
use crate::pairs::{AHEAD, CHUNK, Hood, Lines, adjoints, separation};
use crate::scalar::{Lanes, Pass, Scalar, WIDTH, Wide, dispatch, dispatch_in, transposed};
use crate::sensitivity::Coupling;
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use rayon::prelude::*;

/// `ρᵢ = Σⱼ m W(rᵢⱼ; h)`, self term included, over one chunk of particles.
struct DensityPass<'a, const D: usize> {
    hood: Hood<'a>,
    medium: &'a Medium<D>,
    density: &'a mut [f64],
}

impl<const D: usize> Pass for DensityPass<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(self) {
        let Hood { lines, chunk, space } = self.hood;
        let smoothing = &self.medium.smoothing;
        let own = smoothing.value(0.0);
        let all = W::lines(lines);
        for (k, density) in self.density.iter_mut().enumerate() {
            chunk.fetch_ahead::<W>(k + AHEAD, all);
            let mut sum = W::Double::of(0.0);
            let space = chunk.around(k, space);
            for slots in chunk.neighbours(k) {
                let r = separation::<W, D>(lines, chunk.first + k, slots, space);
                sum += smoothing.value(r.norm_squared().sqrt()).widen();
            }
            *density = self.medium.mass * (own + sum.sum());
        }
    }
}

/// System: sums the density at every particle, and what the model makes of it.
pub fn sum_density<const D: usize>(
    neighbours: Res<Neighbours<D>>,
    (law, rooms): (Res<Law<D>>, Res<Rooms>),
    mut cloud: ResMut<Cloud<D>>,
) {
    let (lines, density) = cloud.lines_and_density();
    neighbours.chunks.par_iter().zip(density.par_chunks_mut(CHUNK)).for_each(|(chunk, density)| {
        let hood = Hood { lines, chunk, space: neighbours.space };
        let pass = DensityPass { hood, medium: law.0.medium(), density };
        dispatch_in(lines.precision, pass);
    });
    let Cloud { packed, singles, density, .. } = &mut *cloud;
    let count = density.len();
    let lines = packed[..count].par_chunks_mut(CHUNK).zip(density.par_chunks(CHUNK));
    lines.for_each(|(lines, density)| {
        lines.iter_mut().zip(density).for_each(|(line, &rho)| line.density = rho);
        if law.0.has_stress() {
            rooms.enter(law.0.network(), |room| find_stress(&*law.0, lines, room));
        }
    });
    let lines = singles.par_iter_mut().zip(&packed[..count]).with_min_len(FEWEST);
    lines.for_each(|(single, line)| {
        (single.density, single.stress) = (line.density as f32, line.stress as f32);
    });
}

/// Densities of up to eight particles, one where there is none.
#[inline(always)]
fn densities(lines: &[Packed]) -> Lanes {
    let mut rho = Lanes::of(1.0);
    for (lane, line) in lines.iter().enumerate() {
        rho.set_lane(lane, line.density);
    }
    rho
}

/// `A(ρ)` of some particles.
fn find_stress<const D: usize>(model: &dyn Model<D>, lines: &mut [Packed], room: &mut Room) {
    for lines in lines.chunks_mut(WIDTH) {
        let stress = model.stress(densities(lines), room);
        for (lane, line) in lines.iter_mut().enumerate() {
            line.stress = stress.lane(lane);
        }
    }
}

/// System: writes the densities back to the particles.
pub fn write_density<const D: usize>(mut densities: Query<&mut Density>, cloud: Res<Cloud<D>>) {
    let mut slots = &cloud.slot_of_row[..];
    for mut column in densities.contiguous_iter_mut().into_iter().flatten() {
        let own = slots.split_off(..column.len()).unwrap_or_default();
        let rows = column.par_iter_mut().zip(own).with_min_len(FEWEST);
        rows.for_each(|(density, &slot)| density.0 = cloud.density[slot as usize]);
    }
}

/// What the density tangent of a chunk of particles is made of, for every block of parameters:
/// `δρᵢ = (Σⱼ m G rᵢⱼ)·δrᵢ − Σⱼ m G rᵢⱼ·δrⱼ`.
#[derive(Clone, Debug, Default)]
pub struct Pulls<const D: usize> {
    /// The first sum.
    own: Vec<[f64; D]>,
    /// Where each particle's pairs start; one more at the end.
    start: Vec<u32>,
    /// The neighbours within `2h`.
    slots: Vec<u32>,
    /// Of each its `m G rᵢⱼ`.
    pulls: Vec<[f64; D]>,
    /// How many pairs there are; what lies behind is anything.
    filled: usize,
}

impl<const D: usize> Pulls<D> {
    /// Bytes held.
    pub fn bytes(&self) -> usize {
        size_of::<[f64; D]>() * (self.own.capacity() + self.pulls.capacity())
            + 4 * (self.start.capacity() + self.slots.capacity())
    }

    /// Adds those of eight pairs whose pull has a size, and who are somebody.
    #[inline(always)]
    fn push(&mut self, slots: &[u32; WIDTH], (sizes, nobody): (Lanes, usize), pulls: &[Lanes; D]) {
        let end = self.filled + WIDTH;
        if self.slots.len() < end {
            self.slots.resize(end * 9 / 8, 0);
            self.pulls.resize(end * 9 / 8, [0.0; D]);
        }
        let (Some(others), Some(rows)) = (
            self.slots[self.filled..].first_chunk_mut::<WIDTH>(),
            self.pulls[self.filled..].first_chunk_mut::<WIDTH>(),
        ) else {
            return;
        };
        // Without a branch that nobody can predict: those that do not act are overwritten.
        let mut count = 0;
        for (lane, &slot) in slots.iter().enumerate() {
            // No more than the lanes before it.
            let place = count % WIDTH;
            others[place] = slot;
            for axis in 0..D {
                rows[place][axis] = pulls[axis].lane(lane);
            }
            count += usize::from(sizes.lane(lane) != 0.0 && slot as usize != nobody);
        }
        self.filled += count;
    }
}

/// Finds the [`Pulls`] of a chunk.
struct PullsPass<'a, const D: usize> {
    hood: Hood<'a>,
    medium: &'a Medium<D>,
    coupling: Coupling,
    into: &'a mut Pulls<D>,
}

impl<const D: usize> Pass for PullsPass<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(self) {
        let Self { hood: Hood { lines, chunk, space }, medium, coupling, into } = self;
        let Medium { smoothing, mass, .. } = medium;
        into.own.clear();
        into.filled = 0;
        into.start.clear();
        into.start.push(0);
        let nobody = lines.double.len() - 1;
        for k in 0..chunk.len() {
            let space = chunk.around(k, space);
            let mut sum = Vector::<W::Double, D>::zero();
            for slots in chunk.neighbours(k) {
                let r = separation::<W, D>(lines, chunk.first + k, slots, space);
                let pull = smoothing.gradient(r.norm_squared().sqrt()) * *mass;
                let (sizes, mut pulls) = (pull.store(), [Lanes::ZERO; D]);
                for axis in 0..D {
                    let along = (r[axis] * pull).widen();
                    pulls[axis] = along.store();
                    sum[axis] += along;
                }
                if coupling == Coupling::Full {
                    into.push(slots, (sizes, nobody), &pulls);
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

/// `δρ` of one chunk of particles for one block of parameters.
struct DensityTangent<'a, const D: usize> {
    pulls: &'a Pulls<D>,
    first: usize,
    sensitivity: &'a [PackedSensitivity<D>],
    density: &'a mut [Lanes],
}

impl<const D: usize> Pass for DensityTangent<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(self) {
        let Self { pulls, first, sensitivity, density } = self;
        for (k, density) in density.iter_mut().enumerate() {
            let own = &sensitivity[first + k].position;
            let mut sum = W::Double::of(0.0);
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

/// System: the tangent of [`sum_density`] for every block of parameters.
pub fn sum_density_tangent<const D: usize>(
    neighbours: Res<Neighbours<D>>,
    (law, rooms): (Res<Law<D>>, Res<Rooms>),
    cloud: Res<Cloud<D>>,
    mut sensitivities: ResMut<SensitivityCloud<D>>,
) {
    let (model, rooms) = (&*law.0, &*rooms);
    let medium = model.medium();
    let SensitivityCloud { blocks, coupling, stress_slopes, pulls, .. } = &mut *sensitivities;
    stress_slopes.resize(cloud.len(), 0.0);
    let (lines, space, coupling) = (cloud.lines(), neighbours.space, *coupling);
    pulls.resize_with(neighbours.chunks.len().min(WINDOW), Pulls::default);
    for (number, chunks) in neighbours.chunks.chunks(WINDOW).enumerate() {
        let first = number * WINDOW * CHUNK;
        chunks.par_iter().zip(&mut *pulls).for_each(|(chunk, into)| {
            let hood = Hood { lines, chunk, space };
            dispatch_in(lines.precision, PullsPass { hood, medium, coupling, into });
        });
        blocks.par_iter_mut().for_each(|block| {
            let SensitivityBlock { packed: sensitivity, density, .. } = block;
            let chunks = density[first..].par_chunks_mut(CHUNK).zip(&*pulls).zip(chunks);
            chunks.for_each(|((density, pulls), chunk)| {
                dispatch(DensityTangent { pulls, first: chunk.first, sensitivity, density });
            });
        });
    }
    let (mut packed, mut columns) = (Vec::new(), Vec::new());
    for block in blocks {
        let SensitivityBlock { packed: lines, density, directions, weights, .. } = block;
        packed.push(&mut lines[..]);
        columns.push(StressColumns { density, directions, weights });
    }
    let chunks = side_by_side(packed).into_par_iter().zip(cloud.particles().par_chunks(CHUNK));
    let chunks = chunks.zip(stress_slopes.par_chunks_mut(CHUNK)).enumerate();
    chunks.for_each(|(chunk, ((lines, particles), slopes))| {
        rooms.enter(model.network(), |room| {
            let (first, columns, into) = (chunk * CHUNK, &columns[..], (lines, slopes));
            StressTangent { model, first, columns, particles, into, room }.run();
        });
    });
}

/// One block of parameters, as the stress sees it.
struct StressColumns<'a> {
    /// `δρ` per slot.
    density: &'a [Lanes],
    /// `∂(c, α, β, γ, θ)/∂(the eight learned parameters)`.
    directions: &'a [Lanes; Parameter::COUNT],
    /// `(lane, place in the network)` of the weights among the eight.
    weights: &'a [(usize, usize)],
}

/// `δAᵢ = ∂A/∂ρ δρᵢ + ∂A/∂θ` of some particles and all blocks of parameters: the stress is
/// differentiated once for all of them.
struct StressTangent<'a, 'b, const D: usize> {
    model: &'a dyn Model<D>,
    /// Slot of the first particle.
    first: usize,
    columns: &'a [StressColumns<'a>],
    particles: &'a [Packed],
    into: (Vec<&'b mut [PackedSensitivity<D>]>, &'b mut [f64]),
    room: &'a mut Room,
}

impl<const D: usize> StressTangent<'_, '_, D> {
    fn run(self) {
        let Self { model, first, columns, particles, into: (mut blocks, slopes), room } = self;
        let some_weights = columns.iter().any(|block| !block.weights.is_empty());
        let with_weights = some_weights && model.has_stress_network();
        let rows = slopes.chunks_mut(WIDTH).zip(particles.chunks(WIDTH));
        for (number, (slopes, particles)) in rows.enumerate() {
            let rho = densities(particles);
            let stress = model.stress_slope(rho, room);
            if with_weights {
                model.stress_weights(rho, room);
            }
            for (lane, slope) in slopes.iter_mut().enumerate() {
                *slope = stress.by_density.lane(lane);
            }
            let by_weight = with_weights.then_some(&room.weights[..]);
            for (lines, columns) in blocks.iter_mut().zip(columns) {
                let lines = &mut lines[number * WIDTH..][..slopes.len()];
                let density = &columns.density[first + number * WIDTH..];
                dispatch(Fill { columns, density, lines, stress: &stress, by_weight });
            }
        }
    }
}

/// `δρ` and `δA` of up to eight particles for one block of parameters.
struct Fill<'a, const D: usize> {
    columns: &'a StressColumns<'a>,
    density: &'a [Lanes],
    lines: &'a mut [PackedSensitivity<D>],
    stress: &'a StressSlope,
    by_weight: Option<&'a [Lanes]>,
}

impl<const D: usize> Pass for Fill<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(self) {
        let Self { columns, density, lines, stress, by_weight } = self;
        let mut direct = [Lanes::ZERO; WIDTH];
        if let Some(by_weight) = by_weight {
            for &(column, weight) in columns.weights {
                direct[column] = by_weight[weight];
            }
        }
        let direct = transposed::<W>(&direct);
        for (lane, (line, density)) in lines.iter_mut().zip(density).enumerate() {
            let mut change = W::Double::load(density) * stress.by_density.lane(lane);
            for (direction, slope) in columns.directions.iter().zip(&stress.by_parameter) {
                change += W::Double::load(direction) * slope.lane(lane);
            }
            line.density = *density;
            line.stress = (change + direct[lane]).store();
        }
    }
}

/// `∂L/∂rᵢ += Σⱼ m G rᵢⱼ (∂L/∂ρᵢ + ∂L/∂ρⱼ)` over one chunk of particles.
struct DensityPullback<'a, const D: usize> {
    hood: Hood<'a>,
    adjoint: &'a [PackedAdjoint],
    medium: &'a Medium<D>,
    position: &'a mut [Vector<f64, D>],
}

impl<const D: usize> Pass for DensityPullback<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(self) {
        let Hood { lines, chunk, space } = self.hood;
        let Medium { smoothing, mass, .. } = self.medium;
        for (k, position) in self.position.iter_mut().enumerate() {
            let slot = chunk.first + k;
            let own = self.adjoint[slot].density;
            let mut sum = Vector::<W::Double, D>::zero();
            let space = chunk.around(k, space);
            for slots in chunk.neighbours(k) {
                let r = separation::<W, D>(lines, slot, slots, space);
                let pull = smoothing.gradient(r.norm_squared().sqrt()) * *mass;
                let [.., density] = adjoints::<W>(self.adjoint, slots);
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

/// System: the pullback of [`sum_density`]: `∂L/∂A` and `∂L/∂ρ` become `∂L/∂r` and parameters.
pub fn sum_density_pullback<const D: usize>(
    neighbours: Res<Neighbours<D>>,
    (law, rooms): (Res<Law<D>>, Res<Rooms>),
    cloud: Res<Cloud<D>>,
    mut adjoint: ResMut<AdjointCloud<D>>,
) {
    let model = &*law.0;
    let weights = model.network().filter(|_| model.has_stress_network());
    let count = Parameter::COUNT + weights.map_or(0, |network| network.weights.len());
    adjoint.sum_parameters(count, |adjoint, sums| {
        let AdjointCloud { packed: lines, scalars, .. } = adjoint;
        let chunks = scalars.par_chunks(CHUNK).zip(cloud.particles().par_chunks(CHUNK));
        let chunks = chunks.zip(sums.par_chunks_mut(count));
        lines[..cloud.len()].par_chunks_mut(CHUNK).zip(chunks).for_each(|(lines, (rows, sums))| {
            rooms.enter(model.network(), |room| {
                room.clear();
                pull_stress_back(model, room, rows, lines);
                room.write_sums(sums);
            });
        });
    });
    let AdjointCloud { packed: lines, position, .. } = &mut *adjoint;
    pull_density_back(&neighbours, model.medium(), (cloud.lines(), lines), position);
}

/// System: in place of [`sum_density_pullback`] where the forces took the densities of an earlier
/// evaluation of the same positions, to which `∂L/∂A` and `∂L/∂ρ` are left.
pub fn carry_density_pullback<const D: usize>(
    cloud: Res<Cloud<D>>,
    mut adjoint: ResMut<AdjointCloud<D>>,
) {
    let AdjointCloud { scalars, carried, .. } = &mut *adjoint;
    carried.clear();
    carried.extend(cloud.slot_of_row.iter().map(|&slot| scalars[slot as usize]));
}

/// `(∂L/∂A, ∂L/∂ρ)` of some particles, and the particles.
type Rows<'a> = (&'a [(f64, f64)], &'a [Packed]);

/// `∂L/∂ρᵢ` of some particles, through their stress and besides; the room gets the sums over parameters.
fn pull_stress_back<const D: usize>(
    model: &dyn Model<D>,
    room: &mut Room,
    (scalars, particles): Rows<'_>,
    lines: &mut [PackedAdjoint],
) {
    let rows = lines.chunks_mut(WIDTH).zip(scalars.chunks(WIDTH)).zip(particles.chunks(WIDTH));
    for ((lines, scalars), particles) in rows {
        let mut by_density = Lanes::ZERO;
        if model.has_stress() {
            let mut stress = Lanes::ZERO;
            for (lane, scalar) in scalars.iter().enumerate() {
                stress.set_lane(lane, scalar.0);
            }
            by_density = model.stress_pullback(densities(particles), stress, room);
        }
        for (lane, (line, scalar)) in lines.iter_mut().zip(scalars).enumerate() {
            line.density = scalar.1 + by_density.lane(lane);
        }
    }
}

/// Adds to `∂L/∂r` what `∂L/∂ρ` makes of it, in cell order.
fn pull_density_back<const D: usize>(
    neighbours: &Neighbours<D>,
    medium: &Medium<D>,
    (lines, adjoint): (Lines<'_>, &[PackedAdjoint]),
    position: &mut [Vector<f64, D>],
) {
    let chunks = neighbours.chunks.par_iter().zip(position.par_chunks_mut(CHUNK));
    chunks.for_each(|(chunk, position)| {
        let hood = Hood { lines, chunk, space: neighbours.space };
        dispatch_in(lines.precision, DensityPullback { hood, adjoint, medium, position });
    });
}
