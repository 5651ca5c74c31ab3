//! Whether a flow is turbulent: intensity, dissipation, scales and Reynolds number of its velocity field.
//!
//! All of them are of the field that the particles carry, smoothed over `h` (Eq. 13 of Woodward et al.,
//! arXiv:2110.13311), on a mesh of one node a particle. Definitions are those of Pope, *Turbulent Flows* (2000), ch. 6,
//! for isotropic flow; sums over wave vectors `k` with `û(k)`, the Fourier coefficients of `u − ū`:
//!
//! | quantity | formula |
//! |---|---|
//! | `u'` | `√(⟨\|u − ū\|²⟩/d)` |
//! | `ε` | `ν Σ k² \|û\|²` |
//! | `λ` | `u' √(15ν/ε)` in 3D, `u' √(8ν/ε)` in 2D |
//! | `Re_λ` | `u' λ/ν` |
//! | `L_int` | `π/(2u'²) Σ ½\|û\|²/k` in 3D, `2/u'² Σ ½\|û\|²/k` in 2D |
//! | `η` | `(ν³/ε)^¼` |
//! | eddy time | `L/(2π u')` ([`super::eddy_time`]) |

use super::momentum;
use super::spectrum::mode_sums;
use crate::flow::{Flow, State};
use crate::losses::Mesh;
use crate::models::{LaminarViscosity, ModelChoice};
use crate::scene::Scene;
use crate::truth::velocity_field;
use crate::viscosity::effective_nu;
use serde::Serialize;
use std::f64::consts::{PI, TAU};
use std::fmt::{self, Display};

/// Reynolds number `Re_λ` below which there is no range of scales between eddies and dissipation.
const FEWEST: f64 = 20.0;

/// Share of the kinetic energy in the smoothed field below which velocities are mostly disorder.
const MOSTLY: f64 = 0.5;

/// The viscosity with which a scene's flow dissipates, and how it is known.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ViscosityOf {
    /// Kinematic viscosity `ν`; none where it is unknown or zero.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub nu: Option<f64>,
    /// How it is known.
    pub known_by: String,
}

/// The viscosity of a scene: the laminar one that it asks for, plus that with which `α` acts ([`effective_nu`]). Learned
/// laws of which the forces are a network have an unknown one.
pub fn acting_viscosity(scene: &Scene) -> ViscosityOf {
    let model = scene.law.as_ref().map_or(ModelChoice::Physics, |law| law.model.clone());
    if !matches!(model, ModelChoice::Physics | ModelChoice::EosNn(_) | ModelChoice::GradP(_)) {
        let known_by = format!("unknown: the forces are those of {}", model.kind());
        return ViscosityOf { nu: None, known_by };
    }
    let fluid = &scene.fluid;
    let ratio = fluid.smoothing_length / scene.spacing();
    let laminar = fluid.viscosity.map_or(0.0, LaminarViscosity::nu);
    let artificial =
        effective_nu(scene.dimension, ratio, fluid.alpha * fluid.c * fluid.smoothing_length);
    let known_by = match (laminar > 0.0, artificial > 0.0) {
        (false, false) => "none: neither alpha nor a laminar viscosity".to_owned(),
        (true, false) => "the laminar viscosity of the scene".to_owned(),
        (false, true) => format!("alpha c h at h/spacing {ratio:.3}, by the measured table"),
        (true, true) => format!(
            "the laminar viscosity {laminar:.2e} of the scene and {artificial:.2e} of alpha, by the measured table"
        ),
    };
    let nu = Some(laminar + artificial).filter(|nu| *nu > 0.0);
    ViscosityOf { nu, known_by }
}

/// The scales of a flow's velocity field, in units of the scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Turbulence {
    /// `u'`, root mean square of one component of `u − ū`.
    pub u_rms: f64,
    /// Share of the particles' kinetic energy (without their mean motion) that is in the smoothed field; the rest is
    /// disorder on scales below `h`.
    pub resolved: f64,
    /// Root-mean-square speed of particles divided by `c`.
    pub mach: f64,
    /// The integral scale `L_int`.
    pub integral_scale: f64,
    /// The Taylor scale `λ`.
    pub taylor_scale: f64,
    /// The eddy time `L/(2π u')`.
    pub eddy_time: f64,
    /// The viscosity.
    pub viscosity: ViscosityOf,
    /// Dissipation `ε` per unit mass; none without a known viscosity.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dissipation: Option<f64>,
    /// `Re_λ`; none without a known viscosity.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub re_lambda: Option<f64>,
    /// The Kolmogorov scale over the particle spacing, `η/Δx`; none without a known viscosity.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub eta_over_spacing: Option<f64>,
}

