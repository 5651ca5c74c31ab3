//! A long table: `track,frame,time,x,y[,z],vx,vy[,vz],…`, one row for each particle and frame. Numbers
//! have the digits that give the same number when they are read.

use super::Frames;
use crate::error::{Error, Result};
use crate::output::Output;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

/// Writes it.
///
/// # Errors
/// [`Error::File`] if it cannot be written, [`Error::Input`] where frames have other columns.
pub(super) fn write(
    frames: &Frames<'_>,
    out: &Path,
    note: &mut dyn FnMut(u64),
) -> Result<Vec<PathBuf>> {
    let output = Output::create(out)?;
    rows(frames, &output, note).inspect_err(|_| output.discard())?;
    output.complete()?;
    Ok(vec![out.to_owned()])
}

fn rows(frames: &Frames<'_>, output: &Output, note: &mut dyn FnMut(u64)) -> Result<()> {
    let failed = |error: csv::Error| {
        let text = error.to_string();
        let source = match error.into_kind() {
            csv::ErrorKind::Io(source) => source,
            _ => std::io::Error::other(text),
        };
        Error::write(output.unfinished(), source)
    };
    let mut writer = csv::Writer::from_writer(BufWriter::new(output.file()?));
    let axes = &["x", "y", "z"][..frames.dimension()];
    let first = frames.cloud(0)?;
    // In the plane the third component is zero, and left out.
    let shown = |name: &str| frames.dimension() > 2 || name != "vz";
    let names = first.columns.iter().map(|column| column.name.as_str()).filter(|name| shown(name));
    let head = ["track", "frame", "time"].into_iter().chain(axes.iter().copied()).chain(names);
    writer.write_record(head).map_err(failed)?;
    let mut record = csv::ByteRecord::new();
    for k in 0..frames.count() {
        let cloud = frames.cloud(k)?;
        let names = |cloud: &crate::recording::Cloud| -> Vec<String> {
            cloud.columns.iter().map(|column| column.name.clone()).collect()
        };
        if names(&cloud) != names(&first) {
            let place = format!("{}, t = {}", frames.topic, cloud.time);
            let expected = format!("the columns of the first frame, {:?}", names(&first));
            let remedy = "export to vtp, which has a table for each frame";
            return Err(Error::input(place, expected, format!("{:?}", names(&cloud)), remedy));
        }
        let columns: Vec<_> = cloud.columns.iter().filter(|column| shown(&column.name)).collect();
        for (i, position) in cloud.positions.iter().enumerate() {
            record.clear();
            record.push_field(i.to_string().as_bytes());
            record.push_field(frames.chosen[k].to_string().as_bytes());
            let position = &position[..axes.len()];
            let columns = columns.iter().map(|column| column.values[i]);
            for number in [cloud.time].into_iter().chain(position.iter().copied()).chain(columns) {
                record.push_field(format!("{number:?}").as_bytes());
            }
            writer.write_byte_record(&record).map_err(failed)?;
        }
        note(k as u64 + 1);
    }
    writer.flush().map_err(|error| Error::write(output.unfinished(), error))
}
