//! [`Recording`]: reads a recording back bit for bit.

use std::collections::BTreeMap;
use std::path::Path;

use prost::Message;

use super::cloud::{Decoded, Numbered};
use super::messages::{self, Level, Log, Scene, TrainStep, Values};
use super::schemas::Schema;
use super::source::McapReader;
use super::{Cloud, DAMAGED, Flow, Frame, RunInfo, clock, topic};
use crate::statistics::Conservation;
use crate::{Error, Result};

/// A recording, opened for reading.
///
/// Opening reads the lengths of the chunks, and the small chunks that name the channels; frames are
/// read from the file when they are requested.
#[derive(Debug)]
pub struct Recording {
    place: String,
    source: McapReader,
    run: RunInfo,
}

/// A line of the log.
#[derive(Clone, Debug, PartialEq)]
pub struct LogLine {
    /// Simulation time.
    pub time: f64,
    /// Its level.
    pub level: Level,
    /// Its text.
    pub text: String,
}

impl Recording {
    /// Opens a recording, also that of a killed run: then the part that was written can be read,
    /// and [`is_truncated`](Self::is_truncated) is true. If no file has the name yet, the
    /// unfinished one is opened ([`crate::output`]).
    ///
    /// # Errors
    /// [`Error::File`] if the file cannot be read, [`Error::Input`] if it is not an MCAP file, was
    /// not written by whirls, or is damaged.
    pub fn open(path: &Path) -> Result<Self> {
        let mut source = McapReader::open(path)?;
        let place = source.path().display().to_string();
        source.complete()?;
        let Some(record) = source.record.take() else {
            return Err(no_metadata(&place));
        };
        let toml = scene(&source, &place)?;
        let run = RunInfo::from_record(record, toml, &place)?;
        Ok(Self { place, source, run })
    }

    /// Metadata of the run.
    pub fn run(&self) -> &RunInfo {
        &self.run
    }

    /// Whether the file is incomplete: the run was killed, or the file truncated.
    pub fn is_truncated(&self) -> bool {
        self.source.truncated
    }

    /// Number of messages of each topic; topics without messages are left out.
    pub fn counts(&self) -> BTreeMap<String, u64> {
        self.source.counts()
    }

    /// The topics that carry particles, the two flows included.
    pub fn cloud_topics(&self) -> Vec<String> {
        self.topics_of(Schema::PointCloud)
    }

    /// The topics that carry named numbers.
    pub fn value_topics(&self) -> Vec<String> {
        self.topics_of(Schema::Values)
    }

    fn topics_of(&self, schema: Schema) -> Vec<String> {
        self.source.topics_of(schema.name())
    }

    /// Number of frames of a flow.
    pub fn frame_count(&self, flow: Flow) -> usize {
        self.source.addresses(flow.topic()).len()
    }

    /// Simulation times of a flow's frames, to the nanosecond; [`Frame::time`] is exact.
    pub fn frame_times(&self, flow: Flow) -> Vec<f64> {
        self.cloud_times(flow.topic())
    }

    /// Frame `k` of a flow, in the order of writing; its rows are in the order of the field `id`,
    /// the particles' numbers.
    ///
    /// # Errors
    /// [`Error::Input`] if there is no such frame or its chunk is damaged.
    pub fn frame(&self, flow: Flow, k: usize) -> Result<Frame> {
        Ok(self.numbered(flow, k)?.frame)
    }

    /// The same, with the numbers of its particles.
    pub(crate) fn numbered(&self, flow: Flow, k: usize) -> Result<Numbered> {
        let place = format!("{}, {}, message {k}", self.place, flow.topic());
        self.decoded(flow.topic(), k)?.into_numbered(&place)
    }

    /// Cloud `k` of a topic of particles with velocities, as a frame.
    pub(crate) fn particles(&self, topic: &str, k: usize) -> Result<Frame> {
        let place = format!("{}, {topic}, message {k}", self.place);
        Ok(self.decoded(topic, k)?.into_numbered(&place)?.frame)
    }

    /// Simulation times of a topic's clouds, to the nanosecond; [`Cloud::time`] is exact.
    pub fn cloud_times(&self, topic: &str) -> Vec<f64> {
        let addresses = self.source.addresses(topic);
        addresses.iter().map(|address| clock::seconds(address.log_time)).collect()
    }

    /// Cloud `k` of a topic, in the order of writing.
    ///
    /// # Errors
    /// [`Error::Input`] if there is no such cloud or its chunk is damaged.
    pub fn cloud(&self, topic: &str, k: usize) -> Result<Cloud> {
        Ok(self.decoded(topic, k)?.cloud)
    }

    fn decoded(&self, topic: &str, k: usize) -> Result<Decoded> {
        let place = format!("{}, {topic}, message {k}", self.place);
        self.source.read((topic, k), &place, |data| Cloud::decode(data, &place))
    }

    /// All iterations of learning.
    ///
    /// # Errors
    /// [`Error::Input`] if one is damaged.
    pub fn train_steps(&self) -> Result<Vec<TrainStep>> {
        decode_all(&self.source, topic::TRAIN_STEP, &self.place)
    }

    /// All named numbers of a topic.
    ///
    /// # Errors
    /// [`Error::Input`] if a message is damaged.
    pub fn values(&self, topic: &str) -> Result<Vec<Values>> {
        decode_all(&self.source, topic, &self.place)
    }

    /// All records of conserved quantities.
    ///
    /// # Errors
    /// [`Error::Input`] if one is damaged.
    pub fn conservation(&self) -> Result<Vec<Conservation>> {
        let kept =
            decode_all::<messages::Conservation>(&self.source, topic::CONSERVATION, &self.place)?;
        Ok(kept.into_iter().map(Conservation::from).collect())
    }

    /// The bytes of an attachment of at most 65536 bytes; none where there is none of that name.
    pub fn attachment(&self, name: &str) -> Option<&[u8]> {
        self.source.attachments.get(name).map(Vec::as_slice)
    }

    /// The log.
    ///
    /// # Errors
    /// [`Error::Input`] if a line is damaged.
    pub fn logs(&self) -> Result<Vec<LogLine>> {
        let lines = decode_all::<Log>(&self.source, topic::LOG, &self.place)?;
        let line =
            |log: Log| LogLine { time: log.simulation_time, level: log.level(), text: log.message };
        Ok(lines.into_iter().map(line).collect())
    }
}

/// The scene's text; empty if the file ends before it.
fn scene(source: &McapReader, place: &str) -> Result<String> {
    let scenes = decode_all::<Scene>(source, topic::SCENE, place)?;
    Ok(scenes.into_iter().next().map(|scene| scene.toml).unwrap_or_default())
}

pub(super) fn no_metadata(place: &str) -> Error {
    Error::input(
        place,
        "a recording of whirls, with metadata whirls.run",
        "an MCAP file of another program",
        "make a recording of its point clouds: `import --mcap FILE.mcap --topic TOPIC --out truth.mcap`",
    )
}

/// All messages of a topic, in the order of writing.
fn decode_all<M: Message + Default>(
    source: &McapReader,
    topic: &str,
    place: &str,
) -> Result<Vec<M>> {
    let mut decoded = Vec::new();
    for chunk in &source.chunks {
        for &channel in chunk.times.keys() {
            if source.channels.get(&channel).is_some_and(|known| known.topic == topic) {
                source.messages(chunk, channel, |data| decoded.push(M::decode(data)))?;
            }
        }
    }
    let decoded: std::result::Result<_, _> = decoded.into_iter().collect();
    decoded.map_err(|error| Error::input(format!("{place}, {topic}"), "a message", error, DAMAGED))
}
