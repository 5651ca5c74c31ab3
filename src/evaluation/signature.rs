//! Statistics of a flow: of single particles, of pairs, and of its velocity field.

use super::{Rollout, SampleTimes};
use crate::error::Result;
use crate::losses::{Density1d, Mesh};
use crate::scene::Scene;
use crate::statistics::{
    Displacement, Moments, Structure, close_pairs, energy_spectrum, pair_dispersion,
    structure_functions,
};
use crate::truth::velocity_field;
use crate::vector::Vector;

/// Number of last marks over which field statistics are averaged.
const AVERAGED: usize = 5;

/// Number of nodes of a density of increments or accelerations.
const NODES: usize = 101;

/// The statistics of one course. The first group has one entry per mark after the first.
#[derive(Clone, Debug, Default)]
pub struct FlowStatistics {
    /// Variance of `δu(τ)`, mean over components.
    pub variance: Vec<f64>,
    /// Flatness of `δu(τ)`, mean over components: 3 for a normal distribution.
    pub flatness: Vec<f64>,
    /// `⟨|r(τ) − r(0)|²⟩`.
    pub displacement: Vec<f64>,
    /// `⟨|Δr(τ) − Δr(0)|²⟩` of pairs that began as neighbours.
    pub dispersion: Vec<f64>,
    /// `E(k)` for `k = 1, 2, …, n/2`.
    pub spectrum: Vec<f64>,
    /// Structure functions by distance.
    pub structure: Vec<Structure>,
    /// Components of `δu` at the last mark.
    pub increments: Vec<f64>,
    /// Components of the accelerations at the last mark.
    pub accelerations: Vec<f64>,
}

impl FlowStatistics {
    /// Of a course, up to its divergence.
    pub fn of<const D: usize>(scene: &Scene, course: &Rollout<D>) -> Self {
        let (Some(first), Some(last)) = (course.states.first(), course.states.last()) else {
            return Self::default();
        };
        let mut signature = Self::default();
        let space = scene.space();
        let spacing = space.spacing::<D>(first.positions.len());
        let pairs = close_pairs(&first.positions, space, 1.2 * spacing);
        let mut displacement = Displacement::new(space, &first.positions);
        for state in &course.states[1..] {
            let moments: Vec<Moments> = (0..D)
                .map(|axis| Moments::of(increments(&first.velocities, &state.velocities, axis)))
                .collect();
            let mean = |of: fn(&Moments) -> f64| moments.iter().map(of).sum::<f64>() / D as f64;
            signature.variance.push(mean(|m| m.variance));
            signature.flatness.push(mean(|m| m.flatness));
            displacement.follow(&state.positions);
            signature.displacement.push(displacement.mean_square());
            signature.dispersion.push(pair_dispersion(&pairs, displacement.travelled()));
        }
        if course.diverged.is_none() {
            let all = |axis| increments(&first.velocities, &last.velocities, axis);
            signature.increments = (0..D).flat_map(all).collect();
            signature.accelerations = course.accelerations.iter().flat_map(|a| a.0).collect();
            signature.fields(scene, course);
        }
        signature
    }

    /// Spectrum and structure functions, means over the last marks.
    fn fields<const D: usize>(&mut self, scene: &Scene, course: &Rollout<D>) {
        let mesh = Mesh::of_particles(scene.space(), scene.particles());
        let late = course.states.len().saturating_sub(AVERAGED).max(1);
        let states = course.states.iter().zip(&course.densities).skip(late);
        let share = 1.0 / states.len().max(1) as f64;
        for (state, densities) in states {
            let field = velocity_field(scene, &mesh, state, densities);
            let spectrum = energy_spectrum(&mesh, &field);
            let structure = structure_functions(&mesh, &field);
            if !spectrum.is_empty() {
                let shells = mesh.per_axis.iter().max().map_or(0, |n| n / 2);
                self.spectrum.resize(shells, 0.0);
            }
            // The first entry is the mean flow.
            let shells = self.spectrum.iter_mut().zip(spectrum.iter().skip(1));
            shells.for_each(|(mean, now)| *mean += share * now);
            if self.structure.is_empty() {
                self.structure = structure.iter().map(|s| s.scaled(0.0)).collect();
            }
            let distances = self.structure.iter_mut().zip(&structure);
            distances.for_each(|(mean, now)| mean.add(&now.scaled(share)));
        }
    }
}

fn increments<const D: usize>(
    from: &[Vector<f64, D>],
    to: &[Vector<f64, D>],
    axis: usize,
) -> impl Iterator<Item = f64> + Clone {
    to.iter().zip(from).map(move |(v, start)| v[axis] - start[axis])
}

/// Distances of statistics from those of the truth: root-mean-square logarithms of ratios, so that
/// `0.1` means ten per cent. NaN for a flow that diverged.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Distance {
    /// Of the displacement by time.
    pub displacement: f64,
    /// Of the pair dispersion by time.
    pub dispersion: f64,
    /// Of the flatness of increments by time.
    pub flatness: f64,
    /// Of the variance of accelerations.
    pub acceleration: f64,
    /// Of the energy spectrum by wavenumber.
    pub spectrum: f64,
    /// Of `S₂` by distance.
    pub structure: f64,
}

impl Distance {
    /// Between two signatures at the same marks.
    pub fn between(model: &FlowStatistics, truth: &FlowStatistics) -> Self {
        let second = |s: &FlowStatistics| s.structure.iter().map(|s| s.second).collect::<Vec<_>>();
        let square =
            |s: &FlowStatistics| vec![Moments::of(s.accelerations.iter().copied()).variance];
        Self {
            displacement: logarithmic(&model.displacement, &truth.displacement),
            dispersion: logarithmic(&model.dispersion, &truth.dispersion),
            flatness: logarithmic(&model.flatness, &truth.flatness),
            acceleration: logarithmic(&square(model), &square(truth)),
            spectrum: logarithmic(&model.spectrum, &truth.spectrum),
            structure: logarithmic(&second(model), &second(truth)),
        }
    }
}

/// `√⟨(ln a/b)²⟩`; NaN for different lengths.
fn logarithmic(a: &[f64], b: &[f64]) -> f64 {
    if a.len() != b.len() || a.is_empty() {
        return f64::NAN;
    }
    let squares = a.iter().zip(b).map(|(a, b)| (a / b).ln().powi(2));
    (squares.sum::<f64>() / a.len() as f64).sqrt()
}

/// A kernel density estimate, on nodes that all compared samples share.
pub(super) struct KernelDensities {
    /// Positions of the nodes.
    pub(super) nodes: Vec<f64>,
    density: Density1d,
}

impl KernelDensities {
    /// On the nodes of the truth's samples.
    pub(super) fn new(truth: &[f64]) -> Result<Self> {
        let density = Density1d::new(truth, NODES)?;
        Ok(Self { nodes: density.nodes().collect(), density })
    }

    /// The density of samples; empty where one is not finite.
    pub(super) fn of(&self, samples: &[f64]) -> Vec<f64> {
        let found = self.density.log_density_of(samples);
        found.map(|log| log.into_iter().map(f64::exp).collect()).unwrap_or_default()
    }
}

/// Times of the marks after the first, in steps.
pub(super) fn later(marks: SampleTimes) -> Vec<f64> {
    marks.marked().skip(1).map(|step| step as f64).collect()
}
