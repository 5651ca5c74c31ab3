//! Recognises files of the wrong kind by their first bytes.

use crate::error::{Error, Result};
use std::path::Path;

/// The kind of a file, by its first bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    /// An array written by `numpy.save`.
    Npy,
    /// An archive written by `numpy.savez`, or any other zip file.
    Zip,
    /// A recording.
    Mcap,
    /// Text in UTF-16, as PowerShell 5 writes it.
    Utf16,
}

/// The kind of a file that begins with these bytes, if it is one of them.
pub(crate) fn kind(bytes: &[u8]) -> Option<Kind> {
    let begins: [(&[u8], Kind); 5] = [
        (b"\x93NUMPY", Kind::Npy),
        (b"PK\x03\x04", Kind::Zip),
        (b"\x89MCAP", Kind::Mcap),
        (b"\xff\xfe", Kind::Utf16),
        (b"\xfe\xff", Kind::Utf16),
    ];
    begins.iter().find(|(begin, _)| bytes.starts_with(begin)).map(|(_, kind)| *kind)
}

impl Kind {
    /// The kind in words.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Npy => "a .npy array",
            Self::Zip => "a zip archive, such as the .npz of numpy.savez",
            Self::Mcap => "an MCAP recording",
            Self::Utf16 => "text in UTF-16, as `>` of PowerShell 5 writes it",
        }
    }

    /// The remedy where a recording is expected.
    pub(crate) fn instead_of_a_recording(self) -> &'static str {
        match self {
            Self::Npy | Self::Zip => {
                "make a recording of the arrays: `import --positions r.npy --velocities v.npy --dt DT --out truth.mcap`"
            }
            Self::Mcap | Self::Utf16 => "give a file that `train`, `simulate` or `import` wrote",
        }
    }

    /// The remedy where a scene is expected.
    pub(crate) fn instead_of_a_scene(self) -> &'static str {
        match self {
            Self::Mcap => {
                "name a scene and give the recording beside it: `train SCENE --truth FILE.mcap`, \
                 `simulate SCENE --from FILE.mcap`, or `evaluate FILE.mcap`"
            }
            Self::Npy | Self::Zip => {
                "name a scene, and make a recording of the arrays: `import --help` says how"
            }
            Self::Utf16 => {
                "save it as UTF-8: in PowerShell, `Get-Content OLD.toml | Set-Content -Encoding utf8 NEW.toml`"
            }
        }
    }

    /// The remedy where an array is expected.
    pub(crate) fn instead_of_an_array(self) -> &'static str {
        match self {
            Self::Zip => {
                "import it as a whole, `import FILE.npz`, or save one of its arrays by its key: \
                 `numpy.save('r.npy', numpy.load('FILE.npz')['KEY'])`"
            }
            Self::Mcap => "give a recording of point clouds with --mcap instead",
            Self::Npy | Self::Utf16 => "save it with numpy.save",
        }
    }
}

/// Refuses what cannot be read twice: a pipe, a device or a folder.
pub(crate) fn must_be_a_file(path: &Path) -> Result<()> {
    let found = std::fs::metadata(path).map_err(|error| Error::read(path, error))?;
    if found.is_file() {
        return Ok(());
    }
    let (what, remedy) = match found.is_dir() {
        true => ("a folder", "give a file in it"),
        false => (
            "a pipe or a device, which is read only once",
            "save it first, as in `cat PIPE > FILE`, and give that file",
        ),
    };
    Err(Error::input(path.display(), "a file", what, remedy))
}
