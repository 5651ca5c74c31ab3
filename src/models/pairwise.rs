//! The loops over pairs of every [`PairLaw`]: value, tangent and pullback.

use super::tangent::MOST_ROWS;
use super::{
    ForceJacobian, ForceOutput, Form, Learned, Medium, Model, PairCotangent, PairLaw, PairRows,
    PairShare, PullbackOutput, Scratch, Slope, Slots, TangentOptions, slope::add_lanes,
    store_vector,
};
use crate::neighbours::chunk::Eight;
use crate::neighbours::near::Near;
use crate::packed::PackedAdjoint;
use crate::pairs::{AHEAD, Batch, Lines, Neighbourhood, adjoints};
use crate::scalar::{F64x8, Scalar, SimdFloat, SimdTask, WIDTH, dispatch_by_kernel};
use crate::space::Space;
use crate::vector::Vector;
use std::mem::ManuallyDrop;

impl<L: PairLaw<D>, const D: usize> Model<D> for L {
    fn boxed(&self) -> Box<dyn Model<D>> {
        Box::new(self.clone())
    }

    fn accelerations(
        &self,
        neighbourhood: Neighbourhood<'_>,
        scratch: &mut Scratch,
        out: ForceOutput<'_, D>,
    ) {
        run(self, neighbourhood, ForcePass { law: self, neighbourhood, scratch, out });
    }

    fn part_names(&self) -> &'static [&'static str] {
        L::PARTS
    }

    fn part(
        &self,
        part: usize,
        neighbourhood: Neighbourhood<'_>,
        scratch: &mut Scratch,
        out: &mut [Vector<f64, D>],
    ) {
        if const { L::PARTS.len() > 1 } {
            run(self, neighbourhood, PartPass { law: self, part, neighbourhood, scratch, out });
        } else {
            self.accelerations(
                neighbourhood,
                scratch,
                ForceOutput { accelerations: out, add: false },
            );
        }
    }

    fn slopes(
        &self,
        neighbourhood: Neighbourhood<'_>,
        kept: TangentOptions<'_>,
        scratch: &mut Scratch,
        into: &mut ForceJacobian,
    ) {
        run(self, neighbourhood, SlopePass { law: self, neighbourhood, kept, scratch, into });
    }

    fn has_force_network(&self) -> bool {
        L::HAS_NETWORK
    }

    fn weight_shares(
        &self,
        neighbourhood: Neighbourhood<'_>,
        first: usize,
        scratch: &mut Scratch,
        out: &mut [f64],
    ) {
        if const { L::HAS_NETWORK } {
            run(self, neighbourhood, WeightPass { law: self, neighbourhood, first, scratch, out });
        } else {
            out.fill(0.0);
        }
    }

    fn passes_to_neighbours(&self) -> bool {
        !self.is_antisymmetric()
    }

    fn pull_back(
        &self,
        neighbourhood: Neighbourhood<'_>,
        forces: &[PackedAdjoint],
        scratch: &mut Scratch,
        into: PullbackOutput<'_, D>,
    ) {
        run(self, neighbourhood, PullPass { law: self, neighbourhood, forces, scratch, into });
    }
}

/// Runs a pass over the pairs of a law.
fn run<L: PairLaw<D>, P: SimdTask, const D: usize>(
    law: &L,
    neighbourhood: Neighbourhood<'_>,
    pass: P,
) -> P::Output {
    dispatch_by_kernel(law.medium().smoothing.is_table(), neighbourhood.lines.precision, pass)
}

/// `aᵢ = Σⱼ fᵢⱼ` over one chunk of particles.
struct ForcePass<'a, L, const D: usize> {
    law: &'a L,
    neighbourhood: Neighbourhood<'a>,
    scratch: &'a mut Scratch,
    out: ForceOutput<'a, D>,
}

