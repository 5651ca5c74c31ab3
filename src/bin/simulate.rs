//! The command `simulate`: `whirls::commands::simulate`.

use std::process::ExitCode;

fn main() -> ExitCode {
    whirls::commands::simulate()
}
