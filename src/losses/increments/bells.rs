//! Sums of normal kernels on uniform nodes, in both directions: the hot part of the loss.

use crate::network::{COUNT, exp};
use crate::scalar::{Lanes, Pass, WIDTH, Wide, dispatch};
use rayon::prelude::*;

/// Samples per parallel task: fixed, so that sums have the same bits for any number of threads.
const CHUNK: usize = 256;
/// Bandwidths beyond the outermost samples that the nodes reach.
const MARGIN: f64 = 5.0;
/// Bandwidths beyond which a sample is not felt: `e⁻⁷² ≈ 5e-32`.
const REACH: f64 = 12.0;

/// Where densities are compared.
#[derive(Clone, Copy, Debug)]
pub(super) struct Nodes {
    /// The lowest.
    first: f64,
    /// Distance of two.
    pub(super) spacing: f64,
    /// How many.
    pub(super) count: usize,
}

impl Nodes {
    /// Over the samples and five bandwidths on either side.
    pub(super) fn new(x: &[f64], bandwidth: f64, count: usize) -> Self {
        let low = x.iter().copied().fold(f64::INFINITY, f64::min) - MARGIN * bandwidth;
        let high = x.iter().copied().fold(f64::NEG_INFINITY, f64::max) + MARGIN * bandwidth;
        Self { first: low, spacing: (high - low) / (count - 1) as f64, count }
    }

    /// Where a node stands.
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
            let (nodes, weights, mut widths) = (*self, &padded[..], Lanes::ZERO);
            let mut lanes = [Lanes::ZERO; CHUNK];
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

/// The stretch of nodes that feel one sample, in whole lanes: the first of them, how many lanes, and
/// `u = (node − x)/b` of the first eight.
#[inline(always)]
fn reach<W: Wide>(nodes: &Nodes, x: f64, bandwidth: f64) -> (usize, usize, W) {
    let place = (x - nodes.first) / nodes.spacing;
    let radius = REACH * bandwidth / nodes.spacing;
    // A conversion to an integer stops at its ends.
    let first = ((place - radius).ceil().max(0.0) as usize).min(nodes.count);
    let end = (((place + radius).floor() + 1.0).max(0.0) as usize).min(nodes.count);
    let lanes = end.saturating_sub(first).div_ceil(WIDTH);
    let step = nodes.spacing / bandwidth;
    (first, lanes, W::load(&COUNT) * step + (first as f64 - place) * step)
}

/// `e^{−u²/2}`.
#[inline(always)]
fn bell<W: Wide>(u: W) -> W {
    exp(u * u * -0.5)
}

/// Adds `Σₖ e^{−u²/2}` of a chunk of samples at every node; `sum` has eight nodes to spare.
struct Spread<'a> {
    nodes: Nodes,
    x: &'a [f64],
    bandwidth: f64,
    sum: &'a mut [f64],
}

impl Pass for Spread<'_> {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(self) {
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

/// For each sample of a chunk `Σₘ wₘ e^{−u²/2} u` over the nodes, and over all of them
/// `Σ wₘ e^{−u²/2} (u² − 1)`; `weights` has eight zeros to spare.
///
/// Lanes are left apart: a sum over them in here would be vectorised in place of the loop.
struct Gather<'a> {
    nodes: Nodes,
    x: &'a [f64],
    bandwidth: f64,
    weights: &'a [f64],
    slopes: &'a mut [Lanes],
    widths: &'a mut Lanes,
}

impl Pass for Gather<'_> {
    type Output = ();

    #[inline(always)]
    fn run<W: Wide>(self) {
        let stride = WIDTH as f64 * self.nodes.spacing / self.bandwidth;
        let mut widths = W::of(0.0);
        for (&x, slope) in self.x.iter().zip(self.slopes) {
            let (first, lanes, mut u) = reach::<W>(&self.nodes, x, self.bandwidth);
            let mut sum = W::of(0.0);
            let (blocks, _) = self.weights[first..].as_chunks::<WIDTH>();
            for block in blocks.iter().take(lanes) {
                let felt = bell(u) * W::load(&Lanes::new(*block));
                sum += felt * u;
                widths += felt * (u * u - 1.0);
                u = u + stride;
            }
            *slope = sum.store();
        }
        *self.widths = widths.store();
    }
}
