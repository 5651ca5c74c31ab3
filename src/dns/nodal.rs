//! Fields at the nodes of the mesh, where they are asked for.

use super::complex::ComplexF64x8;
use super::fft::Buffers;
use super::layout::ROWS;
use super::mesh::{AxisFactors, Mesh, NodeRows, Nodes};
use super::modes::Modes;
use crate::scalar::{SimdFloat, SimdTask, WIDTH, dispatch};
use crate::vector::Vector;
use rayon::prelude::*;
use std::marker::PhantomData;

impl<const D: usize> Mesh<D> {
    /// A field at all nodes, the first axis fastest; each coefficient times a factor before.
    pub(super) fn values(
        &mut self,
        modes: &Modes<D>,
        factors: Option<&AxisFactors>,
        into: &mut [Vector<f64, D>],
    ) {
        self.spread(&modes.data, D, factors);
        let chunk = self.layout.slab_nodes();
        let read = Read { nodes: self.layout.nodes, slices: PhantomData };
        self.slabs(&read, into.par_chunks_mut(chunk));
    }

    /// The coefficients of a field given at all nodes, those that are kept.
    pub(super) fn coefficients(&mut self, field: &[Vector<f64, D>]) -> Modes<D> {
        let chunk = self.layout.slab_nodes();
        let write = Write { nodes: self.layout.nodes, slices: PhantomData };
        self.slabs(&write, field.par_chunks(chunk));
        let mut modes = Modes::zero(&self.layout);
        let length = modes.line_length();
        let mut buffers = Buffers::new(self.layout.nodes);
        for (line, into) in modes.data.chunks_exact_mut(length).enumerate() {
            dispatch(Gather { mesh: self, line, into, buffers: &mut buffers });
        }
        modes.truncate();
        modes
    }
}

/// Node of lane `lane` of a group of rows at number `x` along its row, among those of the slab.
#[inline(always)]
fn node([first, lane, x]: [usize; 3], nodes: usize) -> usize {
    (first + lane) * nodes + x
}

/// Copies values to a slice of each slab.
struct Read<'s, const D: usize> {
    nodes: usize,
    slices: PhantomData<&'s ()>,
}

impl<'s, const D: usize> Nodes for Read<'s, D> {
    type Side = &'s mut [Vector<f64, D>];
    const IN: usize = D;
    const OUT: usize = 0;

    #[inline(always)]
    fn at<V: SimdFloat<Double = V>>(
        &self,
        [_, first]: [usize; 2],
        NodeRows { values, .. }: NodeRows<'_>,
        side: &mut Self::Side,
    ) {
        let count = ROWS.min(side.len() / self.nodes - first);
        for lane in 0..count {
            let row = &mut side[node([first, lane, 0], self.nodes)..][..self.nodes];
            for (x, there) in row.iter_mut().enumerate() {
                for axis in 0..D {
                    there[axis] = part(&values[axis][x], lane);
                }
            }
        }
    }
}

/// Copies values from a slice of each slab.
struct Write<'s, const D: usize> {
    nodes: usize,
    slices: PhantomData<&'s ()>,
}

impl<'s, const D: usize> Nodes for Write<'s, D> {
    type Side = &'s [Vector<f64, D>];
    const IN: usize = 0;
    const OUT: usize = D;

    #[inline(always)]
    fn at<V: SimdFloat<Double = V>>(
        &self,
        [_, first]: [usize; 2],
        NodeRows { results, .. }: NodeRows<'_>,
        side: &mut Self::Side,
    ) {
        let count = ROWS.min(side.len() / self.nodes - first);
        for (axis, results) in results.iter_mut().enumerate().take(D) {
            for (x, eight) in results.iter_mut().enumerate() {
                let mut halves = [[0.0; WIDTH]; 2];
                for lane in 0..count {
                    let value = side[node([first, lane, x], self.nodes)][axis];
                    halves[lane / WIDTH][lane % WIDTH] = value;
                }
                let [re, im] = halves.map(crate::scalar::F64x8::new);
                *eight = ComplexF64x8 { re, im };
            }
        }
    }
}

/// The number of one of sixteen rows: real parts, then imaginary parts.
#[inline(always)]
fn part(eight: &ComplexF64x8, lane: usize) -> f64 {
    if lane < WIDTH { eight.re.lane(lane) } else { eight.im.lane(lane - WIDTH) }
}

/// [`Mesh::gather`] of all components of a line.
struct Gather<'a, const D: usize> {
    mesh: &'a Mesh<D>,
    line: usize,
    into: &'a mut [ComplexF64x8],
    buffers: &'a mut Buffers,
}

impl<const D: usize> SimdTask for Gather<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let fields = self.into.chunks_exact_mut(self.mesh.layout.along);
        for (field, into) in fields.enumerate() {
            self.mesh.gather::<W::Double>((self.line, field, D), self.buffers, into);
        }
    }
}
