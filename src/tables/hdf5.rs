//! HDF5 files in pure Rust.
//!
//! *LagrangeBench*: groups `00000`, … with `position` `[frames, particles, 2 or 3]` and
//! `particle_type` `[particles]`; beside the file `metadata.json` with `dt`, `write_every`, `bounds`
//! and `periodic_boundary_conditions`. Frames are `dt write_every` apart.
//!
//! *flowtracks*: a table `/particles` of records with `pos`, `velocity`, `time` and `trajid`, as
//! PyTables writes it.

use super::columns::Role;
use super::memory::{Long, Stacked};
use super::{Held, Table, Tracks};
use crate::arrays::Array;
use crate::error::{Error, Result};
use hdf5_pure::{CompoundMember, Dataset, Datatype, DatatypeByteOrder, File};
use std::path::Path;

/// The name of the table of flowtracks.
const PARTICLES: &str = "particles";

/// Opens a file of either kind.
///
/// # Errors
/// [`Error::Input`] for a file that is neither.
pub(super) fn open(path: &Path, tracks: &Tracks) -> Result<Box<dyn Table>> {
    let place = path.display().to_string();
    let file = File::open_streaming(path).map_err(|error| damaged(&place, error))?;
    let root = file.root();
    let datasets = root.datasets().map_err(|error| damaged(&place, error))?;
    if datasets.iter().any(|name| name == PARTICLES) {
        let dataset = file.dataset(PARTICLES).map_err(|error| damaged(&place, error))?;
        return Ok(Box::new(flowtracks(&dataset, &place)?));
    }
    let mut groups = root.groups().map_err(|error| damaged(&place, error))?;
    groups.retain(|name| file.dataset(&format!("{name}/position")).is_ok());
    groups.sort();
    let (Some(first), asked) = (groups.first(), &tracks.trajectory) else {
        let expected = "groups with `position` (LagrangeBench) or a table /particles (flowtracks)";
        let found = format!("datasets {datasets:?}");
        let remedy = "write a CSV with the columns track, frame, x, y, z";
        return Err(Error::input(place, expected, found, remedy));
    };
    let name = asked.as_ref().unwrap_or(first);
    if !groups.contains(name) {
        let last = groups.last().map_or("", String::as_str);
        let expected = format!("one of the {} trajectories, {first} to {last}", groups.len());
        return Err(Error::input("--trajectory", expected, name, "name one of them"));
    }
    Ok(Box::new(lagrangebench((&file, path), name, (groups.len(), tracks))?))
}

fn damaged(place: &str, error: impl std::fmt::Display) -> Error {
    Error::input(place, "an HDF5 file", error, "write the file again, with h5py for instance")
}

fn lagrangebench(
    (file, path): (&File, &Path),
    name: &str,
    (count, tracks): (usize, &Tracks),
) -> Result<Stacked> {
    let place = format!("{}, {name}", path.display());
    let read = |what: &str| -> Result<Option<Array>> {
        let Ok(dataset) = file.dataset(&format!("{name}/{what}")) else { return Ok(None) };
        let shape = dataset.shape().map_err(|error| damaged(&place, error))?;
        let values = dataset.read_f64().map_err(|error| damaged(&place, error))?;
        Ok(Some(Array::new(shape.iter().map(|n| *n as usize).collect(), values)))
    };
    let Some(positions) = read("position")? else {
        return Err(damaged(&place, "no `position`"));
    };
    let types = read("particle_type")?;
    let words = format!("LagrangeBench, trajectory {name}, one of {count}");
    let mut table = Stacked::new(&place, (positions, None), types, words)?;
    let metadata = path.with_file_name("metadata.json");
    if metadata.is_file() {
        describe(&mut table.held, &metadata, tracks)?;
    }
    Ok(table)
}

