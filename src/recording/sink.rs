//! One MCAP file being written: channels, chunks, times.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, McapError, McapResult, WriteOptions, Writer};
use prost::Message as _;

use super::cloud::WORLD;
use super::messages::{FrameTransform, FrameTransforms, Quaternion, Scene, Vector3};
use super::schemas::Schema;
use super::{RUN, Summary, topic};
use crate::output::Output;
use crate::{Error, Result};

/// Size in bytes above which a chunk of small messages is closed.
const CHUNK_BYTES: usize = 256 << 10;

/// One message to be written.
pub(super) struct Entry<'a> {
    pub(super) topic: &'a str,
    pub(super) log_time: u64,
    pub(super) publish_time: u64,
    pub(super) data: &'a [u8],
    /// Whether the message has a chunk of its own.
    pub(super) alone: bool,
}

struct Channel {
    id: u16,
    messages: u32,
}

/// An MCAP file being written. If it is dropped, it is complete but keeps its unfinished name;
/// after a kill it can be read up to the last chunk.
/// chunk.
pub(super) struct McapWriter {
    output: Output,
    path: PathBuf,
    writer: Writer<BufWriter<File>>,
    channels: BTreeMap<String, Channel>,
    open_bytes: usize,
    messages: u64,
}

impl McapWriter {
    /// Writes the metadata record and the scene attachment.
    pub(super) fn create(
        output: Output,
        record: BTreeMap<String, String>,
        scene_toml: &str,
    ) -> Result<Self> {
        let (file, path) = (output.file()?, output.unfinished());
        let flat = record.get("dimension").is_some_and(|dimension| dimension == "2");
        let writer = options(flat).create(BufWriter::new(file));
        let writer = writer.map_err(|error| written(path, error))?;
        let channels = BTreeMap::new();
        let path = path.to_owned();
        let mut sink = Self { output, path, writer, channels, open_bytes: 0, messages: 0 };
        sink.attempt(|writer| {
            writer.write_metadata(&Metadata { name: RUN.into(), metadata: record })?;
            writer.attach(&attachment("scene.toml", "text/plain", scene_toml.as_bytes()))?;
            writer.flush()
        })?;
        Ok(sink)
    }

    /// Creates the channels of every run and writes its first messages: the scene, and the
    /// transform that places `world`.
    pub(super) fn begin(&mut self, scene_toml: &str) -> Result<()> {
        for (topic, schema) in topic::OF_EVERY_RUN {
            self.channel(topic, schema.name(), || schema.descriptors())?;
        }
        let scene = Scene { toml: scene_toml.into() }.encode_to_vec();
        let root = FrameTransform {
            timestamp: Some(prost_types::Timestamp::default()),
            parent_frame_id: "tf#/".into(),
            child_frame_id: WORLD.into(),
            translation: Some(Vector3::default()),
            rotation: Some(Quaternion::identity()),
        };
        let root = FrameTransforms { transforms: vec![root] }.encode_to_vec();
        for (topic, data) in [(topic::SCENE, &scene), (topic::TRANSFORM, &root)] {
            self.write(&Entry { topic, log_time: 0, publish_time: 0, data, alone: false })?;
        }
        self.flush()
    }

    /// Creates a channel unless the topic has one. If its messages have chunks of their own, the
    /// channel is written into the first such chunk.
    pub(super) fn channel(
        &mut self,
        topic: &str,
        schema: &str,
        descriptors: impl FnOnce() -> Vec<u8>,
    ) -> Result<()> {
        if self.channels.contains_key(topic) {
            return Ok(());
        }
        if schema == Schema::PointCloud.name() {
            self.flush()?;
        }
        let descriptors = descriptors();
        let id = self.attempt(|writer| {
            let schema = writer.add_schema(schema, "protobuf", &descriptors)?;
            writer.add_channel(schema, topic, "protobuf", &BTreeMap::new())
        })?;
        self.channels.insert(topic.into(), Channel { id, messages: 0 });
        Ok(())
    }

    /// Writes a message to a topic with an existing channel.
    pub(super) fn write(&mut self, entry: &Entry<'_>) -> Result<()> {
        if entry.alone && self.open_bytes > 0 {
            self.flush()?;
        }
        let Some(channel) = self.channels.get_mut(entry.topic) else {
            let unknown = McapError::UnknownChannel(0, 0);
            return Err(written(&self.path, unknown));
        };
        let header = MessageHeader {
            channel_id: channel.id,
            sequence: channel.messages,
            log_time: entry.log_time,
            publish_time: entry.publish_time,
        };
        channel.messages = channel.messages.wrapping_add(1);
        self.attempt(|writer| writer.write_to_known_channel(&header, entry.data))?;
        self.messages += 1;
        self.open_bytes += entry.data.len();
        if entry.alone || self.open_bytes > CHUNK_BYTES { self.flush() } else { Ok(()) }
    }

    /// Attaches a file, dated at time zero like everything else.
    pub(super) fn attach(&mut self, name: &str, media_type: &str, data: &[u8]) -> Result<()> {
        self.flush()?;
        self.attempt(|writer| writer.attach(&attachment(name, media_type, data)))
    }

    /// Number of messages of the topic.
    pub(super) fn count(&self, topic: &str) -> u64 {
        self.channels.get(topic).map_or(0, |channel| channel.messages.into())
    }

    /// Closes the chunk and passes everything to the operating system.
    pub(super) fn flush(&mut self) -> Result<()> {
        self.open_bytes = 0;
        self.attempt(Writer::flush)
    }

    /// Completes the file and, where `named`, gives it its final name.
    pub(super) fn finish(mut self, named: bool) -> Result<Summary> {
        self.attempt(|writer| writer.finish().map(drop))?;
        let Self { output, path, writer, messages, .. } = self;
        let file = writer.into_inner().into_inner();
        let file = file.map_err(|error| Error::write(&path, error.into_error()))?;
        let bytes = file.metadata().map_err(|error| Error::write(&path, error))?.len();
        if named {
            output.complete()?;
        }
        Ok(Summary { bytes, messages })
    }

    fn attempt<T>(
        &mut self,
        action: impl FnOnce(&mut Writer<BufWriter<File>>) -> McapResult<T>,
    ) -> Result<T> {
        action(&mut self.writer).map_err(|error| written(&self.path, error))
    }
}

fn attachment<'a>(name: &str, media_type: &str, data: &'a [u8]) -> Attachment<'a> {
    Attachment {
        log_time: 0,
        create_time: 0,
        name: name.into(),
        media_type: media_type.into(),
        data: Cow::Borrowed(data),
    }
}

/// Compression level of Zstandard: a fast one. It removes repetition, and a higher level gains
/// nothing on the digits of turbulent `f64` that is worth its time.
const LEVEL: i32 = -5;

/// The options of the MCAP writer. In two dimensions a quarter of every cloud is zeros, which
/// compression removes. In three it would gain nothing and take longer than everything else
/// together. The number of threads is fixed because it changes the bytes.
fn options(flat: bool) -> WriteOptions {
    WriteOptions::new()
        .compression(flat.then_some(Compression::Zstd))
        // Zstandard receives it as a signed number.
        .compression_level(LEVEL.cast_unsigned())
        .compression_threads(0)
        .chunk_size(None)
        .library(concat!("whirls ", env!("CARGO_PKG_VERSION")))
}

/// An error while writing, as that of the file.
fn written(path: &Path, error: McapError) -> Error {
    match error {
        McapError::Io(error) => Error::write(path, error),
        other => Error::write(path, std::io::Error::other(other)),
    }
}
