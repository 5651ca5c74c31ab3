//! Arrays of other programs: the `.npy` files that `numpy.save` writes.
//!
//! The file is not trusted: no allocation has a size that only its header claims, and the header is
//! read in one pass without recursion.

use crate::error::{Error, Result};
use crate::files;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

/// Magic bytes at the start of every `.npy` file.
const MAGIC: &[u8; 6] = b"\x93NUMPY";

/// The remedy for a file that is not an array.
const SAVE: &str = "save it with numpy.save";

/// Length of a header in bytes, maximum: that of an array of numbers has about a hundred.
const LONGEST_HEADER: u64 = 1 << 16;

/// An array of finite numbers, as `f64`.
#[derive(Clone, Debug, PartialEq)]
pub struct Array {
    /// Lengths of its axes.
    pub shape: Vec<usize>,
    /// Its numbers, in the order of the file.
    pub values: Vec<f64>,
    /// Whether the first axis varies fastest.
    fortran: bool,
}

impl Array {
    /// The array of a `.npy` file: `f32` or `f64` of either byte order, C or Fortran order, with `rank` axes.
    ///
    /// # Errors
    /// [`Error::File`] if the file cannot be read, [`Error::Input`] if it does not hold such an
    /// array.
    pub fn open(path: &Path, rank: usize) -> Result<Self> {
        files::must_be_a_file(path)?;
        let failed = |source| Error::read(path, source);
        let file = File::open(path).map_err(failed)?;
        let bytes = file.metadata().map_err(failed)?.len();
        Self::read((BufReader::new(file), bytes), rank, path.display())
    }

    /// The same from a reader of `bytes` bytes; `place` names it in errors.
    ///
    /// # Errors
    /// [`Error::Input`] as [`Array::open`].
    pub fn read(
        (mut reader, bytes): (impl Read, u64),
        rank: usize,
        place: impl ToString,
    ) -> Result<Self> {
        let place = place.to_string();
        let array = Self::numbers((&mut reader, bytes), (Some(rank), Kind::of), &place)?;
        match array.values.iter().position(|x| !x.is_finite()) {
            None => Ok(array),
            Some(at) => {
                let found = format!("{} at {:?}", array.values[at], array.index_of(at));
                let remedy = "leave out the particles of which some frames are not known, \
                              or cut the array where the first number is missing";
                Err(Error::input(&place, "finite numbers", found, remedy))
            }
        }
    }

    /// The same with any number of axes, of floating point, whole numbers or truths, finite or not, as
    /// in a member of an archive. It may have no numbers in it.
    ///
    /// # Errors
    /// [`Error::Input`] as [`Array::open`].
    pub(crate) fn read_any(
        (mut reader, bytes): (impl Read, u64),
        place: impl ToString,
    ) -> Result<Self> {
        Self::numbers((&mut reader, bytes), (None, Kind::of_any), &place.to_string())
    }

    /// Reads header and numbers; `kind` knows the types that are accepted.
    fn numbers(
        (reader, bytes): (&mut impl Read, u64),
        (rank, kind): (Option<usize>, KindOf),
        place: &str,
    ) -> Result<Self> {
        let otherwise = |(found, remedy): (String, &str)| {
            let expected = match rank {
                Some(rank) => format!("a .npy array of f32 or f64 with {rank} axes"),
                None => "an array of numbers".to_owned(),
            };
            Error::input(place, expected, found, remedy)
        };
        let refuse = |found: String| otherwise((found, SAVE));
        let header = Header::read(reader, bytes, kind).map_err(otherwise)?;
        let Header { shape, kind, fortran, length } = header;
        let count = shape.iter().try_fold(1_usize, |count, &n| count.checked_mul(n));
        let wanted = count.and_then(|count| (kind.bytes as u64).checked_mul(count as u64));
        let held = bytes - length;
        let other_rank = rank.is_some_and(|rank| shape.len() != rank || held == 0);
        if wanted != Some(held) || other_rank {
            return Err(refuse(format!("shape {shape:?} and {held} bytes of numbers")));
        }
        let count = count.unwrap_or(0);
        // A member of an archive may claim any length.
        let mut values =
            Vec::with_capacity(if rank.is_some() { count } else { count.min(1 << 20) });
        let mut number = [0; 8];
        for _ in 0..count {
            let bytes = &mut number[..kind.bytes];
            reader.read_exact(bytes).map_err(|error| refuse(error.to_string()))?;
            values.push(kind.number(bytes));
        }
        Ok(Self { shape, values, fortran })
    }

