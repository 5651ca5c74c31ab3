//! Forcing: deterministic energy injection and stochastic large-scale modes, appendix A.3, and the
//! stochastic forcing with a correlation time of Eswaran & Pope, [`ornstein_uhlenbeck`].
//!
//! Appendices are those of Woodward et al., arXiv:2110.13311 ("the paper"): see `docs/equations.md`.

pub mod ornstein_uhlenbeck;

use crate::packed::{Packed, PackedSensitivity};
use crate::reduce;
use crate::scalar::{F64x8, Scalar, SimdFloat, SimdTask, dispatch};
use crate::space::Space;
use crate::vector::Vector;
use crate::waves::direction;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// What `θ` means.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Power {
    /// `f = (θ/ke)(v − v̄)` with `ke` of the total velocity, as printed in the paper: injects `2θ`
    /// minus the share of the mean flow (default).
    #[default]
    Paper,
    /// `f = θ (v − v̄)/⟨|v − v̄|²⟩`: injects exactly `θ` per unit mass.
    Exact,
}

/// Deterministic forcing: accelerates every particle along its velocity relative to the mean, so
/// that the flow receives energy at a constant rate and no momentum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EnergyInjection {
    /// Mean velocity `v̄`.
    pub mean: [f64; 3],
    /// Origin of velocities in `energy`: zero ([`Power::Paper`]) or `v̄`.
    origin: [f64; 3],
    /// `E`: `ke = ½⟨|v|²⟩`, or `⟨|v − v̄|²⟩`.
    energy: f64,
    /// `∂E/∂⟨|v − origin|²⟩`: ½ or 1.
    share: f64,
    /// `θ/E`; zero in a flow at rest, which has no preferred direction.
    pub rate: f64,
    /// Power `θ`.
    pub theta: f64,
}

impl EnergyInjection {
    /// The law for a flow of particles with these velocities, `[x, y, z]` each.
    pub fn new<T: Sync>(
        theta: f64,
        power: Power,
        particles: &[T],
        velocity: impl Fn(&T) -> [f64; 3] + Sync,
    ) -> Self {
        let count = particles.len().max(1) as f64;
        let mean = sum_over(particles, &velocity).map(|sum| sum / count);
        let (origin, share) = match power {
            Power::Paper => ([0.0; 3], 0.5),
            Power::Exact => (mean, 1.0),
        };
        let squares = sum_over(particles, &|particle| {
            let v = velocity(particle);
            std::array::from_fn(|a| (v[a] - origin[a]) * (v[a] - origin[a]))
        });
        let energy = share * squares.iter().sum::<f64>() / count;
        let rate = if energy > 0.0 { theta / energy } else { 0.0 };
        Self { mean, origin, energy, share, rate, theta }
    }

    /// `f = (θ/E)(v − v̄)`.
    pub fn force<const D: usize>(&self, velocity: [f64; 3]) -> Vector<f64, D> {
        Vector(std::array::from_fn(|axis| (velocity[axis] - self.mean[axis]) * self.rate))
    }

    /// The change of the law with the velocities: from `Σ δv` and `Σ (v − origin)·δv` over all
    /// `count` particles, and `δθ`.
    pub fn tangent<const D: usize>(
        &self,
        count: usize,
        (sum, work): (Vector<F64x8, D>, F64x8),
        theta: F64x8,
    ) -> InjectionTangent<D> {
        let each = 1.0 / count as f64;
        let change = if self.energy > 0.0 {
            let energy = work * (2.0 * self.share * each);
            (theta - energy * (self.theta / self.energy)) / self.energy
        } else {
            F64x8::ZERO
        };
        InjectionTangent { mean: sum.map(|x| x * each), rate: change }
    }

    /// The pullback of the law from `∂L/∂f` (`adjoint`, in the order of `velocities`): adds each
    /// particle's `∂L/∂v` to `velocity`, and returns `∂L/∂θ`.
    pub fn pullback<const D: usize>(
        &self,
        velocities: impl Iterator<Item = [f64; 3]> + Clone,
        adjoint: impl Iterator<Item = [f64; 3]> + Clone,
        velocity: &mut [Vector<f64, D>],
    ) -> f64 {
        if self.energy <= 0.0 {
            return 0.0;
        }
        let each = 1.0 / velocity.len() as f64;
        let (mut mean, mut by_rate) = (Vector::<f64, D>::zero(), 0.0);
        for (v, a) in velocities.clone().zip(adjoint.clone()) {
            mean += Vector::from_3d(a) * each;
            by_rate += (0..D).map(|axis| a[axis] * (v[axis] - self.mean[axis])).sum::<f64>();
        }
        let by_energy = -by_rate * self.rate / self.energy * (2.0 * self.share * each);
        for ((v, a), out) in velocities.zip(adjoint).zip(velocity) {
            for axis in 0..D {
                out[axis] +=
                    self.rate * (a[axis] - mean[axis]) + by_energy * (v[axis] - self.origin[axis]);
            }
        }
        by_rate / self.energy
    }

