//! The linearised pair force: applied to columns of parameters forwards, and transposed backwards.

use super::PairCoefficient;
use super::tangent::{CentralRows, EightPairs, GeneralRows, PairRows};
use crate::packed::PackedSensitivity;
use crate::pairs::Batch;
use crate::scalar::{F64x8, SimdFloat, WIDTH, transposed};
use crate::vector::Vector;
use std::marker::PhantomData;

/// One number for each of a law's first parameters, in registers: `[W; P]`.
pub trait Slots<W>: Copy + AsRef<[W]> + AsMut<[W]> {
    /// All zero.
    fn zero() -> Self;
}

impl<W: SimdFloat, const P: usize> Slots<W> for [W; P] {
    #[inline(always)]
    fn zero() -> Self {
        [W::of(0.0); P]
    }
}

/// The derivative of the forces of eight pairs by the states of their particles and by parameters.
pub trait Slope<W: SimdFloat, const D: usize> {
    /// How the derivative of each pair is stored.
    type Rows: PairRows<D>;
    /// One number for each of the law's first parameters.
    type ByParameter: Slots<W>;

    /// Writes the derivatives of the eight pairs, one after another.
    fn write(&self, pairs: &mut EightPairs);

    /// The part of `∂f/∂ρᵢ` and `∂f/∂Aᵢ` that is not stored in the rows; zero by default.
    #[inline(always)]
    fn by_own_scalars(&self) -> [Vector<W, D>; 2] {
        [Vector::zero(); 2]
    }

    /// Adds `∂f` by each of the law's first parameters to sums, `[parameter][axis]`.
    fn add_by_parameter(&self, sums: &mut [F64x8]);

    /// The transpose: from `∂L/∂fᵢⱼ` of eight pairs to derivatives by state and parameters.
    fn pullback(&self, force: Vector<W, D>) -> PairCotangent<W, D, Self::ByParameter>;
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
    pub p_over_rho2: W,
}

impl<W: SimdFloat, const D: usize> Change<W, D> {
    /// Zero.
    #[inline(always)]
    pub fn zero() -> Self {
        let (zero, none) = (W::of(0.0), Vector::zero());
        Self { position: none, velocity: none, density: zero, p_over_rho2: zero }
    }

    /// Loads them from memory.
    #[inline(always)]
    pub fn load(memory: &PackedSensitivity<D>) -> Self {
        Self {
            position: load_vector(&memory.position),
            velocity: load_vector(&memory.velocity),
            density: W::load(&memory.density),
            p_over_rho2: W::load(&memory.p_over_rho2),
        }
    }
}

/// `∂L/∂` of the states and parameters of eight pairs.
#[derive(Clone, Copy, Debug)]
pub struct PairCotangent<W, const D: usize, P = [W; 0]> {
    /// By `rᵢⱼ`.
    pub separation: Vector<W, D>,
    /// By `vᵢⱼ`.
    pub velocity: Vector<W, D>,
    /// By `Aᵢ` and `Aⱼ`.
    pub p_over_rho2: [W; 2],
    /// By `ρᵢ` and `ρⱼ`, at fixed `A`.
    pub density: [W; 2],
    /// By the law's first parameters, at fixed `A`.
    pub parameters: P,
}

impl<W: SimdFloat, P: Slots<W>, const D: usize> PairCotangent<W, D, P> {
    /// Zero.
    #[inline(always)]
    pub fn zero() -> Self {
        let zero = W::of(0.0);
        Self {
            separation: Vector::zero(),
            velocity: Vector::zero(),
            p_over_rho2: [zero; 2],
            density: [zero; 2],
            parameters: P::zero(),
        }
    }
}

