//! Random solenoidal velocities with a given energy spectrum.

use super::VelocityField;
use crate::random::{Stream, stream};
use crate::scene::{Requirement, Scene};
use crate::space::Space;
use crate::vector::Vector;
use crate::waves::{Wave, Waves, direction, wave_vectors};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::f64::consts::TAU;

/// A sum of Fourier waves with random phases and directions, each perpendicular to its wave vector,
/// so that the field has zero divergence (Rogallo 1981, NASA TM-81315; in two dimensions the waves
/// of a stream function).
///
/// `E(k)` is the shell sum of [`crate::statistics::energy_spectrum`]: the energy of all waves with
/// `k − ½ <= |n| < k + ½`, `n` in units of `2π/L`, and `Σ E(k) = ½⟨|u|²⟩`. Waves of a shell share
/// its energy equally, so that each shell has exactly its `E(k)`, not only on average over seeds.
/// `initial.velocity` is `u' = √(2 Σ E(k)/d)`, the rms of a component over the box and over the
/// axes. On an unperturbed lattice the mean over the particles is the same to round-off; otherwise
/// it differs by sampling.
///
/// The field depends on the seed only, not on the number of particles. With a larger `largest` the
/// long waves keep their phases and directions: a finer run starts from the same flow. The sum
/// costs about six nanoseconds per wave and particle, so that waves are limited to `k <= 64` in two
/// dimensions (6,500 waves) and 16 in three (9,400): at the limit about half a second per ten
/// thousand particles on one core.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RandomSolenoidal {
    /// `E(k)` up to a factor.
    pub spectrum: Spectrum,
}

/// An energy spectrum up to a factor, by shells `k` in units of `2π/L`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind", deny_unknown_fields)]
pub enum Spectrum {
    /// `E ∝ κ⁴/(5/12 + κ²)^{17/6}` with `κ = k/peak`: rises as `k⁴`, is largest at `peak` and falls as
    /// `k^{−5/3}` (von Kármán 1948, doi:10.1073/pnas.34.11.530). For turbulence.
    VonKarman {
        /// Shell of the maximum.
        peak: f64,
        /// The last shell.
        largest: i64,
    },
    /// `E ∝ k^exponent`.
    PowerLaw {
        /// The exponent, −5/3 for an inertial range.
        exponent: f64,
        /// The first shell.
        #[serde(default = "first")]
        smallest: i64,
        /// The last shell.
        largest: i64,
    },
    /// The same energy in every shell.
    Band {
        /// The first shell.
        #[serde(default = "first")]
        smallest: i64,
        /// The last shell.
        largest: i64,
    },
}

fn first() -> i64 {
    1
}

impl Spectrum {
    /// First and last shell.
    fn shells(&self) -> (i64, i64) {
        match *self {
            Self::VonKarman { largest, .. } => (1, largest),
            Self::PowerLaw { smallest, largest, .. } | Self::Band { smallest, largest } => {
                (smallest, largest)
            }
        }
    }

    /// Whether its numbers are in their ranges, see [`RandomSolenoidal`].
    pub(crate) fn is_usable(&self, dimension: usize) -> bool {
        let (smallest, largest) = self.shells();
        let of_kind = match *self {
            Self::VonKarman { peak, .. } => (1.0..=largest as f64).contains(&peak),
            Self::PowerLaw { exponent, .. } => exponent.abs() <= 20.0,
            Self::Band { .. } => true,
        };
        (1..=limit(dimension)).contains(&largest) && (1..=largest).contains(&smallest) && of_kind
    }

    /// `E(k)` up to a factor.
    fn shape(&self, k: f64) -> f64 {
        match *self {
            Self::VonKarman { peak, .. } => {
                let square = (k / peak) * (k / peak);
                square * square * (5.0 / 12.0 + square).powf(-17.0 / 6.0)
            }
            Self::PowerLaw { exponent, .. } => k.powf(exponent),
            Self::Band { .. } => 1.0,
        }
    }

    /// `E(k)` of unit `u'`: entry `k` is shell `k`, their sum is `d/2`.
    pub fn energies(&self, dimension: usize) -> Vec<f64> {
        let (smallest, largest) = self.shells();
        let shape = |k: i64| if k < smallest.max(1) { 0.0 } else { self.shape(k as f64) };
        let shapes: Vec<f64> = (0..=largest).map(shape).collect();
        let factor = 0.5 * dimension as f64 / shapes.iter().sum::<f64>();
        shapes.into_iter().map(|shape| factor * shape).collect()
    }
}

