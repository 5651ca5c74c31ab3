//! Mean kinetic energy of particles, `f = ½⟨|v|²⟩`.

use super::{Seen, StateAdjoint, Statistic, TrueState};
use crate::vector::Vector;

/// `½⟨|v|²⟩`.
#[derive(Clone, Copy, Debug)]
pub struct Energy;

fn mean(squares: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = squares.len() as f64;
    0.5 * squares.sum::<f64>() / count
}

impl<const D: usize> Statistic<D> for Energy {
    fn name(&self) -> &'static str {
        "energy"
    }

    fn of_truth(&self, truth: &TrueState<'_, D>) -> Vec<f64> {
        vec![mean(truth.state.velocities.iter().map(|v| v.norm_squared()))]
    }

    fn values(&self, seen: &Seen<'_, D>) -> Vec<f64> {
        // In the order of rows: the sum does not depend on the order of cells.
        let (particles, slots) = (seen.inputs.particles(), seen.neighbours.order().slots());
        let square = |&slot: &u32| {
            Vector::<f64, D>::from_3d(particles[slot as usize].velocity).norm_squared()
        };
        vec![mean(slots.iter().map(square))]
    }

    /// `∂f/∂vᵢ = vᵢ/N`.
    fn pull_back(&self, seen: &Seen<'_, D>, cotangents: &[f64]) -> StateAdjoint<D> {
        let particles = seen.inputs.particles();
        let mut adjoint = StateAdjoint::zero(particles.len());
        let share = cotangents.iter().sum::<f64>() / particles.len().max(1) as f64;
        for (slope, particle) in adjoint.velocity.iter_mut().zip(particles) {
            *slope = Vector::from_3d(particle.velocity) * share;
        }
        adjoint
    }
}
