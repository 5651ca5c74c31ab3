//! The statistical loss `L_kl`: the distribution of velocity increments, compared with the truth's.

mod bells;

use crate::error::{Error, Result};
use crate::vector::Vector;
use bells::KdeGrid;
use std::f64::consts::TAU;

/// Weight `ε` of the floor in every density, see [`Density1d`].
const FLOOR: f64 = 1e-12;
/// Widening of the floor's variance, as a share of the truth's variance, so that samples without
/// spread have a floor.
const FLOOR_WIDENING: f64 = 0.01;
/// Standard deviation of the truth, minimum, as a share of `1 + max |x|`.
const SMALLEST_SPREAD: f64 = 1e-9;
/// Number of nodes of a density, minimum.
pub const FEWEST_NODES: usize = 16;

/// The kernel density estimate of the true increments of one component, with which predictions are
/// compared.
///
/// `G(x) = (1 − ε) (1/N b) Σₖ φ((x − xₖ)/b) + ε N(x; mean, variance)` with `φ = e^{−u²/2}/√2π`,
/// bandwidth `b = 0.9 std N^{−1/5}` (Silverman 1986) and `ε = 1e-12`. The second term is the floor.
/// Where a prediction has no sample within about seven bandwidths, its density becomes `ε` times
/// the normal density of its own mean and variance. The loss of disjoint samples is therefore
/// finite: `ln 1/ε` plus the divergence of the two normal densities, with a gradient towards the
/// true mean and variance.
///
/// The nodes are uniform, from five bandwidths below the lowest sample to five above the highest,
/// and depend on the truth alone. Beyond them the integrand `G ln(G/Ĝ)` is zero for any prediction,
/// so that nothing is lost, and the gradient needs no derivative by a node.
///
/// Samples without spread: the truth's standard deviation is taken as at least `1e-9 (1 + max
/// |x|)`. No bandwidth is less than half the spacing of the nodes, because the sum would miss a
/// sample between two nodes.
#[derive(Clone, Debug)]
pub struct Density1d {
    nodes: KdeGrid,
    /// Added to every variance to give the floor's variance.
    widening: f64,
    /// `ln G` at the nodes.
    log_density: Vec<f64>,
    /// `G` times the trapezoidal weight.
    mass: Vec<f64>,
}

/// A loss and its derivatives by every predicted sample, which is a number or a vector.
#[derive(Clone, Debug, PartialEq)]
pub struct IncrementLoss<G = f64> {
    /// The divergence, in nats.
    pub value: f64,
    /// `∂value/∂sample`, sample by sample.
    pub gradient: Vec<G>,
}

/// Samples and the parameters of their density.
#[derive(Clone, Copy, Debug)]
struct Samples<'a> {
    x: &'a [f64],
    mean: f64,
    /// With `N − 1`.
    variance: f64,
    bandwidth: f64,
    /// Whether the bandwidth depends on the standard deviation.
    follows: bool,
    /// Variance of the floor.
    floor: f64,
}

/// Mean and variance (with `N − 1`; zero for one sample).
fn moments(x: &[f64]) -> Result<(f64, f64)> {
    let count = x.len() as f64;
    let mean = x.iter().sum::<f64>() / count;
    let squares: f64 = x.iter().map(|x| (x - mean) * (x - mean)).sum();
    let variance = squares / (count - 1.0).max(1.0);
    if x.is_empty() || !variance.is_finite() {
        return Err(Error::input(
            "increments",
            "at least one sample, every one finite, and a finite variance",
            format!("{} samples of mean {mean} and variance {variance}", x.len()),
            "check that the run did not diverge",
        ));
    }
    Ok((mean, variance))
}

/// Silverman's rule.
fn silverman(deviation: f64, count: usize) -> f64 {
    0.9 * deviation * (count as f64).powf(-0.2)
}

impl<'a> Samples<'a> {
    fn new(x: &'a [f64], nodes: &KdeGrid, widening: f64) -> Result<Self> {
        let (mean, variance) = moments(x)?;
        let wanted = silverman(variance.sqrt(), x.len());
        let narrowest = 0.5 * nodes.spacing;
        Ok(Self {
            x,
            mean,
            variance,
            bandwidth: wanted.max(narrowest),
            follows: wanted > narrowest,
            floor: variance + widening,
        })
    }

    /// `(1 − ε)/(N b √2π)`: the contribution of a sample to the density at its own place.
    fn peak(&self) -> f64 {
        (1.0 - FLOOR) / (self.x.len() as f64 * self.bandwidth * TAU.sqrt())
    }