impl<L: PairLaw<D>, const D: usize> SimdTask for ForcePass<'_, L, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Self { law, neighbourhood: Neighbourhood { lines, near, space }, scratch, out } = self;
        let all = W::lines(lines);
        let ForceOutput { accelerations, add } = out;
        for (k, acceleration) in accelerations.iter_mut().enumerate() {
            near.fetch_ahead::<W>(k + AHEAD, all);
            let here = near.first + k;
            let mut sum = Vector::<W::Double, D>::zero();
            let space = near.around(k, space);
            for eight in near.neighbours(k) {
                let force = law.force(&Batch::<W, D>::read(lines, here, eight, space), scratch);
                sum += widen(force);
            }
            for axis in 0..D {
                let sum = sum[axis].sum();
                acceleration[axis] = if add { acceleration[axis] + sum } else { sum };
            }
        }
    }
}

/// One part of [`ForcePass`].
struct PartPass<'a, L, const D: usize> {
    law: &'a L,
    part: usize,
    neighbourhood: Neighbourhood<'a>,
    scratch: &'a mut Scratch,
    out: &'a mut [Vector<f64, D>],
}

impl<L: PairLaw<D>, const D: usize> SimdTask for PartPass<'_, L, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Self { law, part, neighbourhood: Neighbourhood { lines, near, space }, scratch, out } =
            self;
        for (k, acceleration) in out.iter_mut().enumerate() {
            let mut sum = Vector::<W::Double, D>::zero();
            let space = near.around(k, space);
            for eight in near.neighbours(k) {
                let batch = Batch::<W, D>::read(lines, near.first + k, eight, space);
                sum += widen(law.part_of_force(part, &batch, scratch));
            }
            *acceleration = sum.map(|sum| sum.sum());
        }
    }
}

/// Converts every component to `f64`.
#[inline(always)]
fn widen<W: SimdFloat, const D: usize>(vector: Vector<W, D>) -> Vector<W::Double, D> {
    let mut wide = Vector::zero();
    for axis in 0..D {
        wide[axis] = vector[axis].widen();
    }
    wide
}

/// Linearises a chunk's pairs, eight at a time, and sums them.
struct SlopePass<'a, L, const D: usize> {
    law: &'a L,
    neighbourhood: Neighbourhood<'a>,
    kept: TangentOptions<'a>,
    scratch: &'a mut Scratch,
    into: &'a mut ForceJacobian,
}

impl<L: PairLaw<D>, const D: usize> SimdTask for SlopePass<'_, L, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Self { law, neighbourhood: Neighbourhood { lines, near, space }, kept, scratch, into } =
            self;
        into.clear(<L::Slope<W> as Slope<W, D>>::Rows::FORM);
        let Medium { smoothing, mass, .. } = law.medium();
        let mut pairs = [[F64x8::ZERO; MOST_ROWS]; WIDTH];
        let mut direct = std::mem::take(&mut scratch.direct);
        let count = if kept.direct { 2 + law.scalars() } else { 2 };
        direct.resize(D * count, F64x8::ZERO);
        for k in 0..near.len() {
            let (slot, space) = (near.first + k, near.around(k, space));
            direct.fill(F64x8::ZERO);
            for eight in near.neighbours(k) {
                let batch = Batch::<W, D>::read(lines, slot, eight, space);
                let slope = law.slope(&batch, scratch);
                slope.write(&mut pairs);
                into.push::<<L::Slope<W> as Slope<W, D>>::Rows, D>(eight, lines.sentinel(), &pairs);
                add_direct::<W, L, D>((law, scratch), (&batch, &slope), &mut direct);
            }
            let pull = |r: f64| smoothing.dw_over_r(r) * *mass;
            into.close::<W::Double, <L::Slope<W> as Slope<W, D>>::Rows, D>(kept, &direct, pull);
        }
        scratch.direct = direct;
    }
}