    /// An array of that shape, in C order.
    #[cfg(feature = "hdf5")]
    pub(crate) fn new(shape: Vec<usize>, values: Vec<f64>) -> Self {
        Self { shape, values, fortran: false }
    }

    /// The header of a `.npy` file of little-endian doubles in C order, with the type `<f8`, or
    /// `<i8` of whole numbers.
    pub(crate) fn header(descr: &str, shape: &[usize]) -> Vec<u8> {
        let axes: Vec<String> = shape.iter().map(usize::to_string).collect();
        let axes = if axes.len() == 1 { format!("{},", axes[0]) } else { axes.join(", ") };
        let text = format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': ({axes}), }}");
        // Padded with blanks to a multiple of 64 bytes, as the format asks for.
        let padded = (MAGIC.len() + 4 + text.len() + 1).div_ceil(64) * 64 - MAGIC.len() - 4;
        let mut bytes = MAGIC.to_vec();
        bytes.extend([1, 0]);
        bytes.extend((padded as u16).to_le_bytes());
        bytes.extend(format!("{text:<width$}\n", width = padded - 1).bytes());
        bytes
    }

    /// Refuses an array of another shape; `place` names the array in the error.
    ///
    /// # Errors
    /// [`Error::Input`].
    pub fn must_have(&self, shape: &[usize], place: impl ToString) -> Result<()> {
        if self.shape == shape {
            return Ok(());
        }
        let (expected, found) = (format!("shape {shape:?}"), format!("{:?}", self.shape));
        Err(Error::input(place, expected, found, "give arrays of one flow"))
    }

    /// The index, one entry per axis, of the number at a place in the file.
    fn index_of(&self, mut place: usize) -> Vec<usize> {
        let mut index = vec![0; self.shape.len()];
        let mut take = |axis: usize| {
            index[axis] = place % self.shape[axis];
            place /= self.shape[axis];
        };
        match self.fortran {
            true => (0..self.shape.len()).for_each(&mut take),
            false => (0..self.shape.len()).rev().for_each(&mut take),
        }
        index
    }

    /// The number at an index, one entry per axis.
    pub fn at(&self, index: &[usize]) -> f64 {
        let axes = index.iter().zip(&self.shape);
        let fold = |place: usize, (&i, &n): (&usize, &usize)| place * n + i;
        self.values[if self.fortran { axes.rev().fold(0, fold) } else { axes.fold(0, fold) }]
    }
}

/// The description of a type of numbers that is not supported.
fn words(descr: &str) -> &'static str {
    match descr.trim_start_matches(['<', '>', '|', '=']).chars().next() {
        Some('f') => "floating point of another width",
        Some('i' | 'u') => "whole numbers",
        Some('b') => "true or false",
        Some('c') => "complex numbers",
        Some('O') => "Python objects, as of frames of different lengths",
        Some('[') => "rows of named fields",
        Some('S' | 'U') => "text",
        _ => "no numbers that are known here",
    }
}

/// The remedy for such a type.
fn instead_of(descr: &str) -> &'static str {
    match descr.trim_start_matches(['<', '>', '|', '=']).chars().next() {
        Some('O') => {
            "make frames of equal length, and save numpy.stack(frames).astype(numpy.float64)"
        }
        Some('[') => {
            "save one array of its fields: numpy.stack([a['x'], a['y']], -1).astype(numpy.float64)"
        }
        Some('c') => "save the real part: a.real.astype(numpy.float64)",
        _ => "save it as doubles: numpy.save('r.npy', a.astype(numpy.float64))",
    }
}

/// A class of numbers.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Class {
    Float,
    Signed,
    Unsigned,
}

