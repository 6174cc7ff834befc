//! Reading with checked lengths: nothing is taken that is not there.

use super::Encoding;
use crate::{DecodeError, Fault, Wire};

/// A place in a payload.
#[derive(Debug, Clone)]
pub struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
    /// Where alignment is counted from.
    origin: usize,
    encoding: Encoding,
}

impl<'a> Reader<'a> {
    /// At the first field of a payload in CDR.
    ///
    /// # Errors
    /// `Truncated`, `Encapsulation`.
    pub fn cdr(bytes: &'a [u8]) -> Result<Self, DecodeError> {
        let mut reader = Self { bytes, at: 0, origin: 0, encoding: Encoding::CdrBigEndian };
        let [high, low, ..] = *reader.array::<4>()?;
        reader.origin = reader.at;
        reader.encoding = match [high, low] {
            [0, 0] => Encoding::CdrBigEndian,
            [0, 1] => Encoding::CdrLittleEndian,
            found => return Err(DecodeError::at(0, Fault::Encapsulation { found })),
        };
        Ok(reader)
    }

    /// At the first field of a payload of ROS 1.
    pub fn ros1(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0, origin: 0, encoding: Encoding::Ros1 }
    }

    /// Whether this is ROS 1, some of whose messages have other fields.
    pub fn is_ros1(&self) -> bool {
        self.encoding == Encoding::Ros1
    }

    /// Whether numbers have their highest byte first.
    pub fn is_big_endian(&self) -> bool {
        self.encoding == Encoding::CdrBigEndian
    }

    /// Bytes left.
    pub fn remaining(&self) -> usize {
        self.bytes.len() - self.at
    }

    /// The next `count` bytes.
    ///
    /// # Errors
    /// `Truncated`.
    pub fn take(&mut self, count: usize) -> Result<&'a [u8], DecodeError> {
        self.take_after(0, count)
    }

    /// The next `N` bytes, not aligned.
    fn array<const N: usize>(&mut self) -> Result<&'a [u8; N], DecodeError> {
        self.array_after(0)
    }

    fn array_after<const N: usize>(&mut self, padding: usize) -> Result<&'a [u8; N], DecodeError> {
        let taken = self.bytes.get(self.at..).and_then(|b| b.get(padding..)).and_then(|b| b.first_chunk::<N>());
        let taken = taken.ok_or_else(|| self.truncated(padding, N))?;
        self.at += padding + N;
        Ok(taken)
    }

    fn take_after(&mut self, padding: usize, count: usize) -> Result<&'a [u8], DecodeError> {
        let rest = self.bytes.get(self.at..).and_then(|b| b.get(padding..)).and_then(|b| b.get(..count));
        let taken = rest.ok_or_else(|| self.truncated(padding, count))?;
        self.at += padding + count;
        Ok(taken)
    }

    #[cold]
    fn truncated(&self, padding: usize, count: usize) -> DecodeError {
        let needed = (padding as u64).saturating_add(count as u64);
        DecodeError::at(self.at, Fault::Truncated { needed, available: self.remaining() as u64 })
    }

    /// Bytes up to the next place that a primitive of `size` bytes may stand at.
    fn padding(&self, size: usize) -> usize {
        if self.is_ros1() { 0 } else { (self.origin.wrapping_sub(self.at)) % size.max(1) }
    }

    /// The bytes of a primitive, aligned to its size, the lowest first.
    ///
    /// # Errors
    /// `Truncated`.
    pub fn primitive<const N: usize>(&mut self) -> Result<[u8; N], DecodeError> {
        let mut bytes = *self.array_after::<N>(self.padding(N))?;
        if self.is_big_endian() {
            bytes.reverse();
        }
        Ok(bytes)
    }

    /// The bytes of `count` primitives of `N` bytes, aligned to their size, as they lie.
    ///
    /// # Errors
    /// `Truncated`.
    pub fn primitives<const N: usize>(&mut self, count: usize) -> Result<&'a [[u8; N]], DecodeError> {
        // An empty sequence has no element to align.
        let padding = if count == 0 { 0 } else { self.padding(N) };
        Ok(self.take_after(padding, count.saturating_mul(N))?.as_chunks::<N>().0)
    }

    /// A declared number of elements of at least `least_bytes`, checked against the bytes that are left.
    ///
    /// # Errors
    /// `Truncated`, `CountTooLarge`.
    pub fn count(&mut self, least_bytes: usize) -> Result<usize, DecodeError> {
        let count = u32::from_le_bytes(self.primitive()?) as usize;
        let least_bytes = least_bytes.max(1);
        if count > self.remaining() / least_bytes {
            let available = self.remaining() as u64;
            let fault = Fault::CountTooLarge { count: count as u64, least_bytes: least_bytes as u64, available };
            return Err(DecodeError::at(self.at.saturating_sub(4), fault));
        }
        Ok(count)
    }

    /// A string, without its NUL.
    ///
    /// # Errors
    /// `Truncated`, `CountTooLarge`, `NoTerminator`, `NotUtf8`.
    pub fn string(&mut self) -> Result<&'a str, DecodeError> {
        let length = self.count(1)?;
        let at = self.at;
        let mut bytes = self.take(length)?;
        if !self.is_ros1() {
            // Some writers give the empty string no NUL and the length 0.
            bytes = match bytes.split_last() {
                Some((0, text)) => text,
                None => bytes,
                Some((&last, _)) => {
                    return Err(DecodeError::at(at, Fault::NoTerminator { length: length as u64, last }));
                }
            };
        }
        std::str::from_utf8(bytes).map_err(|e| {
            let fault = Fault::NotUtf8 { length: length as u64, at: e.valid_up_to() as u64 };
            DecodeError::at(at.saturating_add(e.valid_up_to()), fault)
        })
    }

    /// A field of this name.
    ///
    /// # Errors
    /// Those of the field's type.
    pub fn field<T: Wire<'a>>(&mut self, name: &str) -> Result<T, DecodeError> {
        T::read(self).map_err(|e| e.in_field(name))
    }

    /// Checks that fewer than `padding` bytes are left.
    pub(crate) fn finish(&self, padding: usize) -> Result<(), DecodeError> {
        let extra = self.remaining();
        if extra < padding { Ok(()) } else { Err(DecodeError::at(self.at, Fault::Trailing { extra: extra as u64 })) }
    }
}