impl Turbulence {
    /// Of a flow's current state; none for a flow at rest, and where an axis is open.
    pub fn of<const D: usize>(scene: &Scene, flow: &mut Flow<D>) -> Option<Self> {
        Self::of_state(scene, &flow.state(), &flow.densities())
    }

    /// Of a state with the densities of its particles, as in a recorded frame; none as above.
    pub(crate) fn of_state<const D: usize>(
        scene: &Scene,
        state: &State<D>,
        densities: &[f64],
    ) -> Option<Self> {
        let space = scene.space();
        if (0..D).any(|axis| !space.is_periodic(axis)) {
            return None;
        }
        let count = state.positions.len() as f64;
        let length = space.longest::<D>();
        let mesh = Mesh::<D>::of_particles(space, state.positions.len());
        let sums = mode_sums(&mesh, &velocity_field(scene, &mesh, state, densities));
        let mean = momentum(1.0 / count, &state.velocities);
        let squares = state.velocities.iter().map(|&v| (v - mean).norm_squared()).sum::<f64>();
        let all: f64 = state.velocities.iter().map(|v| v.norm_squared()).sum();
        let viscosity = acting_viscosity(scene);
        let wave = TAU / length;
        let gradient = 2.0 * wave * wave * sums.square_gradient;
        let u_rms = (2.0 * sums.energy / D as f64).sqrt();
        let isotropy = if D == 3 { 15.0 } else { 8.0 };
        let taylor_scale = u_rms * (isotropy / gradient).sqrt();
        let longitudinal = if D == 3 { 0.5 * PI } else { 2.0 };
        let integral_scale = longitudinal * sums.over_wavenumber / (wave * u_rms * u_rms);
        let dissipation = viscosity.nu.map(|nu| nu * gradient);
        let eta = |nu: f64| (nu * nu / gradient).powf(0.25);
        let spacing = (space.volume::<D>() / count).powf(1.0 / D as f64);
        let found = Self {
            u_rms,
            resolved: sums.energy * count / (0.5 * squares),
            mach: (all / count).sqrt() / scene.fluid.c,
            integral_scale,
            taylor_scale,
            eddy_time: length / (TAU * u_rms),
            dissipation,
            re_lambda: viscosity.nu.map(|nu| u_rms * taylor_scale / nu),
            eta_over_spacing: viscosity.nu.map(|nu| eta(nu) / spacing),
            viscosity,
        };
        [found.resolved, found.taylor_scale, found.integral_scale, found.eddy_time]
            .iter()
            .all(|x| x.is_finite())
            .then_some(found)
    }

    /// What the numbers mean.
    pub fn verdict(&self) -> String {
        let disorder = (self.resolved < MOSTLY).then(|| {
            format!(
                "{:.0} % of the kinetic energy is disorder of particles below h",
                100.0 * (1.0 - self.resolved)
            )
        });
        let scales = match self.re_lambda {
            None => Some("no Reynolds number without a known viscosity".to_owned()),
            Some(re) if re < FEWEST => Some(format!(
                "not turbulence: eddies of one size, without a range of smaller ones (Re_lambda {re:.1}; that begins \
                 at some {FEWEST})"
            )),
            Some(_) => None,
        };
        let all: Vec<String> = disorder.into_iter().chain(scales).collect();
        match all.is_empty() {
            true => {
                "a Reynolds number of turbulence; whether its scales are filled, the spectrum says"
                    .to_owned()
            }
            false => all.join("; "),
        }
    }
}

impl Display for Turbulence {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { u_rms, mach, integral_scale, taylor_scale, eddy_time, .. } = self;
        write!(f, "u' {u_rms:.3}, ")?;
        if let (Some(re), Some(epsilon), Some(eta)) =
            (self.re_lambda, self.dissipation, self.eta_over_spacing)
        {
            write!(f, "Re_lambda {re:.1}, epsilon {epsilon:.2e}, eta/spacing {eta:.2}, ")?;
        }
        write!(
            f,
            "lambda {taylor_scale:.3}, L_int {integral_scale:.3}, eddy time {eddy_time:.3}, Mach {mach:.3}"
        )?;
        match self.viscosity.nu {
            Some(nu) => write!(f, "; nu {nu:.2e}: {}", self.viscosity.known_by),
            None => write!(f, "; nu {}", self.viscosity.known_by),
        }
    }
}
