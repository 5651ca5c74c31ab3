//! The trajectory loss `L_tr`: every particle compared with the same particle of the truth.

use super::{SquareSum, StateAdjoint};
use crate::packed::{Packed, PackedSensitivity};
use crate::space::Space;
use crate::vector::Vector;

/// One frame's share of `L_tr = (1/N) Σ_frames Σᵢ (|rᵢ − r̂ᵢ|² + |vᵢ − v̂ᵢ|²)`, with position
/// differences of nearest images.
///
/// Positions and velocities are summed separately, because their measurement errors differ. Errors
/// of positions are relative to the size of the box.
///
/// `truth` gives `(r̂, v̂)` of the particle in a slot of `packed`; `blocks` are the sensitivities
/// in the same order, empty in a run that learns nothing. Tested in `tests/gradients.rs`.
pub fn trajectory_loss<const D: usize>(
    packed: &[Packed],
    blocks: &[&[PackedSensitivity<D>]],
    truth: impl Fn(usize) -> (Vector<f64, D>, Vector<f64, D>),
    (space, weight): (Space, f64),
) -> [SquareSum; 2] {
    let [mut positions, mut velocities] = [(); 2].map(|()| SquareSum::new(blocks.len()));
    let weight = weight / packed.len().max(1) as f64;
    for (slot, particle) in packed.iter().enumerate() {
        let (r, v) = truth(slot);
        let position = space.minimum_image(Vector::from_3d(particle.position) - r);
        let velocity = Vector::from_3d(particle.velocity) - v;
        for axis in 0..D {
            positions.add(weight, position[axis], |b| blocks[b][slot].position[axis]);
            velocities.add(weight, velocity[axis], |b| blocks[b][slot].velocity[axis]);
        }
        velocities.size += weight * v.norm_squared();
    }
    let count = (D * packed.len()) as f64;
    (positions.count, velocities.count) = (count, count);
    let squares: f64 = space.sides::<D>().iter().map(|side| side * side).sum();
    positions.size = weight * packed.len() as f64 * squares;
    [positions, velocities]
}

/// The value of [`trajectory_loss`], and its derivative by each particle's state: `2w(r − r̂)` and
/// `2w(v − v̂)`, in the order of `packed`.
pub fn trajectory_adjoint<const D: usize>(
    packed: &[Packed],
    truth: impl Fn(usize) -> (Vector<f64, D>, Vector<f64, D>),
    (space, weight): (Space, f64),
) -> StateAdjoint<D> {
    let weight = weight / packed.len().max(1) as f64;
    let mut adjoint = StateAdjoint::zero(packed.len());
    for (slot, particle) in packed.iter().enumerate() {
        let (r, v) = truth(slot);
        let position = space.minimum_image(Vector::from_3d(particle.position) - r);
        let velocity = Vector::from_3d(particle.velocity) - v;
        adjoint.value += weight * (position.norm_squared() + velocity.norm_squared());
        adjoint.position[slot] = position * (2.0 * weight);
        adjoint.velocity[slot] = velocity * (2.0 * weight);
    }
    adjoint
}
