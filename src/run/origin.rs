//! The origin of a truth: a file, identified by its bytes.

use crate::error::{Error, Result};
use crate::recording::Recording;
use std::io::Read;
use std::path::{Path, PathBuf};

/// Keys of a recording's metadata.
const FILE: &str = "truth_file";
const DIGEST: &str = "truth_digest";

/// A file of recorded particles from which a model was learned.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Origin {
    /// Its absolute path.
    pub path: PathBuf,
    /// Hash of its bytes: FNV-1a of 64 bits in hexadecimal, which detects mistakes, not forgery.
    pub digest: String,
}

impl Origin {
    /// The origin of a file as it is now.
    ///
    /// # Errors
    /// [`Error::File`] where it cannot be read.
    pub fn of(path: &Path) -> Result<Self> {
        let failed = |error| Error::read(path, error);
        let mut file = std::fs::File::open(path).map_err(failed)?;
        let (mut sum, mut part) = (0xcbf2_9ce4_8422_2325_u64, vec![0; 1 << 16]);
        loop {
            let count = file.read(&mut part).map_err(failed)?;
            if count == 0 {
                break;
            }
            let add = |sum: u64, byte: &u8| (sum ^ u64::from(*byte)).wrapping_mul(0x100_0000_01b3);
            sum = part[..count].iter().fold(sum, add);
        }
        let path = std::fs::canonicalize(path).map_err(failed)?;
        Ok(Self { path, digest: format!("fnv1a-{sum:016x}") })
    }

    /// The origin of the truth in a training's recording; none where the truth was run from the
    /// scene.
    pub fn recorded(recording: &Recording) -> Option<Self> {
        let metadata = &recording.run().metadata;
        let (path, digest) = (metadata.get(FILE)?.into(), metadata.get(DIGEST)?.clone());
        Some(Self { path, digest })
    }

    /// The origin as entries of a recording's metadata.
    pub(super) fn metadata(&self) -> [(String, String); 2] {
        let path = self.path.display().to_string();
        [(FILE.to_owned(), path), (DIGEST.to_owned(), self.digest.clone())]
    }

    /// Refuses a file that is missing or has changed; `place` is the recording that names it.
    ///
    /// # Errors
    /// [`Error::Input`], with the remedy.
    pub fn must_be_there(&self, place: &Path) -> Result<()> {
        let path = self.path.display();
        let expected =
            format!("the particles that the model was learned from, {path} ({})", self.digest);
        let refuse = |found: String| {
            let remedy = "give them with --truth FILE.mcap, or --truth SCENE to compare with a flow that a \
                          scene makes";
            Err(Error::input(place.display(), &expected, found, remedy))
        };
        match Self::of(&self.path) {
            Ok(found) if found.digest == self.digest => Ok(()),
            Ok(found) => refuse(format!("another file of that name ({})", found.digest)),
            Err(_) => refuse("no such file".to_owned()),
        }
    }
}

/// Refuses a recording without a scene of particles, such as an imported one, where a learned model is expected.
///
/// # Errors
/// [`Error::Input`], with the remedy.
pub fn must_be_trained(path: &Path, recording: &Recording) -> Result<()> {
    let run = recording.run();
    let is_dns = run.metadata.get("kind").is_some_and(|kind| kind == "dns");
    if !run.scene_toml.trim().is_empty() && !is_dns {
        return Ok(());
    }
    let file = path.display();
    let expected = "a learned model, as `train` records it";
    let command = run.metadata.get("command").map_or("another program", String::as_str);
    let found = match is_dns {
        true => "tracers of a direct numerical simulation".to_owned(),
        false => format!("a recording without a scene, of `{command}`"),
    };
    let remedy = format!(
        "learn from it first: `train SCENE --truth {file} --record learned.mcap`, then `evaluate learned.mcap`"
    );
    Err(Error::input(file, expected, found, remedy))
}
