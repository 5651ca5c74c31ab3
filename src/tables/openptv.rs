//! OpenPTV: one file a frame, `ptv_is.N` or `xuap.N`. The first line is the number of rows; a row
//! of `ptv_is` is `previous next x y z`, one of `xuap` is
//! `previous next x y z xf yf zf u v w ax ay az flag` with positions and velocities of a smoothing
//! spline where the flag is 1. `previous` is the row in the file before, negative for none: the
//! chain of these is a track.

use super::open::{Files, frame_of_name};
use super::{Each, Held, Lost, Progress, Row, Table};
use crate::error::{Error, Result};
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

/// Columns of a row, without and with the spline.
const WIDTHS: [usize; 2] = [5, 15];

/// Files of OpenPTV.
pub(super) struct OpenPtv {
    files: Files,
    held: Held,
}

impl OpenPtv {
    /// Opens the files.
    ///
    /// # Errors
    /// [`Error::Input`] for a name without the number of the frame.
    pub(super) fn open(files: Files) -> Result<Self> {
        if let Some(path) = files.paths.iter().find(|path| frame_of_name(path).is_none()) {
            let expected = "names with the number of the frame, such as ptv_is.10001";
            return Err(Error::input("import", expected, path.display(), "rename the file"));
        }
        let first = files.first().file_name().unwrap_or_default().to_string_lossy().into_owned();
        let velocities = first.starts_with("xuap");
        let held = Held {
            dimension: 3,
            velocities,
            words: format!("OpenPTV, {}", if velocities { "xuap" } else { "ptv_is" }),
            ..Held::default()
        };
        Ok(Self { files, held })
    }
}

impl Table for OpenPtv {
    fn held(&self) -> &Held {
        &self.held
    }

    fn rows(&self, each: Each<'_>, watch: Progress<'_>) -> Result<()> {
        let mut chains = Chains::default();
        let mut done = 0;
        for (path, size) in self.files.paths.iter().zip(&self.files.sizes) {
            let frame = frame_of_name(path).unwrap_or(f64::NAN);
            chains.begin(frame);
            read(path, frame, &mut chains, each)?;
            done += size;
            watch(done, self.files.bytes);
        }
        Ok(())
    }
}

/// The tracks of the rows of the frame before, and of those of the current one.
#[derive(Default)]
struct Chains {
    frame: Option<f64>,
    before: Vec<i64>,
    now: Vec<i64>,
    count: i64,
}

impl Chains {
    fn begin(&mut self, frame: f64) {
        self.before = std::mem::take(&mut self.now);
        if self.frame.is_none_or(|before| (frame - before - 1.0).abs() > 0.5) {
            // A file is missing: no chain passes it.
            self.before.clear();
        }
        self.frame = Some(frame);
    }

    /// The track of a row that follows row `previous` of the file before.
    fn track(&mut self, previous: f64) -> i64 {
        let known = (previous >= 0.0).then(|| self.before.get_mut(previous as usize)).flatten();
        // A row that two rows claim to follow is followed by the first.
        let found = known.map(|track| std::mem::replace(track, -1)).filter(|track| *track >= 0);
        let track = found.unwrap_or_else(|| {
            self.count += 1;
            self.count - 1
        });
        self.now.push(track);
        track
    }
}

fn read(
    path: &Path,
    frame: f64,
    chains: &mut Chains,
    each: &mut dyn FnMut(&Row) -> Result<()>,
) -> Result<()> {
    let failed = |error| Error::read(path, error);
    let mut lines = BufReader::new(File::open(path).map_err(failed)?).lines();
    let refuse = |line: usize, expected: String, found: String| {
        let remedy = "give whole files of OpenPTV, ptv_is.N or xuap.N";
        let place = format!("{}, line {line}", path.display());
        Err(Error::input(place, expected, found, remedy))
    };
    let head = lines.next().transpose().map_err(failed)?.unwrap_or_default();
    let Ok(count) = head.trim().parse::<usize>() else {
        return refuse(1, "the number of rows".to_owned(), format!("{head:?}"));
    };
    let mut seen = 0;
    for (k, line) in lines.enumerate() {
        let line = line.map_err(failed)?;
        let numbers: Vec<f64> =
            line.split_whitespace().map(|x| x.parse().unwrap_or(f64::NAN)).collect();
        if numbers.is_empty() {
            continue;
        }
        if !WIDTHS.contains(&numbers.len()) {
            let expected = "5 numbers (ptv_is) or 15 (xuap)".to_owned();
            return refuse(k + 2, expected, format!("{}", numbers.len()));
        }
        seen += 1;
        let track = chains.track(numbers[0]);
        let three = |at: usize| std::array::from_fn(|axis| numbers[at + axis]);
        let mut row = Row { track, frame, position: three(2), ..Row::EMPTY };
        if numbers.len() == WIDTHS[1] {
            (row.position, row.velocity) = (three(5), three(8));
            row.lost = (numbers[14] < 0.5).then_some(Lost::NotSmoothed);
        }
        each(&row)?;
    }
    if seen == count {
        return Ok(());
    }
    refuse(1, format!("{count} rows, as the first line says"), seen.to_string())
}
