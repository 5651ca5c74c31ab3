//! The final report of `train`, in words.

use crate::commands::common::say;
use crate::evaluation::Spread;
use crate::parameters::Parameter;
use crate::run::{HeldOut, Losses, TrainingReport};

/// Prints a report in words.
pub(crate) fn describe(report: &TrainingReport) {
    say(format!(
        "{}: {} particles over {} steps{}, loss {:.2e} -> {:.2e} in {} iterations{}, gradient {} ({:.1} s)",
        report.scene,
        report.particles,
        report.steps,
        report.lessons.map_or_else(String::new, |lessons| format!(" of each of {lessons} lessons")),
        report.loss_initial,
        report.loss_final,
        report.iterations - report.iterations_before.unwrap_or(0),
        report
            .iterations_before
            .map_or_else(String::new, |before| format!(" after {before} earlier ones")),
        report.gradient,
        report.seconds.train
    ));
    let Losses { trajectory, field, kl, statistics } = &report.losses;
    let named = [("trajectory", *trajectory), ("field", *field), ("kl", *kl)].into_iter();
    let parts = named.chain(statistics.iter().map(|(name, loss)| (name.as_str(), *loss)));
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
    describe_held_out(&report.held_out);
    report.knowledge.lines().iter().for_each(|line| say(format!("  {line}")));
    say(format!("recorded in {}", report.recording.display()));
}

/// Errors in the lessons that are held out, and the flows that diverged.
fn describe_held_out(held_out: &[HeldOut]) {
    let Some(first) = held_out.first() else { return };
    let end = first.times.last().copied().unwrap_or_default();
    let last = |errors: &[f64]| errors.last().copied().unwrap_or(f64::NAN);
    let holding = held_out.iter().filter_map(HeldOut::last_field);
    let Spread { median: error, low, high } = Spread::of(holding);
    let ballistic = Spread::of(held_out.iter().map(|held| last(&held.ballistic))).median;
    let until = |of: &dyn Fn(&HeldOut) -> Option<f64>| {
        let median = Spread::of(held_out.iter().map(|held| of(held).unwrap_or(f64::INFINITY))).median;
        if median.is_finite() { format!("{median:.3}") } else { format!("all {end:.3}") }
    };
    if error.is_finite() {
        say(format!(
            "  held out, {} lessons: relative field error {error:.4} ({low:.4} to {high:.4}) after {end:.3}; ballistic \
             {ballistic:.4}",
            held_out.len(),
        ));
        say(format!(
            "  it stays below a tenth for {}; ballistic {}",
            until(&|held| held.follows_until(&held.field)),
            until(&|held| held.follows_until(&held.ballistic))
        ));
    }
    let diverged = held_out.iter().filter(|held| held.diverged.is_some());
    diverged.for_each(|held| say(format!("  {held}")));
}
