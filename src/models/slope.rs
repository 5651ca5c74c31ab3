//! The linearised pair force: applied to columns of parameters forwards, transposed backwards.

use super::{Parameter, Strength};
use crate::packed::PackedSensitivity;
use crate::pairs::Batch;
use crate::scalar::{Lanes, Wide};
use crate::vector::Vector;

/// The derivative of the forces of eight pairs by the states of their particles.
pub trait Slope<W: Wide, const D: usize> {
    /// The same in memory, where one pair after another can be taken out.
    type Stored: StoredSlope<D>;

    /// Puts it there.
    fn store(&self) -> Self::Stored;

    /// The transpose: from `∂L/∂fᵢⱼ` of eight pairs to derivatives by what they depend on.
    fn pullback(&self, force: Vector<W, D>) -> PairCotangent<W, D>;
}

/// A [`Slope`] in memory.
pub trait StoredSlope<const D: usize> {
    /// Whether the pair in `lane` is known to add nothing, as one beyond the support.
    #[inline(always)]
    fn is_zero(&self, lane: usize) -> bool {
        let _ = lane;
        false
    }

    /// `δfᵢⱼ` of the pair in `lane` for eight parameters at once, from the changes of both particles
    /// and, at fixed stress, of the physical parameters.
    fn tangent<W: Wide>(
        &self,
        lane: usize,
        own: &Change<W, D>,
        other: &Change<W, D>,
        directions: &[W; Parameter::COUNT],
    ) -> Vector<W, D>;
}

/// The sensitivities of a particle to eight parameters, in registers.
#[derive(Clone, Copy, Debug)]
pub struct Change<W, const D: usize> {
    /// `δr`.
    pub position: Vector<W, D>,
    /// `δv`.
    pub velocity: Vector<W, D>,
    /// `δρ`.
    pub density: W,
    /// `δA`.
    pub stress: W,
}

impl<W: Wide, const D: usize> Change<W, D> {
    /// None.
    #[inline(always)]
    pub fn zero() -> Self {
        let (zero, none) = (W::of(0.0), Vector::zero());
        Self { position: none, velocity: none, density: zero, stress: zero }
    }

    /// From memory.
    #[inline(always)]
    pub fn load(memory: &PackedSensitivity<D>) -> Self {
        Self {
            position: load_vector(&memory.position),
            velocity: load_vector(&memory.velocity),
            density: W::load(&memory.density),
            stress: W::load(&memory.stress),
        }
    }
}

/// `∂L/∂` of what eight pairs depend on.
#[derive(Clone, Copy, Debug)]
pub struct PairCotangent<W, const D: usize> {
    /// By `rᵢⱼ`.
    pub separation: Vector<W, D>,
    /// By `vᵢⱼ`.
    pub velocity: Vector<W, D>,
    /// By `Aᵢ` and `Aⱼ`.
    pub stress: [W; 2],
    /// By `ρᵢ` and `ρⱼ`, at fixed stress.
    pub density: [W; 2],
    /// By `c`, `α` and `β`, at fixed stress.
    pub parameters: [W; 3],
}

impl<W: Wide, const D: usize> PairCotangent<W, D> {
    /// No dependence.
    #[inline(always)]
    pub fn zero() -> Self {
        let zero = W::of(0.0);
        Self {
            separation: Vector::zero(),
            velocity: Vector::zero(),
            stress: [zero; 2],
            density: [zero; 2],
            parameters: [zero; 3],
        }
    }
}

/// The slope of a central force `f = s rᵢⱼ`: `δf = s δrᵢⱼ + rᵢⱼ δs`, `δs` linear in everything.
#[derive(Clone, Copy, Debug)]
pub struct CentralSlope<W, const D: usize> {
    /// `rᵢⱼ`.
    pub separation: Vector<W, D>,
    /// `s`.
    pub value: W,
    /// `∂s/∂rᵢⱼ`.
    pub by_separation: Vector<W, D>,
    /// `∂s/∂vᵢⱼ`.
    pub by_velocity: Vector<W, D>,
    /// `∂s/∂Aᵢ`, `∂s/∂Aⱼ`.
    pub by_stress: [W; 2],
    /// `∂s/∂ρᵢ = ∂s/∂ρⱼ` at fixed stress.
    pub by_density: W,
    /// `∂s/∂(c, α, β)` at fixed stress.
    pub by_parameter: [W; 3],
}