    /// `ln` of the floor at `x`.
    fn log_floor(&self, x: f64) -> f64 {
        let away = x - self.mean;
        FLOOR.ln() - 0.5 * (away * away / self.floor + (TAU * self.floor).ln())
    }
}

impl KdeGrid {
    /// `ln G` and the logarithm of its floor at every node. In log space neither underflows.
    fn log_densities(&self, samples: &Samples<'_>) -> Vec<(f64, f64)> {
        let peak = samples.peak().ln();
        let bells = self.bells(samples.x, samples.bandwidth).into_iter().enumerate();
        let log = bells.map(|(node, bells)| {
            let floor = samples.log_floor(self.at(node));
            let kernels = peak + bells.ln();
            let (low, high) = if kernels < floor { (kernels, floor) } else { (floor, kernels) };
            (high + (low - high).exp().ln_1p(), floor)
        });
        log.collect()
    }
}

impl Density1d {
    /// The density of `truth` on `nodes` nodes; Woodward et al. (arXiv:2110.13311) use 200.
    ///
    /// # Errors
    /// [`Error::Input`] for no sample, one that is not finite, or fewer than 16 nodes.
    pub fn new(truth: &[f64], nodes: usize) -> Result<Self> {
        if nodes < FEWEST_NODES {
            let expected = format!("at least {FEWEST_NODES} nodes");
            return Err(Error::input("loss", expected, nodes, "200 are the paper's"));
        }
        let (_, variance) = moments(truth)?;
        let size = truth.iter().fold(0.0, |size: f64, x| size.max(x.abs()));
        let deviation = variance.sqrt().max(SMALLEST_SPREAD * (1.0 + size));
        let widening = FLOOR_WIDENING * deviation * deviation;
        let nodes = KdeGrid::new(truth, silverman(deviation, truth.len()), nodes);
        let samples = Samples::new(truth, &nodes, widening)?;
        let log_density: Vec<f64> =
            nodes.log_densities(&samples).into_iter().map(|(log, _)| log).collect();
        let mut mass: Vec<f64> = log_density.iter().map(|log| nodes.spacing * log.exp()).collect();
        mass[0] *= 0.5;
        mass[nodes.count - 1] *= 0.5;
        Ok(Self { nodes, widening, log_density, mass })
    }

    /// The positions of the nodes, `[nodes]`.
    pub fn nodes(&self) -> impl Iterator<Item = f64> + '_ {
        (0..self.nodes.count).map(|node| self.nodes.at(node))
    }

    /// `ln G` at the nodes, `[nodes]`.
    pub fn log_density(&self) -> &[f64] {
        &self.log_density
    }

    /// `ln Ĝ` of other samples at the same nodes.
    ///
    /// # Errors
    /// [`Error::Input`] for no sample or one that is not finite.
    pub fn log_density_of(&self, samples: &[f64]) -> Result<Vec<f64>> {
        let samples = Samples::new(samples, &self.nodes, self.widening)?;
        Ok(self.nodes.log_densities(&samples).into_iter().map(|(log, _)| log).collect())
    }

    /// The forward divergence `∫ G ln(G/Ĝ) dx` by the trapezoidal rule, and its exact derivatives
    /// by the predicted samples, including those through bandwidth and floor.
    ///
    /// It is zero for the truth itself, and never below `−1e-6`. With `cₘ`, the trapezoidal weight
    /// times `G/Ĝ` at node `m`: `∂L/∂x̂ₖ = −Σₘ cₘ ∂Ĝₘ/∂x̂ₖ`, where
    /// `∂b/∂x̂ₖ = b (x̂ₖ − mean)/((N − 1) variance)`.
    ///
    /// # Errors
    /// [`Error::Input`] for no sample or one that is not finite.
    pub fn loss(&self, predicted: &[f64]) -> Result<IncrementLoss> {
        let samples = Samples::new(predicted, &self.nodes, self.widening)?;
        let logs = self.nodes.log_densities(&samples);
        let truth = self.mass.iter().zip(&self.log_density);
        let value = truth.zip(&logs).map(|((m, truth), (log, _))| m * (truth - log)).sum();
        let (mut gradient, by_bandwidth) = self.by_kernels(&samples, &logs);
        let (by_mean, by_variance) = self.by_floor(&samples, &logs);
        let count = predicted.len() as f64;
        let mut stretch = 2.0 * by_variance / (count - 1.0).max(1.0);
        if samples.follows {
            stretch += by_bandwidth * samples.bandwidth / ((count - 1.0) * samples.variance);
        }
        for (slope, x) in gradient.iter_mut().zip(predicted) {
            *slope += by_mean / count + stretch * (x - samples.mean);
        }
        Ok(IncrementLoss { value, gradient })
    }

    /// `∂L/∂x̂ₖ` at fixed bandwidth and floor, and `∂L/∂b`.
    fn by_kernels(&self, samples: &Samples<'_>, logs: &[(f64, f64)]) -> (Vec<f64>, f64) {
        let scale = samples.peak() / samples.bandwidth;
        // Where no sample contributes, the exponential may overflow; the weight there is zero.
        let weight = |(&mass, &(log, floor)): (&f64, &(f64, f64))| {
            if log > floor { -mass * (scale.ln() - log).exp() } else { 0.0 }
        };
        let weights: Vec<f64> = self.mass.iter().zip(logs).map(weight).collect();
        self.nodes.gather(samples.x, samples.bandwidth, &weights)
    }

    /// `∂L/∂mean` and `∂L/∂variance` of the floor.
    fn by_floor(&self, samples: &Samples<'_>, logs: &[(f64, f64)]) -> (f64, f64) {
        let (mut by_mean, mut by_variance) = (0.0, 0.0);
        for (node, (mass, (log, floor))) in self.mass.iter().zip(logs).enumerate() {
            let share = mass * (floor - log).exp();
            let away = self.nodes.at(node) - samples.mean;
            by_mean -= share * away / samples.floor;
            by_variance -= share * 0.5 * (away * away / samples.floor - 1.0) / samples.floor;
        }
        (by_mean, by_variance)
    }
}

