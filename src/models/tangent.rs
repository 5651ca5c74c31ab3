//! The tangent of the force: a chunk's pairs are linearised once, and then applied to one block of
//! parameters after another.
//!
//! `δaᵢ = Σⱼ δfᵢⱼ` is a block-sparse matrix times the changes of all particles. The diagonal block,
//! the derivative by particle `i`'s own state, is one [`OwnSlope`] per particle. The off-diagonal
//! blocks, the derivatives by a neighbour's state, are stored for each pair within `2h`.

use super::{Change, TangentOptions, load_vector, store_vector};
use crate::packed::PackedSensitivity;
use crate::pairs::Eight;
use crate::scalar::{F64x8, SimdFloat, SimdTask, WIDTH, dispatch};
use crate::sensitivity::Coupling;
use crate::vector::Vector;
use std::fmt::Debug;

/// Rows of a pair, maximum.
pub(super) const MOST_ROWS: usize = 3;

/// Eight pairs one after another, each stored in its first [`PairRows::ROWS`] rows.
pub type EightPairs = [[F64x8; MOST_ROWS]; WIDTH];

/// The storage of one pair's derivative, in rows of eight numbers.
pub trait PairRows<const D: usize>: Debug {
    /// The form.
    const FORM: Form;
    /// Rows per pair.
    const ROWS: usize;

    /// Adds a pair's derivative by the particle's own state to the diagonal block.
    fn add_own<W: SimdFloat>(rows: &[F64x8], own: &mut OwnSlope<W, D>);

    /// Adds the neighbour's part of `δfᵢⱼ`, for eight parameters at once.
    fn add_other<W: SimdFloat>(
        rows: &[F64x8],
        other: &PackedSensitivity<D>,
        sum: &mut Vector<W, D>,
    );

    /// Drops a neighbour's own sensitivities. Two parts remain: of `δρⱼ` the part due to particle
    /// `i`, `pull(r) rᵢⱼ·δrᵢ`; and of `δAⱼ` that part and the direct dependence on the parameters.
    fn leave_alone<W: SimdFloat>(
        rows: &mut [F64x8],
        by_density: f64,
        pull: impl Fn(f64) -> f64,
        own: &mut OwnSlope<W, D>,
    );
}

/// A central pair: a row of `∂s/∂(r, v, ρ, Aᵢ)`, and a row of `rᵢⱼ`, `s` and `∂s/∂Aⱼ`.
#[derive(Clone, Copy, Debug)]
pub struct CentralRows;

/// A force of any direction: for each component a row of its derivatives by `rᵢⱼ` and `vᵢⱼ`.
#[derive(Clone, Copy, Debug)]
pub struct MatrixRows;

/// A force of any direction: for each component a row of its derivatives by `rᵢⱼ`, `vᵢⱼ`, `ρⱼ` and
/// `Aⱼ`.
#[derive(Clone, Copy, Debug)]
pub struct GeneralRows;

/// Lane of `∂/∂ρ` in a row of derivatives by the state; `∂/∂A` is the next lane.
const fn of_density(dimension: usize) -> usize {
    2 * dimension
}

/// The diagonal block: `∂aᵢ` by the state of particle `i`, component by component.
#[derive(Clone, Copy, Debug)]
pub struct OwnSlope<W, const D: usize> {
    /// By `rᵢ`, `vᵢ`, `ρᵢ` and `Aᵢ`, lane after lane.
    by_state: Vector<W, D>,
    /// `Σⱼ s`, to be added to the diagonal.
    value: f64,
}

impl<W: SimdFloat, const D: usize> OwnSlope<W, D> {
    /// Zero.
    #[inline(always)]
    pub(super) fn zero() -> Self {
        Self { by_state: Vector::zero(), value: 0.0 }
    }

    /// Adds the sum of the coefficients to the diagonal. It works on whole registers, because
    /// extracting single numbers would break up the sums.
    #[inline(always)]
    fn complete(&mut self) {
        for axis in 0..D {
            self.by_state[axis] += W::load(&F64x8::unit(axis)) * self.value;
        }
    }
}

impl<const D: usize> OwnSlope<F64x8, D> {
    /// Adds the part of `δaᵢ` due to particle `i`'s own changes, for eight parameters at once.
    #[inline(always)]
    fn add_to<W: SimdFloat>(&self, own: &Change<W, D>, sum: &mut Vector<W, D>) {
        for axis in 0..D {
            let by = &self.by_state[axis];
            let mut part = own.density * by.lane(of_density(D));
            part += own.p_over_rho2 * by.lane(of_density(D) + 1);
            for b in 0..D {
                part += own.position[b] * by.lane(b);
                part += own.velocity[b] * by.lane(D + b);
            }
            sum[axis] += part;
        }
    }
}