/// The derivative of a central force `f = s rᵢⱼ`: `δf = s δrᵢⱼ + rᵢⱼ δs`, where `δs` is linear in
/// all changes.
#[derive(Clone, Copy, Debug)]
pub struct CentralSlope<W, const D: usize, P = [W; 0]> {
    /// `rᵢⱼ`.
    pub separation: Vector<W, D>,
    /// `s`.
    pub value: W,
    /// `∂s/∂rᵢⱼ`.
    pub by_separation: Vector<W, D>,
    /// `∂s/∂vᵢⱼ`.
    pub by_velocity: Vector<W, D>,
    /// `∂s/∂Aᵢ`, `∂s/∂Aⱼ`.
    pub by_p_over_rho2: [W; 2],
    /// `∂s/∂ρᵢ = ∂s/∂ρⱼ` at fixed `A`.
    pub by_density: W,
    /// `∂s` by the law's first parameters, at fixed `A`.
    pub by_parameter: P,
}

impl<W: SimdFloat, P: Slots<W>, const D: usize> CentralSlope<W, D, P> {
    /// From the gradient of a coefficient that depends on `r²` and `v·r`.
    #[inline(always)]
    pub fn new(pairs: &Batch<W, D>, s: &PairCoefficient<W, P>, by_p_over_rho2: [W; 2]) -> Self {
        let (r, v) = (pairs.separation, pairs.velocity);
        Self {
            separation: r,
            value: s.value,
            by_separation: r * s.by_separation + v * s.by_v_dot_r,
            by_velocity: r * s.by_v_dot_r,
            by_p_over_rho2,
            by_density: s.by_density,
            by_parameter: s.by_parameter,
        }
    }
}

/// Adds every component to sums in memory.
#[inline(always)]
pub(super) fn add_lanes<W: SimdFloat, const D: usize>(sums: &mut [F64x8], by: Vector<W, D>) {
    for (axis, sum) in sums.iter_mut().enumerate() {
        *sum = (W::Double::load(sum) + by[axis].widen()).store();
    }
}

/// Loads every component.
#[inline(always)]
pub(super) fn load_vector<W: SimdFloat, const D: usize>(stored: &Vector<F64x8, D>) -> Vector<W, D> {
    let mut vector = Vector::zero();
    for axis in 0..D {
        vector[axis] = W::load(&stored[axis]);
    }
    vector
}

/// Stores every component.
#[inline(always)]
pub(super) fn store_vector<W: SimdFloat, const D: usize>(
    vector: &Vector<W, D>,
) -> Vector<F64x8, D> {
    let mut stored = Vector([F64x8::ZERO; D]);
    for axis in 0..D {
        stored[axis] = vector[axis].store();
    }
    stored
}

impl<W: SimdFloat, P: Slots<W>, const D: usize> Slope<W, D> for CentralSlope<W, D, P> {
    type Rows = CentralRows;
    type ByParameter = P;

    #[inline(always)]
    fn write(&self, pairs: &mut EightPairs) {
        let (mut by_state, mut others) = ([F64x8::ZERO; WIDTH], [F64x8::ZERO; WIDTH]);
        for axis in 0..D {
            by_state[axis] = self.by_separation[axis].store();
            by_state[D + axis] = self.by_velocity[axis].store();
            others[axis] = self.separation[axis].store();
        }
        by_state[2 * D] = self.by_density.store();
        by_state[2 * D + 1] = self.by_p_over_rho2[0].store();
        others[D] = self.value.store();
        others[D + 1] = self.by_p_over_rho2[1].store();
        let (by_state, others) = (transposed::<W>(&by_state), transposed::<W>(&others));
        for (pair, (by_state, others)) in pairs.iter_mut().zip(by_state.iter().zip(others)) {
            (pair[0], pair[1]) = (by_state.store(), others.store());
        }
    }

    #[inline(always)]
    fn add_by_parameter(&self, sums: &mut [F64x8]) {
        for (sums, by) in sums.chunks_exact_mut(D).zip(self.by_parameter.as_ref()) {
            add_lanes(sums, self.separation * *by);
        }
    }

