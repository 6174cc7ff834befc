//! Writing: the mirror of the reader.

use super::Encoding;

/// Bytes of a payload that is being written.
#[derive(Debug)]
pub struct Writer {
    bytes: Vec<u8>,
    origin: usize,
    encoding: Encoding,
    /// The first length that 32 bits cannot say.
    too_long: Option<u64>,
}

impl Writer {
    /// With the encapsulation, if the encoding has one, and room for `num_bytes` of fields.
    pub fn new(encoding: Encoding, num_bytes: usize) -> Self {
        let mut bytes = Vec::with_capacity(num_bytes.saturating_add(64));
        match encoding {
            Encoding::CdrLittleEndian => bytes.extend([0, 1, 0, 0]),
            Encoding::CdrBigEndian => bytes.extend([0, 0, 0, 0]),
            Encoding::Ros1 => {}
        }
        Self { origin: bytes.len(), bytes, encoding, too_long: None }
    }

    /// Whether this is ROS 1, some of whose messages have other fields.
    pub fn is_ros1(&self) -> bool {
        self.encoding == Encoding::Ros1
    }

    /// A primitive whose lowest byte is the first of `bytes`, aligned to its size.
    pub fn primitive<const N: usize>(&mut self, mut bytes: [u8; N]) {
        if !self.is_ros1() {
            let padding = self.origin.wrapping_sub(self.bytes.len()) % N.max(1);
            self.bytes.resize(self.bytes.len() + padding, 0);
        }
        if self.encoding == Encoding::CdrBigEndian {
            bytes.reverse();
        }
        self.bytes.extend(bytes);
    }

    /// Bytes as they are.
    pub fn raw(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    /// The number of elements that follow.
    pub fn count(&mut self, count: usize) {
        let length = u32::try_from(count).unwrap_or_else(|_| {
            self.too_long.get_or_insert(count as u64);
            u32::MAX
        });
        self.primitive(length.to_le_bytes());
    }

    /// A string, which should have no NUL inside.
    pub fn string(&mut self, text: &str) {
        let terminator: &[u8] = if self.is_ros1() { &[] } else { &[0] };
        self.count(text.len() + terminator.len());
        self.raw(text.as_bytes());
        self.raw(terminator);
    }

    /// The payload, or the length that it cannot say.
    pub(crate) fn finish(self) -> Result<Vec<u8>, u64> {
        self.too_long.map_or(Ok(self.bytes), Err)
    }
}
