//! Tecplot ASCII files: `TITLE`, `VARIABLES` and `ZONE`, then rows of points; one zone or one file a
//! frame. The ONERA challenge of particle tracking has one file a frame.

use super::columns::{Columns, Role};
use super::open::{Files, frame_of_name};
use super::text::{must_have_tracks, row_of};
use super::{Each, Held, Progress, Row, Table, Tracks};
use crate::error::{Error, Result};
use csv::ByteRecord;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

/// Tecplot files.
pub(super) struct Tecplot {
    files: Files,
    columns: Columns,
    held: Held,
}

impl Tecplot {
    /// Opens the files, and finds the columns by the names of the variables.
    ///
    /// # Errors
    /// [`Error::Input`] where positions or tracks are not among them.
    pub(super) fn open(files: Files, tracks: &Tracks) -> Result<Self> {
        let path = files.first().to_owned();
        let place = path.display().to_string();
        let names = variables(&path)?;
        let columns = match &tracks.columns {
            Some(text) => Columns::of_text(text, (&names, names.len()))?,
            None => Columns::of_header(names.iter().map(String::as_str)),
        };
        let shown = names.join(" ");
        columns.must_have_positions(&place, &shown)?;
        // A zone is a frame where the rows do not say theirs.
        must_have_tracks(&columns, (&place, &shown), true)?;
        let held = Held {
            dimension: columns.dimension(),
            velocities: columns.has_velocities(),
            words: format!("Tecplot, variables {shown}"),
            ..Held::default()
        };
        Ok(Self { files, columns, held })
    }

    fn file(
        &self,
        path: &Path,
        zones: &mut Zones,
        each: &mut dyn FnMut(&Row) -> Result<()>,
        watch: &mut dyn FnMut(u64),
    ) -> Result<()> {
        let failed = |error| Error::read(path, error);
        let mut reader = BufReader::with_capacity(1 << 16, File::open(path).map_err(failed)?);
        let (mut raw, mut record) = (Vec::new(), ByteRecord::new());
        let (mut line, mut bytes, mut is_list) = (0_u64, 0_u64, false);
        loop {
            raw.clear();
            match reader.read_until(b'\n', &mut raw).map_err(failed)? {
                0 => return Ok(()),
                count => bytes += count as u64,
            }
            let text = String::from_utf8_lossy(&raw);
            line += 1;
            let place = || format!("{}, line {line}", path.display());
            if let Some(word) = Keyword::of(&text) {
                is_list = word == Keyword::Variables;
                if word == Keyword::Zone {
                    zones.begin(&text, place)?;
                } else if word == Keyword::Other {
                    zones.refine(&text);
                }
                continue;
            }
            record.clear();
            let mark = |c: char| c.is_whitespace() || c == ',';
            let fields = text.split(mark).filter(|field| !field.is_empty());
            fields.for_each(|field| record.push_field(field.as_bytes()));
            let names_go_on = is_list && text.trim_start().starts_with('"');
            if record.is_empty() || names_go_on || text.trim_start().starts_with('#') {
                continue;
            }
            is_list = false;
            let mut row = row_of(&self.columns, &record, &place)?;
            zones.stamp(&mut row, &self.columns);
            each(&row)?;
            if line % 4096 == 0 {
                watch(bytes);
            }
        }
    }
}

impl Table for Tecplot {
    fn held(&self) -> &Held {
        &self.held
    }

    fn rows(&self, each: Each<'_>, watch: Progress<'_>) -> Result<()> {
        let (mut done, all) = (0, self.files.bytes);
        let mut zones = Zones::default();
        for (k, path) in self.files.paths.iter().enumerate() {
            zones.file =
                (self.files.paths.len() > 1).then(|| frame_of_name(path).unwrap_or(k as f64));
            self.file(path, &mut zones, each, &mut |bytes| watch(done + bytes, all))?;
            done += self.files.sizes[k];
            watch(done, all);
        }
        Ok(())
    }
}

/// Which frame the rows belong to.
#[derive(Default)]
struct Zones {
    /// The number of the file, where there are several.
    file: Option<f64>,
    /// Zones so far.
    count: usize,
    /// `SOLUTIONTIME` of the current zone.
    time: Option<f64>,
}

impl Zones {
    fn begin(&mut self, text: &str, place: impl Fn() -> String) -> Result<()> {
        self.count += 1;
        self.time = None;
        self.refine(text);
        let upper = text.to_uppercase();
        if upper.contains("BLOCK") {
            let remedy = "write it with DATAPACKING=POINT, one row for each particle";
            return Err(Error::input(place(), "a zone of points (F=POINT)", text.trim(), remedy));
        }
        Ok(())
    }

    fn refine(&mut self, text: &str) {
        let upper = text.to_uppercase();
        let value = upper.split_once("SOLUTIONTIME").and_then(|(_, rest)| rest.split_once('='));
        let value = value.and_then(|(_, rest)| {
            let rest = rest.trim_start();
            let end = rest.find(|c: char| c.is_whitespace() || c == ',').unwrap_or(rest.len());
            rest[..end].parse().ok()
        });
        self.time = value.or(self.time);
    }

    /// Gives a row the frame or time of its zone, where it has none of its own.
    fn stamp(&self, row: &mut Row, columns: &Columns) {
        if columns.of(Role::Frame).is_some() || columns.of(Role::Time).is_some() {
            return;
        }
        match (self.time, self.file) {
            (Some(time), _) => row.time = time,
            (None, Some(file)) => row.frame = file,
            (None, None) => row.frame = self.count as f64,
        }
    }
}

/// What a line that is not a row begins with.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Keyword {
    Variables,
    Zone,
    Other,
}

impl Keyword {
    fn of(line: &str) -> Option<Self> {
        let line = line.trim_start();
        let first = line.chars().next()?;
        let word: String = line.chars().take_while(char::is_ascii_alphabetic).collect();
        match word.to_uppercase().as_str() {
            "VARIABLES" => Some(Self::Variables),
            "ZONE" => Some(Self::Zone),
            "NAN" | "INF" | "" => None,
            _ if first.is_ascii_alphabetic() => Some(Self::Other),
            _ => None,
        }
    }
}

/// The names in the list of variables: `VARIABLES = "X" "Y"`, `X, Y` or `X Y`, perhaps on several
/// lines.
fn variables(path: &Path) -> Result<Vec<String>> {
    let failed = |error| Error::read(path, error);
    let reader = BufReader::new(File::open(path).map_err(failed)?);
    let (mut names, mut is_list) = (Vec::new(), false);
    for line in reader.split(b'\n').take(1000) {
        let line = line.map_err(failed)?;
        let line = String::from_utf8_lossy(&line);
        match Keyword::of(&line) {
            Some(Keyword::Variables) => {
                is_list = true;
                let rest = line.split_once('=').map_or("", |(_, rest)| rest);
                names.extend(names_in(rest));
            }
            None if is_list && line.trim_start().starts_with('"') => names.extend(names_in(&line)),
            _ if is_list => return Ok(names),
            _ => {}
        }
    }
    let remedy = "add a line such as Variables = X Y Z PartID, or give --format text";
    Err(Error::input(path.display(), "a line with VARIABLES", "none", remedy))
}

fn names_in(text: &str) -> Vec<String> {
    if text.contains('"') {
        return text.split('"').skip(1).step_by(2).map(str::to_owned).collect();
    }
    let mark = |c: char| c.is_whitespace() || c == ',';
    text.split(mark).filter(|name| !name.is_empty()).map(str::to_owned).collect()
}