/// Adds the derivatives of eight pairs that are not stored in rows: `[axis]` by `ρᵢ`, by `Aᵢ`, and
/// by each of the law's parameters if `sums` has room for them.
#[inline(always)]
fn add_direct<W: SimdFloat, L: PairLaw<D>, const D: usize>(
    (law, scratch): (&L, &mut Scratch),
    (batch, slope): (&Batch<W, D>, &L::Slope<W>),
    sums: &mut [F64x8],
) {
    let (scalars, parameters) = sums.split_at_mut(2 * D);
    if <L::Slope<W> as Slope<W, D>>::Rows::FORM == Form::General {
        for (sums, by) in scalars.chunks_exact_mut(D).zip(slope.by_own_scalars()) {
            add_lanes(sums, by);
        }
    }
    if parameters.is_empty() {
        return;
    }
    slope.add_by_parameter(parameters);
    if const { W::TABLES && L::HAS_KERNEL } {
        let first = parameters.len() / D - law.medium().kernel_scalars();
        for (parameter, sums) in parameters.chunks_exact_mut(D).skip(first).enumerate() {
            add_lanes(sums, law.by_kernel(batch, parameter, scratch));
        }
    }
}

/// `∂aᵢ/∂weights` of some particles of a chunk, by the pullback of one component after another.
struct WeightPass<'a, L, const D: usize> {
    law: &'a L,
    neighbourhood: Neighbourhood<'a>,
    first: usize,
    scratch: &'a mut Scratch,
    out: &'a mut [f64],
}

impl<L: PairLaw<D>, const D: usize> SimdTask for WeightPass<'_, L, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Self { law, neighbourhood: Neighbourhood { lines, near, space }, first, scratch, out } =
            self;
        let count = law.network().map_or(0, |network: &Learned| network.weights.len());
        for (row, shares) in out.chunks_exact_mut(count.max(1)).enumerate() {
            let (k, axis) = (first + row / D, row % D);
            let mut component = Vector::<W, D>::zero();
            component[axis] = W::of(1.0);
            scratch.clear();
            let space = near.around(k, space);
            for eight in near.neighbours(k) {
                let batch = Batch::<W, D>::read(lines, near.first + k, eight, space);
                law.pullback(&batch, component, scratch);
            }
            for (share, lanes) in shares.iter_mut().zip(&scratch.weights) {
                *share = lanes.sum();
            }
        }
        scratch.clear();
    }
}

/// The pullback of the pair forces of one chunk of particles.
struct PullPass<'a, L, const D: usize> {
    law: &'a L,
    neighbourhood: Neighbourhood<'a>,
    forces: &'a [PackedAdjoint],
    scratch: &'a mut Scratch,
    into: PullbackOutput<'a, D>,
}

impl<L: PairLaw<D>, const D: usize> SimdTask for PullPass<'_, L, D> {
    type Output = ();

    /// Where the two forces of a pair are opposite, the pair's part of the loss is `(λᵢ − λⱼ)·fᵢⱼ`,
    /// and each particle takes the derivatives by its own state. Otherwise it is `λᵢ·fᵢⱼ`, and the
    /// derivatives by the neighbour's state are written to `into.neighbours`.
    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Self {
            law,
            neighbourhood: Neighbourhood { lines, near, space },
            forces,
            scratch,
            into,
        } = self;
        // A local copy stays in registers as long as its address is not taken; dropping it would
        // take the address.
        let copy = ManuallyDrop::new(law.clone());
        let law: &L = &copy;
        let both = law.is_antisymmetric();
        let mut parameters = <L::ByParameter<W::Double> as Slots<W::Double>>::zero();
        for k in 0..near.len() {
            let slot = near.first + k;
            let mut sum = PairCotangent::<W::Double, D, L::ByParameter<W::Double>>::zero();
            let space = near.around(k, space);
            for (number, eight) in near.neighbours(k).enumerate() {
                let batch = Batch::<W, D>::read(lines, slot, eight, space);
                let across = across::<W, D>(forces, (slot, eight), both);
                let passed = law.pullback(&batch, across, scratch);
                add_own(&mut sum, &passed);
                if !both {
                    let first = (near.range(k).start + number) * WIDTH;
                    leave_shares(&passed, &mut into.neighbours[first..first + WIDTH]);
                }
            }
            for axis in 0..D {
                into.position[k][axis] += sum.separation[axis].sum();
                into.velocity[k][axis] += sum.velocity[axis].sum();
            }
            into.scalars[k].0 += sum.p_over_rho2[0].sum();
            into.scalars[k].1 += sum.density[0].sum();
            for (total, own) in parameters.as_mut().iter_mut().zip(sum.parameters.as_ref()) {
                *total += *own;
            }
        }
        for (total, sum) in scratch.scalars.iter_mut().zip(parameters.as_ref()) {
            *total += sum.store();
        }
        if const { W::TABLES && L::HAS_KERNEL } {
            pull_to_kernel::<W, L, D>((law, scratch), (lines, near, space), forces);
        }
        if W::TABLES || !L::IS_NUMBERS {
            drop(ManuallyDrop::into_inner(copy));
        }
        if both {
            // Every pair was evaluated from both particles.
            for sum in scratch.scalars.iter_mut().chain(&mut scratch.weights) {
                *sum = *sum * 0.5;
            }
        }
    }
}

