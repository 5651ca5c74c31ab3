//! The linearised pair force: applied to columns of parameters forwards, transposed backwards.

use super::{Parameter, Strength};
use crate::packed::PackedSensitivity;
use crate::pairs::Batch;
use crate::scalar::Lanes;
use crate::vector::Vector;

/// The derivative of the forces of eight pairs by the states of their particles.
pub trait Slope<const D: usize> {
    /// `δfᵢⱼ` of the pair in `lane` for eight parameters at once, from the changes of both particles
    /// and, at fixed stress, of the physical parameters.
    fn tangent(
        &self,
        lane: usize,
        own: &PackedSensitivity<D>,
        other: &PackedSensitivity<D>,
        directions: &[Lanes; Parameter::COUNT],
    ) -> Vector<Lanes, D>;

    /// The transpose: from `∂L/∂fᵢⱼ` of eight pairs to derivatives by what they depend on.
    fn pullback(&self, force: Vector<Lanes, D>) -> PairCotangent<D>;
}

/// `∂L/∂` of what eight pairs depend on.
#[derive(Clone, Copy, Debug)]
pub struct PairCotangent<const D: usize> {
    /// By `rᵢⱼ`.
    pub separation: Vector<Lanes, D>,
    /// By `vᵢⱼ`.
    pub velocity: Vector<Lanes, D>,
    /// By `Aᵢ` and `Aⱼ`.
    pub stress: [Lanes; 2],
    /// By `ρᵢ` and `ρⱼ`, at fixed stress.
    pub density: [Lanes; 2],
}

impl<const D: usize> PairCotangent<D> {
    /// No dependence.
    pub const ZERO: Self = Self {
        separation: Vector([Lanes::ZERO; D]),
        velocity: Vector([Lanes::ZERO; D]),
        stress: [Lanes::ZERO; 2],
        density: [Lanes::ZERO; 2],
    };
}

/// The slope of a central force `f = s rᵢⱼ`: `δf = s δrᵢⱼ + rᵢⱼ δs`, `δs` linear in everything.
#[derive(Clone, Copy, Debug)]
pub struct CentralSlope<const D: usize> {
    /// `rᵢⱼ`.
    pub separation: Vector<Lanes, D>,
    /// `s`.
    pub value: Lanes,
    /// `∂s/∂rᵢⱼ`.
    pub by_separation: Vector<Lanes, D>,
    /// `∂s/∂vᵢⱼ`.
    pub by_velocity: Vector<Lanes, D>,
    /// `∂s/∂Aᵢ`, `∂s/∂Aⱼ`.
    pub by_stress: [Lanes; 2],
    /// `∂s/∂ρᵢ = ∂s/∂ρⱼ` at fixed stress.
    pub by_density: Lanes,
    /// `∂s/∂(c, α, β)` at fixed stress.
    pub by_parameter: [Lanes; 3],
}

impl<const D: usize> CentralSlope<D> {
    /// From the gradient of a strength that depends on `r²` and `v·r`.
    #[inline(always)]
    pub fn new(pairs: &Batch<D>, s: &Strength<Lanes>, by_stress: [Lanes; 2]) -> Self {
        let (r, v) = (pairs.separation, pairs.velocity);
        Self {
            separation: r,
            value: s.value,
            by_separation: r * s.by_separation + v * s.by_approach,
            by_velocity: r * s.by_approach,
            by_stress,
            by_density: s.by_density,
            by_parameter: s.by_parameter,
        }
    }
}

impl<const D: usize> Slope<D> for CentralSlope<D> {
    #[inline(always)]
    fn tangent(
        &self,
        lane: usize,
        own: &PackedSensitivity<D>,
        other: &PackedSensitivity<D>,
        directions: &[Lanes; Parameter::COUNT],
    ) -> Vector<Lanes, D> {
        let apart = own.position - other.position;
        let moving = own.velocity - other.velocity;
        let mut ds = (own.density + other.density) * self.by_density.lane(lane);
        ds += own.stress * self.by_stress[0].lane(lane);
        ds += other.stress * self.by_stress[1].lane(lane);
        for axis in 0..D {
            ds += apart[axis] * self.by_separation[axis].lane(lane);
            ds += moving[axis] * self.by_velocity[axis].lane(lane);
        }
        for (direction, by) in directions.iter().zip(&self.by_parameter) {
            ds += *direction * by.lane(lane);
        }
        let mut force = apart;
        for axis in 0..D {
            force[axis] =
                apart[axis] * self.value.lane(lane) + ds * self.separation[axis].lane(lane);
        }
        force
    }

    #[inline(always)]
    fn pullback(&self, force: Vector<Lanes, D>) -> PairCotangent<D> {
        let along = force.dot(self.separation);
        PairCotangent {
            separation: force * self.value + self.by_separation * along,
            velocity: self.by_velocity * along,
            stress: [self.by_stress[0] * along, self.by_stress[1] * along],
            density: [self.by_density * along; 2],
        }
    }
}

/// The slope of a force of any direction that depends on `rᵢⱼ` and `vᵢⱼ` alone; row `a` of a matrix is
/// the derivative of component `a`.
#[derive(Clone, Copy, Debug)]
pub struct MatrixSlope<const D: usize> {
    /// `∂f/∂rᵢⱼ`.
    pub by_separation: [Vector<Lanes, D>; D],
    /// `∂f/∂vᵢⱼ`.
    pub by_velocity: [Vector<Lanes, D>; D],
}

impl<const D: usize> MatrixSlope<D> {
    /// No dependence.
    pub const ZERO: Self = Self {
        by_separation: [Vector([Lanes::ZERO; D]); D],
        by_velocity: [Vector([Lanes::ZERO; D]); D],
    };
}

impl<const D: usize> Slope<D> for MatrixSlope<D> {
    #[inline(always)]
    fn tangent(
        &self,
        lane: usize,
        own: &PackedSensitivity<D>,
        other: &PackedSensitivity<D>,
        _: &[Lanes; Parameter::COUNT],
    ) -> Vector<Lanes, D> {
        let apart = own.position - other.position;
        let moving = own.velocity - other.velocity;
        let mut force = Vector::zero();
        for a in 0..D {
            for b in 0..D {
                force[a] += apart[b] * self.by_separation[a][b].lane(lane);
                force[a] += moving[b] * self.by_velocity[a][b].lane(lane);
            }
        }
        force
    }

    #[inline(always)]
    fn pullback(&self, force: Vector<Lanes, D>) -> PairCotangent<D> {
        let mut cotangent = PairCotangent::ZERO;
        for a in 0..D {
            cotangent.separation += self.by_separation[a] * force[a];
            cotangent.velocity += self.by_velocity[a] * force[a];
        }
        cotangent
    }
}
