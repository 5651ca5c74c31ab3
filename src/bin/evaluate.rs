//! The command `evaluate`: `whirls::commands::evaluate`.

use std::process::ExitCode;

fn main() -> ExitCode {
    whirls::commands::evaluate()
}