impl<const D: usize> PairRows<D> for CentralRows {
    const FORM: Form = Form::Central;
    const ROWS: usize = 2;

    #[inline(always)]
    fn add_own<W: SimdFloat>(rows: &[F64x8], own: &mut OwnSlope<W, D>) {
        let [by_state, others] = rows else { return };
        let state = W::load(by_state);
        for axis in 0..D {
            own.by_state[axis] += state * others.lane(axis);
        }
        own.value += others.lane(D);
    }

    #[inline(always)]
    fn add_other<W: SimdFloat>(
        rows: &[F64x8],
        other: &PackedSensitivity<D>,
        sum: &mut Vector<W, D>,
    ) {
        let [by_state, others] = rows else { return };
        let mut ds = W::load(&other.density) * by_state.lane(of_density(D));
        ds += W::load(&other.p_over_rho2) * others.lane(D + 1);
        for axis in 0..D {
            ds -= W::load(&other.position[axis]) * by_state.lane(axis);
            ds -= W::load(&other.velocity[axis]) * by_state.lane(D + axis);
        }
        for axis in 0..D {
            sum[axis] += ds * others.lane(axis);
            sum[axis] -= W::load(&other.position[axis]) * others.lane(D);
        }
    }

    #[inline(always)]
    fn leave_alone<W: SimdFloat>(
        rows: &mut [F64x8],
        by_density: f64,
        pull: impl Fn(f64) -> f64,
        own: &mut OwnSlope<W, D>,
    ) {
        let [by_state, others] = rows else { return };
        let mut separation = F64x8::ZERO;
        let mut square = 0.0;
        for axis in 0..D {
            separation.set_lane(axis, others.lane(axis));
            square += others.lane(axis) * others.lane(axis);
        }
        let by_p_over_rho2 = others.lane(D + 1);
        let given =
            (by_state.lane(of_density(D)) + by_p_over_rho2 * by_density) * pull(square.sqrt());
        for axis in 0..D {
            own.by_state[axis] += W::load(&separation) * (given * others.lane(axis));
        }
        *by_state = F64x8::ZERO;
        by_state.set_lane(of_density(D), -(by_p_over_rho2 * by_density));
        others.set_lane(D, 0.0);
    }
}

impl<const D: usize> PairRows<D> for MatrixRows {
    const FORM: Form = Form::Matrix;
    const ROWS: usize = D;

    #[inline(always)]
    fn add_own<W: SimdFloat>(rows: &[F64x8], own: &mut OwnSlope<W, D>) {
        for (axis, row) in rows.iter().enumerate().take(D) {
            own.by_state[axis] += W::load(row);
        }
    }

    #[inline(always)]
    fn add_other<W: SimdFloat>(
        rows: &[F64x8],
        other: &PackedSensitivity<D>,
        sum: &mut Vector<W, D>,
    ) {
        for b in 0..D {
            let (position, velocity) = (W::load(&other.position[b]), W::load(&other.velocity[b]));
            for axis in 0..D {
                sum[axis] -= position * rows[axis].lane(b);
                sum[axis] -= velocity * rows[axis].lane(D + b);
            }
        }
    }

    #[inline(always)]
    fn leave_alone<W: SimdFloat>(
        rows: &mut [F64x8],
        _: f64,
        _: impl Fn(f64) -> f64,
        _: &mut OwnSlope<W, D>,
    ) {
        rows.fill(F64x8::ZERO);
    }
}

impl<const D: usize> PairRows<D> for GeneralRows {
    const FORM: Form = Form::General;
    const ROWS: usize = D;

    /// By `rᵢ` and `vᵢ`. The derivatives by `ρᵢ` and `Aᵢ` come from
    /// [`Slope::by_own_scalars`](super::Slope::by_own_scalars).
    #[inline(always)]
    fn add_own<W: SimdFloat>(rows: &[F64x8], own: &mut OwnSlope<W, D>) {
        let mut state = F64x8::ZERO;
        (0..2 * D).for_each(|lane| state.set_lane(lane, 1.0));
        let state = W::load(&state);
        for (axis, row) in rows.iter().enumerate().take(D) {
            own.by_state[axis] += W::load(row) * state;
        }
    }

