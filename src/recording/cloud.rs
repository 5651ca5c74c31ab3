//! Particles as rows of bytes: [`Frame`] and [`Cloud`] to and from `foxglove.PointCloud`.

use prost::Message as _;

use super::clock;
use super::colour::colour;
use super::messages::{NumericType, PackedElementField, PointCloud, Pose};
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
    /// Bytes of a particle while its frame waits to be written: position, velocity, density.
    pub const BYTES: usize = 7 * size_of::<f64>();

    /// Bytes of a particle's row in the file, before they are compressed: those, its number and its colour.
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

    pub(super) fn into_cloud(self) -> Cloud {
        let axis = |k: usize| self.velocities.iter().map(|v| v[k]).collect();
        let columns = vec![
            Column::new("vx", axis(0)),
            Column::new("vy", axis(1)),
            Column::new("vz", axis(2)),
            Column::new("rho", self.densities),
        ];
        Cloud { step: self.step, time: self.time, positions: self.positions, columns }
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
            if values.len() != count {
                return Err(Error::input(
                    format!("{topic}, column {name}"),
                    format!("{count} values, one per position"),
                    values.len(),
                    "give every particle one value",
                ));
            }
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
        let flat = self.positions.iter().position(|row| dimension == 2 && row[2] != 0.0);
        flat.map_or(Ok(()), |k| {
            Err(Error::input(
                format!("{topic}, particle {k}"),
                "z = 0 in two dimensions",
                self.positions[k][2],
                "set the third coordinate to 0, or `dimension` to 3",
            ))
        })
    }

    /// The encoded `foxglove.PointCloud`; `shade[k]` is particle `k`'s fraction of the colour scale.
    pub(super) fn encode(&self, shade: impl Iterator<Item = f64>) -> Vec<u8> {
        let fields = layout(self.columns.iter().map(|column| column.name.as_str()));
        let stride = 8 * (3 + self.columns.len()) + 8;
        let mut data = Vec::with_capacity(stride * self.positions.len());
        for ((k, position), fraction) in (0_u32..).zip(&self.positions).zip(shade) {
            position.iter().for_each(|x| data.extend_from_slice(&x.to_le_bytes()));
            for column in &self.columns {
                data.extend_from_slice(&column.values[k as usize].to_le_bytes());
            }
            data.extend_from_slice(&k.to_le_bytes());
            data.extend_from_slice(&colour(fraction));
        }
        let cloud = PointCloud {
            timestamp: Some(clock::timestamp(self.time)),
            frame_id: WORLD.into(),
            pose: Some(Pose::identity()),
            point_stride: stride as u32,
            fields,
            data,
            simulation_time: self.time,
            simulation_step: self.step,
        };
        cloud.encode_to_vec()
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

/// The fields of a row: x y z and the columns as FLOAT64, `id`, then the four colour bytes.
fn layout<'a>(columns: impl Iterator<Item = &'a str>) -> Vec<PackedElementField> {
    use NumericType::{Float64, Uint8, Uint32};
    let floats = ["x", "y", "z"].into_iter().chain(columns).map(|name| (name, Float64, 8));
    let rest = [("id", Uint32, 4), ("red", Uint8, 1), ("green", Uint8, 1), ("blue", Uint8, 1)];
    let mut offset = 0;
    let mut place = |(name, kind, size): (&str, NumericType, u32)| {
        offset += size;
        PackedElementField { name: name.into(), offset: offset - size, r#type: kind.into() }
    };
    floats.chain(rest).chain([("alpha", Uint8, 1)]).map(&mut place).collect()
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_row_is_as_long_as_is_said() {
        let frame = Frame::new::<2>(0, 0.0, [[0.0; 2]; 3], [[1.0; 2]; 3], vec![1.0; 3]);
        let cloud = frame.into_cloud();
        assert_eq!(8 * (3 + cloud.columns.len()), Frame::BYTES);
        let bytes = cloud.encode([0.0; 3].into_iter());
        let read = PointCloud::decode(bytes.as_slice()).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((read.point_stride as usize, read.data.len()), (Frame::ROW, 3 * Frame::ROW));
    }
}
