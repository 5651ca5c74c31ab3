//! Finds the format of a table by the names and the first bytes of its files.

use super::memory::Stacked;
use super::{Table, Tracks, npz, openptv, tecplot, text};
use crate::arrays::Array;
use crate::error::{Error, Result};
use crate::files;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Names of the formats.
const FORMATS: [&str; 6] = ["text", "tecplot", "openptv", "npz", "npy", "hdf5"];

/// The files of a table, in the order of their frames.
#[derive(Debug)]
pub(super) struct Files {
    pub(super) paths: Vec<PathBuf>,
    /// Bytes of each.
    pub(super) sizes: Vec<u64>,
    /// Bytes of all.
    pub(super) bytes: u64,
}

impl Files {
    fn of(mut paths: Vec<PathBuf>) -> Result<Self> {
        let number = |path: &PathBuf| frame_of_name(path).unwrap_or(f64::NAN);
        if paths.iter().all(|path| !number(path).is_nan()) {
            paths.sort_by(|a, b| number(a).total_cmp(&number(b)).then_with(|| a.cmp(b)));
        }
        paths.iter().try_for_each(|path| files::must_be_a_file(path))?;
        let size = |path: &PathBuf| {
            std::fs::metadata(path).map(|file| file.len()).map_err(|error| Error::read(path, error))
        };
        let sizes: Vec<u64> = paths.iter().map(size).collect::<Result<_>>()?;
        Ok(Self { bytes: sizes.iter().sum(), sizes, paths })
    }

    pub(super) fn first(&self) -> &Path {
        self.paths.first().map_or_else(|| Path::new(""), PathBuf::as_path)
    }

    /// Refuses several files of a format that has all frames in one.
    pub(super) fn only(&self, format: &str) -> Result<&Path> {
        match self.paths.len() {
            1 => Ok(self.first()),
            count => {
                let expected = format!("one file of format {format}");
                Err(Error::input("import", expected, count, "import one after another"))
            }
        }
    }
}

/// The last number in the name of a file: `snapshot_0012.dat` is 12, `ptv_is.10001` is 10001.
pub(super) fn frame_of_name(path: &Path) -> Option<f64> {
    let name = path.file_name()?.to_str()?;
    let stem = match path.extension()?.to_str()? {
        extension if extension.bytes().all(|byte| byte.is_ascii_digit()) => name,
        _ => path.file_stem()?.to_str()?,
    };
    let end = stem.rfind(|c: char| c.is_ascii_digit())? + 1;
    let start = stem[..end].rfind(|c: char| !c.is_ascii_digit()).map_or(0, |at| at + 1);
    // A letter of more than one byte before the digits.
    let start = (start..end).find(|at| stem.is_char_boundary(*at))?;
    stem[start..end].parse().ok()
}

/// Opens a table.
///
/// # Errors
/// [`Error::Input`] for files that are no table that is known, [`Error::File`] for files that
/// cannot be read.
pub(crate) fn open(tracks: &Tracks) -> Result<Box<dyn Table>> {
    let files = Files::of(tracks.files.clone())?;
    let format = match &tracks.format {
        Some(name) => name.clone(),
        None => format_of(files.first())?.to_owned(),
    };
    Ok(match format.as_str() {
        "text" => Box::new(text::Text::open(files, tracks)?),
        "tecplot" => Box::new(tecplot::Tecplot::open(files, tracks)?),
        "openptv" => Box::new(openptv::OpenPtv::open(files)?),
        "npz" => Box::new(npz::open(files.only("npz")?)?),
        "npy" => {
            let path = files.only("npy")?;
            let arrays = (Array::open(path, 3)?, None);
            let words = "positions [frames, particles, dimension]".to_owned();
            Box::new(Stacked::new(&path.display().to_string(), arrays, None, words)?)
        }
        #[cfg(feature = "hdf5")]
        "hdf5" => super::hdf5::open(files.only("hdf5")?, tracks)?,
        #[cfg(not(feature = "hdf5"))]
        "hdf5" => {
            let remedy = "build with `--features hdf5`";
            return Err(Error::input(
                files.first().display(),
                "a format of this build",
                "HDF5",
                remedy,
            ));
        }
        other => {
            let expected = format!("one of {}", FORMATS.join(", "));
            return Err(Error::input("--format", expected, other, "name one of them"));
        }
    })
}

/// The format of a file.
fn format_of(path: &Path) -> Result<&'static str> {
    let mut begin = Vec::new();
    let file = File::open(path).map_err(|error| Error::read(path, error))?;
    file.take(4096).read_to_end(&mut begin).map_err(|error| Error::read(path, error))?;
    if begin.starts_with(b"\x89HDF\r\n\x1a\n") {
        return Ok("hdf5");
    }
    match files::kind(&begin) {
        Some(files::Kind::Zip) => return Ok("npz"),
        Some(files::Kind::Npy) => return Ok("npy"),
        Some(kind) => {
            let remedy = match kind {
                files::Kind::Utf16 => "save it as UTF-8",
                other => other.instead_of_an_array(),
            };
            let expected = "a table of tracks";
            return Err(Error::input(path.display(), expected, kind.name(), remedy));
        }
        None => {}
    }
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    if name.starts_with("ptv_is.") || name.starts_with("xuap.") {
        return Ok("openptv");
    }
    let text = String::from_utf8_lossy(&begin).to_lowercase();
    let is_tecplot = |line: &str| {
        let words = ["variables", "zone", "title"];
        words.iter().any(|word| {
            let rest = line.trim_start().strip_prefix(word);
            rest.is_some_and(|rest| rest.trim_start().starts_with(['=', '"']) || *word == "zone")
        })
    };
    Ok(if text.lines().any(is_tecplot) { "tecplot" } else { "text" })
}
