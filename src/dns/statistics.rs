//! What is measured of the flow.

use super::modes::{Modes, weight};
use crate::error::{Error, Result};
use std::f64::consts::FRAC_PI_2;

/// Statistics of a velocity field of mean zero; the mean velocity is left out of all of them.
#[derive(Clone, Debug, PartialEq)]
pub struct Statistics {
    /// Kinetic energy per unit mass `E = ½⟨|u|²⟩`.
    pub energy: f64,
    /// Dissipation per unit mass `ε = ν Σ k² |û|²`.
    pub dissipation: f64,
    /// Power of the forcing per unit mass, `⟨u·f⟩`.
    pub power: f64,
    /// `u' = √(2E/D)`, the rms of a component.
    pub velocity: f64,
    /// Taylor's micro-scale `λ = √(D(D + 2) ν u'²/ε)`: the 15 of three dimensions is 8 in two.
    pub taylor_length: f64,
    /// `Re_λ = u' λ/ν`.
    pub reynolds: f64,
    /// Kolmogorov's length `η = (ν³/ε)^¼`.
    pub kolmogorov_length: f64,
    /// `k_max η` with the largest wave number that the mesh keeps.
    pub resolution: f64,
    /// `L_int = π/(2u'²) Σ E(k)/k` in three dimensions, `2/u'² Σ E(k)/k` in two, with the `k` of each wave.
    pub integral_length: f64,
    /// `u'²/ε`.
    pub eddy_time: f64,
    /// `E(k)`: energy of the shell `k − ½ <= |n| < k + ½`, `n` in units of `2π/L`; `Σ E(k) = E`.
    pub spectrum: Vec<f64>,
}

/// Below this `k_max η` a flow is not resolved.
const REFUSED: f64 = 1.0;

/// Below this `k_max η` velocities are resolved, but not their gradients.
const ADVISED: f64 = 1.5;

impl Statistics {
    pub(super) fn of<const D: usize>(modes: &Modes<D>, nu: f64, power: f64) -> Self {
        let layout = modes.layout();
        let k = layout.wave_number();
        let farthest = layout.largest as f64 * (D as f64).sqrt();
        let mut spectrum = vec![0.0; farthest.round() as usize + 1];
        let (mut square, mut slopes, mut lengths) = (0.0, 0.0, 0.0);
        for (slot, n) in layout.slots().filter(|(_, n)| n.iter().any(|&n| n != 0)) {
            let parts = modes.at(slot).into_iter().flatten();
            let energy = 0.5 * weight(n) * parts.map(|x| x * x).sum::<f64>();
            let length = n.iter().map(|&n| f64::from(n) * f64::from(n)).sum::<f64>().sqrt();
            spectrum[length.round() as usize] += energy;
            square += 2.0 * energy;
            slopes += 2.0 * energy * (k * length) * (k * length);
            lengths += energy / (k * length);
        }
        let dissipation = nu * slopes;
        let component = square / D as f64;
        let velocity = component.sqrt();
        let factor = if D == 3 { FRAC_PI_2 } else { 2.0 };
        let taylor_length = ((D * (D + 2)) as f64 * nu * component / dissipation).sqrt();
        let kolmogorov_length = (nu.powi(3) / dissipation).sqrt().sqrt();
        Self {
            energy: 0.5 * square,
            dissipation,
            power,
            velocity,
            taylor_length,
            reynolds: velocity * taylor_length / nu,
            kolmogorov_length,
            resolution: k * layout.largest as f64 * kolmogorov_length,
            integral_length: factor / component * lengths,
            eddy_time: component / dissipation,
            spectrum,
        }
    }

    /// All but the spectrum, by name.
    pub fn named(&self) -> Vec<(&'static str, f64)> {
        vec![
            ("energy", self.energy),
            ("dissipation", self.dissipation),
            ("power", self.power),
            ("velocity", self.velocity),
            ("taylor_length", self.taylor_length),
            ("reynolds", self.reynolds),
            ("kolmogorov_length", self.kolmogorov_length),
            ("resolution", self.resolution),
            ("integral_length", self.integral_length),
            ("eddy_time", self.eddy_time),
        ]
    }

    /// Refuses a field at rest and a flow with `k_max η < 1`; below 1.5 returns a warning.
    ///
    /// # Errors
    /// [`Error::Input`].
    pub fn check_resolution(&self) -> Result<Option<String>> {
        let found = format!("k_max η = {:.2}", self.resolution);
        let remedy = "take more nodes, a larger viscosity or less power";
        if self.dissipation <= 0.0 {
            let remedy = "start from a field that is not uniform";
            return Err(Error::input("dns.start", "a flow that moves", "a field at rest", remedy));
        }
        if self.resolution < REFUSED {
            let expected = format!("a flow that the mesh resolves, k_max η >= {REFUSED}");
            return Err(Error::input("dns.nodes", expected, found, remedy));
        }
        let warn = || format!("{found} is below {ADVISED}: gradients are not resolved; {remedy}");
        Ok((self.resolution < ADVISED).then(warn))
    }
}

/// `⟨g³⟩/⟨g²⟩^{3/2}` of numbers.
pub(super) fn skewness(numbers: impl Iterator<Item = f64>) -> f64 {
    let (mut count, mut squares, mut cubes) = (0.0, 0.0, 0.0);
    for x in numbers {
        count += 1.0;
        squares += x * x;
        cubes += x * x * x;
    }
    let width = (squares / count).sqrt();
    if width > f64::MIN_POSITIVE { cubes / count / (width * width * width) } else { 0.0 }
}
