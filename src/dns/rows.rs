//! Sixteen rows of the mesh: between values along x and their modes.

use super::complex::{Complex, ComplexF64x8};
use super::fft::{Buffers, Fft};
use super::layout::ROWS;
use crate::scalar::{F64x8, SimdFloat, WIDTH, transposed};

/// Where sixteen rows of modes lie: row `r` of block `b` at `first + stride b + r`, `count` of them.
#[derive(Clone, Copy)]
pub(super) struct Tile {
    pub(super) first: usize,
    pub(super) stride: usize,
    pub(super) count: usize,
    pub(super) blocks: usize,
}

/// Two transforms of real rows in one complex transform: `Z = U + iV` with `U` and `V` the modes of eight rows
/// each, so that the real part of `z` is the first eight rows and the imaginary part the others.
///
/// Leaves the rows in `buffers.front`: entry `x`, lane `r`: rows `r` (real part) and `8 + r` (imaginary part).
#[inline(always)]
pub(super) fn to_nodes<V: SimdFloat<Double = V>>(
    fft: &Fft,
    largest: usize,
    (source, tile): (&[ComplexF64x8], Tile),
    buffers: &mut Buffers,
) {
    let n = buffers.front.len();
    for eight in &mut buffers.front[largest + 1..n - largest] {
        *eight = ComplexF64x8::ZERO;
    }
    for block in 0..tile.blocks {
        let rows = &source[tile.first + block * tile.stride..][..tile.count];
        let (u, v) = rows.split_at(tile.count.min(WIDTH));
        let (u, v) = (columns::<V>(u), columns::<V>(v));
        for lane in 0..WIDTH.min(largest + 1 - block * WIDTH) {
            let (k, u, v) = (block * WIDTH + lane, u[lane], v[lane]);
            let whole = Complex { re: u.re - v.im, im: u.im + v.re };
            if k == 0 {
                buffers.front[0] = Complex { re: u.re, im: v.re }.store();
            } else {
                buffers.front[k] = whole.store();
                let mirrored = Complex { re: u.re + v.im, im: v.re - u.im };
                buffers.front[n - k] = mirrored.store();
            }
        }
    }
    fft.run::<V, true>(buffers);
}

/// Back from `buffers.front` to modes, times a factor.
#[inline(always)]
pub(super) fn to_modes<V: SimdFloat<Double = V>>(
    fft: &Fft,
    (largest, factor): (usize, f64),
    buffers: &mut Buffers,
    (into, tile): (&mut [ComplexF64x8], Tile),
) {
    fft.run::<V, false>(buffers);
    let n = buffers.front.len();
    let half = V::of(0.5 * factor);
    for block in 0..tile.blocks {
        let [mut u_re, mut u_im, mut v_re, mut v_im] = [[F64x8::ZERO; WIDTH]; 4];
        for lane in 0..WIDTH.min(largest + 1 - block * WIDTH) {
            let k = block * WIDTH + lane;
            let z = Complex::<V>::load(&buffers.front[k]);
            let mirrored = Complex::<V>::load(&buffers.front[if k == 0 { 0 } else { n - k }]);
            u_re[lane] = ((z.re + mirrored.re) * half).store();
            u_im[lane] = ((z.im - mirrored.im) * half).store();
            v_re[lane] = ((z.im + mirrored.im) * half).store();
            v_im[lane] = ((mirrored.re - z.re) * half).store();
        }
        let into = &mut into[tile.first + block * tile.stride..][..tile.count];
        let (u, v) = into.split_at_mut(tile.count.min(WIDTH));
        put::<V>(&u_re, &u_im, u);
        put::<V>(&v_re, &v_im, v);
    }
}

/// Up to eight rows as columns: entry `k` has the modes of that number of all rows.
#[inline(always)]
fn columns<V: SimdFloat<Double = V>>(rows: &[ComplexF64x8]) -> [Complex<V>; WIDTH] {
    let [mut re, mut im] = [[F64x8::ZERO; WIDTH]; 2];
    for (r, row) in rows.iter().enumerate() {
        (re[r], im[r]) = (row.re, row.im);
    }
    let (re, im) = (transposed::<V>(&re), transposed::<V>(&im));
    let mut all = [Complex::zero(); WIDTH];
    for (k, all) in all.iter_mut().enumerate() {
        *all = Complex { re: re[k], im: im[k] };
    }
    all
}

/// Columns as up to eight rows.
#[inline(always)]
fn put<V: SimdFloat<Double = V>>(
    re: &[F64x8; WIDTH],
    im: &[F64x8; WIDTH],
    rows: &mut [ComplexF64x8],
) {
    let (re, im) = (transposed::<V>(re), transposed::<V>(im));
    for (r, row) in rows.iter_mut().enumerate() {
        *row = Complex { re: re[r], im: im[r] }.store();
    }
}

/// The tile of a group of rows that lie `stride` apart by blocks.
pub(super) fn tile(
    first: usize,
    stride: usize,
    (group, nodes): (usize, usize),
    blocks: usize,
) -> Tile {
    Tile { first, stride, count: ROWS.min(nodes - group * ROWS), blocks }
}