    #[inline(always)]
    fn add_other<W: SimdFloat>(
        rows: &[F64x8],
        other: &PackedSensitivity<D>,
        sum: &mut Vector<W, D>,
    ) {
        MatrixRows::add_other(rows, other, sum);
        let (density, p_over_rho2) = (W::load(&other.density), W::load(&other.p_over_rho2));
        for axis in 0..D {
            sum[axis] += density * rows[axis].lane(of_density(D));
            sum[axis] += p_over_rho2 * rows[axis].lane(of_density(D) + 1);
        }
    }

    /// Of the neighbour only the direct dependence of `Aⱼ` on the parameters remains,
    /// `δAⱼ − A'ⱼ δρⱼ`.
    #[inline(always)]
    fn leave_alone<W: SimdFloat>(
        rows: &mut [F64x8],
        by_density: f64,
        _: impl Fn(f64) -> f64,
        _: &mut OwnSlope<W, D>,
    ) {
        for row in rows {
            let by_p_over_rho2 = row.lane(of_density(D) + 1);
            *row = F64x8::ZERO;
            row.set_lane(of_density(D), -(by_p_over_rho2 * by_density));
            row.set_lane(of_density(D) + 1, by_p_over_rho2);
        }
    }
}

/// Which [`PairRows`] store a chunk's pairs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Form {
    /// [`CentralRows`].
    #[default]
    Central,
    /// [`MatrixRows`].
    Matrix,
    /// [`GeneralRows`].
    General,
}

/// The linearised forces of some particles, the same for every block of parameters.
#[derive(Clone, Debug, Default)]
pub struct ForceJacobian {
    form: Form,
    /// The [`OwnSlope`] of each particle, row by row.
    own: Vec<F64x8>,
    /// `∂a` of each particle by the law's parameters, at fixed state: `[parameter][axis]`.
    direct: Vec<f64>,
    /// Index of each particle's first pair, and the total at the end.
    start: Vec<u32>,
    /// The neighbour's slot of each pair.
    slots: Vec<u32>,
    /// The rows of each pair.
    rows: Vec<F64x8>,
    /// Number of pairs; elements from here on are unused.
    filled: usize,
}

impl ForceJacobian {
    /// Bytes held.
    pub fn bytes(&self) -> usize {
        size_of::<F64x8>() * (self.own.capacity() + self.rows.capacity())
            + 8 * self.direct.capacity()
            + 4 * (self.start.capacity() + self.slots.capacity())
    }

    /// Removes everything.
    #[inline(always)]
    pub(super) fn clear(&mut self, form: Form) {
        self.form = form;
        self.own.clear();
        self.direct.clear();
        self.start.clear();
        self.start.push(0);
        self.filled = 0;
    }

    /// Makes room for eight more pairs of `rows` rows each.
    #[inline(always)]
    fn make_room(&mut self, rows: usize) {
        if self.slots.len() < self.filled + WIDTH || self.rows.len() < (self.filled + WIDTH) * rows
        {
            let pairs = (self.filled + WIDTH) * 9 / 8;
            self.slots.resize(pairs, 0);
            self.rows.resize(pairs * rows, F64x8::ZERO);
        }
    }

    /// Adds up to eight pairs to the current particle. Sentinels, which come last, are not counted.
    #[inline(always)]
    pub(super) fn push<R: PairRows<D>, const D: usize>(
        &mut self,
        others: Eight<'_, u32>,
        sentinel: usize,
        pairs: &EightPairs,
    ) {
        self.make_room(R::ROWS);
        self.slots[self.filled..self.filled + WIDTH].copy_from_slice(others.entries);
        let rows = &mut self.rows[self.filled * R::ROWS..][..WIDTH * R::ROWS];
        for (rows, pair) in rows.chunks_exact_mut(R::ROWS).zip(pairs) {
            rows.copy_from_slice(&pair[..R::ROWS]);
        }
        // The next call overwrites the sentinels.
        self.filled += others.count(sentinel);
    }

    /// Adds a pair to the current particle.
    #[inline(always)]
    pub(super) fn push_one(&mut self, slot: u32, rows: &[F64x8]) {
        self.make_room(rows.len());
        self.slots[self.filled] = slot;
        self.rows[self.filled * rows.len()..][..rows.len()].copy_from_slice(rows);
        self.filled += 1;
    }

