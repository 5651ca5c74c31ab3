//! [`recover`]: makes a complete file from that of a killed run.

use std::collections::BTreeMap;
use std::path::Path;

use prost::Message as _;

use super::messages::Scene;
use super::reader::no_metadata;
use super::schemas::Schema;
use super::sink::{Entry, McapWriter};
use super::source::McapReader;
use super::wire::{ChannelRecord, MessageRecord, SchemaRecord, opcode};
use super::{Summary, topic};
use crate::output::{Output, must_differ};
use crate::{Error, Result};

/// The result of [`recover`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Recovered {
    /// Messages in the new file.
    pub messages: u64,
    /// Whole chunks found.
    pub chunks: u64,
    /// Chunks with damaged content, which were left out.
    pub chunks_lost: u64,
    /// Size of the new file.
    pub bytes: u64,
}

/// Copies every whole message of `input` into a complete file at `output`. The input is not
/// changed; the output gets its name when it is complete.
///
/// # Errors
/// [`Error::File`] if a file cannot be read or written, or holds no whole frame; [`Error::Input`]
/// if the input is not a recording, or if input and output are the same file. If no frame of
/// particles is whole, nothing is written, and the error is one of a failed run.
pub fn recover(input: &Path, output: &Path) -> Result<Recovered> {
    must_differ(output, &[input])?;
    let mut source = McapReader::open(input)?;
    let place = input.display().to_string();
    let record = source.record.take().ok_or_else(|| no_metadata(&place))?;
    let mut copy = Copy::default();
    let scene = copy.scene(&source);
    // The input may be the unfinished file of this very output.
    let output = Output::beside(output)?;
    let copied = McapWriter::create(output.clone(), record, &scene).and_then(|mut sink| {
        sink.begin(&scene)?;
        copy.chunks(&source, &mut sink)?;
        match copy.frames {
            0 => Err(nothing(input, source.chunks.len(), copy.lost)),
            _ => sink.finish(true),
        }
    });
    if copied.is_err() {
        output.discard();
    }
    let Summary { messages, bytes } = copied?;
    Ok(Recovered { messages, chunks: source.chunks.len() as u64, chunks_lost: copy.lost, bytes })
}

/// The error that nothing was found to recover.
fn nothing(input: &Path, chunks: usize, lost: u64) -> Error {
    let found = format!("no frame in {chunks} chunks, of which {lost} are damaged");
    Error::File {
        action: "recover",
        path: input.to_owned(),
        source: std::io::Error::other(found),
        remedy: "nothing was written; run what recorded it again",
    }
}

/// What the pass through the input has found so far.
#[derive(Default)]
struct Copy {
    channels: BTreeMap<u16, ChannelRecord>,
    schemas: BTreeMap<u16, SchemaRecord>,
    lost: u64,
    /// Number of clouds of particles copied.
    frames: u64,
}

impl Copy {
    /// The scene's text; empty if it was not written. It is in one of the first chunks.
    fn scene(&mut self, source: &McapReader) -> String {
        for chunk in source.chunks.iter().take(2) {
            let mut found = None;
            let read = source.records(chunk, |code, body| {
                if let Some((topic::SCENE, _, message)) = self.meet(code, body)? {
                    found = Scene::decode(message.data).ok();
                }
                Some(())
            });
            if let (Ok(()), Some(scene)) = (read, found) {
                return scene.toml;
            }
        }
        String::new()
    }

    /// Copies all messages except those that begin every recording.
    fn chunks(&mut self, source: &McapReader, sink: &mut McapWriter) -> Result<()> {
        for chunk in &source.chunks {
            let (mut written, mut frames) = (Ok(()), 0);
            let read = source.records(chunk, |code, body| {
                if let (Some(message), Ok(())) = (self.meet(code, body)?, &written) {
                    frames += u64::from(message.1.name == Schema::PointCloud.name());
                    written = write(sink, message);
                }
                Some(())
            });
            self.frames += frames;
            written?;
            match read {
                Err(Error::Input { .. }) => self.lost += 1,
                other => other?,
            }
        }
        Ok(())
    }

    /// Stores schemas and channels; returns a message with its topic and schema. `None` is a
    /// malformed record.
    fn meet<'a>(
        &'a mut self,
        code: u8,
        body: &'a [u8],
    ) -> Option<Option<(&'a str, &'a SchemaRecord, MessageRecord<'a>)>> {
        match code {
            opcode::SCHEMA => self.schemas.extend([SchemaRecord::parse(body)?]),
            opcode::CHANNEL => self.channels.extend([ChannelRecord::parse(body)?]),
            opcode::MESSAGE => {
                let message = MessageRecord::parse(body)?;
                let channel = self.channels.get(&message.channel)?;
                let schema = self.schemas.get(&channel.schema)?;
                return Some(Some((&channel.topic, schema, message)));
            }
            _ => {}
        }
        Some(None)
    }
}

fn write(sink: &mut McapWriter, found: (&str, &SchemaRecord, MessageRecord<'_>)) -> Result<()> {
    let (topic, schema, message) = found;
    if matches!(topic, topic::SCENE | topic::TRANSFORM) {
        return Ok(());
    }
    sink.channel(topic, &schema.name, || schema.data.clone())?;
    sink.write(&Entry {
        topic,
        log_time: message.log_time,
        publish_time: message.publish_time,
        data: message.data,
        alone: schema.name == Schema::PointCloud.name(),
    })
}
