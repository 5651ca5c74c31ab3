//! One MCAP file being read: its chunks, their contents, and its end.
//!
//! The file is read from record to record and chunks are skipped. A complete and a truncated file
//! are read in the same way, and the summary at the end, which a truncated file lacks, is not
//! needed. This takes three small reads per chunk.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::walk::Walk;
use super::wire::{
    Bytes, ChannelRecord, ChunkHead, HEAD, MAGIC, MessageRecord, SchemaRecord, attachment,
    message_index, opcode,
};
use super::{DAMAGED, RUN};
use crate::output::readable;
use crate::{Error, Result};

/// Uncompressed size of a chunk in bytes, maximum.
pub(super) const LARGEST_CHUNK: usize = 1 << 30;

/// Uncompressed size, in bytes, that any chunk may claim; it may claim `EXPANSION` more for each of
/// its bytes in the file.
const FREE_BYTES: usize = 1 << 20;
const EXPANSION: usize = 1024;

/// Size of an attachment that is kept, in bytes, maximum; larger ones are skipped.
const LARGEST_ATTACHMENT: u64 = 1 << 16;

/// Number of attachments that are kept, maximum.
const MOST_ATTACHMENTS: usize = 16;

/// Position of a chunk record, and the log times of each channel's messages in it.
#[derive(Clone, Debug)]
pub(super) struct Chunk {
    offset: u64,
    length: u64,
    pub(super) times: BTreeMap<u16, Vec<u64>>,
}

/// Position of one message: its chunk, and its index among its channel's messages there.
pub(super) struct Address {
    chunk: usize,
    channel: u16,
    ordinal: usize,
    pub(super) log_time: u64,
}

/// An MCAP file being read.
#[derive(Debug)]
pub(super) struct McapReader {
    path: PathBuf,
    file: Mutex<File>,
    pub(super) chunks: Vec<Chunk>,
    pub(super) channels: BTreeMap<u16, ChannelRecord>,
    pub(super) schemas: BTreeMap<u16, SchemaRecord>,
    pub(super) record: Option<BTreeMap<String, String>>,
    /// Small attachments by name.
    pub(super) attachments: BTreeMap<String, Vec<u8>>,
    pub(super) truncated: bool,
}

impl McapReader {
    /// Reads the structure of the file or, if it does not exist yet, of the unfinished one.
    ///
    /// # Errors
    /// [`Error::File`] if it cannot be read, [`Error::Input`] if it is not an MCAP file.
    pub(super) fn open(path: &Path) -> Result<Self> {
        let path = &readable(path);
        let failed = |error| Error::read(path, error);
        let mut walk = Walk::open(path)?;
        walk.begin()?;
        let mut source = Self {
            path: path.to_owned(),
            file: Mutex::new(File::open(path).map_err(failed)?),
            chunks: Vec::new(),
            channels: BTreeMap::new(),
            schemas: BTreeMap::new(),
            record: None,
            attachments: BTreeMap::new(),
            truncated: true,
        };
        while let Some((code, length)) = walk.head()? {
            if code == opcode::FOOTER {
                walk.skip(length)?;
                source.truncated = walk.body(MAGIC.len() as u64)?.as_deref() != Some(&MAGIC);
                break;
            }
            source.note(code, length, &mut walk)?;
        }
        Ok(source)
    }

    /// The file that is read.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }

    /// Processes one record of the file.
    fn note(&mut self, code: u8, length: u64, walk: &mut Walk<'_>) -> Result<()> {
        match code {
            opcode::CHUNK => {
                let times = BTreeMap::new();
                self.chunks.push(Chunk { offset: walk.at, length, times });
                walk.skip(length)
            }
            opcode::MESSAGE => Err(Error::input(
                format!("{}, byte {}", self.path.display(), walk.at),
                "messages in chunks",
                "a message outside any chunk",
                "write it again in chunks, for instance with `mcap filter IN.mcap -o OUT.mcap`",
            )),
            opcode::MESSAGE_INDEX | opcode::METADATA | opcode::SCHEMA | opcode::CHANNEL => {
                let place = walk.at;
                let body = walk.body(length)?.unwrap_or_default();
                self.read_record(code, &body).ok_or_else(|| self.malformed(place))
            }
            opcode::ATTACHMENT
                if length <= LARGEST_ATTACHMENT && self.attachments.len() < MOST_ATTACHMENTS =>
            {
                let body = walk.body(length)?.unwrap_or_default();
                // A damaged attachment is none: particles and parameters do not depend on it.
                self.attachments.extend(attachment(&body));
                Ok(())
            }
            _ => walk.skip(length),
        }
    }

