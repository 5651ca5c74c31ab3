//! Sums of Gaussian kernels on uniform nodes, and their derivatives: the expensive part of the
//! loss.

use crate::network::{COUNT, exp};
use crate::scalar::{F64x8, SimdFloat, SimdTask, WIDTH, dispatch};
use rayon::prelude::*;

/// Samples per parallel task. It is fixed, so that sums have the same bits for any number of
/// threads.
const CHUNK: usize = 256;
/// Margin of the nodes beyond the outermost samples, in bandwidths.
const MARGIN: f64 = 5.0;
/// Reach of a sample, in bandwidths; beyond it the kernel is at most `e⁻⁷² ≈ 5e-32` and is left
/// out.
const REACH: f64 = 12.0;

/// Uniform nodes at which densities are compared.
#[derive(Clone, Copy, Debug)]
pub(super) struct KdeGrid {
    /// Position of the lowest node.
    first: f64,
    /// Distance of two nodes.
    pub(super) spacing: f64,
    /// Number of nodes.
    pub(super) count: usize,
}

impl KdeGrid {
    /// Over the range of the samples, and five bandwidths beyond it on either side.
    pub(super) fn new(x: &[f64], bandwidth: f64, count: usize) -> Self {
        let low = x.iter().copied().fold(f64::INFINITY, f64::min) - MARGIN * bandwidth;
        let high = x.iter().copied().fold(f64::NEG_INFINITY, f64::max) + MARGIN * bandwidth;
        Self { first: low, spacing: (high - low) / (count - 1) as f64, count }
    }

    /// Position of a node.
    pub(super) fn at(&self, node: usize) -> f64 {
        self.first + node as f64 * self.spacing
    }

    /// `Σₖ e^{−u²/2}` at every node, with `u = (node − xₖ)/bandwidth`.
    pub(super) fn bells(&self, x: &[f64], bandwidth: f64) -> Vec<f64> {
        let part = |x: &[f64]| {
            let mut sum = vec![0.0; self.count + WIDTH];
            dispatch(Spread { nodes: *self, x, bandwidth, sum: &mut sum });
            sum
        };
        let parts: Vec<Vec<f64>> = x.par_chunks(CHUNK).map(part).collect();
        let mut sum = vec![0.0; self.count];
        for part in parts {
            sum.iter_mut().zip(part).for_each(|(sum, part)| *sum += part);
        }
        sum
    }

    /// `Σₘ wₘ e^{−u²/2} u` over the nodes for every sample, and `Σ wₘ e^{−u²/2} (u² − 1)` over both.
    pub(super) fn gather(&self, x: &[f64], bandwidth: f64, weights: &[f64]) -> (Vec<f64>, f64) {
        let mut slopes = vec![0.0; x.len()];
        let mut padded = weights.to_vec();
        padded.resize(self.count + WIDTH, 0.0);
        let part = |(x, slopes): (&[f64], &mut [f64])| {
            let (nodes, weights, mut widths) = (*self, &padded[..], F64x8::ZERO);
            let mut lanes = [F64x8::ZERO; CHUNK];
            let gather =
                Gather { nodes, x, bandwidth, weights, slopes: &mut lanes, widths: &mut widths };
            dispatch(gather);
            slopes.iter_mut().zip(lanes).for_each(|(slope, lanes)| *slope = lanes.sum());
            widths.sum()
        };
        let chunks = x.par_chunks(CHUNK).zip(slopes.par_chunks_mut(CHUNK));
        let widths: Vec<f64> = chunks.map(part).collect();
        (slopes, widths.iter().sum())
    }
}

/// The nodes in reach of one sample, in whole registers: the index of the first, the number of
/// registers, and `u = (node − x)/b` of the first eight.
#[inline(always)]
fn reach<W: SimdFloat>(nodes: &KdeGrid, x: f64, bandwidth: f64) -> (usize, usize, W) {
    let place = (x - nodes.first) / nodes.spacing;
    let radius = REACH * bandwidth / nodes.spacing;
    // A conversion to an integer saturates at its limits.
    let first = ((place - radius).ceil().max(0.0) as usize).min(nodes.count);
    let end = (((place + radius).floor() + 1.0).max(0.0) as usize).min(nodes.count);
    let lanes = end.saturating_sub(first).div_ceil(WIDTH);
    let step = nodes.spacing / bandwidth;
    (first, lanes, W::load(&COUNT) * step + (first as f64 - place) * step)
}

/// `e^{−u²/2}`.
#[inline(always)]
fn bell<W: SimdFloat>(u: W) -> W {
    exp(u * u * -0.5)
}

/// Adds `Σₖ e^{−u²/2}` of a chunk of samples at every node; `sum` is padded by eight nodes.
struct Spread<'a> {
    nodes: KdeGrid,
    x: &'a [f64],
    bandwidth: f64,
    sum: &'a mut [f64],
}

impl SimdTask for Spread<'_> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let stride = WIDTH as f64 * self.nodes.spacing / self.bandwidth;
        for &x in self.x {
            let (first, lanes, mut u) = reach::<W>(&self.nodes, x, self.bandwidth);
            for block in self.sum[first..].chunks_exact_mut(WIDTH).take(lanes) {
                let bells = bell(u).store().to_array();
                for (sum, bell) in block.iter_mut().zip(bells) {
                    *sum += bell;
                }
                u = u + stride;
            }
        }
    }
}

/// For each sample of a chunk `Σₘ wₘ e^{−u²/2} u` over the nodes, and in total
/// `Σ wₘ e^{−u²/2} (u² − 1)`; `weights` is padded by eight zeros.
///
/// The caller sums over lanes: if it were done here, the compiler would vectorise that sum instead
/// of the loop.
struct Gather<'a> {
    nodes: KdeGrid,
    x: &'a [f64],
    bandwidth: f64,
    weights: &'a [f64],
    slopes: &'a mut [F64x8],
    widths: &'a mut F64x8,
}

impl SimdTask for Gather<'_> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let stride = WIDTH as f64 * self.nodes.spacing / self.bandwidth;
        let mut widths = W::of(0.0);
        for (&x, slope) in self.x.iter().zip(self.slopes) {
            let (first, lanes, mut u) = reach::<W>(&self.nodes, x, self.bandwidth);
            let mut sum = W::of(0.0);
            let (blocks, _) = self.weights[first..].as_chunks::<WIDTH>();
            for block in blocks.iter().take(lanes) {
                let felt = bell(u) * W::load(&F64x8::new(*block));
                sum += felt * u;
                widths += felt * (u * u - 1.0);
                u = u + stride;
            }
            *slope = sum.store();
        }
        *self.widths = widths.store();
    }
}
