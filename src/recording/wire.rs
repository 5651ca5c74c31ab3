//! MCAP records as bytes. Every length comes from an untrusted file: all reads are checked, and no
//! allocation has a size that only a length claims.

use std::collections::BTreeMap;

pub(super) const MAGIC: [u8; 8] = [0x89, b'M', b'C', b'A', b'P', b'0', b'\r', b'\n'];

/// Bytes before each record: opcode (1 byte) and length (8 bytes).
pub(super) const HEAD: usize = 9;

/// Opcodes of the records that are read.
pub(super) mod opcode {
    pub(in super::super) const FOOTER: u8 = 0x02;
    pub(in super::super) const SCHEMA: u8 = 0x03;
    pub(in super::super) const CHANNEL: u8 = 0x04;
    pub(in super::super) const MESSAGE: u8 = 0x05;
    pub(in super::super) const CHUNK: u8 = 0x06;
    pub(in super::super) const MESSAGE_INDEX: u8 = 0x07;
    pub(in super::super) const ATTACHMENT: u8 = 0x09;
    pub(in super::super) const METADATA: u8 = 0x0C;
}

/// Name and data of an attachment record: two times, name, media type, data after their length, checksum.
pub(super) fn attachment(body: &[u8]) -> Option<(String, Vec<u8>)> {
    let mut bytes = Bytes(body);
    bytes.take(16)?;
    let name = bytes.text()?;
    bytes.block()?;
    let length = usize::try_from(bytes.u64()?).ok()?;
    Some((name, bytes.take(length)?.to_vec()))
}

/// A record's bytes, read from the front; `None` where there are too few.
pub(super) struct Bytes<'a>(pub(super) &'a [u8]);

impl<'a> Bytes<'a> {
    pub(super) fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (front, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(front)
    }

    fn array<const N: usize>(&mut self) -> Option<[u8; N]> {
        self.take(N)?.try_into().ok()
    }

    pub(super) fn u16(&mut self) -> Option<u16> {
        self.array().map(u16::from_le_bytes)
    }

    pub(super) fn u32(&mut self) -> Option<u32> {
        self.array().map(u32::from_le_bytes)
    }

    pub(super) fn u64(&mut self) -> Option<u64> {
        self.array().map(u64::from_le_bytes)
    }

    /// Bytes preceded by their length as four bytes.
    pub(super) fn block(&mut self) -> Option<&'a [u8]> {
        let length = self.u32()?;
        self.take(usize::try_from(length).ok()?)
    }

    pub(super) fn text(&mut self) -> Option<String> {
        String::from_utf8(self.block()?.to_vec()).ok()
    }

    pub(super) fn texts(&mut self) -> Option<BTreeMap<String, String>> {
        let mut entries = Bytes(self.block()?);
        let mut map = BTreeMap::new();
        while !entries.0.is_empty() {
            map.insert(entries.text()?, entries.text()?);
        }
        Some(map)
    }

    /// The next record's opcode and body.
    pub(super) fn record(&mut self) -> Option<(u8, &'a [u8])> {
        let [opcode] = self.array()?;
        let length = self.u64()?;
        Some((opcode, self.take(usize::try_from(length).ok()?)?))
    }
}

/// Header of a chunk record: how its records are stored.
pub(super) struct ChunkHead<'a> {
    pub(super) compression: &'a [u8],
    pub(super) uncompressed_bytes: u64,
    pub(super) records: &'a [u8],
}

impl<'a> ChunkHead<'a> {
    pub(super) fn parse(body: &'a [u8]) -> Option<Self> {
        let mut bytes = Bytes(body);
        bytes.take(16)?;
        let uncompressed_bytes = bytes.u64()?;
        bytes.take(4)?;
        let compression = bytes.block()?;
        let length = bytes.u64()?;
        let records = bytes.take(usize::try_from(length).ok()?)?;
        Some(Self { compression, uncompressed_bytes, records })
    }

    /// Whether the uncompressed records fill the chunk exactly.
    pub(super) fn is_framed(&self) -> bool {
        let mut records = Bytes(self.records);
        while !records.0.is_empty() {
            if records.record().is_none() {
                return false;
            }
        }
        true
    }
}

/// A schema record.
#[derive(Clone, Debug, Default)]
pub(super) struct SchemaRecord {
    pub(super) name: String,
    pub(super) data: Vec<u8>,
}

impl SchemaRecord {
    pub(super) fn parse(body: &[u8]) -> Option<(u16, Self)> {
        let mut bytes = Bytes(body);
        let (id, name, _encoding) = (bytes.u16()?, bytes.text()?, bytes.text()?);
        Some((id, Self { name, data: bytes.block()?.to_vec() }))
    }
}

/// A channel record.
#[derive(Clone, Debug)]
pub(super) struct ChannelRecord {
    pub(super) schema: u16,
    pub(super) topic: String,
}

impl ChannelRecord {
    pub(super) fn parse(body: &[u8]) -> Option<(u16, Self)> {
        let mut bytes = Bytes(body);
        let (id, schema, topic) = (bytes.u16()?, bytes.u16()?, bytes.text()?);
        Some((id, Self { schema, topic }))
    }
}

/// A message record.
pub(super) struct MessageRecord<'a> {
    pub(super) channel: u16,
    pub(super) log_time: u64,
    pub(super) publish_time: u64,
    pub(super) data: &'a [u8],
}

impl<'a> MessageRecord<'a> {
    pub(super) fn parse(body: &'a [u8]) -> Option<Self> {
        let mut bytes = Bytes(body);
        let (channel, _sequence) = (bytes.u16()?, bytes.u32()?);
        let (log_time, publish_time) = (bytes.u64()?, bytes.u64()?);
        Some(Self { channel, log_time, publish_time, data: bytes.0 })
    }
}

/// Channel and log times of a message index record.
pub(super) fn message_index(body: &[u8]) -> Option<(u16, Vec<u64>)> {
    let mut bytes = Bytes(body);
    let channel = bytes.u16()?;
    let mut entries = Bytes(bytes.block()?);
    let mut times = Vec::new();
    while !entries.0.is_empty() {
        times.push(entries.u64()?);
        entries.u64()?;
    }
    Some((channel, times))
}
