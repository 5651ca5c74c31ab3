//! The command `reproduce`: `whirls::commands::reproduce`.

use std::process::ExitCode;

fn main() -> ExitCode {
    whirls::commands::reproduce()
}
