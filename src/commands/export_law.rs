//! `export-law`: writes a learned law as a file of its own.

use super::common::{conclude, say, say_json};
use crate::output::must_differ;
use crate::run::law_of_recording;
use crate::scene::Law;
use crate::{Error, Result};
use clap::Parser;
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;

/// Writes the law that a training learned as one TOML file: its form, scales, weights and parameters, where it was
/// learned and how well. `simulate --law FILE.toml` runs it, and a scene names it with `law = "FILE.toml"`.
#[derive(Debug, Parser)]
#[command(name = "export-law", version)]
pub(super) struct Arguments {
    /// The recording of a training.
    #[arg(value_name = "LEARNED.mcap")]
    learned: PathBuf,
    /// The file [default: that of the recording, ending in .law.toml].
    #[arg(long, value_name = "FILE.toml")]
    out: Option<PathBuf>,
    /// Replace a file that is there.
    #[arg(long)]
    overwrite: bool,
    /// Print one JSON object as the last line of standard output.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> ExitCode {
    conclude(export(arguments))
}

fn export(arguments: &Arguments) -> Result<()> {
    let out = arguments.out.clone().unwrap_or_else(|| arguments.learned.with_extension("law.toml"));
    must_differ(&out, &[&arguments.learned])?;
    if out.exists() && !arguments.overwrite {
        let remedy = "name another with --out, or replace it with --overwrite";
        return Err(Error::input(out.display(), "a new file", "one that is there", remedy));
    }
    let law = law_of_recording(&arguments.learned)?;
    std::fs::write(&out, law.to_toml()).map_err(|source| Error::write(&out, source))?;
    describe(&law);
    say(format!("law in {}", out.display()));
    if !arguments.json {
        return Ok(());
    }
    say_json(&json!({
        "law": out,
        "model": law.model.kind(),
        "parameters": law.parameters,
        "standard_error": law.standard_error,
        "weights": law.weights.len(),
        "learned": law.learned,
    }))
}

fn describe(law: &Law) {
    let there = &law.learned;
    say(format!(
        "{} of scene {}: {} parameters and {} weights, loss {:.2e} after {} iterations over {} steps",
        law.model.kind(),
        there.scene,
        law.parameters.len(),
        law.weights.len(),
        there.loss,
        there.iterations,
        there.steps
    ));
    for (name, value) in &law.parameters {
        match law.standard_error.get(name) {
            Some(error) => say(format!("  {name:6} {value:.12} ± {error:.1e}")),
            None => say(format!("  {name:6} {value:.12}")),
        }
    }
    say(format!(
        "learned at h {:.4}, h/spacing {:.3}, in {} steps of {:.6}; its lengths and steps are tied to these as \
         `simulate --law` says",
        there.smoothing_length,
        there.smoothing_length / there.spacing,
        there.step,
        there.dt
    ));
}