/// The divergence of predicted from true increments of one component: [`Density1d::loss`].
///
/// # Errors
/// As [`Density1d::new`] and [`Density1d::loss`].
pub fn increment_loss(truth: &[f64], predicted: &[f64], nodes: usize) -> Result<IncrementLoss> {
    Density1d::new(truth, nodes)?.loss(predicted)
}

/// The densities of true increments, one per component; computed once and compared with every
/// prediction.
#[derive(Clone, Debug)]
pub struct IncrementDensities<const D: usize> {
    components: Vec<Density1d>,
}

/// One component of every vector.
fn component<const D: usize>(vectors: &[Vector<f64, D>], axis: usize) -> Vec<f64> {
    vectors.iter().map(|v| v[axis]).collect()
}

impl<const D: usize> IncrementDensities<D> {
    /// From the increments `δu(τ) = u(τ) − u(0)` of every particle.
    ///
    /// # Errors
    /// As [`Density1d::new`].
    pub fn new(truth: &[Vector<f64, D>], nodes: usize) -> Result<Self> {
        let one = |axis| Density1d::new(&component(truth, axis), nodes);
        Ok(Self { components: (0..D).map(one).collect::<Result<_>>()? })
    }

    /// The densities, component by component.
    pub fn components(&self) -> &[Density1d] {
        &self.components
    }

    /// `L_kl`: the sum over the components of [`Density1d::loss`].
    ///
    /// # Errors
    /// As [`Density1d::loss`].
    pub fn loss(&self, predicted: &[Vector<f64, D>]) -> Result<IncrementLoss<Vector<f64, D>>> {
        let mut sum = IncrementLoss { value: 0.0, gradient: vec![Vector::zero(); predicted.len()] };
        for (axis, density) in self.components.iter().enumerate() {
            let one = density.loss(&component(predicted, axis))?;
            sum.value += one.value;
            for (sum, slope) in sum.gradient.iter_mut().zip(one.gradient) {
                sum[axis] = slope;
            }
        }
        Ok(sum)
    }
}

/// The mean divergence between different realisations of the same flow, over all ordered pairs: the
/// loss of a perfect model with other random numbers.
///
/// # Errors
/// [`Error::Input`] for fewer than two realisations, and as [`Density1d::new`].
pub fn sampling_floor(realisations: &[&[f64]], nodes: usize) -> Result<f64> {
    if realisations.len() < 2 {
        let found = realisations.len();
        return Err(Error::input("sampling floor", "two realisations", found, "add more seeds"));
    }
    let mut sum = 0.0;
    for (k, truth) in realisations.iter().enumerate() {
        let density = Density1d::new(truth, nodes)?;
        for (other, predicted) in realisations.iter().enumerate() {
            if other != k {
                sum += density.loss(predicted)?.value;
            }
        }
    }
    Ok(sum / (realisations.len() * (realisations.len() - 1)) as f64)
}
