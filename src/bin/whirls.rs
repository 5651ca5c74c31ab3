//! All commands as one program: `whirls train`, `whirls simulate` and so on.

use std::process::ExitCode;

fn main() -> ExitCode {
    whirls::commands::whirls()
}
