//! How a flow is differentiated.
//!
//! Forward sensitivities `S = ∂(r, v)/∂θ` start at zero and pass through the linearised step, beside
//! the flow itself: each system of `systems/` has its tangent in the same file. The adjoint goes the
//! other way, from the loss back through the pullback of every system, in the reverse of the step's
//! order. Both differentiate the discrete step that is run, and agree to round-off.
//!
//! Equation numbers are those of Woodward et al., arXiv:2110.13311 ("the paper"): see `docs/equations.md`.

mod adjoint;
mod check;
mod growth;

pub use adjoint::{AdjointGradient, Storage, adjoint_gradient};
pub use check::{ComparedSlope, compare_along_gradient, compare_component};
pub use growth::{Growth, SHORTEN, USEFUL, sensitivity_growth};

use serde::{Deserialize, Serialize};

/// How a gradient is found.
///
/// | way | cost in forward runs | recommended |
/// |---|---|---|
/// | `forward` | 6 to 10 for the first eight parameters, 0.5 to 5 more for eight more | for Levenberg–Marquardt, which needs the residual derivatives that it alone gives |
/// | `adjoint` | about 4, for any number of parameters | for everything else; memory for the way back |
/// | `auto` | `adjoint`, and `forward` where only that will do | default |
///
/// `cargo bench --bench gradients` measures it; `train --check-gradient` prints what both cost on the
/// scene at hand. The choice of `auto` follows from those measurements, not from the clock of the day, so
/// that equal seeds give equal bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Gradient {
    /// The cheaper of the two (default).
    #[default]
    Auto,
    /// Sensitivities beside the flow.
    Forward,
    /// One way back.
    Adjoint,
}

impl Gradient {
    /// The way taken: the adjoint, whatever the number of parameters, unless something only `forward` has is
    /// needed: the derivatives of every residual, or local coupling.
    ///
    /// There is no number of parameters below which `forward` is cheaper: its first block costs 1.4 to 2.6
    /// adjoints by all parameters, since the pairs are linearised and a network's weights differentiated for
    /// one block as for twenty. `cargo bench --bench gradients` prints where the two cross.
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

/// Which derivatives of the force a forward sensitivity keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Coupling {
    /// All of them: the exact gradient (default, recommended).
    #[default]
    Full,
    /// `∂Fᵢ/∂Xᵢ` alone, as the paper's Eq. (25): wrong in developed flow, kept for comparison.
    Local,
}
