//! Which column of a table holds what: by the names of its header, or as the caller says.

use crate::error::{Error, Result};

/// What a column can hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    Track,
    Frame,
    Time,
    X,
    Y,
    Z,
    U,
    V,
    W,
}

/// Roles with their names in `--columns` and in headers of other programs, in lower case; an
/// earlier name is preferred to a later one.
const NAMES: [(Role, &[&str]); 9] = [
    (
        Role::Track,
        &[
            "track",
            "track_id",
            "trackid",
            "trajectory",
            "trajectory_id",
            "trajid",
            "traj_id",
            "traj",
            "particle",
            "particle_id",
            "particleid",
            "partid",
            "part_id",
            "id",
        ],
    ),
    (Role::Frame, &["frame", "frame_id", "frameid", "frame_number", "snapshot"]),
    (Role::Time, &["time", "position_t", "t"]),
    (Role::X, &["x", "position_x", "pos_x", "worldx", "world_x"]),
    (Role::Y, &["y", "position_y", "pos_y", "worldy", "world_y"]),
    (Role::Z, &["z", "position_z", "pos_z", "worldz", "world_z"]),
    (Role::U, &["u", "vx", "v_x", "velocity_x", "vel_x"]),
    (Role::V, &["v", "vy", "v_y", "velocity_y", "vel_y"]),
    (Role::W, &["w", "vz", "v_z", "velocity_z", "vel_z"]),
];

/// The place of each role in a row, counted from 0.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Columns {
    at: [Option<usize>; 9],
}

impl Columns {
    /// The place of a role.
    pub(crate) fn of(&self, role: Role) -> Option<usize> {
        self.at[role as usize]
    }

    pub(crate) fn set(&mut self, role: Role, place: usize) {
        self.at[role as usize] = Some(place);
    }

    /// 3 with a column of z, else 2.
    pub(crate) fn dimension(&self) -> usize {
        if self.of(Role::Z).is_some() { 3 } else { 2 }
    }

    /// Whether all components of the velocity are there.
    pub(crate) fn has_velocities(&self) -> bool {
        let wanted = &[Role::U, Role::V, Role::W][..self.dimension()];
        wanted.iter().all(|role| self.of(*role).is_some())
    }

    /// The columns by the names of a header; a unit in brackets after a name is left out.
    pub(crate) fn of_header<'a>(header: impl Iterator<Item = &'a str>) -> Self {
        let header: Vec<String> = header.map(plain).collect();
        let mut columns = Self::default();
        for (role, names) in NAMES {
            let place = |name: &&str| header.iter().position(|found| found == *name);
            columns.at[role as usize] = names.iter().find_map(place);
        }
        columns
    }

    /// The columns that `--columns` names, in a row of `width` columns: `track,frame,x,y,z` in the
    /// order of the row, `-` for a column to skip, `...` for any number of them; or
    /// `x=NAME,y=NAME` by the names of the header.
    ///
    /// # Errors
    /// [`Error::Input`] for an unknown name, a repeated one, or more names than columns.
    pub(crate) fn of_text(text: &str, (header, width): (&[String], usize)) -> Result<Self> {
        let names: Vec<&str> = text.split(',').map(str::trim).collect();
        if names.iter().any(|name| name.contains('=')) {
            return Self::by_name(&names, header);
        }
        let dots = names.iter().position(|name| matches!(*name, "..." | "…"));
        if names.len() - usize::from(dots.is_some()) > width {
            let expected = format!("at most {width} names, one for each column");
            return Err(refuse(expected, text, "leave out what the table does not have"));
        }
        let mut columns = Self::default();
        for (k, name) in names.iter().enumerate().filter(|(k, _)| Some(*k) != dots) {
            let place = match dots {
                Some(dots) if k > dots => width - (names.len() - k),
                _ => k,
            };
            if !matches!(*name, "-" | "_" | "") {
                columns.take(role_of(name)?, place, text)?;
            }
        }
        Ok(columns)
    }

    fn by_name(names: &[&str], header: &[String]) -> Result<Self> {
        let mut columns = Self::of_header(header.iter().map(String::as_str));
        for pair in names {
            let Some((role, name)) = pair.split_once('=') else {
                return Err(refuse("ROLE=NAME for every column", pair, "as in x=X_um,y=Y_um"));
            };
            let Some(place) = header.iter().position(|found| found.trim() == name.trim()) else {
                let remedy = format!("name one of the header's: {}", header.join(", "));
                return Err(refuse(format!("a column {name:?}"), pair, &remedy));
            };
            columns.set(role_of(role.trim())?, place);
        }
        Ok(columns)
    }

    fn take(&mut self, role: Role, place: usize, text: &str) -> Result<()> {
        if self.of(role).is_some() {
            return Err(refuse("each name once", text, "write - for a column to skip"));
        }
        self.set(role, place);
        Ok(())
    }

    /// Refuses columns without positions.
    pub(crate) fn must_have_positions(&self, place: &str, header: &str) -> Result<()> {
        if self.of(Role::X).is_some() && self.of(Role::Y).is_some() {
            return Ok(());
        }
        let expected = "columns x and y, by a header or by --columns";
        let remedy = "say what the columns are, in their order: --columns track,frame,x,y,z (- skips one, ... skips any \
                      number), or by the header's names: --columns track=NAME,x=NAME,y=NAME";
        Err(Error::input(place, expected, format!("{header:?}"), remedy))
    }
}

fn plain(name: &str) -> String {
    let name = name.trim().trim_matches('"').trim_start_matches(['#', '%']).trim();
    let end = name.find(['[', '(']).filter(|end| *end > 0).unwrap_or(name.len());
    name[..end].trim().to_lowercase()
}

fn role_of(name: &str) -> Result<Role> {
    let lower = name.to_lowercase();
    let found = NAMES.iter().find(|(_, names)| names.contains(&lower.as_str()));
    found.map(|(role, _)| *role).ok_or_else(|| {
        let expected = "track, frame, time, x, y, z, u, v, w, - or ...";
        refuse(expected, name, "write - for a column to skip")
    })
}

fn refuse(expected: impl ToString, found: &str, remedy: &str) -> Error {
    Error::input("--columns", expected, format!("{found:?}"), remedy)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn places(columns: &Columns) -> Vec<Option<usize>> {
        columns.at.to_vec()
    }

    #[test]
    fn names_of_other_programs_and_dots_find_their_columns() {
        let header = "TrackID,FrameID,WorldX,WorldY,WorldZ,cam0_x(col),cam0_y(row)";
        let found = Columns::of_header(header.split(','));
        let named = Columns::of_text("track,frame,x,y,z", (&[], 7)).unwrap();
        assert_eq!(places(&found), places(&named));
        let spots = Columns::of_header("LABEL,ID,TRACK_ID,POSITION_X,POSITION_Y,FRAME".split(','));
        assert_eq!((spots.of(Role::Track), spots.of(Role::X)), (Some(2), Some(3)));
        let raw = Columns::of_text("track,x,y,z,...,frame", (&[], 9)).unwrap();
        assert_eq!((raw.of(Role::Frame), raw.of(Role::Z)), (Some(8), Some(3)));
        let units = Columns::of_header(["x [mm]", "y (mm)", "id", "t"].into_iter());
        assert_eq!((units.of(Role::X), units.of(Role::Time)), (Some(0), Some(3)));
        for text in ["track,frame,x,y,z", "x,x", "x,height"] {
            assert!(Columns::of_text(text, (&[], 4)).is_err(), "{text}");
        }
    }
}