    fn read_record(&mut self, code: u8, body: &[u8]) -> Option<()> {
        match code {
            opcode::MESSAGE_INDEX => {
                let (channel, times) = message_index(body)?;
                // An index before any chunk belongs to no chunk and is skipped.
                if let Some(chunk) = self.chunks.last_mut() {
                    chunk.times.entry(channel).or_default().extend(times);
                }
            }
            opcode::METADATA => {
                let mut bytes = Bytes(body);
                let (name, record) = (bytes.text()?, bytes.texts()?);
                if name == RUN {
                    self.record.get_or_insert(record);
                }
            }
            opcode::SCHEMA => self.schemas.extend([SchemaRecord::parse(body)?]),
            opcode::CHANNEL => self.channels.extend([ChannelRecord::parse(body)?]),
            _ => {}
        }
        Some(())
    }

    /// Reads the chunks of which the contents are still unknown: those with new channels, those
    /// without an index, and the last one of a truncated file.
    ///
    /// # Errors
    /// [`Error::Input`] if such a chunk is damaged.
    pub(super) fn complete(&mut self) -> Result<()> {
        for k in 0..self.chunks.len() {
            let last = self.truncated && k + 1 == self.chunks.len();
            if last || self.chunks[k].times.is_empty() || !self.knows(k) {
                self.look_into(k)?;
            }
        }
        if (0..self.chunks.len()).all(|k| self.knows(k)) {
            return Ok(());
        }
        (0..self.chunks.len()).try_for_each(|k| self.look_into(k))
    }

    /// Whether all channels with messages in a chunk are known.
    fn knows(&self, k: usize) -> bool {
        self.chunks[k].times.keys().all(|channel| self.channels.contains_key(channel))
    }

    /// Reads channels, schemas and message times of a chunk from its records.
    pub(super) fn look_into(&mut self, k: usize) -> Result<()> {
        let mut found = BTreeMap::<u16, Vec<u64>>::new();
        let (mut schemas, mut channels) = (Vec::new(), Vec::new());
        self.records(&self.chunks[k], |code, body| {
            match code {
                opcode::SCHEMA => schemas.push(SchemaRecord::parse(body)?),
                opcode::CHANNEL => channels.push(ChannelRecord::parse(body)?),
                opcode::MESSAGE => {
                    let message = MessageRecord::parse(body)?;
                    found.entry(message.channel).or_default().push(message.log_time);
                }
                _ => {}
            }
            Some(())
        })?;
        self.schemas.extend(schemas);
        self.channels.extend(channels);
        self.chunks[k].times = found;
        Ok(())
    }

    /// Number of messages of each topic; topics without messages are left out.
    pub(super) fn counts(&self) -> BTreeMap<String, u64> {
        let mut counts = BTreeMap::new();
        for (channel, times) in self.chunks.iter().flat_map(|chunk| &chunk.times) {
            if let Some(channel) = self.channels.get(channel) {
                *counts.entry(channel.topic.clone()).or_insert(0) += times.len() as u64;
            }
        }
        counts
    }

    /// The topics with messages of a schema.
    pub(super) fn topics_of(&self, schema: &str) -> Vec<String> {
        let has_schema = |topic: &str| {
            let mut channels = self.channels.values();
            channels.find(|channel| channel.topic == topic).is_some_and(|channel| {
                self.schemas.get(&channel.schema).is_some_and(|found| found.name == schema)
            })
        };
        self.counts().into_keys().filter(|topic| has_schema(topic)).collect()
    }

    /// Positions of the messages of a topic, in the order of writing.
    pub(super) fn addresses(&self, topic: &str) -> Vec<Address> {
        let mut found = Vec::new();
        for (chunk, entry) in self.chunks.iter().enumerate() {
            for (&channel, times) in &entry.times {
                if self.channels.get(&channel).is_some_and(|known| known.topic == topic) {
                    let address =
                        |(ordinal, &log_time)| Address { chunk, channel, ordinal, log_time };
                    found.extend(times.iter().enumerate().map(address));
                }
            }
        }
        found
    }

    /// Decodes message `k` of a topic; `place` names it in errors.
    ///
    /// # Errors
    /// [`Error::Input`] if there is no such message or its chunk is damaged, and the errors of
    /// `decode`.
    pub(super) fn read<T>(
        &self,
        (topic, k): (&str, usize),
        place: &str,
        decode: impl Fn(&[u8]) -> Result<T>,
    ) -> Result<T> {
        let addresses = self.addresses(topic);
        let Some(address) = addresses.get(k) else {
            let expected = format!("one of {} messages, counted from 0", addresses.len());
            let remedy = "ask for one that was recorded";
            return Err(Error::input(place, expected, format!("message {k}"), remedy));
        };
        let (mut met, mut found) = (0, None);
        self.messages(&self.chunks[address.chunk], address.channel, |data| {
            if met == address.ordinal {
                found = Some(decode(data));
            }
            met += 1;
        })?;
        found.unwrap_or_else(|| Err(Error::input(place, "a message", "none", DAMAGED)))
    }

