//! Particles as rows of bytes: [`Frame`] and [`Cloud`] to and from `foxglove.PointCloud`.

use prost::Message as _;

use super::colour::colour;
use super::messages::{NumericType, PackedElementField, PointCloud};
use super::rows::{CloudHeader, Particle, write_row};
use crate::{Error, Result};

/// The frame of reference of every cloud.
pub(super) const WORLD: &str = "world";

/// One saved step of a flow. Row `k` is particle `k`, in every frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Frame {
    /// The step.
    pub step: u64,
    /// Simulation time.
    pub time: f64,
    /// Positions, `[particles][3]`; the third is 0 in two dimensions.
    pub positions: Vec<[f64; 3]>,
    /// Velocities, `[particles][3]`; the third is 0 in two dimensions.
    pub velocities: Vec<[f64; 3]>,
    /// Densities, `[particles]`; empty where they are unknown.
    pub densities: Vec<f64>,
}

impl Frame {
    /// Bytes of a particle's position, velocity and density.
    pub const BYTES: usize = 7 * size_of::<f64>();

    /// Bytes of a particle's row in the file: the above, its number and its colour.
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
        if !self.densities.is_empty() {
            one_per_position((topic, "rho"), &self.densities, count)?;
        }
        in_the_plane(topic, &self.positions, dimension)
    }

    /// Particle `k` of a frame with columns of equal length; an unknown density is NaN.
    pub(super) fn particle(&self, k: usize) -> Particle {
        let rho = self.densities.get(k).copied().unwrap_or(f64::NAN);
        (self.positions[k], self.velocities[k], rho)
    }

    /// A frame from a cloud with columns `vx`, `vy`, `vz` and, where densities are known, `rho`.
    pub(super) fn from_cloud(cloud: Cloud, place: &str) -> Result<Self> {
        let known = |name: &str| {
            let found = cloud.columns.iter().find(|column| column.name == name);
            found.map(|column| column.values.as_slice())
        };
        let column = |name: &str| {
            known(name).ok_or_else(|| {
                let names: Vec<_> = cloud.columns.iter().map(|c| c.name.as_str()).collect();
                Error::input(
                    place,
                    format!("a field `{name}` of FLOAT32 or FLOAT64"),
                    format!("fields x, y, z and {names:?}"),
                    "give a cloud with velocities vx, vy, vz",
                )
            })
        };
        let (vx, vy, vz) = (column("vx")?, column("vy")?, column("vz")?);
        let densities = known("rho").unwrap_or_default().to_vec();
        let velocities = (0..vx.len()).map(|k| [vx[k], vy[k], vz[k]]).collect();
        let (step, time) = (cloud.step, cloud.time);
        Ok(Self { step, time, positions: cloud.positions, velocities, densities })
    }
}

/// Particles with any named columns of numbers, for instance the sensitivity to one parameter.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Cloud {
    /// The step (or iteration).
    pub step: u64,
    /// Simulation time.
    pub time: f64,
    /// Positions, `[particles][3]`; the third is 0 in two dimensions.
    pub positions: Vec<[f64; 3]>,
    /// The other columns.
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
    /// Refuses columns of another length than the positions, names that are reserved, and a third
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

    /// Encodes the cloud as `foxglove.PointCloud` into `message`; `shade[k]` is particle `k`'s
    /// fraction of the colour scale.
    pub(super) fn encode(&self, title: &CloudHeader<'_>, shade: &[f64], message: &mut Vec<u8>) {
        title.encode(message, self.positions.len(), |k, row| {
            let columns = self.columns.iter().map(|column| column.values[k]);
            write_row((k, row), self.positions[k].into_iter().chain(columns), colour(shade[k]));
        });
    }

    /// Reads an encoded `foxglove.PointCloud`: every FLOAT32 and FLOAT64 field, bit for bit.
    pub(super) fn decode(bytes: &[u8], place: &str) -> Result<Decoded> {
        let cloud = PointCloud::decode(bytes)
            .map_err(|error| Error::input(place, "a foxglove.PointCloud", error, super::DAMAGED))?;
        let rows = Rows::new(&cloud, place)?;
        let (x, y, z) = (rows.float("x")?, rows.float("y")?, rows.float("z")?);
        let positions = (0..rows.count).map(|k| [x, y, z].map(|field| rows.at(k, field)));
        let positions = positions.collect();
        let (mut columns, mut identities) = (Vec::new(), None);
        for packed in &cloud.fields {
            let field = Field::of(packed);
            let values = || (0..rows.count).map(|k| rows.at(k, field));
            match packed.name.as_str() {
                "x" | "y" | "z" => {}
                "id" => identities = Some(values().collect()),
                name if field.is_float() => columns.push(Column::new(name, values().collect())),
                _ => {}
            }
        }
        let (step, time) = (cloud.simulation_step, cloud.simulation_time);
        let stamp =
            cloud.timestamp.map(|t| i128::from(t.seconds) * 1_000_000_000 + i128::from(t.nanos));
        let turned = cloud.pose.is_some_and(|pose| !pose.is_identity());
        Ok(Decoded { cloud: Self { step, time, positions, columns }, identities, stamp, turned })
    }
}

