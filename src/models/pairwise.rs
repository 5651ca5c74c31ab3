//! The loops over pairs that every [`PairLaw`] shares: value, tangent, pullback.

use super::{Columns, Learned, Model, PairCotangent, PairLaw, PairShare, Passed, Room, Slope};
use crate::packed::{PackedAdjoint, PackedSensitivity};
use crate::pairs::{Batch, Hood, gather};
use crate::scalar::{Lanes, Scalar};
use crate::sensitivity::Coupling;
use crate::vector::Vector;
use pulp::{Arch, NullaryFnOnce};

impl<L: PairLaw<D>, const D: usize> Model<D> for L {
    fn boxed(&self) -> Box<dyn Model<D>> {
        Box::new(self.clone())
    }

    fn accelerations(&self, hood: Hood<'_>, room: &mut Room, out: &mut [Vector<f64, D>]) {
        Arch::new().dispatch(ForcePass { law: self, hood, room, out });
    }

    fn tangents(
        &self,
        hood: Hood<'_>,
        columns: Columns<'_, D>,
        room: &mut Room,
        out: &mut [Vector<Lanes, D>],
    ) {
        Arch::new().dispatch(TangentPass { law: self, hood, columns, room, out });
    }

    fn has_force_network(&self) -> bool {
        self.has_network()
    }

    fn weight_shares(&self, hood: Hood<'_>, room: &mut Room, out: &mut [f64]) {
        Arch::new().dispatch(WeightPass { law: self, hood, room, out });
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
        Arch::new().dispatch(PullPass { law: self, hood, forces, room, into });
    }
}

/// `aᵢ = Σⱼ fᵢⱼ` over one chunk of particles.
struct ForcePass<'a, L, const D: usize> {
    law: &'a L,
    hood: Hood<'a>,
    room: &'a mut Room,
    out: &'a mut [Vector<f64, D>],
}

impl<L: PairLaw<D>, const D: usize> NullaryFnOnce for ForcePass<'_, L, D> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { law, hood: Hood { packed, chunk, space }, room, out } = self;
        for (k, acceleration) in out.iter_mut().enumerate() {
            let here = &packed[chunk.first + k];
            let mut sum = Vector::<Lanes, D>::zero();
            for slots in chunk.neighbours(k) {
                sum += law.force(&Batch::<D>::read(packed, here, slots, space), room);
            }
            for axis in 0..D {
                acceleration[axis] = sum[axis].sum();
            }
        }
    }
}

/// `δaᵢ = Σⱼ δfᵢⱼ` over one chunk of particles and one block of parameters: the slope is found for
/// eight pairs at once, then serves the eight parameters of each pair at once.
struct TangentPass<'a, L, const D: usize> {
    law: &'a L,
    hood: Hood<'a>,
    columns: Columns<'a, D>,
    room: &'a mut Room,
    out: &'a mut [Vector<Lanes, D>],
}

impl<L: PairLaw<D>, const D: usize> NullaryFnOnce for TangentPass<'_, L, D> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { law, hood: Hood { packed, chunk, space }, columns, room, out } = self;
        for (k, acceleration) in out.iter_mut().enumerate() {
            let slot = chunk.first + k;
            let own = &columns.sensitivities[slot];
            let mut sum = *acceleration;
            for slots in chunk.neighbours(k) {
                let batch = Batch::<D>::read(packed, &packed[slot], slots, space);
                let slope = law.slope(&batch, room);
                for (lane, &j) in slots.iter().enumerate() {
                    let Some(other) = columns.sensitivities.get(j as usize) else { break };
                    sum += match columns.coupling {
                        Coupling::Full => slope.tangent(lane, own, other, columns.directions),
                        Coupling::Local => {
                            let by_density = columns.stress_slopes[j as usize];
                            let other = alone(law, &batch, lane, (own, other, by_density));
                            slope.tangent(lane, own, &other, columns.directions)
                        }
                    };
                }
            }
            *acceleration = sum;
        }
    }
}

