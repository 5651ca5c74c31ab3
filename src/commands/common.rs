//! Common to all commands: output, the JSON line, exit codes.

use crate::{Error, Result, interrupt};
use std::io::{self, Write};
use std::process::ExitCode;
use std::sync::OnceLock;

/// The error of standard output; none where its reader has only closed the pipe.
static UNSAID: OnceLock<io::Error> = OnceLock::new();

/// Ends a command: nothing on success, the error on standard error otherwise.
#[expect(clippy::print_stderr, reason = "a command reports its failure here")]
pub(crate) fn conclude(result: Result<()>) -> ExitCode {
    let result = match result {
        // The error of an interrupted run is expected.
        Err(Error::Input { .. } | Error::Diverged { .. }) => interrupt::check().and(result),
        other => other,
    };
    match result.and_then(|()| all_said()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(error.exit_code())
        }
    }
}

/// Prints a line on standard output, unless its reader has closed the pipe.
pub(crate) fn say(line: impl std::fmt::Display) {
    // A closed pipe (`train | head`) is no reason to lose the recording.
    match writeln!(io::stdout(), "{line}") {
        Err(error) if error.kind() != io::ErrorKind::BrokenPipe => {
            UNSAID.get_or_init(|| error);
        }
        _ => {}
    }
}

/// Whether standard output has accepted every line.
fn all_said() -> Result<()> {
    let Some(error) = UNSAID.get() else { return Ok(()) };
    let same = error.raw_os_error().map(io::Error::from_raw_os_error);
    Err(Error::File {
        action: "write",
        path: "standard output".into(),
        source: same.unwrap_or_else(|| io::Error::new(error.kind(), error.to_string())),
        remedy: "what was written to files is whole; send the report to where there is room",
    })
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
#[expect(clippy::print_stderr, reason = "a command warns here")]
pub(crate) fn warn(text: &str) {
    eprintln!("warning: {text}");
}