    /// Completes the current particle. `pull` is `m G` at a distance. `direct` holds the
    /// derivatives that are not stored in rows, `[axis]` by `ρᵢ`, by `Aᵢ` and by each parameter; it
    /// may be empty if none is needed.
    #[inline(always)]
    pub(super) fn close<W: SimdFloat, R: PairRows<D>, const D: usize>(
        &mut self,
        kept: TangentOptions<'_>,
        direct: &[F64x8],
        pull: impl Fn(f64) -> f64,
    ) {
        let first = self.start.last().map_or(0, |&first| first as usize);
        let mut own = OwnSlope::<W, D>::zero();
        let rows = &mut self.rows[first * R::ROWS..self.filled * R::ROWS];
        for rows in rows.chunks_exact(R::ROWS) {
            R::add_own(rows, &mut own);
        }
        if kept.coupling == Coupling::Local {
            for (rows, &slot) in rows.chunks_exact_mut(R::ROWS).zip(&self.slots[first..]) {
                R::leave_alone(rows, kept.p_over_rho2_slopes[slot as usize], &pull, &mut own);
            }
        }
        own.complete();
        let (scalars, parameters) = direct.split_at((2 * D).min(direct.len()));
        let mut rows = store_vector(&own.by_state).0;
        if R::FORM == Form::General {
            for (k, sum) in scalars.iter().enumerate() {
                rows[k % D].set_lane(of_density(D) + k / D, sum.sum());
            }
        }
        self.own.extend_from_slice(&rows);
        self.direct.extend(parameters.iter().map(|sum| sum.sum()));
        self.start.push(self.filled as u32);
    }

    /// The diagonal block of the `k`-th particle.
    #[inline(always)]
    fn own<const D: usize>(&self, k: usize) -> OwnSlope<F64x8, D> {
        let mut own = OwnSlope { by_state: Vector([F64x8::ZERO; D]), value: 0.0 };
        own.by_state.0.copy_from_slice(&self.own[D * k..D * (k + 1)]);
        own
    }

    /// Adds the direct dependence of the `k`-th particle's `δa` on the parameters.
    #[inline(always)]
    fn add_direct<W: SimdFloat, const D: usize>(
        &self,
        k: usize,
        directions: &[F64x8],
        sum: &mut Vector<W, D>,
    ) {
        let count = D * directions.len();
        let rows = self.direct[k * count..(k + 1) * count].chunks_exact(D);
        for (direction, by) in directions.iter().zip(rows) {
            let direction = W::load(direction);
            for axis in 0..D {
                sum[axis] += direction * by[axis];
            }
        }
    }

    /// Adds to `out` the `δa` of these particles, from slot `first` on, for one block of
    /// parameters. `directions` gives the derivative of each of the law's parameters by those of
    /// the block. Prefetches the sensitivities of the `next` block, if there is one.
    pub fn add_tangents<const D: usize>(
        &self,
        first: usize,
        [sensitivities, next]: [&[PackedSensitivity<D>]; 2],
        directions: &[F64x8],
        out: &mut [Vector<F64x8, D>],
    ) {
        dispatch(BlockPass { slopes: self, first, sensitivities, next, directions, out });
    }
}

/// [`ForceJacobian::add_tangents`].
struct BlockPass<'a, const D: usize> {
    slopes: &'a ForceJacobian,
    first: usize,
    sensitivities: &'a [PackedSensitivity<D>],
    next: &'a [PackedSensitivity<D>],
    directions: &'a [F64x8],
    out: &'a mut [Vector<F64x8, D>],
}

impl<const D: usize> SimdTask for BlockPass<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        match self.slopes.form {
            Form::Central => self.sweep::<W::Double, CentralRows>(),
            Form::Matrix => self.sweep::<W::Double, MatrixRows>(),
            Form::General => self.sweep::<W::Double, GeneralRows>(),
        }
    }
}

impl<const D: usize> BlockPass<'_, D> {
    #[inline(always)]
    fn sweep<W: SimdFloat, R: PairRows<D>>(self) {
        let Self { slopes, first, sensitivities, next, directions, out } = self;
        let explicit = !slopes.direct.is_empty()
            && directions.iter().any(|direction| *direction != F64x8::ZERO);
        for (k, out) in out.iter_mut().enumerate() {
            if let Some(next) = next.get(first + k) {
                next.fetch::<W>();
            }
            let mut sum = load_vector::<W, D>(out);
            let own = slopes.own::<D>(k);
            own.add_to(&Change::load(&sensitivities[first + k]), &mut sum);
            if explicit {
                slopes.add_direct(k, directions, &mut sum);
            }
            let pairs = slopes.start[k] as usize..slopes.start[k + 1] as usize;
            let rows =
                slopes.rows[pairs.start * R::ROWS..pairs.end * R::ROWS].chunks_exact(R::ROWS);
            for (&slot, rows) in slopes.slots[pairs].iter().zip(rows) {
                R::add_other(rows, &sensitivities[slot as usize], &mut sum);
            }
            *out = store_vector(&sum);
        }
    }
}