    /// Calls `each` with the data of every message of a channel in a chunk.
    pub(super) fn messages(
        &self,
        chunk: &Chunk,
        channel: u16,
        mut each: impl FnMut(&[u8]),
    ) -> Result<()> {
        self.records(chunk, |code, body| {
            if code == opcode::MESSAGE {
                let message = MessageRecord::parse(body)?;
                if message.channel == channel {
                    each(message.data);
                }
            }
            Some(())
        })
    }

    /// Calls `each` with opcode and body of every record in a chunk, after checking its checksum;
    /// `None` from `each` means a malformed record.
    ///
    /// # Errors
    /// [`Error::Input`] if the chunk is damaged, [`Error::File`] if it cannot be read.
    pub(super) fn records(
        &self,
        chunk: &Chunk,
        mut each: impl FnMut(u8, &[u8]) -> Option<()>,
    ) -> Result<()> {
        let bytes = self.load(chunk)?;
        let body = bytes.get(HEAD..).unwrap_or_default();
        let head = ChunkHead::parse(body).ok_or_else(|| self.malformed(chunk.offset))?;
        self.must_unpack(&head, chunk.offset)?;
        let claimed = self.plausible_size(&head, chunk.offset, body.len())?;
        let options = LinearReaderOptions::default()
            .with_skip_start_magic(true)
            .with_skip_end_magic(true)
            .with_prevalidate_chunk_crcs(true)
            .with_record_length_limit(claimed.max(bytes.len()));
        let mut reader = LinearReader::new_with_options(options);
        let mut rest = Bytes(&bytes);
        while let Some(event) = reader.next_event() {
            match event.map_err(|error| self.damaged(chunk.offset, error))? {
                LinearReadEvent::ReadRequest(wanted) => {
                    let part = rest.take(wanted.min(rest.0.len())).unwrap_or_default();
                    reader.insert(part.len()).copy_from_slice(part);
                    reader.notify_read(part.len());
                }
                LinearReadEvent::Record { opcode, data } => {
                    each(opcode, data).ok_or_else(|| self.malformed(chunk.offset))?;
                }
            }
        }
        Ok(())
    }

    /// Refuses an unknown compression.
    fn must_unpack(&self, head: &ChunkHead<'_>, at: u64) -> Result<()> {
        let name = String::from_utf8_lossy(head.compression);
        if matches!(&*name, "" | "zstd" | "lz4") {
            return Ok(());
        }
        let expected = "chunks compressed by zstd or lz4, or not at all";
        let found: String = name.chars().take(20).collect();
        let remedy = "the file need not be damaged: write it again, for instance with \
                      `mcap filter --output-compression zstd IN.mcap -o OUT.mcap`";
        Err(Error::input(self.place(at), expected, format!("compression {found:?}"), remedy))
    }

    /// The uncompressed size that a chunk claims, if that is plausible for its `bytes` bytes in the
    /// file.
    fn plausible_size(&self, head: &ChunkHead<'_>, at: u64, bytes: usize) -> Result<usize> {
        let allowed = EXPANSION.saturating_mul(bytes).saturating_add(FREE_BYTES).min(LARGEST_CHUNK);
        let claimed = usize::try_from(head.uncompressed_bytes).unwrap_or(usize::MAX);
        if claimed > allowed {
            let expected = format!("a chunk of at most {allowed} bytes");
            return Err(Error::input(self.place(at), expected, claimed, DAMAGED));
        }
        if head.compression.is_empty() && !head.is_framed() {
            return Err(self.malformed(at));
        }
        Ok(claimed)
    }

    /// The whole chunk record, including its header.
    fn load(&self, chunk: &Chunk) -> Result<Vec<u8>> {
        let failed = |error| Error::read(&self.path, error);
        let wanted = HEAD as u64 + chunk.length;
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        file.seek(SeekFrom::Start(chunk.offset - HEAD as u64)).map_err(failed)?;
        let mut bytes = Vec::new();
        file.by_ref().take(wanted).read_to_end(&mut bytes).map_err(failed)?;
        if bytes.len() as u64 == wanted { Ok(bytes) } else { Err(self.malformed(chunk.offset)) }
    }

    fn place(&self, at: u64) -> String {
        format!("{}, byte {at}", self.path.display())
    }

    fn malformed(&self, at: u64) -> Error {
        Error::input(self.place(at), "a record of MCAP", "lengths that contradict", DAMAGED)
    }

    fn damaged(&self, at: u64, error: mcap::McapError) -> Error {
        Error::input(self.place(at), "a whole chunk", error, DAMAGED)
    }
}
