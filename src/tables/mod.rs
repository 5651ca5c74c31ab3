//! Tables of tracks that other programs wrote: rows of track, frame or time, position and,
//! perhaps, velocity.
//!
//! | format | file | module |
//! |---|---|---|
//! | comma, semicolon, tab or blanks between columns | `.csv`, `.txt`, … | `text` |
//! | Tecplot ASCII | `.dat` with `VARIABLES` | `tecplot` |
//! | OpenPTV | `ptv_is.N`, `xuap.N` | `openptv` |
//! | NumPy archive | `.npz` | `npz` |
//! | LagrangeBench, flowtracks (feature `hdf5`) | `.h5` | `hdf5` |
//!
//! Each module yields rows; `assembly` turns rows into frames of the same particles, and says what
//! was dropped on the way.

mod assembly;
mod columns;
mod derivative;
#[cfg(feature = "hdf5")]
mod hdf5;
mod memory;
mod npz;
mod open;
mod openptv;
mod presence;
mod statement;
mod survey;
mod tecplot;
mod text;
mod units;

pub(crate) use assembly::{Assembled, Known, assemble};
use derivative::{derive, noise_of};
use open::open;
pub use statement::{Dropped, Statement, Velocities};
pub use units::{Units, interval_of_rate};

use crate::error::Result;
use std::path::PathBuf;

/// How velocities are found that a table does not have.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Derive {
    /// The derivative of a smoothing spline.
    Spline,
    /// Central differences.
    Central,
}

/// A table of tracks to import, and what is known of it. Lengths are in the table's units.
#[derive(Clone, Debug, Default)]
pub struct Tracks {
    /// Its files: one table, or one for each frame.
    pub files: Vec<PathBuf>,
    /// Name of the format; `None` finds it by the names and first bytes of the files.
    pub format: Option<String>,
    /// What its columns are, where no header says it.
    pub columns: Option<String>,
    /// Its units.
    pub units: Units,
    /// The cuboid outside of which rows are dropped: lower and upper end along each axis.
    pub crop: Option<Vec<(f64, f64)>>,
    /// Standard deviation of positions.
    pub noise: Option<f64>,
    /// How velocities are derived; `None` takes the table's.
    pub derive: Option<Derive>,
    /// First and last frame to keep, in the table's numbers; `None` takes the range that keeps most.
    pub frames: Option<(i64, i64)>,
    /// Whether a single missing frame of a track is interpolated.
    pub fill_gaps: bool,
    /// Name of the trajectory in a file that holds several.
    pub trajectory: Option<String>,
}

/// Why a row is dropped by a reader.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Lost {
    Unlinked,
    NoPosition,
    NotSmoothed,
    NotFluid,
    Outside,
    NoVelocity,
}

/// One row of a table; what the table does not have is NaN.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Row {
    pub(crate) track: i64,
    pub(crate) frame: f64,
    pub(crate) time: f64,
    pub(crate) position: [f64; 3],
    pub(crate) velocity: [f64; 3],
    pub(crate) lost: Option<Lost>,
}

impl Row {
    /// A row without anything in it.
    pub(crate) const EMPTY: Self = Self {
        track: 0,
        frame: f64::NAN,
        time: f64::NAN,
        position: [f64::NAN; 3],
        velocity: [f64::NAN; 3],
        lost: None,
    };
}

/// What a table holds, as far as it says so itself.
#[derive(Clone, Debug, Default)]
pub(crate) struct Held {
    pub(crate) dimension: usize,
    pub(crate) velocities: bool,
    /// Time between two frame numbers, in the table's units.
    pub(crate) interval: Option<f64>,
    /// Lower corner and sides of its box, in the table's units.
    pub(crate) bounds: Option<Vec<(f64, f64)>>,
    /// The format, and which columns were taken, in words.
    pub(crate) words: String,
}

/// Called with what is being done, how much of it is done, and how much there is.
pub type Watch<'a> = &'a mut dyn FnMut(&'static str, u64, u64);

/// Called with every row of a table.
pub(crate) type Each<'a> = &'a mut dyn FnMut(&Row) -> Result<()>;

/// Called with bytes or rows done, and all of them.
pub(crate) type Progress<'a> = &'a mut dyn FnMut(u64, u64);

/// A table that can be read more than once.
pub(crate) trait Table {
    /// What it holds.
    fn held(&self) -> &Held;

    /// Calls `each` with every row, and `watch` with bytes or rows done and all of them.
    fn rows(&self, each: Each<'_>, watch: Progress<'_>) -> Result<()>;
}
