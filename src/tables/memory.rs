//! Tables that are read as whole arrays: long columns, or all frames of one number of particles.

use super::columns::{Columns, Role};
use super::{Each, Held, Lost, Progress, Row, Table};
use crate::arrays::Array;
use crate::error::{Error, Result};

/// Rows between two reports of progress.
const OFTEN: usize = 1 << 16;

/// Columns of equal length, in the order of their roles.
pub(super) struct Long {
    held: Held,
    columns: Vec<Option<Vec<f64>>>,
    count: usize,
}

/// All roles, in the order of [`Long`].
pub(super) const ROLES: [Role; 9] =
    [Role::Track, Role::Frame, Role::Time, Role::X, Role::Y, Role::Z, Role::U, Role::V, Role::W];

impl Long {
    /// A table from columns, `None` where there is none.
    ///
    /// # Errors
    /// [`Error::Input`] without tracks, times or positions, or for unequal lengths.
    pub(super) fn new(place: &str, columns: Vec<Option<Vec<f64>>>, words: String) -> Result<Self> {
        let mut found = Columns::default();
        for (k, role) in ROLES.into_iter().enumerate() {
            if columns[k].is_some() {
                found.set(role, k);
            }
        }
        found.must_have_positions(place, &words)?;
        super::text::must_have_tracks(&found, (place, &words), false)?;
        let lengths: Vec<usize> = columns.iter().flatten().map(Vec::len).collect();
        let count = lengths.first().copied().unwrap_or(0);
        if let Some(other) = lengths.iter().find(|length| **length != count) {
            let remedy = "give one number for each row in every column";
            let expected = format!("columns of {count} rows");
            return Err(Error::input(place, expected, other, remedy));
        }
        let (dimension, velocities) = (found.dimension(), found.has_velocities());
        let held = Held { dimension, velocities, words, ..Held::default() };
        Ok(Self { held, columns, count })
    }
}

impl Table for Long {
    fn held(&self) -> &Held {
        &self.held
    }

    fn rows(&self, each: Each<'_>, watch: Progress<'_>) -> Result<()> {
        let plane = self.held.dimension == 2;
        for k in 0..self.count {
            let at = |role: Role| self.columns[role as usize].as_ref().map_or(f64::NAN, |c| c[k]);
            let third = |role: Role| if plane { 0.0 } else { at(role) };
            let track = at(Role::Track);
            let linked = (0.0..9e15).contains(&track);
            each(&Row {
                track: if linked { track as i64 } else { -1 },
                frame: at(Role::Frame),
                time: at(Role::Time),
                position: [at(Role::X), at(Role::Y), third(Role::Z)],
                velocity: [at(Role::U), at(Role::V), third(Role::W)],
                lost: (!linked).then_some(Lost::Unlinked),
            })?;
            if k % OFTEN == 0 {
                watch(k as u64, self.count as u64);
            }
        }
        Ok(())
    }
}

/// Arrays `[frames, particles, 2 or 3]`.
pub(super) struct Stacked {
    pub(super) held: Held,
    positions: Array,
    velocities: Option<Array>,
    /// Types of the particles; only those of type 0 are fluid.
    types: Option<Vec<f64>>,
}

impl Stacked {
    /// A table from arrays of one shape, and of one type for each particle.
    ///
    /// # Errors
    /// [`Error::Input`] for other shapes.
    pub(super) fn new(
        place: &str,
        (positions, velocities): (Array, Option<Array>),
        types: Option<Array>,
        words: String,
    ) -> Result<Self> {
        let shape = positions.shape.clone();
        if shape.len() != 3 || !matches!(shape[2], 2 | 3) {
            let expected = "positions [frames, particles, 2 or 3]";
            return Err(Error::input(place, expected, format!("{shape:?}"), "transpose the array"));
        }
        if let Some(velocities) = &velocities {
            velocities.must_have(&shape, place)?;
        }
        // A damaged file may hold fewer numbers than it says.
        for array in [Some(&positions), velocities.as_ref()].into_iter().flatten() {
            let (wanted, held) = (array.shape.iter().product::<usize>(), array.values.len());
            if wanted != held {
                let expected = format!("{wanted} numbers, as of shape {:?}", array.shape);
                return Err(Error::input(place, expected, held, "write the file again"));
            }
        }
        let types = match types {
            // A type for each frame and particle: those of the first frame hold.
            Some(types) if types.shape == shape[..2] => {
                Some((0..shape[1]).map(|i| types.at(&[0, i])).collect())
            }
            Some(types) => {
                types.must_have(&shape[1..2], place)?;
                Some(types.values)
            }
            None => None,
        };
        let held = Held {
            dimension: shape[2],
            velocities: velocities.is_some(),
            words,
            ..Held::default()
        };
        Ok(Self { held, positions, velocities, types })
    }
}

impl Table for Stacked {
    fn held(&self) -> &Held {
        &self.held
    }

    fn rows(&self, each: Each<'_>, watch: Progress<'_>) -> Result<()> {
        let [frames, particles, dimension] = [0, 1, 2].map(|axis| self.positions.shape[axis]);
        let vector = |array: &Array, k: usize, i: usize| -> [f64; 3] {
            std::array::from_fn(|axis| match axis < dimension {
                true => array.at(&[k, i, axis]),
                false => 0.0,
            })
        };
        for k in 0..frames {
            for i in 0..particles {
                let is_fluid = self.types.as_ref().is_none_or(|types| types[i].abs() < 0.5);
                let velocity = self.velocities.as_ref().map(|array| vector(array, k, i));
                each(&Row {
                    track: i as i64,
                    frame: k as f64,
                    position: vector(&self.positions, k, i),
                    velocity: velocity.unwrap_or([f64::NAN; 3]),
                    lost: (!is_fluid).then_some(Lost::NotFluid),
                    ..Row::EMPTY
                })?;
            }
            watch(k as u64 + 1, frames as u64);
        }
        Ok(())
    }
}
