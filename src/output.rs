//! [`Output`]: a file that gets its final name only when it is complete.
//!
//! `flow.mcap` is written as `flow.unfinished.mcap` in the same folder and renamed at the end. A
//! final name therefore always stands for a complete result: an earlier file keeps the name until
//! the new one is complete, and a killed run leaves only an unfinished name. The file is locked
//! while it is written, so that a second run cannot write it.

use std::fs::{File, Metadata, OpenOptions, TryLockError};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::{Error, Result};

/// A file while it is written. Clones refer to the same file. A file dropped before anything was
/// written is removed.
#[derive(Clone, Debug)]
pub struct Output(Arc<Place>);

#[derive(Debug)]
struct Place {
    /// The final name, as it was given.
    path: PathBuf,
    /// The file that gets the final name: `path`, or the target of a link at `path`.
    target: PathBuf,
    /// The name until the file is complete; devices and pipes are written directly.
    unfinished: PathBuf,
    file: File,
    complete: AtomicBool,
}

/// What to do with the unfinished file of an earlier run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Leftover {
    Replace,
    Keep,
}

impl Output {
    /// Begins a file, and creates its folders. An unfinished file of an earlier run is overwritten.
    ///
    /// # Errors
    /// [`Error::Input`] if another run writes it, [`Error::File`] if it cannot be written.
    pub fn create(path: &Path) -> Result<Self> {
        Self::open(path, Leftover::Replace)
    }

    /// As [`create`](Self::create), but an unfinished file of an earlier run is kept: the new file
    /// takes the next free name, such as `flow.unfinished-2.mcap`.
    ///
    /// # Errors
    /// As [`create`](Self::create).
    pub fn beside(path: &Path) -> Result<Self> {
        Self::open(path, Leftover::Keep)
    }

    fn open(path: &Path, leftover: Leftover) -> Result<Self> {
        if let Some(folder) = path.parent() {
            std::fs::create_dir_all(folder).map_err(|error| Error::write(folder, error))?;
        }
        let target = target_of(path);
        let is_special = std::fs::metadata(&target).is_ok_and(|found| !found.is_file());
        let (unfinished, file) = if is_special {
            let file = OpenOptions::new().write(true).open(&target);
            (target.clone(), file.map_err(|error| Error::write(path, error))?)
        } else {
            free_place(path, &target, leftover)?
        };
        let complete = AtomicBool::new(is_special);
        Ok(Self(Arc::new(Place { path: path.to_owned(), target, unfinished, file, complete })))
    }

    /// The final name, as it was given.
    pub fn path(&self) -> &Path {
        &self.0.path
    }

    /// The current name of the file.
    pub fn unfinished(&self) -> &Path {
        &self.0.unfinished
    }

    /// A handle to write to.
    ///
    /// # Errors
    /// [`Error::File`] if the system has no more file handles.
    pub fn file(&self) -> Result<File> {
        self.0.file.try_clone().map_err(|error| Error::write(&self.0.unfinished, error))
    }

    /// Gives the file its final name, and replaces an earlier file of that name.
    ///
    /// # Errors
    /// [`Error::File`] if it cannot be renamed.
    pub fn complete(&self) -> Result<()> {
        let Place { target, unfinished, complete, path, .. } = &*self.0;
        if complete.swap(true, Ordering::Relaxed) {
            return Ok(());
        }
        std::fs::rename(unfinished, target).map_err(|error| Error::write(path, error))
    }

    /// Removes the unfinished file, because its content can be computed again.
    pub fn discard(&self) {
        if !self.0.complete.swap(true, Ordering::Relaxed) {
            drop(std::fs::remove_file(&self.0.unfinished));
        }
    }

    /// Writes a whole file. A reader never sees a part of it.
    ///
    /// # Errors
    /// As [`create`](Self::create) and [`complete`](Self::complete).
    pub fn write(path: &Path, bytes: &[u8]) -> Result<()> {
        use std::io::Write as _;
        let output = Self::create(path)?;
        let written = (&output.0.file).write_all(bytes);
        written.map_err(|error| Error::write(&output.0.unfinished, error))?;
        output.complete()
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let is_empty = || self.file.metadata().is_ok_and(|file| file.len() == 0);
        if !self.complete.load(Ordering::Relaxed) && is_empty() {
            // An empty file is harmless if it cannot be removed: the next run uses it.
            drop(std::fs::remove_file(&self.unfinished));
        }
    }
}

