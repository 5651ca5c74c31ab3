//! Tables as text: columns parted by commas, semicolons, tabs or blanks, with or without a header.

use super::columns::{Columns, Role};
use super::open::{Files, frame_of_name};
use super::{Each, Held, Lost, Progress, Row, Table, Tracks};
use crate::error::{Error, Result};
use csv::ByteRecord;
use std::fs::File;
use std::io::{BufRead, BufReader};
use std::path::Path;

/// Lines of a file, maximum, before the first row of numbers.
const LONGEST_HEAD: usize = 200;

/// Bytes of a line, maximum: that of a table has some hundreds.
const LONGEST_LINE: u64 = 1 << 20;

/// Lines of names and units, maximum, that follow a header, as TrackMate writes them.
const UNDER_HEADER: usize = 3;

/// How the columns of a file are parted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Parted {
    By(u8),
    Blanks,
}

impl Parted {
    /// As a line of numbers is.
    fn of(line: &str) -> Self {
        match [';', '\t', ','].into_iter().find(|mark| line.contains(*mark)) {
            // Tabs beside blanks that align numbers are blanks.
            Some(mark) => Self::By(mark as u8),
            None => Self::Blanks,
        }
    }

    fn split(self, line: &str) -> Vec<&str> {
        match self {
            Self::By(mark) => line.split(mark as char).map(str::trim).collect(),
            Self::Blanks => line.split_whitespace().collect(),
        }
    }

    fn words(self) -> &'static str {
        match self {
            Self::By(b';') => "semicolons",
            Self::By(b'\t') => "tabs",
            Self::By(_) => "commas",
            Self::Blanks => "blanks",
        }
    }
}

/// The lines before the first row of a file.
struct Head {
    /// Their number.
    lines: usize,
    parted: Parted,
    /// Names of the columns; empty without a header.
    names: Vec<String>,
    /// Columns of the first row.
    width: usize,
    /// The last of these lines or, without any, the first row.
    shown: String,
}

impl Head {
    fn read(path: &Path) -> Result<Self> {
        let failed = |error| Error::read(path, error);
        let mut reader = BufReader::new(File::open(path).map_err(failed)?);
        let (mut before, mut bytes) = (Vec::<String>::new(), Vec::new());
        while before.len() < LONGEST_HEAD {
            bytes.clear();
            let mut limited = std::io::Read::take(&mut reader, LONGEST_LINE);
            if limited.read_until(b'\n', &mut bytes).map_err(failed)? == 0 {
                break;
            }
            // Names of units may be in another encoding than UTF-8.
            let line = String::from_utf8_lossy(&bytes);
            if is_row(&line) {
                return Ok(Self::of(&before, line.trim()));
            }
            before.push(line.trim().trim_start_matches('\u{feff}').to_owned());
        }
        let found = before.first().map_or("an empty file", String::as_str);
        let remedy = "give a table of numbers, with a point in them and not a comma";
        let expected = "rows of numbers parted by commas, semicolons, tabs or blanks";
        Err(Error::input(path.display(), expected, format!("{found:.200}"), remedy))
    }

    fn of(before: &[String], row: &str) -> Self {
        let parted = Parted::of(row);
        let width = parted.split(row).len();
        let shown = before.last().map_or(row, String::as_str).to_owned();
        let candidates = before.iter().rev().filter(|line| !line.is_empty()).take(UNDER_HEADER + 1);
        let fields = |line: &String| -> Vec<String> {
            let line = line.trim_start_matches(['#', '%']);
            let clean = |name: &str| name.trim().trim_matches('"').to_owned();
            parted.split(line).into_iter().map(clean).collect()
        };
        let wide = candidates.map(fields).filter(|names| names.len() == width);
        let known = |names: &Vec<String>| {
            Columns::of_header(names.iter().map(String::as_str)).of(Role::X).is_some()
        };
        let wide: Vec<Vec<String>> = wide.collect();
        // Several lines may look like a header: the last with a column x is the one of keys.
        let named = wide.iter().rev().find(|names| known(names)).or_else(|| wide.last());
        let names = named.cloned().unwrap_or_default();
        Self { lines: before.len(), parted, names, width, shown }
    }
}

