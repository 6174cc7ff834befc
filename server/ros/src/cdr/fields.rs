//! What stands in messages: primitives, strings, arrays and sequences.

use super::{Reader, Writer};
use crate::description::{Base, Definitions, FieldType};
use crate::{DecodeError, Value, Wire};
use std::borrow::Cow;

macro_rules! primitive {
    ($($type:ty, $base:ident, $value:expr;)*) => { $(
        impl<'a> Wire<'a> for $type {
            const LEAST_BYTES: usize = size_of::<$type>();

            fn read(reader: &mut Reader<'a>) -> Result<Self, DecodeError> {
                Ok(Self::from_le_bytes(reader.primitive()?))
            }

            fn read_many(reader: &mut Reader<'a>, count: usize) -> Result<Vec<Self>, DecodeError> {
                let chunks = reader.primitives(count)?;
                Ok(if reader.is_big_endian() {
                    chunks.iter().map(|&b| Self::from_be_bytes(b)).collect()
                } else {
                    chunks.iter().map(|&b| Self::from_le_bytes(b)).collect()
                })
            }

            fn write(&self, writer: &mut Writer) {
                writer.primitive(self.to_le_bytes());
            }

            fn initial() -> Self {
                Self::default()
            }

            fn describe(_: &mut Definitions) -> FieldType {
                FieldType::one(Base::$base)
            }

            fn value(&self) -> Value {
                let value: fn($type) -> Value = $value;
                value(*self)
            }
        }
    )* };
}

primitive! {
    i8, Int8, |v| Value::Integer(v.into());
    u8, Uint8, |v| Value::Integer(v.into());
    i16, Int16, |v| Value::Integer(v.into());
    u16, Uint16, |v| Value::Integer(v.into());
    i32, Int32, |v| Value::Integer(v.into());
    u32, Uint32, |v| Value::Integer(v.into());
    i64, Int64, |v| Value::Integer(v.into());
    u64, Uint64, |v| Value::Integer(v.into());
    f32, Float32, |v| Value::Float(v.into());
    f64, Float64, Value::Float;
}

/// One byte; whatever is not 0 is true.
impl<'a> Wire<'a> for bool {
    const LEAST_BYTES: usize = 1;

    fn read(reader: &mut Reader<'a>) -> Result<Self, DecodeError> {
        Ok(u8::read(reader)? != 0)
    }

    fn write(&self, writer: &mut Writer) {
        u8::from(*self).write(writer);
    }

    fn initial() -> Self {
        false
    }

    fn describe(_: &mut Definitions) -> FieldType {
        FieldType::one(Base::Bool)
    }

    fn value(&self) -> Value {
        Value::Bool(*self)
    }
}

impl<'a> Wire<'a> for &'a str {
    const LEAST_BYTES: usize = 4;

    fn read(reader: &mut Reader<'a>) -> Result<Self, DecodeError> {
        reader.string()
    }

    fn write(&self, writer: &mut Writer) {
        writer.string(self);
    }

    fn num_bytes(&self) -> usize {
        self.len() + 8
    }

    fn initial() -> Self {
        ""
    }

    fn describe(_: &mut Definitions) -> FieldType {
        FieldType::one(Base::String)
    }

    fn value(&self) -> Value {
        Value::Text((*self).to_owned())
    }
}

/// `uint8[]`, borrowed from the payload when read.
impl<'a> Wire<'a> for Cow<'a, [u8]> {
    const LEAST_BYTES: usize = 4;

    fn read(reader: &mut Reader<'a>) -> Result<Self, DecodeError> {
        let count = reader.count(1)?;
        Ok(Cow::Borrowed(reader.take(count)?))
    }

    fn write(&self, writer: &mut Writer) {
        writer.count(self.len());
        writer.raw(self);
    }

    fn num_bytes(&self) -> usize {
        self.len() + 8
    }

    fn initial() -> Self {
        Cow::Borrowed(&[])
    }

    fn describe(_: &mut Definitions) -> FieldType {
        FieldType::one(Base::Uint8).sequence()
    }

    fn value(&self) -> Value {
        Value::List(self.iter().map(Wire::value).collect())
    }
}

/// `int8[]`, borrowed from the payload when read: bytes, each in two's complement.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Int8s<'a>(pub Cow<'a, [u8]>);

impl Int8s<'_> {
    /// Number of values.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The values.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = i8> + '_ {
        self.0.iter().map(|&b| b.cast_signed())
    }
}

impl FromIterator<i8> for Int8s<'_> {
    fn from_iter<T: IntoIterator<Item = i8>>(values: T) -> Self {
        Self(values.into_iter().map(i8::cast_unsigned).collect())
    }
}

impl<'a> Wire<'a> for Int8s<'a> {
    const LEAST_BYTES: usize = 4;

    fn read(reader: &mut Reader<'a>) -> Result<Self, DecodeError> {
        Cow::read(reader).map(Self)
    }

    fn write(&self, writer: &mut Writer) {
        self.0.write(writer);
    }

    fn num_bytes(&self) -> usize {
        self.0.num_bytes()
    }

    fn initial() -> Self {
        Self::default()
    }

    fn describe(_: &mut Definitions) -> FieldType {
        FieldType::one(Base::Int8).sequence()
    }

    fn value(&self) -> Value {
        Value::List(self.iter().map(|v| v.value()).collect())
    }
}

impl<'a, T: Wire<'a>> Wire<'a> for Vec<T> {
    const LEAST_BYTES: usize = 4;

    fn read(reader: &mut Reader<'a>) -> Result<Self, DecodeError> {
        let count = reader.count(T::LEAST_BYTES)?;
        T::read_many(reader, count)
    }

    fn write(&self, writer: &mut Writer) {
        writer.count(self.len());
        self.iter().for_each(|v| v.write(writer));
    }

    fn num_bytes(&self) -> usize {
        8 + self.iter().map(Wire::num_bytes).sum::<usize>()
    }

    fn initial() -> Self {
        Self::new()
    }

    fn describe(definitions: &mut Definitions) -> FieldType {
        T::describe(definitions).sequence()
    }

    fn value(&self) -> Value {
        Value::List(self.iter().map(Wire::value).collect())
    }
}

impl<'a, T: Wire<'a> + Copy, const N: usize> Wire<'a> for [T; N] {
    const LEAST_BYTES: usize = N * T::LEAST_BYTES;

    fn read(reader: &mut Reader<'a>) -> Result<Self, DecodeError> {
        let mut values = Self::initial();
        for (index, value) in values.iter_mut().enumerate() {
            *value = T::read(reader).map_err(|e| e.in_element(index))?;
        }
        Ok(values)
    }

    fn write(&self, writer: &mut Writer) {
        self.iter().for_each(|v| v.write(writer));
    }

    fn initial() -> Self {
        [T::initial(); N]
    }

    fn describe(definitions: &mut Definitions) -> FieldType {
        T::describe(definitions).array(N)
    }

    fn value(&self) -> Value {
        Value::List(self.iter().map(Wire::value).collect())
    }
}
