//! The command `trade`: `whirls::commands::trade`.

use std::process::ExitCode;

fn main() -> ExitCode {
    whirls::commands::trade()
}
