//! Particles as rows of bytes: [`Frame`] and [`Cloud`] to and from `foxglove.PointCloud`.

use prost::Message as _;

use super::colour::colour;
use super::messages::{NumericType, PointCloud};
use super::rows::{Particle, Title, write_row};
use crate::{Error, Result};

/// The frame of reference of every cloud.
pub(super) const WORLD: &str = "world";

/// One saved step of a flow. Row `k` is particle `k`, in every frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// Which step.
    pub step: u64,
    /// Simulation time.
    pub time: f64,
    /// Positions, `[particles][3]`; the third is 0 in two dimensions.
    pub positions: Vec<[f64; 3]>,
    /// Velocities, `[particles][3]`; the third is 0 in two dimensions.
    pub velocities: Vec<[f64; 3]>,
    /// Densities, `[particles]`.
    pub densities: Vec<f64>,
}

impl Frame {
    /// Bytes of a particle's position, velocity and density.
    pub const BYTES: usize = 7 * size_of::<f64>();

    /// Bytes of a particle's row in the file: those, its number and its colour.
    pub const ROW: usize = Self::BYTES + 4 + 4;

    /// A frame from vectors of `D` = 2 or 3 numbers; in two dimensions the third is set to 0.
    pub fn new<const D: usize>(
        step: u64,
        time: f64,
        positions: impl IntoIterator<Item = [f64; D]>,
        velocities: impl IntoIterator<Item = [f64; D]>,
        densities: Vec<f64>,
    ) -> Self {
        const { assert!(D == 2 || D == 3, "a flow has two or three dimensions") };
        let padded = |row: [f64; D]| std::array::from_fn(|k| row.get(k).copied().unwrap_or(0.0));
        Self {
            step,
            time,
            positions: positions.into_iter().map(padded).collect(),
            velocities: velocities.into_iter().map(padded).collect(),
            densities,
        }
    }

    /// Refuses columns of different lengths, and a third coordinate in two dimensions.
    pub(super) fn check(&self, topic: &str, dimension: usize) -> Result<()> {
        let count = self.positions.len();
        if self.velocities.len() != count {
            return Err(Error::input(
                format!("{topic}, step {}", self.step),
                format!("{count} velocities, one per position"),
                self.velocities.len(),
                "give every particle a velocity",
            ));
        }
        one_per_position((topic, "rho"), &self.densities, count)?;
        in_the_plane(topic, &self.positions, dimension)
    }

    /// What is known of particle `k` of a frame whose columns are equally long.
    pub(super) fn particle(&self, k: usize) -> Particle {
        (self.positions[k], self.velocities[k], self.densities[k])
    }

    pub(super) fn from_cloud(cloud: Cloud, place: &str) -> Result<Self> {
        let column = |name: &str| {
            let found = cloud.columns.iter().find(|column| column.name == name);
            found.map(|column| column.values.as_slice()).ok_or_else(|| {
                let names: Vec<_> = cloud.columns.iter().map(|c| c.name.as_str()).collect();
                Error::input(
                    place,
                    format!("a FLOAT64 field `{name}`"),
                    format!("fields x, y, z and {names:?}"),
                    "give a recording that `train` or `simulate` wrote",
                )
            })
        };
        let (vx, vy, vz) = (column("vx")?, column("vy")?, column("vz")?);
        let densities = column("rho")?.to_vec();
        let velocities = (0..vx.len()).map(|k| [vx[k], vy[k], vz[k]]).collect();
        let (step, time) = (cloud.step, cloud.time);
        Ok(Self { step, time, positions: cloud.positions, velocities, densities })
    }
}

/// Particles with any named columns of numbers, for instance the sensitivity to one parameter.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cloud {
    /// Which step (or iteration).
    pub step: u64,
    /// Simulation time.
    pub time: f64,
    /// Positions, `[particles][3]`; the third is 0 in two dimensions.
    pub positions: Vec<[f64; 3]>,
    /// What else is known of each particle.
    pub columns: Vec<Column>,
}

/// One number per particle, with a name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Column {
    /// The name of the field.
    pub name: String,
    /// `[particles]`.
    pub values: Vec<f64>,
}

impl Column {
    /// A column of that name.
    pub fn new(name: impl Into<String>, values: Vec<f64>) -> Self {
        Self { name: name.into(), values }
    }
}

impl Cloud {
    /// Refuses columns of another length than the positions, names that are taken, and a third
    /// coordinate in two dimensions.
    pub(super) fn check(&self, topic: &str, dimension: usize) -> Result<()> {
        let count = self.positions.len();
        let taken = ["x", "y", "z", "id", "red", "green", "blue", "alpha"];
        for (k, Column { name, values }) in self.columns.iter().enumerate() {
            one_per_position((topic, name), values, count)?;
            let twice = self.columns.iter().take(k).any(|column| column.name == *name);
            if twice || name.is_empty() || taken.contains(&name.as_str()) {
                return Err(Error::input(
                    topic,
                    format!("columns with names of their own, none of {taken:?}"),
                    format!("`{name}`"),
                    "choose another name",
                ));
            }
        }
        in_the_plane(topic, &self.positions, dimension)
    }

