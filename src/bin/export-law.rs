//! The command `export-law`: `whirls::commands::export_law`.

use std::process::ExitCode;

fn main() -> ExitCode {
    whirls::commands::export_law()
}
