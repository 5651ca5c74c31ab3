//! Flatness of velocity increments, `F_a = ⟨x⁴⟩/⟨x²⟩²` with `x = δu_a − ⟨δu_a⟩`, `δu = v(τ) − v(0)`, for each component `a`:
//! 3 for a normal distribution, larger where large increments are frequent.

use super::{Seen, StateAdjoint, Statistic, TrueState};
use crate::vector::Vector;

/// The flatness of each component.
#[derive(Clone, Copy, Debug)]
pub struct Flatness;

/// Second, third and fourth central moment of one component, and its mean.
struct Central {
    mean: f64,
    second: f64,
    third: f64,
    fourth: f64,
}

impl Central {
    fn of<const D: usize>(increments: &[Vector<f64, D>], axis: usize) -> Self {
        let share = 1.0 / increments.len().max(1) as f64;
        let mean = share * increments.iter().map(|du| du[axis]).sum::<f64>();
        let power =
            |n: i32| share * increments.iter().map(|du| (du[axis] - mean).powi(n)).sum::<f64>();
        Self { mean, second: power(2), third: power(3), fourth: power(4) }
    }

    /// The flatness; zero without a spread.
    fn flatness(&self) -> f64 {
        if self.second > 0.0 { self.fourth / (self.second * self.second) } else { 0.0 }
    }

    /// `∂F/∂x` of a sample, without the factor `1/N`: `4(y³ − ⟨y³⟩)/⟨y²⟩² − 4 F y/⟨y²⟩` with `y = x − ⟨x⟩`.
    fn slope(&self, x: f64) -> f64 {
        let y = x - self.mean;
        let square = self.second * self.second;
        4.0 * (y.powi(3) - self.third) / square - 4.0 * self.flatness() * y / self.second
    }
}

fn flatnesses<const D: usize>(increments: &[Vector<f64, D>]) -> Vec<f64> {
    (0..D).map(|axis| Central::of(increments, axis).flatness()).collect()
}

/// `v(τ) − v(0)`, particle `k` in row `k`.
fn increments<const D: usize>(seen: &Seen<'_, D>) -> Vec<Vector<f64, D>> {
    let (particles, slots) = (seen.inputs.particles(), seen.neighbours.order().slots());
    let rows = slots.iter().zip(&seen.observations.first.velocities);
    let one = |(&slot, &start): (&u32, &Vector<f64, D>)| {
        Vector::from_3d(particles[slot as usize].velocity) - start
    };
    rows.map(one).collect()
}

impl<const D: usize> Statistic<D> for Flatness {
    fn name(&self) -> &'static str {
        "flatness"
    }

    fn of_truth(&self, truth: &TrueState<'_, D>) -> Vec<f64> {
        let pairs = truth.state.velocities.iter().zip(&truth.first.velocities);
        flatnesses(&pairs.map(|(&now, &start)| now - start).collect::<Vec<_>>())
    }

    fn values(&self, seen: &Seen<'_, D>) -> Vec<f64> {
        flatnesses(&increments(seen))
    }

    fn pull_back(&self, seen: &Seen<'_, D>, cotangents: &[f64]) -> StateAdjoint<D> {
        let increments = increments(seen);
        let mut adjoint = StateAdjoint::zero(increments.len());
        for (axis, cotangent) in cotangents.iter().enumerate() {
            let central = Central::of(&increments, axis);
            if *cotangent == 0.0 || central.second <= 0.0 {
                continue;
            }
            let share = cotangent / increments.len() as f64;
            for (du, &slot) in increments.iter().zip(seen.neighbours.order().slots()) {
                adjoint.velocity[slot as usize][axis] = share * central.slope(du[axis]);
            }
        }
        adjoint
    }
}
