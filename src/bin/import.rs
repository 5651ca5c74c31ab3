//! The command `import`: `whirls::commands::import`.

use std::process::ExitCode;

fn main() -> ExitCode {
    whirls::commands::import()
}
