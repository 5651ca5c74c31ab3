//! [`Clouds`]: point clouds that another program recorded.

use std::path::Path;

use super::cloud::{Cloud, Numbered};
use super::source::McapReader;
use crate::{Error, Result};

/// The schema of the messages that are read.
const SCHEMA: &str = "foxglove.PointCloud";

/// An MCAP file of any program, with `foxglove.PointCloud` messages in protobuf: fields
/// `x y z vx vy vz` and optionally `rho` and `id`, in single or double precision.
#[derive(Debug)]
pub struct Clouds {
    place: String,
    source: McapReader,
}

/// A point cloud as particles.
pub(crate) struct Particles {
    pub(crate) numbered: Numbered,
    /// Time in nanoseconds: the timestamp or, if there is none, the log time.
    pub(crate) time: i128,
}

impl Clouds {
    /// Opens a file.
    ///
    /// # Errors
    /// [`Error::File`] if it cannot be read, [`Error::Input`] if it is not an MCAP file or is damaged.
    pub fn open(path: &Path) -> Result<Self> {
        let mut source = McapReader::open(path)?;
        source.complete()?;
        Ok(Self { place: path.display().to_string(), source })
    }

    /// The topics with point clouds.
    pub fn topics(&self) -> Vec<String> {
        self.source.topics_of(SCHEMA)
    }

    /// The topic with this name or, without a name, the only one with point clouds.
    ///
    /// # Errors
    /// [`Error::Input`] where there is no such topic, or where a name is needed to choose one of
    /// several.
    pub fn topic(&self, named: Option<&str>) -> Result<String> {
        let clouds = self.topics();
        if let Some(topic) = clouds.iter().find(|topic| named == Some(topic.as_str())) {
            return Ok(topic.clone());
        }
        if let ([only], None) = (&clouds[..], named) {
            return Ok(only.clone());
        }
        let refuse = |expected: String, found: String, remedy: &str| {
            Err(Error::input(&self.place, expected, found, remedy))
        };
        let others = self.source.counts().into_keys().collect::<Vec<_>>().join(", ");
        match named {
            Some(topic) => {
                let schema = self
                    .schema_of(topic)
                    .map_or("no such topic".to_owned(), |schema| format!("messages of {schema}"));
                let remedy = "write the particles as foxglove.PointCloud, or name another --topic";
                let expected = format!("{SCHEMA} messages on {topic}");
                refuse(expected, format!("{schema}; topics are {others}"), remedy)
            }
            None if clouds.is_empty() => {
                let remedy = "write the particles as foxglove.PointCloud";
                refuse(format!("a topic of {SCHEMA} messages"), format!("topics {others}"), remedy)
            }
            None => {
                let found = format!("{}: {}", clouds.len(), clouds.join(", "));
                refuse(format!("one topic of {SCHEMA}"), found, "name one of them with --topic")
            }
        }
    }

    fn schema_of(&self, topic: &str) -> Option<&str> {
        let channel = self.source.channels.values().find(|channel| channel.topic == topic)?;
        Some(self.source.schemas.get(&channel.schema)?.name.as_str())
    }

    /// Number of clouds of a topic.
    pub fn count(&self, topic: &str) -> usize {
        self.source.addresses(topic).len()
    }

    /// Cloud `k` of a topic as particles, in the order of their numbers.
    pub(crate) fn particles(&self, topic: &str, k: usize) -> Result<Particles> {
        let place = format!("{}, {topic}, message {k}", self.place);
        let decoded = self.source.read((topic, k), &place, |data| Cloud::decode(data, &place))?;
        if decoded.turned {
            let remedy = "move the points themselves, and leave the pose at the origin";
            return Err(Error::input(
                place,
                "a cloud whose pose is the identity",
                "another",
                remedy,
            ));
        }
        let logged = self.source.addresses(topic).get(k).map_or(0, |found| found.log_time);
        let time = decoded.stamp.unwrap_or(i128::from(logged));
        Ok(Particles { numbered: decoded.into_numbered(&place)?, time })
    }
}
