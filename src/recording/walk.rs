//! Reads an MCAP file from record to record.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Seek, SeekFrom};
use std::path::Path;

use super::wire::{Bytes, HEAD, MAGIC};
use crate::{Error, Result, files};

/// The remedy where a recording is expected.
const RECORDED: &str = "give a file that `train`, `simulate` or `import` wrote";

/// A position in the file between two records.
pub(super) struct Walk<'a> {
    file: BufReader<File>,
    path: &'a Path,
    pub(super) at: u64,
    length: u64,
}

impl<'a> Walk<'a> {
    /// Opens a file that allows random access.
    pub(super) fn open(path: &'a Path) -> Result<Self> {
        files::must_be_a_file(path)?;
        let failed = |error| Error::read(path, error);
        let mut file = File::open(path).map_err(failed)?;
        let length = file.seek(SeekFrom::End(0)).map_err(failed)?;
        file.rewind().map_err(failed)?;
        Ok(Self { file: BufReader::new(file), path, at: 0, length })
    }

    /// Skips the magic bytes of every MCAP file.
    pub(super) fn begin(&mut self) -> Result<()> {
        let found = self.body(MAGIC.len() as u64)?;
        if found.as_deref() == Some(&MAGIC) {
            return Ok(());
        }
        let bytes = found.unwrap_or_default();
        let (what, remedy) = match files::kind(&bytes) {
            Some(kind) => (kind.name().to_owned(), kind.instead_of_a_recording()),
            None if bytes.is_empty() => ("a file of less than 8 bytes".to_owned(), RECORDED),
            None => (format!("{bytes:02x?}"), RECORDED),
        };
        let expected = format!("an MCAP file, beginning with {MAGIC:02x?}");
        Err(Error::input(self.path.display(), expected, what, remedy))
    }

    /// Opcode and length of the next record; `None` where the file ends before the record does.
    pub(super) fn head(&mut self) -> Result<Option<(u8, u64)>> {
        let Some(head) = self.body(HEAD as u64)? else {
            return Ok(None);
        };
        let mut bytes = Bytes(&head);
        let opcode = bytes.take(1).and_then(|byte| byte.first().copied());
        let head = opcode.zip(bytes.u64());
        Ok(head.filter(|(_, length)| *length <= self.length - self.at))
    }

    /// The next bytes; `None` if the file has less.
    pub(super) fn body(&mut self, count: u64) -> Result<Option<Vec<u8>>> {
        if count > self.length - self.at {
            return Ok(None);
        }
        let mut bytes = Vec::new();
        let mut part = self.file.by_ref().take(count);
        part.read_to_end(&mut bytes).map_err(|error| Error::read(self.path, error))?;
        self.at += bytes.len() as u64;
        Ok((bytes.len() as u64 == count).then_some(bytes))
    }

    /// Skips a number of bytes.
    pub(super) fn skip(&mut self, count: u64) -> Result<()> {
        self.at += count;
        let buffered = self.file.buffer().len() as u64;
        let failed = |error| Error::read(self.path, error);
        if count <= buffered {
            self.file.consume(count as usize);
            return Ok(());
        }
        self.file.seek(SeekFrom::Start(self.at)).map(drop).map_err(failed)
    }
}