    /// Makes `message` the encoded `foxglove.PointCloud`; `shade[k]` is particle `k`'s fraction of the
    /// colour scale.
    pub(super) fn encode(&self, title: &Title<'_>, shade: &[f64], message: &mut Vec<u8>) {
        title.encode(message, self.positions.len(), |k, row| {
            let columns = self.columns.iter().map(|column| column.values[k]);
            write_row((k, row), self.positions[k].into_iter().chain(columns), colour(shade[k]));
        });
    }

    /// Reads an encoded `foxglove.PointCloud`: every FLOAT64 field, bit for bit.
    pub(super) fn decode(bytes: &[u8], place: &str) -> Result<Self> {
        let cloud = PointCloud::decode(bytes)
            .map_err(|error| Error::input(place, "a foxglove.PointCloud", error, super::DAMAGED))?;
        let rows = Rows::new(&cloud, place)?;
        let (x, y, z) = (rows.float("x")?, rows.float("y")?, rows.float("z")?);
        let positions = (0..rows.count).map(|k| [rows.at(k, x), rows.at(k, y), rows.at(k, z)]);
        let positions = positions.collect();
        let mut columns = Vec::new();
        for field in &cloud.fields {
            let position = ["x", "y", "z"].contains(&field.name.as_str());
            if field.r#type() == NumericType::Float64 && !position {
                let values = (0..rows.count).map(|k| rows.at(k, field.offset as usize)).collect();
                columns.push(Column::new(field.name.clone(), values));
            }
        }
        Ok(Self { step: cloud.simulation_step, time: cloud.simulation_time, positions, columns })
    }
}

/// Refuses a column of another length than the positions.
fn one_per_position((topic, name): (&str, &str), values: &[f64], count: usize) -> Result<()> {
    if values.len() == count {
        return Ok(());
    }
    Err(Error::input(
        format!("{topic}, column {name}"),
        format!("{count} values, one per position"),
        values.len(),
        "give every particle one value",
    ))
}

/// Refuses a third coordinate in two dimensions.
fn in_the_plane(topic: &str, positions: &[[f64; 3]], dimension: usize) -> Result<()> {
    let outside = positions.iter().position(|row| dimension == 2 && row[2] != 0.0);
    outside.map_or(Ok(()), |k| {
        Err(Error::input(
            format!("{topic}, particle {k}"),
            "z = 0 in two dimensions",
            positions[k][2],
            "set the third coordinate to 0, or `dimension` to 3",
        ))
    })
}

/// The rows of a cloud whose stride, fields and length have been found to agree.
struct Rows<'a> {
    cloud: &'a PointCloud,
    place: &'a str,
    stride: usize,
    count: usize,
}

impl<'a> Rows<'a> {
    fn new(cloud: &'a PointCloud, place: &'a str) -> Result<Self> {
        let (stride, bytes) = (cloud.point_stride as usize, cloud.data.len());
        let refuse = |expected: &str, found: String| {
            Err(Error::input(place, expected, found, super::DAMAGED))
        };
        if stride == 0 || bytes % stride != 0 {
            let found = format!("{bytes} bytes in rows of {stride}");
            return refuse("a whole number of rows", found);
        }
        let floats = cloud.fields.iter().filter(|field| field.r#type() == NumericType::Float64);
        let ends = floats.clone().map(|field| field.offset as usize + 8).max();
        if 8 * floats.count() > stride || ends.is_some_and(|end| end > stride) {
            let found = format!("{} fields in rows of {stride} bytes", cloud.fields.len());
            return refuse("fields that fit into a row", found);
        }
        Ok(Self { cloud, place, stride, count: bytes / stride })
    }

    /// Byte offset of a FLOAT64 field in its row.
    fn float(&self, name: &str) -> Result<usize> {
        let found = self.cloud.fields.iter().find(|field| field.name == name);
        match found.map(|field| (field.r#type(), field.offset as usize)) {
            Some((NumericType::Float64, offset)) => Ok(offset),
            other => Err(Error::input(
                self.place,
                format!("a FLOAT64 field `{name}`"),
                other.map_or("no such field".into(), |(kind, _)| format!("{kind:?}")),
                "give a recording that `train` or `simulate` wrote",
            )),
        }
    }

    fn at(&self, row: usize, offset: usize) -> f64 {
        let from = row * self.stride + offset;
        let bytes = self.cloud.data.get(from..from + 8).and_then(|bytes| bytes.try_into().ok());
        bytes.map_or(f64::NAN, f64::from_le_bytes)
    }
}
