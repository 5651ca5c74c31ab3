//! Fourier coefficients of a velocity field.

use super::complex::ComplexF64x8;
use super::layout::{Layout, Slot};
use crate::vector::Vector;
use crate::waves::{Wave, Waves};
use rayon::prelude::*;

/// `û(n)` with `u(x) = Σ û(n) e^{ik n·x}`, `k = 2π/L`, of the wave vectors of a [`Layout`].
///
/// In memory component `c` of block `outer` of line `line` is number `(D line + c) (2 largest + 1) + outer`.
#[derive(Clone, Debug, PartialEq)]
pub struct Modes<const D: usize> {
    layout: Layout<D>,
    pub(super) data: Vec<ComplexF64x8>,
}

impl<const D: usize> Modes<D> {
    /// A field at rest on a mesh.
    pub(super) fn zero(layout: &Layout<D>) -> Self {
        Self { data: vec![ComplexF64x8::ZERO; D * layout.eights()], layout: layout.clone() }
    }

    /// Which wave vectors are kept.
    pub fn layout(&self) -> &Layout<D> {
        &self.layout
    }

    /// Blocks of eight of one line, all components.
    pub(super) fn line_length(&self) -> usize {
        D * self.layout.along
    }

    fn index(&self, slot: Slot, component: usize) -> usize {
        (D * slot.line + component) * self.layout.along + slot.outer
    }

    pub(super) fn at(&self, slot: Slot) -> [[f64; 2]; D] {
        std::array::from_fn(|c| self.data[self.index(slot, c)].lane(slot.lane))
    }

    pub(super) fn set(&mut self, slot: Slot, value: [[f64; 2]; D]) {
        for (component, value) in value.into_iter().enumerate() {
            let index = self.index(slot, component);
            self.data[index].set_lane(slot.lane, value);
        }
    }

    /// `û(n)`, real and imaginary part of each component; zero where `n` is left out.
    pub fn coefficient(&self, n: [i32; 3]) -> [[f64; 2]; D] {
        if !self.layout.keeps(n) {
            return [[0.0; 2]; D];
        }
        if n[0] >= 0 {
            return self.at(self.layout.slot(n));
        }
        self.at(self.layout.slot(n.map(|n| -n))).map(|[re, im]| [re, -im])
    }

    /// Adds waves; those that the mesh leaves out are left out.
    pub fn add(&mut self, waves: &Waves, factor: f64) {
        let layout = self.layout.clone();
        for wave in waves.list() {
            for (slot, sign) in slots_of(&layout, wave) {
                let mut sum = self.at(slot);
                for (axis, sum) in sum.iter_mut().enumerate() {
                    sum[0] += 0.5 * factor * wave.cosine[axis];
                    sum[1] -= 0.5 * factor * sign * wave.sine[axis];
                }
                self.set(slot, sum);
            }
        }
    }

    /// Adds another field of the same mesh.
    pub(super) fn plus(&mut self, other: &Self) {
        for (sum, more) in self.data.iter_mut().zip(&other.data) {
            sum.re += more.re;
            sum.im += more.im;
        }
    }

    /// Zero where wave vectors are left out: blocks of eight have room for some of these.
    pub(super) fn truncate(&mut self) {
        *self = self.on(&self.layout);
    }

    /// The same field on a mesh of another number of nodes: wave vectors that both keep are copied, the
    /// others of the new mesh are zero.
    pub(super) fn on(&self, layout: &Layout<D>) -> Self {
        let mut there = Self::zero(layout);
        for (slot, n) in layout.slots() {
            there.set(slot, self.coefficient(n));
        }
        there
    }

    /// Every coefficient times a real function of the wave vector.
    pub(super) fn times(&self, factor: impl Fn([i32; 3]) -> f64) -> Self {
        let mut there = Self::zero(&self.layout);
        for (slot, n) in self.layout.slots() {
            let factor = factor(n);
            there.set(slot, self.at(slot).map(|part| part.map(|x| x * factor)));
        }
        there
    }

    /// `∂u/∂x_axis`.
    pub(super) fn derivative(&self, axis: usize) -> Self {
        let mut there = Self::zero(&self.layout);
        let k = self.layout.wave_number();
        for (slot, n) in self.layout.slots() {
            let k = k * f64::from(n[axis]);
            there.set(slot, self.at(slot).map(|[re, im]| [-k * im, k * re]));
        }
        there
    }

    /// `u(x)` by summing every wave: slow, exact to round-off.
    pub fn velocity_at(&self, x: Vector<f64, D>) -> Vector<f64, D> {
        let (x, k) = (x.to_3d(), self.layout.wave_number());
        let mut sum = Vector::zero();
        for (slot, n) in self.layout.slots() {
            let along: f64 = (0..3).map(|axis| f64::from(n[axis]) * x[axis]).sum();
            let (sin, cos) = (k * along).sin_cos();
            let weight = weight(n);
            for (axis, [re, im]) in self.at(slot).into_iter().enumerate() {
                sum[axis] += weight * (re * cos - im * sin);
            }
        }
        sum
    }

