//! The advection of an incompressible flow.

use super::complex::{Complex, ComplexF64x8};
use super::fft::Buffers;
use super::mesh::{Mesh, NodeRows, Nodes};
use super::modes::Modes;
use crate::scalar::{F64x8, SimdFloat};
use crate::vector::Vector;
use rayon::prelude::*;
use std::marker::PhantomData;

/// Fields that come back from the nodes: 2 in two dimensions, 5 in three.
pub(super) const fn products(dimension: usize) -> usize {
    dimension * (dimension + 1) / 2 - 1
}

/// Products of velocities at the nodes.
///
/// `P(−∂ⱼ uᵢuⱼ)` is `P(u × ω)`: where products are free of aliases, as the 2/3 rule makes them, all forms of the
/// advection are the same numbers. Of `uᵢuⱼ` the diagonal matters only up to a gradient, so its last entry is
/// taken from all of it (Basdevant 1983, doi:10.1016/0021-9991(83)90118-X): three transforms there and five back,
/// against six and three of the rotational form; two and two in two dimensions.
struct Products<'s, const D: usize>(PhantomData<&'s ()>);

impl<'s, const D: usize> Nodes for Products<'s, D> {
    /// The largest `Σ |uᵢ|`.
    type Side = &'s mut Speed;
    const IN: usize = D;
    const OUT: usize = products(D);

    #[inline(always)]
    fn at<V: SimdFloat<Double = V>>(
        &self,
        _: [usize; 2],
        nodes: NodeRows<'_>,
        fastest: &mut Self::Side,
    ) {
        let NodeRows { values, results } = nodes;
        let mut largest = V::load(&fastest.0);
        for x in 0..values[0].len() {
            let mut u = [Complex::<V>::zero(); D];
            for (u, values) in u.iter_mut().zip(values) {
                *u = Complex::load(&values[x]);
            }
            let mut sums = [V::of(0.0); 2];
            for u in u {
                sums = [sums[0] + u.re.abs(), sums[1] + u.im.abs()];
            }
            largest = largest.max(sums[0].max(sums[1]));
            let last = squared(u[D - 1]);
            for axis in 0..D - 1 {
                results[axis][x] = squared(u[axis]).minus(last).store();
            }
            let mut place = D - 1;
            for i in 0..D {
                for j in i + 1..D {
                    let cross = Complex { re: u[i].re * u[j].re, im: u[i].im * u[j].im };
                    results[place][x] = cross.store();
                    place += 1;
                }
            }
        }
        fastest.0 = largest.store();
    }
}

/// The squares of two real numbers.
#[inline(always)]
fn squared<V: SimdFloat>(u: Complex<V>) -> Complex<V> {
    Complex { re: u.re * u.re, im: u.im * u.im }
}

/// A speed of each lane.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Speed(F64x8);

/// Working memory of the advection.
#[derive(Debug)]
pub(super) struct Advection {
    speeds: Vec<Speed>,
}

/// What [`Advection::line`] needs for one line.
#[derive(Debug)]
pub(super) struct LineScratch {
    buffers: Buffers,
    products: Vec<ComplexF64x8>,
    /// The rate of change, all components.
    pub(super) rate: Vec<ComplexF64x8>,
}

impl LineScratch {
    pub(super) fn new<const D: usize>(mesh: &Mesh<D>) -> Self {
        let along = mesh.layout.along;
        Self {
            buffers: Buffers::new(mesh.layout.nodes),
            products: vec![ComplexF64x8::ZERO; products(D) * along],
            rate: vec![ComplexF64x8::ZERO; D * along],
        }
    }
}

impl Advection {
    pub(super) fn new<const D: usize>(mesh: &Mesh<D>) -> Self {
        Self { speeds: vec![Speed::default(); mesh.layout.slabs()] }
    }

    /// Everything but the last axis back; returns the largest `Σ |uᵢ|` over the nodes, NaN where there is any.
    pub(super) fn products<const D: usize>(
        &mut self,
        mesh: &mut Mesh<D>,
        modes: &[ComplexF64x8],
    ) -> f64 {
        mesh.spread(modes, D, None);
        self.speeds.fill(Speed::default());
        mesh.slabs(&Products::<D>(PhantomData), self.speeds.par_iter_mut());
        let all = self.speeds.iter().flat_map(|speed| speed.0.to_array());
        all.fold(0.0, |largest, x| if x > largest || x.is_nan() { x } else { largest })
    }
}

