//! The final report of `train`, in words.

use crate::commands::common::say;
use crate::parameters::Parameter;
use crate::run::{Losses, TrainingReport};

/// Prints a report in words.
pub(crate) fn describe(report: &TrainingReport) {
    say(format!(
        "{}: {} particles over {} steps, loss {:.2e} -> {:.2e} in {} iterations{}, gradient {} ({:.1} s)",
        report.scene,
        report.particles,
        report.steps,
        report.loss_initial,
        report.loss_final,
        report.iterations - report.iterations_before.unwrap_or(0),
        report
            .iterations_before
            .map_or_else(String::new, |before| format!(" after {before} earlier ones")),
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
    let is_weight = |name: &str| Parameter::from(name.to_owned()).is_weight();
    match report.parameters.keys().filter(|name| is_weight(name)).count() {
        0 => {}
        count => say(format!("  {} with {count} weights", report.model)),
    }
    if let Some(error) = report.pressure_error {
        say(format!("  its pressure is within {:.3} % of the true one", 100.0 * error));
    }
    for (name, value) in &report.parameters {
        if is_weight(name) {
            continue;
        }
        let known = report.knowledge.value(name, *value);
        let against = match report.truth.as_ref().and_then(|truth| truth.get(name)) {
            Some(truth) => format!("   truth {truth}, off by {:.1e}", (value - truth).abs()),
            None => String::new(),
        };
        say(format!("  {name:6} {known}{against}"));
    }
    report.knowledge.lines().iter().for_each(|line| say(format!("  {line}")));
    say(format!("recorded in {}", report.recording.display()));
}
