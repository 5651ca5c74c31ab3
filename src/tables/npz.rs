//! Archives of `numpy.savez`: long columns by their names, or `positions` and `velocities`
//! `[frames, particles, 2 or 3]`, perhaps with the number `dt` and the side or sides of the `box`.

use super::columns::Columns;
use super::memory::{Long, ROLES, Stacked};
use super::{Each, Held, Progress, Table};
use crate::arrays::Array;
use crate::error::{Error, Result};
use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use zip::ZipArchive;

/// Names of arrays of positions, and of velocities, in lower case.
const POSITIONS: [&str; 5] = ["positions", "position", "pos", "r", "x"];
const VELOCITIES: [&str; 5] = ["velocities", "velocity", "vel", "v", "u"];

/// Names of the types of particles; type 0 is fluid.
const TYPES: [&str; 4] = ["particle_type", "particle_types", "types", "type"];

/// Either kind of table.
pub(super) enum Npz {
    Long(Long),
    Stacked(Stacked),
}

impl Table for Npz {
    fn held(&self) -> &Held {
        match self {
            Self::Long(table) => table.held(),
            Self::Stacked(table) => table.held(),
        }
    }

    fn rows(&self, each: Each<'_>, watch: Progress<'_>) -> Result<()> {
        match self {
            Self::Long(table) => table.rows(each, watch),
            Self::Stacked(table) => table.rows(each, watch),
        }
    }
}

/// Opens an archive.
///
/// # Errors
/// [`Error::Input`] for an archive that holds neither.
pub(super) fn open(path: &Path) -> Result<Npz> {
    let mut members = Members::open(path)?;
    let place = path.display().to_string();
    let words = format!("npz of {}", members.names.join(", "));
    let stacked = members.find(&POSITIONS).map(|k| members.read(k)).transpose()?;
    if let Some(positions) = stacked.filter(|array| array.shape.len() == 3) {
        let mut also = |names: &[&str]| members.find(names).map(|k| members.read(k)).transpose();
        let (velocities, types) = (also(&VELOCITIES)?, also(&TYPES)?);
        let (dt, sides) = (also(&["dt"])?, also(&["box", "box_length"])?);
        let number = |array: Option<Array>| array.and_then(|array| array.values.first().copied());
        let mut table = Stacked::new(&place, (positions, velocities), types, words)?;
        table.held.interval = number(dt);
        let dimension = table.held.dimension;
        let side =
            |sides: &Array, axis: usize| sides.values.get(axis).or(sides.values.first()).copied();
        table.held.bounds = sides.and_then(|sides| {
            (0..dimension).map(|axis| Some((0.0, side(&sides, axis)?))).collect()
        });
        return Ok(Npz::Stacked(table));
    }
    let columns = Columns::of_header(members.names.iter().map(String::as_str));
    let mut read = |role| columns.of(role).map(|at| members.read(at)).transpose();
    let arrays = ROLES.into_iter().map(&mut read).collect::<Result<Vec<_>>>()?;
    if let Some(array) = arrays.iter().flatten().find(|array| array.shape.len() != 1) {
        let expected = "positions [frames, particles, 2 or 3], or columns with one axis";
        let remedy = "save them with numpy.savez(F, track=…, frame=…, x=…, y=…, z=…)";
        return Err(Error::input(place, expected, format!("shape {:?}", array.shape), remedy));
    }
    let columns = arrays.into_iter().map(|array| array.map(|array| array.values)).collect();
    Ok(Npz::Long(Long::new(&place, columns, words)?))
}

/// The arrays of an archive.
struct Members {
    archive: ZipArchive<BufReader<File>>,
    names: Vec<String>,
    place: String,
}

impl Members {
    fn open(path: &Path) -> Result<Self> {
        let file = File::open(path).map_err(|error| Error::read(path, error))?;
        let place = path.display().to_string();
        let archive =
            ZipArchive::new(BufReader::new(file)).map_err(|error| damaged(&place, error))?;
        let plain = |k: usize| {
            let name = archive.name_for_index(k).and_then(|name| name.ok());
            let name = name.as_deref().unwrap_or_default();
            name.strip_suffix(".npy").unwrap_or(name).to_lowercase()
        };
        let names = (0..archive.len()).map(plain).collect();
        Ok(Self { archive, names, place })
    }

    fn find(&self, names: &[&str]) -> Option<usize> {
        names.iter().find_map(|name| self.names.iter().position(|found| found == name))
    }

    fn read(&mut self, k: usize) -> Result<Array> {
        let place = format!("{}, array {}", self.place, self.names[k]);
        let member = self.archive.by_index(k).map_err(|error| damaged(&place, error))?;
        let bytes = member.size();
        Array::read_any((BufReader::new(member), bytes), place)
    }
}

fn damaged(place: &str, error: impl std::fmt::Display) -> Error {
    Error::input(place, "an archive of numpy.savez", error, "save it again")
}
