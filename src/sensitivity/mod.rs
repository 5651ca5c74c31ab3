//! How a flow is differentiated.
//!
//! Forward sensitivities `S = ∂(r, v)/∂θ` start at zero and pass through the linearised step, beside
//! the flow itself: each system of `systems/` has its tangent in the same file.

mod adjoint;
mod check;

pub use adjoint::{AdjointGradient, Storage, adjoint_gradient};
pub use check::{ComparedSlope, compare_with_differences};

use serde::{Deserialize, Serialize};

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