    /// `Σ δv` and `Σ (v − origin)·δv` over some particles, for [`Self::tangent`].
    pub fn sums<const D: usize>(
        &self,
        particles: &[Packed],
        changes: &[PackedSensitivity<D>],
    ) -> (Vector<F64x8, D>, F64x8) {
        dispatch(Sums { law: self, particles, changes })
    }
}

/// [`EnergyInjection::sums`].
struct Sums<'a, const D: usize> {
    law: &'a EnergyInjection,
    particles: &'a [Packed],
    changes: &'a [PackedSensitivity<D>],
}

impl<const D: usize> SimdTask for Sums<'_, D> {
    type Output = (Vector<F64x8, D>, F64x8);

    #[inline(always)]
    fn run<W: SimdFloat>(self) -> Self::Output {
        let Self { law, particles, changes } = self;
        let (mut sum, mut work) = (Vector::<W::Double, D>::zero(), W::Double::of(0.0));
        for (particle, change) in particles.iter().zip(changes) {
            for axis in 0..D {
                let change = W::Double::load(&change.velocity[axis]);
                sum[axis] += change;
                work += change * (particle.velocity[axis] - law.origin[axis]);
            }
        }
        let mut stored = Vector([F64x8::ZERO; D]);
        for axis in 0..D {
            stored[axis] = sum[axis].store();
        }
        (stored, work.store())
    }
}

/// Number of particles, maximum, that are summed sequentially. It determines the bits of a sum, so
/// that it must not depend on the machine.
const SEQUENTIAL_SUM_LEN: usize = 4096;

/// Sums three numbers over particles.
fn sum_over<T: Sync>(particles: &[T], of: &(impl Fn(&T) -> [f64; 3] + Sync)) -> [f64; 3] {
    reduce::by_halving(particles, SEQUENTIAL_SUM_LEN, &|particles: &[T]| {
        let mut sum = [0.0; 3];
        for particle in particles {
            let part = of(particle);
            (0..3).for_each(|axis| sum[axis] += part[axis]);
        }
        sum
    })
}

/// The rank-one couplings of [`EnergyInjection`]: `δv̄` and `δ(θ/E)`.
#[derive(Clone, Copy, Debug)]
pub struct InjectionTangent<const D: usize> {
    /// `δv̄`.
    pub mean: Vector<F64x8, D>,
    /// `δ(θ/E)`.
    pub rate: F64x8,
}

impl<const D: usize> InjectionTangent<D> {
    /// Adds `δf = (θ/E)(δv − δv̄) + δ(θ/E)(v − v̄)` of some particles to `out`.
    pub fn add_force(
        &self,
        law: &EnergyInjection,
        (particles, changes): (&[Packed], &[PackedSensitivity<D>]),
        out: &mut [Vector<F64x8, D>],
    ) {
        dispatch(AddForce { tangent: self, law, particles, changes, out });
    }
}

/// [`InjectionTangent::add_force`].
struct AddForce<'a, const D: usize> {
    tangent: &'a InjectionTangent<D>,
    law: &'a EnergyInjection,
    particles: &'a [Packed],
    changes: &'a [PackedSensitivity<D>],
    out: &'a mut [Vector<F64x8, D>],
}

impl<const D: usize> SimdTask for AddForce<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Self { tangent, law, particles, changes, out } = self;
        let by_rate = W::Double::load(&tangent.rate);
        for ((particle, change), out) in particles.iter().zip(changes).zip(out) {
            for axis in 0..D {
                let apart =
                    W::Double::load(&change.velocity[axis]) - W::Double::load(&tangent.mean[axis]);
                let force = apart * law.rate + by_rate * (particle.velocity[axis] - law.mean[axis]);
                out[axis] = (W::Double::load(&out[axis]) + force).store();
            }
        }
    }
}

/// One wave of the stochastic forcing, `f = a cos(k·x + phase)` with `a ⟂ k`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mode {
    /// Wave vector.
    pub k: [f64; 3],
    /// Amplitude, perpendicular to `k`: the force is free of divergence.
    pub amplitude: [f64; 3],
    /// Phase.
    pub phase: f64,
}

impl Mode {
    /// `k·x + phase`.
    pub fn angle(&self, x: [f64; 3]) -> f64 {
        self.k[0] * x[0] + self.k[1] * x[1] + self.k[2] * x[2] + self.phase
    }
}

