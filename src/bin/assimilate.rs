//! The command `assimilate`: `whirls::commands::assimilate`.

use std::process::ExitCode;

fn main() -> ExitCode {
    whirls::commands::assimilate()
}
