//! Runge–Kutta schemes in which each stage starts from the one before.

use serde::{Deserialize, Serialize};

/// A scheme for `du/dt = N(u) − νk²u`; the viscosity is integrated exactly (integrating factor, Rogallo 1981).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Scheme {
    /// Heun's of order 2, two evaluations: to compare with other programs; not recommended.
    Heun,
    /// Heun's of order 3, three evaluations: stable up to a Courant number of 0.8.
    Third,
    /// The classical one of order 4, four evaluations (default): stable up to a Courant number of 1.3, and the cheapest
    /// at a given error below some 1e-3.
    #[default]
    Classical,
}

/// Of each stage: its time, the share of its rate in the step, and in the start of the next stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Stage {
    pub(crate) time: f64,
    pub(crate) share: f64,
    pub(crate) next: f64,
}

const fn stage(time: f64, share: f64, next: f64) -> Stage {
    Stage { time, share, next }
}

const HEUN: [Stage; 2] = [stage(0.0, 0.5, 1.0), stage(1.0, 0.5, 0.0)];

const THIRD: [Stage; 3] =
    [stage(0.0, 0.25, 1.0 / 3.0), stage(1.0 / 3.0, 0.0, 2.0 / 3.0), stage(2.0 / 3.0, 0.75, 0.0)];

const CLASSICAL: [Stage; 4] = [
    stage(0.0, 1.0 / 6.0, 0.5),
    stage(0.5, 1.0 / 3.0, 0.5),
    stage(0.5, 1.0 / 3.0, 1.0),
    stage(1.0, 1.0 / 6.0, 0.0),
];

impl Scheme {
    /// Evaluations of the rate in a step.
    pub fn evaluations(self) -> usize {
        self.stages().len()
    }

    /// Order of the error of a run.
    pub fn order(self) -> i32 {
        self.evaluations() as i32
    }

    pub(super) fn stages(self) -> &'static [Stage] {
        match self {
            Self::Heun => &HEUN,
            Self::Third => &THIRD,
            Self::Classical => &CLASSICAL,
        }
    }
}