/// The modes `0 < |n| < 2.5` of a box, one of each pair `±n` (10 in 2D, 40 in 3D), of strength
/// `0.25 ((2.5 − |n|)/1.5)² |n|`, and with wave vectors `2π (n_x/L_x, n_y/L_y, …)`; in a box that is no cube
/// the last `|n|` is the length of `L_x` times that vector over 2π. Phases (and directions in 3D) depend on the `seed`
/// and on the number `interval` of the interval of time, not on the time step.
pub fn stochastic_modes(dimension: usize, space: Space, seed: u64, interval: u64) -> Vec<Mode> {
    let mut modes = Vec::new();
    draw_stochastic_modes((dimension, space), (seed, interval), &mut modes);
    modes
}

/// Replaces `modes` by [`stochastic_modes`], and reuses their memory.
pub(crate) fn draw_stochastic_modes(
    (dimension, space): (usize, Space),
    (seed, interval): (u64, u64),
    modes: &mut Vec<Mode>,
) {
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    generator.set_stream(interval);
    let depth: &[i32] = if dimension == 3 { &[-2, -1, 0, 1, 2] } else { &[0] };
    let plane = (-2..=2).flat_map(|x| (-2..=2).map(move |y| [x, y]));
    let lattice = plane.flat_map(|[x, y]| depth.iter().map(move |&z| [x, y, z]));
    let positive = |n: &[i32; 3]| n.iter().rev().find(|&&x| x != 0).is_some_and(|&x| x > 0);
    modes.clear();
    for n in lattice.filter(positive) {
        let across = direction(n, space);
        let n = n.map(f64::from);
        let size = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt();
        if size < 2.5 {
            let phase = TAU * generator.random::<f64>();
            let direction = perpendicular(across, dimension, TAU * generator.random::<f64>());
            let strength = 0.25 * ((2.5 - size) / 1.5).powi(2);
            modes.push(Mode {
                k: std::array::from_fn(|axis| n[axis] * TAU / space.side(axis)),
                amplitude: direction.map(|x| x * strength),
                phase,
            });
        }
    }
}

/// A vector of length `|n|` perpendicular to `n`: `(−n_y, n_x)` in 2D, rotated by `angle` around
/// `n` in 3D.
fn perpendicular(n: [f64; 3], dimension: usize, angle: f64) -> [f64; 3] {
    if dimension == 2 {
        return [-n[1], n[0], 0.0];
    }
    let n = glam::DVec3::from_array(n);
    let (u, w) = n.normalize().any_orthonormal_pair();
    ((u * angle.cos() + w * angle.sin()) * n.length()).to_array()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::Axis;

    #[test]
    fn there_are_10_modes_in_2d_and_40_in_3d_and_none_has_divergence() {
        for (dimension, count) in [(2, 10), (3, 40)] {
            let long = Space::new([3.0, 5.0, 2.0], [Axis::Periodic; 3]);
            let [modes, others] =
                [Space::cube(3.0), long].map(|space| stochastic_modes(dimension, space, 1, 5));
            assert_eq!([modes.len(), others.len()], [count; 2]);
            for mode in modes.into_iter().chain(others) {
                let along: f64 = (0..3).map(|axis| mode.k[axis] * mode.amplitude[axis]).sum();
                assert!(along.abs() < 1e-14);
            }
        }
    }

    #[test]
    fn the_same_seed_and_interval_draw_the_same_modes_and_others_do_not() {
        assert_eq!(
            stochastic_modes(3, Space::cube(1.0), 7, 2),
            stochastic_modes(3, Space::cube(1.0), 7, 2)
        );
        assert_ne!(
            stochastic_modes(3, Space::cube(1.0), 7, 2),
            stochastic_modes(3, Space::cube(1.0), 7, 3)
        );
        assert_ne!(
            stochastic_modes(3, Space::cube(1.0), 7, 2),
            stochastic_modes(3, Space::cube(1.0), 8, 2)
        );
    }

    #[test]
    fn exact_power_is_theta_and_the_papers_is_twice_theta_without_mean_flow() {
        let velocities = [[1.0, 0.5, 0.0], [-1.0, 0.25, 0.0], [0.0, -0.75, 0.0]];
        for (power, expected) in [(Power::Exact, 0.3), (Power::Paper, 0.6)] {
            let law = EnergyInjection::new(0.3, power, &velocities, |v| *v);
            let work = |v: [f64; 3]| law.force::<3>(v).dot(Vector(v));
            let power: f64 = velocities.into_iter().map(work).sum::<f64>() / 3.0;
            assert!((power - expected).abs() < 1e-15);
        }
    }

    #[test]
    fn a_flow_at_rest_is_not_forced() {
        let law = EnergyInjection::new(0.3, Power::Paper, &[[0.0; 3]; 4], |v| *v);
        assert_eq!(law.force::<3>([0.0; 3]), Vector([0.0; 3]));
    }
}
