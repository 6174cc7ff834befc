//! A binary body, element by element.

use super::FORMAT;
use super::header::{Element, Property};
use crate::scalar::Scalar;
use crate::{FormatError, Place};

/// A place in a binary body.
pub(super) struct Cursor<'a> {
    pub(super) bytes: &'a [u8],
    pub(super) offset: usize,
    pub(super) big_endian: bool,
}

impl<'a> Cursor<'a> {
    pub(super) fn take(&mut self, needed: u64, field: &'static str) -> Result<&'a [u8], FormatError> {
        let rest = &self.bytes[self.offset..];
        match usize::try_from(needed).ok().and_then(|n| rest.get(..n)) {
            Some(taken) => {
                self.offset += taken.len();
                Ok(taken)
            }
            None => Err(FormatError::Truncated { format: FORMAT, field, needed, available: rest.len() as u64 }),
        }
    }

    /// One element with lists; `visit` gets the scalar properties, by their index.
    pub(super) fn visit(&mut self, element: &Element, mut visit: impl FnMut(usize, f64)) -> Result<(), FormatError> {
        for (i, property) in element.properties.iter().enumerate() {
            match property.list_length {
                None => {
                    let bytes = self.take(property.scalar.size() as u64, "property")?;
                    visit(i, property.scalar.read(bytes, self.big_endian));
                }
                Some(length) => {
                    self.list(property, length)?;
                }
            }
        }
        Ok(())
    }

    /// The items of a list whose length is kept as `length`.
    pub(super) fn list(&mut self, property: &Property, length: Scalar) -> Result<&'a [u8], FormatError> {
        let at = self.offset as u64;
        let n = length.read(self.take(length.size() as u64, "list length")?, self.big_endian);
        if !(n >= 0.0 && n.fract() == 0.0) {
            let (field, found) = (format!("length of list {}", property.name), n.to_string());
            return Err(FormatError::malformed(FORMAT, Place::Byte(at), field, found.as_bytes(), "a count"));
        }
        self.take((n as u64).saturating_mul(property.scalar.size() as u64), "list")
    }

    /// Steps over all elements of a kind.
    pub(super) fn skip(&mut self, element: &Element) -> Result<(), FormatError> {
        match element.stride() {
            Some(stride) => self.take(element.count.saturating_mul(stride as u64), "skipped element").map(|_| ()),
            None => (0..element.count).try_for_each(|_| self.visit(element, |_, _| {})),
        }
    }
}
