//! Differentiation of a flow: forward sensitivities and adjoint.
//!
//! Forward sensitivities `S = ∂(r, v)/∂θ` start at zero and are advanced by the linearised step
//! together with the flow: each system of `systems/` has its tangent in the same file. The adjoint
//! runs from the loss backwards through the pullback of every system, in the reverse of the step's
//! order. Both differentiate the discrete step that is run, and agree to round-off.
//!
//! Equation numbers are those of Woodward et al., arXiv:2110.13311 ("the paper"): see `docs/equations.md`.

mod adjoint;
mod rollout;

pub use adjoint::{AdjointGradient, StepAdjoint, Storage, adjoint_by_step, adjoint_gradient};
pub use rollout::{Frame, RecordedRollout, RolloutGradient, RolloutPlan};

use serde::{Deserialize, Serialize};

/// The remedy for a horizon that is too long.
pub const SHORTEN: &str = "observe fewer frames (learn.frames), let the window grow (learn.windows), or \
                           compare smoother fields (learn.mesh, fluid.smoothing_length)";

/// The mode of differentiation.
///
/// | way | cost in forward runs | recommended |
/// |---|---|---|
/// | `forward` | 6 to 10 for the first eight parameters, 0.12 to 0.44 for each one after that | for Levenberg–Marquardt, which needs the derivatives of every residual |
/// | `adjoint` | about 3, for any number of parameters | for everything else; needs memory for the tape |
/// | `auto` | `adjoint`, or `forward` where `adjoint` does not suffice | default |
///
/// `cargo bench --bench gradients` measures the costs; `train --check-gradient` prints those of
/// both modes for a given scene. The choice of `auto` follows from these measurements, and not from
/// a timing at run time, so that equal seeds give equal bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Gradient {
    /// The cheaper of the two (default).
    #[default]
    Auto,
    /// Forward sensitivities.
    Forward,
    /// The adjoint.
    Adjoint,
}

impl Gradient {
    /// The mode used: the adjoint for any number of parameters, except where only `forward` has
    /// what is needed: the derivatives of every residual, or local coupling.
    ///
    /// `forward` is not cheaper for any number of parameters. Its first block costs 1.4 to 2.6
    /// adjoints by all parameters, because linearising the pairs and differentiating a network's
    /// weights cost the same for one block as for twenty. `cargo bench --bench gradients` prints
    /// both costs.
    pub fn choose(self, needs_forward: bool) -> Self {
        match self {
            Self::Auto if needs_forward => Self::Forward,
            Self::Auto => Self::Adjoint,
            given => given,
        }
    }

    /// Its name in scenes and reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::Auto => "auto",
            Self::Forward => "forward",
            Self::Adjoint => "adjoint",
        }
    }
}

/// Which derivatives of the force forward sensitivities include.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Coupling {
    /// All of them: the exact gradient (default, recommended).
    #[default]
    Full,
    /// Only `∂Fᵢ/∂Xᵢ`, as in the paper's Eq. (25): wrong in developed flow, kept for comparison.
    Local,
}