/// The advection of one line, after [`Advection::products`]: leaves `P(−∂ⱼ uᵢuⱼ)` in `scratch.rate`, zero for the mean and
/// for wave vectors that are left out.
#[inline(always)]
pub(super) fn line_rate<V: SimdFloat<Double = V>, const D: usize>(
    mesh: &Mesh<D>,
    line: usize,
    scratch: &mut LineScratch,
) {
    let LineScratch { buffers, products: fields, rate } = scratch;
    let layout = &mesh.layout;
    let along = layout.along;
    for (field, into) in fields.chunks_exact_mut(along).enumerate() {
        mesh.gather::<V>((line, field, products(D)), buffers, into);
    }
    let (block, middle) = layout.of_line(line);
    let x = V::load(&layout.along_x(block));
    for outer in 0..along {
        let last = V::of(f64::from(layout.number(outer)));
        let mut n = [x; D];
        n[D - 1] = last;
        if D == 3 {
            n[1] = V::of(middle);
        }
        let mut products = [Complex::<V>::zero(); MOST];
        for (field, product) in products.iter_mut().enumerate().take(self::products(D)) {
            *product = Complex::load(&fields[field * along + outer]);
        }
        let sums = projected(divergence(n, &products), n, layout.limit);
        let k = V::of(layout.wave_number());
        for (axis, sum) in sums.into_iter().enumerate() {
            rate[axis * along + outer] = sum.turned::<false>().scaled(k).store();
        }
    }
}

/// Most products there are.
const MOST: usize = products(3);

/// `nⱼ Tᵢⱼ` with the tensor that [`Products`] left, its last diagonal entry zero.
#[inline(always)]
fn divergence<V: SimdFloat, const D: usize>(n: [V; D], t: &[Complex<V>; MOST]) -> [Complex<V>; D] {
    let mut sums = [Complex::zero(); D];
    for axis in 0..D - 1 {
        sums[axis] = t[axis].scaled(n[axis]);
    }
    let mut place = D - 1;
    for i in 0..D {
        for j in i + 1..D {
            sums[i] = sums[i].plus(t[place].scaled(n[j]));
            sums[j] = sums[j].plus(t[place].scaled(n[i]));
            place += 1;
        }
    }
    sums
}

/// The part across `n`, zero where `|n|²` is zero or not below a limit.
#[inline(always)]
fn projected<V: SimdFloat, const D: usize>(
    field: [Complex<V>; D],
    n: [V; D],
    limit: f64,
) -> [Complex<V>; D] {
    let (mut square, mut along) = (V::of(0.0), Complex::zero());
    for axis in 0..D {
        square += n[axis] * n[axis];
        along = along.plus(field[axis].scaled(n[axis]));
    }
    let zero = V::of(0.0);
    let inside = V::select_less(square, V::of(limit), V::of(1.0), zero);
    let share = along.scaled(V::of(1.0) / square.max(V::of(1.0)));
    let mut across = field;
    for axis in 0..D {
        across[axis] = field[axis].minus(share.scaled(n[axis])).scaled(inside);
    }
    across
}

/// `−∇p`, the part of `Du/Dt` that makes the flow incompressible: from `∇²p = −∂ᵢ∂ⱼ uᵢuⱼ`.
pub(super) fn pressure_force<const D: usize>(mesh: &mut Mesh<D>, modes: &Modes<D>) -> Modes<D> {
    let mut velocity = vec![Vector::zero(); mesh.layout.node_count()];
    mesh.values(modes, None, &mut velocity);
    let mut force = Modes::zero(&mesh.layout);
    for axis in 0..D {
        // Row `axis` of the tensor, times n from the left, and once more along its own axis.
        let row: Vec<_> = velocity.iter().map(|&u| u * u[axis]).collect();
        let row = mesh.coefficients(&row);
        for (slot, n) in mesh.layout.slots().filter(|(_, n)| n.iter().any(|&n| n != 0)) {
            let n = n.map(f64::from);
            let (square, t) = (n.iter().map(|n| n * n).sum::<f64>(), row.at(slot));
            let along = |part: usize| (0..D).map(|j| n[j] * t[j][part]).sum::<f64>() * n[axis];
            let [re, im] = [along(0) / square, along(1) / square];
            let k = mesh.layout.wave_number();
            let mut sum = force.at(slot);
            for (sum, n) in sum.iter_mut().zip(n) {
                // −ik p with p = −nᵢnⱼTᵢⱼ/n².
                *sum = [sum[0] - k * n * im, sum[1] + k * n * re];
            }
            force.set(slot, sum);
        }
    }
    force
}
