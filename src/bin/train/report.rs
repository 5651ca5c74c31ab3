//! What `train` ends with, in words and as JSON.

use crate::Lesson;
use crate::common::say;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;
use whirls::Scene;
use whirls::learn::{Learner, Outcome};
use whirls::models::Parameter;

/// The object of `--json`.
#[derive(Serialize)]
pub(crate) struct Report {
    pub(crate) scene: String,
    pub(crate) model: &'static str,
    pub(crate) particles: usize,
    pub(crate) steps: usize,
    pub(crate) gradient: &'static str,
    pub(crate) iterations: usize,
    pub(crate) loss_initial: f64,
    pub(crate) loss_final: f64,
    pub(crate) parameters: BTreeMap<String, f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) truth: Option<BTreeMap<String, f64>>,
    pub(crate) seconds: Seconds,
    pub(crate) recording: PathBuf,
    pub(crate) losses: Losses,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) kl_floor: Option<f64>,
    /// Largest difference of a learned pressure from the true one, over the densities seen.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) pressure_error: Option<f64>,
}

/// The parts of the final loss.
#[derive(Serialize)]
pub(crate) struct Losses {
    pub(crate) trajectory: f64,
    pub(crate) field: f64,
    pub(crate) kl: f64,
}

#[derive(Serialize)]
pub(crate) struct Seconds {
    pub(crate) truth: f64,
    pub(crate) train: f64,
}

/// What `--json` prints of a search.
pub(crate) fn report<const D: usize>(
    scene: &Scene,
    (lesson, learner): (&Lesson<D>, &Learner<D>),
    outcome: &Outcome,
    (train, recording): (f64, PathBuf),
) -> Report {
    let named = |values: &[f64]| {
        let names = learner.columns().iter().map(|p: &Parameter| p.name().into_owned());
        names.zip(values.iter().copied()).collect::<BTreeMap<_, _>>()
    };
    Report {
        scene: scene.name.clone(),
        model: lesson.learn.model.kind(),
        particles: lesson.truth.densities[0].len(),
        steps: lesson.learn.frames,
        gradient: learner.gradient().name(),
        iterations: outcome.iterations,
        loss_initial: outcome.initial_loss,
        loss_final: outcome.evaluation.loss,
        parameters: named(&outcome.evaluation.parameters),
        truth: lesson.known.as_deref().map(named),
        seconds: Seconds { truth: lesson.seconds, train },
        recording,
        losses: Losses {
            trajectory: outcome.evaluation.trajectory,
            field: outcome.evaluation.field,
            kl: outcome.evaluation.kl,
        },
        kl_floor: None,
        pressure_error: None,
    }
}

/// Prints a report in words.
pub(crate) fn describe(report: &Report) {
    say(format!(
        "{}: {} particles over {} steps, loss {:.2e} -> {:.2e} in {} iterations, gradient {} ({:.1} s)",
        report.scene,
        report.particles,
        report.steps,
        report.loss_initial,
        report.loss_final,
        report.iterations,
        report.gradient,
        report.seconds.train
    ));
    let Losses { trajectory, field, kl } = report.losses;
    let parts = [("trajectory", trajectory), ("field", field), ("kl", kl)].into_iter();
    let mut parts: Vec<_> = parts.filter(|(_, loss)| loss.abs() > 0.0).collect();
    parts.extend(report.kl_floor.map(|floor| ("sampling floor of kl", floor)));
    if parts.len() > 1 {
        let parts = parts.iter().map(|(name, loss)| format!("{name} {loss:.2e}"));
        say(format!("  {}", parts.collect::<Vec<_>>().join(", ")));
    }
    let physical = Parameter::ALL.map(|p| p.name());
    let weights = report.parameters.keys().filter(|name| !physical.contains(&name.as_str().into()));
    match weights.count() {
        0 => {}
        count => say(format!("  {} with {count} weights", report.model)),
    }
    if let Some(error) = report.pressure_error {
        say(format!("  its pressure is within {:.3} % of the true one", 100.0 * error));
    }
    for (name, value) in &report.parameters {
        if !physical.contains(&name.as_str().into()) {
            continue;
        }
        let against = match report.truth.as_ref().and_then(|truth| truth.get(name)) {
            Some(truth) => format!("   truth {truth}, off by {:.1e}", (value - truth).abs()),
            None => String::new(),
        };
        say(format!("  {name:6} {value:.12}{against}"));
    }
    say(format!("recorded in {}", report.recording.display()));
}