/// A cloud as read.
#[derive(Debug)]
pub(super) struct Decoded {
    pub(super) cloud: Cloud,
    /// The particles' numbers from the field `id`, row by row, if there is one.
    pub(super) identities: Option<Vec<f64>>,
    /// Nanoseconds of its timestamp.
    pub(super) stamp: Option<i128>,
    /// Whether its pose moves or rotates its points.
    pub(super) turned: bool,
}

/// A frame and the numbers of its particles, in ascending order.
pub(crate) struct Numbered {
    pub(crate) frame: Frame,
    pub(crate) identities: Vec<u64>,
}

impl Decoded {
    /// The frame with its rows in the order of the field `id`; without that field, rows are the
    /// particles' numbers.
    ///
    /// # Errors
    /// [`Error::Input`] for a number that is not valid, or that two particles have.
    pub(super) fn into_numbered(self, place: &str) -> Result<Numbered> {
        let count = self.cloud.positions.len();
        let mut frame = Frame::from_cloud(self.cloud, place)?;
        let Some(given) = self.identities else {
            return Ok(Numbered { frame, identities: (0..count as u64).collect() });
        };
        let refuse = |row: usize, found: String| {
            let expected = "an `id` of its own for each particle, a whole number";
            let place = format!("{place}, row {row}");
            Err(Error::input(
                place,
                expected,
                found,
                "number the particles, the same in every frame",
            ))
        };
        if let Some(row) =
            given.iter().position(|id| !(*id >= 0.0 && id.fract().abs() < f64::MIN_POSITIVE))
        {
            return refuse(row, given[row].to_string());
        }
        let identities: Vec<u64> = given.iter().map(|&id| id as u64).collect();
        if identities.is_sorted_by(|a, b| a < b) {
            return Ok(Numbered { frame, identities });
        }
        let mut order: Vec<usize> = (0..count).collect();
        order.sort_by_key(|&row| identities[row]);
        if let Some(pair) = order.windows(2).find(|pair| identities[pair[0]] == identities[pair[1]])
        {
            return refuse(
                pair[1],
                format!("{} a second time, first in row {}", identities[pair[0]], pair[0]),
            );
        }
        frame.positions = order.iter().map(|&row| frame.positions[row]).collect();
        frame.velocities = order.iter().map(|&row| frame.velocities[row]).collect();
        frame.densities =
            order.iter().filter_map(|&row| frame.densities.get(row).copied()).collect();
        Ok(Numbered { frame, identities: order.iter().map(|&row| identities[row]).collect() })
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

/// The rows of a cloud, after stride, fields and length have been checked against each other.
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
        let fields = || cloud.fields.iter().map(Field::of).filter(|field| field.bytes() > 0);
        let all: usize = fields().map(Field::bytes).sum();
        if all > stride || fields().any(|field| field.offset + field.bytes() > stride) {
            let found = format!("{} fields in rows of {stride} bytes", cloud.fields.len());
            return refuse("fields that fit into a row", found);
        }
        Ok(Self { cloud, place, stride, count: bytes / stride })
    }

    /// A floating-point field.
    fn float(&self, name: &str) -> Result<Field> {
        let found = self.cloud.fields.iter().find(|field| field.name == name);
        match found.map(Field::of) {
            Some(field) if field.is_float() => Ok(field),
            other => Err(Error::input(
                self.place,
                format!("a field `{name}` of FLOAT32 or FLOAT64"),
                other.map_or("no such field".into(), |field| format!("{:?}", field.kind)),
                "give a cloud with such a field",
            )),
        }
    }

    fn at(&self, row: usize, field: Field) -> f64 {
        let from = row * self.stride + field.offset;
        let bytes = self.cloud.data.get(from..from + field.bytes());
        bytes.and_then(|bytes| field.number(bytes)).unwrap_or(f64::NAN)
    }
}

/// Offset and type of a number in a row.
#[derive(Clone, Copy)]
struct Field {
    offset: usize,
    kind: NumericType,
}

impl Field {
    fn of(field: &PackedElementField) -> Self {
        Self { offset: field.offset as usize, kind: field.r#type() }
    }

    fn is_float(self) -> bool {
        matches!(self.kind, NumericType::Float32 | NumericType::Float64)
    }

    fn bytes(self) -> usize {
        match self.kind {
            NumericType::Unknown => 0,
            NumericType::Uint8 | NumericType::Int8 => 1,
            NumericType::Uint16 | NumericType::Int16 => 2,
            NumericType::Uint32 | NumericType::Int32 | NumericType::Float32 => 4,
            NumericType::Float64 => 8,
        }
    }

    fn number(self, bytes: &[u8]) -> Option<f64> {
        Some(match self.kind {
            NumericType::Unknown => return None,
            NumericType::Uint8 => f64::from(*bytes.first()?),
            NumericType::Int8 => f64::from(*bytes.first()? as i8),
            NumericType::Uint16 => f64::from(u16::from_le_bytes(bytes.try_into().ok()?)),
            NumericType::Int16 => f64::from(i16::from_le_bytes(bytes.try_into().ok()?)),
            NumericType::Uint32 => f64::from(u32::from_le_bytes(bytes.try_into().ok()?)),
            NumericType::Int32 => f64::from(i32::from_le_bytes(bytes.try_into().ok()?)),
            NumericType::Float32 => f64::from(f32::from_le_bytes(bytes.try_into().ok()?)),
            NumericType::Float64 => f64::from_le_bytes(bytes.try_into().ok()?),
        })
    }
}
