//! The command `advise`: `whirls::commands::advise`.

use std::process::ExitCode;

fn main() -> ExitCode {
    whirls::commands::advise()
}
