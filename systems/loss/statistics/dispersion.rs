//! Pair dispersion, `f = ⟨|Δr(τ) − Δr(0)|²⟩` over pairs that began as neighbours (closer than 1.2 spacings).

use super::{Seen, StateAdjoint, Statistic, TrueState};
use crate::space::Space;
use crate::statistics::close_pairs;
use crate::vector::Vector;

/// Longest separation of a pair at the start, in spacings.
const CLOSE: f64 = 1.2;

/// `⟨|Δr(τ) − Δr(0)|²⟩`. A change of separation is taken by nearest images: it holds up to half a side.
#[derive(Clone, Copy, Debug)]
pub struct Dispersion;

/// Pairs of rows with the change of their separation.
fn changes<'a, const D: usize>(
    space: Space,
    first: &'a [Vector<f64, D>],
    now: impl Fn(usize) -> Vector<f64, D> + 'a,
) -> impl Iterator<Item = (usize, usize, Vector<f64, D>)> + 'a {
    let reach = CLOSE * space.spacing::<D>(first.len());
    close_pairs(first, space, reach).into_iter().map(move |(i, j)| {
        let change = (now(i) - now(j)) - (first[i] - first[j]);
        (i, j, space.minimum_image(change))
    })
}

fn mean_square<const D: usize>(
    changes: impl Iterator<Item = (usize, usize, Vector<f64, D>)>,
) -> f64 {
    let (sum, count) = changes.fold((0.0, 0.0), |(sum, count), (_, _, change)| {
        (sum + change.norm_squared(), count + 1.0)
    });
    if count > 0.0 { sum / count } else { 0.0 }
}

/// Positions of the prediction by row.
fn rows<'a, const D: usize>(seen: &Seen<'a, D>) -> impl Fn(usize) -> Vector<f64, D> + use<'a, D> {
    let (particles, slots) = (seen.inputs.particles(), seen.neighbours.order().slots());
    |row| Vector::from_3d(particles[slots[row] as usize].position)
}

impl<const D: usize> Statistic<D> for Dispersion {
    fn name(&self) -> &'static str {
        "dispersion"
    }

    fn of_truth(&self, truth: &TrueState<'_, D>) -> Vec<f64> {
        let now = |row: usize| truth.state.positions[row];
        vec![mean_square(changes(truth.mesh.space, &truth.first.positions, now))]
    }

    fn values(&self, seen: &Seen<'_, D>) -> Vec<f64> {
        let space = seen.neighbours.space;
        vec![mean_square(changes(space, &seen.observations.first.positions, rows(seen)))]
    }

    /// `∂f/∂rᵢ = 2/n Σ_pairs (Δr(τ) − Δr(0))`, with the opposite sign for the other particle of a pair.
    fn pull_back(&self, seen: &Seen<'_, D>, cotangents: &[f64]) -> StateAdjoint<D> {
        let space = seen.neighbours.space;
        let all: Vec<_> = changes(space, &seen.observations.first.positions, rows(seen)).collect();
        let mut adjoint = StateAdjoint::zero(seen.inputs.particles().len());
        let share = 2.0 * cotangents.iter().sum::<f64>() / all.len().max(1) as f64;
        let slots = seen.neighbours.order().slots();
        for (i, j, change) in all {
            adjoint.position[slots[i] as usize] += change * share;
            adjoint.position[slots[j] as usize] -= change * share;
        }
        adjoint
    }
}
