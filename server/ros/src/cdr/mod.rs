//! The bytes of a message: plain CDR of ROS 2, and ROS 1's serialisation.
//!
//! Source: OMG DDS-XTypes 1.3, 7.4 (XCDR version 1, plain); OMG RTPS 2.5, 10.2 (encapsulation); ROS wiki, "msg" (ROS 1).
//! CDR aligns each primitive to its size, counted after the four bytes of encapsulation; its strings end in NUL, which their
//! length counts. ROS 1 has neither alignment, nor encapsulation, nor NUL, and is little endian.

mod fields;
mod reader;
mod writer;

pub use fields::Int8s;
pub use reader::Reader;
pub use writer::Writer;

use crate::description::{self, Definitions, FieldType};
use crate::{DecodeError, EncodeError, Fault, TypeHash, Value};

/// How a message is laid out in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Encoding {
    /// CDR, little endian: what ROS 2 writes on all machines of today.
    CdrLittleEndian,
    /// CDR, big endian.
    CdrBigEndian,
    /// ROS 1.
    Ros1,
}

/// What can stand in a message: primitives, strings, arrays, sequences, and messages themselves.
pub trait Wire<'a>: Sized {
    /// Bytes that a value takes at least, without padding: what a declared number of elements is checked against.
    const LEAST_BYTES: usize;

    /// Reads a value.
    ///
    /// # Errors
    /// Any [`Fault`], with its place.
    fn read(reader: &mut Reader<'a>) -> Result<Self, DecodeError>;

    /// Reads `count` values; [`Reader::count`] has checked that they may be there.
    ///
    /// # Errors
    /// As [`Wire::read`].
    fn read_many(reader: &mut Reader<'a>, count: usize) -> Result<Vec<Self>, DecodeError> {
        // What is reserved is no more than the bytes that are left; it grows with what is read.
        let mut values = Vec::with_capacity(count.min(reader.remaining() / size_of::<Self>().max(1)));
        for index in 0..count {
            values.push(Self::read(reader).map_err(|e| e.in_element(index))?);
        }
        Ok(values)
    }

    /// Writes the value.
    fn write(&self, writer: &mut Writer);

    /// Bytes that the value takes, padding left out: a guess that saves growing.
    fn num_bytes(&self) -> usize {
        Self::LEAST_BYTES
    }

    /// The value that a field has when nobody has set it (ROS: zero, empty, or the default that the definition names).
    fn initial() -> Self;

    /// The type, with those of its fields added to `definitions`.
    fn describe(definitions: &mut Definitions) -> FieldType;

    /// The value as a tree, for showing and comparing.
    fn value(&self) -> Value;
}

/// A message with a name of its own.
pub trait Message<'a>: Wire<'a> {
    /// Its name, `sensor_msgs/msg/PointCloud2`.
    const TYPE_NAME: &'static str;
    /// Whether its ROS 1 form is known here.
    const IS_IN_ROS1: bool;

    /// From CDR of either byte order; large payloads stay where they are.
    ///
    /// # Errors
    /// Any [`Fault`], with field and byte. Up to 7 bytes behind the last field are taken for padding.
    fn decode(bytes: &'a [u8]) -> Result<Self, DecodeError> {
        let read = || {
            let mut reader = Reader::cdr(bytes)?;
            let message = Self::read(&mut reader)?;
            reader.finish(8)?;
            Ok(message)
        };
        read().map_err(|e: DecodeError| e.in_message(Self::TYPE_NAME))
    }

    /// From ROS 1's serialisation.
    ///
    /// # Errors
    /// Any [`Fault`], with field and byte.
    fn decode_ros1(bytes: &'a [u8]) -> Result<Self, DecodeError> {
        let read = || {
            if !Self::IS_IN_ROS1 {
                return Err(DecodeError::at(0, Fault::NotInRos1));
            }
            let mut reader = Reader::ros1(bytes);
            let message = Self::read(&mut reader)?;
            reader.finish(1)?;
            Ok(message)
        };
        read().map_err(|e: DecodeError| e.in_message(Self::TYPE_NAME))
    }

    /// From bytes of either generation.
    ///
    /// # Errors
    /// Any [`Fault`], with field and byte.
    fn decode_as(encoding: Encoding, bytes: &'a [u8]) -> Result<Self, DecodeError> {
        match encoding {
            Encoding::Ros1 => Self::decode_ros1(bytes),
            Encoding::CdrLittleEndian | Encoding::CdrBigEndian => Self::decode(bytes),
        }
    }

    /// As CDR, little endian.
    ///
    /// # Errors
    /// `TooLong`.
    fn encode(&self) -> Result<Vec<u8>, EncodeError> {
        self.encode_as(Encoding::CdrLittleEndian)
    }

    /// As bytes of this encoding.
    ///
    /// # Errors
    /// `TooLong`, `NotInRos1`.
    fn encode_as(&self, encoding: Encoding) -> Result<Vec<u8>, EncodeError> {
        let message = Self::TYPE_NAME;
        if encoding == Encoding::Ros1 && !Self::IS_IN_ROS1 {
            return Err(EncodeError::NotInRos1 { message });
        }
        let mut writer = Writer::new(encoding, self.num_bytes());
        self.write(&mut writer);
        writer.finish().map_err(|length| EncodeError::TooLong { message, length })
    }

    /// The hash of its definition. It is computed at each call: keep it.
    fn type_hash() -> TypeHash {
        TypeHash::of(Self::TYPE_NAME, &definitions::<Self>())
    }

    /// Its definition and those that it needs as ROS 2 writes them (`.msg` files, parted by lines of `=`), without comments
    /// and constants.
    fn definition() -> String {
        description::text(Self::TYPE_NAME, &definitions::<Self>())
    }
}

fn definitions<'a, M: Wire<'a>>() -> Definitions {
    let mut definitions = Definitions::new();
    M::describe(&mut definitions);
    definitions
}
