//! Recordings in the formats of other programs.
//!
//! | to | what | module |
//! |---|---|---|
//! | `vtp` | ParaView: a `.pvd` with the times, and a `.vtp` of points for each frame | `vtp` |
//! | `npz` | NumPy: `positions` `[frames, particles, dimension]`, … | `npz` |
//! | `csv` | a long table, one row for each particle and frame | `table` |
//! | `lagrangebench` | HDF5 with `metadata.json` (feature `hdf5`) | `lagrangebench` |
//! | `learned` | iterations of a training, as `.json` or `.csv` | `learned` |
//!
//! One frame at a time is held, except for HDF5.

#[cfg(feature = "hdf5")]
mod lagrangebench;
mod learned;
mod npz;
mod table;
mod vtp;

use crate::error::{Error, Result};
use crate::interrupt;
use crate::output::must_differ;
use crate::recording::{Cloud, Flow, Recording};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// A format to export to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// `.vtp` files with a `.pvd`.
    Vtp,
    /// An archive of arrays.
    Npz,
    /// A long table.
    Csv,
    /// HDF5 as LagrangeBench has it.
    LagrangeBench,
    /// What was learned.
    Learned,
}

impl Format {
    /// All formats with their names and the extension of the file to write.
    const ALL: [(&'static str, Self, &'static str); 5] = [
        ("vtp", Self::Vtp, "pvd"),
        ("npz", Self::Npz, "npz"),
        ("csv", Self::Csv, "csv"),
        ("lagrangebench", Self::LagrangeBench, "h5"),
        ("learned", Self::Learned, "json"),
    ];

    /// The format of a name or, without one, of a file.
    ///
    /// # Errors
    /// [`Error::Input`] for a name that is not known.
    pub fn of(name: Option<&str>, out: &Path) -> Result<Self> {
        let extension = out.extension().unwrap_or_default().to_string_lossy();
        let found = Self::ALL.into_iter().find(|(known, _, ending)| match name {
            Some(name) => name == *known,
            None => extension == *ending,
        });
        found.map(|(_, format, _)| format).ok_or_else(|| {
            let all = Self::ALL.map(|(name, _, ending)| format!("{name} (.{ending})"));
            let expected = format!("one of {}", all.join(", "));
            let found = name.map_or_else(|| format!("{}", out.display()), str::to_owned);
            Error::input("--to", expected, found, "name the format with --to")
        })
    }

    /// The usual extension of its file.
    pub fn extension(self) -> &'static str {
        let found = Self::ALL.into_iter().find(|(_, format, _)| *format == self);
        found.map_or("", |(_, _, extension)| extension)
    }
}

/// An export.
#[derive(Clone, Debug)]
pub struct Export {
    /// The recording.
    pub recording: PathBuf,
    /// The format.
    pub to: Format,
    /// The file to write; of several topics each gets its own, with the topic in its name.
    pub out: PathBuf,
    /// The topic; without one, all topics with particles.
    pub topic: Option<String>,
    /// Every how many frames one is exported.
    pub every: usize,
    /// Whether files that are there are replaced.
    pub overwrite: bool,
}

/// What was exported.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Exported {
    /// The files that were written; of many frames the first and the last.
    pub files: Vec<PathBuf>,
    /// Frames of all topics.
    pub frames: usize,
    /// Particles of the last frame.
    pub particles: usize,
    /// Iterations of learning.
    pub iterations: usize,
    /// Whether the recording is incomplete, as of a killed run.
    pub truncated: bool,
}

/// Called with frames done, and all of them.
pub type Watch<'a> = &'a mut dyn FnMut(u64, u64);

impl Export {
    /// Exports.
    ///
    /// # Errors
    /// [`Error::Input`] for a recording without such particles, or for files that are there;
    /// [`Error::File`] for files that cannot be read or written.
    pub fn run(&self, watch: Watch<'_>) -> Result<Exported> {
        let recording = Recording::open(&self.recording)?;
        let mut exported = Exported { truncated: recording.is_truncated(), ..Exported::default() };
        must_differ(&self.out, &[&self.recording])?;
        if self.every == 0 {
            let remedy = "1 takes every frame";
            return Err(Error::input("--every", "a positive number", 0, remedy));
        }
        if self.to == Format::Learned {
            self.may_write(&self.out)?;
            exported.iterations = learned::write(&recording, (&self.recording, &self.out))?;
            exported.files.push(self.out.clone());
            return Ok(exported);
        }
        let topics = self.topics(&recording)?;
        let counts = |topic: &String| recording.cloud_times(topic).len().div_ceil(self.every);
        let all: usize = topics.iter().map(counts).sum();
        for topic in &topics {
            let out = if topics.len() > 1 { self.named(topic) } else { self.out.clone() };
            self.may_write(&out)?;
            let done = exported.frames as u64;
            let frames = Frames::new(&recording, topic, self.every);
            let mut note = |k: u64| watch(done + k, all as u64);
            match self.to {
                Format::Vtp => exported.files.extend(vtp::write(&frames, &out, &mut note)?),
                Format::Npz => exported.files.extend(npz::write(&frames, &out, &mut note)?),
                Format::Csv => exported.files.extend(table::write(&frames, &out, &mut note)?),
                #[cfg(feature = "hdf5")]
                Format::LagrangeBench => {
                    self.may_write(&out.with_file_name(lagrangebench::METADATA))?;
                    exported.files.extend(lagrangebench::write(&frames, &out, &mut note)?);
                }
                #[cfg(not(feature = "hdf5"))]
                Format::LagrangeBench => {
                    let remedy = "build with `--features hdf5`";
                    return Err(Error::input("--to", "a format of this build", "HDF5", remedy));
                }
                Format::Learned => {}
            }
            exported.frames += frames.count();
            exported.particles = frames.cloud(frames.count() - 1)?.positions.len();
        }
        Ok(exported)
    }

