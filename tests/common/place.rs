//! A folder in which commands run, with a small scene in it.

#![allow(dead_code, reason = "each test file uses some of these")]
#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use serde_json::Value;
use std::path::PathBuf;
use std::process::Command;
use whirls::recording::Recording;

/// A scene that is learned in a second.
pub(crate) const SMALL: &str = r#"
name = "small"
dimension = 3
seed = 3

[fluid]
particles_per_side = 8
smoothing_length = 0.67
c = 10.0
alpha = 1.0
beta = 2.0
gamma = 7.0

[forcing]
kind = "deterministic"
theta = 0.5

[time]
steps = 6

[learn]
parameters = ["c", "alpha", "beta", "gamma"]
after = 2
frames = 4
windows = [1]
"#;

/// A temporary folder with the small scene in it, in which commands run.
pub(crate) struct Place(tempfile::TempDir);

/// The result of a command.
pub(crate) struct Done {
    pub(crate) code: Option<i32>,
    pub(crate) out: String,
    pub(crate) err: String,
}

impl Place {
    pub(crate) fn new() -> Self {
        let place = Self(tempfile::tempdir().unwrap());
        std::fs::write(place.path("small.toml"), SMALL).unwrap();
        place
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }

    pub(crate) fn command(&self, binary: &str, arguments: &[&str]) -> Command {
        let program = match binary {
            "whirls" => env!("CARGO_BIN_EXE_whirls"),
            "advise" => env!("CARGO_BIN_EXE_advise"),
            "export-law" => env!("CARGO_BIN_EXE_export-law"),
            "train" => env!("CARGO_BIN_EXE_train"),
            "simulate" => env!("CARGO_BIN_EXE_simulate"),
            "import" => env!("CARGO_BIN_EXE_import"),
            "export" => env!("CARGO_BIN_EXE_export"),
            "trade" => env!("CARGO_BIN_EXE_trade"),
            "assimilate" => env!("CARGO_BIN_EXE_assimilate"),
            "evaluate" => env!("CARGO_BIN_EXE_evaluate"),
            "reproduce" => env!("CARGO_BIN_EXE_reproduce"),
            "replay" => env!("CARGO_BIN_EXE_replay"),
            other => panic!("no command {other}"),
        };
        let mut command = Command::new(program);
        command.args(arguments).current_dir(self.0.path());
        command
    }

    pub(crate) fn run(&self, binary: &str, arguments: &[&str]) -> Done {
        let output = self.command(binary, arguments).output().unwrap();
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        Done { code: output.status.code(), out: text(output.stdout), err: text(output.stderr) }
    }

    /// A command that succeeds, and what `--json` printed as its last line.
    #[track_caller]
    pub(crate) fn json(&self, binary: &str, arguments: &[&str]) -> Value {
        let done = self.run(binary, arguments);
        assert_eq!(done.code, Some(0), "{}", done.err);
        serde_json::from_str(done.out.lines().last().unwrap()).unwrap()
    }

    /// A command that refuses its input: exit code 2, the reason on standard error, nothing on
    /// standard output.
    #[track_caller]
    pub(crate) fn refuses(&self, binary: &str, arguments: &[&str], parts: &[&str]) {
        let done = self.run(binary, arguments);
        assert_eq!(done.code, Some(2), "{binary} {arguments:?}: {}{}", done.out, done.err);
        assert!(done.out.is_empty(), "on standard output: {}", done.out);
        for part in parts.iter().chain(&["error: "]) {
            assert!(done.err.contains(part), "no `{part}` in: {}", done.err);
        }
    }

    pub(crate) fn recording(&self, name: &str) -> Recording {
        Recording::open(&self.path(name)).unwrap()
    }
}