/// Takes interval and box from `metadata.json`.
fn describe(held: &mut Held, path: &Path, tracks: &Tracks) -> Result<()> {
    let text = std::fs::read_to_string(path).map_err(|error| Error::read(path, error))?;
    let refuse = |expected: &str, found: String, remedy: &str| {
        Err(Error::input(path.display(), expected, found, remedy))
    };
    let json: serde_json::Value = match serde_json::from_str(&text) {
        Ok(json) => json,
        Err(error) => return refuse("JSON", error.to_string(), "correct it, or move it away"),
    };
    let every = json["write_every"].as_f64().unwrap_or(1.0);
    held.interval = json["dt"].as_f64().map(|dt| dt * every);
    let pair = |range: &serde_json::Value| Some((range[0].as_f64()?, range[1].as_f64()?));
    let bounds = json["bounds"].as_array();
    let bounds = bounds.and_then(|all| all.iter().map(pair).collect::<Option<Vec<_>>>());
    held.bounds = bounds.filter(|bounds| bounds.len() == held.dimension);
    let walls = json["periodic_boundary_conditions"].as_array();
    let walled = |axes: &Vec<serde_json::Value>| axes.iter().any(|axis| axis == false);
    if walls.is_some_and(walled) && tracks.crop.is_none() {
        let found = json["periodic_boundary_conditions"].to_string();
        let remedy = "cut out a cube away from the walls with --crop";
        return refuse("periodic boundaries: the flow has no walls", found, remedy);
    }
    Ok(())
}

fn flowtracks(dataset: &Dataset, place: &str) -> Result<Long> {
    let place = &format!("{place}, /{PARTICLES}");
    let kind = dataset.datatype().map_err(|error| damaged(place, error))?;
    let Datatype::Compound { size, members, .. } = &kind else {
        return Err(damaged(place, "a table without named fields"));
    };
    let bytes = dataset.read_raw().map_err(|error| damaged(place, error))?;
    let member = |names: &[&str]| members.iter().find(|m| names.contains(&m.name.as_str()));
    let column = |member: Option<&CompoundMember>, axis: usize| -> Result<Option<Vec<f64>>> {
        let Some(member) = member else { return Ok(None) };
        let Some(field) = Field::of(member, axis) else {
            return Err(damaged(place, format!("a field {} of another type", member.name)));
        };
        let rows = bytes.chunks_exact((*size).max(1) as usize);
        let numbers: Option<Vec<f64>> = rows.map(|row| field.number(row)).collect();
        numbers.map(Some).ok_or_else(|| damaged(place, "fields that do not fit into a record"))
    };
    let (r, v) = (member(&["pos"]), member(&["velocity", "vel"]));
    let time = member(&["time"]);
    let whole = time.is_some_and(|time| matches!(time.datatype, Datatype::FixedPoint { .. }));
    let mut columns = vec![None; 9];
    columns[Role::Track as usize] = column(member(&["trajid"]), 0)?;
    // Whole times are numbers of frames.
    columns[if whole { Role::Frame } else { Role::Time } as usize] = column(time, 0)?;
    for axis in 0..3 {
        columns[Role::X as usize + axis] = column(r, axis)?;
        columns[Role::U as usize + axis] = column(v, axis)?;
    }
    let names: Vec<&str> = members.iter().map(|member| member.name.as_str()).collect();
    Long::new(place, columns, format!("flowtracks, fields {}", names.join(", ")))
}

/// A number in a record.
struct Field {
    offset: usize,
    bytes: usize,
    float: bool,
    big_endian: bool,
}

impl Field {
    fn of(member: &CompoundMember, axis: usize) -> Option<Self> {
        let base = match &member.datatype {
            Datatype::Array { base_type, dimensions } if (axis as u32) < *dimensions.first()? => {
                base_type
            }
            _ if axis > 0 => return None,
            other => other,
        };
        let (float, size, order) = match base {
            Datatype::FloatingPoint { size, byte_order, .. } => (true, *size, byte_order),
            Datatype::FixedPoint { size, byte_order, .. } => (false, *size, byte_order),
            _ => return None,
        };
        let bytes = size as usize;
        let offset = member.byte_offset as usize + axis * bytes;
        let big_endian = matches!(order, DatatypeByteOrder::BigEndian);
        Some(Self { offset, bytes, float, big_endian })
    }

    fn number(&self, record: &[u8]) -> Option<f64> {
        let mut bytes = record.get(self.offset..self.offset + self.bytes)?.to_vec();
        if self.big_endian {
            bytes.reverse();
        }
        if self.float {
            return match bytes.len() {
                4 => Some(f64::from(f32::from_le_bytes(bytes.try_into().ok()?))),
                8 => Some(f64::from_le_bytes(bytes.try_into().ok()?)),
                _ => None,
            };
        }
        let sign = if bytes.last()? >> 7 == 1 { 0xff } else { 0 };
        bytes.resize(8, sign);
        Some(i64::from_le_bytes(bytes.try_into().ok()?) as f64)
    }
}
