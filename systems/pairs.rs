//! Eight neighbours at once: how every pair loop reads the cloud.

use crate::models::Pair;
use crate::packed::Packed;
use crate::scalar::{Lanes, Scalar, WIDTH};
use crate::space::PeriodicBox;
use crate::vector::Vector;

/// One particle against eight neighbours.
#[derive(Clone, Copy, Debug)]
pub struct Batch<const D: usize> {
    /// `rᵢⱼ`, minimum image.
    pub separation: Vector<Lanes, D>,
    /// `vᵢⱼ`.
    pub velocity: Vector<Lanes, D>,
    /// What the pair law sees.
    pub pair: Pair<Lanes>,
    /// `Aᵢ + Aⱼ`.
    pub stresses: Lanes,
}

/// One number of each of eight particles.
#[inline(always)]
pub fn gather<P>(packed: &[P], slots: &[u32; WIDTH], field: impl Fn(&P) -> f64) -> Lanes {
    let mut lanes = [0.0; WIDTH];
    for (lane, &slot) in lanes.iter_mut().zip(slots) {
        *lane = field(&packed[slot as usize]);
    }
    Lanes::new(lanes)
}

/// `rᵢⱼ` of particle `here` and eight others.
#[inline(always)]
pub fn separation<const D: usize>(
    packed: &[Packed],
    here: &Packed,
    slots: &[u32; WIDTH],
    space: PeriodicBox,
) -> Vector<Lanes, D> {
    let mut r = Vector::zero();
    for axis in 0..D {
        r[axis] = Lanes::of(here.position[axis]) - gather(packed, slots, |p| p.position[axis]);
    }
    space.minimum_image(r)
}

impl<const D: usize> Batch<D> {
    /// Particle `here` against the particles in `slots`.
    #[inline(always)]
    pub fn read(
        packed: &[Packed],
        here: &Packed,
        slots: &[u32; WIDTH],
        space: PeriodicBox,
    ) -> Self {
        let separation = separation(packed, here, slots, space);
        let mut velocity = Vector::zero();
        for axis in 0..D {
            let there = gather(packed, slots, |p| p.velocity[axis]);
            velocity[axis] = Lanes::of(here.velocity[axis]) - there;
        }
        Self {
            separation,
            velocity,
            pair: Pair {
                r2: separation.norm_squared(),
                approach: velocity.dot(separation),
                rho_i: Lanes::of(here.density),
                rho_j: gather(packed, slots, |p| p.density),
            },
            stresses: gather(packed, slots, |p| p.stress) + here.stress,
        }
    }
}