    /// Makes the field real and keeps it so: where `n_x = 0` both `n` and `−n` are in memory, and what round-off
    /// does to one of them alone no product would see, but a linear forcing would amplify.
    pub(super) fn make_real(&mut self) {
        for middle in 0..self.layout.middles {
            for outer in 0..self.layout.along {
                let here = Slot { line: middle * self.layout.blocks, outer, lane: 0 };
                let there = self.layout.slot(self.layout.vector(here).map(|n| -n));
                if (there.line, there.outer) < (here.line, here.outer) {
                    continue;
                }
                let (mut one, mut other) = (self.at(here), self.at(there));
                for (one, other) in one.iter_mut().zip(&mut other) {
                    let mean = [0.5 * (one[0] + other[0]), 0.5 * (one[1] - other[1])];
                    (*one, *other) = (mean, [mean[0], -mean[1]]);
                }
                self.set(here, one);
                self.set(there, other);
            }
        }
    }

    /// Removes the part along `n` of each coefficient: what is left has no divergence.
    pub(super) fn project(&mut self) {
        let layout = self.layout.clone();
        for (slot, n) in layout.slots().filter(|(_, n)| n.iter().any(|&n| n != 0)) {
            let mut value = self.at(slot);
            let square: f64 = n.iter().map(|&n| f64::from(n) * f64::from(n)).sum();
            let along = |part: usize| -> f64 {
                (0..D).map(|axis| f64::from(n[axis]) * value[axis][part]).sum::<f64>() / square
            };
            let along = [along(0), along(1)];
            for (value, n) in value.iter_mut().zip(n) {
                *value = [value[0] - f64::from(n) * along[0], value[1] - f64::from(n) * along[1]];
            }
            self.set(slot, value);
        }
    }

    /// `Σ |û|²` over `0 < |n| <= band`, both halves: `⟨|u|²⟩` of these waves. `sums` has a place for each line,
    /// so that the sum does not depend on threads and nothing is allocated.
    pub(super) fn square_within(&self, band: f64, sums: &mut [f64]) -> f64 {
        let lines = self.data.par_chunks(self.line_length());
        lines.zip(sums.par_iter_mut()).enumerate().for_each(|(line, (eights, sum))| {
            *sum = self.line_square(eights, line, band);
        });
        sums.iter().sum()
    }

    fn line_square(&self, eights: &[ComplexF64x8], line: usize, band: f64) -> f64 {
        let (layout, limit) = (&self.layout, band * band);
        let first = layout.vector(Slot { line, outer: 0, lane: 0 });
        let nearest = first.iter().map(|&n| f64::from(n) * f64::from(n)).sum::<f64>();
        let mut sum = 0.0;
        for outer in (0..layout.along).filter(|_| nearest <= limit) {
            for lane in 0..crate::scalar::WIDTH {
                let n = layout.vector(Slot { line, outer, lane });
                let square = n.iter().map(|&n| f64::from(n) * f64::from(n)).sum::<f64>();
                if square > 0.0 && square <= limit {
                    let parts = (0..D).flat_map(|c| eights[c * layout.along + outer].lane(lane));
                    sum += weight(n) * parts.map(|x| x * x).sum::<f64>();
                }
            }
        }
        sum
    }

    /// `⟨u·w⟩` of two fields.
    pub(super) fn mean_product(&self, other: &Self) -> f64 {
        let mut sum = 0.0;
        for (slot, n) in self.layout.slots() {
            let pairs = self.at(slot).into_iter().zip(other.at(slot));
            sum += weight(n) * pairs.map(|(a, b)| a[0] * b[0] + a[1] * b[1]).sum::<f64>();
        }
        sum
    }

    /// The largest `|k·û|/|k|`, in units of `u' = √(⟨|u|²⟩/D)`; zero in a field at rest.
    pub fn divergence(&self) -> f64 {
        let mut largest = 0.0_f64;
        for (slot, n) in self.layout.slots().filter(|(_, n)| n.iter().any(|&n| n != 0)) {
            let value = self.at(slot);
            let length = n.iter().map(|&n| f64::from(n) * f64::from(n)).sum::<f64>().sqrt();
            let along = |part| (0..D).map(|a| f64::from(n[a]) * value[a][part]).sum::<f64>();
            largest = largest.max(along(0).hypot(along(1)) / length);
        }
        let scale = (self.mean_product(self) / D as f64).sqrt();
        if scale > 0.0 { largest / scale } else { 0.0 }
    }
}

/// How often a coefficient stands in sums over all wave vectors: twice where `n_x > 0`.
pub(super) fn weight(n: [i32; 3]) -> f64 {
    if n[0] > 0 { 2.0 } else { 1.0 }
}

/// Where a wave is kept, and the sign of its sine there: `û(±n) = (a ∓ ib)/2`.
pub(super) fn slots_of<const D: usize>(
    layout: &Layout<D>,
    wave: &Wave,
) -> impl Iterator<Item = (Slot, f64)> {
    let both = [(wave.n, 1.0), (wave.n.map(|n| -n), -1.0)];
    let kept = both.into_iter().filter(|(n, _)| n[0] >= 0 && layout.keeps(*n));
    kept.map(|(n, sign)| (layout.slot(n), sign))
}