/// A name for the unfinished file, and the locked file.
fn free_place(path: &Path, target: &Path, leftover: Leftover) -> Result<(PathBuf, File)> {
    let mut number = 1;
    loop {
        let unfinished = unfinished_name(target, number);
        let failed = |error| Error::write(&unfinished, error);
        let mut options = OpenOptions::new();
        let file = options.write(true).create(true).truncate(false).open(&unfinished);
        let file = file.map_err(failed)?;
        lock(&file, path, &unfinished)?;
        let found = file.metadata().map_err(failed)?;
        if !still_there(&found, &unfinished) {
            // Another run has completed and renamed it just now.
            continue;
        }
        if found.len() > 0 && leftover == Leftover::Keep {
            number += 1;
            continue;
        }
        file.set_len(0).map_err(failed)?;
        return Ok((unfinished, file));
    }
}

fn lock(file: &File, path: &Path, unfinished: &Path) -> Result<()> {
    match file.try_lock() {
        Err(TryLockError::WouldBlock) => Err(Error::input(
            path.display(),
            "a file that no other run is writing",
            format!("one that writes it now, as {}", unfinished.display()),
            "wait for its end, or give this run another name to write to",
        )),
        // Not every file system has locks; without them, runs are kept apart only by the names.
        Err(TryLockError::Error(_)) | Ok(()) => Ok(()),
    }
}

/// The file that a name refers to: itself, or the target of a link.
fn target_of(path: &Path) -> PathBuf {
    let linked = path.is_symlink().then(|| std::fs::canonicalize(path).ok());
    linked.flatten().unwrap_or_else(|| path.to_owned())
}

/// `flow.unfinished.mcap`, then `flow.unfinished-2.mcap`, and so on.
fn unfinished_name(target: &Path, number: usize) -> PathBuf {
    let mut name = target.file_stem().unwrap_or_default().to_owned();
    name.push(".unfinished");
    if number > 1 {
        name.push(format!("-{number}"));
    }
    if let Some(extension) = target.extension() {
        name.push(".");
        name.push(extension);
    }
    target.with_file_name(name)
}

/// The unfinished files of earlier runs, newest last.
pub fn leftovers(path: &Path) -> Vec<PathBuf> {
    let target = target_of(path);
    let names = (1..).map(|number| unfinished_name(&target, number));
    names.take_while(|name| name.is_file()).collect()
}

/// The file to read for a name: the file itself or, where it does not exist, the newest unfinished
/// one.
pub fn readable(path: &Path) -> PathBuf {
    match path.exists() {
        true => path.to_owned(),
        false => leftovers(path).pop().unwrap_or_else(|| path.to_owned()),
    }
}

/// Whether two names refer to one file, through symbolic or hard links.
pub fn same_file(a: &Path, b: &Path) -> bool {
    match (std::fs::canonicalize(a), std::fs::canonicalize(b)) {
        (Ok(a), Ok(b)) => a == b || std::fs::metadata(a).is_ok_and(|a| still_there(&a, &b)),
        _ => false,
    }
}

/// Whether a name refers to a file seen before.
#[cfg(unix)]
fn still_there(file: &Metadata, name: &Path) -> bool {
    use std::os::unix::fs::MetadataExt as _;
    let named = std::fs::metadata(name);
    named.is_ok_and(|named| (named.dev(), named.ino()) == (file.dev(), file.ino()))
}

/// Whether a name refers to a file seen before, as far as the operating system can tell.
#[cfg(not(unix))]
fn still_there(_: &Metadata, name: &Path) -> bool {
    name.exists()
}

/// Refuses an output that is one of the inputs.
///
/// # Errors
/// [`Error::Input`] if it is.
pub fn must_differ(output: &Path, inputs: &[&Path]) -> Result<()> {
    match inputs.iter().find(|input| same_file(output, &readable(input))) {
        None => Ok(()),
        Some(input) => Err(Error::input(
            output.display(),
            "an output that is none of the inputs",
            format!("the same file as the input {}", input.display()),
            "give another file to write to",
        )),
    }
}
