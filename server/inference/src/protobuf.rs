//! Reads protobuf's wire format, without taking memory and without recursion.
//!
//! Source: Protocol Buffers, "Encoding", <https://protobuf.dev/programming-guides/encoding/>. Groups, which ONNX has
//! none of, are refused.

use crate::InferenceError;

/// A field's value.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Value<'a> {
    Number(u64),
    Bytes(Message<'a>),
    Fixed(&'a [u8]),
}

/// A message, or other bytes with a length, and where they begin in the file.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Message<'a> {
    pub(crate) bytes: &'a [u8],
    pub(crate) at: usize,
}

impl<'a> Message<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    pub(crate) fn malformed(&self, reason: &'static str) -> InferenceError {
        InferenceError::NotOnnx { reason, at: self.at }
    }

    /// The next field's number and value; none at the end.
    pub(crate) fn next(&mut self) -> Result<Option<(u64, Value<'a>)>, InferenceError> {
        if self.bytes.is_empty() {
            return Ok(None);
        }
        let tag = self.varint()?;
        let value = match tag & 7 {
            0 => Value::Number(self.varint()?),
            1 => Value::Fixed(self.take(8)?.bytes),
            2 => {
                let length = self.varint()?;
                Value::Bytes(self.take(length)?)
            }
            5 => Value::Fixed(self.take(4)?.bytes),
            _ => return Err(self.malformed("a field of no known type")),
        };
        Ok(Some((tag >> 3, value)))
    }

    /// The text, told from other bytes.
    pub(crate) fn text(&self) -> Result<&'a str, InferenceError> {
        std::str::from_utf8(self.bytes).map_err(|_| self.malformed("a name that is no UTF-8"))
    }

    pub(crate) fn varint(&mut self) -> Result<u64, InferenceError> {
        let mut value = 0u64;
        for i in 0..10 {
            let Some(&byte) = self.bytes.get(i) else {
                return Err(self.malformed("the end in the middle of a number"));
            };
            value |= u64::from(byte & 0x7f) << (7 * i);
            if byte & 0x80 == 0 {
                (self.bytes, self.at) = (&self.bytes[i + 1..], self.at + i + 1);
                return Ok(value);
            }
        }
        Err(self.malformed("a number of more than ten bytes"))
    }

    fn take(&mut self, length: u64) -> Result<Message<'a>, InferenceError> {
        let length = usize::try_from(length).ok().filter(|&n| n <= self.bytes.len());
        let Some(length) = length else { return Err(self.malformed("the end before that of a field")) };
        let (taken, rest) = self.bytes.split_at(length);
        let message = Message { bytes: taken, at: self.at };
        (self.bytes, self.at) = (rest, self.at + length);
        Ok(message)
    }
}
