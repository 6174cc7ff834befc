//! What both containers have in common: records one after another, some of which hold packed blocks of records.

use crate::block::{Block, Compression};
use std::collections::BTreeMap;

/// A record, as far as anybody here cares.
#[derive(Debug, PartialEq)]
pub(crate) enum Record<'a> {
    /// A type of messages (MCAP), by a number.
    Schema { id: u32, type_name: String },
    /// A topic, by a number; its type is that of a schema, or told along (ROS 1).
    Channel { id: u32, schema: u32, topic: String, type_name: Option<String>, encoding: String },
    /// A message of a channel.
    Message { channel: u32, log_time: i64, publish_time: i64, bytes: &'a [u8] },
    /// Packed records: where they lie in the record, and how they are packed; none if that is not known.
    Chunk { offset: usize, num_bytes: u64, compression: Result<Compression, String> },
    /// Something that is said of the recording as a whole (MCAP): its name, and names and values.
    Metadata { name: String, entries: BTreeMap<String, String> },
    /// Nothing follows that has to be read.
    End,
    /// Another one.
    Other,
}

/// A container's framing.
pub(crate) trait Container {
    /// Bytes at the beginning of a file.
    const MAGIC: &'static [u8];
    /// Whether a file without an end is one that was cut.
    const HAS_END: bool;

    /// The length of the record at the beginning of `head` with its framing, and how many of its bytes have to be there to
    /// [`Container::parse`] it if it is a chunk; none if `head` is too short to say.
    fn frame(head: &[u8]) -> Option<Frame>;

    /// The record of these bytes, its framing with it; of a chunk, its head is enough.
    fn parse(record: &[u8]) -> Result<Record<'_>, &'static str>;
}

/// What a record's framing says.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Frame {
    pub(crate) num_bytes: u64,
    pub(crate) is_chunk: bool,
}

/// Bytes that are enough for [`Container::frame`], and for the head of a chunk.
pub(crate) const HEAD_BYTES: usize = 4096;

/// The records in `bytes`, up to where they break off; where that is, and why.
pub(crate) fn records<'a, C: Container>(
    bytes: &'a [u8],
    mut found: impl FnMut(Record<'a>),
) -> Result<(), (usize, &'static str)> {
    let mut at = 0;
    while let Some(rest) = bytes.get(at..).filter(|rest| !rest.is_empty()) {
        let cut = (at, "a record is cut off");
        let frame = C::frame(rest).ok_or(cut)?;
        let record = usize::try_from(frame.num_bytes).ok().and_then(|n| rest.get(..n)).ok_or(cut)?;
        if !frame.is_chunk {
            found(C::parse(record).map_err(|what| (at, what))?);
        }
        at += record.len();
    }
    Ok(())
}

/// A cursor over the fields of a record.
pub(crate) struct Fields<'a>(pub(crate) &'a [u8]);

impl<'a> Fields<'a> {
    pub(crate) fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    pub(crate) fn u16(&mut self) -> Option<u16> {
        self.take(2)?.first_chunk().map(|b| u16::from_le_bytes(*b))
    }

    pub(crate) fn u32(&mut self) -> Option<u32> {
        self.take(4)?.first_chunk().map(|b| u32::from_le_bytes(*b))
    }

    pub(crate) fn u64(&mut self) -> Option<u64> {
        self.take(8)?.first_chunk().map(|b| u64::from_le_bytes(*b))
    }

    /// Bytes behind their 32-bit length.
    pub(crate) fn bytes(&mut self) -> Option<&'a [u8]> {
        let count = self.u32()? as usize;
        self.take(count)
    }

    /// Text behind its 32-bit length.
    pub(crate) fn text(&mut self) -> Option<String> {
        self.bytes().map(|b| String::from_utf8_lossy(b).into_owned())
    }
}

/// Nanoseconds that a stamp can say.
pub(crate) fn nanos(value: u64) -> i64 {
    i64::try_from(value).unwrap_or(i64::MAX)
}

impl Block {
    pub(crate) fn new(offset: u64, num_bytes: u64, compression: Compression) -> Self {
        Self { offset, num_bytes, compression, first: i64::MAX }
    }
}
