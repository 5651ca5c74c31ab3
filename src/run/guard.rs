//! Protects files from being overwritten: inputs of a command, and files of other commands.

use crate::error::{Error, Result};
use crate::output::{Output, must_differ, readable, same_file};
use crate::recording::Recording;
use std::path::Path;

/// A command's files: its inputs, and the existing files that it may replace.
#[derive(Clone, Copy, Debug, Default)]
pub struct Guard<'a> {
    /// The command; its own earlier recordings may be replaced.
    pub command: &'a str,
    /// The inputs; never replaced.
    pub inputs: &'a [&'a Path],
    /// Inputs that become part of the new recording, such as a search that is resumed; replaced
    /// only with `overwrite`.
    pub continued: Option<&'a Path>,
    /// The option `--overwrite`: whether any file except the inputs may be replaced. `None` where
    /// the command has no such option.
    pub overwrite: Option<bool>,
}

impl Guard<'_> {
    /// Checks a recording's name before any work, and reserves it: no other run may write the file,
    /// and an unfinished file of an earlier run is kept.
    ///
    /// # Errors
    /// As [`check`](Self::check) and [`Output::beside`].
    pub fn reserve(&self, path: &Path) -> Result<Output> {
        self.check(path)?;
        Output::beside(path)
    }

    /// Checks names in a folder before any work, and reserves the folder; the caller must hold the
    /// result until the files are written.
    ///
    /// # Errors
    /// As [`check`](Self::check) for recordings; [`Error::Input`] if one is an input or another run
    /// writes into the folder, [`Error::File`] if the folder cannot be written to.
    pub fn reserve_folder(&self, folder: &Path, names: &[&str]) -> Result<Output> {
        for name in names {
            let path = folder.join(name);
            if path.is_dir() {
                let remedy = "give another folder with --out";
                return Err(Error::input(path.display(), "a file to write", "a folder", remedy));
            }
            match path.extension().is_some_and(|extension| extension == "mcap") {
                true => self.check(&path)?,
                false => must_differ(&path, self.inputs)?,
            }
        }
        Output::create(&folder.join(self.command))
    }

    /// Whether a recording may be written under a name.
    ///
    /// # Errors
    /// [`Error::Input`] if it is an input, or if it is not an earlier recording of the same command
    /// and `overwrite` is not given.
    pub fn check(&self, path: &Path) -> Result<()> {
        must_differ(path, self.inputs)?;
        let may_overwrite = self.overwrite == Some(true);
        let refuse = |expected: &str, found: String| {
            Err(Error::input(path.display(), expected, found, self.remedy()))
        };
        match self.continued {
            Some(earlier) if same_file(path, &readable(earlier)) && !may_overwrite => {
                return Err(Error::input(
                    path.display(),
                    "a new name",
                    "the recording that is resumed",
                    "give another --record, or --overwrite: its iterations go into the new recording",
                ));
            }
            _ => {}
        }
        let Ok(there) = std::fs::metadata(path) else { return Ok(()) };
        // An empty file holds nothing; the operating system refuses a folder.
        if may_overwrite || !there.is_file() || there.len() == 0 {
            return Ok(());
        }
        let expected = format!("a new name, or an earlier recording of `{}`", self.command);
        match command_of(path) {
            Some(command) if command == self.command && there.permissions().readonly() => {
                refuse(&expected, "one that is read-only".into())
            }
            Some(command) if command == self.command => Ok(()),
            Some(command) => refuse(&expected, format!("a recording of `{command}`")),
            None => refuse(&expected, "a file that whirls did not record".into()),
        }
    }

    fn remedy(&self) -> &'static str {
        match self.overwrite {
            Some(_) => {
                "give another name with --record or --out, or --overwrite to lose what is there"
            }
            None => "give another place with --out, or move what is there",
        }
    }
}

/// The command that wrote a recording; none where the file is not a recording of a command.
pub fn command_of(path: &Path) -> Option<String> {
    let recording = Recording::open(path).ok()?;
    recording.run().metadata.get("command").cloned()
}
