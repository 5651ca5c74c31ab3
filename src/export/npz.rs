//! An archive for `numpy.load`: `time` `[frames]`, `positions` and `velocities`
//! `[frames, particles, dimension]`, `densities` `[frames, particles]`, other columns by their names,
//! the sides of the `box`, and the number `dt`. Arrays are doubles and not compressed, as of `numpy.savez`.

use super::{Frames, arrays_of};
use crate::arrays::Array;
use crate::error::{Error, Result};
use crate::output::Output;
use crate::recording::Cloud;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

/// Writes it; each array is one pass over the frames.
///
/// # Errors
/// [`Error::File`] if it cannot be written, [`Error::Input`] where frames have other particles.
pub(super) fn write(
    frames: &Frames<'_>,
    out: &Path,
    note: &mut dyn FnMut(u64),
) -> Result<Vec<PathBuf>> {
    let output = Output::create(out)?;
    arrays(frames, &output, note).inspect_err(|_| output.discard())?;
    output.complete()?;
    Ok(vec![out.to_owned()])
}

/// The name of an array of all frames.
fn plural(name: &str) -> &str {
    match name {
        "velocity" => "velocities",
        "density" => "densities",
        other => other,
    }
}

fn arrays(frames: &Frames<'_>, output: &Output, note: &mut dyn FnMut(u64)) -> Result<()> {
    let mut archive = Archive::new(output)?;
    let first = frames.cloud(0)?;
    let (count, dimension) = (frames.count(), frames.dimension());
    let particles = first.positions.len();
    let mut times = Vec::new();
    archive.begin("positions", &[count, particles, dimension])?;
    for k in 0..count {
        let cloud = frames.cloud(k)?;
        frames.must_be_alike(&first, &cloud)?;
        times.push(cloud.time);
        archive.numbers(cloud.positions.iter().flat_map(|r| r[..dimension].iter().copied()))?;
        note(k as u64 + 1);
    }
    for (at, (name, columns)) in arrays_of(&first).iter().enumerate() {
        let shape = [count, particles, columns.len().min(dimension)];
        let axes = if columns.len() > 1 { 3 } else { 2 };
        archive.begin(plural(name), &shape[..axes])?;
        for k in 0..count {
            let cloud: Cloud = frames.cloud(k)?;
            let all = arrays_of(&cloud);
            let columns = &all[at].1[..shape[2]];
            let rows = (0..particles).flat_map(|i| columns.iter().map(move |column| column[i]));
            archive.numbers(rows)?;
        }
    }
    archive.begin("time", &[count])?;
    archive.numbers(times.iter().copied())?;
    archive.begin("box", &[dimension])?;
    archive.numbers((0..dimension).map(|axis| frames.recording.run().space().side(axis)))?;
    if let [first, second, ..] = times[..] {
        archive.begin("dt", &[])?;
        archive.numbers([second - first].into_iter())?;
    }
    archive.finish()
}

/// A zip archive being written.
struct Archive<'a> {
    zip: ZipWriter<BufWriter<File>>,
    output: &'a Output,
    bytes: Vec<u8>,
}

impl<'a> Archive<'a> {
    fn new(output: &'a Output) -> Result<Self> {
        let zip = ZipWriter::new(BufWriter::new(output.file()?));
        Ok(Self { zip, output, bytes: Vec::new() })
    }

    fn failed(&self, error: zip::result::ZipError) -> Error {
        Error::write(self.output.unfinished(), error.into())
    }

    fn begin(&mut self, name: &str, shape: &[usize]) -> Result<()> {
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
        let options = options.large_file(true);
        let begun = self.zip.start_file(format!("{name}.npy"), options);
        begun.map_err(|error| self.failed(error))?;
        let header = Array::header("<f8", shape);
        self.write(&header)
    }

    fn numbers(&mut self, numbers: impl Iterator<Item = f64>) -> Result<()> {
        let mut bytes = std::mem::take(&mut self.bytes);
        bytes.clear();
        bytes.extend(numbers.flat_map(f64::to_le_bytes));
        self.write(&bytes)?;
        self.bytes = bytes;
        Ok(())
    }

    fn write(&mut self, bytes: &[u8]) -> Result<()> {
        let written = self.zip.write_all(bytes);
        written.map_err(|error| Error::write(self.output.unfinished(), error))
    }

    fn finish(self) -> Result<()> {
        let unfinished = self.output.unfinished().to_owned();
        let finished = self.zip.finish().map_err(std::io::Error::from);
        let flushed = finished.and_then(|mut file| file.flush());
        flushed.map_err(|error| Error::write(&unfinished, error))
    }
}
