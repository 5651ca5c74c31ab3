//! Particles packed for the loops over pairs.

use crate::scalar::{F64x8, SimdFloat};
use crate::space::Space;
use crate::vector::Vector;

/// The inputs of a pair loop for one particle: one cache line.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Packed {
    /// Position, `z = 0` in 2D.
    pub position: [f64; 3],
    /// The velocity at which the force is evaluated.
    pub velocity: [f64; 3],
    /// Density `ρ`.
    pub density: f64,
    /// The model's function of density, `A = P/ρ²`.
    pub p_over_rho2: f64,
}

impl Packed {
    /// The sentinel that pads neighbour lists to a whole number of lanes. It is so far away that
    /// every kernel is exactly zero there, and near enough that no fourth power overflows.
    pub const SENTINEL: Self =
        Self { position: [1e50; 3], velocity: [0.0; 3], density: 1.0, p_over_rho2: 0.0 };
}

/// The inputs of a pair loop for one particle in single precision: half a cache line.
///
/// Coordinates are fixed-point numbers, in steps of `L·2⁻³²` of each axis (1.5e-9 in a box of 2π). A
/// difference of two coordinates wraps around as the box does, so that it is exactly the difference
/// of the nearest images.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub struct PackedSingle {
    /// Position, in steps.
    pub position: [i32; 3],
    /// Density `ρ`; negative in the sentinel.
    pub density: f32,
    /// The velocity at which the force is evaluated.
    pub velocity: [f32; 3],
    /// The model's function of density, `A = P/ρ²`.
    pub p_over_rho2: f32,
}

impl PackedSingle {
    /// Fixed-point steps along a side of the box.
    pub const STEPS: f64 = 4_294_967_296.0;

    /// The sentinel, as [`Packed::SENTINEL`]. No fixed-point position is far away, so that a negative
    /// density marks it.
    pub const SENTINEL: Self =
        Self { position: [0; 3], density: -1.0, velocity: [0.0; 3], p_over_rho2: 0.0 };

    /// A coordinate along an axis in fixed-point steps: modulo 2³², as the axis is modulo `L`.
    #[inline(always)]
    pub fn fixed_point(x: f64, axis: usize, space: Space) -> i32 {
        nearest(x * (Self::STEPS / space.side(axis)))
    }

    /// Rounds a particle.
    #[inline(always)]
    pub fn new(particle: &Packed, space: Space) -> Self {
        let mut single = Self {
            density: particle.density as f32,
            p_over_rho2: particle.p_over_rho2 as f32,
            ..Self::SENTINEL
        };
        for axis in 0..3 {
            single.position[axis] = Self::fixed_point(particle.position[axis], axis, space);
            single.velocity[axis] = particle.velocity[axis] as f32;
        }
        single
    }
}

/// The nearest whole number, ties to even, modulo 2³².
#[inline(always)]
pub(crate) fn nearest(x: f64) -> i32 {
    // Added to this number, `x` is rounded to a whole number in the low bits of the sum.
    const SHIFT: f64 = 6_755_399_441_055_744.0;
    (x + SHIFT).to_bits() as i32
}

/// The sensitivities of a particle for a pair loop: eight parameters per number.
#[derive(Clone, Copy, Debug)]
pub struct PackedSensitivity<const D: usize> {
    /// `δr`.
    pub position: Vector<F64x8, D>,
    /// `δv` of the velocity at which the force is evaluated.
    pub velocity: Vector<F64x8, D>,
    /// `δρ`.
    pub density: F64x8,
    /// `δA`.
    pub p_over_rho2: F64x8,
}

impl<const D: usize> PackedSensitivity<D> {
    /// No dependence on any parameter.
    pub const ZERO: Self = Self {
        position: Vector([F64x8::ZERO; D]),
        velocity: Vector([F64x8::ZERO; D]),
        density: F64x8::ZERO,
        p_over_rho2: F64x8::ZERO,
    };

    /// Prefetches all columns.
    #[inline(always)]
    pub fn fetch<W: SimdFloat>(&self) {
        W::fetch_columns(&self.position.0);
        W::fetch_columns(&self.velocity.0);
        W::fetch_columns(std::slice::from_ref(&self.density));
        W::fetch_columns(std::slice::from_ref(&self.p_over_rho2));
    }
}

/// What the adjoint of a force evaluation reads of a neighbour.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub struct PackedAdjoint {
    /// `∂L/∂F`, third component zero in 2D.
    pub force: [f64; 3],
    /// `∂L/∂ρ`.
    pub density: f64,
}

impl PackedAdjoint {
    /// No influence on the loss.
    pub const ZERO: Self = Self { force: [0.0; 3], density: 0.0 };
}
