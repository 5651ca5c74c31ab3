//! A neural ODE, Eq. (2): one network evaluated on a particle's nearest neighbours.
//!
//! Equation numbers are those of Woodward et al., arXiv:2110.13311 ("the paper"): see `docs/equations.md`.

use super::scales::Units;
use super::{
    Constitutive, ForceOutput, Form, TangentOptions, Learned, MatrixRows, Medium, Model, PairShare,
    PullbackOutput, Scratch, Scales, ForceJacobian, Window,
};
use crate::error::{Error, Result};
use crate::network::Network;
use crate::packed::PackedAdjoint;
use crate::pairs::Neighbourhood;
use crate::scalar::{F64x8, SimdTask, WIDTH, SimdFloat, dispatch};
use crate::vector::Vector;
use serde::{Deserialize, Serialize};

/// Options of [`Node`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Units in each hidden layer.
    pub height: usize,
    /// Number of neighbours that are inputs of the network, `m`.
    pub nearest: usize,
    /// Whether a neighbour's features fade towards `2h`, see [`Window`].
    pub window: bool,
    /// Sizes of inputs and outputs.
    pub scales: Scales,
}

impl Default for Options {
    /// Height 5 and 20 neighbours, as in the paper (653 parameters in 3D), with a smooth window.
    fn default() -> Self {
        Self { height: 5, nearest: 20, window: true, scales: Scales::default() }
    }
}

/// Eq. (2): `aᵢ = F NN(w rᵢⱼ/h, w vᵢⱼ/V for the m nearest j within 2h, by distance)`; inputs of
/// missing neighbours are zero.
///
/// `2dm → l → l → d`. It conserves no momentum and is not invariant under rotations. It is
/// continuous where a neighbour enters the support. Where two neighbours exchange ranks it jumps,
/// as does any network of an ordered list, and the gradient is that at fixed ranks.
#[derive(Clone, Debug)]
pub struct Node<const D: usize> {
    medium: Medium<D>,
    network: Learned,
    units: Units,
    nearest: usize,
    window: Window,
}

/// Index that marks a missing neighbour.
const MISSING: u32 = u32::MAX;

/// One neighbour of one particle: its features, and the factor on them.
#[derive(Clone, Copy, Debug)]
struct Feature<const D: usize> {
    separation: Vector<f64, D>,
    velocity: Vector<f64, D>,
    /// `w` and `2 ∂w/∂(r²)`.
    window: (f64, f64),
}

impl<const D: usize> Node<D> {
    /// The model of a fluid.
    ///
    /// # Errors
    /// [`Error::Input`] for a network without units or neighbours, or with more than 1000.
    pub fn new(medium: Medium<D>, options: &Options) -> Result<Self> {
        let nearest = options.nearest;
        if nearest > 1000 {
            let remedy = "take the neighbours within 2h, some 20 to 60";
            return Err(Error::input("nearest", "at most 1000 neighbours", nearest, remedy));
        }
        let network = Learned::new(Network::new(2 * D * nearest, options.height, D)?);
        let window = Window::new(medium.smoothing.h, options.window);
        Ok(Self { units: options.scales.units(&medium), medium, network, nearest, window })
    }

    /// The features of the neighbour at `place` in the lists, for the chunk's `k`-th particle.
    #[inline(always)]
    fn feature(&self, neighbourhood: Neighbourhood<'_>, k: usize, place: u32) -> Feature<D> {
        let here = &neighbourhood.lines.double[neighbourhood.near.first + k];
        let there = &neighbourhood.lines.double[neighbourhood.near.slot(place as usize)];
        let mut separation = Vector::<f64, D>::zero();
        let mut velocity = Vector::<f64, D>::zero();
        for axis in 0..D {
            separation[axis] = here.position[axis] - there.position[axis];
            velocity[axis] = here.velocity[axis] - there.velocity[axis];
        }
        let separation = neighbourhood.space.minimum_image(separation);
        Feature { separation, velocity, window: self.window.at(separation.norm_squared()) }
    }

    /// Finds the nearest neighbours of particle `k`, in order of distance, and writes them to row
    /// `lane` of `scratch.nearest`.
    #[inline(always)]
    fn find_nearest(&self, neighbourhood: Neighbourhood<'_>, (k, lane): (usize, usize), scratch: &mut Scratch) {
        let support2 = self.medium.smoothing.support() * self.medium.smoothing.support();
        let row = &mut scratch.nearest[lane * self.nearest..(lane + 1) * self.nearest];
        row.fill(MISSING);
        if k >= neighbourhood.near.len() {
            return;
        }
        scratch.candidates.clear();
        let batches = neighbourhood.near.range(k);
        for place in (batches.start * WIDTH) as u32..(batches.end * WIDTH) as u32 {
            let r2 = self.feature(neighbourhood, k, place).separation.norm_squared();
            if r2 < support2 {
                scratch.candidates.push((r2, place));
            }
        }
        // Equal distances keep the order of the list.
        scratch.candidates.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        for (place, &(_, candidate)) in row.iter_mut().zip(&scratch.candidates) {
            *place = candidate;
        }
    }