/// Largest wave number in a dimension.
fn limit(dimension: usize) -> i64 {
    if dimension == 2 { 64 } else { 16 }
}

impl RandomSolenoidal {
    /// The waves of a scene's seed, box and dimension, of unit `u'`.
    pub fn waves(&self, scene: &Scene) -> Waves {
        self.waves_in(scene.dimension, scene.space(), scene.seed)
    }

    /// The waves of a dimension, box and seed, of unit `u'`.
    pub fn waves_in(&self, dimension: usize, space: Space, seed: u64) -> Waves {
        let energies = self.spectrum.energies(dimension);
        let largest = energies.len() as f64 - 0.5;
        let vectors = wave_vectors(dimension, largest);
        let shell = |n: &[i32; 3]| length(n.map(f64::from)).round() as usize;
        let mut count = vec![0.0; energies.len()];
        vectors.iter().for_each(|n| count[shell(n)] += 1.0);
        let mut generator = stream(seed, Stream::Field);
        let waves = vectors.into_iter().map(|n| {
            let shell = shell(&n);
            // A wave of amplitude A has the energy A²/4. Waves of zero energy are drawn as well, so
            // that the others do not change.
            let amplitude = 2.0 * (energies[shell] / count[shell]).sqrt();
            let (cosine, sine) = random_directions(direction(n, space), dimension, &mut generator);
            Wave { n, cosine: cosine.map(|x| amplitude * x), sine: sine.map(|x| amplitude * x) }
        });
        Waves::new(space, waves.collect())
    }
}

fn length(n: [f64; 3]) -> f64 {
    glam::DVec3::from_array(n).length()
}

/// Real part and minus the imaginary part of a random complex vector of unit length perpendicular to
/// the wave vector along `n`:
/// the amplitudes of cosine and sine.
fn random_directions(
    n: [f64; 3],
    dimension: usize,
    generator: &mut ChaCha8Rng,
) -> ([f64; 3], [f64; 3]) {
    let n = glam::DVec3::from_array(n).normalize();
    let mut angle = || TAU * generator.random::<f64>();
    if dimension == 2 {
        let (across, phase) = (glam::DVec3::new(-n.y, n.x, 0.0), angle());
        return ((across * phase.cos()).to_array(), (across * -phase.sin()).to_array());
    }
    let (first, second) = n.any_orthonormal_pair();
    let (split, one, two) = (angle(), angle(), angle());
    let (first, second) = (first * split.cos(), second * split.sin());
    let cosine = first * one.cos() + second * two.cos();
    let sine = first * one.sin() + second * two.sin();
    (cosine.to_array(), (-sine).to_array())
}

impl VelocityField for RandomSolenoidal {
    fn requirements(&self, scene: &Scene) -> Vec<Requirement> {
        let (smallest, largest) = self.spectrum.shells();
        let fewest = scene.lattice()[..scene.dimension.min(3)].iter().min().copied().unwrap_or(0);
        let resolved = 2 * i128::from(largest) < fewest as i128;
        let (peak, exponent) = match self.spectrum {
            Spectrum::VonKarman { peak, .. } => (peak, 0.0),
            Spectrum::PowerLaw { exponent, .. } => (1.0, exponent),
            Spectrum::Band { .. } => (1.0, 0.0),
        };
        vec![
            (
                (1..=limit(scene.dimension)).contains(&largest) && resolved,
                "initial.field.spectrum.largest",
                "a wave number of at least 1 and less than half the particles a side, at most 64 in 2D and 16 in 3D",
                format!("{largest} with {fewest} particles a side"),
            ),
            (
                (1..=largest).contains(&smallest),
                "initial.field.spectrum.smallest",
                "a wave number between 1 and spectrum.largest",
                smallest.to_string(),
            ),
            (
                (1.0..=largest as f64).contains(&peak),
                "initial.field.spectrum.peak",
                "a wave number between 1 and spectrum.largest",
                format!("{peak}"),
            ),
            (
                exponent.abs() <= 20.0,
                "initial.field.spectrum.exponent",
                "a number between -20 and 20",
                format!("{exponent}"),
            ),
        ]
    }

    fn velocities<const D: usize>(
        &self,
        scene: &Scene,
        positions: &[Vector<f64, D>],
        _: &mut ChaCha8Rng,
    ) -> Vec<Vector<f64, D>> {
        let waves = self.waves(scene);
        let at = |r: &Vector<f64, D>| waves.at::<D>(r.to_3d()) * scene.initial.velocity;
        positions.par_iter().map(at).collect()
    }
}
