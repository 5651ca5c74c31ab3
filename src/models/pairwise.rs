//! The loops over pairs that every [`PairLaw`] shares: value, tangent, pullback.

use super::tangent::MOST_ROWS;
use super::{
    Kept, Learned, Medium, Model, PairCotangent, PairLaw, PairRows, PairShare, Passed, Room, Slope,
    Slopes, store_vector,
};
use crate::packed::PackedAdjoint;
use crate::pairs::{AHEAD, Batch, Hood, adjoints};
use crate::scalar::{Lanes, Pass, Scalar, WIDTH, Wide, dispatch_in};
use crate::vector::Vector;

impl<L: PairLaw<D>, const D: usize> Model<D> for L {
    fn boxed(&self) -> Box<dyn Model<D>> {
        Box::new(self.clone())
    }

    fn accelerations(&self, hood: Hood<'_>, room: &mut Room, out: &mut [Vector<f64, D>]) {
        dispatch_in(hood.lines.precision, ForcePass { law: self, hood, room, out });
    }

    fn slopes(&self, hood: Hood<'_>, kept: Kept<'_>, room: &mut Room, into: &mut Slopes) {
        dispatch_in(hood.lines.precision, SlopePass { law: self, hood, kept, room, into });
    }

    fn has_force_network(&self) -> bool {
        self.has_network()
    }

    fn weight_shares(&self, hood: Hood<'_>, first: usize, room: &mut Room, out: &mut [f64]) {
        dispatch_in(hood.lines.precision, WeightPass { law: self, hood, first, room, out });
    }

    fn passes_to_neighbours(&self) -> bool {
        !self.is_antisymmetric()
    }

    fn pull_back(
        &self,
        hood: Hood<'_>,
        forces: &[PackedAdjoint],
        room: &mut Room,
        into: Passed<'_, D>,
    ) {
        dispatch_in(hood.lines.precision, PullPass { law: self, hood, forces, room, into });
    }
}

/// `aᵢ = Σⱼ fᵢⱼ` over one chunk of particles.
struct ForcePass<'a, L, const D: usize> {
    law: &'a L,
    hood: Hood<'a>,
    room: &'a mut Room,
    out: &'a mut [Vector<f64, D>],
}

impl<L: PairLaw<D>, const D: usize> Pass for ForcePass<'_, L, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(self) {
        let Self { law, hood: Hood { lines, near, space }, room, out } = self;
        let all = W::lines(lines);
        for (k, acceleration) in out.iter_mut().enumerate() {
            near.fetch_ahead::<W>(k + AHEAD, all);
            let here = near.first + k;
            let mut sum = Vector::<W::Double, D>::zero();
            let space = near.around(k, space);
            for eight in near.neighbours(k) {
                let force = law.force(&Batch::<W, D>::read(lines, here, eight, space), room);
                sum += widen(force);
            }
            for axis in 0..D {
                acceleration[axis] = sum[axis].sum();
            }
        }
    }
}

/// Every component as doubles.
#[inline(always)]
fn widen<W: Wide, const D: usize>(vector: Vector<W, D>) -> Vector<W::Double, D> {
    let mut wide = Vector::zero();
    for axis in 0..D {
        wide[axis] = vector[axis].widen();
    }
    wide
}

/// The slopes of one chunk's pairs, found eight at a time, and their sums.
struct SlopePass<'a, L, const D: usize> {
    law: &'a L,
    hood: Hood<'a>,
    kept: Kept<'a>,
    room: &'a mut Room,
    into: &'a mut Slopes,
}

impl<L: PairLaw<D>, const D: usize> Pass for SlopePass<'_, L, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(self) {
        let Self { law, hood: Hood { lines, near, space }, kept, room, into } = self;
        into.clear(<L::Slope<W> as Slope<W, D>>::Rows::FORM);
        let Medium { smoothing, mass, .. } = law.medium();
        let mut pairs = [[Lanes::ZERO; MOST_ROWS]; WIDTH];
        for k in 0..near.len() {
            let (slot, space) = (near.first + k, near.around(k, space));
            for eight in near.neighbours(k) {
                let batch = Batch::<W, D>::read(lines, slot, eight, space);
                law.slope(&batch, room).write(&mut pairs);
                into.push::<<L::Slope<W> as Slope<W, D>>::Rows, D>(eight, lines.nobody(), &pairs);
            }
            let pull = |r: f64| smoothing.gradient(r) * *mass;
            into.close::<W::Double, <L::Slope<W> as Slope<W, D>>::Rows, D>(kept, pull);
        }
    }
}