    /// `w r/h` and `w v/V`.
    #[inline(always)]
    fn inputs(&self, feature: &Feature<D>) -> [Vector<f64, D>; 2] {
        let (w, _) = feature.window;
        [
            feature.separation * (w / self.units.length),
            feature.velocity * (w / self.units.velocity),
        ]
    }

    /// Evaluates the network for the chunk's particles `first .. first + 8`.
    #[inline(always)]
    fn evaluate(&self, neighbourhood: Neighbourhood<'_>, first: usize, scratch: &mut Scratch) {
        scratch.nearest.resize(WIDTH * self.nearest, MISSING);
        for lane in 0..WIDTH {
            self.find_nearest(neighbourhood, (first + lane, lane), scratch);
            for rank in 0..self.nearest {
                let place = scratch.nearest[lane * self.nearest + rank];
                let [r, v] = match place {
                    MISSING => [Vector::zero(); 2],
                    _ => self.inputs(&self.feature(neighbourhood, first + lane, place)),
                };
                let row = &mut scratch.input[2 * D * rank..];
                for axis in 0..D {
                    row[axis].set_lane(lane, r[axis]);
                    row[D + axis].set_lane(lane, v[axis]);
                }
            }
        }
        self.network.value(scratch);
    }

    /// Derivatives by `rᵢⱼ` and `vᵢⱼ` from derivatives by a neighbour's `2d` inputs.
    #[inline(always)]
    fn through(&self, feature: &Feature<D>, by: [Vector<f64, D>; 2]) -> [Vector<f64, D>; 2] {
        let (w, by_r2) = feature.window;
        let by_r = by[0] * (1.0 / self.units.length);
        let by_v = by[1] * (1.0 / self.units.velocity);
        let through_window = by_r.dot(feature.separation) + by_v.dot(feature.velocity);
        [by_r * w + feature.separation * (through_window * by_r2), by_v * w]
    }

    /// The two vectors of a rank in one lane, out of numbers in the order of the inputs.
    #[inline(always)]
    fn pick(&self, from: &[F64x8], rank: usize, lane: usize) -> [Vector<f64, D>; 2] {
        let mut picked = [Vector::zero(); 2];
        for axis in 0..D {
            picked[0][axis] = from[2 * D * rank + axis].lane(lane);
            picked[1][axis] = from[2 * D * rank + D + axis].lane(lane);
        }
        picked
    }

    /// The derivative of the force by a neighbour's state, after `network.jacobian`.
    #[inline(always)]
    fn slope(
        &self,
        feature: &Feature<D>,
        (rank, lane): (usize, usize),
        scratch: &Scratch,
    ) -> [F64x8; D] {
        let inputs = 2 * D * self.nearest;
        let mut rows = [F64x8::ZERO; D];
        for (a, slopes) in rows.iter_mut().enumerate() {
            let row = &scratch.jacobian[a * inputs..(a + 1) * inputs];
            let [by_r, by_v] = self.through(feature, self.pick(row, rank, lane));
            for b in 0..D {
                slopes.set_lane(b, by_r[b] * self.units.force);
                slopes.set_lane(D + b, by_v[b] * self.units.force);
            }
        }
        rows
    }
}

impl<const D: usize> Constitutive<D> for Node<D> {
    medium_and_network!("node");

    fn sound_speed(&self, _: f64) -> f64 {
        0.0
    }
}

impl<const D: usize> Model<D> for Node<D> {
    fn boxed(&self) -> Box<dyn Model<D>> {
        Box::new(self.clone())
    }

    fn accelerations(&self, neighbourhood: Neighbourhood<'_>, scratch: &mut Scratch, out: ForceOutput<'_, D>) {
        dispatch(ForcePass { model: self, neighbourhood, scratch, out });
    }

    fn part_names(&self) -> &'static [&'static str] {
        &["network"]
    }

    fn part(&self, _: usize, neighbourhood: Neighbourhood<'_>, scratch: &mut Scratch, out: &mut [Vector<f64, D>]) {
        self.accelerations(neighbourhood, scratch, ForceOutput { accelerations: out, add: false });
    }

    fn slopes(
        &self,
        neighbourhood: Neighbourhood<'_>,
        kept: TangentOptions<'_>,
        scratch: &mut Scratch,
        into: &mut ForceJacobian,
    ) {
        dispatch(SlopePass { model: self, neighbourhood, kept, scratch, into });
    }

    fn has_force_network(&self) -> bool {
        true
    }

    fn weight_shares(&self, neighbourhood: Neighbourhood<'_>, first: usize, scratch: &mut Scratch, out: &mut [f64]) {
        dispatch(WeightPass { model: self, neighbourhood, first, scratch, out });
    }

    fn passes_to_neighbours(&self) -> bool {
        true
    }

    fn pull_back(
        &self,
        neighbourhood: Neighbourhood<'_>,
        forces: &[PackedAdjoint],
        scratch: &mut Scratch,
        into: PullbackOutput<'_, D>,
    ) {
        dispatch(PullPass { model: self, neighbourhood, forces, scratch, into });
    }
}