/// A neighbour whose own sensitivities are dropped: of `δρⱼ` only what particle `i` itself gives
/// remains, of `δAⱼ` that and the explicit dependence on the parameters.
#[inline(always)]
fn alone<L: PairLaw<D>, const D: usize>(
    law: &L,
    batch: &Batch<D>,
    lane: usize,
    (own, other, by_density): (&PackedSensitivity<D>, &PackedSensitivity<D>, f64),
) -> PackedSensitivity<D> {
    let medium = law.medium();
    let pull = medium.smoothing.gradient(batch.pair.r2.lane(lane).sqrt()) * medium.mass;
    let mut given = Lanes::ZERO;
    for axis in 0..D {
        given += own.position[axis] * (batch.separation[axis].lane(lane) * pull);
    }
    let explicit = other.stress - other.density * by_density;
    PackedSensitivity {
        density: given,
        stress: explicit + given * by_density,
        ..PackedSensitivity::ZERO
    }
}

/// `∂aᵢ/∂weights` over one chunk: the pullback of each component in turn.
struct WeightPass<'a, L, const D: usize> {
    law: &'a L,
    hood: Hood<'a>,
    room: &'a mut Room,
    out: &'a mut [f64],
}

impl<L: PairLaw<D>, const D: usize> NullaryFnOnce for WeightPass<'_, L, D> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { law, hood: Hood { packed, chunk, space }, room, out } = self;
        let count = law.network().map_or(0, |network: &Learned| network.weights.len());
        for (row, shares) in out.chunks_exact_mut(count.max(1)).enumerate() {
            let (k, axis) = (row / D, row % D);
            let mut component = Vector::<Lanes, D>::zero();
            component[axis] = Lanes::of(1.0);
            room.clear();
            for slots in chunk.neighbours(k) {
                let here = &packed[chunk.first + k];
                law.pullback(&Batch::<D>::read(packed, here, slots, space), component, room);
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

impl<L: PairLaw<D>, const D: usize> NullaryFnOnce for PullPass<'_, L, D> {
    type Output = ();

    /// Where the two forces of a pair are opposite, its part of the loss is `(λᵢ − λⱼ)·fᵢⱼ`, from which
    /// each particle takes its own derivatives. Otherwise it is `λᵢ·fᵢⱼ`, of which the neighbour's
    /// derivatives are left for it to fetch.
    #[inline(always)]
    fn call(self) {
        let Self { law, hood: Hood { packed, chunk, space }, forces, room, into } = self;
        let both = law.is_antisymmetric();
        for k in 0..chunk.len() {
            let slot = chunk.first + k;
            let mut sum = PairCotangent::<D>::ZERO;
            for (number, slots) in chunk.neighbours(k).iter().enumerate() {
                let batch = Batch::<D>::read(packed, &packed[slot], slots, space);
                let mut across = Vector::<Lanes, D>::zero();
                for axis in 0..D {
                    across[axis] = Lanes::of(forces[slot].force[axis]);
                    if both {
                        across[axis] -= gather(forces, slots, |a| a.force[axis]);
                    }
                }
                let passed = law.pullback(&batch, across, room);
                sum.separation += passed.separation;
                sum.velocity += passed.velocity;
                sum.stress[0] += passed.stress[0];
                sum.density[0] += passed.density[0];
                if !both {
                    into.neighbours[chunk.first_batch(k) + number] = PairShare {
                        position: -passed.separation,
                        velocity: -passed.velocity,
                        stress: passed.stress[1],
                        density: passed.density[1],
                    };
                }
            }
            for axis in 0..D {
                into.position[k][axis] += sum.separation[axis].sum();
                into.velocity[k][axis] += sum.velocity[axis].sum();
            }
            into.scalars[k] = (sum.stress[0].sum(), sum.density[0].sum());
        }
        if both {
            // Every pair was met from both ends.
            for sum in room.physical.iter_mut().chain(&mut room.weights) {
                *sum = *sum * 0.5;
            }
        }
    }
}
