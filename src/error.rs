//! The one error type of the crate.
//!
//! Callers need to tell apart bad input, a flow that failed, a file that failed and a run that was
//! asked to stop. Each is a variant of one enum. Every message says what was expected, what was
//! found and what to do, and [`Error::exit_code`] is what a command returns to the shell.

use std::path::{Path, PathBuf};

/// The reason why something could not be done.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A scene, array, recording or argument that is not valid.
    #[error("{place}: expected {expected}, found {found}; {remedy}")]
    Input {
        /// File, line and key, as exactly as they are known.
        place: String,
        /// What was expected.
        expected: String,
        /// What was found.
        found: String,
        /// What to do about it.
        remedy: String,
    },
    /// The flow left the range in which its numbers are meaningful.
    #[error("the run diverged at step {step} (t = {time:.6}): {quantity} {found}; {remedy}")]
    Diverged {
        /// The step.
        step: u64,
        /// Simulation time.
        time: f64,
        /// The quantity and, where it belongs to one, the particle.
        quantity: String,
        /// Its value, and the limit it exceeded.
        found: String,
        /// What to do about it.
        remedy: String,
    },
    /// The operating system refused a file.
    #[error("cannot {action} {}: {source}; {remedy}", path.display())]
    File {
        /// What was attempted: "read", "create", "write".
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// The message of the operating system.
        source: std::io::Error,
        /// What to do about it.
        remedy: &'static str,
    },
    /// A signal asked the run to stop.
    #[error("interrupted by {}: {kept}", crate::interrupt::name(*signal))]
    Interrupted {
        /// The signal's number.
        signal: u8,
        /// What was kept, and how to continue.
        kept: String,
    },
}

/// A result with the crate's [`Error`].
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// An [`Error::Input`] from anything that can be displayed.
    pub fn input(
        place: impl ToString,
        expected: impl ToString,
        found: impl ToString,
        remedy: impl ToString,
    ) -> Self {
        Self::Input {
            place: place.to_string(),
            expected: expected.to_string(),
            found: found.to_string(),
            remedy: remedy.to_string(),
        }
    }

    /// An [`Error::File`] while reading an input.
    pub fn read(path: &Path, source: std::io::Error) -> Self {
        Self::File {
            action: "read",
            path: path.to_owned(),
            source,
            remedy: "check that the file exists and may be read",
        }
    }

    /// An [`Error::File`] while writing a result.
    pub fn write(path: &Path, source: std::io::Error) -> Self {
        Self::File {
            action: "write",
            path: path.to_owned(),
            source,
            remedy: "check that the folder exists, may be written and has room",
        }
    }

    /// The step at which a flow diverged; none for any other error.
    pub fn diverged_at(&self) -> Option<u64> {
        match self {
            Self::Diverged { step, .. } => Some(*step),
            Self::Input { .. } | Self::File { .. } | Self::Interrupted { .. } => None,
        }
    }

    /// A copy of the error, for a caller that asks again.
    pub(crate) fn again(&self) -> Self {
        match self {
            Self::Input { place, expected, found, remedy } => {
                Self::input(place, expected, found, remedy)
            }
            Self::Diverged { step, time, quantity, found, remedy } => Self::Diverged {
                step: *step,
                time: *time,
                quantity: quantity.clone(),
                found: found.clone(),
                remedy: remedy.clone(),
            },
            Self::File { action, path, source, remedy } => {
                let same = source.raw_os_error().map(std::io::Error::from_raw_os_error);
                let said = || std::io::Error::new(source.kind(), source.to_string());
                let (path, source) = (path.clone(), same.unwrap_or_else(said));
                Self::File { action, path, source, remedy }
            }
            Self::Interrupted { signal, kept } => {
                Self::Interrupted { signal: *signal, kept: kept.clone() }
            }
        }
    }

    /// The exit code of a command: 2 for bad input (also a missing input file), 1 for a run that
    /// failed, 128 plus the signal's number for one that was interrupted.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Input { .. } => 2,
            Self::File { action: "read", .. } => 2,
            Self::Diverged { .. } | Self::File { .. } => 1,
            Self::Interrupted { signal, .. } => signal.saturating_add(128),
        }
    }
}
