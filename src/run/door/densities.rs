//! Compares densities of input data with those that the particles have in a kernel.

use super::Findings;
use crate::error::Result;
use crate::kernel::KernelChoice;
use crate::scene::Scene;
use crate::space::Space;
use crate::truth::{Truth, summed_densities};

/// A kernel with its smoothing length.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Kernel {
    /// The kernel.
    pub(crate) kernel: KernelChoice,
    /// `h`.
    pub(crate) h: f64,
}

impl Kernel {
    /// That of a scene.
    pub(crate) fn of(scene: &Scene) -> Self {
        Self { kernel: scene.fluid.kernel, h: scene.fluid.smoothing_length }
    }
}

/// Relative difference below which densities are equal to round-off, at worst of single precision:
/// the recorded bits are kept.
const SINGLE: f64 = 1e-5;

/// Relative difference from which densities are refused: other units, or another reference density.
const UNITS: f64 = 0.05;

/// Root-mean-square relative difference from which densities are refused if it persists from frame
/// to frame: differences due to another kernel or `h` persist, those due to noise do not. In
/// `tests/door.rs`, a change of `h` by 1 % makes 7e-4, of which 97 % persists; of noise of 1 % of
/// the spacing nothing persists.
const LASTING: f64 = 1e-4;

/// Sums the densities of a truth that has none.
pub(crate) fn sum_where_missing<const D: usize>(
    truth: &mut Truth<D>,
    Kernel { kernel, h }: Kernel,
    space: Space,
) {
    for (state, densities) in truth.states.iter().zip(&mut truth.densities) {
        if densities.len() != state.positions.len() {
            *densities = summed_densities((kernel, h), space, &state.positions);
        }
    }
}

/// Uses the densities of the scene's kernel where densities are missing, all equal to one, or
/// slightly different.
///
/// # Errors
/// [`crate::Error::Input`] where the differences are those of other units, kernels or smoothing
/// lengths.
pub(crate) fn settle<const D: usize>(
    truth: &mut Truth<D>,
    kernel: Kernel,
    space: Space,
    findings: &mut Findings,
) -> Result<()> {
    let given = std::mem::take(&mut truth.densities);
    truth.densities = vec![Vec::new(); given.len()];
    sum_where_missing(truth, kernel, space);
    if given.iter().any(Vec::is_empty) {
        return Ok(());
    }
    let known = || given.iter().flatten().zip(truth.densities.iter().flatten());
    let differences: Vec<f64> = known().map(|(given, sum)| given / sum - 1.0).collect();
    let most = differences.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
    if most <= SINGLE {
        truth.densities = given;
        return Ok(());
    }
    if given.iter().flatten().all(|rho| rho.to_bits() == 1.0_f64.to_bits()) {
        findings.warn(
            "every density is 1, as where none was given; summed in the scene's kernel instead",
        );
        return Ok(());
    }
    judge(&given, &differences, findings)
}

/// Compares densities with the sum of the kernel that is given for the data or, without one, with
/// the reference density of 1.
///
/// # Errors
/// As [`settle`].
pub(crate) fn check<const D: usize>(
    truth: &Truth<D>,
    kernel: Option<Kernel>,
    space: Space,
    findings: &mut Findings,
) -> Result<()> {
    let Some(kernel) = kernel else {
        let usual = super::median(truth.densities.iter().flatten().copied().collect());
        if (0.5..2.0).contains(&usual) {
            return Ok(());
        }
        let found = format!("{usual:.6} usually");
        let remedy = format!(
            "divide them by {usual:.6} if they are in other units, or leave them out to have them summed"
        );
        return findings.refuse("densities about the reference density of 1", found, remedy);
    };
    settle(&mut truth.clone(), kernel, space, findings)
}

/// Describes the differences of densities from the sum of the kernel, `given/sum − 1` of every
/// particle in every frame.
fn judge(given: &[Vec<f64>], differences: &[f64], findings: &mut Findings) -> Result<()> {
    let count = differences.len() as f64;
    let mean = differences.iter().sum::<f64>() / count;
    let spread = (differences.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / count).sqrt();
    let middle = super::median(differences.to_vec());
    let expected = "densities Σ m W in the scene's kernel, at a reference density of 1";
    if middle.abs() > UNITS {
        let usual = super::median(given.iter().flatten().copied().collect());
        let found = format!("{:.6} times that; the usual density is {usual:.6}", 1.0 + middle);
        let remedy = format!(
            "divide them by {:.6} if they are in other units, or leave them out to have them summed",
            1.0 + middle
        );
        return findings.refuse(expected, found, remedy);
    }
    let particles = given.first().map_or(1, Vec::len).max(1);
    let size = mean.hypot(spread);
    if size > LASTING && lasts(differences, particles) {
        let found =
            format!("densities {:.3} % apart from it, lasting from frame to frame", 100.0 * size);
        let remedy = "set fluid.smoothing_length and fluid.kernel to those of the data";
        return findings.refuse(expected, found, remedy);
    }
    let (at, most) = differences.iter().enumerate().fold((0, 0.0_f64), |(at, most), (k, x)| {
        if x.abs() > most { (k, x.abs()) } else { (at, most) }
    });
    findings.warn(format!(
        "densities are not those that the scene's kernel sums: {most:.2e} apart at most (particle {} of frame {}), \
         {spread:.1e} usually; the summed ones are taken",
        at % particles,
        at / particles
    ));
    Ok(())
}

/// Whether the difference of a particle is similar in the next frame.
fn lasts(differences: &[f64], particles: usize) -> bool {
    let pairs = || differences.iter().zip(differences.iter().skip(particles));
    let both: f64 = pairs().map(|(now, next)| now * next).sum();
    let each: f64 = pairs().map(|(now, next)| 0.5 * (now * now + next * next)).sum();
    both > 0.5 * each
}