    /// The topics to export.
    fn topics(&self, recording: &Recording) -> Result<Vec<String>> {
        let there = recording.cloud_topics();
        let place = self.recording.display();
        let list = if there.is_empty() { "none".to_owned() } else { there.join(", ") };
        match &self.topic {
            Some(topic) if there.contains(topic) => Ok(vec![topic.clone()]),
            Some(topic) => {
                let expected = format!("a topic with particles: {list}");
                Err(Error::input("--topic", expected, topic, "name one of them"))
            }
            None if there.is_empty() => {
                let remedy = "export what was learned: --to learned";
                Err(Error::input(place, "a recording with particles", list, remedy))
            }
            None => Ok(there),
        }
    }

    /// The file of one of several topics: `flow.csv` of `/truth/particles` is `flow-truth.csv`.
    fn named(&self, topic: &str) -> PathBuf {
        let short = Flow::ALL.iter().find(|flow| flow.topic() == topic);
        let short = short.map_or(topic, |_| topic.trim_end_matches("/particles"));
        let short = short.trim_end_matches("/particles").trim_matches('/').replace('/', "-");
        let stem = self.out.file_stem().unwrap_or_default().to_string_lossy();
        let extension = self.out.extension().unwrap_or_default().to_string_lossy();
        self.out.with_file_name(format!("{stem}-{short}.{extension}"))
    }

    /// Refuses to replace the recording, or a file that is there.
    fn may_write(&self, path: &Path) -> Result<()> {
        must_differ(path, &[&self.recording])?;
        if !path.exists() || self.overwrite {
            return Ok(());
        }
        let remedy = "give another name with --out, or --overwrite to lose what is there";
        Err(Error::input(path.display(), "a new name", "a file that is there", remedy))
    }
}

/// The frames of a topic that are exported.
struct Frames<'a> {
    recording: &'a Recording,
    topic: &'a str,
    chosen: Vec<usize>,
}

impl<'a> Frames<'a> {
    fn new(recording: &'a Recording, topic: &'a str, every: usize) -> Self {
        let chosen = (0..recording.cloud_times(topic).len()).step_by(every).collect();
        Self { recording, topic, chosen }
    }

    fn count(&self) -> usize {
        self.chosen.len()
    }

    fn cloud(&self, k: usize) -> Result<Cloud> {
        interrupt::check()?;
        self.recording.cloud(self.topic, self.chosen[k])
    }

    fn dimension(&self) -> usize {
        self.recording.run().dimension
    }

    /// Refuses frames with other particles or columns than the first, for formats of whole arrays.
    fn must_be_alike(&self, first: &Cloud, other: &Cloud) -> Result<()> {
        let names = |cloud: &Cloud| -> Vec<String> {
            cloud.columns.iter().map(|column| column.name.clone()).collect()
        };
        let shape = |cloud: &Cloud| (cloud.positions.len(), names(cloud));
        if shape(first) == shape(other) {
            return Ok(());
        }
        let place = format!("{}, t = {}", self.topic, other.time);
        let expected = format!("the particles and columns of the first frame, {:?}", shape(first));
        let remedy = "export to csv or vtp, which have a table for each frame";
        Err(Error::input(place, expected, format!("{:?}", shape(other)), remedy))
    }
}

/// The columns of a cloud as arrays with names: vectors of three components, and numbers.
fn arrays_of(cloud: &Cloud) -> Vec<(String, Vec<&[f64]>)> {
    let column = |name: &str| {
        let found = cloud.columns.iter().find(|column| column.name == name);
        found.map(|column| column.values.as_slice())
    };
    let velocity = ["vx", "vy", "vz"].map(column);
    let mut arrays = Vec::new();
    if let [Some(x), Some(y), Some(z)] = velocity {
        arrays.push(("velocity".to_owned(), vec![x, y, z]));
    }
    for found in &cloud.columns {
        let known = !arrays.is_empty() && ["vx", "vy", "vz"].contains(&found.name.as_str());
        if !known {
            let name = if found.name == "rho" { "density" } else { &found.name };
            arrays.push((name.to_owned(), vec![&found.values]));
        }
    }
    arrays
}
