//! A requested accuracy, and the step that a calibration chose for it. The paper is Woodward et
//! al., arXiv:2110.13311, and its step [`Step::Paper`].

use super::Scene;
use crate::systems::verlet::Step;
use serde::{Deserialize, Serialize};

/// An accuracy by name.
///
/// | speed | particles are within | the shipped scenes get |
/// |---|---|---|
/// | `draft` | 1e-2 `h` | `kick-drift-kick` at their own time step: half the work of the paper's step |
/// | `balanced` | 2e-3 `h` | half that time step: as much work as the paper's step, five times closer |
/// | `exact` | 1e-4 `h` | an eighth of it: four times that work |
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Speed {
    /// To look at a flow.
    Draft,
    /// To measure it.
    Balanced,
    /// To compare others with it.
    Exact,
}

impl Speed {
    /// All of them, the fastest first.
    pub const ALL: [Self; 3] = [Self::Draft, Self::Balanced, Self::Exact];

    /// The accuracy in smoothing lengths.
    pub fn accuracy(self) -> f64 {
        match self {
            Self::Draft => 1e-2,
            Self::Balanced => 2e-3,
            Self::Exact => 1e-4,
        }
    }

    /// Its name in scenes.
    pub fn name(self) -> &'static str {
        match self {
            Self::Draft => "draft",
            Self::Balanced => "balanced",
            Self::Exact => "exact",
        }
    }
}

/// The result of a calibration. A scene that contains it runs as it is.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CalibratedStep {
    /// The requested accuracy.
    pub accuracy: f64,
    /// Kind of step.
    pub step: Step,
    /// Time step.
    pub dt: f64,
    /// Number of force evaluations per time, divided by that of the scene as written.
    pub cost: f64,
    /// Root-mean-square distance of particles from a much finer run after the calibration, divided
    /// by the smoothing length.
    pub error: f64,
}

impl std::fmt::Display for CalibratedStep {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { accuracy, step, dt, cost, error } = self;
        let step = step.name();
        write!(
            f,
            "accuracy {accuracy:e} asked for: {step} in steps of {dt}, error {error:.2e}, {cost} times the cost of the \
             scene as written"
        )
    }
}

impl Scene {
    /// The requested accuracy in smoothing lengths, from a number or a name.
    pub fn accuracy_asked(&self) -> Option<f64> {
        self.accuracy.or_else(|| self.speed.map(Speed::accuracy))
    }

    /// Whether an accuracy is requested but no step has been chosen: such a scene cannot run.
    pub fn is_unsettled(&self) -> bool {
        self.accuracy_asked().is_some() && self.chosen.is_none()
    }

    /// The scene without a requested accuracy, as written.
    pub fn as_written(&self) -> Self {
        Self { accuracy: None, speed: None, chosen: None, ..self.clone() }
    }

    /// The same scene in steps `finer` times finer and `longer` times longer. All counts of steps
    /// change accordingly, so that everything happens at the same times; `None` where some count
    /// would not be whole. The recorded times are kept where possible, with at most one frame per
    /// step.
    pub fn in_other_steps(&self, finer: u64, longer: u64) -> Option<Self> {
        let counted = |steps: u64| {
            let steps = steps.checked_mul(finer)?;
            steps.is_multiple_of(longer).then_some(steps / longer)
        };
        let mut scene = self.clone();
        scene.time.dt = Some(self.dt() * longer as f64 / finer as f64);
        scene.time.steps = counted(self.time.steps)?;
        scene.record.every = self.record.every.checked_mul(finer)?.div_ceil(longer);
        if let Some(up) = &mut scene.spin_up {
            up.steps = counted(up.steps)?;
        }
        if let Some(learn) = &mut scene.learn {
            (learn.after, learn.every) = (counted(learn.after)?, counted(learn.every)?);
        }
        Some(scene)
    }

    /// Steps between two observed frames.
    pub fn observed_every(&self) -> u64 {
        self.learn.as_ref().map_or(1, |learn| learn.every)
    }

    /// Time between two observed frames.
    pub fn observed_interval(&self) -> f64 {
        self.observed_every() as f64 * self.dt()
    }
}