/// The cotangent of eight pair forces: `λᵢ − λⱼ` where forces are opposite, otherwise `λᵢ`.
#[inline(always)]
fn across<W: SimdFloat, const D: usize>(
    forces: &[PackedAdjoint],
    (slot, eight): (usize, Eight<'_, u32>),
    both: bool,
) -> Vector<W, D> {
    let there = adjoints::<W>(forces, eight);
    let mut across = Vector::zero();
    for axis in 0..D {
        let mut force = W::Double::of(forces[slot].force[axis]);
        if both {
            force -= there[axis];
        }
        across[axis] = W::narrow(force);
    }
    across
}

/// The derivatives by the kernel's parameters, which are the last of a law's scalars. They have a
/// loop of their own, because few flows learn them.
#[inline(always)]
fn pull_to_kernel<W: SimdFloat, L: PairLaw<D>, const D: usize>(
    (law, scratch): (&L, &mut Scratch),
    (lines, near, space): (Lines<'_>, &Near, Space),
    forces: &[PackedAdjoint],
) {
    let count = law.medium().kernel_scalars();
    let first = law.scalars() - count;
    if count == 0 {
        return;
    }
    for k in 0..near.len() {
        let (slot, space) = (near.first + k, near.around(k, space));
        for eight in near.neighbours(k) {
            let batch = Batch::<W, D>::read(lines, slot, eight, space);
            let across = across::<W, D>(forces, (slot, eight), law.is_antisymmetric());
            for parameter in 0..count {
                let by = law.by_kernel(&batch, parameter, scratch);
                let sum = &mut scratch.scalars[first + parameter];
                *sum = (W::Double::load(sum) + by.dot(across).widen()).store();
            }
        }
    }
}

/// Adds the part of a cotangent that belongs to particle `i`, and the derivatives by the
/// parameters.
#[inline(always)]
fn add_own<W: SimdFloat, P: Slots<W>, Q: Slots<W::Double>, const D: usize>(
    sum: &mut PairCotangent<W::Double, D, Q>,
    passed: &PairCotangent<W, D, P>,
) {
    sum.separation += widen(passed.separation);
    sum.velocity += widen(passed.velocity);
    sum.p_over_rho2[0] += passed.p_over_rho2[0].widen();
    sum.density[0] += passed.density[0].widen();
    let parts = passed.parameters.as_ref();
    for (total, part) in sum.parameters.as_mut().iter_mut().zip(parts) {
        *total += part.widen();
    }
}

/// Writes the parts that belong to the eight particles `j`.
#[inline(always)]
fn leave_shares<W: SimdFloat, P, const D: usize>(
    passed: &PairCotangent<W, D, P>,
    shares: &mut [PairShare<D>],
) {
    let (position, velocity) = (store_vector(&-passed.separation), store_vector(&-passed.velocity));
    let (p_over_rho2, density) = (passed.p_over_rho2[1].store(), passed.density[1].store());
    for (lane, share) in shares.iter_mut().enumerate() {
        for axis in 0..D {
            share.position[axis] = position[axis].lane(lane);
            share.velocity[axis] = velocity[axis].lane(lane);
        }
        (share.p_over_rho2, share.density) = (p_over_rho2.lane(lane), density.lane(lane));
    }
}