/// The kind of a `descr`, if it is accepted.
type KindOf = fn(&str) -> Option<Kind>;

/// How a number is stored.
#[derive(Clone, Copy)]
struct Kind {
    class: Class,
    bytes: usize,
    big_endian: bool,
}

impl Kind {
    fn of(descr: &str) -> Option<Self> {
        let (order, bytes) = (descr.get(..1)?, descr.get(1..)?);
        let big_endian = match order {
            "<" => false,
            ">" => true,
            _ => return None,
        };
        match bytes {
            "f4" => Some(Self { class: Class::Float, bytes: 4, big_endian }),
            "f8" => Some(Self { class: Class::Float, bytes: 8, big_endian }),
            _ => None,
        }
    }

    /// The same with whole numbers and truths.
    fn of_any(descr: &str) -> Option<Self> {
        let (order, rest) = (descr.get(..1)?, descr.get(1..)?);
        let class = match rest.get(..1)? {
            "f" => return Self::of(descr),
            "i" => Class::Signed,
            "u" | "b" => Class::Unsigned,
            _ => return None,
        };
        let bytes = rest.get(1..)?.parse().ok().filter(|bytes| matches!(bytes, 1 | 2 | 4 | 8))?;
        matches!(order, "<" | ">" | "|").then_some(Self { class, bytes, big_endian: order == ">" })
    }

    fn number(self, bytes: &mut [u8]) -> f64 {
        if self.big_endian {
            bytes.reverse();
        }
        if self.class != Class::Float {
            let negative = self.class == Class::Signed && bytes.last().is_some_and(|b| b >> 7 == 1);
            let mut whole = [if negative { 0xff } else { 0 }; 8];
            whole[..bytes.len()].copy_from_slice(bytes);
            let number = i64::from_le_bytes(whole);
            return if self.class == Class::Signed { number as f64 } else { number as u64 as f64 };
        }
        match (<[u8; 4]>::try_from(&*bytes), <[u8; 8]>::try_from(&*bytes)) {
            (Ok(single), _) => f64::from(f32::from_le_bytes(single)),
            (_, Ok(double)) => f64::from_le_bytes(double),
            _ => f64::NAN,
        }
    }
}

/// The description of the numbers in a file.
struct Header {
    shape: Vec<usize>,
    kind: Kind,
    fortran: bool,
    /// Bytes before the numbers.
    length: u64,
}

impl Header {
    /// Reads the header at the start of a file. The error says what was found instead, and the
    /// remedy.
    fn read(
        reader: &mut impl Read,
        bytes: u64,
        kind: KindOf,
    ) -> std::result::Result<Self, (String, &'static str)> {
        let (text, length) = Self::text(reader, bytes)?;
        if let Some(header) = Self::parse(&text, length, kind) {
            return Ok(header);
        }
        Err(Self::descr(&text).map_or_else(
            || (format!("{:?}", text.trim().chars().take(200).collect::<String>()), SAVE),
            |descr| (format!("numbers of type '{descr}' ({})", words(descr)), instead_of(descr)),
        ))
    }

    /// The text of the header, and the number of bytes before the numbers.
    fn text(
        reader: &mut impl Read,
        bytes: u64,
    ) -> std::result::Result<(String, u64), (String, &'static str)> {
        let mut take = |count: u64| {
            let mut part = Vec::new();
            let read = reader.take(count).read_to_end(&mut part);
            let read = read.map_err(|error| (error.to_string(), SAVE))?;
            let short = || (format!("a file of {bytes} bytes"), SAVE);
            if read as u64 == count { Ok(part) } else { Err(short()) }
        };
        let start = take(8)?;
        if start[..6] != *MAGIC {
            return Err(match files::kind(&start) {
                Some(kind) => (kind.name().to_owned(), kind.instead_of_an_array()),
                None => (format!("{:02x?} in front", &start[..6]), SAVE),
            });
        }
        let size = if start[6] == 1 { 2 } else { 4 };
        let text = take(size)?.iter().rev().fold(0, |sum, &byte| sum << 8 | u64::from(byte));
        let length = 8 + size + text;
        if text > LONGEST_HEADER || length > bytes {
            return Err((format!("a header of {text} bytes in a file of {bytes}"), SAVE));
        }
        let no_text = |_| ("a header that is no text".to_owned(), SAVE);
        Ok((String::from_utf8(take(text)?).map_err(no_text)?, length))
    }

