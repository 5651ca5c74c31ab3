//! VTK XML files of points for ParaView. Positions are written once, as points, and times once, in
//! the `.pvd`: filters for path lines take both from there. Numbers are raw bytes after the text
//! (`AppendedData`), each array after its length in bytes as `UInt64`.

use super::{Frames, arrays_of};
use crate::error::{Error, Result};
use crate::output::Output;
use crate::recording::Cloud;
use std::fmt::Write as _;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

/// Writes `NAME.pvd`, and `NAME/NAME_00000.vtp` and so on beside it.
///
/// # Errors
/// [`Error::File`] for files that cannot be written.
pub(super) fn write(
    frames: &Frames<'_>,
    out: &Path,
    note: &mut dyn FnMut(u64),
) -> Result<Vec<PathBuf>> {
    let stem = out.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let folder = out.with_extension("");
    let mut collection = String::new();
    let mut files = vec![out.to_owned()];
    for k in 0..frames.count() {
        let cloud = frames.cloud(k)?;
        let name = format!("{stem}_{k:05}.vtp");
        let path = folder.join(&name);
        write_frame(&cloud, &path)?;
        let folder = folder.file_name().unwrap_or_default().to_string_lossy();
        let file = escaped(&format!("{folder}/{name}"));
        // Writing to a string does not fail.
        let _ = writeln!(
            collection,
            "    <DataSet timestep=\"{:?}\" part=\"0\" file=\"{file}\"/>",
            cloud.time
        );
        if k == 0 || k + 1 == frames.count() {
            files.push(path);
        }
        note(k as u64 + 1);
    }
    let text = format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"Collection\" version=\"1.0\" byte_order=\"LittleEndian\" \
         header_type=\"UInt64\">\n  <Collection>\n{collection}  </Collection>\n</VTKFile>\n"
    );
    Output::write(out, text.as_bytes())?;
    Ok(files)
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}

/// An array of the file.
struct Block {
    name: String,
    kind: &'static str,
    components: usize,
    bytes: Vec<u8>,
}

fn write_frame(cloud: &Cloud, path: &Path) -> Result<()> {
    let count = cloud.positions.len();
    let doubles = |name: String, columns: &[&[f64]]| {
        let rows = (0..count).flat_map(|k| columns.iter().map(move |column| column[k]));
        let bytes = rows.flat_map(f64::to_le_bytes).collect();
        Block { name, kind: "Float64", components: columns.len(), bytes }
    };
    let whole = |name: &str, numbers: &mut dyn Iterator<Item = u64>| {
        let bytes = numbers.flat_map(|k| (k as i64).to_le_bytes()).collect();
        Block { name: name.to_owned(), kind: "Int64", components: 1, bytes }
    };
    let mut data: Vec<Block> =
        arrays_of(cloud).into_iter().map(|(name, columns)| doubles(name, &columns)).collect();
    data.push(whole("id", &mut (0..count as u64)));
    let flat = cloud.positions.iter().flatten().flat_map(|x| x.to_le_bytes()).collect();
    let points = Block { name: "Points".to_owned(), kind: "Float64", components: 3, bytes: flat };
    let vertices =
        [whole("connectivity", &mut (0..count as u64)), whole("offsets", &mut (1..=count as u64))];
    let mut offset = 0;
    let mut tag = |block: &Block| {
        let Block { name, kind, components, bytes } = block;
        let text = format!(
            "        <DataArray type=\"{kind}\" Name=\"{}\" NumberOfComponents=\"{components}\" format=\"appended\" \
             offset=\"{offset}\"/>\n",
            escaped(name)
        );
        offset += 8 + bytes.len();
        text
    };
    let [data_tags, point_tags, vertex_tags] =
        [&data[..], std::slice::from_ref(&points), &vertices[..]]
            .map(|blocks| blocks.iter().map(&mut tag).collect::<String>());
    let head = format!(
        "<?xml version=\"1.0\"?>\n<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" \
         header_type=\"UInt64\">\n  <PolyData>\n    <Piece NumberOfPoints=\"{count}\" NumberOfVerts=\"{count}\" \
         NumberOfLines=\"0\" NumberOfStrips=\"0\" NumberOfPolys=\"0\">\n      \
         <PointData>\n{data_tags}      </PointData>\n      <Points>\n{point_tags}      </Points>\n      \
         <Verts>\n{vertex_tags}      </Verts>\n    </Piece>\n  </PolyData>\n  <AppendedData encoding=\"raw\">\n_"
    );
    let output = Output::create(path)?;
    let write = || {
        let mut file = BufWriter::new(output.file()?);
        let failed = |error| Error::write(output.unfinished(), error);
        file.write_all(head.as_bytes()).map_err(failed)?;
        for block in data.iter().chain([&points]).chain(&vertices) {
            file.write_all(&(block.bytes.len() as u64).to_le_bytes()).map_err(failed)?;
            file.write_all(&block.bytes).map_err(failed)?;
        }
        file.write_all(b"\n  </AppendedData>\n</VTKFile>\n").map_err(failed)?;
        file.flush().map_err(failed)
    };
    write().inspect_err(|_| output.discard())?;
    output.complete()
}
