//! The command `replay`: `whirls::commands::replay`.

use std::process::ExitCode;

fn main() -> ExitCode {
    whirls::commands::replay()
}
