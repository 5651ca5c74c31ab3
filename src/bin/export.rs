//! The command `export`: `whirls::commands::export`.

use std::process::ExitCode;

fn main() -> ExitCode {
    whirls::commands::export()
}