    #[inline(always)]
    fn pullback(&self, force: Vector<W, D>) -> PairCotangent<W, D, P> {
        let along = force.dot(self.separation);
        let [by_i, by_j] = self.by_p_over_rho2;
        let mut parameters = self.by_parameter;
        for by in parameters.as_mut() {
            *by = *by * along;
        }
        PairCotangent {
            separation: force * self.value + self.by_separation * along,
            velocity: self.by_velocity * along,
            p_over_rho2: [by_i * along, by_j * along],
            density: [self.by_density * along; 2],
            parameters,
        }
    }
}

/// The derivative of a force of any direction by the full state of its pair. Row `a` of a matrix is
/// the derivative of component `a`. With [`MatrixRows`](super::MatrixRows) in place of
/// [`GeneralRows`] the derivatives by density and `A` are left out.
#[derive(Clone, Copy, Debug)]
pub struct GeneralSlope<W, const D: usize, const P: usize = 0, R = GeneralRows> {
    /// `∂f/∂rᵢⱼ`.
    pub by_separation: [Vector<W, D>; D],
    /// `∂f/∂vᵢⱼ`.
    pub by_velocity: [Vector<W, D>; D],
    /// `∂f/∂ρᵢ` and `∂f/∂ρⱼ`, at fixed `A`.
    pub by_density: [Vector<W, D>; 2],
    /// `∂f/∂Aᵢ` and `∂f/∂Aⱼ`.
    pub by_p_over_rho2: [Vector<W, D>; 2],
    /// `∂f` by the law's first parameters.
    pub by_parameter: [Vector<W, D>; P],
    rows: PhantomData<R>,
}

impl<W: SimdFloat, R, const D: usize, const P: usize> GeneralSlope<W, D, P, R> {
    /// Zero.
    #[inline(always)]
    pub fn zero() -> Self {
        let none = Vector::zero();
        Self {
            by_separation: [none; D],
            by_velocity: [none; D],
            by_density: [none; 2],
            by_p_over_rho2: [none; 2],
            by_parameter: [none; P],
            rows: PhantomData,
        }
    }
}

impl<W: SimdFloat, R: PairRows<D>, const D: usize, const P: usize> Slope<W, D>
    for GeneralSlope<W, D, P, R>
{
    type Rows = R;
    type ByParameter = [W; P];

    #[inline(always)]
    fn write(&self, pairs: &mut EightPairs) {
        for a in 0..D {
            let mut columns = [F64x8::ZERO; WIDTH];
            for b in 0..D {
                columns[b] = self.by_separation[a][b].store();
                columns[D + b] = self.by_velocity[a][b].store();
            }
            columns[2 * D] = self.by_density[1][a].store();
            columns[2 * D + 1] = self.by_p_over_rho2[1][a].store();
            let rows = transposed::<W>(&columns);
            for (pair, row) in pairs.iter_mut().zip(rows) {
                pair[a] = row.store();
            }
        }
    }

    #[inline(always)]
    fn by_own_scalars(&self) -> [Vector<W, D>; 2] {
        [self.by_density[0], self.by_p_over_rho2[0]]
    }

    #[inline(always)]
    fn add_by_parameter(&self, sums: &mut [F64x8]) {
        for (sums, by) in sums.chunks_exact_mut(D).zip(self.by_parameter) {
            add_lanes(sums, by);
        }
    }

    #[inline(always)]
    fn pullback(&self, force: Vector<W, D>) -> PairCotangent<W, D, [W; P]> {
        let mut cotangent: PairCotangent<W, D, [W; P]> = PairCotangent::zero();
        for a in 0..D {
            cotangent.separation += self.by_separation[a] * force[a];
            cotangent.velocity += self.by_velocity[a] * force[a];
        }
        for end in 0..2 {
            cotangent.density[end] = self.by_density[end].dot(force);
            cotangent.p_over_rho2[end] = self.by_p_over_rho2[end].dot(force);
        }
        for (sum, by) in cotangent.parameters.iter_mut().zip(&self.by_parameter) {
            *sum = by.dot(force);
        }
        cotangent
    }
}