struct ForcePass<'a, const D: usize> {
    model: &'a Node<D>,
    neighbourhood: Neighbourhood<'a>,
    scratch: &'a mut Scratch,
    out: ForceOutput<'a, D>,
}

impl<const D: usize> SimdTask for ForcePass<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Self { model, neighbourhood, scratch, out } = self;
        let ForceOutput { accelerations, add } = out;
        for (group, accelerations) in accelerations.chunks_mut(WIDTH).enumerate() {
            model.evaluate(neighbourhood, group * WIDTH, scratch);
            for (lane, acceleration) in accelerations.iter_mut().enumerate() {
                for axis in 0..D {
                    let force = scratch.output[axis].lane(lane) * model.units.force;
                    acceleration[axis] = if add { acceleration[axis] + force } else { force };
                }
            }
        }
    }
}

struct SlopePass<'a, const D: usize> {
    model: &'a Node<D>,
    neighbourhood: Neighbourhood<'a>,
    kept: TangentOptions<'a>,
    scratch: &'a mut Scratch,
    into: &'a mut ForceJacobian,
}

impl<const D: usize> SimdTask for SlopePass<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Self { model, neighbourhood, kept, scratch, into } = self;
        into.clear(Form::Matrix);
        // The force does not depend on scalar parameters directly.
        let mut direct = std::mem::take(&mut scratch.direct);
        direct.clear();
        direct.resize(if kept.direct { D * (2 + model.scalars()) } else { 0 }, F64x8::ZERO);
        for first in (0..neighbourhood.near.len()).step_by(WIDTH) {
            model.evaluate(neighbourhood, first, scratch);
            model.network.jacobian(scratch);
            for lane in 0..(neighbourhood.near.len() - first).min(WIDTH) {
                let k = first + lane;
                for rank in 0..model.nearest {
                    let place = scratch.nearest[lane * model.nearest + rank];
                    if place == MISSING {
                        break;
                    }
                    let feature = model.feature(neighbourhood, k, place);
                    let rows = model.slope(&feature, (rank, lane), scratch);
                    into.push_one(neighbourhood.near.slot(place as usize) as u32, &rows);
                }
                into.close::<W, MatrixRows, D>(kept, &direct, |_| 0.0);
            }
        }
        scratch.direct = direct;
    }
}

struct WeightPass<'a, const D: usize> {
    model: &'a Node<D>,
    neighbourhood: Neighbourhood<'a>,
    first: usize,
    scratch: &'a mut Scratch,
    out: &'a mut [f64],
}

impl<const D: usize> SimdTask for WeightPass<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Self { model, neighbourhood, first, scratch, out } = self;
        let count = model.network.weights.len();
        for (group, shares) in out.chunks_mut(WIDTH * D * count).enumerate() {
            model.evaluate(neighbourhood, first + group * WIDTH, scratch);
            for axis in 0..D {
                model.network.weight_gradient(axis, scratch);
                for (lane, shares) in shares.chunks_exact_mut(D * count).enumerate() {
                    let shares = &mut shares[axis * count..(axis + 1) * count];
                    for (share, slope) in shares.iter_mut().zip(&scratch.weights) {
                        *share = slope.lane(lane) * model.units.force;
                    }
                }
            }
        }
        scratch.clear();
    }
}

struct PullPass<'a, const D: usize> {
    model: &'a Node<D>,
    neighbourhood: Neighbourhood<'a>,
    forces: &'a [PackedAdjoint],
    scratch: &'a mut Scratch,
    into: PullbackOutput<'a, D>,
}

impl<const D: usize> SimdTask for PullPass<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Self { model, neighbourhood, forces, scratch, into } = self;
        into.neighbours.fill(PairShare::ZERO);
        for first in (0..neighbourhood.near.len()).step_by(WIDTH) {
            model.evaluate(neighbourhood, first, scratch);
            let lanes = (neighbourhood.near.len() - first).min(WIDTH);
            for axis in 0..D {
                let mut force = F64x8::ZERO;
                for lane in 0..lanes {
                    let slot = neighbourhood.near.first + first + lane;
                    force.set_lane(lane, forces[slot].force[axis] * model.units.force);
                }
                scratch.output_cotangent[axis] = force;
            }
            model.network.pullback(scratch);
            for lane in 0..lanes {
                let k = first + lane;
                for rank in 0..model.nearest {
                    let place = scratch.nearest[lane * model.nearest + rank];
                    if place == MISSING {
                        break;
                    }
                    let feature = model.feature(neighbourhood, k, place);
                    let by = model.pick(&scratch.input_cotangent, rank, lane);
                    let [by_r, by_v] = model.through(&feature, by);
                    into.position[k] += by_r;
                    into.velocity[k] += by_v;
                    let share = &mut into.neighbours[place as usize];
                    (share.position, share.velocity) = (-by_r, -by_v);
                }
            }
        }
    }
}