/// `∂aᵢ/∂weights` of some particles of a chunk: the pullback of each component in turn.
struct WeightPass<'a, L, const D: usize> {
    law: &'a L,
    hood: Hood<'a>,
    first: usize,
    room: &'a mut Room,
    out: &'a mut [f64],
}

impl<L: PairLaw<D>, const D: usize> Pass for WeightPass<'_, L, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(self) {
        let Self { law, hood: Hood { lines, near, space }, first, room, out } = self;
        let count = law.network().map_or(0, |network: &Learned| network.weights.len());
        for (row, shares) in out.chunks_exact_mut(count.max(1)).enumerate() {
            let (k, axis) = (first + row / D, row % D);
            let mut component = Vector::<W, D>::zero();
            component[axis] = W::of(1.0);
            room.clear();
            let space = near.around(k, space);
            for eight in near.neighbours(k) {
                let batch = Batch::<W, D>::read(lines, near.first + k, eight, space);
                law.pullback(&batch, component, room);
            }
            for (share, lanes) in shares.iter_mut().zip(&room.weights) {
                *share = lanes.sum();
            }
        }
        room.clear();
    }
}

/// What one chunk of particles passes back through the pair forces.
struct PullPass<'a, L, const D: usize> {
    law: &'a L,
    hood: Hood<'a>,
    forces: &'a [PackedAdjoint],
    room: &'a mut Room,
    into: Passed<'a, D>,
}

impl<L: PairLaw<D>, const D: usize> Pass for PullPass<'_, L, D> {
    type Output = ();

    /// Where the two forces of a pair are opposite, its part of the loss is `(λᵢ − λⱼ)·fᵢⱼ`, from which
    /// each particle takes its own derivatives. Otherwise it is `λᵢ·fᵢⱼ`, of which the neighbour's
    /// derivatives are left for it to fetch.
    #[inline(always)]
    fn run<W: Wide>(self) {
        let Self { law, hood: Hood { lines, near, space }, forces, room, into } = self;
        // A copy of its own: numbers that nobody else can write stay in registers.
        let law = &law.clone();
        let both = law.is_antisymmetric();
        let mut parameters = [W::Double::of(0.0); 3];
        for k in 0..near.len() {
            let slot = near.first + k;
            let mut sum = PairCotangent::<W::Double, D>::zero();
            let space = near.around(k, space);
            for (number, eight) in near.neighbours(k).enumerate() {
                let batch = Batch::<W, D>::read(lines, slot, eight, space);
                let there = adjoints::<W>(forces, eight);
                let mut across = Vector::<W, D>::zero();
                for axis in 0..D {
                    let mut force = W::Double::of(forces[slot].force[axis]);
                    if both {
                        force -= there[axis];
                    }
                    across[axis] = W::narrow(force);
                }
                let passed = law.pullback(&batch, across, room);
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
            into.scalars[k].0 += sum.stress[0].sum();
            into.scalars[k].1 += sum.density[0].sum();
            for (total, own) in parameters.iter_mut().zip(sum.parameters) {
                *total += own;
            }
        }
        for (total, sum) in room.physical.iter_mut().zip(parameters) {
            *total += sum.store();
        }
        if both {
            // Every pair was met from both ends.
            for sum in room.physical.iter_mut().chain(&mut room.weights) {
                *sum = *sum * 0.5;
            }
        }
    }
}

/// Adds the part of a cotangent that belongs to particle `i`, and that of the parameters.
#[inline(always)]
fn add_own<W: Wide, const D: usize>(
    sum: &mut PairCotangent<W::Double, D>,
    passed: &PairCotangent<W, D>,
) {
    sum.separation += widen(passed.separation);
    sum.velocity += widen(passed.velocity);
    sum.stress[0] += passed.stress[0].widen();
    sum.density[0] += passed.density[0].widen();
    for (total, part) in sum.parameters.iter_mut().zip(passed.parameters) {
        *total += part.widen();
    }
}

/// Leaves the parts that belong to the eight particles `j`.
#[inline(always)]
fn leave_shares<W: Wide, const D: usize>(
    passed: &PairCotangent<W, D>,
    shares: &mut [PairShare<D>],
) {
    let (position, velocity) = (store_vector(&-passed.separation), store_vector(&-passed.velocity));
    let (stress, density) = (passed.stress[1].store(), passed.density[1].store());
    for (lane, share) in shares.iter_mut().enumerate() {
        for axis in 0..D {
            share.position[axis] = position[axis].lane(lane);
            share.velocity[axis] = velocity[axis].lane(lane);
        }
        (share.stress, share.density) = (stress.lane(lane), density.lane(lane));
    }
}
