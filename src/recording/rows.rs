//! Encodes a particle cloud's message in one pass over the particles.

use prost::Message as _;
use rayon::prelude::*;

use super::clock;
use super::cloud::WORLD;
use super::messages::{CloudHead, CloudTail, NumericType, PackedElementField, Pose};

/// Rows per parallel task.
const ROWS: usize = 1024;

/// The protobuf key before the rows: field 6, length-delimited.
const DATA: u8 = (6 << 3) | 2;

/// Position, velocity and density of a particle; third coordinates are 0 in two dimensions.
pub(crate) type Particle = ([f64; 3], [f64; 3], f64);

/// The properties that all rows of a cloud share.
pub(super) struct CloudHeader<'a> {
    pub(super) step: u64,
    pub(super) time: f64,
    /// Names of the columns after x, y and z.
    pub(super) columns: &'a [&'a str],
}

impl CloudHeader<'_> {
    /// Bytes of a row: its columns, its number and its colour.
    pub(super) fn stride(&self) -> usize {
        8 * (3 + self.columns.len()) + 4 + 4
    }

    /// Encodes a `foxglove.PointCloud` of `count` rows into `message`. `write` gets each row's
    /// index and its words of eight bytes; the last word holds the row's number and colour.
    ///
    /// `message` is overwritten and its memory reused.
    pub(super) fn encode(
        &self,
        message: &mut Vec<u8>,
        count: usize,
        write: impl Fn(usize, &mut [[u8; 8]]) + Sync,
    ) {
        let (head, tail) = (self.head(count), self.tail());
        let stride = self.stride();
        let rows = head.len()..head.len() + stride * count;
        let length = rows.end + tail.len();
        message.reserve_exact(length.saturating_sub(message.len()));
        message.resize(length, 0);
        message[..rows.start].copy_from_slice(&head);
        message[rows.end..].copy_from_slice(&tail);
        let tasks = message[rows].par_chunks_mut(stride * ROWS).enumerate();
        tasks.for_each(|(task, rows)| {
            for (k, row) in (task * ROWS..).zip(rows.chunks_exact_mut(stride)) {
                write(k, row.as_chunks_mut().0);
            }
        });
    }

    fn head(&self, count: usize) -> Vec<u8> {
        let head = CloudHead {
            timestamp: Some(clock::timestamp(self.time)),
            frame_id: WORLD.into(),
            pose: Some(Pose::identity()),
            point_stride: self.stride() as u32,
            fields: layout(self.columns.iter().copied()),
        };
        let mut bytes = head.encode_to_vec();
        bytes.push(DATA);
        let mut length = (self.stride() * count) as u64;
        while length > 0x7f {
            bytes.push(length as u8 | 0x80);
            length >>= 7;
        }
        bytes.push(length as u8);
        bytes
    }

    fn tail(&self) -> Vec<u8> {
        CloudTail { simulation_time: self.time, simulation_step: self.step }.encode_to_vec()
    }
}

/// Writes the columns, one word each, then the row's number and its colour.
#[inline(always)]
pub(super) fn write_row(
    (k, row): (usize, &mut [[u8; 8]]),
    numbers: impl IntoIterator<Item = f64>,
    colour: [u8; 4],
) {
    let Some((last, words)) = row.split_last_mut() else { return };
    for (word, number) in words.iter_mut().zip(numbers) {
        *word = number.to_le_bytes();
    }
    let colour = u32::from_le_bytes(colour);
    *last = (u64::from(colour) << 32 | u64::from(k as u32)).to_le_bytes();
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

#[cfg(test)]
mod tests {
    use super::super::messages::PointCloud;
    use super::*;

    #[test]
    fn the_message_is_the_one_that_protobuf_encodes_whatever_it_held_before() {
        let title = |step| CloudHeader { step, time: 0.25 * step as f64, columns: &["a"] };
        let mut message = vec![7; 5000];
        for (step, count) in [(1, 40), (0, 300), (u64::MAX, 2), (5, 2)] {
            title(step).encode(&mut message, count, |k, row| {
                write_row((k, row), [k as f64, -0.0, 2.0, 0.5], [1, 2, 3, 255]);
            });
            let read = PointCloud::decode(message.as_slice()).unwrap_or_else(|e| panic!("{e}"));
            assert_eq!(read.encode_to_vec(), message, "step {step}");
            assert_eq!((read.point_stride, read.data.len()), (40, 40 * count));
            assert_eq!(read.simulation_step, step);
        }
    }
}