impl<W: Wide, const D: usize> CentralSlope<W, D> {
    /// From the gradient of a strength that depends on `r²` and `v·r`.
    #[inline(always)]
    pub fn new(pairs: &Batch<W, D>, s: &Strength<W>, by_stress: [W; 2]) -> Self {
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

/// Every component from memory.
#[inline(always)]
pub(super) fn load_vector<W: Wide, const D: usize>(stored: &Vector<Lanes, D>) -> Vector<W, D> {
    let mut vector = Vector::zero();
    for axis in 0..D {
        vector[axis] = W::load(&stored[axis]);
    }
    vector
}

/// What eight parameters mean to the physical ones, from memory.
#[inline(always)]
pub(super) fn load_directions<W: Wide>(
    stored: &[Lanes; Parameter::COUNT],
) -> [W; Parameter::COUNT] {
    let mut directions = [W::of(0.0); Parameter::COUNT];
    for (direction, stored) in directions.iter_mut().zip(stored) {
        *direction = W::load(stored);
    }
    directions
}

/// Every component to memory.
#[inline(always)]
pub(super) fn store_vector<W: Wide, const D: usize>(vector: &Vector<W, D>) -> Vector<Lanes, D> {
    let mut stored = Vector([Lanes::ZERO; D]);
    for axis in 0..D {
        stored[axis] = vector[axis].store();
    }
    stored
}

impl<W: Wide, const D: usize> Slope<W, D> for CentralSlope<W, D> {
    type Stored = CentralSlope<Lanes, D>;

    #[inline(always)]
    fn store(&self) -> CentralSlope<Lanes, D> {
        let [by_i, by_j] = self.by_stress;
        let [by_c, by_alpha, by_beta] = self.by_parameter;
        CentralSlope {
            separation: store_vector(&self.separation),
            value: self.value.store(),
            by_separation: store_vector(&self.by_separation),
            by_velocity: store_vector(&self.by_velocity),
            by_stress: [by_i.store(), by_j.store()],
            by_density: self.by_density.store(),
            by_parameter: [by_c.store(), by_alpha.store(), by_beta.store()],
        }
    }

    #[inline(always)]
    fn pullback(&self, force: Vector<W, D>) -> PairCotangent<W, D> {
        let along = force.dot(self.separation);
        let [by_i, by_j] = self.by_stress;
        let [by_c, by_alpha, by_beta] = self.by_parameter;
        PairCotangent {
            separation: force * self.value + self.by_separation * along,
            velocity: self.by_velocity * along,
            stress: [by_i * along, by_j * along],
            density: [self.by_density * along; 2],
            parameters: [by_c * along, by_alpha * along, by_beta * along],
        }
    }
}

impl<const D: usize> StoredSlope<D> for CentralSlope<Lanes, D> {
    #[inline(always)]
    fn is_zero(&self, lane: usize) -> bool {
        if self.value.lane(lane) != 0.0 {
            return false;
        }
        let mut size = self.by_density.lane(lane).abs();
        for axis in 0..D {
            size += self.by_separation[axis].lane(lane).abs();
            size += self.by_velocity[axis].lane(lane).abs();
        }
        for by in self.by_stress.iter().chain(&self.by_parameter) {
            size += by.lane(lane).abs();
        }
        size == 0.0
    }

    #[inline(always)]
    fn tangent<W: Wide>(
        &self,
        lane: usize,
        own: &Change<W, D>,
        other: &Change<W, D>,
        directions: &[W; Parameter::COUNT],
    ) -> Vector<W, D> {
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
}

/// The slope of a force of any direction that depends on `rᵢⱼ` and `vᵢⱼ` alone; row `a` of a matrix is
/// the derivative of component `a`.
#[derive(Clone, Copy, Debug)]
pub struct MatrixSlope<W, const D: usize> {
    /// `∂f/∂rᵢⱼ`.
    pub by_separation: [Vector<W, D>; D],
    /// `∂f/∂vᵢⱼ`.
    pub by_velocity: [Vector<W, D>; D],
}

impl<W: Wide, const D: usize> MatrixSlope<W, D> {
    /// No dependence.
    #[inline(always)]
    pub fn zero() -> Self {
        Self { by_separation: [Vector::zero(); D], by_velocity: [Vector::zero(); D] }
    }
}

impl<W: Wide, const D: usize> Slope<W, D> for MatrixSlope<W, D> {
    type Stored = MatrixSlope<Lanes, D>;

    #[inline(always)]
    fn store(&self) -> MatrixSlope<Lanes, D> {
        let mut stored = MatrixSlope::zero();
        for a in 0..D {
            stored.by_separation[a] = store_vector(&self.by_separation[a]);
            stored.by_velocity[a] = store_vector(&self.by_velocity[a]);
        }
        stored
    }

    #[inline(always)]
    fn pullback(&self, force: Vector<W, D>) -> PairCotangent<W, D> {
        let mut cotangent = PairCotangent::zero();
        for a in 0..D {
            cotangent.separation += self.by_separation[a] * force[a];
            cotangent.velocity += self.by_velocity[a] * force[a];
        }
        cotangent
    }
}

impl<const D: usize> StoredSlope<D> for MatrixSlope<Lanes, D> {
    #[inline(always)]
    fn tangent<W: Wide>(
        &self,
        lane: usize,
        own: &Change<W, D>,
        other: &Change<W, D>,
        _: &[W; Parameter::COUNT],
    ) -> Vector<W, D> {
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
}