/// Whether a line holds numbers: at least two, and more of them than texts.
fn is_row(line: &str) -> bool {
    let line = line.trim();
    if line.starts_with(['#', '%']) {
        return false;
    }
    let fields = Parted::of(line).split(line);
    let numbers = fields.iter().filter(|field| field.parse::<f64>().is_ok()).count();
    numbers >= 2 && 2 * numbers >= fields.iter().filter(|field| !field.is_empty()).count()
}

/// A table as text.
pub(super) struct Text {
    files: Files,
    columns: Columns,
    held: Held,
}

impl Text {
    /// Opens it, and finds its columns.
    ///
    /// # Errors
    /// [`Error::Input`] where tracks, times or positions are not found.
    pub(super) fn open(files: Files, tracks: &Tracks) -> Result<Self> {
        let first = files.first();
        let head = Head::read(first)?;
        let columns = match &tracks.columns {
            Some(text) => Columns::of_text(text, (&head.names, head.width))?,
            None => Columns::of_header(head.names.iter().map(String::as_str)),
        };
        let place = first.display().to_string();
        columns.must_have_positions(&place, &head.shown)?;
        must_have_tracks(&columns, (&place, &head.shown), files.paths.len() > 1)?;
        let held = Held {
            dimension: columns.dimension(),
            velocities: columns.has_velocities(),
            words: format!("text, columns parted by {}", head.parted.words()),
            ..Held::default()
        };
        Ok(Self { files, columns, held })
    }

    fn file(
        &self,
        (k, path): (usize, &Path),
        each: &mut dyn FnMut(&Row) -> Result<()>,
        watch: &mut dyn FnMut(u64),
    ) -> Result<()> {
        let head = Head::read(path)?;
        let mut lines = Lines::open(path, &head)?;
        let frame = frame_of_name(path).unwrap_or(k as f64);
        let mut record = ByteRecord::new();
        while let Some(line) = lines.next(&mut record)? {
            let place = || format!("{}, line {line}", path.display());
            let mut row = row_of(&self.columns, &record, &place)?;
            if self.columns.of(Role::Frame).is_none() && self.columns.of(Role::Time).is_none() {
                row.frame = frame;
            }
            each(&row)?;
            if line % 4096 == 0 {
                watch(lines.bytes);
            }
        }
        Ok(())
    }
}

/// Refuses a table that does not say which rows are of one track, or of one time.
pub(super) fn must_have_tracks(
    columns: &Columns,
    (place, shown): (&str, &str),
    many: bool,
) -> Result<()> {
    let timed = columns.of(Role::Frame).is_some() || columns.of(Role::Time).is_some() || many;
    if columns.of(Role::Track).is_some() && timed {
        return Ok(());
    }
    let (expected, remedy) = match timed {
        true => (
            "a column with the number of the track",
            "link the positions to tracks first, or name the column: --columns track,frame,x,y,z",
        ),
        false => (
            "a column with the frame or the time, or one file for each frame",
            "name the column, as in --columns track,frame,x,y,z, or give all files",
        ),
    };
    Err(Error::input(place, expected, format!("{shown:?}"), remedy))
}

impl Table for Text {
    fn held(&self) -> &Held {
        &self.held
    }

    fn rows(&self, each: Each<'_>, watch: Progress<'_>) -> Result<()> {
        let (mut done, all) = (0, self.files.bytes);
        for (k, path) in self.files.paths.iter().enumerate() {
            self.file((k, path), each, &mut |bytes| watch(done + bytes, all))?;
            done += self.files.sizes[k];
            watch(done, all);
        }
        Ok(())
    }
}

/// The rows of a file after its head, as records.
enum Source {
    Csv(Box<csv::Reader<BufReader<File>>>),
    Blanks(BufReader<File>, Vec<u8>),
}

struct Lines {
    source: Source,
    line: u64,
    skipped: u64,
    bytes: u64,
    path: std::path::PathBuf,
}