    /// The text of the header's `descr` field, the type of the numbers.
    fn descr(text: &str) -> Option<&str> {
        let after = text.split_once("descr")?.1.split_once(':')?.1.trim_start();
        let quote = after.chars().next()?;
        match quote {
            '\'' | '"' => after[1..].split(quote).next(),
            '[' => after.split_inclusive(']').next(),
            _ => None,
        }
    }

    /// Parses a text such as `{'descr': '<f8', 'fortran_order': False, 'shape': (3, 7, 2), }`.
    fn parse(text: &str, length: u64, kind: KindOf) -> Option<Self> {
        let text = text.trim().strip_prefix('{')?.strip_suffix('}')?;
        let value = |key: &str| {
            let quoted = ['\'', '"'].map(|quote| format!("{quote}{key}{quote}"));
            let rest = quoted.iter().find_map(|key| text.split_once(key.as_str()))?.1;
            Some(rest.trim_start().strip_prefix(':')?.trim_start())
        };
        let descr = value("descr")?;
        let quote = descr.chars().next().filter(|c| matches!(c, '\'' | '"'))?;
        let kind = kind(descr[1..].split(quote).next()?)?;
        let order = value("fortran_order")?;
        let fortran = order.starts_with("True");
        if !fortran && !order.starts_with("False") {
            return None;
        }
        let inside = value("shape")?.strip_prefix('(')?.split_once(')')?.0;
        let axes = inside.trim().trim_end_matches(',').split(',').filter(|n| !n.is_empty());
        let shape = axes.map(|n| n.trim().parse().ok()).collect::<Option<Vec<usize>>>()?;
        Some(Self { shape, kind, fortran, length })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(version: u8, header: &str, numbers: &[u8]) -> Vec<u8> {
        let mut bytes = MAGIC.to_vec();
        bytes.extend([version, 0]);
        let length = (header.len() as u32).to_le_bytes();
        bytes.extend(&length[..if version == 1 { 2 } else { 4 }]);
        bytes.extend(header.as_bytes());
        bytes.extend(numbers);
        bytes
    }

    fn read(bytes: &[u8], rank: usize) -> Result<Array> {
        Array::read((bytes, bytes.len() as u64), rank, "array")
    }

    #[test]
    fn every_version_byte_order_and_precision_is_read() {
        for version in [1, 2, 3] {
            for (descr, numbers) in [
                ("<f8", [1.5_f64, -2.0].map(f64::to_le_bytes).concat()),
                (">f8", [1.5_f64, -2.0].map(f64::to_be_bytes).concat()),
                ("<f4", [1.5_f32, -2.0].map(f32::to_le_bytes).concat()),
                (">f4", [1.5_f32, -2.0].map(f32::to_be_bytes).concat()),
            ] {
                let header =
                    format!("{{'descr': '{descr}', 'fortran_order': False, 'shape': (2,), }}   \n");
                let array = read(&file(version, &header, &numbers), 1).unwrap();
                assert_eq!((array.shape, array.values), (vec![2], vec![1.5, -2.0]), "{descr}");
            }
        }
    }

    /// A reader that trusts the header allocates four gigabytes, or recurses until the stack
    /// overflows.
    #[test]
    fn a_header_that_claims_too_much_or_nests_too_deep_is_refused() {
        let mut huge = file(2, "{}", &[]);
        huge[8..12].fill(0xff);
        let deep = "(".repeat(60_000);
        let deep = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {deep}, }}");
        let many = "{'descr': '<f8', 'fortran_order': False, 'shape': (4294967296, 4294967296), }";
        for bytes in [huge, file(1, &deep, &[]), file(1, many, &[0; 8])] {
            let text = read(&bytes, 2).unwrap_err().to_string();
            assert!(text.contains("numpy.save"), "{text}");
        }
    }
}
