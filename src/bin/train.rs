//! The command `train`: `whirls::commands::train`.

use std::process::ExitCode;

fn main() -> ExitCode {
    whirls::commands::train()
}