impl Lines {
    fn open(path: &Path, head: &Head) -> Result<Self> {
        let failed = |error| Error::read(path, error);
        let mut reader = BufReader::with_capacity(1 << 16, File::open(path).map_err(failed)?);
        let (mut bytes, mut skip) = (0, Vec::new());
        for _ in 0..head.lines {
            skip.clear();
            bytes += reader.read_until(b'\n', &mut skip).map_err(failed)? as u64;
        }
        let source = match head.parted {
            Parted::Blanks => Source::Blanks(reader, Vec::new()),
            Parted::By(mark) => {
                let mut builder = csv::ReaderBuilder::new();
                builder.has_headers(false).flexible(true).comment(Some(b'#'));
                let reader = builder.trim(csv::Trim::All).delimiter(mark).from_reader(reader);
                Source::Csv(Box::new(reader))
            }
        };
        let skipped = head.lines as u64;
        Ok(Self { source, line: skipped, skipped, bytes, path: path.to_owned() })
    }

    /// The number of the next line with a row, which is put into `record`; none at the end.
    fn next(&mut self, record: &mut ByteRecord) -> Result<Option<u64>> {
        let Self { source, line, skipped, bytes, path } = self;
        match source {
            Source::Csv(reader) => {
                let more = reader.read_byte_record(record).map_err(|error| {
                    let remedy = "correct the table there";
                    Error::input(path.display(), "rows of a table", error, remedy)
                })?;
                *bytes = reader.position().byte();
                Ok(more.then(|| *skipped + record.position().map_or(0, csv::Position::line)))
            }
            Source::Blanks(reader, text) => loop {
                text.clear();
                let read = reader.read_until(b'\n', text);
                match read.map_err(|error| Error::read(path, error))? {
                    0 => return Ok(None),
                    count => *bytes += count as u64,
                }
                *line += 1;
                record.clear();
                let fields = text.split(u8::is_ascii_whitespace);
                fields.filter(|field| !field.is_empty()).for_each(|field| record.push_field(field));
                if record.get(0).is_some_and(|field| !field.starts_with(b"#")) {
                    return Ok(Some(*line));
                }
            },
        }
    }
}

/// The row of a record; an empty field is NaN.
pub(super) fn row_of(
    columns: &Columns,
    record: &ByteRecord,
    place: &dyn Fn() -> String,
) -> Result<Row> {
    let number = |role: Role| -> Result<f64> {
        let Some(at) = columns.of(role) else { return Ok(f64::NAN) };
        let Some(field) = record.get(at) else {
            let expected = format!("at least {} columns", at + 1);
            let remedy = "complete the row, or cut the table before it";
            return Err(Error::input(place(), expected, record.len(), remedy));
        };
        number_of(field).ok_or_else(|| {
            let found = format!("{:?}", String::from_utf8_lossy(field));
            let remedy = "write numbers with a point, and leave a field empty where one is missing";
            Error::input(place(), format!("a number in column {}", at + 1), found, remedy)
        })
    };
    let mut row = Row {
        track: -1,
        frame: number(Role::Frame)?,
        time: number(Role::Time)?,
        position: [number(Role::X)?, number(Role::Y)?, number(Role::Z)?],
        velocity: [number(Role::U)?, number(Role::V)?, number(Role::W)?],
        lost: None,
    };
    let track = number(Role::Track)?;
    if columns.of(Role::Z).is_none() {
        (row.position[2], row.velocity[2]) = (0.0, 0.0);
    }
    match track {
        id if id.is_nan() || id < 0.0 => row.lost = Some(Lost::Unlinked),
        id if id.fract().abs() < f64::MIN_POSITIVE && id < 9e15 => row.track = id as i64,
        id => {
            let remedy = "number the tracks";
            return Err(Error::input(place(), "a whole number of a track", id, remedy));
        }
    }
    Ok(row)
}

fn number_of(field: &[u8]) -> Option<f64> {
    let text = std::str::from_utf8(field).ok()?.trim().trim_matches('"');
    match text {
        "" | "NA" | "N/A" | "None" | "null" => Some(f64::NAN),
        text => text.parse().ok(),
    }
}
