//! What all commands share: output, the JSON line, exit codes.

use std::process::ExitCode;
use whirls::{Error, Result};

/// Ends a command: nothing on success, the error on standard error otherwise.
#[expect(clippy::print_stderr, reason = "a command reports its failure here")]
pub(crate) fn conclude(result: Result<()>) -> ExitCode {
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}

/// Prints a line on standard output, unless its reader has gone.
pub(crate) fn say(line: impl std::fmt::Display) {
    use std::io::Write;
    // A closed pipe (`train | head`) is no reason to lose the recording.
    let _ = writeln!(std::io::stdout(), "{line}");
}

/// Prints the object of `--json`.
pub(crate) fn say_json(report: &impl serde::Serialize) -> Result<()> {
    let text = serde_json::to_string(report).map_err(|error| {
        Error::input("the report", "numbers that JSON can hold", error, "run without --json")
    })?;
    say(text);
    Ok(())
}

/// Prints a warning on standard error.
#[allow(dead_code, reason = "not every command warns")]
#[expect(clippy::print_stderr, reason = "a command warns here")]
pub(crate) fn warn(text: &str) {
    eprintln!("warning: {text}");
}
